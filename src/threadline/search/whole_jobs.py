"""The whole job in all runs, judged after a search that judged parts of the job, or one run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from threadline.commands.plan import Plan
from threadline.jobs.operations import Feed, FeedMode
from threadline.proof.pipeline import NOMINAL, plan_job
from threadline.search.allowance import Candidate
from threadline.search.deadline import until_deadline
from threadline.search.feed_ranges import Interval, closeness, used, worst_criterion
from threadline.search.paced import Question
from threadline.search.searched_edges import with_searched_edges
from threadline.verdict import Verdict

_LOWERED = 8  # largest number of feeds at which the whole job is tried
_LOWER = 0.98
_OVER_MACHINES = 12  # largest number of feeds tried over the tolerances, for one share
_LEAST_SLOWER, _MOST_SLOWER, _POWER = 1.04, 1.4, 0.7  # next duration = this power of the used share
_CLOSE = 1.02  # ratio of feeds at which a bisection ends
_UNKNOWN = 1.2  # used share that stands for a broken limit of 0
_SLOWED, _FIXED = 3.0, 0.01  # as in ``fastest``: slower motion does not change a fixed error


def planned_at(question: Question, share: float, feed: float) -> Plan:
    """Return the plan of the whole job at a feed of ``Question.by``, with a share of the limits."""
    by = FeedMode.FASTEST_AXIS if question.by is None else question.by
    options = replace(question.options, limit_share=share, feed=Feed(by, feed))
    return plan_job(question.job, question.machine, options)


def in_one_run(question: Question) -> Question:
    """Return the question for the trials of a search; a winding is judged by one run per feed.

    Near a limit, a verdict over repeats takes hundreds of runs and a verdict over tolerances takes
    hundreds of machines, which is too slow for a winding.
    """
    if question.options.product is None or question.trials != question.trials.without_others:
        return question
    if question.trials == NOMINAL:
        return question
    return replace(question, trials=NOMINAL)


def judged_whole(
    best: Candidate, candidates: dict[float, Candidate], question: Question, most: int
) -> Candidate:
    """Judge the whole job at the best share of the limits, or at the next; return the best result.

    At most ``most`` shares are tried, in order of duration, until one passes. For a winding over
    the tolerances, every share that may be the answer is tried. The results replace the entries of
    ``candidates``.
    """
    over_machines = question.options.product is not None and question.trials.machines > 0
    results, shortest_s = [best], math.inf
    for candidate in sorted(candidates.values(), key=in_order)[:most]:
        if candidate.duration_s is None or candidate.duration_s >= shortest_s:
            break
        result = (
            _over_machines(candidate, question, shortest_s)
            if over_machines
            else _of_whole(candidate, question)
        )
        candidates[candidate.share] = result
        results = [result] if candidate is best else [*results, result]
        shortest_s = min(shortest_s, math.inf if result.duration_s is None else result.duration_s)
        if result.found.fixed or (shortest_s < math.inf and not over_machines):
            break
    return min(results, key=in_order)


def with_searched_best(
    best: Candidate,
    candidates: dict[float, Candidate],
    question: Question,
    seen: Mapping[float, Mapping[float, Verdict]] | None,
) -> Candidate:
    """Return the best result with feeds that pass a search for a failing run.

    ``candidates`` is updated. If the result of another share becomes the best, its feeds are
    searched next. Once the time is over, nothing is searched.

    Parameters
    ----------
    seen
        Verdicts by feed, for each share. None: only the best feed of the best result is searched,
        because the other feeds were judged by parts of the job, or by one run.
    """
    searched_shares: set[float] = set()
    if not question.searches or (question.until is not None and question.until.ended):
        return best
    with until_deadline(question.until, lambda: candidates):
        while best.duration_s is not None and best.share not in searched_shares:
            searched_shares.add(best.share)
            best = candidates[best.share] = _with_searched(best, question, seen)
            if seen is not None:
                best = min(candidates.values(), key=in_order)
    return best


def _with_searched(
    best: Candidate, question: Question, seen: Mapping[float, Mapping[float, Verdict]] | None
) -> Candidate:
    known_verdicts = {} if seen is None else seen.get(best.share, {})

    def judged(feed: float) -> Verdict:
        if feed in known_verdicts:
            return known_verdicts[feed]
        return question.judged(planned_at(question, best.share, feed))

    def searched(feed: float, verdict: Verdict) -> Verdict:
        return question.searched(planned_at(question, best.share, feed), verdict)

    fastest = with_searched_edges(
        best.found, judged, searched, until=question.until, best_only=seen is None
    )
    if fastest.best is None or fastest.best == best.found.best:
        return replace(best, found=fastest, duration_s=best.duration_s if fastest.best else None)
    plan = planned_at(question, best.share, fastest.best)
    return replace(best, found=fastest, duration_s=plan.duration_s)


def in_order(candidate: Candidate) -> tuple[float, tuple[bool, float]]:
    """Return the sort key of a result: its duration, or its distance to spec if no feed passes."""
    if candidate.duration_s is None:
        return math.inf, closeness(candidate.found.verdict)
    return candidate.duration_s, (False, 0.0)


def _of_whole(best: Candidate, question: Question) -> Candidate:
    """Return ``best`` judged by the whole job, at the highest feed at which it is in spec."""
    interval = best.found.fastest
    assert interval is not None
    feed = interval.high
    for _ in range(_LOWERED):
        plan = planned_at(question, best.share, feed)
        verdict = question.judged(plan)
        if verdict.passed:
            return _passed(best, feed, verdict, plan.duration_s)
        feed = float(f"{feed * _LOWER:.6g}")
    return _failed(best, verdict)


def _over_machines(best: Candidate, question: Question, shortest_s: float) -> Candidate:
    """Return ``best`` at the highest tried feed at which all machines are in spec.

    The first machines are those that failed at the feed above, so a failing feed fails soon. A
    passing feed is judged on hundreds of machines, so the next feed follows from the size of the
    error and not from a fixed step. The machines are judged before the repeats of the file's
    machine, which may also be hundreds of runs near a limit.

    Parameters
    ----------
    shortest_s
        Duration of the best result so far, s; a longer job cannot be the answer.
    """
    interval = best.found.fastest
    assert interval is not None
    screening = replace(question, trials=replace(question.trials, repeats=1))
    feed: float | None = interval.high
    verdict = best.found.verdict
    first_worst: tuple[str, float, float] | None = None
    for _ in range(_OVER_MACHINES):
        if feed is None:
            break
        plan = planned_at(question, best.share, feed)
        duration_s = plan.duration_s
        if duration_s >= shortest_s:
            break
        verdict = screening.judged(plan)
        if verdict.passed:
            verdict = question.judged(plan)
        if verdict.passed:
            return _passed(best, feed, verdict, duration_s)
        worst = worst_criterion(verdict)[0], used(verdict), duration_s
        first_worst = first_worst or worst
        if duration_s >= _SLOWED * first_worst[2] and _same(worst[:2], first_worst[:2]):
            return _failed(best, verdict, fixed=worst[0])
        slowdown = min(max((worst[1] or _UNKNOWN) ** _POWER, _LEAST_SLOWER), _MOST_SLOWER)
        feed = _slower(question, best.share, feed, slowdown * duration_s)
    return _failed(best, verdict)


def _slower(question: Question, share: float, feed: float, lasts_s: float) -> float | None:
    """Return a lower feed at which the job takes about ``lasts_s``; None if it is out of range.

    At high feeds the duration depends only on acceleration and on the speed limits of the axes, so
    the feed may have to fall far.
    """
    low, high = feed, feed
    while planned_at(question, share, low).duration_s < lasts_s:
        if question.low is not None and low < question.low:
            return None
        low, high = low / _MOST_SLOWER, low
    while high > _CLOSE * low:
        middle = math.sqrt(low * high)
        if planned_at(question, share, middle).duration_s < lasts_s:
            high = middle
        else:
            low = middle
    return float(f"{low:.6g}")


def _same(worst: tuple[str, float], first: tuple[str, float]) -> bool:
    """Return whether criterion and used share are the same as in the first trial."""
    return worst[0] == first[0] and abs(worst[1] - first[1]) <= _FIXED * first[1] > 0.0


def _passed(best: Candidate, feed: float, verdict: Verdict, duration_s: float) -> Candidate:
    interval = best.found.fastest
    assert interval is not None
    intervals = best.found.intervals
    if feed < interval.high:
        # Higher feeds passed only for parts of the job or on the file's machine, not for the whole
        # job.
        passing = Interval(low=min(interval.low, feed), high=feed)
        intervals = (passing, *(i for i in intervals if i.high < passing.low))
    fastest = replace(best.found, intervals=intervals, verdict=verdict)
    return replace(best, found=fastest, duration_s=duration_s)


def _failed(best: Candidate, verdict: Verdict, fixed: str = "") -> Candidate:
    limited_by = worst_criterion(verdict)[0]
    fastest = replace(best.found, intervals=(), verdict=verdict, limited_by=limited_by, fixed=fixed)
    return replace(best, found=fastest, duration_s=None)
