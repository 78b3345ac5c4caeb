"""The whole job in all runs, judged after a search that judged parts of the job, or one run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from threadline.commands.plan import Plan
from threadline.jobs.operations import Feed, FeedMode
from threadline.proof.pipeline import NOMINAL, plan_job
from threadline.search.allowance import Rung
from threadline.search.deadline import until_deadline
from threadline.search.feed_ranges import Interval, closeness, used, worst_criterion
from threadline.search.paced import Question
from threadline.search.searched_edges import with_searched_edges
from threadline.verdict import Verdict

_LOWERED = 8  # most feeds at which the whole job is tried
_LOWER = 0.98
_OVER_MACHINES = 12  # most feeds that are tried over the tolerances, for a share of the limits
_LEAST_SLOWER, _MOST_SLOWER, _POWER = 1.04, 1.4, 0.7  # the time grows with the used share
_CLOSE = 1.02  # ratio of feeds at which a bisection ends
_UNKNOWN = 1.2  # used share of a broken limit of 0
_SLOWED, _FIXED = 3.0, 0.01  # as in ``fastest``: an error that no slower motion mends


def planned_at(question: Question, share: float, feed: float) -> Plan:
    """Return the plan of the whole job at a feed of ``Question.by``, with a share of the limits."""
    by = FeedMode.FASTEST_AXIS if question.by is None else question.by
    options = replace(question.options, limit_share=share, feed=Feed(by, feed))
    return plan_job(question.job, question.machine, options)


def in_one_run(question: Question) -> Question:
    """Return the question that a search asks at every feed: for a winding, in one run.

    Near a limit a verdict over repeats takes hundreds of runs, a verdict over tolerances takes
    hundreds of machines, and a winding is long.
    """
    if question.options.product is None or question.trials != question.trials.alone:
        return question
    if question.trials == NOMINAL:
        return question
    return replace(question, trials=NOMINAL)


def judged_whole(best: Rung, rungs: dict[float, Rung], question: Question, most: int) -> Rung:
    """Judge the whole job at the best rung and, if it fails, at the next ones; return the best.

    At most ``most`` rungs are tried. For a winding over the tolerances, every one of them that can
    be the answer is tried. The results are written into ``rungs``.
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


def with_searched_best(
    best: Rung,
    rungs: dict[float, Rung],
    question: Question,
    seen: Mapping[float, Mapping[float, Verdict]] | None,
) -> Rung:
    """Return the best rung whose feeds also pass a search for a bad run; write it into ``rungs``.

    If another rung becomes the best, its feeds are searched next. Once the time is over, nothing is
    searched.

    Parameters
    ----------
    seen
        By share, the verdicts by feed. None: only the best feed of the best rung is searched,
        because the others were judged by parts of the job, or in one run.
    """
    done: set[float] = set()
    if not question.searches or (question.until is not None and question.until.ended):
        return best
    with until_deadline(question.until, lambda: rungs):
        while best.duration_s is not None and best.share not in done:
            done.add(best.share)
            best = rungs[best.share] = _with_searched(best, question, seen)
            if seen is not None:
                best = min(rungs.values(), key=in_order)
    return best


def _with_searched(
    best: Rung, question: Question, seen: Mapping[float, Mapping[float, Verdict]] | None
) -> Rung:
    known = {} if seen is None else seen.get(best.share, {})

    def judged(feed: float) -> Verdict:
        if feed in known:
            return known[feed]
        return question.judged(planned_at(question, best.share, feed))

    def searched(feed: float, verdict: Verdict) -> Verdict:
        return question.searched(planned_at(question, best.share, feed), verdict)

    found = with_searched_edges(
        best.found, judged, searched, until=question.until, best_alone=seen is None
    )
    if found.best is None or found.best == best.found.best:
        return replace(best, found=found, duration_s=best.duration_s if found.best else None)
    plan = planned_at(question, best.share, found.best)
    return replace(best, found=found, duration_s=plan.duration_s)


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
    """Return ``best`` at the first feed at which all machines are in spec.

    A failing feed fails on the first machines, because they failed at the feed above, too. A
    passing feed takes hundreds of machines, so the error sets the next feed, not a fixed step. The
    machines are tried before the repeats of the file's machine: near a limit these are hundreds,
    too.

    Parameters
    ----------
    shortest_s
        Duration from which on the rung cannot be the answer.
    """
    interval = best.found.fastest
    assert interval is not None
    screening = replace(question, trials=replace(question.trials, repeats=1))
    feed: float | None = interval.high
    verdict = best.found.verdict
    first: tuple[str, float, float] | None = None
    for _ in range(_OVER_MACHINES):
        if feed is None:
            break
        plan = planned_at(question, best.share, feed)
        lasts_s = plan.duration_s
        if lasts_s >= shortest_s:
            break
        verdict = screening.judged(plan)
        if verdict.passed:
            verdict = question.judged(plan)
        if verdict.passed:
            return _passed(best, feed, verdict, lasts_s)
        worst = worst_criterion(verdict)[0], used(verdict), lasts_s
        first = first or worst
        if lasts_s >= _SLOWED * first[2] and _same(worst[:2], first[:2]):
            return _failed(best, verdict, fixed=worst[0])
        slower = min(max((worst[1] or _UNKNOWN) ** _POWER, _LEAST_SLOWER), _MOST_SLOWER)
        feed = _slower(question, best.share, feed, slower * lasts_s)
    return _failed(best, verdict)


def _slower(question: Question, share: float, feed: float, lasts_s: float) -> float | None:
    """Return a lower feed at which the job takes about ``lasts_s``; None if no feed does.

    Above some feed, acceleration and the axes' speeds set the time, and no feed changes it.
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
    """Return whether a criterion uses the same share of its limit as at the first duration."""
    return worst[0] == first[0] and abs(worst[1] - first[1]) <= _FIXED * first[1] > 0.0


def _passed(best: Rung, feed: float, verdict: Verdict, duration_s: float) -> Rung:
    interval = best.found.fastest
    assert interval is not None
    kept = best.found.intervals
    if feed < interval.high:
        # Parts of the job, or the file's machine, passed above this feed; the whole job did not.
        own = Interval(low=min(interval.low, feed), high=feed)
        kept = (own, *(i for i in kept if i.high < own.low))
    found = replace(best.found, intervals=kept, verdict=verdict)
    return replace(best, found=found, duration_s=duration_s)


def _failed(best: Rung, verdict: Verdict, fixed: str = "") -> Rung:
    limited_by = worst_criterion(verdict)[0]
    found = replace(best.found, intervals=(), verdict=verdict, limited_by=limited_by, fixed=fixed)
    return replace(best, found=found, duration_s=None)
