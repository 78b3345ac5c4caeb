"""Husqvarna's VP3: nested blocks, each with its length; one block for each colour of the design.

The reader skips the parts before the stitches by their lengths, and keeps the centre of the design.
A colour block has its start position relative to the centre, and records of two signed bytes: X to
the right and Y down, in 0.1 mm. ``80 01``, two numbers of 16 bits and two bytes without known
effect make a long stitch; ``80 02`` alone has no effect, and ``80 03`` is a trim. VP3 has no jumps:
the frame travels from the end of a block to the start of the next block.
"""

from __future__ import annotations

from threadline.errors import JobError, Place

_MAGIC = b"%vsm%\x00"
_PER_UNIT = 100
"""Steps per 0.1 mm in the centre and the start positions of blocks."""
_STITCH, _JUMP, _TRIM, _LAST, _COLOUR = 0, 1, 2, 4, 5
_ESCAPE, _LONG, _BEHIND_LONG, _CUT = 0x80, 1, 2, 3


class _Bytes:
    """The bytes of a file with a reading position."""

    def __init__(self, content: bytes, place: Place) -> None:
        self._content = content
        self._place = place
        self.at = 0

    def take(self, size: int) -> bytes:
        """Return the next ``size`` bytes.

        Raises
        ------
        JobError
            If the file has fewer bytes left.
        """
        part = self._content[self.at : self.at + size]
        if len(part) < size:
            raise self.refused(f"it is cut off at byte {len(self._content)}")
        self.at += size
        return part

    def number(self, size: int) -> int:
        """Return the next signed number of ``size`` bytes."""
        return int.from_bytes(self.take(size), "big", signed=True)

    def text(self) -> str:
        """Return a text, which begins with its number of bytes."""
        return self.take(int.from_bytes(self.take(2), "big")).decode("latin-1")

    def refused(self, why: str) -> JobError:
        """Return the error for a file that is no VP3."""
        return JobError(
            f"the file cannot be read as VP3: {why}",
            place=self._place,
            remedy="It is damaged, or its name has the ending of another format; export it again.",
        )


def read_vp3(content: bytes, place: Place) -> list[list[float]]:
    """Return x and y (down) in 0.1 mm and act of every record, like the readers of pystitch.

    Raises
    ------
    JobError
        If the file is no VP3, is cut off, or has invalid records; the error gives the byte.
    """
    source = _Bytes(content, place)
    centre, blocks = _header(source)
    rows: list[list[float]] = []
    for block in range(blocks):
        if block:
            rows.append([*rows[-1][:2], _COLOUR] if rows else [0.0, 0.0, _COLOUR])
        _colour_block(source, centre, rows)
    return [*rows, [*rows[-1][:2], _LAST]] if rows else [[0.0, 0.0, _LAST]]


def read_threads(content: bytes, place: Place) -> list[tuple[bytes, str]]:
    """Return red, green and blue of each colour block, and the name of its thread.

    Raises
    ------
    JobError
        If the file is no VP3 or is cut off.
    """
    source = _Bytes(content, place)
    _, blocks = _header(source)
    threads = []
    for _ in range(blocks):
        source.take(3)
        size = source.number(4)
        end = source.at + size
        source.take(8)
        threads.append(_thread(source))
        source.take(end - source.at)
    return threads


def _header(source: _Bytes) -> tuple[tuple[float, float], int]:
    """Skip the parts before the colour blocks; return the centre and the number of blocks."""
    if source.take(len(_MAGIC)) != _MAGIC:
        raise source.refused("it does not begin with %vsm%")
    source.text()
    source.take(7)
    source.text()
    source.take(32)
    centre = source.number(4) / _PER_UNIT, -source.number(4) / _PER_UNIT
    source.take(27)
    source.text()
    source.take(24)
    source.text()
    return centre, int.from_bytes(source.take(2), "big")


def _thread(source: _Bytes) -> tuple[bytes, str]:
    """Return the last colour of a block's thread, as pystitch does, and its name."""
    colours = source.take(2)[0]
    colour = bytes(3)
    for _ in range(colours):
        colour = source.take(6)[:3]
    source.take(2)
    source.text()
    name = source.text()
    source.text()
    return colour, name


def _colour_block(source: _Bytes, centre: tuple[float, float], rows: list[list[float]]) -> None:
    """Append the records of a colour block to ``rows``."""
    source.take(3)
    size = source.number(4)
    end = source.at + size
    x = source.number(4) / _PER_UNIT + centre[0]
    y = -source.number(4) / _PER_UNIT + centre[1]
    if [x, y] != (rows[-1][:2] if rows else [0.0, 0.0]):
        rows.append([x, y, _JUMP])
    _thread(source)
    source.take(18)
    if end < source.at:
        raise source.refused(f"its block of {size} bytes ends before its stitches")
    records = source.take(end - source.at)
    begin, index = end - len(records), 0
    while index + 1 < len(records):
        dx, dy = records[index], records[index + 1]
        index += 2
        if dx != _ESCAPE:
            x, y = x + (dx ^ 0x80) - 0x80, y + (dy ^ 0x80) - 0x80
            rows.append([x, y, _STITCH])
        elif dy == _LONG:
            if index + 4 > len(records):
                raise source.refused(f"the long stitch at byte {begin + index - 2} is not whole")
            x += int.from_bytes(records[index : index + 2], "big", signed=True)
            y += int.from_bytes(records[index + 2 : index + 4], "big", signed=True)
            rows.append([x, y, _STITCH])
            index += 6
        elif dy == _CUT:
            rows.append([x, y, _TRIM])
        elif dy != _BEHIND_LONG:
            raise source.refused(f"the bytes 0x80 {dy:#04x} at {begin + index - 2} are no record")
