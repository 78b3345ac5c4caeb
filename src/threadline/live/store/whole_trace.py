"""Unfinished runs of a store, and the recording of a run joined with the runs that it continues.

A continued run begins from rest where the work begins again. Work of the previous run after that
place was repeated, and is left out: the recording goes on at once with the continued run.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from threadline.commands.plan import Plan
from threadline.errors import StoreError
from threadline.files import (
    Channel,
    ChannelKind,
    Clock,
    Event,
    Recording,
    RecordingBlock,
    RunEnd,
    Stream,
)
from threadline.files.formats import read_recording
from threadline.live.store.index import REFUSED, RunRecord
from threadline.live.store.run_store import TRACE, opened


def unfinished_run(store: Path, run: str) -> tuple[Path, RunRecord]:
    """Return the folder and the record of a run that can be continued; nothing is made.

    Raises
    ------
    StoreError
        If there is no such run, or it is complete.
    """
    opened_store = opened(store)
    if opened_store is None:
        raise StoreError(
            f"there is no run {run[:60]!r} in {str(store)!r}", remedy="Give its folder: --store."
        )
    folder = opened_store.find(run)
    record = opened_store.index.record(folder.name)
    if record.ended in {RunEnd.COMPLETED, REFUSED}:
        raise StoreError(
            f"run {folder.name} was {record.ended}: there is no rest of it", remedy="Run the job."
        )
    return folder, record


def refuse_other_rows(record: RunRecord, plan: Plan) -> None:
    """Refuse a plan whose commands differ from a run's in any row.

    Raises
    ------
    StoreError
        If they differ.
    """
    if plan.commands.rows_sha256() != record.commands_sha256:
        raise StoreError(
            f"run {record.run} had other rows than these: another job, machine or options",
            remedy="Give the files and options of that run; its proof.json names them.",
        )


def trace_of(folder: Path, record: RunRecord) -> Path:
    """Return the trace of a run, which shows the executed part.

    Raises
    ------
    StoreError
        If the file in its place is the trace of another run.
    RecordingError
        If it cannot be read.
    """
    trace = folder / TRACE
    recording = read_recording(trace)
    run = recording.origin.get("run", record.run)
    if (run, recording.job_sha256, recording.machine_sha256) != (
        record.run, record.job_sha256, record.machine_sha256,
    ):  # fmt: skip
        raise StoreError(
            f"{str(trace)!r} is the trace of another run ({run[:60]!r}): it does not show what was "
            "executed of this one",
            remedy="Put its own trace there, or run the job anew.",
        )
    return trace


CONTINUES = "continues"
"""Key of a continued run's origin: the name of the run that it continues."""
_ENDS = frozenset(("completed", "stopped", "fault"))


def joined_with(trace: Path) -> tuple[str, ...]:
    """Return the names of the runs that ``whole_recording`` joins to a trace, the latest first."""
    return tuple(name for name, _ in _chain(trace, read_recording(trace)))


def as_one(names: Sequence[str]) -> str:
    """Return a note on a verdict over several runs together."""
    return f"Judged as one with what {' and '.join(names)} did before the work began again"


def _chain(trace: Path, later: Recording) -> list[tuple[str, Recording]]:
    """Return the runs that a trace continues, as far as they exist and fit each other."""
    earlier_runs: list[tuple[str, Recording]] = []
    name, seen = later.origin.get(CONTINUES), {trace.parent.name}
    while name and name == Path(name).name and name not in seen:
        seen.add(name)
        file = trace.parent.parent / name / TRACE
        if not file.is_file():
            break
        earlier = read_recording(file)
        if _fitting(earlier, later) is not None:  # else it began after the place already
            earlier_runs.append((name, earlier))
            later = earlier
        name = earlier.origin.get(CONTINUES)
    return earlier_runs


def whole_recording(trace: Path) -> Recording:
    """Return the recording of a trace, joined with the runs that it continues.

    A trace that continues no run, or whose earlier runs are not beside it any more, is returned
    alone.

    Raises
    ------
    RecordingError
        If a trace is damaged.
    """
    recording = read_recording(trace)
    for _, earlier in _chain(trace, recording):
        recording = _joined(earlier, recording)
    return recording


def _fitting(earlier: Recording, later: Recording) -> tuple[int, int] | None:
    """Return the tick of ``earlier`` where ``later`` continues, and the shift of ``later``, ticks.

    None if they have other jobs or channels, or ``earlier`` never reached that place.
    """
    operation = later.find(ChannelKind.OPERATION)
    alike = (earlier.channels, earlier.job_sha256) == (later.channels, later.job_sha256)
    if operation is None or not alike:
        return None
    first_block = next((block for block in later if len(block.samples[operation.name])), None)
    tick = None if first_block is None else _begins_again(earlier, first_block, operation, later)
    if first_block is None or tick is None:
        return None
    return tick, tick - first_block.first_tick[operation.clock.name]


def _joined(earlier: Recording, later: Recording) -> Recording:
    """Return ``earlier`` up to where the work of ``later`` begins, followed by ``later``."""
    fitting = _fitting(earlier, later)
    if fitting is None:
        return later
    channel = later.channels[0]
    blocks = Stream(_blocks, earlier, later, channel.clock, channel.stride, *fitting)
    return replace(later, blocks=blocks)


def _begins_again(
    earlier: Recording, first_block: RecordingBlock, operation: Channel, later: Recording
) -> int | None:
    """Return the tick of ``earlier`` at which the work began that ``later`` repeats first.

    ``first_block`` is the block of ``later`` with its first samples.

    It is the first sample of that operation, or a later one with the same commanded positions: the
    work may begin again at a rest within an operation. None if ``earlier`` begins after it, or
    never reached it.
    """
    commanded = [
        channel.name for channel in later.channels if channel.kind is ChannelKind.COMMANDED
    ]
    first_operation = float(first_block.samples[operation.name][0])
    operation_tick: int | None = None
    seen_earlier = False
    for block in earlier:
        operations = block.samples[operation.name]
        reached = np.flatnonzero(operations >= first_operation)
        seen_earlier |= bool((operations < first_operation).any())
        if not len(reached):
            continue
        tick = block.first_tick[operation.clock.name]
        if operation_tick is None and seen_earlier:
            operation_tick = tick + int(reached[0]) * operation.stride
        is_same = operations == first_operation
        for name in commanded:
            is_same &= block.samples[name] == first_block.samples[name][0]
        if is_same.any():
            return tick + int(np.argmax(is_same)) * operation.stride
        if (operations > first_operation).any():
            break
    return operation_tick


def _blocks(
    earlier: Recording,
    later: Recording,
    clock: Clock,
    stride: int,
    join_tick: int,
    shift_ticks: int,
) -> Iterator[RecordingBlock]:
    """Yield the blocks of ``earlier`` up to the tick ``join_tick``, then the blocks of ``later``.

    Parameters
    ----------
    shift_ticks
        Ticks by which events of ``later`` come later in the joined recording.
    """
    has_plan_time = False
    for block in earlier:
        kept_count = max(-(-(join_tick - block.first_tick[clock.name]) // stride), 0)
        kept_events = tuple(e for e in block.events if e.tick < join_tick and e.kind not in _ENDS)
        has_plan_time = has_plan_time or any(event.kind == "plan" for event in kept_events)
        yield replace(
            block,
            samples={name: values[:kept_count] for name, values in block.samples.items()},
            events=kept_events,
        )
        if kept_count < max(map(len, block.samples.values()), default=0):
            break
    hold_event = Event(tick=join_tick, kind="hold", operation=-1, name="broken off")
    no_samples = {channel.name: np.empty(0) for channel in later.channels}
    resume_event = replace(hold_event, kind="resume", name="continued")
    joint_events = [hold_event, resume_event]
    if has_plan_time:  # the place where the work began again defines the plan's time
        joint_events.append(
            replace(hold_event, kind="plan", name="", value=clock.time_s(join_tick - shift_ticks))
        )
    has_begun = False
    for block in later:
        if not has_begun and not max(map(len, block.samples.values()), default=0):
            # On the program's way to that place, only late ticks and overrides count.
            kept_kinds = {"late", "override"}
            joint_events += [
                replace(e, tick=join_tick) for e in block.events if e.kind in kept_kinds
            ]
            continue
        if not has_begun:
            yield RecordingBlock(
                first_tick={clock.name: join_tick}, samples=no_samples, events=tuple(joint_events)
            )
            has_begun = True
        yield replace(
            block,
            first_tick={name: tick + shift_ticks for name, tick in block.first_tick.items()},
            events=tuple(replace(event, tick=event.tick + shift_ticks) for event in block.events),
        )
