"""Intervals of feeds that pass, and what forbids the others."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from threadline.verdict import Status, Verdict

Judged = Callable[[float], Verdict]
INSIDE = 16
"""Feeds that are tried inside an interval before it is believed."""
_THIN = 0.96
"""What is used of the tightest limit where a feed right beside may use more than all of it."""
_BESIDE = (-47, -29, -16, -7, -3, -1, 1, 3, 7, 16, 29, 47)
"""Feeds that are tried beside such a one, in parts of ``_JUMP``."""
_JUMP = 2e-4
"""Relative distance of feeds whose times round to other ticks."""
_LOOKS = 2
"""How many of the tightest feeds of an interval are looked beside."""
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Interval:
    """A range of feeds that pass; SI or counts per tick, as searched.

    Both ends were tried, and, where the search looks near its edges, feeds all over it.

    Parameters
    ----------
    alone
        Whether it is one feed, whose neighbours on both sides, no farther than edges are refined,
        are out of specification: a chance of how times round to whole ticks.
    """

    low: float
    high: float
    alone: bool = False


def typeable(feed: float, gap: float) -> float:
    """Return ``feed`` with as few digits as move it by a hundredth of ``gap`` at the most.

    The shortened feed is the one that is tried: typed on a command line it gives the same plan.
    """
    for digits in range(4, 16):
        short = float(f"{feed:.{digits}g}")
        if abs(short - feed) <= 0.01 * gap:
            return short
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
    verdict_at: Judged, seen: Mapping[float, Verdict], interval: Interval, edge_relative: float
) -> list[Interval]:
    """Return the parts of an interval in which every feed that was looked at passes.

    Between two feeds that pass, one may fail: where a margin is thin, the rounding of times to
    whole ticks decides. So an interval is looked into at feeds spread evenly, by the golden ratio,
    and cut about each that fails; of a part narrower than an edge, but at an end of the search, its
    highest feed is left, alone. Where a margin is thin, what is used of a limit jumps by a
    hundredth or two from one feed to one 0.02 % beside it: so the tightest feeds of what is left
    are looked beside, too.
    """
    parts, found = [interval], []
    while parts:
        part = parts.pop()
        width = part.high - part.low
        if width <= edge_relative * part.low:
            at_an_end = part.low <= min(seen) or part.high >= max(seen)
            found.append(part if at_an_end else Interval(low=part.high, high=part.high, alone=True))
            continue
        inside = [
            typeable(part.low + (_GOLDEN * k % 1.0) * width, width / INSIDE)
            for k in range(1, INSIDE + 1)
        ]
        failing = next((f for f in inside if not verdict_at(f).passed), None)
        if failing is None:
            failing = _beside_tightest(verdict_at, seen, part)
        if failing is None:
            found.append(part)
            continue
        known = [f for f in seen if part.low <= f <= part.high and seen[f].passed]
        below = max(f for f in known if f < failing)
        above = min(f for f in known if f > failing)
        parts.append(
            Interval(low=part.low, high=refined(verdict_at, below, failing, edge_relative))
        )
        parts.append(
            Interval(low=refined(verdict_at, above, failing, edge_relative), high=part.high)
        )
    return sorted(found, key=lambda part: part.low)


def _beside_tightest(
    verdict_at: Judged, seen: Mapping[float, Verdict], part: Interval
) -> float | None:
    """Return a feed that fails right beside one of the tightest of an interval; None: none does."""
    looked: set[float] = set()
    for _ in range(_LOOKS):
        uses = {f: used(seen[f]) for f in seen if part.low <= f <= part.high and f not in looked}
        tightest = max(uses, key=uses.__getitem__, default=0.0)
        if uses.get(tightest, 0.0) < _THIN:
            return None
        looked.add(tightest)
        for steps in _BESIDE:
            feed = typeable(tightest * (1.0 + steps * _JUMP), tightest * _JUMP)
            looked.add(feed)
            if part.low < feed < part.high and not verdict_at(feed).passed:
                return feed
    return None


def used(verdict: Verdict) -> float:
    """Return the share of the tightest limit that is used; 0 where none was measured."""
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
    return verdict.runs + verdict.machines + verdict.ends + verdict.band > 1


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
