"""The answer of a search that was judged in part, judged by the whole job in all of its runs."""

from __future__ import annotations

import math
from dataclasses import replace

from threadline.commands.plan import Plan
from threadline.jobs.operations import Feed, FeedMode
from threadline.proof.pipeline import NOMINAL, plan_job
from threadline.search.allowance import Rung
from threadline.search.feed_ranges import Interval, closeness, used, worst_criterion
from threadline.search.paced import Question
from threadline.verdict import Verdict

_LOWERED = 8  # feeds at which the whole job is tried
_LOWER = 0.98
_OVER_MACHINES = 12  # feeds of a share of the limits that are tried over the tolerances
_MOST_LOWERED, _LEAST_LOWERED, _POWER = 0.7, 0.96, 0.7  # a feed falls with the used share
_UNKNOWN = 1.2  # used share of a limit of 0 that is not kept
_CLOSE, _BETWEEN = 1.05, 2  # ratio of a failing and a passing feed, and tries between them
_SLOWED, _FIXED = 3.0, 0.01  # as in ``fastest``: no slower motion mends this error


def planned_at(question: Question, share: float, feed: float) -> Plan:
    """Return the plan of the whole job at a feed of ``Question.by``, with a share of the limits."""
    by = FeedMode.FASTEST_AXIS if question.by is None else question.by
    options = replace(question.options, limit_share=share, feed=Feed(by, feed))
    return plan_job(question.job, question.machine, options)


def in_one_run(question: Question) -> Question:
    """Return the question that a search asks at every feed: of a winding in one run.

    Near a limit a verdict over repeats takes hundreds of runs, one over tolerances takes hundreds
    of machines, and a winding runs long.
    """
    if question.options.product is None or question.trials != question.trials.alone:
        return question
    if question.trials == NOMINAL:
        return question
    return replace(question, trials=NOMINAL)


def judged_whole(best: Rung, rungs: dict[float, Rung], question: Question, most: int) -> Rung:
    """Return the best rung as the whole job is judged; where it fails, the next ones.

    ``most`` rungs are tried, and over the tolerances of a winding every rung that can be the
    answer. ``rungs`` take what was found.
    """
    over = question.options.product is not None and question.trials.machines > 0
    found, shortest_s = [best], math.inf
    for rung in sorted(rungs.values(), key=in_order)[:most]:
        if rung.duration_s is None or rung.duration_s >= shortest_s:
            break
        one = _over_machines(rung, question, shortest_s) if over else _of_whole(rung, question)
        rungs[rung.share] = one
        found = [one] if rung is best else [*found, one]
        shortest_s = min(shortest_s, math.inf if one.duration_s is None else one.duration_s)
        if one.found.fixed or (shortest_s < math.inf and not over):
            break
    return min(found, key=in_order)


def in_order(rung: Rung) -> tuple[float, tuple[bool, float]]:
    """Return the sort key of a rung: its duration; without a feed in spec, its distance to spec."""
    if rung.duration_s is None:
        return math.inf, closeness(rung.found.verdict)
    return rung.duration_s, (False, 0.0)


def _of_whole(best: Rung, question: Question) -> Rung:
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


def _over_machines(best: Rung, question: Question, shortest_s: float) -> Rung:
    """Return ``best`` at a feed at which all machines are in spec.

    A feed that fails does so in the first machines, as they failed at the feed above. It takes
    hundreds of machines to pass, so the feed falls at once by what the error asks for.

    Parameters
    ----------
    shortest_s
        Duration from which on the rung is not the answer.
    """
    interval = best.found.fastest
    assert interval is not None
    feed, failing, passed = interval.high, 0.0, best
    first: tuple[str, float] | None = None
    verdict, between = best.found.verdict, 0
    for _ in range(_OVER_MACHINES):
        plan = planned_at(question, best.share, feed)
        if passed is best and plan.duration_s >= shortest_s:
            break
        judged = question.judged(plan)
        if judged.passed:
            passed = _passed(best, feed, judged, plan.duration_s)
        else:
            verdict, failing = judged, feed
            worst = worst_criterion(judged)[0], used(judged)
            first = first or worst
            if feed * _SLOWED <= interval.high and _same(worst, first):
                return _failed(best, judged, fixed=worst[0])
        if passed is best:
            share = max(used(verdict) or _UNKNOWN, 1.0)
            feed *= min(max(share**-_POWER, _MOST_LOWERED), _LEAST_LOWERED)
        elif failing <= _CLOSE * (low := passed.found.best or feed) or between == _BETWEEN:
            break
        else:
            between += 1
            feed = math.sqrt(low * failing)
        feed = float(f"{feed:.6g}")
    return _failed(best, verdict) if passed is best else passed


def _same(worst: tuple[str, float], first: tuple[str, float]) -> bool:
    """Return whether a criterion exceeds its limit by the same as at the first feed."""
    return worst[0] == first[0] and abs(worst[1] - first[1]) <= _FIXED * first[1] > 0.0


def _passed(best: Rung, feed: float, verdict: Verdict, duration_s: float) -> Rung:
    interval = best.found.fastest
    assert interval is not None
    kept = best.found.intervals
    if feed < interval.high:
        # Parts, or the machine of the file, passed above this feed; the whole did not.
        own = Interval(low=min(interval.low, feed), high=feed)
        kept = (own, *(i for i in kept if i.high < own.low))
    found = replace(best.found, intervals=kept, verdict=verdict)
    return replace(best, found=found, duration_s=duration_s)


def _failed(best: Rung, verdict: Verdict, fixed: str = "") -> Rung:
    limited_by = worst_criterion(verdict)[0]
    found = replace(best.found, intervals=(), verdict=verdict, limited_by=limited_by, fixed=fixed)
    return replace(best, found=found, duration_s=None)
