"""A run of an on/off machine: samples of its channels, kept in little memory.

Everything is read from the channels of the recording. The outputs show when a row of the schedule
took effect, so a cycle that waited for its inputs is judged at its own instants, simulated or live.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.intents import Scheduled, ScheduledMove
from threadline.commands.plan import Plan
from threadline.errors import RecordingError
from threadline.files import Channel, ChannelKind, Clock, Creep, Event, Recording
from threadline.verdict.coverage import Coverage, Lack
from threadline.verdict.finding import Hidden, RunFindings
from threadline.verdict.measure import Running, RunReading
from threadline.verdict.samples import Block, sample_interval_s

Samples: TypeAlias = NDArray[np.float64] | NDArray[np.int8]
"""Samples of a channel; switches are int8, an eighth of the memory."""


def compact(values: FloatArray) -> Samples:
    """Return the samples of a switch in an eighth of the memory; other samples unchanged."""
    if ((values == 0.0) | (values == 1.0)).all():
        return values.astype(np.int8)
    return values


def joined(parts: list[Samples]) -> Samples:
    """Return the parts of a channel joined, as integers if all parts are."""
    if all(part.dtype == np.int8 for part in parts):
        return np.concatenate(parts, dtype=np.int8)
    return np.concatenate(parts, dtype=np.float64)


def whole(values: Samples) -> NDArray[np.int8]:
    """Return the nearest state of an output; a value far from 0 and 1 stays far from both."""
    return np.clip(np.rint(values), -100, 100).astype(np.int8)


def sample_at(times_s: FloatArray, end_s: float) -> int:
    """Return the last sample at or before an instant; the first if all are later."""
    return max(int(np.searchsorted(times_s, end_s, side="right")) - 1, 0)


_ROUNDING_S = 1e-9
_ROUNDING = 1e-6  # of a sample: instants are sums
_NYQUIST = 0.5  # of a period from sample to sample: at this interval a sine may be 0 at each
_PER_PERIOD = 8.0  # samples in a period show an amplitude to 8 %
UNNAMED = "begin"
"""Name of the step of moves before the first named step of the list."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunStep:
    """A step of the cycle as it was recorded.

    Parameters
    ----------
    name, operation
        Name and operation of the step.
    begin_s, end_s
        Its instants in the recording; the end is the beginning of the next step.
    """

    name: str
    operation: int
    begin_s: float
    end_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RunMove:
    """A move as it was recorded.

    Parameters
    ----------
    planned
        The move of the schedule.
    target_m
        Its target.
    begin_s, end_s
        First and last switching, including the openings by which it crept to its switch.
    rest_s
        Instant at which the cylinder has come to rest: dead time and some lags after the last
        switching, as in the schedule.
    """

    planned: ScheduledMove
    target_m: float
    begin_s: float
    end_s: float
    rest_s: float


class SwitchRun:
    """A recording with its plan, read as a whole at the first access.

    Parameters
    ----------
    recording, plan
        The recording and its plan.

    Raises
    ------
    RecordingError
        If it has no outputs; when it is read, if a channel is damaged.
    """

    of: ClassVar[str] = "an on/off machine"
    absent: ClassVar[str] = "nothing of axis {axis} was measured"
    by_time = False
    fallback = None

    def __init__(self, recording: Recording, plan: Plan) -> None:
        self.plan = plan
        self.commands = plan.scheduled.commands
        self._coverage = Coverage(recording)
        self._holds: list[tuple[float, float]] = []  # start and end of each hold, s
        self.recording = self._coverage.watched
        missing = [
            name
            for name in self.commands.outputs
            if not any(c.name == name and c.kind is ChannelKind.OUTPUT for c in recording.channels)
        ]
        if missing:
            raise RecordingError(
                f"the recording has no output channel {missing[0]!r}",
                remedy="Record every output of the PLC, 0 or 1, in a table as a column "
                f'"{missing[0]}.output": they tell when it switched.',
            )

    @cached_property
    def _switched(self) -> tuple[FloatArray, NDArray[np.int8]]:
        """(n,) instants and (n, outputs) states of the outputs."""
        time_s, _ = self._samples(self.commands.outputs[0])
        columns = [whole(self._samples(name)[1]) for name in self.commands.outputs]
        if len(time_s) < 2 or any(len(v) != len(time_s) for v in columns):
            raise RecordingError("the output channels must have the same instants, two at least")
        states: NDArray[np.int8] = np.stack(columns, axis=1)
        outputs = [c for c in self.recording.channels if c.name in self.commands.outputs]
        # Until the first output is on, the cycle has not begun.
        begin_s = 0.0 if states[0].any() else np.inf
        lack = self._coverage.lack(outputs, begin_s, 0.0)
        if lack is not None:
            raise RecordingError(
                f"{lack.why}: nobody knows when the valves switched",
                remedy="Record every output of the PLC from the start of the cycle, without gaps.",
            )
        return time_s, states

    @property
    def time_s(self) -> FloatArray:
        """(n,) instants at which the outputs were recorded."""
        return self._switched[0]

    @property
    def states(self) -> NDArray[np.int8]:
        """(n, outputs) state of each output at each instant, 0 or 1."""
        return self._switched[1]

    @cached_property
    def ends(self) -> tuple[tuple[float, float], ...] | str:
        """Final position, m, and time, s, of each move, or why they are not known."""
        found = []
        loads = {a: self.find(ChannelKind.LOAD, a) for a in {m.planned.axis for m in self.moves}}
        for move in self.moves:
            axis, load = move.planned.axis, loads[move.planned.axis]
            if load is None:
                return self.why(ChannelKind.LOAD, axis)
            step = next(s for s in reversed(self.steps) if s.begin_s <= move.begin_s + 1e-9)
            why = self.ends_too_early(load[0], self.due_s(step, axis))
            if why:
                return why
            at = sample_at(load[0], self.quiet_s(step, axis)[1])
            found.append((float(load[1][at]), float(load[0][at])))
        return tuple(found)

    def release(self) -> None:
        """Discard all samples; keep steps, moves, switchings and final positions."""
        if self.steps:
            _ = self.ends, self.moves
        for samples in ("_channels", "_switched", "changes"):
            self.__dict__.pop(samples, None)

    @cached_property
    def _channels(self) -> Mapping[str, tuple[FloatArray, Samples]]:
        channels = self.recording.channels
        values: dict[str, list[Samples]] = {c.name: [] for c in channels}
        firsts: dict[str, list[int]] = {c.clock.name: [] for c in channels}
        events: list[Event] = []
        for block in self.recording:
            events += block.events
            for name, first in firsts.items():
                first.append(block.first_tick[name])
            for c in channels:
                values[c.name].append(compact(block.samples[c.name]))
        times: dict[tuple[str, int, tuple[int, ...]], FloatArray] = {}
        found: dict[str, tuple[FloatArray, Samples]] = {}
        for c in channels:
            parts = values.pop(c.name)
            pace = (c.clock.name, c.stride, tuple(len(part) for part in parts))
            if parts and pace not in times:  # channels with equal instants share them
                blocks = zip(firsts[c.clock.name], pace[2], strict=True)
                times[pace] = np.concatenate([c.clock.times_s(k, n, c.stride) for k, n in blocks])
            if parts:
                found[c.name] = (times[pace], joined(parts))
        self._holds = _held(events, self.recording.channel(self.commands.outputs[0]).clock)
        return found

    def held_s(self, begin_s: float, end_s: float) -> float:
        """Return the total time of holds between two instants, s."""
        return sum(max(min(b, end_s) - max(a, begin_s), 0.0) for a, b in self._holds)

    def _samples(self, name: str) -> tuple[FloatArray, FloatArray]:
        empty = np.empty(0)
        time_s, values = self._channels.get(name, (empty, empty))
        if not np.isfinite(values).all():
            raise RecordingError(
                f"channel {name!r} holds a value that is not finite",
                remedy="Repair the trace, or leave the channel out.",
            )
        return time_s, np.asarray(values, dtype=np.float64)

    def lacks(self, reading: RunReading, per_axis: bool) -> str:  # noqa: ARG002
        """Return nothing: each of its measures reports missing data itself, step by step."""
        return ""

    def blocks(self) -> Iterator[Block]:
        """Yield nothing: its measures read the whole run."""
        return iter(())

    def leave(self) -> None:
        """Do nothing: the run is read as a whole."""

    def results(self, running: Sequence[Running], last: Block | None) -> list[list[RunFindings]]:  # noqa: ARG002
        """Return the findings of each measure in the whole run."""
        found = [list(one.measure.finish()) for one in running]
        why = self.ends_too_early(self.time_s, self.end_s) if self.followed else ""
        if not why:
            return found
        # A finding without a step belongs to the whole cycle.
        return [
            [f if f.step else f.each(partial(replace, unseen=why)) for f in row] for row in found
        ]

    def unseen(self, reading: RunReading) -> str:  # noqa: ARG002
        """Return nothing: each measure reports its own missing samples."""
        return ""

    def find(self, kind: ChannelKind, axis: str) -> tuple[FloatArray, FloatArray] | None:
        """Return times, s, and values of a channel of ``axis``; None if samples are missing."""
        channel = self.recording.find(kind, axis)
        if channel is None or self._lack_of(channel) is not None:
            return None
        return self._samples(channel.name)

    def why(self, kind: ChannelKind, axis: str) -> str:
        """Return the reason for which ``find`` returns None."""
        channel = self.recording.find(kind, axis)
        lack = None if channel is None else self._lack_of(channel)
        return f"no {kind.value} channel of {axis}" if lack is None else lack.why

    def largest_share(self, axis: str, pole: complex) -> float:
        """Return which share of its amplitude a frame that rings reaches at a sample, at least.

        At samples T apart it is cos(pi T / P) for a period P: the motion between two of them is at
        most T / 2 from one. 0 where less than two samples lie in a period.
        """
        channel = self.recording.find(ChannelKind.FRAME, axis)
        assert channel is not None
        periods = sample_interval_s(channel) * abs(pole) / (2.0 * np.pi)
        return float(np.cos(np.pi * periods)) if periods < _NYQUIST else 0.0

    def hidden_ringing(self, axis: str, pole: complex, amplitude_m: float) -> Hidden:
        """Return by how much a frame may ring more than its samples show, m."""
        channel = self.recording.find(ChannelKind.FRAME, axis)
        assert channel is not None
        share, period_s = self.largest_share(axis, pole), 2.0 * np.pi / abs(pole)
        most_m = amplitude_m * (1.0 / share - 1.0) if share > 0.0 else np.inf
        why = f"the frame of {axis} rings with a period of {1e3 * period_s:.4g} ms"
        return Hidden(
            channel.name, sample_interval_s(channel), most_m, why, enough_s=period_s / _PER_PERIOD
        )

    def _lack_of(self, channel: Channel) -> Lack | None:
        """Return the missing part of a channel since the first switching, except its end."""
        begin_s = float(self.row_s[0]) if len(self.row_s) else 0.0
        return self._coverage.lack([channel], begin_s, 0.0)

    @cached_property
    def end_s(self) -> float:
        """End of the cycle, if the schedule was followed."""
        return self.instant_s(self.commands.duration_ticks)

    @staticmethod
    def ends_too_early(time_s: FloatArray, until_s: float) -> str:
        """Return that samples at ``time_s`` end before an instant; empty if they do not."""
        interval_s = float(time_s[-1] - time_s[-2]) if len(time_s) > 1 else 0.0
        if time_s[-1] + (1.0 + _ROUNDING) * interval_s + _ROUNDING_S >= until_s:
            return ""
        return f"the recording ends at {time_s[-1]:.6g} s, it is judged until {until_s:.6g} s"

    def due_s(self, step: RunStep, axis: str) -> float:
        """Return until when effects of ``step`` must be seen: at most until the cycle's end."""
        return min(self.quiet_s(step, axis)[1], self.end_s)

    @cached_property
    def changes(self) -> IntArray:
        """(k,) samples at which an output changes; everything is off before."""
        before = np.vstack((np.zeros_like(self.states[:1]), self.states[:-1]))
        return np.flatnonzero((before != self.states).any(axis=1))

    @cached_property
    def _followed(self) -> tuple[FloatArray, dict[int, float], float]:
        """Instants of rows, last end of openings by wait, and the first unscheduled switching."""
        rows, openings = list[float](), list[tuple[int, float]]()
        levels, opened = self.commands.levels, False
        creeps = self.commands.creeps_by_row()
        left_s = float(self.time_s[-1])
        for index in self.changes:
            row, state, now_s = len(rows), self.states[index], float(self.time_s[index])
            due = row < len(levels) and np.array_equal(state, levels[row])
            shown = tuple(state.tolist())
            creep = next((c for c in creeps.get(row - 1, ()) if c.levels == shown), None)
            if creep and not opened and not (due and self._on(creep, int(index))):
                openings.append((creep.tick, now_s))
                opened = True
            elif opened and np.array_equal(state, levels[row - 1]):
                openings[-1] = (openings[-1][0], now_s)
                opened = False
            elif due:
                rows.append(now_s)
                opened = False
            else:
                left_s = now_s
                break
        return np.array(rows), dict(openings), left_s

    def _on(self, creep: Creep, index: int) -> bool:
        """Return whether the switch of a creep was on at a sample of the outputs."""
        wait = next(e for e in self.commands.events if (e.kind, e.tick) == ("wait", creep.tick))
        time_s, values = self._samples(wait.name)
        if not len(time_s):
            return True
        return bool(values[sample_at(time_s, float(self.time_s[index]))])

    @property
    def row_s(self) -> FloatArray:
        """(followed rows,) instants at which the rows of the schedule took effect."""
        return self._followed[0]

    @property
    def left_s(self) -> float:
        """Instant of the first switching that is not in the schedule; the end if all are."""
        return self._followed[2]

    def _crept_s(self) -> Mapping[str, list[tuple[int, float]]]:
        """By cylinder: the ticks of the waits in which it crept to its switch, and the ends, s."""
        found: dict[str, list[tuple[int, float]]] = {}
        names = {e.tick: e.name for e in self.commands.events if e.kind == "wait"}
        for tick, end_s in self._followed[1].items():
            axis = str(self.plan.machine.contacts[names[tick]].cylinder)
            found.setdefault(axis, []).append((tick, end_s))
        return found

    @property
    def followed(self) -> bool:
        """Whether every row of the schedule was played, in its order."""
        return len(self.row_s) == len(self.commands.ticks)

    def instant_s(self, tick: int) -> float:
        """Return the instant, s, at which a tick of the schedule was played.

        It is counted back from the next switching, whose instant is known, or on from the last
        switching.
        """
        period_s = float(self.commands.clock.period_s)
        ticks = self.commands.ticks
        after = int(np.searchsorted(ticks, tick))
        if after < len(ticks):
            return float(self.row_s[after] - (ticks[after] - tick) * period_s)
        # After the last switching ticks follow at their period, except for waits.
        now_s, last = float(self.row_s[-1]), int(ticks[-1])
        for event in self.commands.events:
            if event.kind == "wait" and last <= event.tick < tick:
                now_s += (event.tick - last) * period_s
                now_s, last = self._came_s(event, now_s), event.tick
        return now_s + (tick - last) * period_s

    def _came_s(self, event: Event, from_s: float) -> float:
        time_s, values = self._samples(event.name)
        came = (time_s >= from_s - _ROUNDING_S) & ((values != 0) == bool(event.value))
        found = np.flatnonzero(came)
        if not len(found):
            return from_s  # the input never came, or was not recorded
        period_s = float(self.commands.clock.period_s)
        scans = np.ceil((time_s[found[0]] - from_s) / period_s - _ROUNDING_S)
        return float(from_s + scans * period_s)

    @cached_property
    def unseen_wait(self) -> str:
        """Why the wait after the last switching is unknown; empty if it is known.

        Earlier waits show in the switchings.
        """
        now_s = float(self.row_s[-1]) if len(self.row_s) else 0.0
        for event in self.commands.events:
            if event.kind == "wait" and event.tick >= self.commands.ticks[-1]:
                time_s, values = self._samples(event.name)
                if not len(time_s):
                    return f"no input channel {event.name}: how long the cycle waited is not known"
                if not ((time_s >= now_s) & ((values != 0) == bool(event.value))).any():
                    return f"the recording ends while the cycle waits for {event.name}"
        return ""

    @cached_property
    def steps(self) -> tuple[RunStep, ...]:
        """Every step of the cycle; empty unless the schedule was followed."""
        if not self.followed or not len(self.row_s):
            return ()
        named = [(e.tick, e.name, e.operation) for e in self.commands.events if e.kind == "tool"]
        first = min((move.first_tick for move in self.plan.scheduled.moves), default=0)
        if not named or first < named[0][0]:
            # Moves before the first named step belong to a step, too.
            start = int(self.commands.ticks[0])
            named.insert(0, (start, UNNAMED, int(self.commands.operation[0])))
        begins = [self.instant_s(tick) for tick, _, _ in named]
        ends = [*begins[1:], self.instant_s(self.commands.duration_ticks)]
        return tuple(
            RunStep(name=name, operation=operation, begin_s=begin, end_s=max(begin, end))
            for (_, name, operation), begin, end in zip(named, begins, ends, strict=True)
        )

    @cached_property
    def moves(self) -> tuple[RunMove, ...]:
        """Every move; empty unless the schedule was followed."""
        if not self.followed:
            return ()
        found, crept_s = [], self._crept_s()
        for move in reversed(self.plan.scheduled.moves):
            cylinder = self.plan.machine.cylinders[move.axis]
            mine = crept_s.get(move.axis, [])
            end_s = self.instant_s(move.last_tick)
            while mine and mine[-1][0] >= move.last_tick:
                end_s = max(end_s, mine.pop()[1])
            found.append(
                RunMove(
                    planned=move,
                    target_m=move.end_m,
                    begin_s=self.instant_s(move.first_tick),
                    end_s=end_s,
                    rest_s=end_s + cylinder.rest_s(move.forward),
                )
            )
        return tuple(reversed(found))

    def moves_of(self, axis: str) -> list[RunMove]:
        """Return the moves of one cylinder."""
        return [m for m in self.moves if m.planned.axis == axis]

    def quiet_s(self, step: RunStep, axis: str) -> tuple[float, float]:
        """Return the span in which effects of ``step`` are seen: from rest to the next move.

        It begins at the end of the motion, or at the beginning of the step if that is later. It
        ends with the next move of this cylinder; without one, with the recording or the cycle,
        whichever ends later.
        """
        mine = self.moves_of(axis)
        done = [m for m in mine if m.begin_s < step.end_s - _ROUNDING_S]
        later = [m for m in mine if m.begin_s >= step.end_s - _ROUNDING_S]
        begin_s = max([step.begin_s, *(m.rest_s for m in done)])
        last_s = max(float(self.time_s[-1]), self.end_s)
        return begin_s, min([last_s, *(m.begin_s for m in later)])


def _held(events: Sequence[Event], clock: Clock) -> list[tuple[float, float]]:
    """Return begin and end of each hold, s, except a hold in which the run ended."""
    found, since = [], None
    for event in events:
        if event.kind == "hold" and since is None:
            since = clock.time_s(event.tick)
        elif event.kind == "resume" and since is not None:
            found.append((since, clock.time_s(event.tick)))
            since = None
    return found


def steps_judged(plan: Plan) -> Mapping[str, Sequence[tuple[str, str]]]:
    """Return, by measure, the cylinders and named steps for which a run of a plan has results.

    The cylinder is ``""`` for a measure of all cylinders. Other kinds of plan have no steps: the
    result is empty.
    """
    if not isinstance(plan.intent, Scheduled):
        return {}
    begins = [(e.tick, e.name) for e in plan.intent.commands.events if e.kind == "tool"]
    moved = [
        (move.axis, next(name for tick, name in reversed(begins) if tick <= move.first_tick))
        for move in plan.intent.moves
        if begins and begins[0][0] <= move.first_tick
    ]
    return {
        "residual_vibration": [(axis, step) for axis in plan.axes for _, step in begins],
        "settling_time": [("", step) for _, step in moved],
        "end_position_error": moved,
    }
