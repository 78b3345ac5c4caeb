"""Brother's PES and PEC: the PEC block of a design, which every version of the format has.

A PES file has a signature (``#PES0001`` to ``#PES0100``), the offset of its PEC block, and the
source drawing of the stitches, which this reader ignores. A PEC file has the signature ``#PEC0001``
and the block. The block has these parts, by byte offset:

* 0: ``LA:`` and a name; 48: the number of colour changes (255: no colour), then a palette index for
  each colour;
* 514: the length of the stitches from byte 512, in 3 bytes; 520: width, height and two constants;
* 528: the records. Each record has X (to the right) and Y (down), in 0.1 mm. A value has one byte
  with 7 bits, or two bytes with 12 bits; the first of two bytes has the bit 0x80, the flags 0x20
  (trim) and 0x10 (jump), and the upper 4 bits. ``FE B0`` and a byte change the thread, ``FF`` ends
  the design.

Brother's software, and writers that follow it, begin with a jump from the upper left corner of the
design to its first place. pyembroidery 1.5 and later begins with the first stitch. A jump from the
corner does not belong to the design and is left out: the design begins at its first place.
"""

from __future__ import annotations

from threadline.errors import JobError, Place

_PEC = b"#PEC0001"
_OFFSET = slice(8, 12)
_COLOURS, _RECORDS = 48, 528
_LONG, _BEYOND, _TRIM_FLAG, _JUMP_FLAG = 0x80, 0x40, 0x20, 0x10
_CHANGE, _END = b"\xfe\xb0", 0xFF
_STITCH, _JUMP, _TRIM, _STOP, _LAST, _COLOUR = 0, 1, 2, 3, 4, 5
_ROUNDED = 1
"""Rounding differences of writers at the corner of a design, in units of 0.1 mm."""


def read_pes(content: bytes, place: Place) -> list[list[float]]:
    """Return x and y (down) in 0.1 mm and act of every record, like the readers of pystitch.

    A change to the same colour is a stop.

    Raises
    ------
    JobError
        If the file is no PES, is cut off, or has invalid records; the error gives the byte.
    """
    block = _block(content, place)
    rows = _records(content, block + _RECORDS, place)
    changes, palette = content[block + _COLOURS], content[block + _COLOURS + 1 :]
    colour = 0
    for row in rows:
        if row[2] == _COLOUR:
            colour += 1
            if colour <= changes < 0xFF and palette[colour] == palette[colour - 1]:
                row[2] = _STOP
    return _from_first_place(rows)


def palette_indices(content: bytes, place: Place) -> list[int]:
    """Return the index into Brother's palette for each thread, in the order of the design.

    Raises
    ------
    JobError
        If the file is no PES or is cut off.
    """
    block = _block(content, place)
    changes = content[block + _COLOURS]
    first = block + _COLOURS + 1
    return [] if changes == 0xFF else list(content[first : first + changes + 1])


def _block(content: bytes, place: Place) -> int:
    """Return the offset of the PEC block."""
    if content[:8] == _PEC:
        block = 8
    elif content[:4] != b"#PES":
        raise _refused(place, "it does not begin with #PES")
    elif len(content) < _OFFSET.stop:
        raise _refused(place, f"it is cut off at byte {len(content)}, in its header")
    else:
        block = int.from_bytes(content[_OFFSET], "little")
    if len(content) < block + _RECORDS:
        raise _refused(
            place,
            f"it is cut off at byte {len(content)}: its stitches begin at byte {block + _RECORDS}",
        )
    if content[block : block + 3] != b"LA:":
        raise _refused(place, f"no PEC block begins at byte {block}, where its header says")
    return block


def _records(content: bytes, at: int, place: Place) -> list[list[float]]:
    """Return the records from byte ``at``, with the end of the design."""
    rows: list[list[float]] = []
    x = y = 0
    while True:
        if at >= len(content):
            raise _refused(place, f"its records are cut off at byte {len(content)}")
        if content[at] == _END:
            return [*rows, [x, y, _LAST]]
        if content[at : at + 2] == _CHANGE:
            if at + 3 > len(content):
                raise _refused(place, f"its records are cut off at byte {len(content)}")
            rows.append([x, y, _COLOUR])
            at += 3
            continue
        dx, flags_x, at = _number(content, at, place)
        dy, flags_y, at = _number(content, at, place)
        flags = flags_x | flags_y
        if flags & _TRIM_FLAG and not flags & _JUMP_FLAG:
            rows.append([x, y, _TRIM])
        x, y = x + dx, y + dy
        rows.append([x, y, _JUMP if flags & (_TRIM_FLAG | _JUMP_FLAG) else _STITCH])


def _number(content: bytes, at: int, place: Place) -> tuple[int, int, int]:
    """Return the displacement at byte ``at``, its flags, and the offset of the next byte."""
    long = at < len(content) and content[at] & _LONG
    if at + (2 if long else 1) > len(content):
        raise _refused(place, f"its records are cut off at byte {len(content)}")
    first = content[at]
    if not long:
        return (first ^ 0x40) - 0x40, 0, at + 1
    if first & _BEYOND:
        raise _refused(place, f"the byte {first:#04x} at {at} begins no record")
    units = (first & 0x0F) << 8 | content[at + 1]
    return (units ^ 0x800) - 0x800, first & (_TRIM_FLAG | _JUMP_FLAG), at + 2


def _from_first_place(rows: list[list[float]]) -> list[list[float]]:
    """Return the records without a first jump from the corner of the design to its first place."""
    if rows[0][2] != _JUMP:
        return rows
    x, y, _ = rows[0]
    shifted_rows = [[at_x - x, at_y - y, act] for at_x, at_y, act in rows[1:]]
    sewn = [row for row in shifted_rows if row[2] == _STITCH]
    for tested_rows in (shifted_rows, sewn):
        left = min((row[0] for row in tested_rows), default=0)
        top = min((row[1] for row in tested_rows), default=0)
        if abs(x + left) <= _ROUNDED and abs(y + top) <= _ROUNDED:
            return shifted_rows
    return rows


def _refused(place: Place, why: str) -> JobError:
    return JobError(
        f"the file cannot be read as PES: {why}",
        place=place,
        remedy="It is damaged, or its name has the ending of another format; export it again.",
    )
