"""What drives are told, tick by tick: all that is known of a machine without dynamics."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil

import numpy as np

from threadline.arrays import IntArray
from threadline.machine import Machine
from threadline.signals import (
    Channel,
    ChannelKind,
    Event,
    Recording,
    RecordingBlock,
    Stream,
    TickTable,
)

_MOST_ROWS = 1 << 14


def record_commanded(
    commands: TickTable, machine: Machine, record_every: int, settle_s: float
) -> Recording:
    """Return ``X.commanded`` of each axis, m or rad, and ``operation``, and no other channel.

    Where a load is, is not known and not made up: what asks for it is not measured.
    """
    clock = machine.tick_clock
    channels = tuple(
        Channel(
            name=f"{name}.commanded",
            kind=ChannelKind.COMMANDED,
            unit="m" if axis.kind == "linear" else "rad",
            clock=clock,
            axis=name,
            stride=record_every,
        )
        for name, axis in machine.axes.items()
    )
    operation = Channel(
        name="operation", kind=ChannelKind.OPERATION, unit="", clock=clock, stride=record_every
    )
    return Recording(
        channels=(*channels, operation),
        blocks=Stream(_blocks, commands, machine, record_every, settle_s),
        job_sha256=commands.job_sha256,
        machine_sha256=machine.sha256,
        simulated=True,
    )


def _blocks(
    commands: TickTable, machine: Machine, every: int, settle_s: float
) -> Iterator[RecordingBlock]:
    clock = machine.tick_clock
    settle_ticks = ceil(settle_s / float(clock.period_s))
    for tick, position, operation, events in told_rows(commands, settle_ticks):
        first = -(-tick // every)
        kept = slice(first * every - tick, len(operation), every)
        samples = {
            f"{name}.commanded": position[:-1][kept, at] / axis.counts.si
            for at, (name, axis) in enumerate(machine.axes.items())
        }
        samples["operation"] = operation[kept].astype(np.float64)
        yield RecordingBlock(first_tick={clock.name: first * every}, samples=samples, events=events)


def told_rows(
    commands: TickTable, settle_ticks: int
) -> Iterator[tuple[int, IntArray, IntArray, tuple[Event, ...]]]:
    """Yield first tick, (n + 1, axes) counts at the ticks, (n,) operations, and events."""
    tick, last = 0, 0
    position = commands.start_counts.copy()
    for block in commands:
        for at in range(0, len(block), _MOST_ROWS):
            counts = block.counts[at : at + _MOST_ROWS]
            operation = block.operation[at : at + _MOST_ROWS]
            end = tick + len(counts)
            rows = np.concatenate((position[None], position + np.cumsum(counts, axis=0)))
            yield tick, rows, operation, tuple(e for e in block.events if tick <= e.tick < end)
            position, tick, last = rows[-1], end, int(operation[-1])
    left = settle_ticks + 1
    while left:
        count = min(left, _MOST_ROWS)
        still = np.broadcast_to(position, (count + 1, len(position)))
        yield tick, still, np.full(count, last), ()
        tick, left = tick + count, left - count
