"""The fastest feed that stays in spec.

Passing is not monotone in speed: a loop that rings at one feed can be quiet at a higher feed. So
the search first scans the whole range, from above. Then it scans more finely about every change
between pass and fail, because thin margins there depend on the rounding of times to whole ticks.
Finally it refines the edges of every interval that passes.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from threadline.base.progress import TrialShares
from threadline.errors import OptionError
from threadline.search.deadline import Deadline, HaltError
from threadline.search.feed_ranges import (
    BESIDE,
    INSIDE,
    Forbidden,
    Interval,
    Judged,
    closest_of,
    forbidden,
    held_parts,
    refined,
    typeable,
    worst_criterion,
)
from threadline.verdict import Status, Verdict

EDGE_RELATIVE = 2e-3
_AT_ENDS = 2  # number of end feeds that stand for all feeds between them
_ENOUGH = 4  # number of consecutive feeds that must pass to end a scan from above
_SLOWED = 3.0
"""An error counts as fixed if it stays the same in a motion that is slower by this factor."""
_FIXED = 0.01
"""Largest relative change of a fixed error."""
RANGE = "range"
"""``limited_by`` of a search that reached the end of its range before any feed failed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Resolution of a search.

    Parameters
    ----------
    points
        Number of feeds in the scan. The search can miss an interval narrower than the spacing.
    near
        Number of feeds tried within each gap of the scan between pass and fail, and in the gaps
        beside it.
    edge
        Relative distance between a passing and a failing feed at which the refinement of an edge
        ends.
    every
        Whether every interval is examined closely. If not, only the fastest interval and feeds near
        its upper edge are examined closely; the scan then goes down from above until a few feeds in
        a row pass, or until an error is fixed: it exceeds its limit by the same value at every
        feed, however slow the motion is. Slower intervals are found by the scan and the bisection
        of edges alone.
    between
        Whether every feed between two passing feeds passes, too. This holds if only limits are
        judged that the planner keeps at every feed. If both ends of the range pass, no other feed
        is tried; without ``every``, the ends are the highest feed and one a few steps below it.
    inside, beside
        Number of feeds tried inside an interval that is examined closely, and the neighbours of a
        feed with a thin margin that are tried, in steps of 0.02 % of the feed.
    """

    points: int = 48
    near: int = 0
    edge: float = EDGE_RELATIVE
    every: bool = True
    between: bool = False
    inside: int = INSIDE
    beside: Sequence[int] = BESIDE

    def at_most(self, other: Grid | None) -> Grid:
        """Return the grid with at most the feeds that ``other`` tries; None stands for any number.

        >>> few = Grid(points=8, near=1, inside=2, beside=(-3, 3))
        >>> Grid(points=20, near=16).at_most(few) == few
        True
        """
        if other is None:
            return self
        return replace(
            self,
            points=min(self.points, other.points),
            near=min(self.near, other.near),
            inside=min(self.inside, other.inside),
            beside=min(self.beside, other.beside, key=len),
        )


PLAIN: Grid = Grid()
FINE: Grid = Grid(near=16)
"""Resolution of a search whose answer is printed."""
COARSE: Grid = Grid(points=12, edge=5e-3)
"""Resolution of one of many searches."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fastest:
    """Result of a search.

    Parameters
    ----------
    intervals
        Every found interval, the fastest first; empty when no feed passes.
    limited_by
        Criterion that fails just above the fastest interval; ``"range"`` when the range ends first.
        When no feed passes: the criterion that fails at the trial that came closest.
    verdict
        Verdict at the best feed; when no feed passes, at the trial that came closest.
    tried
        Number of tried feeds.
    step, near_step
        Relative distance of neighbouring feeds in the scan, and near the edges of intervals. The
        search can miss a narrower interval. 0 where two feeds stand for all feeds between them.
    low
        Lowest feed of the scan; feeds below it are unknown.
    edge
        Relative distance of pass and fail at the edges of intervals.
    complete
        Whether the search came to its end. If not, intervals reach from one tried feed to another,
        and the feeds between them are unknown.
    every
        Whether every interval was examined as closely as the fastest.
    forbidden
        When no feed passes: every criterion that forbids feeds, and the feeds it forbids.
    fixed
        When the scan from above ended at a fixed error: its criterion; else empty.
    """

    intervals: tuple[Interval, ...]
    limited_by: str
    verdict: Verdict
    tried: int
    step: float = 0.0
    near_step: float = 0.0
    low: float = 0.0
    edge: float = EDGE_RELATIVE
    complete: bool = True
    every: bool = True
    forbidden: tuple[Forbidden, ...] = ()
    fixed: str = ""

    @property
    def fastest(self) -> Interval | None:
        """The fastest interval; an isolated feed only if no wider interval passes."""
        return _first(self.intervals) if self.intervals else None

    @property
    def best(self) -> float | None:
        """The highest feed that passed; an isolated feed only if no other feed passed."""
        return None if self.fastest is None else self.fastest.high

    @property
    def isolated(self) -> tuple[float, ...]:
        """Isolated feeds, which pass while their close neighbours fail, the highest first."""
        return tuple(interval.high for interval in self.intervals if interval.isolated)


def check_range(low: float, high: float, unit: str) -> None:
    """Refuse a range that contains no feed to try.

    Raises
    ------
    OptionError
        If the lowest feed is not above 0 and below the highest, or the highest is infinite.
    """
    if not 0.0 < low < high < math.inf:
        raise OptionError(
            f"nothing to scan from {low:.6g} {unit} to {high:.6g} {unit}",
            remedy="Give a --low below --high; an end that is not given has a default.",
        )


def find_fastest(
    judged: Judged,
    low: float,
    high: float,
    grid: Grid = PLAIN,
    *,
    trials: TrialShares | None = None,
    until: Deadline | None = None,
    seen: dict[float, Verdict] | None = None,
) -> Fastest:
    """Scan feeds from ``low`` to ``high``, then refine every edge between pass and fail.

    Parameters
    ----------
    judged
        Returns the verdict at a feed.
    low, high
        Ends of the scan, ``0 < low < high``. Feeds are evenly spaced on a logarithmic scale,
        because the load on a machine's limits grows with powers of its speed.
    trials
        Receives the progress of the search.
    until
        Deadline of the search. With a deadline, an interrupt ends the search and not the program,
        once a feed was judged.
    seen
        Verdicts by feed from an earlier search of the same range. They are not judged again, and
        count as tried. The search adds its own verdicts.

    Raises
    ------
    OptionError
        If the range is empty.
    HaltError
        If the time is over before a feed was judged.
    """
    points, near, edge_relative = grid.points, grid.near, grid.edge
    if points < 2:
        raise ValueError(f"nothing to scan with {points} points, two are the least")
    check_range(low, high, "m/s")
    seen = {} if seen is None else seen
    trials_per_edge = float(np.log2(np.log(high / low) / points / edge_relative + 1.0))
    trials_inside = grid.inside if near else 0
    trials = TrialShares(None, "", 0.0) if trials is None else trials
    expected_trials = (
        points + 6.0 * near + 2.0 * trials_per_edge + trials_inside - len(seen)
    )  # estimate for one interval
    trials.expects(_AT_ENDS if grid.between else expected_trials)

    def verdict_at(feed: float) -> Verdict:
        if feed not in seen:
            if until is None:
                seen[feed] = judged(feed)
            else:
                until.check()
                with until.interrupting():
                    seen[feed] = judged(feed)
            trials.done()
        return seen[feed]

    def expects(edge_count: int) -> None:
        trials.expects(trials_per_edge * edge_count + trials_inside * (edge_count / 2.0 + 1.0))

    step = (high / low) ** (1.0 / (points - 1))
    steps: dict[str, Any] = {
        "every": grid.every,
        "step": step - 1.0,
        "near_step": step ** (1.0 / (near + 1)) - 1.0,
        "low": low,
        "edge": edge_relative,
    }
    complete = True
    try:
        intervals = _whole_range(verdict_at, (low, high), grid)
        steps |= {"step": 0.0, "near_step": 0.0} if intervals else {}
        if grid.between and not intervals:
            trials.expects(expected_trials)
        intervals = intervals or (_searched if grid.every else _searched_from_above)(
            verdict_at, seen, (low, high), grid, expects
        )
    except KeyboardInterrupt as signal:
        if until is None or not seen or not until.interrupted(signal):
            raise
        complete = False
    except HaltError:
        if not seen:
            raise
        complete = False
    if not complete:
        intervals = _between_tried(seen)
    intervals.reverse()
    if not intervals:
        closest = closest_of(seen.values())
        return Fastest(
            intervals=(),
            limited_by=worst_criterion(closest)[0],
            verdict=closest,
            tried=len(seen),
            complete=complete,
            forbidden=forbidden(seen),
            **_not_below(steps, seen),
        )
    steps["low"] = low if grid.every else min(seen)
    best_feed = _first(intervals).high
    # An isolated passing feed may lie between the best feed and the first failing feed.
    failed_above = [feed for feed in seen if feed > best_feed and not seen[feed].passed]
    limited_by = worst_criterion(seen[min(failed_above)])[0] if failed_above else RANGE
    return Fastest(
        intervals=tuple(intervals),
        limited_by=limited_by,
        verdict=seen[best_feed],
        tried=len(seen),
        complete=complete,
        **steps,
    )


def _not_below(steps: dict[str, Any], seen: Mapping[float, Verdict]) -> dict[str, Any]:
    """Return the steps of a search without an answer, with its lowest feed and its fixed error."""
    fixed = "" if steps["every"] else _fixed([seen[feed] for feed in sorted(seen)])
    return steps | {"low": min(seen), "fixed": fixed} if fixed else steps


def _between_tried(seen: Mapping[float, Verdict]) -> list[Interval]:
    """Return the intervals in which every tried feed passes, the lowest first."""
    intervals: list[Interval] = []
    previous_passed = False
    for feed in sorted(seen):
        passed = seen[feed].passed
        if passed:
            low = intervals.pop().low if previous_passed else feed
            intervals.append(Interval(low=low, high=feed))
        previous_passed = passed
    return intervals


def _whole_range(verdict_at: Judged, feed_range: tuple[float, float], grid: Grid) -> list[Interval]:
    """Return the interval between two feeds that stand for all others; empty if one fails."""
    if not grid.between:
        return []
    low, high = feed_range
    lower_feed = low if grid.every else _spaced(low, high, grid.points)[-min(_ENOUGH, grid.points)]
    passes = verdict_at(high).passed and verdict_at(lower_feed).passed
    return [Interval(low=lower_feed, high=high)] if passes else []


def _searched(
    verdict_at: Judged,
    seen: Mapping[float, Verdict],
    feed_range: tuple[float, float],
    grid: Grid,
    expects: Callable[[int], None],
) -> list[Interval]:
    """Return every interval that passes, the lowest first.

    ``expects`` is called with the number of edges to refine, once it is known.
    """
    points, near, edge_relative = grid.points, grid.near, grid.edge
    feeds = _spaced(*feed_range, points)
    passes = _feeds_pass(verdict_at, feeds)
    if near:
        feeds = _with_more_feeds(feeds, _gaps_to_refine(passes), near)
        passes = _feeds_pass(verdict_at, feeds)
    expects(sum(before != after for before, after in pairwise(passes)))
    intervals = _bounded(verdict_at, feeds, passes, edge_relative)
    if near:
        intervals = [
            part for interval in intervals for part in _examined(verdict_at, seen, interval, grid)
        ]
    return intervals


def _searched_from_above(
    verdict_at: Judged,
    seen: Mapping[float, Verdict],
    feed_range: tuple[float, float],
    grid: Grid,
    expects: Callable[[int], None],
) -> list[Interval]:
    """Return the intervals that pass, the lowest first; only the fastest is examined closely.

    The scan goes down until some feeds in a row pass. Then feeds are tried near the upper edge of
    the fastest interval, and inside it. If only isolated feeds of this interval pass, the next
    interval below is examined. If no interval remains, the whole range is searched, unless an error
    is fixed.
    """
    points, near, edge_relative = grid.points, grid.near, grid.edge
    scan = _down_to_passing(verdict_at, _spaced(*feed_range, points))
    if _fixed([verdict_at(feed) for feed in scan]):
        return []
    if not near:
        intervals = _bounded(verdict_at, scan, _feeds_pass(verdict_at, scan), edge_relative)
        expects(2 * len(intervals))
        return intervals
    refined_gaps: set[int] = set()
    while True:
        feeds = _with_more_feeds(scan, refined_gaps, near)
        intervals = _bounded(verdict_at, feeds, _feeds_pass(verdict_at, feeds), edge_relative)
        expects(1)
        examined: list[Interval] = []
        while intervals and all(part.isolated for part in examined):
            examined = _examined(verdict_at, seen, intervals.pop(), grid) + examined
        if all(part.isolated for part in examined):
            return _searched(verdict_at, seen, feed_range, grid, expects)
        highest_passing = max(part.high for part in examined if not part.isolated)
        gap = bisect_right(scan, highest_passing) - 1
        if gap in refined_gaps or gap == len(scan) - 1:
            return intervals + examined
        refined_gaps |= {gap - 1, gap, gap + 1}


def _examined(
    verdict_at: Judged, seen: Mapping[float, Verdict], interval: Interval, grid: Grid
) -> list[Interval]:
    return held_parts(verdict_at, seen, interval, grid.edge, inside=grid.inside, beside=grid.beside)


def _down_to_passing(verdict_at: Judged, feeds: list[float]) -> list[float]:
    """Return the highest feeds, down to ``_ENOUGH`` in a row that pass or to a fixed error."""
    passed_count, verdicts = 0, list[Verdict]()
    for index in range(len(feeds) - 1, -1, -1):
        verdicts.insert(0, verdict_at(feeds[index]))
        passed_count = passed_count + 1 if verdicts[0].passed else 0
        if passed_count == _ENOUGH or _fixed(verdicts):
            return feeds[index:]
    return feeds


def _fixed(verdicts: Sequence[Verdict]) -> str:
    """Return the criterion whose error is above its limit by the same value at every speed.

    Examples are an offset of the loops under a pull, and a program that leaves a part of its
    product bare. Empty if there is none. ``verdicts`` belong to one job, the slowest run first.
    """
    slowest, errors = _speeds(verdicts[0]), _failing(verdicts[0])
    for verdict in verdicts:
        failing = _failing(verdict)
        errors = {
            name: value
            for name, value in errors.items()
            if name in failing and abs(failing[name] - value) <= _FIXED * value
        }
        if not errors or verdict.passed:
            return ""
        speeds = _speeds(verdict)
        if speeds and all(speeds[axis] > _SLOWED * slowest[axis] for axis in speeds):
            return min(name for name, _, _ in errors)
    return ""


def _speeds(verdict: Verdict) -> dict[str, float]:
    """Return the highest speed of each axis that moves."""
    return {
        one.axis: abs(one.measured)
        for one in verdict.results
        if one.name == "velocity" and one.measured
    }


def _failing(verdict: Verdict) -> dict[tuple[str, str, str], float]:
    """Return the values that are above their limits, by criterion, axis and step."""
    return {
        (one.name, one.axis, one.step): abs(one.measured)
        for one in verdict.results
        if one.status is Status.FAILED and one.limit and one.measured is not None
    }


def _feeds_pass(verdict_at: Judged, feeds: Sequence[float]) -> list[bool]:
    """Return whether each feed passes. The highest feed is tried first.

    A high feed takes the least time to simulate, and a failing feed fails at once. So a search that
    ends early knows the highest passing feed, and has spent no time on slow feeds.
    """
    return [verdict_at(feed).passed for feed in reversed(feeds)][::-1]


def _bounded(
    verdict_at: Judged, feeds: Sequence[float], passes: Sequence[bool], edge_relative: float
) -> list[Interval]:
    """Return the intervals between feeds that fail, the lowest first, with their edges refined."""
    intervals: list[Interval] = []
    start: float | None = None
    for index, feed in enumerate(feeds):
        if passes[index] and start is None:
            start = (
                feed if index == 0 else refined(verdict_at, feed, feeds[index - 1], edge_relative)
            )
        is_end = index + 1 == len(feeds) or not passes[index + 1]
        if passes[index] and is_end and start is not None:
            is_last = index + 1 == len(feeds)
            stop = feed if is_last else refined(verdict_at, feed, feeds[index + 1], edge_relative)
            intervals.append(Interval(low=start, high=stop))
            start = None
    return intervals


def _first(intervals: Sequence[Interval]) -> Interval:
    """Return the first interval; an isolated feed only if there is no wider interval."""
    return min(intervals, key=lambda interval: interval.isolated)


def _gaps_to_refine(passes: Sequence[bool]) -> set[int]:
    """Return the gaps between pass and fail, and gaps beside them, by index of the lower feed."""
    edge_gaps = (gap for gap, (a, b) in enumerate(pairwise(passes)) if a != b)
    return {near_gap for gap in edge_gaps for near_gap in (gap - 1, gap, gap + 1)}


def _with_more_feeds(feeds: Sequence[float], gaps: Collection[int], near: int) -> list[float]:
    """Return ``feeds`` with ``near`` more feeds in each gap of ``gaps``."""
    finer = []
    for gap, feed in enumerate(feeds):
        finer.append(feed)
        if gap in gaps and gap < len(feeds) - 1:
            finer += _spaced(feed, feeds[gap + 1], near + 2)[1:-1]
    return finer


def _spaced(low: float, high: float, points: int) -> list[float]:
    """Return feeds evenly spaced on a logarithmic scale; the inner feeds have few digits."""
    share = (high / low) ** (1.0 / (points - 1)) - 1.0
    inner = [typeable(float(f), share * float(f)) for f in np.geomspace(low, high, points)[1:-1]]
    return [low, *inner, high]
