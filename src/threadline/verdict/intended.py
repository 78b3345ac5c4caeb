"""Commanded positions of the loads, where feed-forward gives the controllers other ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace

from threadline.plan import Plan
from threadline.signals import Channel, ChannelKind, Recording, RecordingBlock, Stream
from threadline.trajectory import Trajectory, TrajectoryReader
from threadline.verdict.plan_clock import PlanClock


def as_intended(recording: Recording, plan: Plan) -> Recording:
    """Return ``recording`` with the commanded position of each axis as the plan meant it.

    Where the loads follow the motion, the controllers are told what makes them do so: the motors
    run ahead of it. What was intended is the motion; errors are measured from there. Where rows
    were held it is the motion at the plan's time, which stands with them. Where the
    motors follow it the two are one, and the recording is returned as it is.
    """
    intended = plan.motion.of_loads
    if intended is None:
        return recording
    columns = {
        channel.name: (channel, intended.axes.index(channel.axis))
        for channel in recording.channels
        if channel.kind is ChannelKind.COMMANDED and channel.axis in intended.axes
    }
    return replace(recording, blocks=Stream(_blocks, recording.blocks, intended, columns))


def _blocks(
    blocks: Iterable[RecordingBlock],
    trajectory: Trajectory,
    columns: Mapping[str, tuple[Channel, int]],
) -> Iterator[RecordingBlock]:
    """Yield ``blocks`` with the positions of ``trajectory`` in the channels ``columns``."""
    readers = {name: TrajectoryReader(trajectory) for name in columns}
    clocks = {name: PlanClock(channel.clock) for name, (channel, _) in columns.items()}
    for block in blocks:
        samples = dict(block.samples)
        for name, (channel, column) in columns.items():
            clocks[name].take(block.events)
            if name not in samples or not len(samples[name]):
                continue
            first = block.first_tick[channel.clock.name]
            time_s = channel.clock.times_s(first, len(samples[name]), channel.stride)
            due_s, _ = clocks[name].at(time_s)
            samples[name] = readers[name].ladder(due_s, 1)[:, 0, column]
            readers[name].drop(float(due_s[-1]))
        yield replace(block, samples=samples)
