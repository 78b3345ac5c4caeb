"""Commanded positions of the loads, where feed-forward gives the controllers other ones."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.files import Channel, ChannelKind, Recording, RecordingBlock, Stream
from threadline.motion.timing import Trajectory, TrajectoryReader
from threadline.verdict.finding import Found, Worst, largest
from threadline.verdict.measure import Measure, SweptMeasure
from threadline.verdict.progress import PlanClock
from threadline.verdict.samples import Block, Setting


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


class TrackingPart(NamedTuple):
    """What a sweep over a block takes from the measure and brings back.

    ``command``, (n, axes), is what the samples are held against; ``size`` and ``at``, (axes, runs),
    are raised to the largest difference and to the first sample that has it, -1 of none.
    """

    command: FloatArray
    size: FloatArray
    at: IntArray


class _Tracking(SweptMeasure):
    """Per axis, in its own unit (m or rad): the largest absolute difference. Lag counts.

    The actual position is that of the tool or the load. A live machine has neither: there it is
    what the axis' own encoder read, and the result says so.
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
        """Return what the sweep needs for the tool or the load, where there is one."""
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
        """Take what the sweep found; what encoders read is in no sweep."""
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

    def finish(self) -> Sequence[Found]:
        found = (worst.found() for worst in self._worst)
        return [one for one in found if not np.isnan(one.value).all()]


def start_tracking(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring the tracking error."""
    return _Tracking(setting)
