"""Recordings, plan and specification -> verdict."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from threadline.errors import RecordingError, SpecError
from threadline.path.types import ProgrammedPath
from threadline.plan import Plan, SwitchPlan
from threadline.signals import ChannelKind, Recording, TickTable
from threadline.verdict.blocks import (
    find_first,
    judged_blocks,
    sample_interval_s,
    setting_of,
)
from threadline.verdict.by_time import OPERATION_BY_TIME, checked_operations, with_operation
from threadline.verdict.demands import measure_demands
from threadline.verdict.deviation import measure_path_deviation, measure_shaping_deviation
from threadline.verdict.intended import as_intended
from threadline.verdict.measure import Finding, Measure, MeasureKind
from threadline.verdict.passes import with_passes
from threadline.verdict.registry import MEASURES, PLAN_DEMANDS
from threadline.verdict.switch_judge import judge_switching
from threadline.verdict.types import Criterion, Result, Spec, Verdict
from threadline.verdict.window import PathWindow
from threadline.wording import nearest

_KIND_OF_UNIT = {"m": "linear", "rad": "rotary"}
_EXCUSED = ("acceleration", "jerk")
_ROUNDING = 1e-9
_Key = tuple[str, tuple[tuple[str, float], ...]]  # a measure and its options


def judge(recordings: Sequence[Recording], plan: Plan | SwitchPlan, spec: Spec) -> Verdict:
    """Measure every criterion of ``spec`` and say what came of it.

    Each recording is read once, in bounded memory; of several, the worst counts. One without
    operations has those of the commands at the same instant.

    Parameters
    ----------
    recordings
        Of one and the same job; at least one.
    plan
        What was intended.
    spec
        What is asked.

    Raises
    ------
    SpecError
        If a criterion names no measure.
    RecordingError
        If there is no recording, one is of another job, one has angles of a linear axis or
        lengths of a rotary one, or a trace is damaged.
    """
    if not recordings:
        raise RecordingError("there is no recording to judge", remedy="Give at least one.")
    for recording in recordings:
        _check_same_job(recording, plan)
        _check_units(recording, plan)
    if isinstance(plan, SwitchPlan):
        return judge_switching(recordings, plan, spec)
    recordings = [checked_operations(recording, plan) for recording in recordings]
    by_time = any(recording.find(ChannelKind.OPERATION) is None for recording in recordings)
    recordings = [
        as_intended(with_operation(recording, plan, plan.programmed.axes), plan)
        for recording in recordings
    ]
    findings: dict[_Key, list[Finding]] = {}
    keys = {_key(criterion): criterion for criterion in spec.criteria}
    for recording in recordings:
        for key, found in _measure(recording, plan, spec, keys).items():
            findings[key] = _worse(findings.get(key, []), found)
    for key in keys:
        kind = MEASURES[key[0]]
        if kind.of_many is not None:
            missing = next(
                filter(None, (_unmeasurable(kind, r, plan, spec.lag_s) for r in recordings)), ""
            )
            findings[key] = (
                [Finding(value=None, note=missing)]
                if missing
                else list(kind.of_many(recordings, plan, kind.with_defaults(dict(key[1]))))
            )
    findings |= {(name, ()): found for name, found in _of_plan(plan, keys).items()}
    results = [
        _told(result) if by_time else result
        for criterion in spec.criteria
        for result in _results(criterion, findings, plan)
    ]
    return Verdict(
        results=tuple(with_passes(tuple(_with_lines(results, plan.programmed)), plan.job)),
        simulated=all(recording.simulated for recording in recordings),
    )


def _check_same_job(recording: Recording, plan: Plan | SwitchPlan) -> None:
    theirs, ours = recording.job_sha256, plan.job.sha256
    if theirs and ours and theirs != ours:
        raise RecordingError(
            f"the recording is of another job (sha256 {theirs[:12]}) than the plan ({ours[:12]})",
            remedy="Judge it against the job that was run.",
        )


def _check_units(recording: Recording, plan: Plan | SwitchPlan) -> None:
    """Refuse angles of a linear axis and lengths of a rotary one: a number would pass for it."""
    for channel in recording.channels:
        axis = plan.machine.axes.get(channel.axis)
        if axis is None or channel.unit not in _KIND_OF_UNIT:
            continue
        if axis.kind != _KIND_OF_UNIT[channel.unit]:
            raise RecordingError(
                f"channel {channel.name!r} is in {channel.unit}, and axis {channel.axis} of "
                f"{plan.machine.name} is {axis.kind}",
                remedy=f"Give it in {'deg or rad' if axis.kind == 'rotary' else 'mm or m'}.",
            )


def _told(result: Result) -> Result:
    """Say of a result that its operations were not recorded, if it has any."""
    relies = any(ChannelKind.OPERATION in kinds for kinds in MEASURES[result.name].needs)
    if result.measured is None or not relies:
        return result
    return replace(result, note="; ".join(filter(None, (result.note, OPERATION_BY_TIME))))


def _key(criterion: Criterion) -> _Key:
    kind = MEASURES.get(criterion.name)
    if kind is None:
        raise SpecError(
            f"there is no measure {criterion.name!r}",
            remedy=nearest(criterion.name, MEASURES),
        )
    return criterion.name, tuple(sorted(criterion.options.items()))


def _measure(
    recording: Recording, plan: Plan, spec: Spec, keys: Mapping[_Key, Criterion]
) -> dict[_Key, list[Finding]]:
    """Run every measure of one recording over its blocks, all in the same pass."""
    setting = setting_of(plan, recording, spec.lag_s)
    found: dict[_Key, list[Finding]] = {}
    running: dict[_Key, Measure] = {}
    for key in keys:
        kind = MEASURES[key[0]]
        if kind.start is None:
            continue
        missing = _unmeasurable(kind, recording, plan, spec.lag_s)
        if missing:
            found[key] = [Finding(value=None, note=missing)]
        else:
            running[key] = kind.start(setting, kind.with_defaults(dict(key[1])))
    if running:
        path = PathWindow(plan.programmed)
        for block in judged_blocks(recording, setting.axes, setting.lag_samples, path):
            for measure in running.values():
                measure.feed(block)
    return found | {key: list(measure.finish()) for key, measure in running.items()}


def _unmeasurable(kind: MeasureKind, recording: Recording, plan: Plan, lag_s: float) -> str:
    """Say why the recording cannot tell what the measure asks for; empty where it can."""
    axes = plan.programmed.axes
    return _missing(kind, recording, axes) or (
        _too_coarse(kind, recording, plan, lag_s) if kind.follows else ""
    )


def _too_coarse(kind: MeasureKind, recording: Recording, plan: Plan, lag_s: float) -> str:
    """Say which channel is sampled more coarsely than the lag; empty where none is.

    An error may come and go between two samples, and the lag that is free would be a whole
    sample. A sample at each tick of the commands is as fine as any: a lag may be shorter.
    """
    commands = plan.commands
    tick_s = float(commands.clock.period_s) if isinstance(commands, TickTable) else 0.0
    channels = [
        channel
        for alternatives in kind.needs
        for axis in ("", *plan.programmed.axes)
        if (channel := find_first(recording, alternatives, axis)) is not None
    ]
    coarsest = max(channels, key=sample_interval_s)
    interval_s, finest_s = sample_interval_s(coarsest), max(lag_s, tick_s)
    if interval_s <= finest_s * (1.0 + _ROUNDING):
        return ""
    return (
        f"{coarsest.name} has a sample every {1e3 * interval_s:.4g} ms, the lag of the "
        f"specification is {1e3 * lag_s:.4g} ms: what happens in between is not seen; record "
        f"every {1e3 * finest_s:.4g} ms at least"
    )


def _missing(kind: MeasureKind, recording: Recording, axes: Sequence[str]) -> str:
    """Say which channel that the measure needs is absent; empty where none is."""
    for alternatives in kind.needs:
        # A measure of single axes takes what there is; one of the tool needs every axis.
        have = [
            find_first(recording, alternatives, axis) or find_first(recording, alternatives, "")
            for axis in axes
        ]
        lacking = [axis for axis, channel in zip(axes, have, strict=True) if channel is None]
        if lacking and (not kind.per_axis or len(lacking) == len(axes)):
            return (
                f"no {' or '.join(alternatives)} channel of {', '.join(lacking)}: "
                + _how_to_give(alternatives, lacking[0])
            )
    return ""


def _how_to_give(alternatives: Sequence[ChannelKind], axis: str) -> str:
    if ChannelKind.LOAD in alternatives:
        return f'name the column "{axis}.load" if it was measured at the load, see docs/files.md'
    return f'a column "{axis}.{alternatives[0]}" gives it, see docs/files.md'


def _of_plan(plan: Plan, keys: Mapping[_Key, Criterion]) -> dict[str, list[Finding]]:
    names = {name for name, _ in keys}
    found: dict[str, list[Finding]] = {}
    if names & set(PLAN_DEMANDS):
        found |= measure_demands(plan)
    if "path_deviation" in names:
        found["path_deviation"] = measure_path_deviation(plan)
    if "shaping_deviation" in names:
        found["shaping_deviation"] = measure_shaping_deviation(plan)
    return {name: found[name] for name in names & set(found)}


def _worse(known: Sequence[Finding], fresh: Sequence[Finding]) -> list[Finding]:
    """Return, per axis, the worse of two sets of findings; one not measured is the worst."""
    worst = {finding.axis: finding for finding in known}
    for finding in fresh:
        other = worst.get(finding.axis)
        if other is None or (
            other.value is not None and (finding.value is None or finding.value > other.value)
        ):
            worst[finding.axis] = finding
    return list(worst.values())


def _results(
    criterion: Criterion, findings: Mapping[_Key, list[Finding]], plan: Plan
) -> Iterator[Result]:
    kind = MEASURES[criterion.name]
    found = findings.get(_key(criterion), [])
    build = partial(_result, criterion, kind, plan)
    if not kind.per_axis:
        yield build("", found[0] if found else Finding(value=None, note="nothing was measured"))
        return
    # A finding without an axis is the reason why none was measured.
    per_axis = {finding.axis: finding for finding in found}
    absent = per_axis.get("", Finding(value=None, note="the recording has no such channel"))
    for axis in [criterion.axis] if criterion.axis else plan.programmed.axes:
        if axis not in plan.programmed.axes:
            if not criterion.every_axis:
                yield build(axis, Finding(value=None, note=f"the job has no axis {axis}"))
        elif axis in per_axis or not _endless(criterion.name, axis, plan):
            yield build(axis, per_axis.get(axis, absent))


def _endless(name: str, axis: str, plan: Plan) -> bool:
    return name == "travel" and plan.machine.axes[axis].endless


def _result(
    criterion: Criterion, kind: MeasureKind, plan: Plan, axis: str, finding: Finding
) -> Result:
    limit = criterion.limit
    if finding.value == 0.0:  # nothing anywhere: no place is worse than another
        finding = Finding(value=0.0, axis=finding.axis, note=finding.note)
    if criterion.hard and plan.path.historical and criterion.name in _EXCUSED:
        limit = None
    return Result(
        name=criterion.name,
        axis=axis,
        measured=finding.value,
        limit=limit,
        unit=kind.unit(plan.machine.axes[axis].kind if axis in plan.machine.axes else "linear"),
        status=kind.status(finding.value, limit),
        required=criterion.required,
        time_s=finding.time_s,
        operation=finding.operation,
        job_line=finding.job_line,
        position=finding.position,
        note=finding.note,
    )


def _with_lines(results: Sequence[Result], path: ProgrammedPath) -> Iterator[Result]:
    """Fill in the job lines that the measures did not know; one reading, no further than needed."""
    wanted = np.unique(
        [r.operation for r in results if r.operation is not None and r.job_line is None]
    ).astype(np.int64)
    lines: dict[int, int] = {}
    latest = 0  # an operation without motion has the line of the motion before it
    for block in path if len(wanted) else ():
        if len(lines) == len(wanted) or not len(block):
            break
        due = wanted[len(lines) :]
        due = due[due < block.operation[-1]]
        at = np.searchsorted(block.operation, due, side="right") - 1
        for operation, index in zip(due.tolist(), at.tolist(), strict=True):
            lines[operation] = int(block.line[index]) if index >= 0 else latest
        latest = int(block.line[-1])
    for operation in wanted[len(lines) :].tolist():
        lines[operation] = latest
    for result in results:
        if result.operation is not None and result.job_line is None:
            result = replace(result, job_line=lines[result.operation] or None)  # noqa: PLW2901
        yield result
