"""Intervals of feeds that pass, and the criteria that forbid the other feeds."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from threadline.verdict import Status, Verdict

Judged = Callable[[float], Verdict]
INSIDE = 16
"""Number of feeds tried inside an interval before it is accepted."""
_THIN = 0.96
"""If a feed uses a larger share of its tightest limit, a close neighbour may exceed that limit."""
BESIDE = (-47, -29, -16, -7, -3, -1, 1, 3, 7, 16, 29, 47)
"""Neighbours that are tried beside a feed with a thin margin, in multiples of ``_JUMP``."""
_JUMP = 2e-4
"""Relative distance of two feeds at which times round to different ticks."""
_LOOKS = 2
"""Number of feeds with the thinnest margins whose neighbours are tried, per interval."""
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """A range of feeds that pass; SI or counts per tick, as searched.

    Both ends were tried. Where the search examines its edges closely, feeds all over the range were
    tried, too.

    Parameters
    ----------
    isolated
        Whether the interval is one isolated feed: its neighbours on both sides, within the
        refinement of edges, are out of specification. Such a feed passes by chance of the rounding
        of times to whole ticks.
    """

    low: float
    high: float
    isolated: bool = False


def typeable(feed: float, gap: float) -> float:
    """Return ``feed`` with as few digits as change it by at most a hundredth of ``gap``.

    The shortened feed itself is tried, so a user who types it gets the same plan.
    """
    for digits in range(4, 16):
        rounded_feed = float(f"{feed:.{digits}g}")
        if abs(rounded_feed - feed) <= 0.01 * gap:
            return rounded_feed
    return feed


def refined(verdict_at: Judged, passing: float, failing: float, edge_relative: float) -> float:
    """Return the passing end of the bisected gap between a passing and a failing feed."""
    while abs(failing - passing) > edge_relative * min(passing, failing):
        middle = typeable(math.sqrt(passing * failing), abs(failing - passing))
        if verdict_at(middle).passed:
            passing = middle
        else:
            failing = middle
    return passing


def held_parts(
    verdict_at: Judged,
    seen: Mapping[float, Verdict],
    interval: Interval,
    edge_relative: float,
    *,
    inside: int = INSIDE,
    beside: Sequence[int] = BESIDE,
) -> list[Interval]:
    """Return the parts of an interval in which every tried feed passes.

    A feed between two passing feeds may fail: where a margin is thin, the result depends on the
    rounding of times to whole ticks. So feeds spread evenly by the golden ratio are tried inside
    the interval, and the interval is cut about each feed that fails. A part narrower than an edge
    is reduced to its highest feed, alone, unless it lies at an end of the search. Where a margin is
    thin, the used share of a limit jumps by a hundredth or two between feeds 0.02 % apart. So the
    neighbours of the tightest feeds of the remaining parts are tried, too.

    Parameters
    ----------
    inside
        Number of feeds tried inside an interval.
    beside
        Neighbours of a tight feed that are tried, in steps of 0.02 % of the feed.
    """
    parts, held = [interval], []
    while parts:
        part = parts.pop()
        width = part.high - part.low
        if width <= edge_relative * part.low:
            at_an_end = part.low <= min(seen) or part.high >= max(seen)
            held.append(
                part if at_an_end else Interval(low=part.high, high=part.high, isolated=True)
            )
            continue
        inner_feeds = [
            typeable(part.low + (_GOLDEN * k % 1.0) * width, width / inside)
            for k in range(1, inside + 1)
        ]
        failing = next((f for f in inner_feeds if not verdict_at(f).passed), None)
        if failing is None:
            failing = _beside_tightest(verdict_at, seen, part, beside)
        if failing is None:
            held.append(part)
            continue
        passing_feeds = [f for f in seen if part.low <= f <= part.high and seen[f].passed]
        passing_below = max(f for f in passing_feeds if f < failing)
        passing_above = min(f for f in passing_feeds if f > failing)
        parts.append(
            Interval(low=part.low, high=refined(verdict_at, passing_below, failing, edge_relative))
        )
        parts.append(
            Interval(low=refined(verdict_at, passing_above, failing, edge_relative), high=part.high)
        )
    return sorted(held, key=lambda part: part.low)


def _beside_tightest(
    verdict_at: Judged, seen: Mapping[float, Verdict], part: Interval, beside: Sequence[int]
) -> float | None:
    """Return a failing neighbour of a feed with a thin margin; None without one."""
    looked_at: set[float] = set()
    for _ in range(_LOOKS):
        share_used = {
            f: used(seen[f]) for f in seen if part.low <= f <= part.high and f not in looked_at
        }
        tightest = max(share_used, key=share_used.__getitem__, default=0.0)
        if share_used.get(tightest, 0.0) < _THIN:
            return None
        looked_at.add(tightest)
        for steps in beside:
            feed = typeable(tightest * (1.0 + steps * _JUMP), tightest * _JUMP)
            looked_at.add(feed)
            if part.low < feed < part.high and not verdict_at(feed).passed:
                return feed
    return None


def used(verdict: Verdict) -> float:
    """Return the used share of the tightest limit; 0 where no criterion was measured."""
    worst = verdict.tightest
    if worst is None or worst.measured is None or not worst.limit:
        return 0.0
    return abs(worst.measured) / worst.limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Forbidden:
    """The feeds that one criterion forbids.

    Parameters
    ----------
    name
        Name of the criterion that fails at these feeds by the largest factor.
    low, high
        The lowest and the highest of these feeds; other criteria may forbid feeds between them.
    feeds
        Number of tried feeds that the criterion forbids.
    repeated
        Number of these feeds that pass in one run of the file's machine, and fail over the
        requested runs and machines.
    """

    name: str
    low: float
    high: float
    feeds: int
    repeated: int


def forbidden(seen: Mapping[float, Verdict]) -> tuple[Forbidden, ...]:
    """Return the criteria that forbid feeds, the criterion of the slowest feeds first."""
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
    """Return the criteria of several searches over the same feeds, each criterion once."""
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
    """Return the verdict that came closest to passing."""
    return min(verdicts, key=closeness)


def closeness(verdict: Verdict) -> tuple[bool, float]:
    """Return the sort key of verdicts that fail; the closest verdict has the smallest key.

    A verdict that fails in the first run has no further runs, and these could exceed limits by
    more. So such a verdict ranks behind every verdict that passes its first run.
    """
    return not _beyond_one_run(verdict), worst_criterion(verdict)[1]


def _beyond_one_run(verdict: Verdict) -> bool:
    return verdict.runs + verdict.machines + verdict.ends + verdict.band > 1


def worst_criterion(verdict: Verdict) -> tuple[str, float]:
    """Return the criterion that exceeds its limit by the largest factor, and the factor.

    The factor is infinite if a required criterion was not measured, or a criterion with limit zero
    fails. Such a criterion is named only if no other fails.
    """
    worst_name, factor, without_ratio = "", 0.0, ""
    for result in verdict.results:
        if result.status is Status.FAILED and result.limit and result.measured is not None:
            ratio = result.measured / result.limit
            if ratio > factor:
                worst_name, factor = result.name, ratio
        elif result.status is Status.FAILED or (
            result.status is Status.NOT_MEASURED and result.required
        ):
            without_ratio = without_ratio or result.name
    return worst_name or without_ratio, math.inf if without_ratio else factor
