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
    x, y, offset, sewing, last_function = 0, 0, FIRST, False, 0
    rows: list[list[float]] = []
    while True:
        if offset + RECORD > len(content):
            raise _refused(place, f"it ends at {offset:#x} without the record of its end")
        function = content[offset]
        holes = content[offset + 1 : offset + RECORD]
        if function == END:
            break
        for k, byte in enumerate(holes):
            if byte & 0xC0 or byte & 7 == 7 or byte >> 3 & 7 == 7:
                raise _refused(
                    place, f"the byte {byte:#04x} at {offset + 1 + k:#x} is no displacement"
                )
        first, second, third = holes
        dx = _digits(first, first >> 3, second)
        dy = _digits(second >> 3, third, third >> 3)
        x, y = x + dx, y + dy
        if function == MOVE:
            if sewing or dx or dy:
                rows.append([x, -y, _STITCH if sewing else _JUMP])
        elif function == CHANGE:
            rows.append([x, -y, _COLOUR])
        elif function in {OUTER, INNER}:
            if dx or dy:
                raise _refused(place, f"the function {function:#04x} at {offset:#x} moves")
            if last_function in {OUTER, INNER} and last_function != function:
                if sewing != (function == OUTER):
                    raise _refused(
                        place, f"the function {function:#04x} at {offset:#x} is out of turn"
                    )
                sewing = not sewing
                if sewing:
                    rows.append([x, -y, _STITCH])
                function = 0
        else:
            raise _refused(place, f"the function {function:#04x} at {offset:#x} is not known")
        last_function = function
        offset += RECORD
    rest = content[offset + 1 :]
    if any(rest):
        wrong_offset = offset + 1 + next(k for k, byte in enumerate(rest) if byte)
        raise _refused(
            place,
            f"the byte {content[wrong_offset]:#04x} at {wrong_offset:#x} stands behind its end",
        )
    # A change after the last stitch only cuts the thread.
    sewn = [k for k, row in enumerate(rows) if row[2] == _STITCH]
    for row in rows[sewn[-1] :] if sewn else ():
        if row[2] == _COLOUR:
            row[2] = _TRIM
    return [*rows, [x, -y, _LAST]]


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

    def needle(is_down_next: bool) -> None:
        nonlocal down
        if is_down_next != down:
            pair = (OUTER, INNER) if is_down_next else (INNER, OUTER)
            records.extend(_record(function, 0, 0) for function in pair)
            down = is_down_next

    for k, (step, stitch) in enumerate(zip(units.tolist(), sewn.tolist(), strict=True)):
        if k in changes:
            needle(False)
            records.append(_record(CHANGE, 0, 0))
        # The needle is up on the way to the first stitch of a stretch, which is in place.
        begins_stretch = bool(stitch) and not down
        if not stitch:
            needle(False)
        parts = max(1, -(-max(map(abs, step)) // MOST)) if begins_stretch or not stitch else 1
        if not begins_stretch or step != [0, 0]:
            places = np.rint(np.outer(np.arange(parts + 1) / parts, step)).astype(int)
            records += [_record(MOVE, dx, dy) for dx, dy in np.diff(places, axis=0).tolist()]
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


def _holes(units: int) -> tuple[int, int, int]:
    """Return the holes for the base-7 digits (-3 to 3) of a displacement, lowest digit first."""
    if abs(units) > MOST:
        raise ValueError(f"a way of {units} units: a record holds {MOST}")
    digits = []
    for _ in range(3):
        digit = (units + 3) % 7 - 3
        digits.append(_HOLES[digit])
        units = (units - digit) // 7
    return digits[0], digits[1], digits[2]


def _refused(place: Place, why: str) -> JobError:
    return JobError(
        f"the file is no T15 card that is understood: {why}",
        place=place,
        remedy="Export it again, or as DST.",
    )
