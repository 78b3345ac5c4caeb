"""The operation at each instant, from the plan's commands if a controller did not record it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from threadline.base.arrays import IntArray
from threadline.commands.plan import Plan
from threadline.errors import RecordingError
from threadline.files import (
    Channel,
    ChannelKind,
    Recording,
    RecordingBlock,
    Stream,
    TickTable,
    tick_table,
)
from threadline.jobs.operations import Job, MoveRun
from threadline.verdict.blocks import master_channel
from threadline.verdict.progress import PlanClock
from threadline.verdict.types import Result

OPERATION_BY_TIME = "operations from the plan by time"
"""Note of a result for which the operations were taken from the plan."""

_ROUNDING = 1e-9  # of a tick: an instant this close to a tick is that tick
_MOST_ROWS = 2.0**62  # later instants are beyond the end of any table


class WatchedOperations:
    """The blocks of a live recording, and whether their operations are usable.

    A column of -1 throughout means that no operation was recorded. This is known at the first real
    operation, or at the end of the recording.

    Parameters
    ----------
    blocks
        Read once.
    channel
        The channel of the operations.
    job
        The job whose operations they are.

    Attributes
    ----------
    usable
        Whether a real operation was seen so far.
    """

    def __init__(self, blocks: Iterable[RecordingBlock], channel: Channel, job: Job) -> None:
        self._blocks, self._channel, self._job = blocks, channel, job
        self.usable = False

    def __iter__(self) -> Iterator[RecordingBlock]:
        """Yield the blocks.

        Raises
        ------
        RecordingError
            If an operation is not one of the job's.
        """
        channel, count = self._channel, 0
        for block in self._blocks:
            samples = block.samples[channel.name]
            self.usable = self.usable or not (samples < 0).all()
            if len(samples) and samples.max() >= count:
                count = count or _count(self._job)
                at = int(np.argmax(samples >= count))
                if samples[at] >= count:
                    first = block.first_tick[channel.clock.name]
                    time_s = channel.clock.times_s(first, len(samples), channel.stride)[at]
                    raise RecordingError(
                        f"the operation at {time_s:.6g} s is {samples[at]:.12g}, and "
                        f"{self._job.name} has {count}, from 0 to {count - 1}",
                        remedy="Judge it against the job that was run, or leave the column out.",
                    )
            yield block


def _count(job: Job) -> int:
    """Return the number of operations of the job."""
    return sum(
        times * (len(item) if isinstance(item, MoveRun) else 1) for item, times, _ in job.folded()
    )


def with_operation(recording: Recording, plan: Plan, axes: Sequence[str]) -> Recording:
    """Return ``recording`` with the operation of the commands at the same instant.

    A trace of another controller has no operations. Its time counts from the start of the commands
    (docs/files.md), so each instant has a row of the commands, and the row has an operation; an
    instant outside takes the first or the last row. If the recording includes holds, rows are
    found by the plan's time.

    Raises
    ------
    RecordingError
        If the recording holds no position of any of ``axes``.
    """
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
    rows, plan_clock = _Rows(commands), PlanClock(master.clock)
    for block in blocks:
        plan_clock.take(block.events)
        count = len(block.samples[master.name])
        first = block.first_tick.get(master.clock.name, 0)
        time_s, _ = plan_clock.at(master.clock.times_s(first, count, master.stride))
        due = np.minimum(np.floor(time_s / tick_s + _ROUNDING), _MOST_ROWS).astype(np.int64)
        operation = rows.operations(due).astype(np.float64)
        yield replace(block, samples={**block.samples, name: operation})


class _Rows:
    """The operations of a tick table, read once from the front."""

    def __init__(self, commands: TickTable) -> None:
        self._blocks = iter(commands)
        self._first = 0
        self._operation: IntArray = np.empty(0, dtype=np.int64)

    def operations(self, rows: IntArray) -> IntArray:
        """Return (n,) operations of (n,) ascending rows; beyond the end the last operation."""
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


def with_passes(results: Sequence[Result], job: Job) -> Iterator[Result]:
    """Yield ``results`` with the passes of their line; read the job only as far as needed.

    The place of a result may lie on a chord of the previous or the next operation: the job line of
    the result decides.
    """
    operations = {
        operation + step
        for operation in (r.operation for r in results if r.job_line is not None)
        if operation is not None
        for step in (-1, 0, 1)
    }
    found = _sources(job, operations)
    for result in results:
        if result.operation is not None and result.job_line is not None:
            for step in (0, -1, 1):
                line, passes = found.get(result.operation + step, (0, ()))
                if line == result.job_line:
                    if passes != result.passes:
                        result = replace(result, passes=passes)  # noqa: PLW2901
                    break
        yield result


def _sources(job: Job, operations: set[int]) -> dict[int, tuple[int, tuple[int, ...]]]:
    """Return line and passes of the wanted operations."""
    found: dict[int, tuple[int, tuple[int, ...]]] = {}
    due = sorted(number for number in operations if number >= 0)
    at = 0
    for item in job.runs() if due else ():
        count = len(item) if isinstance(item, MoveRun) else 1
        while due and due[0] < at + count:
            number = due.pop(0)
            if isinstance(item, MoveRun):
                found[number] = int(item.line[number - at]), item.passes
            else:
                found[number] = item.source.line, item.source.passes
        at += count
        if not due:
            break
    return found
