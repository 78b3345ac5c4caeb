"""The readers of pystitch, watched: a design that is cut off must not pass for a shorter one."""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable

from pystitch import EmbPattern

READERS = {
    ".dst": "DstReader",
    ".exp": "ExpReader",
    ".pes": "PesReader",
    ".jef": "JefReader",
    ".vp3": "Vp3Reader",
    ".xxx": "XxxReader",
    ".u01": "U01Reader",
}
"""By the ending of the file."""
_ENDS: dict[str, Callable[[bytes, bool], bool]] = {
    ".pes": lambda read, _: read[-2:] == b"\xff\x00",
    # Its reader takes two bytes more, where there are any.
    ".jef": lambda read, _: b"\x80\x10" in (read[-4:-2], read[-3:-1], read[-2:]),
    ".vp3": lambda _, short: not short,
    ".xxx": lambda read, _: read[-4:-2] in (b"\x7f\x7f", b"\x7f\x18"),
    ".u01": lambda read, _: len(read) > 2 and read[-3] & 0x1F == 0x18,
}
"""Whether the records are whole, by what was read until their end and whether more was wanted: four
formats have a mark of their own, VP3 says its lengths. EXP has neither; DST is looked at before."""


class CutOffError(Exception):
    """The records end without the mark of their end."""


class SenselessError(Exception):
    """What stands at a byte makes no sense to the reader."""


class _Stream(io.BytesIO):
    """Remembers whether somebody wanted more than there is."""

    short = False

    def read(self, size: int | None = -1, /) -> bytes:
        found = super().read(size)
        if size is not None and 0 <= len(found) < size:
            self.short = True
        return found


class _Watched(EmbPattern):  # type: ignore[misc]
    """Looks where its reader stands when the records are at their end."""

    def __init__(self, stream: _Stream, suffix: str) -> None:
        super().__init__()
        self._stream, self._suffix = stream, suffix

    def end(self, dx: float = 0, dy: float = 0) -> None:
        """Take the end of the design, unless that is where the file was cut off."""
        at = self._stream.tell()
        whole = _ENDS.get(self._suffix)
        last = self._stream.getvalue()[max(0, at - 4) : at]
        if whole is not None and not whole(last, self._stream.short):
            raise CutOffError(f"its records are cut off at byte {at}")
        super().end(dx, dy)


def read_with_peer(content: bytes, suffix: str) -> tuple[list[list[float]], int]:
    """Return x, y and code of every record, and how many bytes were read.

    Raises
    ------
    CutOffError
        If the records end without their mark.
    SenselessError
        If its arithmetic meets what no such file has.
    """
    stream = _Stream(content)
    pattern = _Watched(stream, suffix)
    try:
        importlib.import_module(f"pystitch.{READERS[suffix]}").read(stream, pattern)
    except CutOffError:
        raise
    except Exception as error:
        # It raises whatever it meets: TypeError where bytes are lacking, IndexError in a palette.
        at, size = stream.tell(), len(content)
        why = f"it ends at byte {size}, in the middle of what is read there"
        if at < size or not stream.short:
            why = f"what stands before byte {at} of {size} makes no sense there"
        raise SenselessError(why) from error
    stitches: list[list[float]] = pattern.stitches
    return stitches, stream.tell()
