"""Readers of pystitch, with a check that refuses a design that is cut off."""

from __future__ import annotations

import importlib
import io
from collections.abc import Callable

from pystitch import EmbPattern

from threadline.jobs.embroidery.threads import threads_of_peer
from threadline.jobs.operations import Thread

READERS = {
    ".dst": "DstReader",
    ".exp": "ExpReader",
    ".jef": "JefReader",
    ".xxx": "XxxReader",
    ".u01": "U01Reader",
}
"""Module of pystitch that reads each format, by the ending of the file."""
_COMPLETE_TESTS: dict[str, Callable[[bytes], bool]] = {
    # The JEF reader takes two more bytes if the file has them.
    ".jef": lambda read: b"\x80\x10" in (read[-4:-2], read[-3:-1], read[-2:]),
    ".xxx": lambda read: read[-4:-2] in (b"\x7f\x7f", b"\x7f\x18"),
    ".u01": lambda read: len(read) > 2 and read[-3] & 0x1F == 0x18,
}
"""Tests that the records of a format are complete, by the ending of the file.

The argument is the last bytes that the reader has read. These three formats have an end mark; EXP
has no end mark, and ``records`` tests DST.
"""


class CutOffError(Exception):
    """The records end without the end mark."""


class SenselessError(Exception):
    """The reader failed at a byte that is not valid at its place."""


class _Stream(io.BytesIO):
    """A stream that notes whether a reader asked for more bytes than the file has."""

    short = False

    def read(self, size: int | None = -1, /) -> bytes:
        content = super().read(size)
        if size is not None and 0 <= len(content) < size:
            self.short = True
        return content


class _Watched(EmbPattern):  # type: ignore[misc]
    """A pattern of pystitch that tests at the end whether the records are complete."""

    def __init__(self, stream: _Stream, suffix: str) -> None:
        super().__init__()
        self._stream, self._suffix = stream, suffix

    def end(self, dx: float = 0, dy: float = 0) -> None:
        """Add the end of the design; raise ``CutOffError`` if the file is cut off there."""
        position = self._stream.tell()
        is_complete = _COMPLETE_TESTS.get(self._suffix)
        last = self._stream.getvalue()[max(0, position - 4) : position]
        if is_complete is not None and not is_complete(last):
            raise CutOffError(f"its records are cut off at byte {position}")
        super().end(dx, dy)


def read_with_peer(
    content: bytes, suffix: str
) -> tuple[list[list[float]], list[Thread | None], int]:
    """Return x, y and code of every record, the threads, and the number of bytes read.

    Raises
    ------
    CutOffError
        If the records end without the end mark.
    SenselessError
        If pystitch fails in any other way.
    """
    stream = _Stream(content)
    pattern = _Watched(stream, suffix)
    try:
        importlib.import_module(f"pystitch.{READERS[suffix]}").read(stream, pattern)
    except CutOffError:
        raise
    except Exception as error:
        # pystitch raises TypeError for missing bytes, IndexError for a bad palette, and others.
        position, size = stream.tell(), len(content)
        why = f"it ends at byte {size}, in the middle of a record"
        if position < size or not stream.short:
            why = f"the bytes before byte {position} of {size} make no sense there"
        raise SenselessError(why) from error
    stitches: list[list[float]] = pattern.stitches
    return stitches, threads_of_peer(pattern.threadlist), stream.tell()
