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
    kept = opened(store)
    if kept is None:
        raise StoreError(
            f"there is no run {run[:60]!r} in {str(store)!r}", remedy="Give its folder: --store."
        )
    folder = kept.find(run)
    record = kept.index.record(folder.name)
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
    whole = read_recording(trace)
    run = whole.origin.get("run", record.run)
    if (run, whole.job_sha256, whole.machine_sha256) != (
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


def _chain(trace: Path, rest: Recording) -> list[tuple[str, Recording]]:
    """Return the runs that a trace continues, as far as they exist and fit each other."""
    found: list[tuple[str, Recording]] = []
    name, seen = rest.origin.get(CONTINUES), {trace.parent.name}
    while name and name == Path(name).name and name not in seen:
        seen.add(name)
        file = trace.parent.parent / name / TRACE
        if not file.is_file():
            break
        before = read_recording(file)
        if _fitting(before, rest) is not None:  # else it began after the place already
            found.append((name, before))
            rest = before
        name = before.origin.get(CONTINUES)
    return found


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
    for _, before in _chain(trace, recording):
        recording = _joined(before, recording)
    return recording


def _fitting(before: Recording, rest: Recording) -> tuple[int, int] | None:
    """Return the tick of ``before`` at which ``rest`` continues, and how many ticks earlier it is.

    None if they have other jobs or channels, or ``before`` never reached that place.
    """
    operation = rest.find(ChannelKind.OPERATION)
    alike = (before.channels, before.job_sha256) == (rest.channels, rest.job_sha256)
    if operation is None or not alike:
        return None
    begins = next((block for block in rest if len(block.samples[operation.name])), None)
    at = None if begins is None else _begins_again(before, begins, operation, rest)
    if begins is None or at is None:
        return None
    return at, at - begins.first_tick[operation.clock.name]


def _joined(before: Recording, rest: Recording) -> Recording:
    """Return ``before`` up to where the work of ``rest`` begins, followed by ``rest``."""
    fitting = _fitting(before, rest)
    if fitting is None:
        return rest
    channel = rest.channels[0]
    blocks = Stream(_blocks, before, rest, channel.clock, channel.stride, *fitting)
    return replace(rest, blocks=blocks)


def _begins_again(
    before: Recording, begins: RecordingBlock, operation: Channel, rest: Recording
) -> int | None:
    """Return the tick of ``before`` at which the work began that ``rest`` repeats first.

    ``begins`` is the block of ``rest`` with its first samples.

    It is the first sample of that operation, or a later one with the same commanded positions: the
    work may begin again at a rest within an operation. None if ``before`` begins after it, or never
    reached it.
    """
    commanded = [channel.name for channel in rest.channels if channel.kind is ChannelKind.COMMANDED]
    of = float(begins.samples[operation.name][0])
    first: int | None = None
    earlier = False
    for block in before:
        now = block.samples[operation.name]
        found = np.flatnonzero(now >= of)
        earlier |= bool((now < of).any())
        if not len(found):
            continue
        tick = block.first_tick[operation.clock.name]
        if first is None and earlier:
            first = tick + int(found[0]) * operation.stride
        alike = now == of
        for name in commanded:
            alike &= block.samples[name] == begins.samples[name][0]
        if alike.any():
            return tick + int(np.argmax(alike)) * operation.stride
        if (now > of).any():
            break
    return first


def _blocks(
    before: Recording, rest: Recording, clock: Clock, stride: int, at: int, earlier: int
) -> Iterator[RecordingBlock]:
    """Yield the blocks of ``before`` up to the tick ``at``, then the blocks of ``rest``.

    Parameters
    ----------
    earlier
        Ticks by which events of ``rest`` come later in the joined recording.
    """
    tells = False
    for block in before:
        kept = max(-(-(at - block.first_tick[clock.name]) // stride), 0)
        own = tuple(e for e in block.events if e.tick < at and e.kind not in _ENDS)
        tells = tells or any(event.kind == "plan" for event in own)
        yield replace(
            block, samples={name: a[:kept] for name, a in block.samples.items()}, events=own
        )
        if kept < max(map(len, block.samples.values()), default=0):
            break
    held = Event(tick=at, kind="hold", operation=-1, name="broken off")
    nothing = {channel.name: np.empty(0) for channel in rest.channels}
    resumed = replace(held, kind="resume", name="continued")
    joint = [held, resumed]
    if tells:  # the place where the work began again defines the plan's time
        joint.append(replace(held, kind="plan", name="", value=clock.time_s(at - earlier)))
    worked = False
    for block in rest:
        if not worked and not max(map(len, block.samples.values()), default=0):
            # On the program's way to that place, only late ticks and overrides count.
            kept_kinds = {"late", "override"}
            joint += [replace(e, tick=at) for e in block.events if e.kind in kept_kinds]
            continue
        if not worked:
            yield RecordingBlock(first_tick={clock.name: at}, samples=nothing, events=tuple(joint))
            worked = True
        yield replace(
            block,
            first_tick={name: tick + earlier for name, tick in block.first_tick.items()},
            events=tuple(replace(event, tick=event.tick + earlier) for event in block.events),
        )
