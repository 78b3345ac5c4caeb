"""The interpreter of part programs: calls, and plain blocks many at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.jobs.gcode import plain_blocks as kernel
from threadline.jobs.gcode.block import Block
from threadline.jobs.gcode.frames import Frame, KeptText
from threadline.jobs.gcode.kept_feeds import travelling
from threadline.jobs.gcode.modal import MILLIMETRE, RAPID, Modal, ProgramText
from threadline.jobs.gcode.plain_reader import PlainReader, plain_reader
from threadline.jobs.gcode.subprograms import Structure
from threadline.jobs.gcode.textfile import Lines
from threadline.jobs.gcode.words import ONE
from threadline.jobs.gcode.work_offsets import FIRST
from threadline.jobs.operations import (
    Feed,
    FeedMode,
    Move,
    MoveRun,
    Operation,
    Source,
    Stop,
    ToolEvent,
)

_STEADY_PASS = 3
_FINE = ONE // kernel.STEPS
_ANEW = (170, FIRST, 900, 940)  # with G1: what M2 and M30 set (grbl 1.1, gcode.c)


@dataclass(frozen=True, slots=True)
class PartProgram(ProgramText):
    """A scanned part program, which can be read any number of times.

    Parameters
    ----------
    structure
        The programs of the file.
    """

    structure: Structure

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


class Interpreter(Modal):
    """The state of one reading, with the calls that are open.

    Parameters
    ----------
    program
        What is read.
    fold
        Whether the third pass of a subroutine stands for all that follow.
    """

    def __init__(self, program: PartProgram, fold: bool = False) -> None:
        super().__init__(program)
        self._structure = program.structure
        self._fold = fold
        self._plain = plain_reader(program.reading, program.linear, follow=True)
        self._text = KeptText(program.file, program.reading)

    def run(self) -> Iterator[tuple[Operation | MoveRun, int, int]]:
        """Return operations and runs, with their times and the line of the main program's call."""
        structure = self._structure
        frames = [Frame(structure.main, self._text.lines_of(structure.main), 1, 1)]
        while frames:
            frame = frames[-1]
            lines = frame.lines
            if not lines.more():
                if frame.program.ends_with is None or self._dialect.needs_end:
                    raise self._error(lines.number, "the program has no end", "Start again.")
                for operation in self._rest(
                    Stop(True, Source(self._path, max(1, lines.number - 1)))
                ):
                    yield operation, 1, 0
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
                    yield Move(tuple(self._position), RAPID, self._source(block)), 0, frame.line
                if frame.pass_ < frame.passes:
                    frame.pass_ += 1
                    if self._fold and frame.pass_ == _STEADY_PASS:
                        frame.fold_rest((*self._exact, *self._zeros.offset, *self._zeros.kept))
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
        return block.ends == "end" and block.line >= self._structure.main.closes

    def _advance(self, frame: Frame) -> None:
        """Set the position to the one after all passes that were folded into one."""
        axes = len(self._exact)
        for index, start in enumerate(frame.start[:axes]):
            self._put(index, start + frame.folded * (self._exact[index] - start))
        for at, values in ((axes, self._zeros.offset), (2 * axes, self._zeros.kept)):
            for index, start in enumerate(frame.start[at : at + axes]):
                values[index] = start + frame.folded * (values[index] - start)

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
        self._cancelled = self._cancelled and self._motion == -1
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
            (at, self._feed_of(value) if value >= 0 else self._feed_of_g0(-value))
            for at, value in zip(changes, values[changes].tolist(), strict=True)
        )
        targets, line = plain.out_position[:count].copy(), plain.out_line[:count].copy()
        acts: tuple[tuple[int, tuple[ToolEvent, ...]], ...] = ()
        if self._waiting or not self._moved:
            own = self._acting(Source(self._path, int(line[0]), self._passes))
            acts = ((0, own),) if own else ()
        columns = plain.columns(count)
        return MoveRun(targets, line, feeds, self._path, self._passes, columns, acts)

    def _feed_of_g0(self, value: float) -> Feed:
        return travelling(self._feed_of(value)) if self._dialect.rapid_is_feed else RAPID

    def _in_degrees(self, plain: PlainReader, count: int, before: tuple[float, ...]) -> FloatArray:
        """Return the (count,) feeds of the moves just read, with inches undone for A B C alone."""
        values = plain.out_feed[:count]
        if self._feed_tenth_mm == self._tenth_mm == MILLIMETRE:
            return values
        words = np.flatnonzero(plain.out_word[:count] >= 0)
        unit = np.full(count, self._feed_tenth_mm)
        if len(words):
            unit[words[0] :] = self._feed_tenth_mm = self._tenth_mm
        in_turn = self._rule.mode is FeedMode.IN_TURN
        if self._inverse_time or not in_turn or (unit == MILLIMETRE).all():
            return values
        way = np.diff(plain.out_position[:count], axis=0, prepend=np.array([before]))
        at_feed = (values > 0) | self._dialect.rapid_is_feed
        turned = ~way[:, self._lengths].any(axis=1) & at_feed
        return np.where(turned, values * MILLIMETRE / unit, values)
