"""Saurer T15 cards: the punched card of a shuttle embroidery machine as a file.

No description of the format is published; this reader follows two files and the same designs in
DST. A file has a header of 12 bytes (size / 12, 15, 0), a leader of 384 bytes (64 columns of
punched letters), and records of 4 bytes: a function byte and three bytes of holes. A displacement
has three base-7 digits of three holes for each axis; a negative digit is the complement of the
positive digit. The record D0 and zeros end the file. The maker's names of the functions are not
known:

* C0 moves; C8 and CA come before each sewn stretch, CA and C8 come after the stretch;
* C6 marks a thread change, a thread cut or the end, and may move, too.
"""

from __future__ import annotations

import struct

import numpy as np

from threadline.base.arrays import IntArray
from threadline.errors import JobError, Place

SUFFIX = ".t15"
HEADER, LEADER, RECORD = 12, 384, 4
FIRST = HEADER + LEADER
MOST = 171
"""Longest displacement of a record, in units of 0.1 mm."""
MOVE, CHANGE, OUTER, INNER, END = 0xC0, 0xC6, 0xC8, 0xCA, 0xD0
_DIGITS = {0: 0, 1: 1, 2: 2, 4: 3, 6: -1, 5: -2, 3: -3}
_HOLES = {digit: holes for holes, digit in _DIGITS.items()}
_KIND = 15
_BLANKS = (100, 200)
"""Numbers of empty moves before and after the design, from the known cards."""
_STITCH, _JUMP, _TRIM, _COLOUR, _LAST = 0, 1, 2, 5, 4


def read_t15(content: bytes, place: Place) -> list[list[float]]:
    """Return x and y (down) in 0.1 mm and act of every record, like the readers of pystitch.

    Each sewn stretch begins with a stitch in place. A record without motion is a stitch inside a
    stretch, and is left out elsewhere.

    Raises
    ------
    JobError
        If the content differs from the format; the error gives the offset and the byte.
    """
    if len(content) < FIRST + RECORD or len(content) % HEADER:
        raise _refused(place, f"it has {len(content)} bytes, no whole number of 12 from 408 on")
    size, kind, zero = struct.unpack_from("<3I", content)
    if (size * HEADER, kind, zero) != (len(content), _KIND, 0):
        raise _refused(place, f"its header says {size}, {kind}, {zero}: no T15 card of its size")
    x, y, at, sewing, before = 0, 0, FIRST, False, 0
    found: list[list[float]] = []
    while True:
        if at + RECORD > len(content):
            raise _refused(place, f"it ends at {at:#x} without the record of its end")
        function = content[at]
        holes = content[at + 1 : at + RECORD]
        if function == END:
            break
        for k, byte in enumerate(holes):
            if byte & 0xC0 or byte & 7 == 7 or byte >> 3 & 7 == 7:
                raise _refused(place, f"the byte {byte:#04x} at {at + 1 + k:#x} is no displacement")
        first, second, third = holes
        dx = _digits(first, first >> 3, second)
        dy = _digits(second >> 3, third, third >> 3)
        x, y = x + dx, y + dy
        if function == MOVE:
            if sewing or dx or dy:
                found.append([x, -y, _STITCH if sewing else _JUMP])
        elif function == CHANGE:
            found.append([x, -y, _COLOUR])
        elif function in {OUTER, INNER}:
            if dx or dy:
                raise _refused(place, f"the function {function:#04x} at {at:#x} moves")
            if before in {OUTER, INNER} and before != function:
                if sewing != (function == OUTER):
                    raise _refused(place, f"the function {function:#04x} at {at:#x} is out of turn")
                sewing = not sewing
                if sewing:
                    found.append([x, -y, _STITCH])
                function = 0
        else:
            raise _refused(place, f"the function {function:#04x} at {at:#x} is not known")
        before = function
        at += RECORD
    rest = content[at + 1 :]
    if any(rest):
        wrong = at + 1 + next(k for k, byte in enumerate(rest) if byte)
        raise _refused(place, f"the byte {content[wrong]:#04x} at {wrong:#x} stands behind its end")
    # A change after the last stitch only cuts the thread.
    sewn = [k for k, row in enumerate(found) if row[2] == _STITCH]
    for row in found[sewn[-1] :] if sewn else ():
        if row[2] == _COLOUR:
            row[2] = _TRIM
    return [*found, [x, -y, _LAST]]


def t15_bytes(units: IntArray, sewn: IntArray, changes: set[int]) -> bytes:
    """Return the bytes of a card.

    Parameters
    ----------
    units
        (n, 2) displacements in units of 0.1 mm, Y up.
    sewn
        (n,) 1 if the displacement ends in a stitch, 0 if the needle is up.
    changes
        Indices of the displacements after a thread change or cut; n stands for the end.

    Raises
    ------
    ValueError
        If a stitch is too long for a record.
    """
    records = [_record(MOVE, 0, 0)] * _BLANKS[0]
    down = False

    def needle(wanted: bool) -> None:
        nonlocal down
        if wanted != down:
            pair = (OUTER, INNER) if wanted else (INNER, OUTER)
            records.extend(_record(function, 0, 0) for function in pair)
            down = wanted

    for k, (way, stitch) in enumerate(zip(units.tolist(), sewn.tolist(), strict=True)):
        if k in changes:
            needle(False)
            records.append(_record(CHANGE, 0, 0))
        # The needle is up on the way to the first stitch of a stretch, which is in place.
        begins = bool(stitch) and not down
        if not stitch:
            needle(False)
        parts = max(1, -(-max(map(abs, way)) // MOST)) if begins or not stitch else 1
        if not begins or way != [0, 0]:
            done = np.rint(np.outer(np.arange(parts + 1) / parts, way)).astype(int)
            records += [_record(MOVE, dx, dy) for dx, dy in np.diff(done, axis=0).tolist()]
        needle(bool(stitch))
    needle(False)
    if len(units) in changes:
        records.append(_record(CHANGE, 0, 0))
    records += [_record(MOVE, 0, 0)] * _BLANKS[1]
    body = bytes(LEADER) + b"".join(records) + bytes([END, 0, 0, 0])
    body += bytes(-(HEADER + len(body)) % HEADER)
    return struct.pack("<3I", (HEADER + len(body)) // HEADER, _KIND, 0) + body


def _digits(units: int, sevens: int, top: int) -> int:
    return _DIGITS[units & 7] + 7 * _DIGITS[sevens & 7] + 49 * _DIGITS[top & 7]


def _record(function: int, dx: int, dy: int) -> bytes:
    (x0, x1, x2), (y0, y1, y2) = _holes(dx), _holes(dy)
    return bytes([function, x0 | x1 << 3, x2 | y0 << 3, y1 | y2 << 3])


def _holes(way: int) -> tuple[int, int, int]:
    """Return the holes for the base-7 digits (-3 to 3) of a displacement, lowest digit first."""
    if abs(way) > MOST:
        raise ValueError(f"a way of {way} units: a record holds {MOST}")
    found = []
    for _ in range(3):
        digit = (way + 3) % 7 - 3
        found.append(_HOLES[digit])
        way = (way - digit) // 7
    return found[0], found[1], found[2]


def _refused(place: Place, why: str) -> JobError:
    return JobError(
        f"the file is no T15 card that is understood: {why}",
        place=place,
        remedy="Export it again, or as DST.",
    )
