"""Moves of a plan, merged into straight chords for a firmware that plans its own ramps.

A chord has the highest speed of its moves. A plan of an hour has millions of moves, so the loops
over moves are compiled.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.base.progress import WRITING
from threadline.commands.planned_job import CHORD_TOLERANCE_M, ChordRun, planned_runs
from threadline.jobs.feed_times import feed_time_s
from threadline.jobs.gcode.dialects import DIALECTS
from threadline.jobs.gcode.feeds import RULES
from threadline.jobs.operations import Feed, FeedMode, Job, Operation, ToolEvent
from threadline.machine import Machine
from threadline.motion.timing.types import Trajectory

CLOSE_M = 1e-7
"""Largest error of an end point rounded to 0.0001 mm or degrees, with a margin."""
_RISE = 1e-3  # share of a speed
_STRAIGHT = 1e-6  # one minus the cosine of a turn that counts as straight

_MOST_POINTS = 100_000
_STRAIGHT_M = 2.0 * CLOSE_M  # points nearer to a line are on it: both its ends are rounded, too
MOST_CACHED = 24_000_000
"""Numbers of a plan that are kept in memory between two passes over it; 192 MB."""


class Chord(NamedTuple):
    """A straight move through (n, axes) ``points``, at ``speed`` at most.

    The move begins at ``points[0]``. ``speed`` is in m/s, measured as F of the target measures it.
    ``feed`` is the feed of the programmed move. ``acts`` happen when the chord begins.
    """

    points: FloatArray
    speed: float
    duration_s: float
    feed: Feed | None = None
    acts: tuple[ToolEvent, ...] = ()


class Runs:
    """The operations and the runs of moves of a plan, kept from the first pass to the next ones.

    A plan of more than ``MOST_CACHED`` numbers is read anew each time: memory stays bounded.
    """

    def __init__(self, read: Callable[[], Iterator[Operation | ChordRun]]) -> None:
        self._read = read
        self._cached: list[Operation | ChordRun] | None = None

    def __iter__(self) -> Iterator[Operation | ChordRun]:
        """Yield operations and runs in order."""
        if self._cached is not None:
            yield from self._cached
            return
        found: list[Operation | ChordRun] = []
        numbers = 0
        for item in self._read():
            numbers += item.ends.size + item.rates.size if isinstance(item, ChordRun) else 1
            if numbers <= MOST_CACHED:
                found.append(item)
            else:
                found.clear()
            yield item
        if numbers <= MOST_CACHED:
            self._cached = found


@dataclass(frozen=True, slots=True, eq=False)
class Chords:
    """The operations of a plan, with moves merged into chords; iteration may be repeated.

    Parameters
    ----------
    target, job, trajectory
        Target firmware, and job and motion of the plan.
    planned_on
        Machine of the plan.
    override
        Factor on the feeds of the job: no chord exceeds a feed times ``override``. None if another
        feed replaces the job's feeds.
    vertices
        Whether the plan goes through the ends of the program's moves, as a firmware itself does.
    own_feeds
        Whether F is the feed of the job, where job and target measure feeds alike. With
        ``vertices``, moves in different directions are then not merged, and moves with a replaced
        feed get their highest speed as F.
    """

    target: str
    job: Job
    trajectory: Trajectory
    planned_on: Machine
    override: float | None
    vertices: bool = False
    own_feeds: bool = False
    runs: Runs = field(init=False)

    def __post_init__(self) -> None:
        """Take the runs of moves from the plan."""
        runs = Runs(lambda: planned_runs(self.job, self.trajectory, self.planned_on))
        object.__setattr__(self, "runs", runs)

    def at_own_feeds(self) -> Chords:
        """Return the chords whose F is the feed of the job; they share the kept runs."""
        own = replace(self, own_feeds=True)
        object.__setattr__(own, "runs", self.runs)
        return own

    @property
    def machine(self) -> Machine:
        """The machine without its operator's feed, because the plan already contains that feed."""
        return replace(self.planned_on, operator=None)

    def __iter__(self) -> Iterator[Operation | Chord]:
        """Yield operations and chords in order, and report the progress to ``WRITING``."""
        stretch, done_s, whole_s = _Stretch(self), 0.0, self.trajectory.duration_s
        for item in self.runs:
            if not isinstance(item, ChordRun):
                yield from stretch.end()
                yield item
                continue
            acts = item.acts
            done_s += float((1.0 / item.rates).sum())
            WRITING.reach(done_s, whole_s)
            for first in range(0, len(item.ends), _MOST_POINTS):
                rest = slice(first, first + _MOST_POINTS)
                stands = item.rests and first == 0
                if stands or stretch.ends_before(item.feed, acts, len(item.ends[rest])):
                    yield from stretch.end()
                    stretch.feed, stretch.acts = item.feed, acts
                stretch.take(item.ends[rest], 1.0 / item.rates[rest])
                acts = ()
        yield from stretch.end()


class _Stretch:
    """Collected moves that follow each other at one programmed feed.

    Attributes
    ----------
    feed, acts
        Programmed feed, and actions at the start of the first move.
    """

    def __init__(self, chords: Chords) -> None:
        job, machine = chords.job, chords.machine
        dialect = DIALECTS[chords.target]
        mode, _ = RULES[dialect.feed_rule]
        self._unit, self._override = Feed(mode, 1.0), chords.override
        self._own_feeds = chords.own_feeds
        as_programmed = chords.own_feeds and chords.vertices
        self._within_m = _STRAIGHT_M if as_programmed else CHORD_TOLERANCE_M
        self._rapid_is_feed = dialect.rapid_is_feed
        self._axes, self._machine = job.axes, machine
        self._radius_m = machine.radius_m[[machine.axis_names.index(axis) for axis in job.axes]]
        self._start = np.array(job.start)
        self._ends: list[FloatArray] = []
        self._durations_s: list[FloatArray] = []
        self._count = 0
        self.feed: Feed | None = None
        self.acts: tuple[ToolEvent, ...] = ()

    def take(self, ends: FloatArray, durations_s: FloatArray) -> None:
        """Add (n, axes) ends of chords and their (n,) durations."""
        self._ends.append(ends)
        self._durations_s.append(durations_s)
        self._count += len(ends)

    def ends_before(self, feed: Feed | None, acts: tuple[ToolEvent, ...], more: int) -> bool:
        """Say whether the current stretch ends before ``more`` moves at a feed."""
        if not self._count or acts or self._count + more > _MOST_POINTS:
            return True
        if self._override is None:  # one feed for all moves but G0
            return travels(feed) != travels(self.feed)
        return feed != self.feed

    def end(self) -> Iterator[Chord]:
        """Yield the chords of the collected moves, and start the next stretch at their end."""
        if not self._count:
            return
        points = np.vstack([self._start, *self._ends])
        seconds = np.concatenate(self._durations_s)
        lengths = feed_time_s(np.diff(points, axis=0), self._unit, self._axes, self._machine)
        speeds = lengths / seconds
        if self.feed is not None and self.feed.mode is FeedMode.RAPID:
            if not self._rapid_is_feed:
                speeds = np.full(len(speeds), speeds.max())  # the program writes no F for G0
        elif self.feed is not None and self._override and self.feed.mode is self._unit.mode:
            # The plan accelerates to a faster move on the end of a slower one; F does not.
            most = self._override * self.feed.value
            speeds = np.full(len(speeds), most) if self._own_feeds else np.minimum(speeds, most)
        elif self._own_feeds:
            speeds = np.full(len(speeds), speeds.max())
        acts = self.acts
        for part in merged(points * self._radius_m, speeds, self._within_m):
            yield Chord(
                points[part.first : part.stop + 1],
                part.speed,
                float(seconds[part.first : part.stop].sum()),
                self.feed,
                acts,
            )
            acts = ()
        self._start = points[-1]
        self._ends, self._durations_s, self._count, self.acts = [], [], 0, ()


def travels(feed: Feed | None) -> bool:
    """Return whether moves at a feed are rapid moves, which take no feed."""
    return feed is not None and feed.travels


class Part(NamedTuple):
    """The moves from ``first`` up to ``stop``, not included, as one chord at ``speed`` at most."""

    first: int
    stop: int
    speed: float


def merged(
    points: FloatArray, speeds: FloatArray, within_m: float = CHORD_TOLERANCE_M
) -> list[Part]:
    """Return the chords of moves along (n + 1, axes) ``points`` of the tool at (n,) ``speeds``.

    No point is farther than ``within_m`` from its chord.
    """
    points = np.ascontiguousarray(points, dtype=float)
    first, stop, fastest = _chords(points, np.ascontiguousarray(speeds, dtype=float), within_m)
    return [Part(*one) for one in zip(first.tolist(), stop.tolist(), fastest.tolist(), strict=True)]


@njit(nogil=True)
def _chords(
    points: FloatArray, speeds: FloatArray, within_m: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the first move of each chord, the move behind its last one, and its speed."""
    moves = len(speeds)
    starts, stops = np.empty(moves, np.int64), np.empty(moves, np.int64)
    fastest = np.empty(moves)
    first, count = 0, 0
    for last in _humps(speeds, points):
        while first < last:
            stop = first + _longest(points, first, last, within_m)
            starts[count], stops[count] = first, stop
            fastest[count] = speeds[first:stop].max()
            count += 1
            first = stop
    kept = _without_slivers(starts, stops, fastest, count, points, within_m)
    return starts[:kept], stops[:kept], fastest[:kept]


@njit(nogil=True)
def _humps(speeds: FloatArray, points: FloatArray) -> IntArray:
    """Return the end of each stretch of (n,) speeds that rises and then falls at most once.

    Changes below ``_RISE`` of the speed do not count, because end points of moves are rounded. A
    stretch ends at the sharpest turn of (n + 1, axes) ``points`` between its slowest moves: the
    moves into and out of a corner are equally slow, and the corner belongs between them.
    """
    ends, count = np.empty(len(speeds) + 1, np.int64), 0
    highest = lowest = speeds[0]
    slowest = 0  # the first of the slowest moves that come one after the other
    for at in range(len(speeds)):
        speed = speeds[at]
        fallen = lowest < highest * (1.0 - _RISE)
        if fallen and speed > lowest * (1.0 + _RISE):
            ends[count] = _sharpest(points, slowest + 1, at)
            count += 1
            highest = lowest = speed
            slowest = at
        elif speed > highest:
            highest = lowest = speed
            slowest = at
        else:
            if speed < lowest * (1.0 - _RISE):
                slowest = at
            lowest = min(lowest, speed)
    ends[count] = len(speeds)
    return ends[: count + 1]


@njit(nogil=True)
def _sharpest(points: FloatArray, first: int, last: int) -> int:
    """Return the sharpest turn of the points from ``first`` to ``last``; the last of equal ones."""
    found, most = last, -1.0
    for k in range(first, last + 1):
        along = before = after = 0.0
        for a in range(points.shape[1]):
            into, out = points[k, a] - points[k - 1, a], points[k + 1, a] - points[k, a]
            along += into * out
            before += into * into
            after += out * out
        lengths = np.sqrt(before) * np.sqrt(after)
        turn = 1.0 - along / lengths if lengths > 0.0 else 0.0
        turn = turn if turn > _STRAIGHT else 0.0
        if turn >= most:
            found, most = k, turn
    return found


@njit(nogil=True)
def _without_slivers(
    first: IntArray, stop: IntArray, speed: FloatArray, count: int, points: FloatArray,
    within_m: float,
) -> int:  # fmt: skip
    """Join each chord shorter than the tolerance to its neighbour; return how many are left.

    Where a planned speed falls and rises again in the middle of a move, the rest of the move would
    become a block of its own. The joined chord takes the speed of the longer one: a speed over less
    than the tolerance of a chord has no effect.
    """
    kept = 0
    for k in range(count):
        if kept:
            before = kept - 1
            sliver = _short(points, first[before], stop[before], within_m)
            joins = sliver or _short(points, first[k], stop[k], within_m)
            if joins and _within(points, first[before], stop[k], within_m, within_m):
                stop[before] = stop[k]
                if sliver:
                    speed[before] = speed[k]
                continue
        first[kept], stop[kept], speed[kept] = first[k], stop[k], speed[k]
        kept += 1
    return kept


@njit(nogil=True)
def _short(points: FloatArray, first: int, stop: int, within_m: float) -> bool:
    """Return whether no point is as far as the tolerance from the first one."""
    for k in range(first, stop + 1):
        squared = 0.0
        for a in range(points.shape[1]):
            squared += (points[k, a] - points[first, a]) ** 2
        if squared >= within_m**2:
            return False
    return True


@njit(nogil=True)
def _longest(points: FloatArray, first: int, last: int, within_m: float) -> int:
    """Return how many moves from ``first`` on, up to ``last``, fit one chord, at least 1."""
    most = last - first
    good = 1
    while good < most and _within(points, first, first + min(2 * good, most), within_m, CLOSE_M):
        good = min(2 * good, most)
    bad = min(2 * good, most + 1)
    while bad - good > 1:
        middle = (good + bad) // 2
        if middle <= most and _within(points, first, first + middle, within_m, CLOSE_M):
            good = middle
        else:
            bad = middle
    return good


@njit(nogil=True)
def _within(points: FloatArray, first: int, last: int, most_m: float, back_m: float) -> bool:
    """Say whether points lie within ``most_m`` of the line from ``first`` to ``last``, in order.

    No step goes back along the line by more than ``back_m``, and no point lies more than ``back_m``
    beyond the ends of the line.
    """
    axes = points.shape[1]
    length = 0.0
    for a in range(axes):
        length += (points[last, a] - points[first, a]) ** 2
    length = np.sqrt(length)
    if length == 0.0:
        return False
    way = (points[last] - points[first]) / length
    before = 0.0
    for k in range(first, last + 1):
        along = away = 0.0
        for a in range(axes):
            along += (points[k, a] - points[first, a]) * way[a]
        if along - before < -back_m or along < -back_m or along > length + back_m:
            return False
        for a in range(axes):
            away += (points[k, a] - points[first, a] - along * way[a]) ** 2
        if not np.sqrt(away) <= most_m:
            return False
        before = along
    return True
