"""A plan as the program sent to a grbl controller, whole or from one of its lines on."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Mapping, Sequence
from contextvars import Context
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.firmware_program import planned_instants
from threadline.commands.plan import Plan
from threadline.errors import CommandError
from threadline.files import (
    Channel,
    ChannelKind,
    Clock,
    Event,
    EventKind,
    RecordingBlock,
    RunEnd,
    tick_table,
)
from threadline.live.derived import Rest, rest_from_row
from threadline.live.grbl_controller import Controller
from threadline.live.grbl_settings import units_of
from threadline.live.grbl_words import Program, program_of, runs_out
from threadline.live.kinds_run import run_kind_of
from threadline.live.states import Sink
from threadline.machine import Machine
from threadline.proof.kinds import kind_of

_TARGET = "grbl"
_FEED = re.compile(rb"F([\d.]+)")
_SWITCHES = re.compile(rb"(?<![A-Z0-9])(?:M[345789]|S[0-9.]+)(?![0-9.])")
_COOLANT = (b"M7", b"M8")
_WORKS = re.compile(rb"^(?:[XYZABCUVW]|G[014] |[MST])")
"""Lines that move, wait or switch; lines before the first of them prepare the controller."""
_SHIFTS = b"G92"
_CHANGE = re.compile(rb"^(?=.*\bM6\b).*$", re.MULTILINE)
"""A change of the tool, for which grbl has no word: its senders replace it by a stop."""
_MOTION = re.compile(rb"\bG[01]\b")


def written_program(plan: Plan) -> tuple[Program, Mapping[str, bytes]]:
    """Return the program of a plan, and its file by name.

    Raises
    ------
    PlanError
        If it contains characters that grbl executes at once.
    """
    machine = plan.machine
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "program.nc"
        # In a separate context: the file is written at once, and is no output of the command.
        Context().run(kind_of(machine).targets[_TARGET].write, plan, file)
        text = _CHANGE.sub(b"M0", file.read_bytes())
    starts = run_kind_of(machine).start(plan.commands) / machine.counts_per_unit
    program = program_of(text, machine.axis_names, units_of(machine), starts)
    begins_s = planned_instants(
        _TARGET, plan.job, plan.motion.trajectory, machine, override=plan.feed_override
    )
    rows = np.rint(begins_s / float(machine.tick_clock.period_s)).astype(np.int64)
    return replace(program, rows=rows, operations=_operations(plan, rows)), {file.name: text}


def _operations(plan: Plan, rows: IntArray) -> IntArray:
    """Return the operations at ascending ticks; after the last tick the last operation."""
    operations = np.zeros(len(rows), dtype=np.int64)
    for block in tick_table(plan.commands):
        if not len(block):
            continue
        begin, end = np.searchsorted(rows, [block.first_tick, block.first_tick + len(block)])
        operations[begin:end] = block.operation[rows[begin:end] - block.first_tick]
        operations[end:] = block.operation[-1]
    return operations


def rest_of_program(program: Program, plan: Plan, operation: int) -> tuple[Rest, Program]:
    """Return the rest of a job from an operation on, and the program for it.

    The rest begins with the line that is current when the operation begins; a line may span the
    ends of several operations. Before this line, the program repeats the lines that prepare the
    controller, and sets the feed, spindle, spindle speed or power, and coolant that are then in
    force. The program's zero (G92) is not sent again, since the controller still has it.

    Parameters
    ----------
    program
        The program of the whole plan, from ``written_program``.
    plan
        The plan.
    operation
        An operation of the job.

    Raises
    ------
    CommandError
        If the operation is not in this job.
    """
    machine, lines = plan.machine, program.lines
    working_lines = [k for k, line in enumerate(lines) if _WORKS.match(line)]
    began = _first_row(plan, operation)
    first = max(
        k for k in working_lines if k == working_lines[0] or program.rows[k] <= began + 1
    )  # it is rounded
    starts = run_kind_of(machine).start(plan.commands) / machine.counts_per_unit
    begins = program.ends[first - 1] if first else starts
    kept_lines = [line for line in lines[: working_lines[0]] if not line.startswith(_SHIFTS)]
    feeds = [word for line in lines[:first] for word in _FEED.findall(line)]
    motions = [word for line in lines[:first] for word in _MOTION.findall(line)]
    preparing = [
        *kept_lines,
        *([b"G1 F" + feeds[-1] + b"\n"] if feeds else []),
        *([b"G0\n"] if motions[-1:] == [b"G0"] else []),
        *_switched(lines[:first]),
    ]
    text = b"".join([*preparing, *lines[first:]])
    rest_program = program_of(text, machine.axis_names, units_of(machine), begins)
    row, line_operation = int(program.rows[first]), int(program.operations[first])
    if row >= began - 1:
        line_operation = operation
    rest_rows = rest_from_row(plan.commands, row, line_operation)
    counts = np.rint(begins * machine.counts_per_unit).astype(np.int64)
    return replace(rest_rows, begins=counts), replace(
        rest_program,
        rows=np.concatenate([np.full(len(preparing), row), program.rows[first:]]) - row,
        operations=np.concatenate(
            [np.full(len(preparing), line_operation), program.operations[first:]]
        ).clip(line_operation),
    )


def _switched(lines: Sequence[bytes]) -> list[bytes]:
    """Return the lines that restore the spindle and coolant state at the end of ``lines``."""
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
        rows = np.flatnonzero(block.operation >= operation)
        if len(rows):
            return block.first_tick + int(rows[0])
    raise CommandError(
        f"operation {operation} is not in this job", remedy="Continue the run of this job."
    )


def notes_on(program: Program, controller: Controller) -> tuple[str, ...]:
    """Return notes for the operator about a program, before it is sent to a controller."""
    goes_s, _ = runs_out(program, controller.blocks, controller.room)
    return (
        "grbl plans its own ramps: what is proved is the program's path, not its timing",
        f"if the link is lost, the controller executes its buffer: up to {goes_s:.1f} s at "
        "these feeds",
    )


_CLOCK = Clock("reports", Fraction(1, 100))


class ReportTrace:
    """Writes the reports of a run into a sink.

    A report gives the controller's stepped position, which is its command: nothing is measured.
    Samples are interpolated on straight lines between reports.

    Parameters
    ----------
    machine
        Machine with the axes.
    sink
        Receiver of the blocks.

    Attributes
    ----------
    tick
        Number of the next sample.
    channels
        A commanded position for each axis, and the current operation.
    """

    def __init__(self, machine: Machine, sink: Sink) -> None:
        self._sink = sink
        places = (
            Channel(
                name=f"{name}.commanded",
                kind=ChannelKind.COMMANDED,
                unit="m" if axis.kind == "linear" else "rad",
                clock=_CLOCK,
                axis=name,
            )
            for name, axis in machine.axes.items()
        )
        operation = Channel(name="operation", kind=ChannelKind.OPERATION, unit="", clock=_CLOCK)
        self.channels: tuple[Channel, ...] = (*places, operation)
        self.tick = 0
        self._sample_s, self._before = 0.0, np.zeros(len(machine.axes))

    def begin(self, at: FloatArray) -> None:
        """Begin at a position, and announce the channels to the sink."""
        self.again(at)
        self._sink.begin(self.channels, False)

    def again(self, at: FloatArray) -> None:
        """Begin another run at a position, with the channels already announced."""
        self.tick, self._sample_s, self._before = 0, 0.0, at

    def record(
        self, now_s: float, at: FloatArray, begins: FloatArray, operations: IntArray
    ) -> None:
        """Record the samples up to a report.

        Parameters
        ----------
        now_s, at
            Time of the run, and the position.
        begins, operations
            (n,) shares of the motion since the last report at which another line began, and
            (n + 1,) the operations.
        """
        period_s = float(_CLOCK.period_s)
        times_s = period_s * np.arange(self.tick, int(now_s / period_s) + 1)
        report_times_s = [self._sample_s, max(now_s, self._sample_s + 1e-9)]
        samples = {
            channel.name: np.interp(times_s, report_times_s, [self._before[k], at[k]])
            for k, channel in enumerate(self.channels[:-1])
        }
        shares = np.interp(times_s, report_times_s, [0.0, 1.0])
        operations_now = operations[np.searchsorted(begins, shares, side="right")]
        samples[self.channels[-1].name] = operations_now.astype(np.float64)
        if len(times_s):
            self._put(samples)
        self.tick += len(times_s)
        self._sample_s, self._before = now_s, at

    def end(self, ended: RunEnd, text: str) -> None:
        """Record how the run ended."""
        self.note(ended.value, text)

    def note(self, kind: EventKind, text: str, operation: int = -1) -> None:
        """Record an event at the next sample, with its text and operation."""
        event = Event(tick=self.tick, kind=kind, operation=operation, name=text)
        self._put({channel.name: np.empty(0) for channel in self.channels}, event)

    def _put(self, samples: dict[str, FloatArray], *events: Event) -> None:
        first = {_CLOCK.name: self.tick}
        self._sink.block(RecordingBlock(first_tick=first, samples=samples, events=events))
