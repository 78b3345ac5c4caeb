"""HUS designs: three packed columns (command, X, Y), each with one byte per record.

The columns are packed as in LHA's dynamic Huffman methods: blocks of at most 65 535 symbols, each
block with its own code lengths. A symbol below 256 is a byte, 510 ends the column, and any other
symbol copies bytes that are already unpacked. The layout comes from pystitch, whose reader can
allocate gigabytes for a damaged file; tests compare this reader with the reader of pystitch.

======  =====================================================
offset  content
======  =====================================================
0       u32 LE with the upper half 0x00C8
4       u32 number of records
8       u32 number of colours
20      three u32 offsets: columns command, X and Y
======  =====================================================
"""

from __future__ import annotations

import struct

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError, Place

MOST_RECORDS = 10_000_000
_MAGIC = 0xC8
_HEADER = struct.Struct("<3I8x3I")
_STITCH, _JUMP, _COLOUR, _TRIM, _END = 0x80, 0x81, 0x84, 0x88, 0x90
_ACTS = {_STITCH: 0, _JUMP: 1, _COLOUR: 5, _TRIM: 2, _END: 4}  # numbers of the acts in pystitch
_LONGEST_CODE = 16
_END_OF_COLUMN = 510
_SHORTEST_COPY = 253  # copy length = symbol - this number


def read_hus(content: bytes, place: Place) -> FloatArray:
    """Return the (n, 3) records: x, y (down) in units of the format, and act.

    Raises
    ------
    JobError
        If the file is no HUS file, is cut off, or has an unknown command.
    """
    if len(content) < _HEADER.size:
        raise _damaged(f"it has {len(content)} bytes", place)
    magic, count, _, *offsets = _HEADER.unpack_from(content)
    if magic >> 16 != _MAGIC:
        raise _damaged(f"it begins with {magic:#010x}", place)
    if not 0 < count <= MOST_RECORDS:
        raise _damaged(f"it says that it has {count} records, at most {MOST_RECORDS}", place)
    ends = [*offsets[1:], len(content)]
    columns = []
    for column_name, begin, end in zip(("command", "X", "Y"), offsets, ends, strict=True):
        if not _HEADER.size <= begin < end <= len(content):
            raise _damaged(f"its column {column_name} is from {begin} to {end}", place)
        try:
            unpacked = _Unpacker(content[begin:end]).unpack(count)
        except ValueError as error:
            raise _damaged(f"column {column_name}: {error}", place) from error
        if len(unpacked) < count:
            raise _damaged(f"column {column_name} has {len(unpacked)} of {count} records", place)
        columns.append(np.frombuffer(bytes(unpacked[:count]), dtype=np.uint8))
    acts = columns[0]
    end_records = np.flatnonzero(acts == _END)
    last = int(end_records[0]) + 1 if len(end_records) else count
    unknown = np.flatnonzero(~np.isin(acts[:last], list(_ACTS)))
    if len(unknown):
        record = int(unknown[0])
        raise _damaged(f"record {record + 1} is the unknown command {acts[record]:#04x}", place)
    steps = np.stack(columns[1:], axis=1).view(np.int8)[:last].astype(np.float64)
    numbers = np.array([_ACTS.get(code, 0) for code in range(256)])
    table = np.empty((last, 3))
    table[:, :2] = np.cumsum(steps, axis=0)
    table[:, 1] *= -1.0  # the file has Y up
    table[:, 2] = numbers[acts[:last]]
    return table


def _damaged(why: str, place: Place) -> JobError:
    return JobError(
        f"the file cannot be read as HUS: {why}",
        place=place,
        remedy="It is damaged, or its name has the ending of another format; export it again.",
    )


class _Code:
    """A Huffman code from its lengths; without lengths, ``always`` is the only symbol (0 bits)."""

    def __init__(self, lengths: list[int], always: int = 0) -> None:
        self.lengths, self.always = lengths, always
        self.width = max(lengths, default=0)
        if self.width > _LONGEST_CODE:
            raise ValueError(f"a code of {self.width} bits, at most {_LONGEST_CODE} are possible")
        self.symbols: list[int] = []
        for width in range(1, self.width + 1):
            span = 1 << (self.width - width)
            for symbol, length in enumerate(lengths):
                if length == width:
                    self.symbols += [symbol] * span
        if len(self.symbols) > 1 << self.width:
            raise ValueError("more codes than their lengths allow")


class _Unpacker:
    """A packed column with the position of the next bit; zeros follow the end of the column."""

    def __init__(self, packed: bytes) -> None:
        self.data, self.bits, self.at = packed + bytes(4), 8 * len(packed), 0

    def peek(self) -> int:
        """Return the next 16 bits."""
        byte = self.at >> 3
        three = int.from_bytes(self.data[byte : byte + 3], "big")
        return three >> (8 - (self.at & 7)) & 0xFFFF

    def take(self, count: int) -> int:
        """Return the next ``count`` bits, at most 16."""
        value = self.peek() >> (16 - count)
        self.at += count
        if self.at > self.bits:
            raise ValueError("it is cut off")
        return value

    def symbol(self, code: _Code) -> int:
        """Return the next symbol of a code."""
        if not code.lengths:
            return code.always
        code_index = self.peek() >> (16 - code.width)
        if code_index >= len(code.symbols):
            raise ValueError("bits that are no code")
        symbol = code.symbols[code_index]
        self.at += code.lengths[symbol]
        if self.at > self.bits:
            raise ValueError("it is cut off")
        return symbol

    def length(self) -> int:
        """Return the next code length: 3 bits; after 7, a 1 for each further bit, then a 0."""
        length = self.take(3)
        while length >= 7 and self.take(1):
            length += 1
            if length > _LONGEST_CODE:
                raise ValueError(f"a code of more than {_LONGEST_CODE} bits")
        return length

    def lengths_code(self) -> _Code:
        """Return the code for the lengths of the symbols."""
        count = self.take(5)
        if count == 0:
            return _Code([], self.take(5))
        lengths: list[int] = []
        while len(lengths) < count:
            if len(lengths) == 3:
                lengths += [0] * self.take(2)
                if len(lengths) >= count:
                    break
            lengths.append(self.length())
        return _Code(lengths[:count])

    def symbols_code(self, of_lengths: _Code) -> _Code:
        """Return the code for bytes and copies."""
        count = self.take(9)
        if count == 0:
            return _Code([], self.take(9))
        lengths: list[int] = []
        while len(lengths) < count:
            short = self.symbol(of_lengths)
            if short == 0:
                lengths.append(0)
            elif short == 1:
                lengths += [0] * (3 + self.take(4))
            elif short == 2:
                lengths += [0] * (20 + self.take(9))
            else:
                lengths.append(short - 2)
        return _Code(lengths[:count])

    def distances_code(self) -> _Code:
        """Return the code for the distances back to the source of a copy."""
        count = self.take(5)
        if count == 0:
            return _Code([], self.take(5))
        return _Code([self.length() for _ in range(count)])

    def unpack(self, most: int) -> bytearray:
        """Return the bytes of the column; stop after ``most`` bytes or at the end of the column.

        Raises
        ------
        ValueError
            If the column is cut off, or its bits are no code.
        """
        out, symbols_left = bytearray(), 0
        symbols = distances = _Code([])
        while len(out) < most:
            if symbols_left == 0:
                if self.at >= self.bits:
                    break
                symbols_left = self.take(16)
                if symbols_left == 0:
                    raise ValueError("a block of no symbols")
                symbols = self.symbols_code(self.lengths_code())
                distances = self.distances_code()
            symbols_left -= 1
            symbol = self.symbol(symbols)
            if symbol < 256:
                out.append(symbol)
                continue
            if symbol == _END_OF_COLUMN:
                break
            exponent = self.symbol(distances)
            back = 1 if exponent == 0 else 1 + (1 << exponent - 1) + self.wide(exponent - 1)
            if back > len(out):
                raise ValueError(f"a copy from {back} bytes back, of {len(out)}")
            length = symbol - _SHORTEST_COPY
            piece = out[-back:]
            out += (piece * (length // back + 1))[:length]
        return out

    def wide(self, count: int) -> int:
        """Return the next ``count`` bits; ``count`` may exceed 16."""
        high = max(0, count - 16)
        return self.take(high) << min(count, 16) | self.take(min(count, 16)) if count else 0
