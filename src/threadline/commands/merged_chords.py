"""Moves of a plan, merged into chords for a firmware that plans its own ramps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.progress import WRITING
from threadline.commands.merging import CLOSE_M, merged
from threadline.commands.planned_job import CHORD_TOLERANCE_M, ChordRun, planned_runs
from threadline.jobs.feed_times import feed_time_s
from threadline.jobs.gcode.dialects import DIALECTS
from threadline.jobs.gcode.feeds import RULES
from threadline.jobs.operations import Feed, FeedMode, Job, Operation, ToolEvent
from threadline.machine import Machine
from threadline.motion.timing.types import Trajectory

_MOST_POINTS = 100_000
_STRAIGHT_M = 2.0 * CLOSE_M  # points nearer to a line are on it: both its ends are rounded, too
MOST_KEPT = 24_000_000
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

    A plan of more than ``MOST_KEPT`` numbers is read anew each time: memory stays bounded.
    """

    def __init__(self, read: Callable[[], Iterator[Operation | ChordRun]]) -> None:
        self._read = read
        self._kept: list[Operation | ChordRun] | None = None

    def __iter__(self) -> Iterator[Operation | ChordRun]:
        """Yield operations and runs in order."""
        if self._kept is not None:
            yield from self._kept
            return
        found: list[Operation | ChordRun] = []
        numbers = 0
        for item in self._read():
            numbers += item.ends.size + item.rates.size if isinstance(item, ChordRun) else 1
            if numbers <= MOST_KEPT:
                found.append(item)
            else:
                found.clear()
            yield item
        if numbers <= MOST_KEPT:
            self._kept = found


@dataclass(frozen=True, slots=True, eq=False)
class Chords:
    """The operations of a plan, with moves merged into chords; iteration may be repeated.

    Parameters
    ----------
    target, job, trajectory
        Firmware to write for, and the plan to write.
    planned_on
        Machine of the plan.
    override
        As in ``write_firmware_program``.
    vertices
        Whether the plan goes through the ends of the program's moves, as a firmware itself does.
    own_feeds
        Whether F is the feed of the job, where job and target measure feeds alike. With
        ``vertices``, moves in different directions are then not merged, and F of moves whose feed
        was replaced is their highest speed.
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
        """Yield operations and chords in order, and tell ``WRITING`` how far the motion is."""
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
