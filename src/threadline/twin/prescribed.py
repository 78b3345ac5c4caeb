"""Simulates machines whose drives follow commanded positions, such as steppers and pulse servos.

Within a tick the pulses are evenly spaced, so the motor has a constant speed. The load is a linear
network behind belt and gear, and one matrix exponential advances it by a tick. The torque that
load, rotor and friction need is compared with the torque of the motor at that speed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import expm

from threadline.base.arrays import FloatArray, IntArray, Recent
from threadline.base.compiled import njit
from threadline.dynamics.prescribed import Prescribed, prescribed, resonance_hz
from threadline.errors import MachineError, OptionError
from threadline.files import Channel, ChannelKind, RecordingBlock, RunEnd
from threadline.machine import Machine
from threadline.machine.sources import PulseServo, Source
from threadline.twin.channels import encoder_phases
from threadline.twin.row_session import Part, RowSession

_TERMS, _ROUNDING = 24, 1e-17
_FAR = 1e3  # the series does not converge for larger generators


def exponential_of_short_step(turned: FloatArray) -> FloatArray:
    """Return the matrix exponentials of (V, K, n, n) generators by their power series.

    In the shortest part of a step even the stiffest beam turns by a thousandth of a radian, so a
    few terms are enough, and the series is much faster than a general exponential. If the series
    has not converged after ``_TERMS`` terms, or an entry is above ``_FAR`` so that its powers could
    overflow, the general exponential is used.
    """
    if float(np.abs(turned).max()) > _FAR:
        return np.asarray(expm(turned))
    total = np.broadcast_to(np.eye(turned.shape[-1]), turned.shape).copy()
    term = total
    for order in range(1, _TERMS):
        term = term @ turned / order
        total = total + term
        if (np.abs(term) <= _ROUNDING * np.abs(total)).all():
            return total
    whole: FloatArray = expm(turned)
    return whole


_MOST_AVERAGED = 1_000_000
"""Largest number of ticks over which the acceleration of a stepper is averaged."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Advance:
    """A connected piece, ready to be simulated; its state is ``[x, servo positions and speeds]``.

    Parameters
    ----------
    piece, sources
        Equations of the piece, and its drives.
    step
        (m, m) transition matrix of the state over a tick.
    by_position, by_speed
        (m, s) effect of the commanded position at the tick, and of the commanded speed within it.
    servo
        (s,) index of each servo's position in the state; -1 for a stepper.
    averaged
        (s,) number of ticks over which a stepper's acceleration is averaged: half a period of its
        resonance, because its magnetic spring absorbs single microsteps.
    spread
        (s,) number of ticks over which a stepper makes a step: a quarter of that period, the time
        of its rotor to the next position; 1 if a tick is longer.
    """

    piece: Prescribed
    sources: tuple[Source, ...]
    step: FloatArray
    by_position: FloatArray
    by_speed: FloatArray
    servo: IntArray
    averaged: IntArray
    spread: IntArray
    tick_s: float


# A search simulates the same machines repeatedly. They are compared by value, because a proof draws
# its days anew for every plan. The cache holds three times the days of a proof.
_RECENT: Recent[Machine, tuple[Advance, ...]] = Recent(64, lambda a, b: a is b or a == b)


def advances_of(machine: Machine) -> tuple[Advance, ...]:
    """Return the connected pieces of a machine, ready to be simulated; none without dynamics.

    Raises
    ------
    MachineError
        If an axis has a control loop, a part is not linear, or a stepper resonates too slowly for
        its acceleration to be averaged.
    """
    return _RECENT.of(machine, lambda: _made(machine))


def _made(machine: Machine) -> tuple[Advance, ...]:
    if machine.without_dynamics:
        return ()
    looped = [name for name in machine.axes if machine.source_of(name) is None]
    if looped:
        other = next(name for name in machine.axes if name not in looped)
        raise MachineError(
            f"axis {looped[0]} has a control loop and axis {other} takes positions: a machine with "
            "both is not simulated",
            place=machine.place,
            remedy="Make a machine file for each.",
        )
    return tuple(_advance_of(machine, piece) for piece in prescribed(machine))


def _advance_of(machine: Machine, piece: Prescribed) -> Advance:
    sources = tuple(machine.position_sources[name] for name in piece.drives)
    n, count = len(piece.states), len(sources)
    tick_s = float(machine.tick_clock.period_s)
    servos = [k for k, source in enumerate(sources) if isinstance(source, PulseServo)]
    size = n + 2 * len(servos)
    rates, commanded, speeds = (
        np.zeros((size, size)),
        np.zeros((size, count)),
        np.zeros((size, count)),
    )
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
            commanded[at + 1, k] = w * w
        else:
            commanded[:n, k], speeds[:n, k] = piece.rates[:, n + k], piece.rates[:, n + count + k]
            swing_hz = resonance_hz(source, float(piece.inertia[k]))
            assert swing_hz is not None
            averaged[k] = _half_period(machine, piece.drives[k], swing_hz, tick_s)
    # x' = rates x + commanded (p + p' t) + speeds p', where p' is constant over the tick.
    whole = np.zeros((size + 2 * count, size + 2 * count))
    whole[:size, :size] = rates
    whole[:size, size : size + count], whole[:size, size + count :] = commanded, speeds
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
        spread=np.maximum(averaged // 2, 1),
        tick_s=tick_s,
    )


def _half_period(machine: Machine, drive: str, swing_hz: float, tick_s: float) -> int:
    """Return half a period of a stepper's resonance in ticks."""
    ticks = 0.5 / (swing_hz * tick_s)
    if ticks > _MOST_AVERAGED:
        raise MachineError(
            f"drives.{drive}: its rotor and its load resonate at {swing_hz:.3g} Hz; half a "
            f"period is {ticks:.3g} ticks, and the acceleration is averaged over at most "
            f"{_MOST_AVERAGED}",
            place=machine.place,
            remedy="Correct the inertia of its load, or its holding torque.",
        )
    return max(1, round(ticks))


class PieceRun:
    """One connected piece during a simulation: its state between blocks."""

    def __init__(self, machine: Machine, advance: Advance, phases: FloatArray) -> None:
        self.machine, self.advance = machine, advance
        self.state = np.zeros(len(advance.step))
        names = list(machine.axes)
        self.columns = [
            next(names.index(a) for a in advance.piece.axes if machine.axes[a].drive == drive)
            for drive in advance.piece.drives
        ]
        self.phases = phases[self.columns]
        # Counts at the previous ticks, the latest last; 0 at the start.
        self.counts = np.zeros((int(advance.spread.max()), len(advance.sources)), dtype=np.int64)
        # Speeds in the previous ticks, the latest last.
        self.before = np.zeros((int(advance.averaged.max()), len(advance.sources)))

    def run(self, travelled: IntArray) -> tuple[FloatArray, FloatArray, tuple[int, str]]:
        """Return states and torques at n ticks, and the number of valid ticks with the reason.

        States are (n, n_states + 2 s): the states of the piece, then position and speed of its s
        drives. Torques are (n, s), each divided by the torque that the drive has at its speed. The
        piece is linear until a belt becomes slack: ticks from there on are not valid. The reason
        is empty if all ticks are valid.

        Parameters
        ----------
        travelled
            (n + 1, axes) counts since the start, at the ticks and at the tick after the last one.
        """
        a, count = self.advance, len(self.advance.sources)
        stood = np.concatenate((self.counts, travelled[:, self.columns]))
        commanded = np.stack(
            [
                _commanded_position(source, stood[:, k], phase, len(travelled), int(a.spread[k]))
                for k, (source, phase) in enumerate(zip(a.sources, self.phases, strict=True))
            ],
            axis=1,
        )
        # The last row comes again as the first of the next part.
        self.counts = stood[len(stood) - 1 - len(self.counts) : -1]
        speed = np.diff(commanded, axis=0) / a.tick_s
        pushed = in_order(commanded[:-1], a.by_position) + in_order(speed, a.by_speed)
        states = follow(a.step, pushed, self.state)
        self.state = states[-1]
        states = states[:-1]
        history = np.concatenate((self.before, speed))
        history_length = len(self.before)
        mean = 0.5 * (history[history_length - 1 : -1] + speed)
        demand, position, rate = np.zeros_like(speed), commanded[:-1].copy(), mean.copy()
        acceleration = np.zeros_like(speed)
        for k, source in enumerate(a.sources):
            if isinstance(source, PulseServo):
                at, w = a.servo[k], 2.0 * np.pi * source.bandwidth.si
                position[:, k], rate[:, k] = states[:, at], states[:, at + 1]
                acceleration[:, k] = (
                    w * w * (commanded[:-1, k] - position[:, k]) - 2.0 * w * rate[:, k]
                )
            else:
                ticks = int(a.averaged[k])
                earlier = history[history_length - ticks : len(history) - ticks, k]
                acceleration[:, k] = (speed[:, k] - earlier) / (ticks * a.tick_s)
        self.before = history[-history_length:]
        whole = np.hstack((states[:, : len(a.piece.states)], position, rate))
        demand = a.piece.inertia * acceleration - in_order(whole, a.piece.pulls)
        demand += a.piece.friction * np.sign(rate)
        most = np.stack([s.most_torque(rate[:, k]) for k, s in enumerate(a.sources)], axis=1)
        # If the drive has no torque left, the share becomes a very large number.
        share = np.abs(demand) / np.maximum(most, 1e-9 * np.abs(demand) + 1e-300)
        return whole, share.reshape(-1, count), self._check_belts(whole)

    def _check_belts(self, whole: FloatArray) -> tuple[int, str]:
        known, why = len(whole), ""
        for belt in self.advance.piece.belts:
            force = in_order(whole, belt.row[None])[:, 0]
            loose = np.flatnonzero((force < belt.low) | (force > belt.high))
            if len(loose) and int(loose[0]) < known:
                known = int(loose[0])
                why = f"{belt.name}: a run falls slack, with {force[known]:.4g} N over its preload"
        return known, why


def in_order(rows: FloatArray, factors: FloatArray) -> FloatArray:
    """Return (n, k) ``rows @ factors.T`` for (n, m) rows, summed in the order of the columns.

    A matrix product would round differently for each number of rows, and on each processor.

    Parameters
    ----------
    factors
        (k, m).
    """
    return np.asarray(summed(np.ascontiguousarray(rows), np.ascontiguousarray(factors)))


def _summed(rows: FloatArray, factors: FloatArray) -> FloatArray:
    """Return the result of ``in_order`` for contiguous arrays."""
    total = np.empty((len(rows), len(factors)))
    for i in range(len(rows)):
        for k in range(len(factors)):
            one = 0.0
            for j in range(rows.shape[1]):
                one += rows[i, j] * factors[k, j]
            total[i, k] = one
    return total


summed = njit(nogil=True)(_summed)


_FINEST = 2.0**40  # parts of a radian: errors are summed exactly, as whole numbers of them


def _commanded_position(
    source: Source, counts: IntArray, phase: float, rows: int, ticks: int
) -> FloatArray:
    """Return the commanded position of a drive at the last ``rows`` of ``counts``, rad or m.

    The position includes the microstep error, and is the mean over the last ``ticks``.
    """
    window_counts = counts[len(counts) - rows - ticks + 1 :]
    position = window_counts / source.counts
    error: FloatArray | None = None
    if not isinstance(source, PulseServo) and source.microstep_error is not None:
        turns = 2.0 * np.pi * (source.full_steps.si * position + phase)
        error = source.microstep_error.si * (np.sin(turns) - np.sin(2.0 * np.pi * phase))
    if ticks == 1:
        return np.asarray(position if error is None else position + error)
    commanded = _means(window_counts, ticks) / source.counts
    if error is not None:
        commanded += _means(np.rint(_FINEST * error).astype(np.int64), ticks) / _FINEST
    return np.asarray(commanded)


def _means(numbers: IntArray, ticks: int) -> FloatArray:
    """Return the means of every ``ticks`` consecutive numbers, without rounding of sums."""
    total = np.concatenate(([0], np.cumsum(numbers)))
    return np.asarray((total[ticks:] - total[:-ticks]) / ticks)


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


class PositionSession(RowSession):
    """One simulated machine whose drives take positions, which receives its rows in pieces.

    Channels, per axis: ``X.commanded``, ``X.load`` and, if the axis has a frame, ``X.frame`` in m
    or rad; ``X.torque_share``, the largest ratio since the previous sample of needed torque to the
    torque that the drive has at its speed. Then ``operation``. A machine without dynamics has only
    ``X.commanded`` and ``operation``.

    If a belt becomes slack, the simulation ends there with a fault.

    Parameters
    ----------
    machine
        The simulated machine; it starts at rest.
    start_counts
        (axes,) commanded position before the first row; 0 when None.
    phases
        (axes,) position of each stepper within a full step at the start, in [0, 1); 0.5 when None.
    record_every
        Number of ticks from sample to sample.
    advances
        The result of ``advances_of(machine)``, if it is known already; it saves time.

    Raises
    ------
    MachineError
        If an axis has a control loop, or a part is not linear.
    OptionError
        If a number or a phase is out of range.
    """

    def __init__(
        self,
        machine: Machine,
        *,
        start_counts: IntArray | None = None,
        phases: FloatArray | None = None,
        record_every: int = 1,
        advances: Sequence[Advance] | None = None,
    ) -> None:
        if record_every < 1:
            raise OptionError(f"record_every must be at least 1, got {record_every}")
        super().__init__(machine, start_counts)
        at = encoder_phases(machine, phases)
        self._every = record_every
        found = advances_of(machine) if advances is None else advances
        self._pieces = [PieceRun(machine, advance, at) for advance in found]
        self.channels = position_channels(machine, record_every)
        self._tick = 0
        self._carried: FloatArray = np.zeros(len(machine.axes))

    @property
    def tick(self) -> int:
        """Number of ticks simulated so far."""
        return self._tick

    def _tripped(self, name: str) -> bool:
        raise OptionError(f"{self._machine.name} has no limit switch {name}")

    def _read(self, part: Part) -> Mapping[Any, FloatArray]:
        travelled = np.concatenate((part.travelled, self._position[None]))
        ran = [(piece.advance, *piece.run(travelled)) for piece in self._pieces]
        known, why = min(
            (far for _, _, _, far in ran), key=lambda far: far[0], default=(len(part.operation), "")
        )
        read: dict[str, FloatArray] = {}
        for advance, whole, share, _ in ran:
            piece = advance.piece
            for index, name in enumerate(piece.axes):
                axis, at = self._machine.axes[name], self._machine.axis_names.index(name)
                offset = self._start[at] / axis.counts.si
                read[f"{name}.load"] = offset + in_order(whole, piece.loads[index][None])[:known, 0]
                if piece.has_frame[index]:
                    read[f"{name}.frame"] = in_order(whole, piece.frames[index][None])[:known, 0]
                drive = piece.drives.index(axis.drive)
                read[f"{name}.torque_share"] = share[:known, drive]
        if why:
            self._fail(self._tick + known, int(part.operation[known]), why)
            part.travelled, part.operation = part.travelled[:known], part.operation[:known]
        self._tick += known
        return read

    def _fail(self, tick: int, operation: int, why: str) -> None:
        """End the run with a fault at ``tick``, and drop all later events."""
        self._pending_events = [event for event in self._pending_events if event.tick < tick]
        self._rows.clear()
        self._events.clear()
        self.failed, self._operation = True, operation
        self._halted, self._held = None, False
        self._ended, self._final = (RunEnd.FAULT, why), True
        self._record_event("fault", tick=tick, name=why)

    def _block(self, first: int, parts: list[Part]) -> RecordingBlock:
        begin = -(-first // self._every)
        recorded_rows = slice(begin * self._every - first, None, self._every)
        axes = len(self._machine.axes)
        nothing = np.zeros((0, axes), dtype=np.int64)
        position = self._start + np.concatenate([nothing, *(part.travelled for part in parts)])
        samples: dict[str, FloatArray] = {}
        for channel in self.channels[:-1]:
            name, at = channel.name, self._machine.axis_names.index(channel.axis)
            if channel.kind is ChannelKind.COMMANDED:
                samples[name] = (
                    position[recorded_rows, at] / self._machine.axes[channel.axis].counts.si
                )
                continue
            values = np.concatenate([np.empty(0), *(part.read[name] for part in parts)])
            if channel.kind is ChannelKind.TORQUE_SHARE:
                samples[name], self._carried[at] = _since(values, recorded_rows, self._carried[at])
            else:
                samples[name] = values[recorded_rows]
        operation = np.concatenate([nothing[:, 0], *(part.operation for part in parts)])
        samples["operation"] = operation[recorded_rows].astype(np.float64)
        events, self._pending_events = tuple(self._pending_events), []
        clock = self._machine.tick_clock.name
        return RecordingBlock(
            first_tick={clock: begin * self._every}, samples=samples, events=events
        )


def position_channels(machine: Machine, every: int) -> tuple[Channel, ...]:
    """Return the channels of a machine whose drives take positions."""
    return tuple(_channels(machine, every))


def _channels(machine: Machine, every: int) -> Iterator[Channel]:
    clock = machine.tick_clock
    for name, axis in machine.axes.items():
        unit = "m" if axis.kind == "linear" else "rad"
        kinds = [("commanded", ChannelKind.COMMANDED, unit)]
        if not machine.without_dynamics:
            kinds.append(("load", ChannelKind.LOAD, unit))
            if axis.frame is not None:
                kinds.append(("frame", ChannelKind.FRAME, unit))
            kinds.append(("torque_share", ChannelKind.TORQUE_SHARE, ""))
        for ending, kind, own in kinds:
            yield Channel(
                name=f"{name}.{ending}", kind=kind, unit=own, clock=clock, axis=name, stride=every
            )
    yield Channel(name="operation", kind=ChannelKind.OPERATION, unit="", clock=clock, stride=every)


def _since(share: FloatArray, recorded_rows: slice, carried: float) -> tuple[FloatArray, float]:
    """Return, for each sample, the largest share since the previous one; and since the last."""
    at = np.arange(len(share))[recorded_rows]
    if not len(at):
        return np.empty(0), float(max(carried, share.max(initial=0.0)))
    begins = np.concatenate(([0], at[:-1] + 1))
    largest = np.maximum.reduceat(share[: at[-1] + 1], begins)
    largest[0] = max(largest[0], carried)
    return largest, float(share[at[-1] + 1 :].max(initial=0.0))
