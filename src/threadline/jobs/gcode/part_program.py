"""The interpreter of part programs: calls, and plain blocks many at a time."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import BudgetError, JobError, MachineError, OptionError, Place
from threadline.files import Stream
from threadline.jobs.gcode import plain_blocks as kernel
from threadline.jobs.gcode.block import Block
from threadline.jobs.gcode.dialects import DIALECTS, Dialect, Reading, dialect_of
from threadline.jobs.gcode.feeds import f_rule, travelling
from threadline.jobs.gcode.foreign import letters_of
from threadline.jobs.gcode.modal import MILLIMETRE, RAPID, Modal, ProgramText
from threadline.jobs.gcode.plain_blocks import PlainReader, plain_reader
from threadline.jobs.gcode.program_warnings import capped_feeds, program_warnings
from threadline.jobs.gcode.scan import Scanner
from threadline.jobs.gcode.subprograms import CachedText, Frame, Structure
from threadline.jobs.gcode.textfile import Lines, SourceFile, identify
from threadline.jobs.gcode.words import ONE, is_parametric
from threadline.jobs.gcode.zeros import FIRST, tool_lengths, zeros_of
from threadline.jobs.operations import (
    CachedOperations,
    Feed,
    FeedMode,
    Job,
    Move,
    MoveRun,
    Operation,
    OperationStream,
    Source,
    Stop,
    ToolEvent,
)
from threadline.machine import Machine
from threadline.machine.motion_planner import DIALECT_NAMES

if TYPE_CHECKING:
    from threadline.jobs.gcode.parametric.program import ParametricProgram

_STEADY_PASS = 3
_FINE = ONE // kernel.STEPS
_ANEW = (170, FIRST, 900, 940)  # M2 and M30 set these modes and G1 (grbl 1.1, gcode.c)


@dataclass(frozen=True, slots=True)
class PartProgram(ProgramText):
    """A scanned part program; it can be read any number of times.

    Parameters
    ----------
    structure
        Programs of the file, and their calls.
    """

    structure: Structure

    def runs(self) -> Iterator[Operation | MoveRun]:
        """Return the operations from the start position, with moves in runs.

        Raises
        ------
        JobError
            If a block lacks a feed or a mode of motion.
        """
        return (item for item, _, _ in Interpreter(self).run())

    def folded(self) -> Iterator[tuple[Operation | MoveRun, int, int]]:
        """Return the operations, with one pass in place of passes that repeat.

        From its third pass, a subroutine makes the same moves in every pass: the first pass sets
        the modes, and the second pass, in these modes, moves every absolutely programmed axis to
        its place. The third pass therefore stands for all later passes.

        Returns
        -------
        iterator
            Operations and runs, each with its number of times and the line of its call in the main
            program (0 for operations of the main program). A move with 0 times gives the position
            after the passes that were left out.

        Raises
        ------
        JobError
            If a block lacks a feed or a mode of motion.
        """
        return Interpreter(self, fold=True).run()


class Interpreter(Modal):
    """The state of one reading, with its open calls.

    Parameters
    ----------
    program
        Program to read.
    fold
        Whether the third pass of a subroutine stands for all later passes.
    """

    def __init__(self, program: PartProgram, fold: bool = False) -> None:
        super().__init__(program)
        self._structure = program.structure
        self._fold = fold
        self._plain = plain_reader(program.reading, program.linear, follow=True)
        self._text = CachedText(program.file, program.reading)

    def run(self) -> Iterator[tuple[Operation | MoveRun, int, int]]:
        """Return operations and runs, each with its times and the line of the main call."""
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
            blocks = self._text.next_line(lines, looping=bool(self._passes))
            if not blocks:
                continue
            *earlier_blocks, block = blocks
            # The scan refuses a line that goes on behind an end.
            for earlier in earlier_blocks:
                for operation in self._step(earlier):
                    yield operation, frame.times, frame.line
            for operation in self._step(block):
                yield operation, frame.times, frame.line
            if block.program == 98:
                callee = structure.programs[(block.p or 0) // ONE]
                # A subroutine without operations needs only one pass.
                pass_count = (block.passes or 1) if structure.totals[callee.label].operations else 1
                main_line, callee_lines = frame.line or block.line, self._text.lines_of(callee)
                frames.append(Frame(callee, callee_lines, 1, pass_count, frame.times, main_line))
                self._passes = (*self._passes, 1)
            elif block.ends == "return":
                if frame.folded > 1:
                    self._advance(frame)
                    yield Move(tuple(self._position), RAPID, self._source(block)), 0, frame.line
                if frame.pass_ < frame.passes:
                    frame.pass_ += 1
                    if self._fold and frame.pass_ == _STEADY_PASS:
                        frame.fold_rest(
                            (*self._exact, *self._zeros.offset, *self._zeros.saved_offset)
                        )
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
        """Say whether the reading ends at a block, because no later line runs."""
        return block.ends == "end" and block.line >= self._structure.main.closes

    def _advance(self, frame: Frame) -> None:
        """Set the position to the end of all passes that one pass stands for."""
        axis_count = len(self._exact)
        for index, start in enumerate(frame.start[:axis_count]):
            self._put(index, start + frame.folded * (self._exact[index] - start))
        for first_column, values in (
            (axis_count, self._zeros.offset),
            (2 * axis_count, self._zeros.saved_offset),
        ):
            for index, start in enumerate(frame.start[first_column : first_column + axis_count]):
                values[index] = start + frame.folded * (values[index] - start)

    def _read_plain(self, lines: Lines) -> MoveRun | None:
        """Read plain blocks with the compiled reader; return their moves, None without moves."""
        plain = self._plain
        for plain_values, exact_values in (
            (plain.exact, self._exact),
            (plain.offset, self._zeros.offset),
        ):
            for index, exact in enumerate(exact_values):
                if exact % _FINE or not -kernel.EXACT_LIMIT < exact // _FINE < kernel.EXACT_LIMIT:
                    return None  # the kernel cannot hold these digits
                plain_values[index] = exact // _FINE
        plain.position[:] = self._position
        plain.feed[0] = math.nan if self._feed is None else self._feed.value
        state = plain.state
        state[kernel.MOTION] = self._motion
        state[kernel.RELATIVE] = self._relative
        state[kernel.TENTH_MM] = self._tenth_mm
        state[kernel.INVERSE] = self._inverse_time
        position_before = tuple(self._position)
        move_count = plain.read(lines)
        self._motion = int(state[kernel.MOTION])
        self._cancelled = self._cancelled and self._motion == -1
        self._relative = bool(state[kernel.RELATIVE])
        if move_count == 0:
            return None
        self._cycles.take((), self._motion)
        self._exact = [exact * _FINE for exact in plain.exact.tolist()]
        self._position = plain.position.tolist()
        value = float(plain.feed[0])
        self._feed = None if math.isnan(value) else self._feed_of(value)
        feed_values = self._in_degrees(plain, move_count, position_before)
        change_indices = [0, *(np.flatnonzero(np.diff(feed_values)) + 1).tolist()]
        feeds = tuple(
            (first_move, self._feed_of(value) if value >= 0 else self._feed_of_g0(-value))
            for first_move, value in zip(
                change_indices, feed_values[change_indices].tolist(), strict=True
            )
        )
        targets, move_lines = (
            plain.out_position[:move_count].copy(),
            plain.out_line[:move_count].copy(),
        )
        acts: tuple[tuple[int, tuple[ToolEvent, ...]], ...] = ()
        if self._waiting or not self._moved:
            events = self._acting(Source(self._path, int(move_lines[0]), self._passes))
            acts = ((0, events),) if events else ()
        columns = plain.columns(move_count)
        return MoveRun(targets, move_lines, feeds, self._path, self._passes, columns, acts)

    def _feed_of_g0(self, value: float) -> Feed:
        return travelling(self._feed_of(value)) if self._dialect.rapid_is_feed else RAPID

    def _in_degrees(
        self, plain: PlainReader, move_count: int, position_before: tuple[float, ...]
    ) -> FloatArray:
        """Return (move_count,) feeds of the last moves, without inches for moves of A B C alone."""
        feed_values = plain.out_feed[:move_count]
        if self._feed_tenth_mm == self._tenth_mm == MILLIMETRE:
            return feed_values
        f_moves = np.flatnonzero(plain.out_word[:move_count] >= 0)
        feed_unit = np.full(move_count, self._feed_tenth_mm)
        if len(f_moves):
            feed_unit[f_moves[0] :] = self._feed_tenth_mm = self._tenth_mm
        in_turn = self._rule.mode is FeedMode.IN_TURN
        if self._inverse_time or not in_turn or (feed_unit == MILLIMETRE).all():
            return feed_values
        displacement = np.diff(
            plain.out_position[:move_count], axis=0, prepend=np.array([position_before])
        )
        at_feed = (feed_values > 0) | self._dialect.rapid_is_feed
        only_turns = ~displacement[:, self._lengths].any(axis=1) & at_feed
        return np.where(only_turns, feed_values * MILLIMETRE / feed_unit, feed_values)


_RESERVED = "EFGLMNOP"


def read_part_program(
    path: str | Path,
    *,
    machine: Machine,
    dialect: str | None = None,
    feed_mode: str | None = None,
    base_axes: tuple[str, ...] = (),
    axes: str | None = None,
) -> Job:
    """Return the job of a part program.

    This function reads the file once: it checks every block and counts the moves, multiplied by
    the passes of the calls. The job reads the file again in every iteration.

    Parameters
    ----------
    path
        Part program in a dialect of ``docs/part-programs.md``.
    machine
        Machine whose axes the program may move.
    dialect
        Name of the dialect; None: the machine file's dialect.
    feed_mode, base_axes
        Rule for the meaning of F (``threadline.jobs.gcode.feeds``); None: the machine file's rule,
        else the dialect's.
    axes
        Axes of the machine for letters of the program, such as ``"C=A,Z=X"`` (the program's C is
        the machine's A); None: axes with the same letters.

    Raises
    ------
    JobError
        If the program cannot be read, or the machine has no axes; the error names file and line.
    BudgetError
        If the program has more operations than the machine's tick budget.
    OptionError
        If there is no such dialect, or the options for F do not fit the machine.
    MachineError
        If an axis of the machine has the letter of another word.
    """
    path = Path(path)
    if not machine.axis_names:
        raise JobError(
            f"{machine.name!r} has no axes for part programs",
            place=Place(str(path)),
            remedy="Such a machine takes move lists (.toml); choose another job or machine (-m).",
        )
    for name in machine.axis_names:
        if name in _RESERVED:
            raise MachineError(
                f"the axis {name} of {machine.name!r} has the letter of another word",
                remedy="A part program moves axes A B C U V W X Y Z.",
            )
    spoken_dialect = _dialect(machine, dialect)
    rule = f_rule(machine, feed_mode, tuple(base_axes), spoken_dialect.feed_rule)
    file = identify(path)
    letters = letters_of(machine, axes)
    reading = Reading(
        str(path), machine.name, letters.axes, machine.axis_names, spoken_dialect, letters.dropped,
        wrapped_axes(machine, spoken_dialect.name), tool_lengths(machine, letters.axes),
    )  # fmt: skip
    linear = tuple(axis.kind == "linear" for axis in machine.axes.values())
    program: PartProgram | ParametricProgram
    if spoken_dialect.flavour is not None and is_parametric(file):
        from threadline.jobs.gcode.parametric.program import survey

        surveyed = survey(file, reading, linear, rule, machine)
        program, findings = surveyed.program, surveyed.findings
        moved_axes, label = surveyed.moved, None
    else:
        scanner = Scanner(file, reading)
        structure = scanner.run()
        if structure.totals[structure.main.label].moves == 0:
            raise JobError(
                f"{structure.main.name} moves nothing",
                place=file.place(structure.main.line),
                remedy="Name a file with a program that moves an axis.",
            )
        _check_budget(structure, file, machine)
        systems = zeros_of(scanner.systems, machine, file)
        program = PartProgram(file, reading, linear, rule, systems, structure)
        findings, moved_axes = scanner.findings, scanner.moved_axes
        label = structure.main.label
    return Job(
        name=path.name,
        file=str(path),
        sha256=file.sha256,
        axes=machine.axis_names,
        start=(0.0,) * len(machine.axis_names),
        operations=OperationStream(CachedOperations(_runs, program), Stream(_folded, program)),
        warnings=program_warnings(findings, file, spoken_dialect),
        capped=capped_feeds(findings, moved_axes, label, machine, file),
        feed_rule=rule.text,
        dialect=spoken_dialect.name,
        sets_limits=bool(findings.limits),
    )


def wrapped_axes(machine: Machine, dialect: str) -> frozenset[int]:
    """Return the indices of the axes whose angles count within one turn.

    Raises
    ------
    MachineError
        If the dialect knows no such axes.
    """
    wrapped = [index for index, axis in enumerate(machine.axes.values()) if axis.wrapped]
    if wrapped and dialect != "linuxcnc":
        raise MachineError(
            f"axes.{machine.axis_names[wrapped[0]]}.wrapped: LinuxCNC alone reads angles in one "
            f"turn, and the program is read as {dialect}",
            remedy='Remove it from the machine file, or take dialect = "linuxcnc".',
        )
    return frozenset(wrapped)


def _runs(program: PartProgram | ParametricProgram) -> Iterator[Operation | MoveRun]:
    return program.runs()


def _folded(
    program: PartProgram | ParametricProgram,
) -> Iterator[tuple[Operation | MoveRun, int, int]]:
    return program.folded()


def _dialect(machine: Machine, option: str | None) -> Dialect:
    name = dialect_of(machine, option)
    if name not in DIALECTS:
        raise OptionError(
            f"there is no dialect {name[:40]!r} of part programs",
            remedy=f"Choose {', '.join(DIALECT_NAMES)}.",
        )
    return DIALECTS[name]


def _check_budget(structure: Structure, file: SourceFile, machine: Machine) -> None:
    """Refuse more operations than the tick budget: each operation takes at least one tick."""
    budget = int(machine.tick_budget.si)
    main = structure.main
    totals = structure.totals[main.label]
    needed = totals.operations
    if needed <= budget:
        return
    costliest_call = max(
        main.calls.items(),
        key=lambda item: item[1].passes * structure.totals[item[0]].operations,
        default=None,
    )
    line = main.line if costliest_call is None else costliest_call[1].line
    count = f"{needed}" if needed < 10**15 else "more than 10^15"
    raise BudgetError(
        f"the program asks for {count} operations with all passes; the machine's tick budget is "
        f"{budget} and each counts as a tick at least",
        place=file.place(line),
        remedy="Lower L, or raise tick_budget in the machine file.",
    )
