"""Following a part program from block to block: modes, calls, exact positions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import JobError
from threadline.jobs.gcode import plain_blocks as kernel
from threadline.jobs.gcode.block import Block, Dialect, parse_block
from threadline.jobs.gcode.f_words import FRule
from threadline.jobs.gcode.plain_blocks import PlainReader
from threadline.jobs.gcode.programs import Program, Structure
from threadline.jobs.gcode.scan import TAPE
from threadline.jobs.gcode.textfile import Chunk, Lines, SourceFile
from threadline.jobs.gcode.words import ONE
from threadline.jobs.operations import (
    NO_TAGS,
    Dwell,
    Feed,
    FeedMode,
    Move,
    MoveRun,
    Operation,
    Source,
    Stop,
    ToolEvent,
)

_KEPT_BYTES = 1 << 21
_KEPT_BLOCKS = 10_000
_KEPT_FEEDS = 1000
_STEADY_PASS = 3
_RAPID = Feed(FeedMode.RAPID, 0.0)
_MM_PER_M = 1000 * ONE
_FINE = ONE // kernel.STEPS
_LENGTHS = "XYZUVW"
_MILLIMETRE = 10  # tenths of a millimetre


@dataclass(frozen=True, slots=True)
class PartProgram:
    """A scanned part program, ready to be followed any number of times.

    Parameters
    ----------
    linear
        (axes,) whether an axis is linear.
    rule
        What F means in G94.
    """

    file: SourceFile
    dialect: Dialect
    structure: Structure
    linear: tuple[bool, ...]
    rule: FRule

    def runs(self) -> Iterator[Operation | MoveRun]:
        """Return the operations from the start position on, moves in runs.

        Raises
        ------
        JobError
            Where a block does not say what it needs to: a feed, or a mode of motion.
        """
        return (item for item, _, _ in Interpreter(self).run())

    def folded(self) -> Iterator[tuple[Operation | MoveRun, int, int]]:
        """Return the operations with passes that repeat each other given once.

        From its third pass on a subroutine makes the same moves in every pass: the first has set
        every mode that it sets, and the second, in these modes, has placed every axis that it
        places absolutely. So three passes stand for all.

        Returns
        -------
        iterator
            Of an operation or a run, how many times it happens, and the line of the call in the
            main program that it comes from (0 for the main program's own). A move that happens
            0 times says where the passes that were left out end.

        Raises
        ------
        JobError
            As ``runs`` does.
        """
        return Interpreter(self, fold=True).run()


@dataclass(slots=True)
class _Frame:
    program: Program
    lines: Lines
    pass_: int
    passes: int
    calls: int = 1  # how many times the call that began it stands for
    line: int = 0  # of the call in the main program
    folded: int = 1  # how many passes the present one stands for
    start: tuple[int, ...] = ()  # the exact position where the pass that is folded begins

    @property
    def times(self) -> int:
        """How many times an operation of the present pass happens."""
        return self.calls * self.folded

    def fold_rest(self, position: tuple[int, ...]) -> None:
        """Let the pass that begins at ``position`` stand for all that are left."""
        self.folded = self.passes - self.pass_ + 1
        self.pass_ = self.passes
        self.start = position


class Interpreter:
    """The state of one reading. Positions are exact: 10**-18 mm or degrees.

    Parameters
    ----------
    program
        What is read.
    fold
        Whether the third pass of a subroutine stands for all that follow.
    """

    def __init__(self, program: PartProgram, fold: bool = False) -> None:
        self._program = program
        self._fold = fold
        self._path = program.file.path
        self._linear = program.linear
        self._exact = [0] * len(program.linear)
        self._position = [0.0] * len(program.linear)
        self._motion = -1
        self._relative = False
        self._tenth_mm = 10  # tenths of a millimetre in the unit of length
        self._feed_tenth_mm = 10  # and in that in which the feed was given
        axes = enumerate(program.dialect.axes)
        self._lengths = [index for index, name in axes if name in _LENGTHS]
        self._inverse_time = False
        self._feed: Feed | None = None
        self._passes: tuple[int, ...] = ()
        self._plain = PlainReader(program.dialect.axes, program.linear, follow=True)
        self._kept: dict[int | None, Chunk] = {}
        self._kept_bytes = 0
        self._parsed: dict[int, Block | None] = {}
        self._feeds: dict[tuple[FeedMode, float], Feed] = {}

    def run(self) -> Iterator[tuple[Operation | MoveRun, int, int]]:
        """Return the operations, moves in runs where the kernel has read them.

        With each comes how many times it happens and the line of the main program's call.
        """
        structure = self._program.structure
        frames = [_Frame(structure.main, self._lines(structure.main), 1, 1)]
        while frames:
            frame = frames[-1]
            lines = frame.lines
            if not lines.more():
                raise self._error(lines.number, "the program has no end", "Start again.")
            if self._plain.worth_trying():
                run = self._read_plain(lines)
                if run is not None:
                    yield run, frame.times, frame.line
                    continue
                if not lines.more():
                    continue
            block = self._next(lines)
            if block is None:
                continue
            for operation in self._step(block):
                yield operation, frame.times, frame.line
            if block.program == 98:
                callee = structure.programs[(block.p or 0) // ONE]
                turns = self._turns(callee, block)
                line = frame.line or block.line
                frames.append(_Frame(callee, self._lines(callee), 1, turns, frame.times, line))
                self._passes = (*self._passes, 1)
            elif block.program == 99:
                if frame.folded > 1:
                    self._advance(frame)
                    yield Move(tuple(self._position), _RAPID, self._source(block)), 0, frame.line
                if frame.pass_ < frame.passes:
                    frame.pass_ += 1
                    if self._fold and frame.pass_ == _STEADY_PASS:
                        frame.fold_rest(tuple(self._exact))
                    frame.lines = self._lines(frame.program)
                    self._passes = (*self._passes[:-1], frame.pass_)
                else:
                    frames.pop()
                    self._passes = self._passes[:-1]
            elif block.program in (2, 30):
                return

    def _advance(self, frame: _Frame) -> None:
        """Go where the passes that were folded into one would have led."""
        for index, start in enumerate(frame.start):
            self._put(index, start + frame.folded * (self._exact[index] - start))

    def _put(self, index: int, exact: int) -> None:
        """Let an axis be at an exact position."""
        self._exact[index] = exact
        linear = self._linear[index]
        self._position[index] = exact / _MM_PER_M if linear else math.radians(exact / ONE)

    def _turns(self, callee: Program, block: Block) -> int:
        """Return the passes; a body that only sets modes sets the same in every pass."""
        totals = self._program.structure.totals[callee.label]
        return block.passes if totals.operations else 1

    def _lines(self, program: Program) -> Lines:
        """Return the lines of a program; short ones are kept in memory."""
        size = program.end - program.offset
        kept = self._kept.get(program.label)
        if kept is None and self._kept_bytes + size <= _KEPT_BYTES:
            chunks = self._program.file.chunks(program.offset, max(size, 1), program.end)
            kept = Chunk(program.offset, b"".join(chunk.data for chunk in chunks))
            self._kept[program.label] = kept
            self._kept_bytes += size
        return Lines(self._program.file, program.offset, program.line, kept)

    def _next(self, lines: Lines) -> Block | None:
        """Return the block on the next line, None if it has none; blocks are kept for loops."""
        offset = lines.offset
        if self._passes and offset in self._parsed:
            lines.skip()
            return self._parsed[offset]
        number, _, text = lines.take()
        block = None
        if text.strip() != TAPE:
            block = parse_block(text, number, self._program.dialect)
        if self._passes and len(self._parsed) < _KEPT_BLOCKS:
            self._parsed[offset] = block
        return block

    def _read_plain(self, lines: Lines) -> MoveRun | None:
        """Let the kernel go on; return what it moved."""
        plain = self._plain
        for index, exact in enumerate(self._exact):
            if exact % _FINE or not -kernel.EXACT_LIMIT < exact // _FINE < kernel.EXACT_LIMIT:
                return None  # more digits than the kernel has
            plain.exact[index] = exact // _FINE
        plain.position[:] = self._position
        plain.feed[0] = math.nan if self._feed is None else self._feed.value
        state = plain.state
        state[kernel.MOTION] = self._motion
        state[kernel.RELATIVE] = self._relative
        state[kernel.TENTH_MM] = self._tenth_mm
        state[kernel.INVERSE] = self._inverse_time
        before = tuple(self._position)
        count = plain.read(lines)
        self._motion = int(state[kernel.MOTION])
        self._relative = bool(state[kernel.RELATIVE])
        if count == 0:
            return None
        self._exact = [exact * _FINE for exact in plain.exact.tolist()]
        self._position = plain.position.tolist()
        value = float(plain.feed[0])
        self._feed = None if math.isnan(value) else self._feed_of(value)
        values = self._in_degrees(plain, count, before)
        changes = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist()]
        feeds = tuple(
            (at, _RAPID if value < 0 else self._feed_of(value))
            for at, value in zip(changes, values[changes].tolist(), strict=True)
        )
        targets, line = plain.out_position[:count].copy(), plain.out_line[:count].copy()
        return MoveRun(targets, line, feeds, self._path, self._passes)

    def _in_degrees(self, plain: PlainReader, count: int, before: tuple[float, ...]) -> FloatArray:
        """Return the (count,) feeds of moves just read, those of A B C alone without inches."""
        values = plain.out_feed[:count]
        words = np.flatnonzero(plain.out_word[:count] >= 0)
        unit = np.full(count, self._feed_tenth_mm)
        if len(words):
            unit[words[0] :] = self._feed_tenth_mm = self._tenth_mm
        if self._inverse_time or not self._by_letters or (unit == _MILLIMETRE).all():
            return values
        way = np.diff(plain.out_position[:count], axis=0, prepend=np.array([before]))
        turned = ~way[:, self._lengths].any(axis=1) & (values > 0)
        return np.where(turned, values * _MILLIMETRE / unit, values)

    @property
    def _by_letters(self) -> bool:
        return self._program.rule.mode is FeedMode.IN_TURN

    def _step(self, block: Block) -> Iterator[Operation]:
        """Return the operations of one block, in the order of RS274/NGC."""
        if block.settings:
            self._set(block.settings)
        if block.feed is not None:
            self._feed = self._feed_of(self._speed(block.feed))
            self._feed_tenth_mm = self._tenth_mm
        if block.motion >= 0:
            self._motion = block.motion
        if block.axes and block.action == -1:
            yield self._move(block)
        elif block.action == 28:
            yield from self._return_to_start(block)
        elif block.action == 4:
            yield Dwell((block.p or 0) / ONE, self._source(block))
        if block.tool_off:
            yield ToolEvent("spindle", 0.0, self._source(block))
        if block.program in (0, 2, 30):
            yield Stop(block.program != 0, self._source(block))

    def _source(self, block: Block) -> Source:
        return Source(self._path, block.line, self._passes)

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

    def _speed(self, exact: int) -> float:
        """Return F in m/s, in G93 in 1/s."""
        if self._inverse_time:
            return exact / (60 * ONE)
        return exact * self._tenth_mm / (10 * 60 * _MM_PER_M)

    def _feed_of(self, value: float) -> Feed:
        """Return the feed with ``value`` in the present mode; equal feeds are one object."""
        rule = self._program.rule
        mode = FeedMode.INVERSE_TIME if self._inverse_time else rule.mode
        feed = self._feeds.get((mode, value))
        if feed is None:
            if len(self._feeds) >= _KEPT_FEEDS:
                self._feeds.clear()
            feed = Feed(mode, value, rule.base_axes if mode is FeedMode.BASE_AXES else ())
            self._feeds[mode, value] = feed
        return feed

    def _go(self, block: Block) -> None:
        """Take the axis words of ``block``."""
        for index, value in block.axes:
            linear = self._linear[index]
            target = value * self._tenth_mm // 10 if linear else value
            if self._relative:
                target += self._exact[index]
            self._put(index, target)

    def _move(self, block: Block) -> Move:
        feed = _RAPID if self._motion == 0 else self._feed
        if self._motion == -1:
            raise self._error(
                block.line, "axis words before any G0 or G1", "Write G1 and a feed first."
            )
        if feed is None:
            raise self._error(block.line, "G1 moves before any feed F", "Give F, in mm/min.")
        if feed.mode is FeedMode.INVERSE_TIME and block.feed is None:
            raise self._error(
                block.line,
                "in G93 every G1 block needs its own F",
                "Give F as 1 / minutes of the move.",
            )
        before = tuple(self._exact)
        self._go(block)
        if (
            self._feed_tenth_mm != _MILLIMETRE
            and feed.mode is FeedMode.IN_TURN
            and all(self._exact[index] == before[index] for index in self._lengths)
        ):
            feed = self._feed_of(feed.value * _MILLIMETRE / self._feed_tenth_mm)
        tags = dict(block.tags) if block.tags else NO_TAGS
        return Move(tuple(self._position), feed, self._source(block), tags)

    def _return_to_start(self, block: Block) -> Iterator[Operation]:
        """Return the two moves of G28: by way of the words of the block, then to the start."""
        source = self._source(block)
        if block.axes:
            self._go(block)
            yield Move(tuple(self._position), _RAPID, source)
        for index in [i for i, _ in block.axes] or range(len(self._exact)):
            self._exact[index] = 0
            self._position[index] = 0.0
        yield Move(tuple(self._position), _RAPID, source)

    def _error(self, line: int, message: str, remedy: str) -> JobError:
        return JobError(message, place=self._program.file.place(line), remedy=remedy)
