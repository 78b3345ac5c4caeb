"""The programs that are open while a part program is read, and the text kept for their loops."""

from __future__ import annotations

from dataclasses import dataclass

from threadline.jobs.gcode.block import Block, parse_block
from threadline.jobs.gcode.dialects import Reading
from threadline.jobs.gcode.subprograms import Program
from threadline.jobs.gcode.tapes import TAPE
from threadline.jobs.gcode.textfile import Chunk, Lines, SourceFile

_KEPT_BYTES = 1 << 21
_KEPT_BLOCKS = 10_000


@dataclass(slots=True)
class Frame:
    """A program that is open: its pass, the number of its passes, and its next line."""

    program: Program
    lines: Lines
    pass_: int
    passes: int
    calls: int = 1  # number of times that its call happens
    line: int = 0  # line of the call in the main program
    folded: int = 1  # number of passes for which the present one stands
    start: tuple[int, ...] = ()  # exact position and offset at the beginning of the folded pass

    @property
    def times(self) -> int:
        """Number of times that an operation of the present pass happens."""
        return self.calls * self.folded

    def fold_rest(self, start: tuple[int, ...]) -> None:
        """Let the pass that begins at ``start`` stand for itself and all passes after it."""
        self.folded = self.passes - self.pass_ + 1
        self.pass_ = self.passes
        self.start = start


class KeptText:
    """The lines of programs; short ones, and the blocks of loops, are kept in memory.

    Parameters
    ----------
    file, reading
        The file, and the axes and dialect by which its blocks are read.
    """

    def __init__(self, file: SourceFile, reading: Reading) -> None:
        self._file = file
        self._reading = reading
        self._kept: dict[int | None, Chunk] = {}
        self._kept_bytes = 0
        self._parsed: dict[int, Block | None] = {}

    def lines_of(self, program: Program) -> Lines:
        """Return the lines of a program."""
        size = program.end - program.offset
        kept = self._kept.get(program.label)
        if kept is None and self._kept_bytes + size <= _KEPT_BYTES:
            chunks = self._file.chunks(program.offset, max(size, 1), program.end)
            kept = Chunk(program.offset, b"".join(chunk.data for chunk in chunks))
            self._kept[program.label] = kept
            self._kept_bytes += size
        return Lines(self._file, program.offset, program.line, kept)

    def next_block(self, lines: Lines, looping: bool) -> Block | None:
        """Return the block on the next line, None if it has none.

        Raises
        ------
        JobError
            If it is no block of the dialect.
        """
        offset = lines.offset
        if looping and offset in self._parsed:
            lines.skip()
            return self._parsed[offset]
        number, _, text = lines.take()
        block = None
        if text.strip() != TAPE:
            block = parse_block(text, number, self._reading)
        if looping and len(self._parsed) < _KEPT_BLOCKS:
            self._parsed[offset] = block
        return block
