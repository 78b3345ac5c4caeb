"""Recordings, the plan of an on/off machine, and a specification -> verdict."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from threadline.plan import SwitchPlan
from threadline.signals import Recording
from threadline.verdict.measure import Finding, MeasureKind
from threadline.verdict.registry import MEASURES
from threadline.verdict.switch_measures import SwitchMeasure
from threadline.verdict.switch_run import SwitchRun
from threadline.verdict.types import Criterion, Result, Spec, Verdict

_Place = tuple[str, str]  # axis and step


def judge_switching(recordings: Sequence[Recording], plan: SwitchPlan, spec: Spec) -> Verdict:
    """Measure every criterion of ``spec``; of several recordings the worst counts.

    Raises
    ------
    RecordingError
        If a recording has no outputs, or is damaged.
    """
    runs = [SwitchRun(recording, plan) for recording in recordings]
    lines = [operation.source.line for operation in plan.job]
    own = {(c.name, c.axis, c.step) for c in spec.criteria if c.step}
    results: list[Result] = []
    for criterion in spec.criteria:
        kind = MEASURES[criterion.name]
        for finding in _findings(kind, criterion, runs):
            # A criterion of one step replaces that of every step there.
            if not criterion.step and (criterion.name, criterion.axis, finding.step) in own:
                continue
            results.append(_result(criterion, kind, finding, lines))
    return Verdict(results=tuple(results), simulated=all(r.simulated for r in recordings))


def _findings(
    kind: MeasureKind, criterion: Criterion, runs: Sequence[SwitchRun]
) -> Iterator[Finding]:
    measure = kind.of_switching
    axis = criterion.axis
    if measure is None:
        note = "not a measure of an on/off machine"
        yield Finding(value=None, axis=axis, step=criterion.step, note=note)
        return
    options = kind.with_defaults(criterion.options)
    worst: dict[_Place, Finding] = {}
    for run in runs:
        for finding in _of_one(measure, run, options, criterion):
            place = finding.axis, finding.step
            known = worst.get(place)
            if known is None or _is_worse(finding, known):
                worst[place] = finding
    if not worst:
        what = f"step {criterion.step!r}" if criterion.step else f"axis {axis}"
        note = f"nothing of {what} was measured"
        yield Finding(value=None, axis=axis, step=criterion.step, note=note)
    yield from worst.values()


def _of_one(
    measure: SwitchMeasure, run: SwitchRun, options: Mapping[str, float], criterion: Criterion
) -> Iterator[Finding]:
    for finding in measure(run, options):
        if criterion.axis and finding.axis != criterion.axis:
            continue
        if criterion.step and finding.step not in ("", criterion.step):
            continue
        yield finding


def _is_worse(fresh: Finding, known: Finding) -> bool:
    if known.value is None:
        return False
    return fresh.value is None or fresh.value > known.value


def _result(
    criterion: Criterion, kind: MeasureKind, finding: Finding, lines: Sequence[int]
) -> Result:
    line = None if finding.operation is None else lines[finding.operation] or None
    return Result(
        name=criterion.name,
        axis=finding.axis,
        step=finding.step,
        measured=finding.value,
        limit=criterion.limit,
        unit=kind.unit("linear"),
        status=kind.status(finding.value, criterion.limit),
        required=criterion.required,
        time_s=finding.time_s,
        operation=finding.operation,
        job_line=line,
        note=finding.note,
    )
