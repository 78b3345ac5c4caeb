"""Following a part program from block to block: modes, calls, exact positions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NoReturn

from threadline.errors import JobError
from threadline.jobs.blocks import Block, Dialect, parse_block
from threadline.jobs.feeds import FeedRule
from threadline.jobs.operations import (
    NO_TAGS,
    Dwell,
    Feed,
    FeedMode,
    Move,
    Operation,
    Source,
    Stop,
    ToolEvent,
)
from threadline.jobs.programs import Program, Structure
from threadline.jobs.scan import TAPE
from threadline.jobs.textfile import SourceFile, lines_of
from threadline.jobs.words import ONE

_KEPT_BLOCKS = 20_000
_RAPID = Feed(FeedMode.RAPID, 0.0)
_MM_PER_M = 1000 * ONE


@dataclass(frozen=True, slots=True)
class PartProgram:
    """A scanned part program, ready to be followed any number of times."""

    file: SourceFile
    dialect: Dialect
    structure: Structure
    rule: FeedRule

    def blocks(self, program: Program) -> Iterator[Block]:
        """Return the blocks of one program, read from the file."""
        left = program.blocks
        for number, _, text in lines_of(self.file, program.offset, program.line):
            if text.strip() == TAPE:
                continue
            block = parse_block(text, number, self.dialect)
            if block is not None:
                yield block
                left -= 1
                if left == 0:
                    return

    def operations(self) -> Iterator[Operation]:
        """Return the operations from the start position on.

        Raises
        ------
        JobError
            Where a block does not say what it needs to: a feed, or a mode of motion.
        """
        return _Interpreter(self).run()


@dataclass(slots=True)
class _Frame:
    program: Program
    blocks: Iterator[Block]
    pass_: int
    passes: int


class _Interpreter:
    """The state of one reading. Positions are exact: 10**-18 mm or degrees."""

    def __init__(self, program: PartProgram) -> None:
        self._program = program
        self._rule = program.rule
        self._path = program.file.path
        count = len(program.rule.linear)
        self._exact = [0] * count
        self._position = [0.0] * count
        self._linear = program.rule.linear
        self._motion = -1
        self._relative = False
        self._tenth_mm = 10  # tenths of a millimetre in the unit of length
        self._inverse_time = False
        self._feed: Feed | None = None
        self._kept: dict[int | None, tuple[Block, ...]] = {}
        self._kept_blocks = 0
        self._passes: tuple[int, ...] = ()

    def run(self) -> Iterator[Operation]:
        structure = self._program.structure
        frames = [_Frame(structure.main, self._blocks(structure.main), 1, 1)]
        while frames:
            frame = frames[-1]
            for block in frame.blocks:
                yield from self._step(block)
                if block.program == 98:
                    assert block.p is not None
                    callee = structure.programs[block.p // ONE]
                    frames.append(
                        _Frame(callee, self._blocks(callee), 1, self._turns(callee, block))
                    )
                    self._passes = (*self._passes, 1)
                    break
                if block.program in (2, 30):
                    return
            else:
                if frame.pass_ < frame.passes:
                    frame.pass_ += 1
                    frame.blocks = self._blocks(frame.program)
                    self._passes = (*self._passes[:-1], frame.pass_)
                else:
                    frames.pop()
                    self._passes = self._passes[:-1]

    def _turns(self, callee: Program, block: Block) -> int:
        """Return the passes; a body that only sets modes sets the same in every pass."""
        totals = self._program.structure.totals[callee.label]
        return block.passes if totals.moves or totals.others else 1

    def _blocks(self, program: Program) -> Iterator[Block]:
        kept = self._kept.get(program.label)
        if kept is not None:
            return iter(kept)
        blocks = self._program.blocks(program)
        if self._kept_blocks + program.blocks <= _KEPT_BLOCKS:
            self._kept_blocks += program.blocks
            kept = tuple(blocks)
            self._kept[program.label] = kept
            return iter(kept)
        return blocks

    def _step(self, block: Block) -> Iterable[Operation]:
        """Return the operations of one block, in the order of RS274/NGC."""
        if block.settings:
            self._set(block.settings)
        if block.feed is not None:
            self._feed = self._read_feed(block.feed)
        if block.motion >= 0:
            self._motion = block.motion
        if block.action == -1 and block.program in (-1, 98, 99) and not block.tool_off:
            return (self._move(block),) if block.axes else ()
        return self._step_with_actions(block)

    def _step_with_actions(self, block: Block) -> Iterator[Operation]:
        source = Source(self._path, block.line, self._passes)
        if block.action == 28:
            yield from self._return_to_start(block, source)
        elif block.action == 4:
            assert block.p is not None
            yield Dwell(block.p / ONE, source)
        elif block.axes:
            yield self._move(block)
        if block.tool_off:
            yield ToolEvent("spindle", 0.0, source)
        if block.program in (0, 2, 30):
            yield Stop(block.program != 0, source)

    def _set(self, settings: tuple[int, ...]) -> None:
        for code in settings:
            if code in (90, 91):
                self._relative = code == 91
            elif code in (20, 21):
                self._tenth_mm = 254 if code == 20 else 10
            elif code in (93, 94) and self._inverse_time != (code == 93):
                # A number that was a speed is no inverse of a time.
                self._inverse_time = code == 93
                self._feed = None

    def _read_feed(self, exact: int) -> Feed:
        if self._inverse_time:
            return Feed(FeedMode.INVERSE_TIME, exact / (60 * ONE))
        metres_per_s = exact * self._tenth_mm / (10 * 60 * _MM_PER_M)
        return Feed(self._rule.mode, metres_per_s, self._rule.base_names)

    def _go(self, block: Block) -> list[float]:
        """Take the axis words of ``block``; return the differences, (axes,) m or rad."""
        difference = [0.0] * len(self._position)
        for index, value in block.axes:
            linear = self._linear[index]
            target = value * self._tenth_mm // 10 if linear else value
            if self._relative:
                target += self._exact[index]
            self._exact[index] = target
            si = target / _MM_PER_M if linear else math.radians(target / ONE)
            difference[index] = si - self._position[index]
            self._position[index] = si
        return difference

    def _move(self, block: Block) -> Move:
        place_line = block.line
        if self._motion == -1:
            self._refuse(place_line, "axis words before any G0 or G1", "Write G1 and a feed first.")
        difference = self._go(block)
        feed: Feed | None
        if self._motion == 0:
            feed = _RAPID
        elif self._inverse_time:
            if block.feed is None:
                self._refuse(
                    place_line,
                    "in G93 every G1 block needs its own F",
                    "Give F as 1 / minutes of the move.",
                )
            feed = self._feed
        elif self._feed is None:
            self._refuse(place_line, "G1 moves before any feed F", "Give F in mm/min.")
        else:
            feed = self._rule.capped(self._feed, difference, self._program.file.place(place_line))
        tags = dict(block.tags) if block.tags else NO_TAGS
        source = Source(self._path, place_line, self._passes)
        return Move(tuple(self._position), feed, source, tags)

    def _return_to_start(self, block: Block, source: Source) -> Iterator[Operation]:
        if block.axes:
            self._go(block)
            yield Move(tuple(self._position), _RAPID, source)
        for index in [i for i, _ in block.axes] or range(len(self._exact)):
            self._exact[index] = 0
            self._position[index] = 0.0
        yield Move(tuple(self._position), _RAPID, source)

    def _refuse(self, line: int, message: str, remedy: str) -> NoReturn:
        raise JobError(message, place=self._program.file.place(line), remedy=remedy)
