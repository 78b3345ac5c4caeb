"""Jogs and moves by hand, and the test whether a machine's loops have come to rest.

Accelerating and braking are state-to-state moves of ruckig, time-optimal within the limits of
velocity, acceleration and jerk. All numbers are in counts and ticks.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil

import numpy as np
from ruckig import ControlInterface, InputParameter, Ruckig, Trajectory

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import CommandError
from threadline.live.ahead import SETTLE_S, ticks_in
from threadline.live.braking import CountLimits
from threadline.live.pace import place_words, speed_words
from threadline.live.wire import Message
from threadline.machine import Machine

STILL_S = 0.1
"""Machine time in s for which every encoder must stay within a count."""
_COUNTS = 1.5


class Stillness:
    """Recent readings of a machine's encoders, over machine time.

    The slowest pole of ``lathe-winder``, in the loop of Y, has a time constant of 66 ms: an axis
    that moves by at most one count in 100 ms is within 0.3 counts of its final position. If a loop
    keeps ringing, the wait ends after the time for which a run is recorded after its last row.
    """

    def __init__(self, machine: Machine) -> None:
        self._wait, self._most = ticks_in(STILL_S, machine), ticks_in(SETTLE_S, machine)
        self._room = {
            f"{name}.measured": _COUNTS / scale
            for name, scale in zip(machine.axes, machine.counts_per_unit, strict=True)
        }
        self._within: dict[str, tuple[float, float]] = {}  # range of each encoder since it moved
        self._since = 0  # tick from which on all of them were still

    def hear(self, tick: int, samples: Mapping[str, FloatArray]) -> None:
        """Process a report.

        Parameters
        ----------
        tick
            Tick of the commands at the end of the report.
        samples
            (n,) samples of each channel.
        """
        for name, room in self._room.items():
            readings = samples.get(name)
            if readings is None or not len(readings):
                continue
            latest = float(readings[-1])
            low, high = self._within.get(name, (latest, latest))
            low, high = min(low, float(readings.min())), max(high, float(readings.max()))
            if high - low > room:
                low, high, self._since = latest, latest, tick
            self._within[name] = low, high

    def settled(self, tick: int, end: int) -> bool:
        """Return whether all encoders are still at a tick, after commands that ended at ``end``.

        Without encoders the answer is always yes.
        """
        since = max(end, self._since)
        return not self._within or tick >= min(since + self._wait, end + self._most)


_PAST_TICKS = 4  # ticks kept behind the machine


@dataclass(frozen=True, slots=True)
class _At:
    """Position of the axis in counts, and its velocity and acceleration per tick and tick^2."""

    position: float
    velocity: float
    acceleration: float


class JogAhead:
    """The part of a jog that was sent to the machine, as a state for each tick.

    Parameters
    ----------
    machine
        Machine whose limits are kept.
    stands
        (axes,) position at the beginning, in counts.
    axis
        Name of the axis that moves.
    velocity
        Velocity in m/s or rad/s; its sign is the direction.

    Raises
    ------
    CommandError
        If there is no such axis, or the velocity is above its manual feed.
    """

    keeps_home = True
    halt = None
    settle_ticks = 0

    def __init__(self, machine: Machine, stands: IntArray, axis: str, velocity: float) -> None:
        if axis not in machine.axes:
            raise CommandError(
                f"there is no axis {axis[:20]!r}", remedy=f"There are {', '.join(machine.axes)}."
            )
        self._column = machine.axis_names.index(axis)
        counts_per_speed = machine.counts_per_unit[self._column] * float(
            machine.tick_clock.period_s
        )
        limits = CountLimits.of(machine)
        max_feed = manual_feed(machine)[self._column]
        if not abs(velocity) * counts_per_speed <= max_feed * (1.0 + 1e-9):
            raise CommandError(
                f"axis {axis}: {speed_words(machine, axis, abs(velocity))} is faster than the "
                f"manual feed, {speed_words(machine, axis, max_feed / counts_per_speed)}",
                remedy="Jog more slowly, or change operator.manual_feed in the machine file.",
            )
        self._target = velocity * counts_per_speed
        self._low, self._high = float(limits.low[self._column]), float(limits.high[self._column])
        self._otg, self._asked = Ruckig(1), InputParameter(1)
        self._asked.control_interface = ControlInterface.Velocity
        self._asked.max_acceleration = [float(limits.acceleration[self._column])]
        self._asked.max_jerk = [float(limits.jerk[self._column])]
        self._stands = stands
        self._first = 0  # tick of the first state that is kept
        self._states = [_At(float(stands[self._column]), 0.0, 0.0)]
        self._before_cut: tuple[int, list[_At], float] | None = None
        self._still = Stillness(machine)
        self.why = ""
        """Why the jog ended before the operator let go; empty if it did not."""

    @property
    def end(self) -> int:
        """Tick up to which rows were sent, without the braking tail."""
        return self._first + len(self._states) - 1

    @property
    def complete(self) -> bool:
        """Whether the sent rows end at rest."""
        return self._target == 0.0 and self._states[-1].velocity == 0.0

    def measured(self, tick: int, samples: Mapping[str, FloatArray]) -> None:
        """Process the encoder readings of a report that ends at a tick; see ``Stillness``."""
        self._still.hear(tick, samples)

    def settled(self, tick: int) -> bool:
        """Whether the loops have come to rest at a tick, at the end of the sent rows."""
        return self._still.settled(tick, self.end)

    def forget(self, tick: int) -> None:
        """Delete the states before ``tick``."""
        forgotten_count = min(tick - _PAST_TICKS - self._first, len(self._states) - 1)
        if forgotten_count > 0:
            self._states = self._states[forgotten_count:]
            self._first += forgotten_count

    def extend(self, until: int) -> Message:
        """Return the refill with the rows up to tick ``until``, and a braking tail."""
        first_tick, self._before_cut = self.end, None
        for _ in range(first_tick, until):
            if self.complete:
                break
            next_state = self._step(self._states[-1], self._target)
            rest_position = self._rest(next_state)
            if self._target and not self._low <= rest_position <= self._high:
                self._target, self.why = 0.0, "the end of its travel"
                next_state = self._step(self._states[-1], 0.0)
            self._states.append(next_state)
        return self._refill(first_tick, self._braking(self._states[-1])[1:])

    def cut(self, tick: int) -> Message:
        """Return the refill that brakes from ``tick`` on."""
        tick = min(max(tick, self._first), self.end)
        self._before_cut = (self._first, self._states, self._target)
        kept_states = self._states[: tick - self._first + 1]
        self._target, self._states = 0.0, [*kept_states, *self._braking(kept_states[-1])[1:]]
        return self._refill(tick, [])

    def undo(self) -> bool:
        """Undo the last cut, which the machine refused; return whether there was one."""
        if self._before_cut is None:
            return False
        (self._first, self._states, self._target), self._before_cut = self._before_cut, None
        return True

    def _trajectory(self, state: _At, target: float) -> Trajectory:
        request = self._asked
        request.current_position = [state.position]
        request.current_velocity = [state.velocity]
        request.current_acceleration = [state.acceleration]
        request.target_velocity, request.target_acceleration = [target], [0.0]
        trajectory = Trajectory(1)
        self._otg.calculate(request, trajectory)
        return trajectory

    def _step(self, state: _At, target: float) -> _At:
        return _state(self._trajectory(state, target), 1.0)

    def _braking(self, state: _At) -> list[_At]:
        """Return the states at the ticks from now on until it rests."""
        trajectory = self._trajectory(state, 0.0)
        tick_count = ceil(trajectory.duration - 1e-9)
        states = [_state(trajectory, float(k)) for k in range(1, tick_count)]
        if tick_count:
            states.append(_At(_state(trajectory, float(trajectory.duration)).position, 0.0, 0.0))
        return [state, *states]

    def _rest(self, state: _At) -> float:
        """Return the position of the last state of ``_braking``, without the others."""
        trajectory = self._trajectory(state, 0.0)
        is_at_rest = trajectory.duration <= 1e-9
        return (
            state.position
            if is_at_rest
            else _state(trajectory, float(trajectory.duration)).position
        )

    def _refill(self, first_tick: int, tail: list[_At]) -> Message:
        """Return the refill from a tick on, with a braking tail after it."""
        states = [*self._states[first_tick - self._first :], *tail]
        position_counts = np.rint([state.position for state in states]).astype(np.int64)
        counts = np.zeros((len(position_counts) - 1, len(self._stands)), dtype=np.int64)
        counts[:, self._column] = np.diff(position_counts)
        start_counts = np.zeros_like(self._stands)
        start_counts[self._column] = position_counts[0] - self._stands[self._column]
        head = {"first": first_tick, "wanted": self.end - first_tick, "last": False, "events": []}
        arrays = {"at": start_counts, "counts": counts, "operation": np.full(len(counts), -1)}
        return Message("refill", head, arrays)


class MoveAhead(JogAhead):
    """A jog that ends at a position, at the manual feed.

    Parameters
    ----------
    machine, stands, axis
        As in ``JogAhead``.
    to_counts
        Final position, in counts.

    Raises
    ------
    CommandError
        If there is no such axis, or the position lies beyond its travel.
    """

    def __init__(self, machine: Machine, stands: IntArray, axis: str, to_counts: int) -> None:
        super().__init__(machine, stands, axis, 0.0)
        if not self._low <= to_counts <= self._high:
            target, low, high = (
                place_words(machine, axis, counts / machine.counts_per_unit[self._column])
                for counts in (to_counts, self._low, self._high)
            )
            raise CommandError(
                f"axis {axis}: {target} is beyond its travel, {low} to {high}",
                remedy="Move the position where the job starts.",
            )
        inputs = InputParameter(1)
        inputs.current_position = [self._states[0].position]
        inputs.target_position = [float(to_counts)]
        inputs.max_velocity = [float(manual_feed(machine)[self._column])]
        inputs.max_acceleration = self._asked.max_acceleration
        inputs.max_jerk = self._asked.max_jerk
        self._way, self._ends = Trajectory(1), float(to_counts)
        self._otg.calculate(inputs, self._way)
        self._target = self._ends - self._states[0].position  # not 0, which means braking

    def _step(self, state: _At, target: float) -> _At:
        tick = self.end + 1
        if target == 0.0:  # it brakes, or has reached its end
            return super()._step(state, 0.0)
        if tick < self._way.duration:
            return _state(self._way, float(tick))
        self._target = 0.0
        return _At(self._ends, 0.0, 0.0)


def manual_feed(machine: Machine) -> FloatArray:
    """Return the (axes,) largest speeds of jogs in counts per tick.

    This is the operator's manual feed, or without one a tenth of the axes' limits.
    """
    max_velocity = CountLimits.of(machine).velocity
    feed = None if machine.operator is None else machine.operator.manual_feed
    return np.minimum(max_velocity, 0.1 * max_velocity if feed is None else feed.si)


def _state(trajectory: Trajectory, time: float) -> _At:
    position, velocity, acceleration = trajectory.at_time(time)
    return _At(float(position[0]), float(velocity[0]), float(acceleration[0]))
