"""What forbids feeds: the criterion that each fails by most, and where a search came closest."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from threadline.verdict import Status, Verdict


@dataclass(frozen=True, slots=True, kw_only=True)
class Forbidden:
    """The feeds that one criterion forbids.

    Parameters
    ----------
    name
        Of the criterion that fails there by the largest factor, of those that were judged.
    low, high
        The lowest and the highest of these feeds; others between them may fail by another.
    feeds
        How many were tried.
    repeated
        How many of them pass in the one run of the machine as its file says, and fail over the runs
        and machines that were asked for.
    """

    name: str
    low: float
    high: float
    feeds: int
    repeated: int


def forbidden(seen: Mapping[float, Verdict]) -> tuple[Forbidden, ...]:
    """Return what forbids the feeds that fail, the criterion that forbids the slowest first."""
    by_name: defaultdict[str, list[float]] = defaultdict(list)
    for feed in sorted(seen):
        if not seen[feed].passed:
            by_name[worst_criterion(seen[feed])[0]].append(feed)
    return tuple(
        Forbidden(
            name=name,
            low=feeds[0],
            high=feeds[-1],
            feeds=len(feeds),
            repeated=sum(_beyond_one_run(seen[feed]) for feed in feeds),
        )
        for name, feeds in by_name.items()
    )


def joined(found: Iterable[Forbidden]) -> tuple[Forbidden, ...]:
    """Return what several searches of the same feeds were forbidden, each criterion once."""
    by_name: dict[str, Forbidden] = {}
    for one in found:
        other = by_name.get(one.name)
        by_name[one.name] = (
            one
            if other is None
            else Forbidden(
                name=one.name,
                low=min(one.low, other.low),
                high=max(one.high, other.high),
                feeds=one.feeds + other.feeds,
                repeated=one.repeated + other.repeated,
            )
        )
    return tuple(sorted(by_name.values(), key=lambda one: (one.low, one.high)))


def closest_of(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the verdict of where a search without a feed in specification came closest."""
    return min(verdicts, key=closeness)


def closeness(verdict: Verdict) -> tuple[bool, float]:
    """Return what the closest of verdicts that fail has least of.

    One that fails in the first run already was judged by that alone, and may exceed by more what
    only many runs show. So it is farther than any that comes through one run.
    """
    return not _beyond_one_run(verdict), worst_criterion(verdict)[1]


def _beyond_one_run(verdict: Verdict) -> bool:
    return verdict.runs + verdict.machines + verdict.ends > 1


def worst_criterion(verdict: Verdict) -> tuple[str, float]:
    """Return the criterion that exceeds its limit by the largest factor, and the factor.

    A required criterion that was not measured, or one whose limit is zero, exceeds it by
    infinitely much, but is named only when no other fails.
    """
    worst, factor, unbounded = "", 0.0, ""
    for result in verdict.results:
        if result.status is Status.FAILED and result.limit and result.measured is not None:
            ratio = result.measured / result.limit
            if ratio > factor:
                worst, factor = result.name, ratio
        elif result.status is Status.FAILED or (
            result.status is Status.NOT_MEASURED and result.required
        ):
            unbounded = unbounded or result.name
    return worst or unbounded, math.inf if unbounded else factor
