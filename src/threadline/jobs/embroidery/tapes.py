"""Writers of designs with records of three bytes: Tajima's DST and Barudan's U01.

Both formats have units of 0.1 mm and split a longer move into jumps and a stitch.

* **DST**: a header of 512 bytes in text, then records. A displacement of at most 121 units has five
  balanced digits in base 3 for each axis, a bit for each digit and sign. A thread change and a stop
  are the same record; readers take three jumps in a row as a trim.
* **U01**: a header of 256 bytes, then records of a command, Y and X, of at most 127 units here. The
  command has the signs and the act; SLOW and FAST belong to a stitch or jump that moves. A thread
  change is the number of a needle, 1 to 15.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from itertools import pairwise

import numpy as np

from threadline.base.arrays import IntArray

DST, U01 = ".dst", ".u01"
DST_MOST, U01_MOST = 121, 127
"""Longest displacement of a record, in units of 0.1 mm."""
MOST_JUMPS = 2
"""Most jumps before a stitch that no reader of DST takes for a trim."""
NEEDLES = 15
SLOW, FAST = "slow", "fast"
_HEADER = {DST: 512, U01: 256}
_JUMP, _CHANGE, _END = 0x80, 0xC3, 0xF3
_BITS: Mapping[int, tuple[int, int, int, int, int]] = {
    # Digit: byte, and the bits of X forward, X back, Y up, Y down.
    1: (0, 0, 1, 7, 6),
    3: (1, 0, 1, 7, 6),
    9: (0, 2, 3, 5, 4),
    27: (1, 2, 3, 5, 4),
    81: (2, 2, 3, 5, 4),
}
_TRIM_WAYS = ((2, 2), (-4, -4), (2, 2))
"""Three jumps that end where they begin: a trim in DST."""
_U01_SIGNED, _U01_DOWN, _U01_BACK = 0x80, 0x40, 0x20
_U01_JUMP, _U01_TRIM, _U01_STOP, _U01_END = 0x01, 0x07, 0x08, 0xF8
_U01_PACE = {FAST: 0x02, SLOW: 0x04}

Part = tuple[str, int, int]
"""An act (``stitch``, ``jump``, or the name of an event), and its displacement."""


def dst_bytes(units: IntArray, sewn: IntArray, events: Mapping[int, list[str]], name: str) -> bytes:
    """Return the bytes of a DST file.

    Parameters
    ----------
    units
        (n, 2) displacements in units of 0.1 mm, X and Y (up).
    sewn
        (n,) 1 if the displacement ends in a stitch, 0 if the needle is up.
    events
        Events by the index of the displacement that follows them; n at the end of the design. Only
        ``trim``, ``stop`` and ``colour`` are written.
    name
        Name of the design in the header.
    """
    records: list[bytes] = []
    changes = 0
    for act, dx, dy in _record_parts(units, sewn, events, DST_MOST):
        if act in {"stitch", "jump"}:
            records.append(_dst_record(dx, dy, 0x03 | (_JUMP if act == "jump" else 0)))
        elif act == "trim":
            records += [_dst_record(*step, 0x03 | _JUMP) for step in _TRIM_WAYS]
        elif act in {"stop", "colour"}:
            records.append(bytes((0, 0, _CHANGE)))
            changes += 1
    left, right, low, high, x, y = _extents(units)
    label = "".join(c if c.isascii() and c.isprintable() else "_" for c in name)[:16]
    fields = [
        f"LA:{label:<16}", f"ST:{len(records):7}", f"CO:{changes:3}",
        f"+X:{right:5}", f"-X:{-left:5}", f"+Y:{high:5}", f"-Y:{-low:5}",
        *(f"{key}:{'-' if last < 0 else '+'}{abs(last):5}" for key, last in (("AX", x), ("AY", y))),
        "MX:+    0", "MY:+    0", "PD:******",
    ]  # fmt: skip
    head = "".join(f"{field}\r" for field in fields).encode("ascii") + b"\x1a"
    return head.ljust(_HEADER[DST]) + b"".join(records) + bytes((0, 0, _END))


def u01_bytes(units: IntArray, sewn: IntArray, events: Mapping[int, list[str]]) -> bytes:
    """Return the bytes of a U01 file; the design begins with needle 1.

    Parameters
    ----------
    units, sewn
        As for ``dst_bytes``.
    events
        Events by the index of the displacement that follows them; n at the end of the design:
        ``trim``, ``stop``, ``colour``, ``slow`` and ``fast``. The last two are written in the next
        record that moves.
    """
    records, pace, needle = [_u01_record(_U01_STOP + 1, 0, 0)], 0, 1
    for act, dx, dy in _record_parts(units, sewn, events, U01_MOST):
        if act in _U01_PACE:
            pace = _U01_PACE[act]
        elif act == "trim":
            records.append(_u01_record(_U01_TRIM, 0, 0))
        elif act == "stop":
            records.append(_u01_record(_U01_STOP, 0, 0))
        elif act == "colour":
            if len(records) == 1:  # the design names its first needle itself
                continue
            needle = needle % NEEDLES + 1
            records.append(_u01_record(_U01_STOP + needle, 0, 0))
        else:
            moves = bool(dx or dy)
            jump = _U01_JUMP if act == "jump" else 0
            records.append(_u01_record(jump | (pace if moves else 0), dx, dy))
            pace = 0 if moves else pace
    left, right, low, high, x, y = _extents(units)
    numbers = (left, low, right, high, 0, len(records) + 1, x, y)
    head = b"0" * 128 + struct.pack("<4h2I2h", *numbers)
    return head.ljust(_HEADER[U01], b"\0") + b"".join(records) + bytes((_U01_END, 0, 0))


def _record_parts(
    units: IntArray, sewn: IntArray, events: Mapping[int, list[str]], most: int
) -> Iterator[Part]:
    """Yield the records of a design; a displacement above ``most`` is jumps and its own act."""
    for k, (step, stitch) in enumerate(zip(units.tolist(), sewn.tolist(), strict=True)):
        for name in events.get(k, ()):
            yield name, 0, 0
        count = max(1, -(-max(map(abs, step)) // most))
        places = np.rint(np.outer(np.arange(count + 1) / count, step)).astype(int).tolist()
        for number, (before, after) in enumerate(pairwise(places), 1):
            last = number == count
            act = "stitch" if stitch and last else "jump"
            yield act, after[0] - before[0], after[1] - before[1]
    for name in events.get(len(units), ()):
        yield name, 0, 0


def _extents(units: IntArray) -> tuple[int, int, int, int, int, int]:
    """Return least and largest X, least and largest Y (start included), and the last place."""
    places = np.vstack((np.zeros((1, 2), dtype=np.int64), np.cumsum(units, axis=0)))
    (left, low), (right, high) = places.min(axis=0).tolist(), places.max(axis=0).tolist()
    x, y = places[-1].tolist()
    return left, right, low, high, x, y


def _dst_record(dx: int, dy: int, last: int) -> bytes:
    record = [0, 0, last]
    for units, forward, backward in ((dx, 1, 2), (dy, 3, 4)):
        rest, digit = units, 1
        while rest:
            sign = (rest + 1) % 3 - 1
            if sign:
                bits = _BITS[digit]
                record[bits[0]] |= 1 << bits[forward if sign > 0 else backward]
            rest, digit = (rest - sign) // 3, digit * 3
    return bytes(record)


def _u01_record(act: int, dx: int, dy: int) -> bytes:
    # Writers of this format give a displacement of 0 the signs of X back and Y down.
    signs = (_U01_DOWN if dy <= 0 else 0) | (_U01_BACK if dx <= 0 else 0)
    return bytes((_U01_SIGNED | signs + act, abs(dy), abs(dx)))
