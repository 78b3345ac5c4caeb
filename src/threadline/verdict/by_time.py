"""The operation under way, from the plan's commands where a controller didn't record it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from threadline.arrays import IntArray
from threadline.errors import RecordingError
from threadline.jobs.operations import Job, MoveRun
from threadline.plan import Plan
from threadline.signals import (
    Channel,
    ChannelKind,
    Recording,
    RecordingBlock,
    Stream,
    TickTable,
    tick_table,
)
from threadline.verdict.blocks import master_channel

OPERATION_BY_TIME = "operations from the plan by time"
"""Note of a result that relies on it."""

_ROUNDING = 1e-9  # of a tick: an instant that is a tick but for a rounding is that tick


def checked_operations(recording: Recording, plan: Plan) -> Recording:
    """Return ``recording`` without operations that say nothing, and refusing those of no job.

    A column of -1 throughout says that none was recorded. What the twin has simulated is taken as
    it is.

    Raises
    ------
    RecordingError
        While it is read: if an operation is not one of the job's.
    """
    channel = recording.find(ChannelKind.OPERATION)
    if channel is None or recording.simulated:
        return recording
    name = channel.name
    if all((block.samples[name] < 0).all() for block in recording):
        kept = tuple(c for c in recording.channels if c is not channel)
        return replace(recording, channels=kept)
    return replace(recording, blocks=Stream(_checked, recording.blocks, channel, plan.job))


def _checked(
    blocks: Iterable[RecordingBlock], channel: Channel, job: Job
) -> Iterator[RecordingBlock]:
    """Yield ``blocks`` as long as their operations are those of the job."""
    count = 0
    for block in blocks:
        samples = block.samples[channel.name]
        if len(samples) and samples.max() >= count:
            count = count or _count(job)
            at = int(np.argmax(samples >= count))
            if samples[at] >= count:
                first = block.first_tick[channel.clock.name]
                time_s = channel.clock.times_s(first, len(samples), channel.stride)[at]
                raise RecordingError(
                    f"the operation at {time_s:.6g} s is {samples[at]:.12g}, and "
                    f"{job.name} has {count}, from 0 to {count - 1}",
                    remedy="Judge it against the job that was run, or leave the column out.",
                )
        yield block


def _count(job: Job) -> int:
    """Return how many operations the job has."""
    return sum(
        times * (len(item) if isinstance(item, MoveRun) else 1) for item, times, _ in job.folded()
    )


def with_operation(recording: Recording, plan: Plan, axes: Sequence[str]) -> Recording:
    """Return ``recording`` with the operation that the commands were at, at the same instant.

    A trace of another controller knows nothing of operations. Its time counts from the start of
    the commands (docs/files.md), so each instant has its row in them, and the row its operation;
    before the first row and after the last, theirs. A recording that has operations is returned as
    it is: what was under way counts, not what was meant to be.

    Raises
    ------
    RecordingError
        If the recording holds no position of any of ``axes``.
    """
    if recording.find(ChannelKind.OPERATION) is not None:
        return recording
    commands = tick_table(plan.commands)
    master = master_channel(recording, axes)
    channel = Channel(
        name=ChannelKind.OPERATION.value,
        kind=ChannelKind.OPERATION,
        unit="",
        clock=master.clock,
        stride=master.stride,
    )
    blocks = Stream(_labelled, recording.blocks, commands, master, channel.name)
    return replace(recording, channels=(*recording.channels, channel), blocks=blocks)


def _labelled(
    blocks: Iterable[RecordingBlock], commands: TickTable, master: Channel, name: str
) -> Iterator[RecordingBlock]:
    """Yield ``blocks`` with the operations of the commands as the channel ``name``."""
    tick_s = float(commands.clock.period_s)
    rows = _Rows(commands)
    for block in blocks:
        count = len(block.samples[master.name])
        first = block.first_tick.get(master.clock.name, 0)
        time_s = master.clock.times_s(first, count, master.stride)
        due = np.floor(time_s / tick_s + _ROUNDING).astype(np.int64)
        operation = rows.operations(due).astype(np.float64)
        yield replace(block, samples={**block.samples, name: operation})


class _Rows:
    """The operations of a tick table, read once from the front."""

    def __init__(self, commands: TickTable) -> None:
        self._blocks = iter(commands)
        self._first = 0
        self._operation: IntArray = np.empty(0, dtype=np.int64)

    def operations(self, rows: IntArray) -> IntArray:
        """Return (n,) operations of (n,) rows, which never go back; beyond the end the last."""
        found = np.empty(len(rows), dtype=np.int64)
        done = 0
        while done < len(rows):
            end = done + int(np.searchsorted(rows[done:], self._first + len(self._operation)))
            found[done:end] = self._operation[rows[done:end] - self._first]
            done = end
            if done < len(rows):
                block = next(self._blocks, None)
                if block is None:
                    found[done:] = self._operation[-1] if len(self._operation) else 0
                    break
                if len(block):
                    self._first, self._operation = block.first_tick, block.operation
        return found
