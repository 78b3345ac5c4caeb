"""Runs of the rest of a job: where they begin, the approach, and their recording.

In the recording of a continued run, samples have their instants in the whole job. So the judge sees
which part is missing: the part before the first sample was not measured.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

import numpy as np

from threadline.base.arrays import IntArray
from threadline.commands.plan import Plan
from threadline.errors import CommandError, LimitError, OptionError
from threadline.files import Channel, ChannelKind, Event, RecordingBlock
from threadline.files.formats import read_recording
from threadline.jobs.needle_holes import hole_operations
from threadline.live.braking import CountLimits
from threadline.live.derived import Rest
from threadline.live.jogging import manual_feed
from threadline.live.kinds_run import run_kind_of
from threadline.live.states import Cause, Sink, State
from threadline.machine import Machine

_OF_RUNS = frozenset(
    ("hold", "resume", "late", "override", "completed", "stopped", "fault", "plan")
)
"""Kinds of events that belong to a run and not to its commands."""


class ContinuedSink:
    """Passes on samples and events from the operation on at which the work begins again.

    Parameters
    ----------
    sink
        Receiver of samples and events.
    machine
        Machine whose ticks are counted.
    left_out
        Ticks of the whole commands that were left out.
    operation
        First operation of work: earlier ones are repeated dry, with tools off.
    """

    def __init__(self, sink: Sink, machine: Machine, left_out: int, operation: int) -> None:
        self._sink, self._operation = sink, operation
        self._left_out_s: Fraction = left_out * machine.command_clock.period_s
        self._channels: tuple[Channel, ...] = ()
        self._works = False

    def begin(self, channels: tuple[Channel, ...], simulated: bool) -> None:
        """Pass on the channels."""
        self._channels = channels
        self._sink.begin(channels, simulated)

    def state(self, tick: int, state: State, cause: Cause, text: str) -> None:
        """Pass on a change of state."""
        self._sink.state(tick, state, cause, text)

    def block(self, block: RecordingBlock) -> None:
        """Pass on a block, shifted by the ticks left out, without its dry part."""
        dry_count = 0 if self._works else self._dry(block)
        clock = self._channels[0]
        ticks_later = round(self._left_out_s / clock.clock.period_s)
        first = block.first_tick[clock.clock.name] + ticks_later + dry_count * clock.stride
        self._sink.block(
            replace(
                block,
                first_tick={clock.clock.name: first},
                samples={name: values[dry_count:] for name, values in block.samples.items()},
                events=tuple(
                    self._later(event, ticks_later)
                    for event in block.events
                    if self._works or event.kind in _OF_RUNS
                ),
            )
        )

    def _later(self, event: Event, ticks: int) -> Event:
        """Return an event with its tick and time in the whole job."""
        shift_s = float(self._left_out_s) if event.kind == "plan" else 0.0
        return replace(event, tick=event.tick + ticks, value=event.value + shift_s)

    def _dry(self, block: RecordingBlock) -> int:
        """Return how many samples at the start of a block belong to operations before the work."""
        operation_channel = next(c for c in self._channels if c.kind is ChannelKind.OPERATION)
        work_samples = np.flatnonzero(block.samples[operation_channel.name] >= self._operation)
        self._works = len(work_samples) > 0
        return int(work_samples[0]) if self._works else len(block.samples[operation_channel.name])


_NUMBER = re.compile(r"[0-9]{1,12}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Continued:
    """A run of the rest of a job.

    Parameters
    ----------
    rest
        The commands to send.
    line
        Line of the job at which the work begins again, 0 for none.
    approach
        Moves, one after the other, to the starting place: the axis, and the position in counts.
    notes
        Description of the run for the operator, who must confirm it.
    """

    rest: Rest
    line: int
    approach: Sequence[tuple[str, int]]
    notes: Sequence[str]


def last_executed(trace: Path) -> int:
    """Return the last operation that a recording shows as executed.

    Raises
    ------
    CommandError
        If nothing was executed.
    """
    recording = read_recording(trace)
    channel = recording.find(ChannelKind.OPERATION)
    last = -1
    if channel is not None:
        for block in recording:
            values = block.samples[channel.name]
            last = max(last, int(np.nanmax(values, initial=-1.0)))
    if last < 0:
        raise CommandError("nothing of that run was executed", remedy="Run the job again.")
    return last


def operation_at(plan: Plan, executed: int, at: str) -> int:
    """Return the operation with which the work begins again.

    Parameters
    ----------
    executed
        The last operation that was executed.
    at
        ``block``: that operation. ``circuit``: the beginning of its circuit. ``circuit N`` or
        ``line N``: the last execution of this circuit, or of this line of the job. ``stitch N``:
        the stitch with that number, counted from 1; ``back N``: N stitches before the next one.

    Raises
    ------
    OptionError
        If it is none of these, or was not executed.
    """
    word, _, number = at.strip().partition(" ")
    if at.strip() == "block":
        return executed
    wrong = OptionError(
        f"--at {at[:40]!r} is no place of a job",
        remedy='Give "block", "circuit", "circuit 12", "line 40", "stitch 120" or "back 10".',
    )
    if word in {"stitch", "back"}:
        if not _NUMBER.fullmatch(number):
            raise wrong
        return _stitch_at(plan, executed, word, int(number))
    if word not in {"circuit", "line"} or (number and not _NUMBER.fullmatch(number)):
        raise wrong
    if word == "line" and not number:
        raise wrong
    begins: int | None = None
    previous_place: object = None
    for index, operation in enumerate(plan.job):
        if index > executed:
            break
        source = operation.source
        place = source.line if word == "line" else _circuit(operation)
        wanted = place is not None and (not number or place == int(number))
        if wanted and place != previous_place:
            begins = index
        previous_place = place
    if begins is None:
        raise OptionError(
            f"--at {at[:40]!r}: the run has not executed it",
            remedy='Give "block" for the place that it had reached.',
        )
    return begins


def _stitch_at(plan: Plan, executed: int, word: str, number: int) -> int:
    """Return the operation of a stitch that was reached; see ``operation_at``."""
    holes = hole_operations(plan.job)
    if not len(holes):
        raise OptionError(
            f"--at '{word} {number}': {plan.job.name} has no stitches", remedy='Give "block".'
        )
    reached = int(np.searchsorted(holes, executed, side="right"))  # with the one under way
    wanted = number if word == "stitch" else max(reached - number, 1)
    if not 1 <= wanted <= reached:
        raise OptionError(
            f"--at '{word} {number}': the run has reached stitch {reached}",
            remedy='Give a stitch up to that one, or "block".',
        )
    return int(holes[wanted - 1])


def _circuit(operation: object) -> int | None:
    """Return the circuit of an operation: its tag, or the pass of the outermost call."""
    circuit = getattr(operation, "tags", {}).get("circuit")
    if circuit is not None:
        return int(circuit)
    passes: tuple[int, ...] = getattr(operation, "source").passes  # noqa: B009
    return passes[0] if passes else None


def continued(plan: Plan, operation: int, *, at_rest: bool) -> Continued:
    """Return the run of rows, turns or scans from an operation on; see ``continued_by``.

    Parameters
    ----------
    at_rest
        Whether it may begin only at a rest: if the commands are not the path itself, a start from
        rest anywhere else would leave the path.
    """
    rest = run_kind_of(plan.machine).rest(plan.commands, plan.machine, operation, at_rest=at_rest)
    return continued_by(plan, rest)


def continued_by(plan: Plan, rest: Rest) -> Continued:
    """Return the run of the rest of a job; its approach is checked before anything moves.

    Raises
    ------
    LimitError
        If the approach leaves the travel of an axis.
    """
    machine = plan.machine
    begins = run_kind_of(machine).start(plan.commands)
    approach = [] if rest.dry else _approach(machine, begins, rest.begins)
    line = plan.intent.lines_of(plan.job, [rest.operation]).get(rest.operation, 0)
    return Continued(
        rest=rest, line=line, approach=approach, notes=_notes(machine, rest, line, approach)
    )


def _approach(machine: Machine, begins: IntArray, ends: IntArray) -> list[tuple[str, int]]:
    """Return the moves from home to a position, axis by axis in the order of the machine."""
    limits = CountLimits.of(machine)
    for k, axis in enumerate(machine.axes):
        is_beyond = ends[k] < limits.low[k], ends[k] > limits.high[k]
        if any(is_beyond):
            per_unit = machine.counts_per_unit[k]
            end = float((limits.low if is_beyond[0] else limits.high)[k] / per_unit)
            raise LimitError(
                f"axis {axis}: the approach goes to {ends[k] / per_unit:.4g}, beyond its travel, "
                f"which ends at {end:.4g}",
                axis=axis,
                quantity="position",
                value_si=float(ends[k] / per_unit),
                limit_si=end,
                remedy="Begin elsewhere: --at.",
            )
    return [
        (axis, int(to))
        for axis, stands, to in zip(machine.axes, begins, ends, strict=True)
        if stands != to
    ]


def _notes(
    machine: Machine, rest: Rest, line: int, approach: Sequence[tuple[str, int]]
) -> list[str]:
    begin_text = f"line {line} of the job" if line else f"operation {rest.operation}"
    if rest.dry:
        approach_text = (
            "it gets there by the program itself, with needle and tools off"
            if rest.operation
            else "it begins at once"
        )
        return [f"the work begins again at {begin_text}; {approach_text}"]
    names, scale = machine.axis_names, machine.counts_per_unit
    feed = manual_feed(machine)
    tick_s = float(machine.tick_clock.period_s)
    approach_moves = []
    for axis, to in approach:
        k = names.index(axis)
        linear = machine.axes[axis].kind == "linear"
        to_shown, unit = (1e3, "mm") if linear else (180.0 / np.pi, "deg")
        speed = feed[k] / scale[k] / tick_s * to_shown
        approach_moves.append(
            f"{axis} to {to / scale[k] * to_shown:.2f} {unit} at {speed:.3g} {unit}/s"
        )
    moves = "; then ".join(approach_moves) or "nothing has to move first"
    return [f"the work begins again at {begin_text}; from home: {moves}"]
