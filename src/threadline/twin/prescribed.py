"""Machines whose drives are told positions, simulated exactly from tick to tick.

Within a tick the pulses come evenly: the motor runs at a constant speed, and its load, a linear
network on the other end of belt and gear, is advanced by one matrix exponential. What the load, the
rotor and friction ask of the motor stands beside what its curve has at that speed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.sources import PulseServo, Source
from threadline.plant.prescribed import Prescribed, prescribed, resonance_hz
from threadline.recent import Recent

_MOST_AVERAGED = 1_000_000
"""Ticks of which the speeds are kept: of the slowest swing of a stepper."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Advance:
    """A piece ready to be run; its state is ``[x, positions and speeds of its servos]``.

    Parameters
    ----------
    piece, sources
        Equations and drives.
    step
        (m, m) of the state over a tick.
    by_position, by_speed
        (m, s) of what the drives are told: where they are at the tick, and their speed in it.
    servo
        (s,) place of each drive's position in the state, -1 of a stepper.
    averaged
        (s,) ticks over which a stepper's acceleration is averaged: half a period of its own
        resonance, in which its magnetic spring takes up a microstep more or less.
    """

    piece: Prescribed
    sources: tuple[Source, ...]
    step: FloatArray
    by_position: FloatArray
    by_speed: FloatArray
    servo: IntArray
    averaged: IntArray
    tick_s: float


# A search asks for the same machines again. They are found by their numbers, because the days of a
# proof, of which these are three times as many, are drawn anew for every plan.
_RECENT: Recent[Machine, tuple[Advance, ...]] = Recent(64, lambda a, b: a is b or a == b)


def advances_of(machine: Machine) -> tuple[Advance, ...]:
    """Return the connected pieces of a machine, ready to be run; none of one without dynamics.

    Raises
    ------
    MachineError
        If an axis has a loop, a part is not linear, or a stepper swings too slowly to be averaged.
    """
    return _RECENT.of(machine, lambda: _made(machine))


def _made(machine: Machine) -> tuple[Advance, ...]:
    if machine.without_dynamics:
        return ()
    looped = [name for name in machine.axes if machine.source_of(name) is None]
    if looped:
        told = next(name for name in machine.axes if name not in looped)
        raise MachineError(
            f"axis {looped[0]} has a loop and axis {told} is told positions: a machine of both "
            "sorts is not simulated",
            place=machine.place,
            remedy="Make a machine file of each sort.",
        )
    return tuple(_advance_of(machine, piece) for piece in prescribed(machine))


def _advance_of(machine: Machine, piece: Prescribed) -> Advance:
    sources = tuple(machine.position_sources[name] for name in piece.drives)
    n, count = len(piece.states), len(sources)
    tick_s = float(machine.tick_clock.period_s)
    servos = [k for k, source in enumerate(sources) if isinstance(source, PulseServo)]
    size = n + 2 * len(servos)
    rates, told, speeds = np.zeros((size, size)), np.zeros((size, count)), np.zeros((size, count))
    rates[:n, :n] = piece.rates[:, :n]
    servo = np.full(count, -1, dtype=np.int64)
    averaged = np.ones(count, dtype=np.int64)
    for k, source in enumerate(sources):
        if isinstance(source, PulseServo):
            at = servo[k] = n + 2 * servos.index(k)
            w = 2.0 * np.pi * source.bandwidth.si
            rates[:n, at], rates[:n, at + 1] = piece.rates[:, n + k], piece.rates[:, n + count + k]
            rates[at, at + 1] = 1.0
            rates[at + 1, at], rates[at + 1, at + 1] = -w * w, -2.0 * w
            told[at + 1, k] = w * w
        else:
            told[:n, k], speeds[:n, k] = piece.rates[:, n + k], piece.rates[:, n + count + k]
            swing_hz = resonance_hz(source, float(piece.inertia[k]))
            assert swing_hz is not None
            averaged[k] = _half_period(machine, piece.drives[k], swing_hz, tick_s)
    # x' = rates x + told (p + p' t) + speeds p', with p' constant over the tick.
    whole = np.zeros((size + 2 * count, size + 2 * count))
    whole[:size, :size] = rates
    whole[:size, size : size + count], whole[:size, size + count :] = told, speeds
    whole[size : size + count, size + count :] = np.eye(count)
    moved = expm(whole * tick_s)
    return Advance(
        piece=piece,
        sources=sources,
        step=moved[:size, :size].copy(),
        by_position=moved[:size, size : size + count].copy(),
        by_speed=moved[:size, size + count :].copy(),
        servo=servo,
        averaged=averaged,
        tick_s=tick_s,
    )


def _half_period(machine: Machine, drive: str, swing_hz: float, tick_s: float) -> int:
    """Return half a period of a stepper's resonance in ticks."""
    ticks = 0.5 / (swing_hz * tick_s)
    if ticks > _MOST_AVERAGED:
        raise MachineError(
            f"drives.{drive}: its rotor swings at {swing_hz:.3g} Hz with what it carries; half a "
            f"period is {ticks:.3g} ticks, and its acceleration is averaged over "
            f"{_MOST_AVERAGED} at most",
            place=machine.place,
            remedy="Correct the inertia that it carries, or its holding torque.",
        )
    return max(1, round(ticks))


class Moving:
    """One connected piece while it is run: its state between blocks."""

    def __init__(self, machine: Machine, advance: Advance, phases: FloatArray) -> None:
        self.machine, self.advance = machine, advance
        self.state = np.zeros(len(advance.step))
        names = list(machine.axes)
        self.columns = [
            next(names.index(a) for a in advance.piece.axes if machine.axes[a].drive == drive)
            for drive in advance.piece.drives
        ]
        self.phases = phases[self.columns]
        # Speeds of the ticks before, the latest last.
        self.before = np.zeros((int(advance.averaged.max()), len(advance.sources)))

    def run(self, travelled: IntArray) -> tuple[FloatArray, FloatArray, tuple[int, str]]:
        """Return states and torques at n ticks, and how many of the ticks are valid.

        States are (n, n_states + 2 s): those of the piece, then position and speed of its s
        drives. Torques are (n, s), as shares of what each drive has at its speed. A piece is
        linear until a belt falls slack: the last pair is the number of ticks before that, and
        the reason, empty where all are valid.

        Parameters
        ----------
        travelled
            (n + 1, axes) counts from the start at the ticks, and at the one behind the last.
        """
        a, count = self.advance, len(self.advance.sources)
        told = np.stack(
            [
                _stands(source, travelled[:, column], phase)
                for source, column, phase in zip(a.sources, self.columns, self.phases, strict=True)
            ],
            axis=1,
        )
        speed = np.diff(told, axis=0) / a.tick_s
        pushed = in_order(told[:-1], a.by_position) + in_order(speed, a.by_speed)
        states = follow(a.step, pushed, self.state)
        self.state = states[-1]
        states = states[:-1]
        history = np.concatenate((self.before, speed))
        kept = len(self.before)
        mean = 0.5 * (history[kept - 1 : -1] + speed)
        demand, position, rate = np.zeros_like(speed), told[:-1].copy(), mean.copy()
        acceleration = np.zeros_like(speed)
        for k, source in enumerate(a.sources):
            if isinstance(source, PulseServo):
                at, w = a.servo[k], 2.0 * np.pi * source.bandwidth.si
                position[:, k], rate[:, k] = states[:, at], states[:, at + 1]
                acceleration[:, k] = w * w * (told[:-1, k] - position[:, k]) - 2.0 * w * rate[:, k]
            else:
                ticks = int(a.averaged[k])
                earlier = history[kept - ticks : len(history) - ticks, k]
                acceleration[:, k] = (speed[:, k] - earlier) / (ticks * a.tick_s)
        self.before = history[-kept:]
        whole = np.hstack((states[:, : len(a.piece.states)], position, rate))
        demand = a.piece.inertia * acceleration - in_order(whole, a.piece.pulls)
        demand += a.piece.friction * np.sign(rate)
        most = np.stack([s.most_torque(rate[:, k]) for k, s in enumerate(a.sources)], axis=1)
        # Where there is no torque left, what is asked is beyond any number.
        share = np.abs(demand) / np.maximum(most, 1e-9 * np.abs(demand) + 1e-300)
        return whole, share.reshape(-1, count), self._tight(whole)

    def _tight(self, whole: FloatArray) -> tuple[int, str]:
        known, why = len(whole), ""
        for belt in self.advance.piece.belts:
            force = in_order(whole, belt.row[None])[:, 0]
            loose = np.flatnonzero((force < belt.low) | (force > belt.high))
            if len(loose) and int(loose[0]) < known:
                known = int(loose[0])
                why = f"{belt.name}: a run falls slack, with {force[known]:.4g} N over its preload"
        return known, why


def in_order(rows: FloatArray, factors: FloatArray) -> FloatArray:
    """Return (n, k) ``rows @ factors.T`` of (n, m) rows, summed in the order of the columns.

    A product of matrices is rounded differently for each number of rows, and on each processor.

    Parameters
    ----------
    factors
        (k, m).
    """
    return np.asarray(summed(np.ascontiguousarray(rows), np.ascontiguousarray(factors)))


def _summed(rows: FloatArray, factors: FloatArray) -> FloatArray:
    """Return what ``in_order`` does, of contiguous arrays: one pass over the rows."""
    total = np.empty((len(rows), len(factors)))
    for i in range(len(rows)):
        for k in range(len(factors)):
            one = 0.0
            for j in range(rows.shape[1]):
                one += rows[i, j] * factors[k, j]
            total[i, k] = one
    return total


summed = njit(nogil=True)(_summed)


def _stands(source: Source, counts: IntArray, phase: float) -> FloatArray:
    """Return where a drive is told to stand, rad or m from the start, its own error included."""
    position = counts / source.counts
    if isinstance(source, PulseServo) or source.microstep_error is None:
        return position
    turns = 2.0 * np.pi * (source.full_steps.si * position + phase)
    error = np.sin(turns) - np.sin(2.0 * np.pi * phase)
    return np.asarray(position + source.microstep_error.si * error)


def _follow(step: FloatArray, pushed: FloatArray, start: FloatArray) -> FloatArray:
    """Return (n + 1, m) ``x[k+1] = step x[k] + pushed[k]``."""
    size = len(start)
    states = np.empty((len(pushed) + 1, size))
    for i in range(size):  # an assignment of the row takes seconds to compile
        states[0, i] = start[i]
    for k in range(len(pushed)):
        for i in range(size):
            total = pushed[k, i]
            for j in range(size):
                total += step[i, j] * states[k, j]
            states[k + 1, i] = total
    return states


follow = njit(nogil=True)(_follow)
