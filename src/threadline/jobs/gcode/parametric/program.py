"""A part program with parameters: its lines, its O words, and the run over its lines."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NoReturn

from threadline.errors import BudgetError, JobError, Place
from threadline.jobs.gcode.block import Block, block_of
from threadline.jobs.gcode.dialects import Flavour, Reading
from threadline.jobs.gcode.feeds import FRule
from threadline.jobs.gcode.grammar import check_length
from threadline.jobs.gcode.modal import Modal, ProgramText
from threadline.jobs.gcode.parametric.course import Run
from threadline.jobs.gcode.parametric.flow import Flow, FlowReader, o_word
from threadline.jobs.gcode.parametric.parameters import Values
from threadline.jobs.gcode.parametric.statements import Code, code_of
from threadline.jobs.gcode.scan import Findings
from threadline.jobs.gcode.textfile import Lines, SourceFile
from threadline.jobs.gcode.words import ONE, READ_TO_TAPE, TAPE, Tapes, refuse_switched
from threadline.jobs.gcode.zeros import SystemsUsed, ToolLengths, moves_length, zeros_of
from threadline.jobs.operations import Move, MoveRun, Operation, Source, Stop
from threadline.machine import Machine

MOST_BYTES = 16 << 20
_AXIS_NAMES = {f"_{letter}": letter.upper() for letter in "xyzabcuvw"}
_ENDS = re.compile(r"[Mm]0*(?:2|30)(?![\d.])")
_PLANES = {170: 170.0, 180: 180.0, 190: 190.0}


@dataclass(frozen=True, slots=True)
class Text:
    """The lines of a program without comments and blanks, and the flow of its O words."""

    codes: tuple[Code, ...]
    flow: Flow


def text_of(file: SourceFile, reading: Reading, flavour: Flavour) -> Text:
    """Return the lines of a program that is short enough for memory.

    Raises
    ------
    JobError
        If the program is too long, or its O words do not match.
    """
    if file.end - file.begin > MOST_BYTES:
        raise JobError(
            f"a program with parameters or O words of more than {MOST_BYTES >> 20} MiB",
            place=file.place(),
            remedy="Have it written with numbers alone.",
        )
    flow = FlowReader(reading.file, flavour)
    first_line_only = reading.dialect.grammar.tape == "first"
    tapes = Tapes(file, reading.dialect.name if first_line_only else "")
    codes: list[Code] = []
    lines = Lines(file, file.begin, 1)
    has_code = False
    while lines.more():
        number, _, text = lines.take()
        code = Code("", "")
        if text.strip() == TAPE:
            tapes.take(number, has_code)
        else:
            tapes.pass_by(text)
            place = Place(reading.file, number)
            check_length(text, reading.dialect.grammar, reading.dialect.name, place)
            code = code_of(text, flavour, reading.file, number)
        if code.text:
            has_code = True
            if code.text[0] == "/":
                refuse_switched(Place(reading.file, number))
            tapes.check(number)
            o = o_word(code.text, Place(reading.file, number))
            if o is not None:
                flow.take(o, number - 1)
        codes.append(code)
    last_code = next((code.text for code in reversed(codes) if code.text), "")
    ends_program = reading.dialect.name not in READ_TO_TAPE and _ENDS.search(last_code) is not None
    tapes.finish(max(1, lines.number - 1), ended=ends_program)
    if not has_code:
        raise JobError(
            "the file holds no block", place=file.place(), remedy="Name a file with a program."
        )
    return Text(tuple(codes), flow.finish())


@dataclass(frozen=True, slots=True)
class ParametricProgram(ProgramText):
    """A part program with parameters; it can be read any number of times.

    Parameters
    ----------
    flavour
        Rules of the control for parameters and O words.
    """

    flavour: Flavour

    def runs(self) -> Iterator[Operation | MoveRun]:
        """Return the operations from the start position.

        Raises
        ------
        JobError
            If a block cannot be read, or a formula has no value.
        """
        return (item for item, _, _ in self.folded())

    def folded(self) -> Iterator[tuple[Operation | MoveRun, int, int]]:
        """Return the operations, each with its number of times (1) and line of the call (0).

        Raises
        ------
        JobError
            If a block cannot be read, or a formula has no value.
        """
        for _, operations in ParametricInterpreter(self).blocks():
            for operation in operations:
                yield operation, 1, 0


class ParametricInterpreter(Modal):
    """The state of one reading, with its parameters.

    Parameters
    ----------
    program
        Program to read.

    Attributes
    ----------
    values
        Parameters of the run.
    """

    def __init__(self, program: ParametricProgram) -> None:
        super().__init__(program)
        self._reading = program.reading
        self._flavour = program.flavour
        self._text = text_of(program.file, program.reading, program.flavour)
        self.values = Values(program.flavour, self._predefined)

    def blocks(self) -> Iterator[tuple[Block, Iterator[Operation]]]:
        """Return each block of the run with its operations; take them before the next block.

        Raises
        ------
        JobError
            If a block cannot be read, a formula has no value, or too many lines run.
        """
        codes = self._text.codes
        run = Run(codes, self._text.flow, self._flavour, self.values, self._reading.file)
        line = 1
        for raw, line in run.statements():
            if not raw.words:
                continue
            block = block_of(raw, line, self._reading)
            if block.ends in {"call", "return"} or block.label >= 0:
                self._mixed(line)
            if block.action == 40 or block.goes:
                run.idle = 0
            yield block, self._step(block)
            if block.ends == "end":
                return
        if self._dialect.needs_end:
            raise self._error(
                len(codes),
                "the program has no end: the file may be truncated",
                "Close it with M2 or M30.",
            )
        end_block = Block(
            line, -1, -1, (), (), None, None, 0, (), 0.0, 30, "end", None, False, (), -1, ()
        )
        yield end_block, self._rest(Stop(True, Source(self._path, line)))

    def _mixed(self, line: int) -> NoReturn:
        raise self._error(
            line,
            "M98 and M99 do not go with O words and parameters here",
            "Write the subroutine as o100 sub ... o100 endsub, and its call as o100 call.",
        )

    def _predefined(self, name: str) -> float | None:
        """Return the value of a predefined name, None for an unknown name."""
        letter = _AXIS_NAMES.get(name)
        if letter is not None:
            index = self._reading.axes.get(letter)
            return 0.0 if index is None else self._place_of(index)
        states = {
            "_metric": self._tenth_mm == 10,
            "_imperial": self._tenth_mm != 10,
            "_absolute": not self._relative,
            "_incremental": self._relative,
            "_inverse_time": self._inverse_time,
            "_units_per_minute": not self._inverse_time,
            "_units_per_rev": False,
        }
        if name in states:
            return float(states[name])
        if name == "_plane":
            return _PLANES[self._curves.plane]
        if name == "_motion_mode" and self._flavour.subroutines:
            return 800.0 if self._motion == -1 else 10.0 * self._motion
        return None

    def _place_of(self, index: int) -> float:
        """Return the present position of an axis in the units of the program."""
        from_zero = (self._exact[index] - self._zeros.offset[index]) / ONE
        value = from_zero * 10.0 / self._tenth_mm if self._linear[index] else from_zero
        return self._flavour.rounded(value if math.isfinite(value) else 0.0)


MOST_OPERATIONS = 5_000_000
"""Most operations (moves, chords, dwells and others) of a program with parameters."""


@dataclass(frozen=True, slots=True)
class Surveyed:
    """A program, the findings of its first run, and the indices of the axes that it names."""

    program: ParametricProgram
    findings: Findings
    moved: list[int]


def survey(
    file: SourceFile, reading: Reading, linear: tuple[bool, ...], rule: FRule, machine: Machine
) -> Surveyed:
    """Run a program once.

    A program that moves in several coordinate systems runs a second time with their zeros, because
    the program can read its own position.

    Raises
    ------
    JobError
        If the program cannot be read, runs too long, or moves no axis.
    BudgetError
        If the program has more operations than the machine's tick budget.
    """
    flavour = reading.dialect.flavour
    assert flavour is not None
    systems = SystemsUsed()
    program = ParametricProgram(file, reading, linear, rule, {}, flavour)
    surveyed = _run(program, systems, machine)
    zeros = zeros_of(systems, machine, file)
    if zeros:
        program = ParametricProgram(file, reading, linear, rule, zeros, flavour)
        surveyed = _run(program, SystemsUsed(), machine)
    return surveyed


def _run(program: ParametricProgram, systems: SystemsUsed, machine: Machine) -> Surveyed:
    file, findings = program.file, Findings()
    moved_axes: set[int] = set()
    budget = int(machine.tick_budget.si)
    limit = min(budget, MOST_OPERATIONS)
    operation_count, has_moves, motion = 0, False, -1
    interpreter = ParametricInterpreter(program)
    lengths = ToolLengths(file, program.reading.lengths)
    for block, block_operations in interpreter.blocks():
        motion = block.motion if block.motion >= 0 else motion
        if block.feed is not None and block.axes and motion == 0 and not findings.rapid_f:
            findings.rapid_f = block.line
        findings.note(None, block)
        moved_axes.update(index for index, _ in block.axes)
        systems.take(block.settings, block.line, moves=block.goes)
        lifts = moves_length(block, program.reading)
        lengths.take(block.length, block.settings, block.line, moves=lifts, later=False)
        for operation in block_operations:
            has_moves = has_moves or isinstance(operation, Move)
            operation_count += 1
            if operation_count > limit:
                raise BudgetError(
                    f"the program asks for more than {limit} operations; the machine's tick budget "
                    f"is {budget} and each counts as a tick at least, and a program with "
                    f"parameters may have {MOST_OPERATIONS}",
                    place=file.place(block.line),
                    remedy="Does a loop have no end? Lower its count, or raise tick_budget in the "
                    "machine file.",
                )
    if not has_moves:
        raise JobError(
            "the program moves nothing",
            place=file.place(),
            remedy="Name a file with a program that moves an axis.",
        )
    findings.length = lengths.line
    findings.unset = interpreter.values.unset
    findings.doubtful = interpreter.values.doubtful
    return Surveyed(program, findings, sorted(moved_axes))
