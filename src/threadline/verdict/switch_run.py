"""What an on/off machine did, laid beside its schedule: when each switching came, and each step.

Everything is read from the channels of the recording. The outputs tell when a row of the schedule
took effect, so that a cycle that waited for its inputs is judged at its own instants, simulated
or live.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import RecordingError
from threadline.plan import SwitchPlan
from threadline.signals import ChannelKind, Event, Recording
from threadline.targets.schedule import REST_LAGS, ScheduledMove

_ROUNDING_S = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class RunStep:
    """A step of the cycle as it was recorded.

    Parameters
    ----------
    name, operation
        Of the step.
    begin_s, end_s
        Its instants in the recording; the end is the beginning of the next.
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
        Where it was to go.
    begin_s, end_s
        First and last switching.
    rest_s
        When the cylinder has come to rest: its dead time and some lags after the last switching,
        as the schedule has it.
    """

    planned: ScheduledMove
    target_m: float
    begin_s: float
    end_s: float
    rest_s: float


class SwitchRun:
    """A recording beside its plan; the whole of it in memory, for a cycle takes seconds.

    Parameters
    ----------
    recording, plan
        The two.

    Raises
    ------
    RecordingError
        If there are no outputs in it, or a channel is damaged.
    """

    def __init__(self, recording: Recording, plan: SwitchPlan) -> None:
        self.plan = plan
        self.commands = plan.commands
        self._recording = recording
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
        columns = [self._samples(name) for name in self.commands.outputs]
        self.time_s = columns[0][0]
        if len(self.time_s) < 2 or any(len(v) != len(self.time_s) for _, v in columns):
            raise RecordingError("the output channels must have the same instants, two at least")
        self.states: IntArray = np.rint(np.stack([v for _, v in columns], axis=1)).astype(np.int64)

    @cached_property
    def _channels(self) -> Mapping[str, tuple[FloatArray, FloatArray]]:
        times: dict[str, list[FloatArray]] = {c.name: [] for c in self._recording.channels}
        values: dict[str, list[FloatArray]] = {c.name: [] for c in self._recording.channels}
        for block in self._recording:
            for c in self._recording.channels:
                part = block.samples[c.name]
                first = block.first_tick[c.clock.name]
                times[c.name].append(c.clock.times_s(first, len(part), c.stride))
                values[c.name].append(part)
        return {
            name: (np.concatenate(times[name]), np.concatenate(values[name]))
            for name in times
            if times[name]
        }

    def _samples(self, name: str) -> tuple[FloatArray, FloatArray]:
        empty = np.empty(0)
        time_s, values = self._channels.get(name, (empty, empty))
        if not np.isfinite(values).all():
            raise RecordingError(
                f"channel {name!r} holds a value that is not finite",
                remedy="Repair the trace, or leave the channel out.",
            )
        return time_s, values

    def find(self, kind: ChannelKind, axis: str) -> tuple[FloatArray, FloatArray] | None:
        """Return times, s, and values of a channel of ``axis``, or None where there is none."""
        channel = self._recording.find(kind, axis)
        return None if channel is None else self._samples(channel.name)

    @cached_property
    def changes(self) -> IntArray:
        """(k,) samples at which an output is another than before; everything is off before."""
        before = np.vstack((np.zeros_like(self.states[:1]), self.states[:-1]))
        return np.flatnonzero((before != self.states).any(axis=1))

    @cached_property
    def row_s(self) -> FloatArray:
        """(rows that were followed,) instants at which the rows of the schedule took effect."""
        found = []
        for index, row in zip(self.changes, self.commands.levels, strict=False):
            if not np.array_equal(self.states[index], row):
                break
            found.append(float(self.time_s[index]))
        return np.array(found)

    @property
    def followed(self) -> bool:
        """Whether every row of the schedule was played, in its order."""
        return len(self.row_s) == len(self.commands.ticks)

    def instant_s(self, tick: int) -> float:
        """Return when a tick of the schedule came, by the switchings about it."""
        period_s = float(self.commands.clock.period_s)
        ticks = self.commands.ticks
        after = int(np.searchsorted(ticks, tick))
        if after < len(ticks):
            return float(self.row_s[after] - (ticks[after] - tick) * period_s)
        # Behind the last switching: time goes on, but stands still at waits.
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
            return from_s  # not recorded, or it never came: no more is known
        period_s = float(self.commands.clock.period_s)
        scans = np.ceil((time_s[found[0]] - from_s) / period_s - _ROUNDING_S)
        return float(from_s + scans * period_s)

    @cached_property
    def steps(self) -> tuple[RunStep, ...]:
        """Every step of the cycle; none unless the schedule was followed."""
        events = [e for e in self.commands.events if e.kind == "tool"]
        if not self.followed or not len(self.row_s):
            return ()
        begins = [self.instant_s(e.tick) for e in events]
        ends = [*begins[1:], self.instant_s(self.commands.duration_ticks)]
        return tuple(
            RunStep(name=e.name, operation=e.operation, begin_s=begin, end_s=max(begin, end))
            for e, begin, end in zip(events, begins, ends, strict=True)
        )

    @cached_property
    def moves(self) -> tuple[RunMove, ...]:
        """Every move; none unless the schedule was followed."""
        if not self.followed:
            return ()
        position = dict(zip(self.plan.job.axes, self.plan.job.start, strict=True))
        found = []
        for move in self.plan.scheduled.moves:
            cylinder = self.plan.machine.cylinders[move.axis]
            position[move.axis] += move.levels.wanted_m * (1.0 if move.forward else -1.0)
            end_s = self.instant_s(move.last_tick)
            found.append(
                RunMove(
                    planned=move,
                    target_m=position[move.axis],
                    begin_s=self.instant_s(move.first_tick),
                    end_s=end_s,
                    rest_s=end_s + cylinder.delay.si + REST_LAGS * cylinder.lag.si,
                )
            )
        return tuple(found)

    def moves_of(self, axis: str) -> list[RunMove]:
        """Return the moves of one cylinder."""
        return [m for m in self.moves if m.planned.axis == axis]

    def quiet_s(self, step: RunStep, axis: str) -> tuple[float, float]:
        """Return the span in which what ``step`` leaves is seen: at rest, until it moves again.

        From the end of the motion, or the beginning of the step where that is later, to the next
        move of this cylinder or the end of the recording.
        """
        mine = self.moves_of(axis)
        done = [m for m in mine if m.begin_s < step.end_s - _ROUNDING_S]
        later = [m for m in mine if m.begin_s >= step.end_s - _ROUNDING_S]
        begin_s = max([step.begin_s, *(m.rest_s for m in done)])
        return begin_s, min([float(self.time_s[-1]), *(m.begin_s for m in later)])
