"""Search for the fastest plan of a job within a contour allowance: all proved plans, and the best.

``optimal`` plans the fastest motion within the given limits. Without feed-forward one of the limits
is the contour allowance: the largest distance of the loads from the path. Encoder counts, DAC
levels and the spread between runs add to the contour error, and only a proof shows how much they
add. So the search proves a few plans: it raises the allowance until a plan fails, and lowers it
until a plan passes. Near the limit a plan can pass by chance. So a slightly smaller allowance is
proved, too. If the plan with the smaller allowance fails, the first plan is marked as isolated, and
a slower plan is the answer.
With feed-forward the loads follow the motion itself, and position-controlled drives have no loop to
lag. There the search lowers the share of the acceleration and jerk limits until a plan passes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from threadline.errors import LimitError
from threadline.jobs.operations import Feed, FeedMode
from threadline.proof.option_words import LEAST_CONTOUR_M
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.search.deadline import until_deadline
from threadline.search.fastest import Fastest
from threadline.search.feed import feed_range_m_s
from threadline.search.feed_ranges import Interval, closeness, worst_criterion
from threadline.search.least_times import Bound, bounds_of
from threadline.search.paced import Question, beyond
from threadline.verdict import Verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """The result of one trial: the fastest plan at one share of the limits, or one allowance.

    Parameters
    ----------
    share
        Share of the machine's acceleration and jerk limits that the plan uses.
    found
        The feeds in spec.
    duration_s
        Duration of the job at the best feed; None where no feed passes.
    contour_m
        Contour allowance of the plan, m; None if the timing has no such limit.
    options
        Options of the plan if the search chose several; None if it chose only the allowance or the
        share.
    """

    share: float
    found: Fastest
    duration_s: float | None
    contour_m: float | None = None
    options: Options | None = None

    @property
    def isolated(self) -> bool:
        """Whether the plans with neighbouring allowances are out of specification."""
        return self.found.fastest is not None and self.found.fastest.isolated


@dataclass(frozen=True, slots=True, kw_only=True)
class FastestJob:
    """Result of a search: the trial with the shortest job, and all trials by share of the limits.

    Parameters
    ----------
    bounds
        With ``optimal``: lower bounds on the time of the best plan; otherwise empty.
    left_out
        Shares of the limits that the search skipped, because even at the highest feed the job takes
        no less time with them than with the best share.
    moves, judged_moves, parts
        Number of moves of the job; number of moves in every trial, and number of distinct
        stretches that hold them. 0 where the whole job was judged.
    cut
        Whether trials were judged without the middles of long moves.
    whole
        Whether the best plan of the whole job was judged, too, after trials of a part of the job.
    in_one_run
        Whether every trial was judged by one run of the file's machine. If ``whole`` is true, too,
        the best plan was judged at the requested level.
    ended
        Reason for which the search stopped early; empty if it was completed.
    left
        With ``optimal``: largest number of places that a search left untried when it stopped early.
    by
        Feed mode of the feeds in the result.
    enough
        If only limits are judged and even the highest feed passes: the lowest feed found, in
        the same unit, with which the job takes at most 0.1 % longer. Otherwise None.
    """

    best: Candidate
    candidates: tuple[Candidate, ...]
    bounds: tuple[Bound, ...] = ()
    left_out: tuple[float, ...] = ()
    moves: int = 0
    judged_moves: int = 0
    parts: int = 0
    cut: bool = False
    whole: bool = True
    in_one_run: bool = False
    ended: str = ""
    left: int = 0
    by: FeedMode = FeedMode.FASTEST_AXIS
    enough: float | None = None


LIMITS = "limits"
"""``limited_by`` of a plan that passes with the full limits of axes and drives."""
ALLOWED = "contour"
"""``limited_by`` of a plan that passes with the given contour allowance."""
_SHARES = (0.95, 0.9, 0.85, 0.75, 0.6, 0.4, 0.2)
_MOST_PROOFS = 8
_CLOSE = 1.03  # the search ends below this ratio of a failing allowance to a passing one
_AIM = 0.97  # share of the limit that the next allowance aims at
_LEAST_GROWTH, _MOST_GROWTH = 1.06, 1.5
_LEAST_FALL = 0.4
_BESIDE = 0.995  # factor from an allowance to its neighbour, which must pass as well
_MOST_NEIGHBOURS = 3
_PLACED = ("contour_error", "turning_point_error", "progress_error")


def fastest_allowed(question: Question) -> FastestJob:
    """Return the fastest plan in spec, and the least times within the limits alone.

    The question takes the options of ``optimal``. If they name a contour allowance, only this
    allowance is tried. ``Question.high`` is a feed that caps the speed, m/s of the fastest axis;
    None: no cap below the axes' own limits.

    Raises
    ------
    PlanError
        If the machine cannot do the job.
    """
    job, machine, until = question.job, question.machine, question.until
    top_feed_m_s = feed_range_m_s(machine)[1] if question.high is None else question.high
    options = replace(question.options, feed=Feed(FeedMode.FASTEST_AXIS, top_feed_m_s))
    by_contour = options.follows_contour and not machine.takes_positions  # no loop lags

    def proved(amount: float) -> Candidate:
        if until is not None:
            until.check()
        if question.progress is not None:
            question.progress("proving", len(candidates) / _MOST_PROOFS)
        trial_options = (
            replace(options, contour_m=amount)
            if by_contour
            else replace(options, limit_share=amount)
        )
        try:
            plan = plan_job(job, machine, trial_options)
        except LimitError as error:
            # With feed-forward the loads follow the motion, and the smoothing can make it break a
            # limit.
            if by_contour or error.quantity == "travel":
                raise
            return candidate_of(
                trial_options, top_feed_m_s, beyond(error, machine), None, by_contour
            )
        verdict = question.searched(plan, question.judged(plan))
        return candidate_of(trial_options, top_feed_m_s, verdict, plan.duration_s, by_contour)

    candidates: dict[float, Candidate] = {}
    next_amount = _next_contour if by_contour else _next_share
    amount: float | None = options.timing.contour_m if by_contour else options.limit_share
    with until_deadline(until, lambda: candidates):
        while amount is not None:
            candidates[amount] = proved(amount)
            is_single = by_contour and options.contour_m is not None
            amount = (
                None if is_single or len(candidates) >= _MOST_PROOFS else next_amount(candidates)
            )
        if by_contour and options.contour_m is None:
            _look_beside(candidates, proved)
    return FastestJob(
        best=_best(candidates, ALLOWED if by_contour else LIMITS),
        candidates=tuple(candidates[amount] for amount in sorted(candidates, reverse=True)),
        bounds=bounds_of(job, machine, options),
        ended="" if until is None else until.ended,
    )


def _look_beside(candidates: dict[float, Candidate], proved: Callable[[float], Candidate]) -> None:
    """Prove neighbours of the fastest plans until plan and neighbour pass; mark isolated plans."""
    for _ in range(_MOST_NEIGHBOURS):
        passing = [
            c
            for c, candidate in candidates.items()
            if candidate.duration_s is not None and not candidate.isolated
        ]
        if not passing:
            return
        best_m = min(passing, key=lambda amount: candidates[amount].duration_s or math.inf)
        neighbour_m = _short(best_m * _BESIDE)
        candidates[neighbour_m] = (
            candidates[neighbour_m] if neighbour_m in candidates else proved(neighbour_m)
        )
        if math.isinf(best_m) or candidates[neighbour_m].duration_s is not None:
            return
        found = candidates[best_m].found
        isolated = tuple(replace(interval, isolated=True) for interval in found.intervals)
        candidates[best_m] = replace(candidates[best_m], found=replace(found, intervals=isolated))


def _short(allowance_m: float) -> float:
    """Return an allowance with five digits, so that a user can type the tried value."""
    return float(f"{allowance_m:.5g}")


def options_at(question: Question, candidate: Candidate) -> Options:
    """Return the planning options with which ``fastest_allowed`` proved a candidate."""
    if candidate.options is not None:
        return candidate.options
    top_feed_m_s = feed_range_m_s(question.machine)[1] if question.high is None else question.high
    return replace(
        question.options,
        feed=Feed(FeedMode.FASTEST_AXIS, top_feed_m_s),
        limit_share=candidate.share,
        contour_m=question.options.contour_m
        if candidate.contour_m is None
        else candidate.contour_m,
    )


def candidate_of(
    options: Options, feed_m_s: float, verdict: Verdict, duration_s: float | None, by_contour: bool
) -> Candidate:
    """Return the result of one plan."""
    passed = verdict.passed
    found = Fastest(
        intervals=(Interval(low=feed_m_s, high=feed_m_s),) if passed else (),
        limited_by=worst_criterion(verdict)[0],
        verdict=verdict,
        tried=1,
    )
    return Candidate(
        share=options.limit_share,
        found=found,
        duration_s=duration_s if passed else None,
        contour_m=options.timing.contour_m if by_contour else None,
    )


def _best(candidates: Mapping[float, Candidate], default_limit: str) -> Candidate:
    """Return the passing trial with the shortest job, or else the trial closest to passing."""
    passed = [
        amount for amount, candidate in candidates.items() if candidate.duration_s is not None
    ]
    if not passed:
        return min(candidates.values(), key=lambda candidate: closeness(candidate.found.verdict))
    best_amount = min(
        passed,
        key=lambda amount: (candidates[amount].isolated, candidates[amount].duration_s or math.inf),
    )
    failed_above = [
        amount
        for amount, candidate in candidates.items()
        if candidate.duration_s is None and amount > best_amount
    ]
    limited_by = candidates[min(failed_above)].found.limited_by if failed_above else default_limit
    return replace(
        candidates[best_amount], found=replace(candidates[best_amount].found, limited_by=limited_by)
    )


def _next_contour(candidates: Mapping[float, Candidate]) -> float | None:
    """Return the next allowance to try; None where another trial would gain little."""
    passed = [c for c, candidate in candidates.items() if candidate.duration_s is not None]
    passed_m = max(passed, default=0.0)
    failed_m = min((c for c in candidates if c not in passed and c > passed_m), default=math.inf)
    if math.isinf(passed_m) or failed_m <= _CLOSE * passed_m or failed_m <= LEAST_CONTOUR_M:
        return None
    if not passed:
        excess = worst_criterion(candidates[failed_m].found.verdict)[1]
        return _short(max(failed_m * max(_AIM / excess, _LEAST_FALL), LEAST_CONTOUR_M))
    if math.isinf(failed_m):
        return _short(
            passed_m * min(max(_AIM / _used(candidates[passed_m]), _LEAST_GROWTH), _MOST_GROWTH)
        )
    return _short(math.sqrt(passed_m * failed_m))


def _used(candidate: Candidate) -> float:
    """Return the largest used share of the limits on load positions."""
    return max(
        (
            abs(result.measured) / result.limit
            for result in candidate.found.verdict.results
            if result.name in _PLACED and result.limit and result.measured is not None
        ),
        default=1.0 / _MOST_GROWTH,
    )


def _next_share(candidates: Mapping[float, Candidate]) -> float | None:
    """Return the next smaller share of the limits; None if a share has passed, or none is left."""
    least = min(candidates)
    if candidates[least].duration_s is not None:
        return None
    return next((share for share in _SHARES if share < least), None)
