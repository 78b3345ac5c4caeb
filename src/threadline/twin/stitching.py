"""Step tables on their machine: a frame that is driven by steps, each placed exactly in time.

Servos follow the steps with their lag, the frame hangs on them by a linear network. Between two
samples the state goes on by one matrix exponential; a step that comes tau before the sample adds
``integral_0^tau exp(A s) ds B``, whose power series in tau needs no more than sums of powers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from math import ceil

import numpy as np
from scipy.linalg import expm

from threadline.arrays import FloatArray
from threadline.errors import MachineError, RecordingError
from threadline.machine import Machine
from threadline.machine.sources import PulseServo
from threadline.plant.prescribed import prescribed
from threadline.signals import (
    Channel,
    ChannelKind,
    Event,
    Recording,
    RecordingBlock,
    StepPlay,
    StitchBlock,
    Stream,
)
from threadline.twin.stitching_run import Library, Played, play
from threadline.twin.stitching_shaft import Needles

_TERMS = 20
_NORM = 1.0  # of the rates over an interval: the series then ends below 1e-18
_MOST_PARTS = 1024
_REST_S = Fraction(2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Driven:
    """A machine whose axes are told steps; its state is that of all pieces, servos behind each.

    Parameters
    ----------
    step
        (m, m) of the state over an interval.
    held
        (m, A) what the steps that were there before it add.
    series
        (terms, m, A) by powers of the part of an interval that is left when a step comes.
    loads
        (A, m) position of each axis, in its own units.
    forces
        (A, m) force that its drive gives, N, but for what it is told.
    told
        (A,) N per m (rad) that it is told.
    limit
        (A,) N that it has.
    scale
        (A,) of the steps of an axis: m (rad) of its drive.
    parts
        Intervals in a sample.
    """

    step: FloatArray
    held: FloatArray
    series: FloatArray
    loads: FloatArray
    forces: FloatArray
    told: FloatArray
    limit: FloatArray
    scale: FloatArray
    parts: int


def simulate_stitching(commands: StepPlay, machine: Machine) -> Recording:
    """Return what happens when ``machine`` plays ``commands`` once; it runs as it is read.

    Channels, on the clock of the drives: per axis ``X.commanded`` (the steps that were given),
    ``X.load`` and ``X.torque_share`` (force asked of the drive over what it has); ``needle``, 1
    while it is in the cloth; ``operation``. Two seconds of rest follow the last turn.

    Raises
    ------
    MachineError
        If an axis has no servo that is told steps, a part is not linear, or sample and timer have
        no common count.
    RecordingError
        If the commands are not for this machine.
    """
    if commands.machine_sha256 != machine.sha256:
        raise RecordingError(
            "the step tables were made for another machine file", remedy="Compile them again."
        )
    driven = driven_of(machine)
    return Recording(
        channels=tuple(_channels(machine)),
        blocks=Stream(_read, commands, machine, driven),
        simulated=True,
        machine_sha256=machine.sha256,
        job_sha256=commands.job_sha256,
    )


def driven_of(machine: Machine) -> Driven:
    """Return the machine, ready to be driven.

    Raises
    ------
    MachineError
        If an axis has no servo that is told steps, or a part is not linear.
    """
    for name, axis in machine.axes.items():
        if not isinstance(machine.position_sources.get(axis.drive), PulseServo):
            raise MachineError(
                f"axes.{name} is not moved by a pulse-servo, which step tables are played on",
                place=machine.place,
                remedy='Give it a drive of kind = "pulse-servo".',
            )
    names = machine.axis_names
    pieces = prescribed(machine)
    size = sum(len(piece.states) + 2 * len(piece.drives) for piece in pieces)
    rates, entry = np.zeros((size, size)), np.zeros((size, len(names)))
    loads, forces = np.zeros((len(names), size)), np.zeros((len(names), size))
    told, limit, scale = (np.zeros(len(names)) for _ in range(3))
    first = 0
    for piece in pieces:
        n = len(piece.states)
        columns = np.arange(first, first + n + 2 * len(piece.drives))
        rates[first : first + n, columns] = piece.rates
        for k, drive in enumerate(piece.drives):
            source = machine.position_sources[drive]
            assert isinstance(source, PulseServo)
            at = next(names.index(a) for a in piece.axes if machine.axes[a].drive == drive)
            w = 2.0 * np.pi * source.bandwidth.si
            place, speed = columns[n + k], columns[n + len(piece.drives) + k]
            rates[place, speed] = 1.0
            rates[speed, place], rates[speed, speed] = -w * w, -2.0 * w
            entry[speed, at] = w * w
            # It gives what its own mass and the network ask for.
            forces[at, columns] = -piece.pulls[k]
            forces[at] += piece.inertia[k] * rates[speed]
            told[at] = piece.inertia[k] * w * w
            limit[at] = source.torque_limit.si
            scale[at] = 1.0 / source.counts
        for index, name in enumerate(piece.axes):
            loads[names.index(name), columns] = piece.loads[index]
        first = int(columns[-1]) + 1
    sample_s = float(machine.tick_clock.period_s)
    parts = _parts(rates, sample_s, machine)
    step, series = _powers(rates, entry, sample_s / parts)
    return Driven(
        step=step,
        held=series.sum(axis=0),
        series=series,
        loads=loads,
        forces=forces,
        told=told,
        limit=limit,
        scale=scale,
        parts=parts,
    )


def _parts(rates: FloatArray, sample_s: float, machine: Machine) -> int:
    """Return into how many intervals a sample is cut, so that the series ends."""
    fastest = float(np.abs(np.linalg.eigvals(rates)).max())
    parts = ceil(fastest * sample_s / _NORM)
    if parts > _MOST_PARTS:
        raise MachineError(
            f"{machine.name} rings at {fastest / (2.0 * np.pi):.4g} Hz, too fast for samples of "
            f"{sample_s * 1e3:g} ms",
            place=machine.place,
            remedy="Give its drives a shorter clock, or leave out what rings so fast.",
        )
    return max(1, parts)


def _powers(
    rates: FloatArray, entry: FloatArray, interval_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the state's step over an interval, and (terms, m, A) ``A^k B T^(k+1) / (k+1)!``."""
    terms, power = [], entry * interval_s
    for k in range(1, _TERMS + 1):
        terms.append(power)
        power = rates @ power * (interval_s / (k + 1))
    return np.asarray(expm(rates * interval_s)), np.stack(terms)


def _channels(machine: Machine) -> Iterator[Channel]:
    clock = machine.tick_clock
    for name, axis in machine.axes.items():
        unit = "m" if axis.kind == "linear" else "rad"
        for ending, kind, own in (
            ("commanded", ChannelKind.COMMANDED, unit),
            ("load", ChannelKind.LOAD, unit),
            ("torque_share", ChannelKind.TORQUE_SHARE, ""),
        ):
            yield Channel(name=f"{name}.{ending}", kind=kind, unit=own, clock=clock, axis=name)
    yield Channel(name="needle", kind=ChannelKind.OUTPUT, unit="", clock=clock)
    yield Channel(name="operation", kind=ChannelKind.OPERATION, unit="", clock=clock)


def _ticks_of_sample(commands: StepPlay, machine: Machine) -> int:
    ratio = machine.tick_clock.period_s / commands.clock.period_s
    if ratio.denominator != 1:
        raise MachineError(
            f"a sample of {machine.tick_clock.name!r} is {float(ratio):g} periods of the timer "
            f"{commands.clock.name!r}, which is no whole number",
            place=machine.place,
            remedy="Choose a clock of the drives that is a multiple of the timer.",
        )
    return int(ratio)


def _read(commands: StepPlay, machine: Machine, driven: Driven) -> Iterator[RecordingBlock]:
    """Yield the blocks of one run: the samples of some turns each, and at last those of rest."""
    every = _ticks_of_sample(commands, machine)
    library = Library.of(commands)
    start = commands.start_steps / commands.steps_per_unit
    played = Played.at_rest(driven.step.shape[0], len(commands.axes))
    needles = Needles(machine, commands)
    first, operation = 0, 0
    for block, after in _with_next(commands):
        # What is due at the beginning of the next block belongs to it.
        end = commands.duration_ticks if after is None else int(after.begin[0])
        rest = ceil(_REST_S / machine.tick_clock.period_s) if after is None else 0
        until = -(-end // every) + rest
        count = until - first
        states, steps = play(driven, library, played, block, commands, (first, count, every))
        ticks = every * np.arange(first, until, dtype=np.int64)
        turn = np.searchsorted(block.begin, ticks, side="right") - 1
        samples: dict[str, FloatArray] = {}
        for k, name in enumerate(commands.axes):
            given = steps[:, k] * driven.scale[k]
            force = states @ driven.forces[k] + driven.told[k] * given
            samples[f"{name}.commanded"] = start[k] + steps[:, k] / commands.steps_per_unit[k]
            samples[f"{name}.load"] = start[k] + states @ driven.loads[k]
            samples[f"{name}.torque_share"] = np.abs(force) / driven.limit[k]
        samples["needle"] = needles.down(block, after, ticks)
        under_way = np.where(turn >= 0, block.operation[np.maximum(turn, 0)], operation)
        samples["operation"] = under_way.astype(np.float64)
        operation = int(block.operation[-1])
        yield RecordingBlock(
            first_tick={machine.tick_clock.name: first},
            samples=samples,
            events=tuple(_at_samples(block, commands, every)),
        )
        first = until


def _with_next(commands: StepPlay) -> Iterator[tuple[StitchBlock, StitchBlock | None]]:
    before: StitchBlock | None = None
    for block in commands:
        if before is not None:
            yield before, block
        before = block
    if before is not None:
        yield before, None


def _at_samples(block: StitchBlock, commands: StepPlay, every: int) -> Iterator[Event]:
    """Yield the events of some turns, at samples of the recording."""
    for event in block.events:
        turn = event.tick - block.first_stitch
        tick = commands.duration_ticks if turn >= len(block) else int(block.begin[turn])
        yield Event(tick=tick // every, kind=event.kind, operation=event.operation, name=event.name)
