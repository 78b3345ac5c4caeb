"""What a search for the fastest plan of a job tells: every plan that it proved, and the best.

``optimal`` plans the fastest motion within the limits that it is given. Without feed-forward one of
them is the contour allowance: how far the loads may leave the path. Encoder counts, levels of the
DAC and the spread from run to run add to that error, and how much is known only after a proof. So a
few plans are proved, with larger allowances until one fails and with smaller ones until one passes.
Near the limit it can be chance that one passes, so the answer is proved with a slightly smaller
allowance, too: one whose neighbour fails is called alone, and a slower one is the answer.
With feed-forward the loads follow the motion itself, and drives that are told positions have no
loop: the share of the acceleration and jerk limits is lowered until a plan passes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from threadline.dynamics import EARLIEST
from threadline.errors import LimitError
from threadline.jobs.operations import Feed, FeedMode, Job
from threadline.machine import Machine
from threadline.motion.timing.optimal.fastest_motion import least_time_s
from threadline.motion.timing.optimal.motion_limits import axis_limits, limits_of
from threadline.proof.option_words import LEAST_CONTOUR_M
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.search.fastest import Fastest
from threadline.search.feed import feed_range_m_s
from threadline.search.forbidden import Interval, closeness, worst_criterion
from threadline.search.paced import Question, beyond
from threadline.search.until import as_far_as
from threadline.verdict import Verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Rung:
    """The fastest plan at one share of the limits, or with one contour allowance.

    Parameters
    ----------
    share
        Share of the machine's acceleration and jerk limits that was used.
    found
        The feeds in spec.
    duration_s
        Duration of the job at the best of them; None where no feed passes.
    contour_m
        How far the loads were allowed to leave the path; None where the timing has no such limit.
    """

    share: float
    found: Fastest
    duration_s: float | None
    contour_m: float | None = None

    @property
    def alone(self) -> bool:
        """Whether its neighbours are out of specification."""
        return self.found.fastest is not None and self.found.fastest.alone


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """A lower bound on the time along a path.

    Parameters
    ----------
    within
        Whose limits alone it keeps: ``"the axes"``, or ``"axes and drives"``.
    duration_s
        The least time within them.
    """

    within: str
    duration_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FastestJob:
    """What was found: the rung with the shortest job, and all that were tried, by share.

    Parameters
    ----------
    bounds
        With ``optimal``: lower bounds on the time of the best plan; otherwise empty.
    left_out
        Shares of the limits that were not searched, because even at the highest feed the job takes
        no less time with them than with the best.
    moves, judged_moves, parts
        How many moves the job has, and how many of them in how many distinct stretches every try
        was judged by; 0 where it was judged by all of them.
    cut
        Whether tries were judged without the middles of moves that last long.
    whole
        Whether the best plan of the whole job was judged, too, where tries were judged by less.
    ended
        Why the search stopped before its end; empty where it did not.
    by
        What its feeds are of.
    """

    best: Rung
    rungs: tuple[Rung, ...]
    bounds: tuple[Bound, ...] = ()
    left_out: tuple[float, ...] = ()
    moves: int = 0
    judged_moves: int = 0
    parts: int = 0
    cut: bool = False
    whole: bool = True
    ended: str = ""
    by: FeedMode = FeedMode.FASTEST_AXIS


LIMITS = "limits"
"""``limited_by`` of a plan that passes with the full limits of axes and drives."""
ALLOWED = "contour"
"""``limited_by`` of a plan that passes with the contour allowance that it was given."""
_SHARES = (0.95, 0.9, 0.85, 0.75, 0.6, 0.4, 0.2)
_MOST_PROOFS = 8
_CLOSE = 1.03  # between the allowances of a plan that passes and one that fails
_AIM = 0.97  # of a limit
_LEAST_GROWTH, _MOST_GROWTH = 1.06, 1.5
_LEAST_FALL = 0.4
_BESIDE = 0.995  # of an allowance: its neighbour, which has to pass as well
_MOST_ALONE = 3
_PLACED = ("contour_error", "turning_point_error", "progress_error")


def fastest_allowed(asked: Question) -> FastestJob:
    """Return the fastest plan in spec, and the least times that the limits alone would allow.

    The options of the question are those of ``optimal``; if they name a contour allowance, only
    that one is tried. ``Question.high`` is a feed that caps the speed, m/s of the fastest axis;
    None for all that the axes can do.

    Raises
    ------
    PlanError
        If the machine cannot do the job.
    """
    job, machine, until = asked.job, asked.machine, asked.until
    top = feed_range_m_s(machine)[1] if asked.high is None else asked.high
    options = replace(asked.options, feed=Feed(FeedMode.FASTEST_AXIS, top))
    by_contour = options.follows_contour and not machine.takes_positions  # no loop, no lag

    def proved(amount: float) -> Rung:
        if until is not None:
            until.check()
        if asked.progress is not None:
            asked.progress("proving", len(rungs) / _MOST_PROOFS)
        chosen = (
            replace(options, contour_m=amount)
            if by_contour
            else replace(options, limit_share=amount)
        )
        try:
            plan = plan_job(job, machine, chosen)
        except LimitError as error:
            # The motion of loads that follow breaks a limit by what smooths it.
            if by_contour or error.quantity == "travel":
                raise
            return _rung(chosen, top, beyond(error, machine), None, by_contour)
        return _rung(chosen, top, asked.judged(plan), plan.duration_s, by_contour)

    rungs: dict[float, Rung] = {}
    next_one = _next_contour if by_contour else _next_share
    amount: float | None = options.timing.contour_m if by_contour else options.limit_share
    with as_far_as(until, lambda: rungs):
        while amount is not None:
            rungs[amount] = proved(amount)
            alone = by_contour and options.contour_m is not None
            amount = None if alone or len(rungs) >= _MOST_PROOFS else next_one(rungs)
        if by_contour and options.contour_m is None:
            _look_beside(rungs, proved)
    return FastestJob(
        best=_best(rungs, ALLOWED if by_contour else LIMITS),
        rungs=tuple(rungs[amount] for amount in sorted(rungs, reverse=True)),
        bounds=_bounds(job, machine, options),
        ended="" if until is None else until.ended,
    )


def _look_beside(rungs: dict[float, Rung], proved: Callable[[float], Rung]) -> None:
    """Prove neighbours of the fastest plans until one of both passes; mark those alone."""
    for _ in range(_MOST_ALONE):
        steady = [c for c, rung in rungs.items() if rung.duration_s is not None and not rung.alone]
        if not steady:
            return
        best = min(steady, key=lambda amount: rungs[amount].duration_s or math.inf)
        near = _short(best * _BESIDE)
        rungs[near] = rungs[near] if near in rungs else proved(near)
        if math.isinf(best) or rungs[near].duration_s is not None:
            return
        found = rungs[best].found
        alone = tuple(replace(interval, alone=True) for interval in found.intervals)
        rungs[best] = replace(rungs[best], found=replace(found, intervals=alone))


def _short(allowance_m: float) -> float:
    """Return an allowance of five digits: what is tried can be typed."""
    return float(f"{allowance_m:.5g}")


def options_at(asked: Question, rung: Rung) -> Options:
    """Return the options of a plan that was proved by ``fastest_allowed``."""
    top = feed_range_m_s(asked.machine)[1] if asked.high is None else asked.high
    return replace(
        asked.options,
        feed=Feed(FeedMode.FASTEST_AXIS, top),
        limit_share=rung.share,
        contour_m=asked.options.contour_m if rung.contour_m is None else rung.contour_m,
    )


def _rung(
    options: Options,
    feed_m_s: float,
    verdict: Verdict,
    duration_s: float | None,
    by_contour: bool,
) -> Rung:
    passed = verdict.passed
    found = Fastest(
        intervals=(Interval(low=feed_m_s, high=feed_m_s),) if passed else (),
        limited_by=worst_criterion(verdict)[0],
        verdict=verdict,
        tried=1,
    )
    return Rung(
        share=options.limit_share,
        found=found,
        duration_s=duration_s if passed else None,
        contour_m=options.timing.contour_m if by_contour else None,
    )


def _best(rungs: Mapping[float, Rung], otherwise: str) -> Rung:
    """Return the shortest that passes, with what forbids more; else the one that came closest."""
    passed = [amount for amount, rung in rungs.items() if rung.duration_s is not None]
    if not passed:
        return min(rungs.values(), key=lambda rung: closeness(rung.found.verdict))
    at = min(passed, key=lambda amount: (rungs[amount].alone, rungs[amount].duration_s or math.inf))
    above = [amount for amount, rung in rungs.items() if rung.duration_s is None and amount > at]
    limited_by = rungs[min(above)].found.limited_by if above else otherwise
    return replace(rungs[at], found=replace(rungs[at].found, limited_by=limited_by))


def _next_contour(rungs: Mapping[float, Rung]) -> float | None:
    """Return the allowance to try next, None where another would gain little."""
    passed = [c for c, rung in rungs.items() if rung.duration_s is not None]
    low = max(passed, default=0.0)
    high = min((c for c in rungs if c not in passed and c > low), default=math.inf)
    if math.isinf(low) or high <= _CLOSE * low or high <= LEAST_CONTOUR_M:
        return None
    if not passed:
        excess = worst_criterion(rungs[high].found.verdict)[1]
        return _short(max(high * max(_AIM / excess, _LEAST_FALL), LEAST_CONTOUR_M))
    if math.isinf(high):
        return _short(low * min(max(_AIM / _used(rungs[low]), _LEAST_GROWTH), _MOST_GROWTH))
    return _short(math.sqrt(low * high))


def _used(rung: Rung) -> float:
    """Return the largest share of a limit of where the loads are."""
    return max(
        (
            abs(result.measured) / result.limit
            for result in rung.found.verdict.results
            if result.name in _PLACED and result.limit and result.measured is not None
        ),
        default=1.0 / _MOST_GROWTH,
    )


def _next_share(rungs: Mapping[float, Rung]) -> float | None:
    """Return the next smaller share of the limits, until one passes."""
    least = min(rungs)
    if rungs[least].duration_s is not None:
        return None
    return next((share for share in _SHARES if share < least), None)


def _bounds(job: Job, machine: Machine, options: Options) -> tuple[Bound, ...]:
    """Return the least time within the limits of the axes, and within those of the drives, too."""
    freely = replace(options, feed_forward_s=None, contour_m=math.inf)
    path = plan_job(job, machine, freely).motion.path
    # A table may end before its loads stand, by so much at most.
    sooner_s = 0.0
    if options.timing.ends_m is not None:
        sooner_s = EARLIEST * float(machine.tick_clock.period_s)
    of_loads = not options.follows_contour
    drives = limits_of(machine, path.axes, path.radius_m, of_loads=of_loads)
    return tuple(
        Bound(within=within, duration_s=max(least_time_s(path, limits) - sooner_s, 0.0))
        for within, limits in (
            ("the axes", axis_limits(machine, path.axes, path.radius_m)),
            ("axes and drives", drives),
        )
    )
