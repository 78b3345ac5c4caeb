"""Ends of intervals of a pace that also pass a search for a failing run.

A search by pace ends at the plan that passes by the smallest margin, so a few drawn runs prove too
little. Near a limit, every end of an interval is therefore judged by the worst run that a search
finds, and moved inwards until it passes. The search varies encoder phases, friction and supply and,
over the tolerances, also the machine. The plans between the ends keep their verdicts on drawn runs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from threadline.search.deadline import Deadline
from threadline.search.fastest import Fastest
from threadline.search.feed_ranges import (
    Interval,
    Judged,
    closest_of,
    forbidden,
    refined,
    typeable,
    worst_criterion,
)
from threadline.verdict import Verdict


def with_searched_edges(
    found: Fastest,
    judged: Judged,
    searched: Callable[[float, Verdict], Verdict],
    *,
    until: Deadline | None = None,
    best_only: bool = False,
) -> Fastest:
    """Return the result with ends of intervals that also pass a search for a failing run.

    Parameters
    ----------
    judged
        Returns the verdict at a pace, as in the search of ``found``.
    searched
        Takes a pace and its verdict; returns the verdict after the search for a bad run.
    best_only
        Whether only the upper end of the fastest interval is searched.

    Raises
    ------
    HaltError
        If the time is over.
    """
    first = found.fastest
    if first is None:
        return found
    searched_verdicts: dict[float, Verdict] = {}

    def verdict_at(pace: float) -> Verdict:
        if pace not in searched_verdicts:
            if until is not None:
                until.check()
            at_best = pace == found.best
            first_verdict = found.verdict if at_best else judged(pace)
            searched_verdicts[pace] = (
                searched(pace, first_verdict) if first_verdict.passed else first_verdict
            )
        return searched_verdicts[pace]

    intervals: list[Interval] = []
    best_found = False
    for interval in found.intervals:
        if best_found or (best_only and interval.isolated and not first.isolated):
            intervals.append(interval)
            continue
        high = _held(verdict_at, interval.high, interval.low, found.edge)
        if high is None:
            continue
        low = interval.low if best_only else _held(verdict_at, interval.low, high, found.edge)
        low = high if low is None else min(low, high)
        isolated = interval.isolated or (low == high and interval.low < interval.high)
        intervals.append(Interval(low=low, high=high, isolated=isolated))
        best_found = best_only
    return _with_intervals(found, tuple(intervals), searched_verdicts)


def _held(verdict_at: Judged, end: float, far_end: float, edge: float) -> float | None:
    """Return the passing pace nearest to one end of an interval; None if none is found.

    Steps from the end towards the other end double until a pace passes. Then the gap between it and
    the last failing pace is bisected.
    """
    if verdict_at(end).passed:
        return end
    failing, step = end, edge
    inwards = 1.0 if far_end > end else -1.0
    while True:
        pace = typeable(end * (1.0 + inwards * step), end * edge)
        if inwards * (pace - far_end) >= 0.0:
            pace = far_end
        if pace == failing:
            return None
        if verdict_at(pace).passed:
            return refined(verdict_at, pace, failing, edge)
        failing, step = pace, 2.0 * step


def _with_intervals(
    found: Fastest, intervals: tuple[Interval, ...], known: dict[float, Verdict]
) -> Fastest:
    """Return a result with other intervals, and with the criterion that limits the fastest."""
    assert found.best is not None
    ends = {end for interval in found.intervals for end in (interval.low, interval.high)}
    tried = found.tried + len(known.keys() - ends)
    failing = {pace: verdict for pace, verdict in known.items() if not verdict.passed}
    result = replace(found, intervals=intervals, tried=tried)
    if result.best is None:
        closest = closest_of(failing.values())
        limited_by = worst_criterion(closest)[0]
        return replace(result, limited_by=limited_by, verdict=closest, forbidden=forbidden(failing))
    failing_above = [pace for pace in failing if pace > result.best]
    verdict = known.get(result.best, found.verdict)
    limited_by = (
        worst_criterion(failing[min(failing_above)])[0] if failing_above else found.limited_by
    )
    return replace(result, limited_by=limited_by, verdict=verdict)
