"""Shares of every limit that the candidates of a redesign use, judged over many runs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.machine import Machine
from threadline.machine.days import on_days
from threadline.machine.vary import REPEAT_SEED, Days, drawn_days
from threadline.proof.judge_runs import RunsJudge, cached_in_memory
from threadline.proof.pipeline import Trials
from threadline.search.design_space import Space
from threadline.verdict import Criterion, EachRun, Spec
from threadline.verdict.measure import OfRun
from threadline.verdict.needle import has_stitches
from threadline.verdict.registry import MEASURES

SETTLE_S = 0.25
HOPELESS = 1e3
"""Ratio of a variant that cannot be planned, simulated or measured; the largest ratio."""

_LENGTH = "stitch_length_error"
_SEAM = "seam_error"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ratios:
    """Used shares of the limits; n candidates, D needle delays.

    Parameters
    ----------
    names
        Names of the criteria other than the stitch length.
    others
        (n, criteria) ratio of measured to limit.
    length
        (n, D) ratio of the stitch length for each delay; None without a criterion of the stitch
        length.
    """

    names: tuple[str, ...]
    others: FloatArray
    length: FloatArray | None

    def worst_of(self, count: int) -> Ratios:
        """Return the worst of every ``count`` consecutive candidates (a candidate's corners)."""
        length = None
        if self.length is not None:
            length = self.length.reshape(-1, count, self.length.shape[1]).max(axis=1)
        return Ratios(
            names=self.names,
            others=self.others.reshape(-1, count, len(self.names)).max(axis=1),
            length=length,
        )

    def taken(self, index: IntArray) -> Ratios:
        """Return the ratios of some candidates."""
        length = None if self.length is None else self.length[index]
        return replace(self, others=self.others[index], length=length)

    def worse_at(self, index: IntArray, other: Ratios) -> Ratios:
        """Return a copy in which the rows ``index`` are the worse of these ratios and ``other``."""
        worse = self.taken(index).worse(other)
        others = self.others.copy()
        others[index] = worse.others
        length = None if self.length is None else self.length.copy()
        if length is not None and worse.length is not None:
            length[index] = worse.length
        return replace(self, others=others, length=length)

    def worse(self, other: Ratios) -> Ratios:
        """Return the worse of two ratios, candidate by candidate."""
        length = None
        if self.length is not None and other.length is not None:
            length = np.maximum(self.length, other.length)
        return Ratios(names=self.names, others=np.maximum(self.others, other.others), length=length)

    def best(self) -> tuple[FloatArray, np.ndarray]:
        """Return (n,) the worst ratio at the best delay, and (n,) the index of the best delay."""
        other_ratio = self.others.max(axis=1, initial=0.0)
        if self.length is None:
            return other_ratio, np.zeros(len(other_ratio), dtype=np.int64)
        best_delay = self.length.argmin(axis=1)
        return np.maximum(
            other_ratio, self.length[np.arange(len(other_ratio)), best_delay]
        ), best_delay

    def binding(self, index: int) -> str:
        """Return the criterion that uses the largest share of its limit in a candidate."""
        other_ratio = self.others[index].max(initial=0.0)
        if self.length is not None and self.length[index].min() >= other_ratio:
            return _LENGTH
        return self.names[int(self.others[index].argmax())] if self.names else _LENGTH


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DesignJudge:
    """Judges variants of a machine under the commands of one plan.

    Parameters
    ----------
    runs
        Judges the variants by every criterion with a limit, and by the stitch length once for each
        needle delay.
    others
        Criteria other than the stitch length.
    length
        Criteria of the stitch length, one for each of ``delays_s``; empty if the specification has
        none.
    delays_s
        (D,) needle delays; the specification's own delay where no delays are tried.
    """

    runs: RunsJudge
    others: tuple[Criterion, ...]
    length: tuple[Criterion, ...]
    delays_s: FloatArray

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the axes that the job moves."""
        return self.runs.plan.axes

    def ratios(
        self, variants: Mapping[str, FloatArray], phases: FloatArray | None = None
    ) -> Ratios:
        """Return the used share of each limit by variant; 1000 where there is no answer.

        Parameters
        ----------
        phases
            (V, axes) place of each encoder between two counts; 0.5 when None.
        """
        results = self.runs.judged(variants, phases)
        by_delay = [row for row in results.rows if row.name == _LENGTH]
        length = [
            _share(row.values, criterion.limit)
            for row, criterion in zip(by_delay, self.length, strict=True)
        ]
        return Ratios(
            names=tuple(f"{c.name} {c.axis}".strip() for c in self.others),
            others=np.array([_used(c, results) for c in self.others]).reshape(-1, results.runs).T,
            length=np.stack(length, axis=1) if length else None,
        )


def _used(criterion: Criterion, results: EachRun) -> FloatArray:
    """Return (runs,) the largest used share of a criterion's limit over its axes.

    An axis that the job does not move uses no share.
    """
    shares = [
        np.zeros(results.runs),
        *(
            _share(row.values, criterion.limit)
            for row in results.rows
            if row.name == criterion.name and criterion.axis in ("", row.axis)
        ),
    ]
    return np.asarray(np.max(shares, axis=0))


def _share(values: FloatArray, limit: float | None) -> FloatArray:
    """Return the values divided by a limit; 0 for a value that was not measured."""
    assert limit is not None
    measured = np.nan_to_num(values, nan=0.0, posinf=np.inf)
    if limit <= 0.0:
        return np.where(measured <= 0.0, 0.0, HOPELESS)
    return np.minimum(measured / limit, HOPELESS)


def design_judge(plan: Plan, machine: Machine, spec: Spec, delays_s: FloatArray) -> DesignJudge:
    """Prepare to judge variants of ``machine`` under the commands of ``plan``.

    Parameters
    ----------
    delays_s
        (D,) needle delays to try; empty for the specification's delay.
    """
    plan_in_memory = cached_in_memory(replace(plan, machine=machine))
    criteria = tuple(c for c in spec.criteria if _is_asked(c, plan_in_memory))
    length = tuple(c for c in criteria if c.name == _LENGTH)
    if not has_stitches(plan_in_memory.job):
        length = ()
    if length:
        length_criterion = length[0]
        if not len(delays_s):
            delays_s = np.array([length_criterion.options.get("delay", 0.0)])
        length = tuple(
            replace(length_criterion, options={**length_criterion.options, "delay": delay_s})
            for delay_s in delays_s.tolist()
        )
    others = tuple(c for c in criteria if c.name != _LENGTH)
    judged = replace(spec, criteria=(*others, *length))
    return DesignJudge(
        runs=RunsJudge(plan_in_memory, judged, settle_s=SETTLE_S),
        others=others,
        length=length,
        delays_s=delays_s,
    )


def _is_asked(criterion: Criterion, plan: Plan) -> bool:
    """Return whether the result of a criterion can differ between machines.

    The contour error between drawing and path is the same for every machine; only the proof checks
    it.
    """
    if criterion.name == _SEAM or criterion.limit is None:
        return False
    kind = MEASURES[criterion.name]
    return kind.of_plan(plan) is None and any(isinstance(r, OfRun) for r in kind.reads)


_Numbers = Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtherRuns:
    """The runs of a candidate beyond its first.

    Parameters
    ----------
    space
        The parameters and settings that may be changed.
    repeats
        Number of runs of each candidate in all, as ``prove`` draws them.
    corners
        Whether every corner of the space's tolerances counts, too, with one run each.
    """

    space: Space
    repeats: int
    corners: bool

    @classmethod
    def of(cls, space: Space, trials: Trials, *, corners: bool = False) -> OtherRuns:
        """Return the runs that screen candidates for a proof by ``trials``.

        Machines within the tolerances of the whole file are left to the proof. Here the corners of
        the changeable parameters represent them.
        """
        all_machines = trials.machines > 0 and trials.wanted_yield is None
        return cls(
            space=space,
            repeats=trials.repeats,
            # If machines are simulated one by one, the corners would take hours, so only the proof
            # judges them.
            corners=(corners or all_machines) and space.corner_count > 1 and not space.serial,
        )

    @property
    def asked(self) -> bool:
        """Whether there are any further runs."""
        return self.repeats > 1 or self.corners

    @property
    def words(self) -> str:
        """Runs and corners over which a ratio is the worst, in words."""
        runs = "1 run" if self.repeats == 1 else f"{self.repeats} runs"
        if not self.corners:
            return runs
        return f"{runs} and {self.space.corner_count} corners of the tolerances"

    def worst(
        self, judge: DesignJudge, points: FloatArray, numbers: _Numbers, own: Ratios, beyond: float
    ) -> tuple[Ratios, int]:
        """Return the worst ratios of (n, dims) candidates, and the number of simulated machines.

        Runs with the extremes of friction and supply come first. A candidate whose ratio exceeds
        ``beyond`` there is not tried in further runs.

        Parameters
        ----------
        numbers
            Path to (n,) values, with the numbers of the candidates' filters.
        own
            Ratios of the first runs.
        beyond
            Candidates with a larger ratio are not tried.
        """
        simulated, worst_ratios = 0, own
        for days in self._turns(len(judge.axes)):
            undecided = np.flatnonzero(worst_ratios.best()[0] <= beyond)
            if not len(undecided):
                break
            undecided_numbers = {k: v[undecided] for k, v in numbers.items()}
            phases: FloatArray | None = None
            if days is None:
                count, variants = (
                    self.space.corner_count,
                    self._off(points[undecided], undecided_numbers),
                )
            else:
                count, variants = len(days), on_days(self.space.machine, undecided_numbers, days)
                phases = np.tile(days.phases, (len(undecided), 1))
            simulated += len(undecided) * count
            worst_ratios = worst_ratios.worse_at(
                undecided, judge.ratios(variants, phases).worst_of(count)
            )
        return worst_ratios, simulated

    def _turns(self, axes: int) -> Iterator[Days | None]:
        """Yield groups of runs that are tried together; None for the corners."""
        if self.repeats > 1:
            days = drawn_days(self.repeats, axes, np.random.default_rng(REPEAT_SEED))
            yield from _hardest_first(days)
        if self.corners:
            yield None

    def _off(self, points: FloatArray, numbers: _Numbers) -> dict[str, FloatArray]:
        """Return the numbers of every corner of candidates, candidate by candidate."""
        # All corners get the filters of the nominal machine, because the real machine is unknown.
        repeated = {k: np.repeat(v, self.space.corner_count) for k, v in numbers.items()}
        return repeated | self.space.numbers(self.space.corners(points))


def _hardest_first(days: Days) -> Iterator[Days]:
    """Yield the runs beyond the first: extremes of friction and supply, then the others."""
    others: IntArray = np.arange(1, len(days))
    friction, supply = days.friction[others], days.supply[others]
    extremes = [friction.argmin(), friction.argmax(), supply.argmin(), supply.argmax()]
    hardest = np.unique(others[extremes])
    yield days.taken(hardest)
    remaining = np.setdiff1d(others, hardest)
    if len(remaining):
        yield days.taken(remaining)
