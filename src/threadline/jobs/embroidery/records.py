"""The records of a design file in any format: positions, and the act at each position."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from importlib import import_module
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.reading import open_binary
from threadline.errors import JobError, Place
from threadline.jobs.operations import Thread

_OWN_READERS = {".hus": "hus", ".t15": "t15", ".pes": "pes", ".pec": "pes", ".vp3": "vp3"}
"""Module of each of Threadline's own readers, by the ending of the file.

pystitch reads all other formats. A module is imported when a file needs it.
"""
_PEERS = (".dst", ".exp", ".jef", ".xxx", ".u01")
SUFFIXES = (*_PEERS, *_OWN_READERS)
UNIT_M = 1e-4
"""Unit of length of all these formats: 0.1 mm."""
MAX_BYTES = 64 * 1024 * 1024
_DST_HEADER, _DST_RECORD = 512, 3
_DST_FILL = b"\x1a"
_DST_PADDING = b"\x00\x1a "
_EXTENT_SIGNS = (1, -1, 1, -1)
_DST_FIELD = re.compile(rb"(ST|[+-][XY]|A[XY]):([+-]? *\d+)[\r\n]")


class Act(IntEnum):
    """The act at the position of a record, with the numbers of pystitch."""

    STITCH = 0
    JUMP = 1
    TRIM = 2
    STOP = 3
    END = 4
    COLOUR = 5
    NEEDLE = 9
    SLOW = 0xB
    FAST = 0xC


_KNOWN = tuple(Act)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Records:
    """The n records of a design.

    Parameters
    ----------
    position_m
        (n, 2) X to the right and Y up, in m, from the start position of the frame.
    act
        (n,) acts, as numbers of ``Act``.
    content
        All bytes of the file.
    threads
        A thread for each colour of the design, None where its colour is not known; empty if the
        file holds no colours.
    warnings
        Warnings about the file.
    """

    position_m: FloatArray
    act: IntArray
    content: bytes
    threads: tuple[Thread | None, ...] = ()
    warnings: tuple[str, ...] = ()


def read_records(path: Path) -> Records:
    """Return the records of a design.

    Raises
    ------
    JobError
        If the file cannot be read, is cut off, or does not have the format of its ending.
    """
    place = Place(str(path))
    with open_binary(path) as stream:
        content = b"" if path.is_dir() else stream.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise JobError(
            f"the design has more than {MAX_BYTES} bytes", place=place, remedy="Is it a design?"
        )
    suffix = path.suffix.lower()
    warnings = _check_dst(content, place) if suffix == ".dst" else ()
    decoded: FloatArray | list[list[float]]
    if suffix in _OWN_READERS:
        decoded, thread_list = _read_here(content, suffix, place)
    else:
        decoded, thread_list = _decoded(content, suffix, place)
    table = np.array(decoded, dtype=np.float64).reshape(len(decoded), 3)
    if not np.isfinite(table).all():
        raise _not_of_its_format(suffix, "a place that is not a number", place)
    act = table[:, 2].astype(np.int64) & 0xFF
    unknown = np.flatnonzero(~np.isin(act, _KNOWN))
    if len(unknown):
        first = int(unknown[0])
        raise JobError(
            f"record {first + 1} has a command that no machine here executes (code "
            f"{int(act[first])})",
            place=Place(str(path), first + 1),
            remedy="Export the design without sequins and other attachments.",
        )
    # The readers return Y down.
    position = table[:, :2] * np.array([UNIT_M, -UNIT_M]) + 0.0
    return Records(
        position_m=position, act=act, content=content, threads=tuple(thread_list), warnings=warnings
    )


def sewn_units(content: bytes, suffix: str) -> IntArray:
    """Return the (n, 2) places of the stitches in units of 0.1 mm, X and Y (up).

    Parameters
    ----------
    content
        All bytes of a file in a format that pystitch reads.
    suffix
        Ending of the format.
    """
    table = np.array(_decoded(content, suffix, Place(""))[0], dtype=np.float64).reshape(-1, 3)
    sewn = table[table[:, 2].astype(np.int64) & 0xFF == Act.STITCH, :2]
    return np.rint(sewn * (1.0, -1.0)).astype(np.int64)


def _read_here(
    content: bytes, suffix: str, place: Place
) -> tuple[FloatArray | list[list[float]], list[Thread | None]]:
    """Return x, y and code of every record, and the threads, from one of Threadline's readers."""
    from threadline.jobs.embroidery.threads import READERS

    name = _OWN_READERS[suffix]
    reader: Callable[[bytes, Place], FloatArray | list[list[float]]] = getattr(
        import_module(f"{__package__}.{name}"), f"read_{name}"
    )
    decoded = reader(content, place)
    return decoded, READERS[suffix](content, place) if suffix in READERS else []


def _decoded(
    content: bytes, suffix: str, place: Place
) -> tuple[list[list[float]], list[Thread | None]]:
    """Return x, y and code of every record, and the threads, from the reader of pystitch."""
    from threadline.jobs.embroidery.peer_readers import CutOffError, SenselessError, read_with_peer

    try:
        stitches, thread_list, bytes_read = read_with_peer(content, suffix)
    except CutOffError as error:
        raise _not_of_its_format(suffix, str(error), place) from error
    except SenselessError as error:
        raise _not_of_its_format(suffix, str(error), place) from error
    if suffix == ".exp" and (bytes_read < len(content) or len(content) % 2):
        # EXP has no end mark: the bytes that the reader left would be lost.
        why = f"byte {bytes_read - 2} of {len(content)} is no record"
        raise _not_of_its_format(suffix, why, place)
    return stitches, thread_list


def _not_of_its_format(suffix: str, why: str, place: Place) -> JobError:
    return JobError(
        f"the file cannot be read as {suffix[1:].upper()}: {why}",
        place=place,
        remedy="It is damaged, or its name has the ending of another format; export it again.",
    )


def _check_dst(content: bytes, place: Place) -> tuple[str, ...]:
    """Refuse a DST file that is cut off; return warnings about one that may be damaged.

    Only the end mark is missing if number, extents and last position of the records equal the
    header's. In a file with its end mark only the extents are compared with the header: programs
    count the records and give the last position in their own ways.
    """
    records = content[_DST_HEADER:]
    count = len(records) // _DST_RECORD
    marks = np.frombuffer(records[: count * _DST_RECORD], dtype=np.uint8)
    ends = np.flatnonzero(marks[2::_DST_RECORD] & 0xF3 == 0xF3)
    if len(ends):
        bytes_behind = len(records[(int(ends[0]) + 1) * _DST_RECORD :].strip(_DST_PADDING))
        return (
            *(
                [f"{place}: {bytes_behind} bytes behind the mark of its end are left out"]
                * (bytes_behind > 0)
            ),
            *_other_extents(content, place),
        )
    if records[count * _DST_RECORD :] in {b"", _DST_FILL} and _is_whole_dst(content, count):
        return (
            f"{place}: the mark of its end is missing; number, extents and end of its {count} "
            "records agree with its header, so nothing else is",
        )
    raise JobError(
        f"the file ends after {count} records without the mark of its end",
        place=place,
        remedy="It is cut off, or no DST file; export it again.",
    )


def _other_extents(content: bytes, place: Place) -> tuple[str, ...]:
    """Return a warning if the records of a DST file reach elsewhere than its header says."""
    stated = _dst_header(content)
    stated_extents = [stated.get(key, 0) for key in ("+X", "-X", "+Y", "-Y")]
    if not any(stated_extents):
        return ()
    extents = _extents(np.array(_decoded(content, ".dst", Place(""))[0], dtype=np.float64))
    if extents[:2] == stated_extents[:2] and sorted(extents[2:]) == sorted(stated_extents[2:]):
        return ()
    header, reached = (
        "X {1:g} to {0:g} and Y {3:g} to {2:g}".format(
            *(n / 10 * s + 0.0 for n, s in zip(reach, _EXTENT_SIGNS, strict=True))
        )
        for reach in (stated_extents, extents)
    )
    return (
        f"{place}: its header says that the design reaches {header} mm; its records reach "
        f"{reached} mm: one of them may be damaged",
    )


def _dst_header(content: bytes) -> dict[str, int]:
    return {
        key.decode("ascii"): int(value.replace(b" ", b""))
        for key, value in _DST_FIELD.findall(content[:_DST_HEADER])
    }


def _extents(table: FloatArray) -> list[float]:
    """Return how far (n, 3) records reach to +X, -X, +Y (down) and -Y from the start."""
    x, y = table[:, 0], table[:, 1]
    return [max(0.0, float(v)) for v in (x.max(), -x.min(), y.max(), -y.min())]


def _is_whole_dst(content: bytes, count: int) -> bool:
    """Return whether the header of a DST file without end mark agrees with its records.

    Programs count the thread changes and the end mark as records, or do not, and have Y up or down.
    The last position may differ from the header only if the design ends where it began.
    """
    header = _dst_header(content)
    if not count or set(header) != {"ST", "+X", "-X", "+Y", "-Y", "AX", "AY"}:
        return False
    table = np.array(_decoded(content, ".dst", Place(""))[0], dtype=np.float64)
    x, y = table[:, 0], table[:, 1]
    right, left, *along_y = _extents(table)
    change = int((table[:, 2].astype(np.int64) & 0xFF == Act.COLOUR).sum())
    return (
        header["ST"] in {count, count + 1, count - change}
        and [right, left] == [header["+X"], header["-X"]]
        and sorted(along_y) == sorted((header["+Y"], header["-Y"]))
        and (x[-1], abs(y[-1])) in {(header["AX"], abs(header["AY"])), (0.0, 0.0)}
    )
