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
    best_alone: bool = False,
) -> Fastest:
    """Return the result with ends of intervals that also pass a search for a failing run.

    Parameters
    ----------
    judged
        Returns the verdict at a pace, as in the search of ``found``.
    searched
        Takes a pace and its verdict; returns the verdict after the search for a bad run.
    best_alone
        Whether only the upper end of the fastest interval is searched.

    Raises
    ------
    HaltError
        If the time is over.
    """
    first = found.fastest
    if first is None:
        return found
    known: dict[float, Verdict] = {}

    def verdict_at(pace: float) -> Verdict:
        if pace not in known:
            if until is not None:
                until.check()
            at_best = pace == found.best
            before = found.verdict if at_best else judged(pace)
            known[pace] = searched(pace, before) if before.passed else before
        return known[pace]

    kept: list[Interval] = []
    enough = False
    for interval in found.intervals:
        if enough or (best_alone and interval.alone and not first.alone):
            kept.append(interval)
            continue
        high = _held(verdict_at, interval.high, interval.low, found.edge)
        if high is None:
            continue
        low = interval.low if best_alone else _held(verdict_at, interval.low, high, found.edge)
        low = high if low is None else min(low, high)
        alone = interval.alone or (low == high and interval.low < interval.high)
        kept.append(Interval(low=low, high=high, alone=alone))
        enough = best_alone
    return _with_kept(found, tuple(kept), known)


def _held(verdict_at: Judged, end: float, other: float, edge: float) -> float | None:
    """Return the passing pace nearest to one end of an interval; None if none is found.

    Steps from the end towards the other end double until a pace passes. Then the gap between it and
    the last failing pace is bisected.
    """
    if verdict_at(end).passed:
        return end
    failing, step = end, edge
    inwards = 1.0 if other > end else -1.0
    while True:
        pace = typeable(end * (1.0 + inwards * step), end * edge)
        if inwards * (pace - other) >= 0.0:
            pace = other
        if pace == failing:
            return None
        if verdict_at(pace).passed:
            return refined(verdict_at, pace, failing, edge)
        failing, step = pace, 2.0 * step


def _with_kept(found: Fastest, kept: tuple[Interval, ...], known: dict[float, Verdict]) -> Fastest:
    """Return a result with other intervals, and with the criterion that limits the fastest."""
    assert found.best is not None
    ends = {end for one in found.intervals for end in (one.low, one.high)}
    tried = found.tried + len(known.keys() - ends)
    failing = {pace: verdict for pace, verdict in known.items() if not verdict.passed}
    new = replace(found, intervals=kept, tried=tried)
    if new.best is None:
        closest = closest_of(failing.values())
        limited_by = worst_criterion(closest)[0]
        return replace(new, limited_by=limited_by, verdict=closest, forbidden=forbidden(failing))
    above = [pace for pace in failing if pace > new.best]
    verdict = known.get(new.best, found.verdict)
    limited_by = worst_criterion(failing[min(above)])[0] if above else found.limited_by
    return replace(new, limited_by=limited_by, verdict=verdict)
