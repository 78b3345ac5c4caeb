"""The programs open while a part program is followed, and the text kept for their loops."""

from __future__ import annotations

from dataclasses import dataclass

from threadline.jobs.gcode.block import Block, parse_block
from threadline.jobs.gcode.dialects import Reading
from threadline.jobs.gcode.scan import TAPE
from threadline.jobs.gcode.subprograms import Program
from threadline.jobs.gcode.textfile import Chunk, Lines, SourceFile

_KEPT_BYTES = 1 << 21
_KEPT_BLOCKS = 10_000


@dataclass(slots=True)
class Frame:
    """A program that is open: which pass of how many, and where it has been read to."""

    program: Program
    lines: Lines
    pass_: int
    passes: int
    calls: int = 1  # how many times the call that began it stands for
    line: int = 0  # of the call in the main program
    folded: int = 1  # how many passes the present one stands for
    start: tuple[int, ...] = ()  # exact position and offset where the pass that is folded begins

    @property
    def times(self) -> int:
        """How many times an operation of the present pass happens."""
        return self.calls * self.folded

    def fold_rest(self, start: tuple[int, ...]) -> None:
        """Let the pass that begins at ``start`` stand for all that are left."""
        self.folded = self.passes - self.pass_ + 1
        self.pass_ = self.passes
        self.start = start


class KeptText:
    """The lines of programs; short ones, and the blocks of loops, are kept in memory.

    Parameters
    ----------
    file, reading
        Where they are read from, and against what.
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
