"""Plays step tables on a simulated frame: each step acts exactly at the instant it is given.

Servos follow the steps with their lag; the frame hangs on them by a linear network
(:mod:`threadline.twin.stitching_machine`).
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from math import ceil

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import MachineError, RecordingError
from threadline.machine import Machine
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
from threadline.twin.prescribed import in_order
from threadline.twin.stitching_machine import Driven, driven_of
from threadline.twin.stitching_run import Library, Played, play
from threadline.twin.stitching_shaft import Needles

_REST_S = Fraction(2)
_AT_ONCE = 1 << 16
"""Samples of a block of a recording at most: the drives' clock may be a thousand times a turn's."""


def simulate_stitching(commands: StepPlay, machine: Machine) -> Recording:
    """Return what happens when ``machine`` plays ``commands`` once; it runs as it is read.

    Channels, on the clock of the drives: per axis ``X.commanded`` (the steps that were given),
    ``X.load`` and ``X.torque_share`` (force asked of the drive over what it has); ``needle``, 1
    while it is in the cloth; ``operation``. Two seconds of rest follow the last turn.

    Raises
    ------
    MachineError
        If an axis is not moved by a pulse servo, a part is not linear, or a sample is not a whole
        number of periods of the timer.
    RecordingError
        If the commands are not for this machine.
    """
    if commands.machine_sha256 != machine.sha256:
        raise RecordingError(
            "the step tables were made for another machine file", remedy="Compile them again."
        )
    driven = driven_of(machine)
    return Recording(
        channels=tuple(stitching_channels(machine)),
        blocks=Stream(_read, commands, machine, driven),
        simulated=True,
        machine_sha256=machine.sha256,
        job_sha256=commands.job_sha256,
    )


def stitching_channels(machine: Machine) -> Iterator[Channel]:
    """Yield the channels of a recording."""
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


def ticks_of_sample(commands: StepPlay, machine: Machine) -> int:
    """Return how many periods of the timer a sample is.

    Raises
    ------
    MachineError
        If it is no whole number.
    """
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
    every = ticks_of_sample(commands, machine)
    library = Library.of(commands)
    played = Played.at_rest(driven.step.shape[0], len(commands.axes))
    needles = Needles(machine, commands)
    first, operation = 0, 0
    for block, after in _with_next(commands):
        # What is due at the beginning of the next block belongs to it.
        end = commands.duration_ticks if after is None else int(after.begin[0])
        rest = ceil(_REST_S / machine.tick_clock.period_s) if after is None else 0
        until = -(-end // every) + rest
        played.turn[:], played.at[:] = 0, 0
        events = [*_at_samples(block, commands, every)]
        while True:
            count = min(until - first, _AT_ONCE)
            states, steps = play(driven, library, played, block, commands, (first, count, every))
            ticks = every * np.arange(first, first + count, dtype=np.int64)
            turn = np.searchsorted(block.begin, ticks, side="right") - 1
            samples = frame_samples(commands, driven, states, steps)
            samples["needle"] = needles.down(block, after, ticks)
            under_way = np.where(turn >= 0, block.operation[np.maximum(turn, 0)], operation)
            samples["operation"] = under_way.astype(np.float64)
            begun, first = first, first + count
            due = [e for e in events if e.tick < first or first == until]
            events = [e for e in events if e.tick >= first and first < until]
            yield RecordingBlock(
                first_tick={machine.tick_clock.name: begun}, samples=samples, events=tuple(due)
            )
            if first == until:
                break
        operation = int(block.operation[-1])


def frame_samples(
    commands: StepPlay, driven: Driven, states: FloatArray, steps: FloatArray
) -> dict[str, FloatArray]:
    """Return the samples of the axes from (n, m) states and (n, A) steps given.

    Sums run in the order of the states, so that they do not depend on the number of samples.
    """
    start = commands.start_steps / commands.steps_per_unit
    forces, loads = in_order(states, driven.forces), in_order(states, driven.loads)
    samples: dict[str, FloatArray] = {}
    for k, name in enumerate(commands.axes):
        force = forces[:, k] + driven.told[k] * (steps[:, k] * driven.scale[k])
        samples[f"{name}.commanded"] = start[k] + steps[:, k] / commands.steps_per_unit[k]
        samples[f"{name}.load"] = start[k] + loads[:, k]
        samples[f"{name}.torque_share"] = np.abs(force) / driven.limit[k]
    return samples


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
