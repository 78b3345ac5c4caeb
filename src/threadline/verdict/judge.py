"""The judge: opens a recording with its plan, and measures every criterion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from threadline.base.wording import nearest
from threadline.commands.plan import Motion, Plan, Scheduled, Stitched
from threadline.errors import RecordingError, SpecError
from threadline.files import ChannelKind, Recording
from threadline.verdict.by_time import OPERATION_BY_TIME, with_passes
from threadline.verdict.coverage import (
    EventReader,
    effects_in,
    end_words,
    not_beyond,
    with_event_readers,
)
from threadline.verdict.demands import with_needle
from threadline.verdict.each_run import EachRun, criterion_row, limit_of, unit_of
from threadline.verdict.finding import Finding, RunFindings, joined
from threadline.verdict.measure import MeasureKind, MeasureOfRuns, OfRuns, Run
from threadline.verdict.motion_run import motion_run
from threadline.verdict.of_recording import kinds_of, with_recording
from threadline.verdict.one_pass import Findings, Key, Pass, read_all
from threadline.verdict.registry import MEASURES
from threadline.verdict.stitch_run import StitchRun
from threadline.verdict.switch_run import SwitchRun
from threadline.verdict.types import Criterion, Disturbance, Result, Spec, Verdict


def _switch_run(recording: Recording, plan: Plan, lag_s: float) -> Run:  # noqa: ARG001
    """Return a run with its schedule; it has no lag, because it waits for its inputs."""
    return SwitchRun(recording, plan)


def _stitch_run(recording: Recording, plan: Plan, lag_s: float) -> Run:  # noqa: ARG001
    """Return a run with its stitches; it has no lag, because the needle sets their times."""
    return StitchRun(recording, plan)


RUNS: Mapping[type, Callable[[Recording, Plan, float], Run]] = {
    Motion: motion_run,
    Scheduled: _switch_run,
    Stitched: _stitch_run,
}
"""By intent: opens a recording with its plan and the lag, s, that the specification allows."""


def open_run(recording: Recording, plan: Plan, lag_s: float) -> Run:
    """Return ``recording`` with ``plan``, in the form that measures read.

    Raises
    ------
    RecordingError
        If channels are missing without which nothing can be judged.
    """
    return RUNS[type(plan.intent)](recording, plan, lag_s)


_USUAL_UNITS = {
    ("linear", False): "mm or m",
    ("rotary", False): "deg or rad",
    ("linear", True): "mm/s or m/s",
    ("rotary", True): "deg/s or rad/s",
}
_KIND_OF_UNIT = {"m": "linear", "rad": "rotary", "m/s": "linear", "rad/s": "rotary"}


def judge(recordings: Sequence[Recording], plan: Plan, spec: Spec) -> Verdict:
    """Measure every criterion of ``spec`` on recordings: see ``Judge.verdict``."""
    return Judge(plan, spec).verdict(recordings, recorded=True)


class Judge:
    """Judges any number of runs of one plan by one specification.

    Results that do not depend on a run are computed once.

    Parameters
    ----------
    plan
        The intended work.
    spec
        The specification.

    Raises
    ------
    SpecError
        If a criterion names no measure.
    """

    def __init__(self, plan: Plan, spec: Spec) -> None:
        self.plan, self.spec = plan, with_needle(spec, plan.job)
        self._keys = {_key(criterion): criterion for criterion in self.spec.criteria}

    @cached_property
    def _of_plan(self) -> Findings:
        return _of_plan(self.plan, self._keys)

    def verdict(
        self,
        recordings: Sequence[Recording],
        others: Sequence[Recording] = (),
        *,
        recorded: bool = False,
    ) -> Verdict:
        """Measure every criterion and return the verdict.

        Each recording is read once, in bounded memory, with all runs that it holds; the worst run
        counts. A recording without operations gets the operations of the commands at the same
        instant. If a run ended before its last row nothing passes: a criterion that had not failed
        before counts as not measured.

        Parameters
        ----------
        recordings
            Recordings of the same job; at least one.
        others
            Recordings of other machines within the tolerances. Their worst results count too,
            except in measures of many runs together (repeatability), which compare runs of one
            machine.
        recorded
            Whether these are recordings, not runs simulated for this verdict. Travel and velocity
            are then measured on them as well, whatever origin a recording names. If a simulated
            recording keeps these limits, the plan's own values are shown, as in its proof.

        Raises
        ------
        RecordingError
            If there is no recording, one is of another job, one has angles for a linear axis or
            lengths for a rotary one, or a trace is damaged.
        """
        plan, spec = self.plan, self.spec
        findings, runs, readers = self._measured(recordings, recorded=recorded)
        for other in others:
            measured, _, more_readers = self._measured([other], together=False, recorded=recorded)
            readers = [*readers, *more_readers]
            for key, found in measured.items():
                if key not in self._of_plan:
                    findings[key] = joined(findings.get(key, []), found)
        outcomes = [reader.outcome() for reader in readers]
        why = next(filter(None, map(end_words, outcomes)), "")
        stops = [
            reader.stopped_s
            for reader, outcome in zip(readers, outcomes, strict=True)
            if outcome.incomplete
        ]
        stopped_s = None if None in stops else min(filter(None, stops), default=None)
        count = sum(recording.runs for recording in (*recordings, *others))
        simulated = all(recording.simulated for recording in (*recordings, *others))
        shown = recorded and not simulated and not why
        unlined = [
            with_recording(result, findings, plan, spec, shown=shown)
            if MEASURES[criterion.name].of_plan(plan) is not None
            else not_beyond(
                _with_operation_note(_with_run_number(result, found, count), runs),
                why,
                stopped_s,
                of_worst=kind.of_worst,
            )
            for criterion in spec.criteria
            for kind, found in _rows(criterion, findings, runs[0], spec)
            for result in (_result(criterion, kind, plan, found.worst()),)
        ]
        results = with_lines(unlined, plan)
        happened = [*(one for reader in readers for one in reader.disturbances)]
        return Verdict(
            results=results,
            simulated=simulated,
            limits_alone=simulated and plan.machine.without_dynamics,
            runs=sum(recording.runs for recording in recordings),
            machines=sum(recording.runs for recording in others),
            incomplete=why,
            late_ticks=sum(outcome.late_ticks for outcome in outcomes),
            recorded=recorded,
            disturbances=tuple(
                _in_order([*_lined(happened, plan), *effects_in(results, plan.machine)])
            ),
        )

    def each(self, recording: Recording) -> EachRun:
        """Measure every criterion in every run that ``recording`` holds, each of another machine.

        As ``verdict``, but run by run; measures of many runs together (repeatability) are left
        out.

        Raises
        ------
        RecordingError
            As ``verdict``.
        """
        plan = self.plan
        findings, runs, readers = self._measured([recording], together=False, each=True)
        why = next(filter(None, (end_words(one.outcome()) for one in readers)), "")
        rows = [
            criterion_row(criterion, kind, plan, found, recording.runs)
            for criterion in self.spec.criteria
            if not isinstance(MEASURES[criterion.name].of_run(runs[0]), OfRuns)
            for kind, found in _rows(criterion, findings, runs[0], self.spec)
        ]
        return EachRun(rows=tuple(rows), runs=recording.runs, incomplete=why)

    def _measured(
        self,
        recordings: Sequence[Recording],
        *,
        together: bool = True,
        recorded: bool = False,
        each: bool = False,
    ) -> tuple[Findings, list[Run], list[EventReader]]:
        plan = self.plan
        if not recordings:
            raise RecordingError("there is no recording to judge", remedy="Give at least one.")
        for recording in recordings:
            _check_same_job(recording, plan)
            _check_units(recording, plan)
        readers = with_event_readers(recordings, plan.machine)
        opened = [open_run(recording, plan, self.spec.lag_s) for recording, _ in readers]
        kinds = {key: MEASURES[criterion.name] for key, criterion in self._keys.items()}
        of_recording = {} if each else kinds_of(self.spec, recorded=recorded)
        # Parallel runs in one recording are measured together while it is read.
        several = together and len(opened) == 1 and recordings[0].runs > 1
        passes = [Pass(run, kinds | of_recording, together=several) for run in opened]
        in_step = {
            key: reading.in_step(opened, kind.with_defaults(dict(key[1])))
            for key, kind in kinds.items()
            if isinstance(reading := kind.of_run(opened[0]), OfRuns)
            and together
            and not (several and reading.start is not None)
        }
        read_all(passes, list(in_step.values()))
        runs = [one.run for one in passes]
        findings: Findings = {}
        for one in passes:
            for key, found in one.found().items():
                findings[key] = joined(findings.get(key, []), found)
        findings |= _of_runs(in_step, runs, self._keys)
        findings |= self._of_plan
        return findings, runs, [reader for _, reader in readers]


def _check_same_job(recording: Recording, plan: Plan) -> None:
    theirs, ours = recording.job_sha256, plan.job.sha256
    if theirs and ours and theirs != ours:
        raise RecordingError(
            f"the recording is of another job (sha256 {theirs[:12]}) than the plan ({ours[:12]})",
            remedy="Judge it against the job that was run.",
        )


def _check_units(recording: Recording, plan: Plan) -> None:
    """Refuse angles for a linear axis and lengths for a rotary one: both are plain numbers."""
    for channel in recording.channels:
        if channel.axis not in plan.machine.moving or channel.unit not in _KIND_OF_UNIT:
            continue
        unit = plan.machine.unit_of(channel.axis, frame=channel.kind is ChannelKind.FRAME)
        kind = _KIND_OF_UNIT[unit]
        if kind != _KIND_OF_UNIT[channel.unit]:
            raise RecordingError(
                f"channel {channel.name!r} is in {channel.unit}, and axis {channel.axis} of "
                f"{plan.machine.name} is {kind}",
                remedy=f"Give it in {_USUAL_UNITS[kind, '/' in channel.unit]}.",
            )


def _with_operation_note(result: Result, runs: Sequence[Run]) -> Result:
    """Add a note to a result that needs operations if they were not recorded."""
    reading = MEASURES[result.name].of_run(runs[0])
    if result.measured is None or reading is None or not any(run.by_time for run in runs):
        return result
    if not any(ChannelKind.OPERATION in kinds for kinds in reading.needs):
        return result
    return replace(result, note="; ".join(filter(None, (result.note, OPERATION_BY_TIME))))


def _with_run_number(result: Result, found: RunFindings, runs: int) -> Result:
    """Add to a result the median of the runs, and the number of the worst unless its value is 0."""
    if runs == 1 or len(found) != runs or not result.measured:
        return result
    typical = float(np.nanmedian(found.value))
    return replace(
        result,
        run=int(np.nanargmax(found.value)) + 1,
        typical=typical if np.isfinite(typical) else None,
    )


def _key(criterion: Criterion) -> Key:
    kind = MEASURES.get(criterion.name)
    if kind is None:
        raise SpecError(
            f"there is no measure {criterion.name!r}",
            remedy=nearest(criterion.name, MEASURES),
        )
    return criterion.name, tuple(sorted(criterion.options.items()))


def _of_runs(
    begun: Mapping[Key, MeasureOfRuns], runs: Sequence[Run], keys: Mapping[Key, Criterion]
) -> Findings:
    """Return the findings of measures over several recordings, once these have been read."""
    found: Findings = {}
    for key, measure in begun.items():
        kind = MEASURES[keys[key].name]
        reading = kind.of_run(runs[0])
        assert isinstance(reading, OfRuns)
        reasons = (run.lacks(reading, kind.per_axis) for run in runs)
        missing = next(filter(None, reasons), "")
        if missing:
            found[key] = [RunFindings.made([Finding(value=None, note=missing)])]
            continue
        measured = list(measure.finish(runs))
        unseen = next(filter(None, (run.unseen(reading) for run in runs)), "")
        if unseen and any(finding.value is not None for finding in measured):
            measured = [Finding(value=None, note=unseen)]
        found[key] = [RunFindings.made([finding]) for finding in measured]
    return found


def _of_plan(plan: Plan, keys: Mapping[Key, Criterion]) -> Findings:
    """Run every measure of the plan; measures of one pass share it."""
    names = {name for name, _ in keys}
    readings = {name: MEASURES[name].of_plan(plan) for name in names}
    passes = dict.fromkeys(reading.measure for reading in readings.values() if reading is not None)
    measured = {name: rows for measure in passes for name, rows in measure(plan).items()}
    return {
        key: [RunFindings.made([finding]) for finding in measured.get(key[0], ())]
        for key in keys
        if readings[key[0]] is not None
    }


def _rows(
    criterion: Criterion, findings: Mapping[Key, list[RunFindings]], run: Run, spec: Spec
) -> Iterator[tuple[MeasureKind, RunFindings]]:
    """Yield the findings of a criterion, for each axis and step that it covers."""
    kind, plan = MEASURES[criterion.name], run.plan
    found = findings.get(_key(criterion), [])
    axes: Sequence[str] = ("",)
    if kind.per_axis:
        axes = [criterion.axis] if criterion.axis else plan.axes
    for axis in axes:
        if axis and axis not in plan.axes:
            if not criterion.every_axis:
                note = f"the job has no axis {axis}"
                yield kind, RunFindings.made([Finding(value=None, axis=axis, note=note)])
            continue
        mine = [one for one in found if one.axis == axis]
        if criterion.step:
            mine = [one for one in mine if one.step in ("", criterion.step)]
        if not mine and not _endless(criterion.name, axis, plan):
            # A finding without an axis gives the reason why no axis was measured.
            reasons = [one for one in found if not one.axis]
            note = reasons[0].worst().note if reasons else _absent(criterion, kind, axis, run)
            blank = Finding(value=None, axis=axis, step=criterion.step, note=note)
            mine = [RunFindings.made([blank])]
        for one in mine:
            if not _replaced(criterion, one, spec):
                yield kind, one


def _absent(criterion: Criterion, kind: MeasureKind, axis: str, run: Run) -> str:
    """Return why there is no finding for an axis, or for the tool."""
    if kind.of_run(run) is None and kind.of_plan(run.plan) is None:
        return f"not a measure of {run.of}"
    if criterion.step:
        return f"nothing of step {criterion.step!r} was measured"
    return run.absent.format(axis=axis) if axis else "nothing was measured"


def _replaced(criterion: Criterion, found: RunFindings, spec: Spec) -> bool:
    """Return whether a criterion for one step replaces this one for every step there."""
    if criterion.step or not found.step:
        return False
    place = criterion.name, criterion.axis, found.step
    return any((other.name, other.axis, other.step) == place for other in spec.criteria)


def _endless(name: str, axis: str, plan: Plan) -> bool:
    return name == "travel" and axis in plan.machine.axes and plan.machine.axes[axis].endless


def _result(criterion: Criterion, kind: MeasureKind, plan: Plan, finding: Finding) -> Result:
    limit = limit_of(criterion, plan)
    unit = unit_of(kind, finding.axis, plan)
    finding = finding.somewhere().in_unit(unit).under(limit, kind.status)
    return Result(
        name=criterion.name,
        axis=finding.axis,
        step=finding.step,
        measured=finding.value,
        limit=limit,
        unit=unit,
        status=kind.status(finding.value, limit),
        required=criterion.required,
        hard=criterion.hard,
        time_s=finding.time_s,
        operation=finding.operation,
        job_line=finding.job_line,
        position=finding.position,
        typical=finding.typical,
        note="; ".join(filter(None, (finding.note, criterion.note))),
    )


def _lined(happened: Sequence[Disturbance], plan: Plan) -> list[Disturbance]:
    """Fill in the job lines of events."""
    operations = {one.operation for one in happened if one.operation is not None}
    lines = plan.intent.lines_of(plan.job, operations) if operations else {}
    return [
        one if one.operation is None else replace(one, job_line=lines.get(one.operation) or None)
        for one in happened
    ]


def _in_order(happened: Sequence[Disturbance]) -> list[Disturbance]:
    """Return events in the order of time; events without a time come last."""
    return sorted(happened, key=lambda one: np.inf if one.time_s is None else one.time_s)


def with_lines(results: Sequence[Result], plan: Plan) -> tuple[Result, ...]:
    """Return results with the job lines and passes that their measures did not know."""
    operations = {r.operation for r in results if r.operation is not None and r.job_line is None}
    lines = plan.intent.lines_of(plan.job, {o for o in operations if o is not None})
    lined = tuple(
        replace(result, job_line=lines.get(result.operation) or None)
        if result.operation is not None and result.job_line is None
        else result
        for result in results
    )
    return tuple(with_passes(lined, plan.job))
