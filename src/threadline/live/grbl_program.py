"""A plan as the program that a controller with grbl is sent, whole or from one of its lines on."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping, Sequence
from contextvars import Context
from dataclasses import replace
from pathlib import Path

import numpy as np

from threadline.arrays import IntArray
from threadline.errors import CommandError
from threadline.kinds import kind_of
from threadline.live.derived import Rest, rest_from_row
from threadline.live.grbl_controller import Controller, units_of
from threadline.live.grbl_words import Program, program_of, runs_out
from threadline.live.ways import way_of
from threadline.plan import Plan
from threadline.signals import tick_table
from threadline.targets.firmware_program import planned_instants

_TARGET = "grbl"
_FEED = re.compile(rb"F([\d.]+)")
_SWITCHES = re.compile(rb"(?<![A-Z0-9])(?:M[345789]|S[0-9.]+)(?![0-9.])")
_COOLANT = (b"M7", b"M8")
_WORKS = re.compile(rb"^(?:[XYZABCUVW]|G[014] |[MST])")
"""Lines that move, wait or switch; what stands before the first of them prepares the controller."""
_SHIFTS = b"G92"
_CHANGE = re.compile(rb"^(?=.*\bM6\b).*$", re.MULTILINE)
"""A change of the tool, for which grbl has no word: who sends it programs makes a stop of it."""
_MOTION = re.compile(rb"\bG[01]\b")


def written_program(plan: Plan) -> tuple[Program, Mapping[str, bytes]]:
    """Return the program of a plan, and the file that it was read from, by its name.

    Raises
    ------
    PlanError
        If it holds what grbl would act on at once.
    """
    machine = plan.machine
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "program.nc"
        # In a context of its own it is there at once, and no output of the command.
        Context().run(kind_of(machine).targets[_TARGET].write, plan, file)
        text = _CHANGE.sub(b"M0", file.read_bytes())
    starts = way_of(machine).start(plan.commands) / machine.counts_per_unit
    program = program_of(text, machine.axis_names, units_of(machine), starts)
    begins_s = planned_instants(
        _TARGET, plan.job, plan.motion.trajectory, machine, override=plan.feed_override
    )
    rows = np.rint(begins_s / float(machine.tick_clock.period_s)).astype(np.int64)
    return replace(program, rows=rows, operations=_operations(plan, rows)), {file.name: text}


def _operations(plan: Plan, rows: IntArray) -> IntArray:
    """Return the operations of ticks that never fall; behind the last tick that of the last."""
    found = np.zeros(len(rows), dtype=np.int64)
    for block in tick_table(plan.commands):
        if not len(block):
            continue
        begin, end = np.searchsorted(rows, [block.first_tick, block.first_tick + len(block)])
        found[begin:end] = block.operation[rows[begin:end] - block.first_tick]
        found[end:] = block.operation[-1]
    return found


def rest_of_program(program: Program, plan: Plan, operation: int) -> tuple[Rest, Program]:
    """Return the rest of a job from an operation on, and the program that does it.

    It begins with the line that was to be under way when the operation began: a line goes on over
    the ends of operations that lie on it. What prepares the controller, the feed in force, and
    spindle, its speed or power, and coolant as they were come before it. Where the program's zero
    is the controller still knows.

    Parameters
    ----------
    program
        That of the whole plan, as ``written_program`` returns it.
    plan
        The plan.
    operation
        An operation of the job.

    Raises
    ------
    CommandError
        If it is none of this job.
    """
    machine, lines = plan.machine, program.lines
    works = [k for k, line in enumerate(lines) if _WORKS.match(line)]
    began = _first_row(plan, operation)
    first = max(k for k in works if k == works[0] or program.rows[k] <= began + 1)  # it is rounded
    starts = way_of(machine).start(plan.commands) / machine.counts_per_unit
    begins = program.ends[first - 1] if first else starts
    before = [line for line in lines[: works[0]] if not line.startswith(_SHIFTS)]
    feeds = [found for line in lines[:first] for found in _FEED.findall(line)]
    motions = [found for line in lines[:first] for found in _MOTION.findall(line)]
    again = [
        *before,
        *([b"G1 F" + feeds[-1] + b"\n"] if feeds else []),
        *([b"G0\n"] if motions[-1:] == [b"G0"] else []),
        *_switched(lines[:first]),
    ]
    text = b"".join([*again, *lines[first:]])
    rest = program_of(text, machine.axis_names, units_of(machine), begins)
    row, of = int(program.rows[first]), int(program.operations[first])
    if row >= began - 1:
        of = operation
    found = rest_from_row(plan.commands, row, of)
    counts = np.rint(begins * machine.counts_per_unit).astype(np.int64)
    return replace(found, begins=counts), replace(
        rest,
        rows=np.concatenate([np.full(len(again), row), program.rows[first:]]) - row,
        operations=np.concatenate([np.full(len(again), of), program.operations[first:]]).clip(of),
    )


def _switched(lines: Sequence[bytes]) -> list[bytes]:
    """Return the lines that switch spindle and coolant as some lines leave them."""
    speed = spindle = b""
    coolant: list[bytes] = []
    for word in (word for line in lines for word in _SWITCHES.findall(line)):
        if word.startswith(b"S"):
            speed = word
        elif word == b"M9":
            coolant = [word]
        elif word in _COOLANT:
            coolant = [*(one for one in coolant if one not in {word, b"M9"}), word]
        else:
            spindle = word
    return [
        b" ".join(filter(None, words)) + b"\n"
        for words in ((spindle, speed), coolant)
        if any(words)
    ]


def _first_row(plan: Plan, operation: int) -> int:
    for block in tick_table(plan.commands):
        of = np.flatnonzero(block.operation >= operation)
        if len(of):
            return block.first_tick + int(of[0])
    raise CommandError(
        f"operation {operation} is none of this job", remedy="Continue the run of this job."
    )


def notes_on(program: Program, controller: Controller) -> tuple[str, ...]:
    """Return what the operator has to know before a program is sent to a controller."""
    goes_s, _ = runs_out(program, controller.blocks, controller.room)
    return (
        "grbl plans its own ramps: what is proved is the program's path, not its timing",
        f"if the link is lost, the controller runs out its own buffer: up to {goes_s:.1f} s at "
        "these feeds",
    )
