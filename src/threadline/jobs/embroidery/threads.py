"""The threads of a design: a colour for each block, from the formats that hold colours.

PES and PEC, HUS and JEF hold indices into a palette of their maker, XXX and VP3 the colours
themselves, and some writers of DST add ``TC`` lines to its header. EXP, U01 and T15 hold none.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable, Sequence

from threadline.errors import Place
from threadline.jobs.operations import Thread

_HUS_COLOURS, _HUS_COLUMN, _HUS_INDICES = slice(8, 12), slice(20, 24), 42


def pec_threads(content: bytes, place: Place) -> list[Thread | None]:
    """Return the threads of a PES or PEC file; index 0 of its palette is no colour."""
    from threadline.jobs.embroidery.pes import palette_indices

    return _from_palette("EmbThreadPec", palette_indices(content, place))


def hus_threads(content: bytes, place: Place) -> list[Thread | None]:  # noqa: ARG001
    """Return the threads of a HUS file, from the indices of 16 bits behind its header."""
    count = int.from_bytes(content[_HUS_COLOURS], "little")
    end = min(_HUS_INDICES + 2 * count, int.from_bytes(content[_HUS_COLUMN], "little"))
    index_bytes = content[_HUS_INDICES:end]
    pairs = zip(index_bytes[::2], index_bytes[1::2], strict=False)
    return _from_palette("EmbThreadHus", [low | high << 8 for low, high in pairs])


def vp3_threads(content: bytes, place: Place) -> list[Thread | None]:
    """Return the threads of a VP3 file, with their names in its catalogue."""
    from threadline.jobs.embroidery.vp3 import read_threads

    return [
        Thread(f"#{red:02x}{green:02x}{blue:02x}", name)
        for (red, green, blue), name in read_threads(content, place)
    ]


READERS: dict[str, Callable[[bytes, Place], list[Thread | None]]] = {
    ".pes": pec_threads,
    ".pec": pec_threads,
    ".hus": hus_threads,
    ".vp3": vp3_threads,
}
"""Readers of the threads, by the ending of the file; for files whose records were read."""


def threads_of_peer(found: Iterable[object]) -> list[Thread | None]:
    """Return the threads that a reader of pystitch found; None where it found no colour."""
    return [
        None if thread is None else Thread(thread.hex_color(), str(thread.description or ""))  # type: ignore[attr-defined]
        for thread in found
    ]


def _from_palette(module: str, indices: Sequence[int]) -> list[Thread | None]:
    """Return the threads of a palette of pystitch; None for an index that it does not have."""
    palette = importlib.import_module(f"pystitch.{module}").get_thread_set()
    return threads_of_peer(palette[k] if 0 <= k < len(palette) else None for k in indices)
