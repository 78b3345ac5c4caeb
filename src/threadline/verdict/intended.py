"""Where the loads were to be, where that is not what the controllers were told."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from threadline.plan import Plan
from threadline.signals import ChannelKind, Recording, RecordingBlock, Stream
from threadline.trajectory import TrajectoryReader


def as_intended(recording: Recording, plan: Plan) -> Recording:
    """Return ``recording`` with the commanded position of each axis as the plan meant it.

    With feed-forward the controllers are told what makes the loads follow the trajectory of the
    plan: the motors run ahead of it. What was intended is the trajectory; errors are measured
    from there. Without feed-forward the two are one, and the recording is returned as it is.
    """
    if not plan.feed_forward:
        return recording
    columns = {
        channel.name: (channel, plan.trajectory.axes.index(channel.axis))
        for channel in recording.channels
        if channel.kind is ChannelKind.COMMANDED and channel.axis in plan.trajectory.axes
    }

    def blocks() -> Iterator[RecordingBlock]:
        readers = {name: TrajectoryReader(plan.trajectory) for name in columns}
        for block in recording:
            samples = dict(block.samples)
            for name, (channel, column) in columns.items():
                if name not in samples or not len(samples[name]):
                    continue
                first = block.first_tick[channel.clock.name]
                time_s = channel.clock.times_s(first, len(samples[name]), channel.stride)
                samples[name] = readers[name].ladder(time_s, 1)[:, 0, column]
                readers[name].drop(float(time_s[-1]))
            yield replace(block, samples=samples)

    return replace(recording, blocks=Stream(blocks))
