"""The first pass over a program with parameters: one run, in which it is counted."""

from __future__ import annotations

from dataclasses import dataclass

from threadline.errors import BudgetError, JobError
from threadline.jobs.gcode.dialects import Reading
from threadline.jobs.gcode.f_words import FRule
from threadline.jobs.gcode.findings import Findings
from threadline.jobs.gcode.parametric.program import ParametricInterpreter, ParametricProgram
from threadline.jobs.gcode.textfile import SourceFile
from threadline.jobs.gcode.work_offsets import SystemsUsed, zeros_of
from threadline.jobs.operations import Move
from threadline.machine import Machine

MOST_OPERATIONS = 5_000_000
"""Moves, chords of arcs, dwells and such that a program with parameters may come to."""


@dataclass(frozen=True, slots=True)
class Surveyed:
    """A program, what was found in its first run, and the indices of the axes that it names."""

    program: ParametricProgram
    findings: Findings
    moved: list[int]


def survey(
    file: SourceFile, reading: Reading, linear: tuple[bool, ...], rule: FRule, machine: Machine
) -> Surveyed:
    """Run a program once.

    Where it moves in several coordinate systems it is run a second time, with their zeros, since
    its own position is among what it can ask for.

    Raises
    ------
    JobError
        If it cannot be read, runs too long, or moves nothing.
    BudgetError
        If it has more operations than the machine's tick budget.
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
    moved: set[int] = set()
    budget = int(machine.tick_budget.si)
    most = min(budget, MOST_OPERATIONS)
    operations, moves, motion = 0, False, -1
    interpreter = ParametricInterpreter(program)
    for block, made in interpreter.blocks():
        motion = block.motion if block.motion >= 0 else motion
        if block.feed is not None and block.axes and motion == 0 and not findings.rapid_f:
            findings.rapid_f = block.line
        findings.note(None, block)
        moved.update(index for index, _ in block.axes)
        systems.take(block.settings, block.line, moves=block.goes)
        for operation in made:
            moves = moves or isinstance(operation, Move)
            operations += 1
            if operations > most:
                raise BudgetError(
                    f"the program asks for more than {most} operations; the machine's tick budget "
                    f"is {budget} and each counts as a tick at least, and a program with "
                    f"parameters may have {MOST_OPERATIONS}",
                    place=file.place(block.line),
                    remedy="Does a loop have no end? Lower its count, or raise tick_budget in the "
                    "machine file.",
                )
    if not moves:
        raise JobError(
            "the program moves nothing",
            place=file.place(),
            remedy="Name a file with a program that moves an axis.",
        )
    findings.unset = interpreter.values.unset
    findings.doubtful = interpreter.values.doubtful
    return Surveyed(program, findings, sorted(moved))
