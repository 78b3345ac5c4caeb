"""Machines whose drives are told positions, simulated exactly from tick to tick.

Within a tick the pulses come evenly: the motor runs at a constant speed, and its load, a linear
network on the other end of belt and gear, is advanced by one matrix exponential. What the load, the
rotor and friction ask of the motor stands beside what its curve has at that speed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil

import numpy as np
from numba import njit
from scipy.linalg import expm

from threadline.arrays import FloatArray, IntArray
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.sources import PulseServo, Source
from threadline.plant.prescribed import Prescribed, prescribed, resonance_hz
from threadline.signals import (
    Channel,
    ChannelKind,
    Event,
    Recording,
    RecordingBlock,
    Stream,
    TickTable,
)
from threadline.twin.commanded import told_rows


def simulate_prescribed(
    commands: TickTable,
    machine: Machine,
    phases: FloatArray,
    record_every: int,
    settle_s: float,
) -> Recording:
    """Return what ``machine`` does under ``commands``; it runs as it is read.

    Channels, per axis: ``X.commanded``, ``X.load`` and, where it has one, ``X.frame`` in m or rad;
    ``X.torque_share``, the torque asked of the drive over what it has at its speed, its largest
    since the sample before. Then ``operation``. The recording ends with a fault where a run of a
    belt falls slack: nothing is known from there on.

    Parameters
    ----------
    phases
        (axes,) where in a full step each stepper stands at the start, in [0, 1).

    Raises
    ------
    MachineError
        If an axis has a loop, or a part is not linear.
    """
    looped = [name for name in machine.axes if machine.source_of(name) is None]
    if looped:
        told = next(name for name in machine.axes if name not in looped)
        raise MachineError(
            f"axis {looped[0]} has a loop and axis {told} is told positions: a machine of both "
            "sorts is not simulated",
            place=machine.place,
            remedy="Make a machine file of each sort.",
        )
    pieces = tuple(_advance_of(machine, piece) for piece in prescribed(machine))
    channels = tuple(_channels(machine, record_every))
    return Recording(
        channels=channels,
        blocks=Stream(_read, commands, machine, pieces, phases, record_every, settle_s),
        job_sha256=commands.job_sha256,
        machine_sha256=machine.sha256,
        simulated=True,
    )


def _channels(machine: Machine, every: int) -> Iterator[Channel]:
    clock = machine.tick_clock
    for name, axis in machine.axes.items():
        unit = "m" if axis.kind == "linear" else "rad"
        kinds = [("commanded", ChannelKind.COMMANDED, unit), ("load", ChannelKind.LOAD, unit)]
        if axis.frame is not None:
            kinds.append(("frame", ChannelKind.FRAME, unit))
        kinds.append(("torque_share", ChannelKind.TORQUE_SHARE, ""))
        for ending, kind, own in kinds:
            yield Channel(
                name=f"{name}.{ending}", kind=kind, unit=own, clock=clock, axis=name, stride=every
            )
    yield Channel(name="operation", kind=ChannelKind.OPERATION, unit="", clock=clock, stride=every)


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
            averaged[k] = max(1, round(0.5 / (swing_hz * tick_s)))
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


class _Moving:
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
        pushed = told[:-1] @ a.by_position.T + speed @ a.by_speed.T
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
        demand = a.piece.inertia * acceleration - whole @ a.piece.pulls.T
        demand += a.piece.friction * np.sign(rate)
        most = np.stack([s.most_torque(rate[:, k]) for k, s in enumerate(a.sources)], axis=1)
        # Where there is no torque left, what is asked is beyond any number.
        share = np.abs(demand) / np.maximum(most, 1e-9 * np.abs(demand).max(initial=1e-300))
        return whole, share.reshape(-1, count), self._tight(whole)

    def _tight(self, whole: FloatArray) -> tuple[int, str]:
        known, why = len(whole), ""
        for belt in self.advance.piece.belts:
            force = whole @ belt.row
            loose = np.flatnonzero((force < belt.low) | (force > belt.high))
            if len(loose) and int(loose[0]) < known:
                known = int(loose[0])
                why = f"{belt.name}: a run falls slack, with {force[known]:.4g} N over its preload"
        return known, why


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
    states[0] = start
    for k in range(len(pushed)):
        for i in range(size):
            total = pushed[k, i]
            for j in range(size):
                total += step[i, j] * states[k, j]
            states[k + 1, i] = total
    return states


follow = njit(cache=True, nogil=True)(_follow)


def _read(
    commands: TickTable,
    machine: Machine,
    pieces: tuple[Advance, ...],
    phases: FloatArray,
    every: int,
    settle_s: float,
) -> Iterator[RecordingBlock]:
    moving = [_Moving(machine, piece, phases) for piece in pieces]
    start, clock = commands.start_counts, machine.tick_clock
    settle_ticks = ceil(settle_s / float(clock.period_s))
    carried: FloatArray = np.zeros(len(machine.axes))
    for tick, position, operation, events in told_rows(commands, settle_ticks):
        first = -(-tick // every)
        kept = slice(first * every - tick, len(operation), every)
        samples: dict[str, FloatArray] = {}
        ran = [one.run(position - start) for one in moving]
        known, why = min((far for _, _, far in ran), key=lambda far: far[0])
        kept = slice(kept.start, known, every)
        for one, (whole, share, _) in zip(moving, ran, strict=True):
            piece = one.advance.piece
            for index, name in enumerate(piece.axes):
                axis, at = machine.axes[name], machine.axis_names.index(name)
                offset = start[at] / axis.counts.si
                drive = piece.drives.index(axis.drive)
                samples[f"{name}.commanded"] = position[:-1][kept, at] / axis.counts.si
                samples[f"{name}.load"] = offset + whole[kept] @ piece.loads[index]
                if piece.has_frame[index]:
                    samples[f"{name}.frame"] = whole[kept] @ piece.frames[index]
                largest, carried[at] = _since(share[:, drive], kept, carried[at])
                samples[f"{name}.torque_share"] = largest
        samples["operation"] = operation[kept].astype(np.float64)
        if why:
            ended = tick + known
            fault = Event(tick=ended, kind="fault", operation=int(operation[known]), name=why)
            told = (*(event for event in events if event.tick < ended), fault)
            yield RecordingBlock(
                first_tick={clock.name: first * every}, samples=samples, events=told
            )
            return
        yield RecordingBlock(first_tick={clock.name: first * every}, samples=samples, events=events)


def _since(share: FloatArray, kept: slice, carried: float) -> tuple[FloatArray, float]:
    """Return the largest share since the sample before, and since the last one of these."""
    at = np.arange(len(share))[kept]
    if not len(at):
        return np.empty(0), float(max(carried, share.max(initial=0.0)))
    begins = np.concatenate(([0], at[:-1] + 1))
    largest = np.maximum.reduceat(share[: at[-1] + 1], begins)
    largest[0] = max(largest[0], carried)
    return largest, float(share[at[-1] + 1 :].max(initial=0.0))
