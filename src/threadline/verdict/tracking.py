"""Tracking error, and the intended commanded positions if feed-forward changes the commands."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.files import Channel, ChannelKind, Recording, RecordingBlock, Stream
from threadline.motion.timing import Trajectory, TrajectoryReader
from threadline.verdict.finding import RunFindings, Worst, largest
from threadline.verdict.measure import Measure, SweptMeasure
from threadline.verdict.progress import PlanClock
from threadline.verdict.samples import Block, Setting


def as_intended(recording: Recording, plan: Plan) -> Recording:
    """Return ``recording`` with the commanded position of each axis as the plan intended it.

    If the loads follow the motion, the controllers receive commands that lead the motion. The
    intended position is the motion itself, in holds the motion at the plan's time, and errors are
    measured from there. If the motors follow the motion, the two are equal and the recording is
    returned unchanged.
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
            samples[name] = readers[name].derivatives(due_s, 1)[:, 0, column]
            readers[name].drop(float(due_s[-1]))
        yield replace(block, samples=samples)


class TrackingPart(NamedTuple):
    """Arrays that a sweep over a block reads and updates for the tracking error.

    ``command``, (n, axes), is subtracted from the samples; ``size`` and ``at``, (axes, runs),
    become the largest difference and its first sample, or -1.
    """

    command: FloatArray
    size: FloatArray
    at: IntArray


class _Tracking(SweptMeasure):
    """Per axis, in its own unit (m or rad): the largest absolute difference. Lag counts.

    The actual position is the position of the tool or the load. If a live machine records neither,
    the axis' own encoder is read, and the result says so.
    """

    def __init__(self, setting: Setting) -> None:
        recording = setting.recording
        self._own = [
            recording.find(ChannelKind.TOOL, axis) is None
            and recording.find(ChannelKind.LOAD, axis) is None
            for axis in setting.axes
        ]
        count = len(setting.axes)
        self._worst = [Worst(setting.runs, count, axis) for axis in setting.axes]
        self._part: TrackingPart | None = None

    def part(self, block: Block) -> TrackingPart | None:
        """Return the arrays for the sweep over the tool or the load; None if not recorded."""
        self._part = None
        if block.actual is not None and block.commanded is not None and not all(self._own):
            shape = len(self._own), block.actual.shape[1]
            self._part = TrackingPart(
                command=np.ascontiguousarray(block.commanded),
                size=np.full(shape, -np.inf),
                at=np.full(shape, -1, dtype=np.int64),
            )
        return self._part

    def feed(self, block: Block) -> None:
        """Take the sweep's results; encoders are not part of the sweep."""
        if self._part is not None:
            self._offer(block, self._part.size, self._part.at, own=False)
        if block.own is not None and any(self._own):
            self._offer(block, *largest(block.own, block.commanded), own=True)

    def _offer(self, block: Block, size: FloatArray, at: IntArray, *, own: bool) -> None:
        for column, mine in enumerate(self._own):
            if mine == own and self._worst[column].is_beaten(size[column]):
                self._worst[column].offer(
                    size[column],
                    time_s=block.time_s[at[column]],
                    operation=block.operations_at(at[column]),
                    position=block.positions_at(at[column]),
                    note="of the axis' own encoder" if own else "",
                )

    def finish(self) -> Sequence[RunFindings]:
        found = (worst.found() for worst in self._worst)
        return [one for one in found if not np.isnan(one.value).all()]


def start_tracking(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring the tracking error."""
    return _Tracking(setting)
