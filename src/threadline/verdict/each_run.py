"""Results of every run and machine: shares of the limits, the worst, and confidence intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.motion.path.types import Timing
from threadline.verdict.demands import BRAKING, PATH_USE
from threadline.verdict.finding import Finding, RunFindings
from threadline.verdict.measure import MeasureKind
from threadline.verdict.registry import MEASURES
from threadline.verdict.types import Criterion, Result, Status, Verdict, is_measured

_WITHIN = "a machine within the tolerances"
_EXCUSED = ("acceleration", BRAKING, "jerk", PATH_USE)
_PLACED = 2  # worst runs whose place is kept: the worst machine may be judged separately


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CriterionRow:
    """A criterion, for one axis and step, in every run.

    Parameters
    ----------
    name, axis, step, limit, unit, required, hard
        As in a ``Result``.
    values
        (runs,) measured; NaN if nothing could be measured.
    failed
        (runs,) whether the limit is exceeded.
    of_plan
        Whether it is measured on the plan alone, and so equal in every run.
    places
        By the index of the run: finding, with time, operation and note, of the worst of the runs
        that were measured together.
    """

    name: str
    axis: str
    step: str
    limit: float | None
    unit: str
    required: bool
    hard: bool
    values: FloatArray
    failed: NDArray[np.bool_]
    of_plan: bool = False
    places: Mapping[int, Finding] = field(default_factory=dict)

    def taken(self, index: IntArray) -> CriterionRow:
        """Return the row of the runs at (n,) ``index``, in that order."""
        at = enumerate(index.tolist()) if self.places else ()
        places = {new: self.places[old] for new, old in at if old in self.places}
        return replace(self, values=self.values[index], failed=self.failed[index], places=places)

    @classmethod
    def joined(cls, parts: Sequence[CriterionRow]) -> CriterionRow:
        """Return the row of consecutive runs of the same plan."""
        values = np.concatenate([row.values for row in parts])
        failed = np.concatenate([row.failed for row in parts])
        begin = np.cumsum([0, *(len(row.values) for row in parts)]).tolist()
        places = {
            first + run: finding
            for first, row in zip(begin, parts, strict=False)
            for run, finding in row.places.items()
        }
        return replace(parts[0], values=values, failed=failed, places=places)

    def worst(self) -> tuple[float, Finding] | None:
        """Return the largest value that was measured, with its finding; None if there is none.

        Of runs with equal values, the first with a known place counts. If no place is known, the
        finding has none.
        """
        known = [is_measured(value, self.unit) for value in self.values.tolist()]
        if not any(known):
            return None
        most = float(self.values[known].max())
        equal = np.flatnonzero(self.values == most).tolist()
        placed = (self.places[run] for run in equal if run in self.places)
        return most, next(placed, Finding(value=most, axis=self.axis, step=self.step))

    @property
    def missed(self) -> NDArray[np.bool_]:
        """(runs,) whether it is required but could not be measured."""
        return np.isnan(self.values) & self.required

    @property
    def text(self) -> str:
        """Name, axis and step in words."""
        return " ".join(filter(None, (self.name, self.axis, self.step)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EachRun:
    """Every criterion in every run.

    Parameters
    ----------
    rows
        In the order of the specification.
    runs
        Number of runs.
    incomplete
        How a run ended before its last row; empty if every run was complete.
    """

    rows: tuple[CriterionRow, ...]
    runs: int
    incomplete: str = ""

    def __reduce__(self) -> tuple[Callable[..., EachRun], tuple[Any, ...]]:
        # Workers send many results of one run each: two tables are quicker than two arrays a row.
        heads = [tuple(getattr(row, name) for name in _HEAD) for row in self.rows]
        values = np.array([row.values for row in self.rows])
        failed = np.array([row.failed for row in self.rows])
        places = [row.places for row in self.rows]
        return _unpacked, (heads, values, failed, places, self.runs, self.incomplete)

    @property
    def passed(self) -> NDArray[np.bool_]:
        """(runs,) whether nothing failed and every required criterion was measured."""
        found = np.full(self.runs, not self.incomplete)
        for row in self.rows:
            found &= ~(row.failed | row.missed)
        return found

    def row(self, name: str, axis: str = "") -> CriterionRow:
        """Return the row of a criterion.

        Raises
        ------
        KeyError
            If it was not judged.
        """
        for row in self.rows:
            if row.name == name and row.axis == axis:
                return row
        raise KeyError((name, axis))

    @classmethod
    def joined(cls, parts: Sequence[EachRun]) -> EachRun:
        """Return consecutive runs of the same plan, joined."""
        if len(parts) == 1:
            return parts[0]
        return cls(
            rows=tuple(map(CriterionRow.joined, zip(*(part.rows for part in parts), strict=True))),
            runs=sum(part.runs for part in parts),
            incomplete=next(filter(None, (part.incomplete for part in parts)), ""),
        )

    def without_answer(self) -> EachRun:
        """Return the result of a run that cannot be simulated, with the same rows.

        Criteria of the plan alone keep their value; all others are infinite, and fail their limit.
        """
        rows = []
        for row in self.rows:
            if row.of_plan:
                rows.append(row.taken(np.zeros(1, dtype=np.int64)))
            else:
                failed = np.array([row.limit is not None])
                infinite = np.array([np.inf])
                rows.append(replace(row, values=infinite, failed=failed, places={}))
        return EachRun(rows=tuple(rows), runs=1)

    def taken(self, index: IntArray) -> EachRun:
        """Return the runs at (n,) ``index``, in that order."""
        rows = tuple(row.taken(index) for row in self.rows)
        return EachRun(rows=rows, runs=len(index), incomplete=self.incomplete)


_HEAD = ("name", "axis", "step", "limit", "unit", "required", "hard", "of_plan")


def _unpacked(
    heads: list[tuple[Any, ...]],
    values: FloatArray,
    failed: NDArray[np.bool_],
    places: list[Mapping[int, Finding]],
    runs: int,
    incomplete: str,
) -> EachRun:
    """Return a result from its pickle."""
    rows = tuple(
        CriterionRow(
            values=values[k],
            failed=failed[k],
            places=places[k],
            **dict(zip(_HEAD, head, strict=True)),
        )
        for k, head in enumerate(heads)
    )
    return EachRun(rows=rows, runs=runs, incomplete=incomplete)


def limit_of(criterion: Criterion, plan: Plan) -> float | None:
    """Return the limit of a criterion; None for limits that a historical plan may exceed.

    For a historical plan, simulation shows the effect of excess demands. Without dynamics in the
    machine file there is no simulation, so its limits apply, except to the firmware's own plan,
    whose velocity steps at corners are normal.
    """
    if not criterion.hard or criterion.name not in _EXCUSED or not plan.intent.historical:
        return criterion.limit
    if plan.machine.without_dynamics and plan.motion.path.timing is not Timing.FIRMWARE:
        return criterion.limit
    return None


def unit_of(kind: MeasureKind, axis: str, plan: Plan) -> str:
    """Return the SI unit of a measure for ``axis``; for the tool if it is empty."""
    return kind.unit("rotary" if axis in plan.machine.rotary else "linear")


def criterion_row(
    criterion: Criterion, kind: MeasureKind, plan: Plan, found: RunFindings, runs: int
) -> CriterionRow:
    """Return the results of ``runs`` runs; a value of the plan alone is repeated for each."""
    unit, limit = unit_of(kind, found.axis, plan), limit_of(criterion, plan)
    values = found.value if unit == "s" else np.where(np.isfinite(found.value), found.value, np.nan)
    values = _counted(found, values, kind, limit)
    if len(values) != runs:
        values = np.broadcast_to(values, (runs,))
    of_plan = kind.of_plan(plan) is not None
    return CriterionRow(
        name=criterion.name,
        axis=found.axis,
        step=found.step,
        limit=limit,
        unit=unit,
        required=criterion.required,
        hard=criterion.hard,
        values=values,
        failed=exceeded(kind, limit, values),
        of_plan=of_plan,
        places={} if of_plan or len(found) != runs else _places(found, values),
    )


def _counted(
    found: RunFindings, values: FloatArray, kind: MeasureKind, limit: float | None
) -> FloatArray:
    """Return (n,) values as they count under a limit, as in a verdict: NaN if not measured.

    The runs of one recording have the same samples, so all of them lack the same part or none.
    """
    first = found.of(0)
    if not first.unseen and first.hidden is None:
        return values
    counted = (found.of(run).under(limit, kind.status).value for run in range(len(values)))
    return np.array([np.nan if value is None else value for value in counted])


def _places(found: RunFindings, values: FloatArray) -> dict[int, Finding]:
    """Return the findings of the worst of (runs,) values that were measured, by run."""
    known = np.flatnonzero(~np.isnan(values))
    worst = known[np.argsort(-values[known], kind="stable")[:_PLACED]]
    return {run: found.of(run).somewhere() for run in worst.tolist()}


def exceeded(kind: MeasureKind, limit: float | None, values: FloatArray) -> NDArray[np.bool_]:
    """Return (n,) whether each of (n,) values exceeds a limit; NaN does not."""
    if limit is None:
        return np.zeros(len(values), dtype=np.bool_)
    return np.asarray(values > kind.slack * limit + kind.allowance)


def worst_of(
    verdict: Verdict,
    others: Sequence[tuple[str, Verdict]],
    over: Literal["ends", "band"] | None = "ends",
) -> Verdict:
    """Return ``verdict`` with every result replaced by the worst of all machines.

    Parameters
    ----------
    verdict
        The verdict on the nominal machine.
    others
        For each other machine, how it differs, and its verdict by the same specification. A
        criterion that is not measured there (repeatability in one run) keeps its result.
    over
        Which machines they are: the attribute of a verdict that counts them. None: they are not
        counted, and their results keep the number of the run.
    """
    results = list(verdict.results)
    for text, other in others:
        found = {(r.name, r.axis, r.step): r for r in other.results}
        for k, result in enumerate(results):
            one = found.get((result.name, result.axis, result.step))
            if one is not None and _worse(one, result):
                note = ", ".join(filter(None, (one.note, text)))
                results[k] = replace(one, note=note, run=None if over else one.run)
    worst, count = replace(verdict, results=tuple(results)), len(others)
    if over is None:
        return worst
    return replace(worst, ends=count) if over == "ends" else replace(worst, band=count)


def with_other_machines(verdict: Verdict, others: EachRun, text: str = _WITHIN) -> Verdict:
    """Return ``verdict`` with every result replaced by the worst of other machines, if it is worse.

    Such a result takes time, operation and position from the worst machine; ``with_lines`` adds the
    job line. A machine that could not be simulated is left out.

    Parameters
    ----------
    others
        The results of other machines by the same specification, one run each.
    text
        Note of a replaced result.
    """
    rows = {(row.name, row.axis, row.step): row for row in others.rows if not row.of_plan}
    results = list(verdict.results)
    for k, result in enumerate(results):
        row = rows.get((result.name, result.axis, result.step))
        if row is None:
            continue
        kind = MEASURES[row.name]
        worst = row.worst()
        most, place = (None, Finding(value=None)) if worst is None else worst
        other = replace(
            result,
            measured=most,
            status=kind.status(most, row.limit),
            time_s=place.time_s,
            operation=place.operation,
            job_line=place.job_line,
            position=place.position,
            passes=(),
            run=None,
            note=", ".join(filter(None, (place.note, text))),
        )
        if worst is not None and _worse(other, results[k]):
            results[k] = other
        if row.missed.any() and results[k].status is not Status.FAILED:
            results[k] = replace(
                other, measured=None, status=Status.NOT_MEASURED, note=text, time_s=None,
                operation=None, job_line=None, position=None,
            )  # fmt: skip
    return replace(verdict, results=tuple(results))


def _worse(one: Result, than: Result) -> bool:
    return one.status is not Status.NOT_MEASURED and one.severity > than.severity


CONFIDENCE = 0.95


def clopper_pearson(passed: int, tried: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the exact two-sided confidence interval of a proportion, ``passed`` of ``tried``.

    Clopper and Pearson (1934), "The use of confidence or fiducial limits illustrated in the case
    of the binomial".

    >>> low, high = clopper_pearson(10_000, 10_000)
    >>> f"{low:.5f} {high}"
    '0.99963 1.0'
    """
    from scipy.special import betaincinv  # slow to import, and few commands need it

    tail = 0.5 * (1.0 - confidence)
    low = 0.0 if not passed else float(betaincinv(passed, tried - passed + 1, tail))
    high = 1.0 if passed == tried else float(betaincinv(passed + 1, tried - passed, 1.0 - tail))
    return low, high


def at_least(passed: int, tried: int, confidence: float = CONFIDENCE) -> float:
    """Return the exact one-sided lower bound of a proportion, ``passed`` of ``tried``.

    >>> f"{at_least(200, 200):.4f}", f"{at_least(199, 200):.4f}", at_least(0, 200)
    ('0.9851', '0.9765', 0.0)
    """
    if passed == tried:
        return float((1.0 - confidence) ** (1.0 / tried)) if tried else 0.0
    return clopper_pearson(passed, tried, 2.0 * confidence - 1.0)[0]
