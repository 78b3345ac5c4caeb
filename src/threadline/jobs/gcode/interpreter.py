"""The interpreter of part programs: modes, calls and exact positions, block by block."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import JobError
from threadline.jobs.gcode import plain_blocks as kernel
from threadline.jobs.gcode.block import Block
from threadline.jobs.gcode.curved_blocks import CURVED, Curves
from threadline.jobs.gcode.dialects import CANCEL, Reading
from threadline.jobs.gcode.f_words import FRule
from threadline.jobs.gcode.frames import Frame, KeptText
from threadline.jobs.gcode.kept_feeds import KeptFeeds, value_of
from threadline.jobs.gcode.plain_reader import PlainReader, plain_reader
from threadline.jobs.gcode.program_zero import Zeros
from threadline.jobs.gcode.subprograms import Structure
from threadline.jobs.gcode.textfile import Lines, SourceFile
from threadline.jobs.gcode.words import ONE
from threadline.jobs.gcode.work_offsets import FIRST, MACHINE, SYSTEMS
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
    Tags,
    ToolEvent,
)

_STEADY_PASS = 3
_RAPID = Feed(FeedMode.RAPID, 0.0)
_MM_PER_M = 1000 * ONE
_FINE = ONE // kernel.STEPS
_LENGTHS = "XYZUVW"
_MILLIMETRE = 10  # tenths of a millimetre
_ANEW = (170, FIRST, 900, 940)  # with G1: what M2 and M30 set (grbl 1.1, gcode.c)


@dataclass(frozen=True, slots=True)
class PartProgram:
    """A scanned part program, which can be read any number of times.

    Parameters
    ----------
    linear
        (axes,) whether an axis is linear.
    rule
        Meaning of F in G94.
    systems
        Zeros of work coordinate systems (``work_offsets``).
    """

    file: SourceFile
    reading: Reading
    structure: Structure
    linear: tuple[bool, ...]
    rule: FRule
    systems: Mapping[int, tuple[int, ...]]

    def runs(self) -> Iterator[Operation | MoveRun]:
        """Return the operations from the start position on, moves in runs.

        Raises
        ------
        JobError
            If a block lacks a feed or a mode of motion.
        """
        return (item for item, _, _ in Interpreter(self).run())

    def folded(self) -> Iterator[tuple[Operation | MoveRun, int, int]]:
        """Return the operations with passes that repeat each other given once.

        From its third pass on a subroutine makes the same moves in every pass: the first has set
        its modes, and the second, in these, has placed every axis that it places absolutely. The
        third pass therefore stands for all that follow.

        Returns
        -------
        iterator
            Of operations and runs, each with the number of times it happens and the line of the
            call in the main program that it comes from (0 for operations of the main program). A
            move that happens 0 times gives the position after the passes that were left out.

        Raises
        ------
        JobError
            As ``runs`` does.
        """
        return Interpreter(self, fold=True).run()


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
        self._dialect = program.reading.dialect
        self._exact = [0] * len(program.linear)
        self._zeros = Zeros(len(program.linear), program.systems)
        self._curves = Curves(program.reading, program.linear)
        self._position = [0.0] * len(program.linear)
        self._motion = -1
        self._relative = False
        self._tenth_mm = 10  # tenths of a millimetre in the unit of length
        self._feed_tenth_mm = 10  # and in that in which the feed was given
        axes = enumerate(program.reading.axes)
        self._lengths = [index for index, name in axes if name in _LENGTHS]
        self._inverse_time = False
        self._feed: Feed | None = None
        self._passes: tuple[int, ...] = ()
        self._plain = plain_reader(program.reading, program.linear, follow=True)
        self._text = KeptText(program.file, program.reading)
        self._feeds = KeptFeeds(program.rule)

    def run(self) -> Iterator[tuple[Operation | MoveRun, int, int]]:
        """Return operations and runs, with their times and the line of the main program's call."""
        structure = self._program.structure
        frames = [Frame(structure.main, self._text.lines_of(structure.main), 1, 1)]
        while frames:
            frame = frames[-1]
            lines = frame.lines
            if not lines.more():
                if frame.program.ends_with is None or self._dialect.needs_end:
                    raise self._error(lines.number, "the program has no end", "Start again.")
                yield Stop(True, Source(self._path, max(1, lines.number - 1))), 1, 0
                return
            if self._plain.worth_trying():
                run = self._read_plain(lines)
                if run is not None:
                    yield run, frame.times, frame.line
                    continue
                if not lines.more():
                    continue
            block = self._text.next_block(lines, looping=bool(self._passes))
            if block is None:
                continue
            for operation in self._step(block):
                yield operation, frame.times, frame.line
            if block.program == 98:
                callee = structure.programs[(block.p or 0) // ONE]
                # A subroutine without operations needs only one pass.
                turns = block.passes if structure.totals[callee.label].operations else 1
                line, text = frame.line or block.line, self._text.lines_of(callee)
                frames.append(Frame(callee, text, 1, turns, frame.times, line))
                self._passes = (*self._passes, 1)
            elif block.ends == "return":
                if frame.folded > 1:
                    self._advance(frame)
                    yield Move(tuple(self._position), _RAPID, self._source(block)), 0, frame.line
                if frame.pass_ < frame.passes:
                    frame.pass_ += 1
                    if self._fold and frame.pass_ == _STEADY_PASS:
                        frame.fold_rest((*self._exact, *self._zeros.offset))
                    frame.lines = self._text.lines_of(frame.program)
                    self._passes = (*self._passes[:-1], frame.pass_)
                else:
                    frames.pop()
                    self._passes = self._passes[:-1]
            elif self._ends(block):
                return
            elif block.ends == "end":
                self._motion = 1
                self._set(_ANEW)

    def _ends(self, block: Block) -> bool:
        """Say whether nothing is run behind a block that ends a program."""
        return block.ends == "end" and block.line >= self._program.structure.main.closes

    def _advance(self, frame: Frame) -> None:
        """Set the position to the one after all passes that were folded into one."""
        axes, offset = len(self._exact), self._zeros.offset
        for index, start in enumerate(frame.start[:axes]):
            self._put(index, start + frame.folded * (self._exact[index] - start))
        for index, start in enumerate(frame.start[axes:]):
            offset[index] = start + frame.folded * (offset[index] - start)

    def _put(self, index: int, exact: int) -> None:
        """Set the position of an axis, exactly and in SI."""
        self._exact[index] = exact
        linear = self._linear[index]
        self._position[index] = exact / _MM_PER_M if linear else math.radians(exact / ONE)

    def _read_plain(self, lines: Lines) -> MoveRun | None:
        """Read plain blocks with the compiled reader; return their moves, None without any."""
        plain = self._plain
        for to, numbers in ((plain.exact, self._exact), (plain.offset, self._zeros.offset)):
            for index, exact in enumerate(numbers):
                if exact % _FINE or not -kernel.EXACT_LIMIT < exact // _FINE < kernel.EXACT_LIMIT:
                    return None  # more digits than the kernel has
                to[index] = exact // _FINE
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
        return MoveRun(targets, line, feeds, self._path, self._passes, plain.columns(count))

    def _in_degrees(self, plain: PlainReader, count: int, before: tuple[float, ...]) -> FloatArray:
        """Return the (count,) feeds of the moves just read, with inches undone for A B C alone."""
        values = plain.out_feed[:count]
        if self._feed_tenth_mm == self._tenth_mm == _MILLIMETRE:
            return values
        words = np.flatnonzero(plain.out_word[:count] >= 0)
        unit = np.full(count, self._feed_tenth_mm)
        if len(words):
            unit[words[0] :] = self._feed_tenth_mm = self._tenth_mm
        in_turn = self._program.rule.mode is FeedMode.IN_TURN
        if self._inverse_time or not in_turn or (unit == _MILLIMETRE).all():
            return values
        way = np.diff(plain.out_position[:count], axis=0, prepend=np.array([before]))
        turned = ~way[:, self._lengths].any(axis=1) & (values > 0)
        return np.where(turned, values * _MILLIMETRE / unit, values)

    def _step(self, block: Block) -> Iterator[Operation]:
        """Return the operations of one block, in the order of RS274/NGC."""
        if block.settings:
            self._set(block.settings)
        if block.feed is not None:
            told = value_of(block.feed, self._tenth_mm, inverse_time=self._inverse_time)
            self._feed = self._feed_of(told)
            self._feed_tenth_mm = self._tenth_mm
        if block.motion >= 0:
            self._motion = -1 if block.motion == CANCEL else block.motion
        if block.action == 40:
            yield Dwell(block.dwell_s, self._source(block))
        elif block.action == 280:
            yield from self._return_to_start(block)
        elif block.action != -1:
            given = {index: self._scaled(index, value) for index, value in block.axes}
            self._zeros.take(block.action, self._exact, given)
        elif block.axes or (block.curve and self._motion in CURVED):
            yield from self._move(block)
        if block.spindle is not None:
            yield ToolEvent("spindle", block.spindle, self._source(block))
        if block.waits:
            yield Dwell(0.0, self._source(block))
        if block.ends == "stop" or self._ends(block):
            yield Stop(block.ends == "end", self._source(block))
        elif block.ends == "end":
            yield Dwell(0.0, self._source(block))

    def _source(self, block: Block) -> Source:
        return Source(self._path, block.line, self._passes)

    def _set(self, settings: tuple[int, ...]) -> None:
        for code in settings:
            if code in (900, 910):
                self._relative = code == 910
            elif code in (200, 210):
                self._tenth_mm = 254 if code == 200 else 10
            elif code in (930, 940) and self._inverse_time != (code == 930):
                # A number that was a speed is no inverse of a time.
                self._inverse_time = code == 930
                self._feed = None
            elif code in (170, 180, 190):
                self._curves.plane = code
            elif code in SYSTEMS:
                self._zeros.choose(code)

    def _feed_of(self, value: float) -> Feed:
        """Return the feed with ``value`` in the present mode."""
        return self._feeds.feed(value, inverse_time=self._inverse_time)

    def _scaled(self, index: int, value: int) -> int:
        """Return the word of an axis in mm or degrees."""
        return value * self._tenth_mm // 10 if self._linear[index] else value

    def _go(self, block: Block) -> None:
        """Set the position to that of the axis words of ``block``."""
        base: Sequence[int] = self._exact if self._relative else self._zeros.offset
        if MACHINE in block.settings:
            base = self._zeros.machine
        for index, value in block.axes:
            self._put(index, base[index] + self._scaled(index, value))

    def _move(self, block: Block) -> Iterator[Operation]:
        rapid = self._motion == 0 and not self._dialect.rapid_is_feed
        feed = _RAPID if rapid else self._feed
        if feed is None and self._motion == 0 and self._stays(block):
            feed = _RAPID  # it takes no time at any feed: planners begin so
        if self._motion == -1 or (self._dialect.each_g and block.motion == -1):
            raise self._error(
                block.line,
                "axis words before any G0 or G1"
                if self._motion == -1
                else f"axis words without a G word, which {self._dialect.name} does not take",
                "Write G1 and a feed first.",
            )
        if feed is None:
            raise self._error(
                block.line, f"G{self._motion} moves before any feed F", "Give F, in mm/min."
            )
        if feed.mode is FeedMode.INVERSE_TIME and block.feed is None:
            raise self._error(
                block.line,
                f"in G93 every G{self._motion} block needs its own F",
                "Give F as 1 / minutes of the move.",
            )
        before = tuple(self._exact)
        self._go(block)
        source = self._source(block)
        tags = dict(block.tags) if block.tags else NO_TAGS
        if self._motion in CURVED:
            yield from self._along(block, before, feed, source, tags)
            return
        if block.curve:
            raise self._error(
                block.line,
                f"{block.curve[0][0]} has no use in a block of G{self._motion}",
                "I J K R Q belong to G2, G3 and G5.",
            )
        if (
            self._feed_tenth_mm != _MILLIMETRE
            and feed.mode is FeedMode.IN_TURN
            and all(self._exact[index] == before[index] for index in self._lengths)
        ):
            feed = self._feed_of(feed.value * _MILLIMETRE / self._feed_tenth_mm)
        yield Move(tuple(self._position), feed, source, tags)

    def _stays(self, block: Block) -> bool:
        """Return whether the axis words of a block are the present position."""
        base = self._exact if self._relative else self._zeros.offset
        return all(base[i] + self._scaled(i, v) == self._exact[i] for i, v in block.axes)

    def _along(
        self, block: Block, before: tuple[int, ...], feed: Feed, source: Source, tags: Tags
    ) -> Iterator[Operation]:
        """Return the chords of an arc or spline, of which the last ends where the block does."""
        after = tuple(self._exact)
        points = list(self._curves.points(self._motion, block, before, after, self._tenth_mm))
        chords = len(points) + 1
        if feed.mode is FeedMode.INVERSE_TIME:
            feed = self._feed_of(feed.value * chords)
        for point in points:
            for index, exact in enumerate(point):
                self._put(index, exact)
            yield Move(tuple(self._position), feed, source, tags)
        for index, exact in enumerate(after):
            self._put(index, exact)
        yield Move(tuple(self._position), feed, source, tags)

    def _return_to_start(self, block: Block) -> Iterator[Operation]:
        """Return the moves of G28: by way of the words of the block, then home.

        A controller that homes goes there at once, and its zero is there afterwards.
        """
        source = self._source(block)
        if block.axes and not self._dialect.homes:
            self._go(block)
            yield Move(tuple(self._position), _RAPID, source)
        for index in [i for i, _ in block.axes] or range(len(self._exact)):
            self._put(index, self._zeros.home[index])
            if self._dialect.homes:
                self._zeros.offset[index] = 0
        yield Move(tuple(self._position), _RAPID, source)

    def _error(self, line: int, message: str, remedy: str) -> JobError:
        return JobError(message, place=self._program.file.place(line), remedy=remedy)
