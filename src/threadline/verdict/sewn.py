"""Stitches as they were sewn: the time of each needle-down, and the position of the tool."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.files import ChannelKind, Recording
from threadline.motion.timing.types import TrajectoryReader
from threadline.verdict.blocks import find_first, judged_blocks, setting_of
from threadline.verdict.bow import bows
from threadline.verdict.nearest import nearest_chords
from threadline.verdict.needle import Stitches, has_stitches, planned_stitches
from threadline.verdict.samples import Block, Setting, lanes


class SewnClock:
    """Converts times of the plan into times of a recording, and back, over the buffered samples.

    Until the first hold the two are equal, to the bit.
    """

    def __init__(self) -> None:
        self._held = False
        self._time_s: FloatArray = np.empty(0)
        self._due_s: FloatArray = np.empty(0)
        self._slow_s: FloatArray = np.empty(0)  # samples before which the run was held

    def take(self, block: Block, used: IntArray) -> None:
        """Take the samples ``used`` of a block."""
        self._time_s = np.concatenate([self._time_s, block.time_s[used]])
        self._due_s = np.concatenate([self._due_s, block.due_s[used]])
        if block.slow is not None:
            self._held = True
            self._slow_s = np.concatenate([self._slow_s, block.time_s[block.slow]])

    def drop(self, before_s: float, slow_before_s: float) -> None:
        """Discard samples before an instant, except two, and slow ones before another instant."""
        first = max(int(np.searchsorted(self._time_s, before_s, side="right")) - 2, 0)
        self._time_s, self._due_s = self._time_s[first:], self._due_s[first:]
        self._slow_s = self._slow_s[np.searchsorted(self._slow_s, slow_before_s) :]

    def when(self, due_s: FloatArray) -> FloatArray:
        """Return (n,) first instants with the given ascending plan times; infinite if not yet."""
        if not self._held or not len(due_s):
            return due_s
        after = np.searchsorted(self._due_s, due_s, side="left")
        last = len(self._due_s) - 1
        before, at = np.clip(after - 1, 0, last), np.clip(after, 0, last)
        long_s = self._due_s[at] - self._due_s[before]
        part = np.where(long_s > 0.0, due_s - self._due_s[before], 0.0) / np.where(
            long_s > 0.0, long_s, 1.0
        )
        found = self._time_s[before] + part * (self._time_s[at] - self._time_s[before])
        early = due_s - self._due_s[0] + self._time_s[0]  # before the buffered samples
        return np.where(after > last, np.inf, np.where(after == 0, early, found))

    def due(self, time_s: FloatArray) -> FloatArray:
        """Return (n,) times of the plan at ascending instants."""
        if not self._held:
            return time_s
        return np.asarray(np.interp(time_s, self._time_s, self._due_s))

    def slowed(self, begin_s: FloatArray, end_s: FloatArray) -> NDArray[np.bool_]:
        """Return (n,) whether a run was held, or regained its speed, between instants."""
        first = np.searchsorted(self._slow_s, begin_s, side="right")
        return np.asarray(np.searchsorted(self._slow_s, end_s, side="right") > first)


_ACTUAL = (ChannelKind.TOOL, ChannelKind.LOAD)
_BEHIND, _AHEAD = 12, 3  # stitches before and after its own that a needle-down is compared with
_PARTS = 256  # of the averaging time of a speed: finer samples add nothing
_FINE_S = 0.002  # or of this time, since the averaging time is at most a part of a stitch
_TO_SPEED = 2  # exempt stitches before and after a rest
_SLOWEST = 1e-3  # of the highest speed of a following needle
Figure = Literal["length", "placement", "speed", "time"]
_ALL: tuple[Figure, ...] = ("length", "placement", "speed", "time")
PART_OF_STITCH = 0.25
"""Longest averaging time of the speed, as part of a stitch: a longer mean hides oscillation."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SewnStitches:
    """Stitches, and the position of the tool at each.

    Parameters
    ----------
    stitches
        The n stitches.
    down_s
        (n,) times of needle-down, the delay included.
    actual, begun
        (n, axes, runs) tool position at this and at the previous needle-down; lengths at the tool.
    length_error
        (n, runs) distance moved since the previous needle-down over the wanted distance, minus 1.
    placement_m
        (n, runs) distance of ``actual`` from the seam: the nearest point of the nearby stitches.
    speed_error
        (n, runs) relative error of the head's speed. The wanted speed is the wanted length of the
        stitch over its planned time, or times the planned needle speed if the needle follows the
        head. Speeds are means over ``over_s``, or over ``PART_OF_STITCH`` of the stitch if that is
        less. The error is the largest in the stitch, with its sign; NaN in a hold and for two
        stitches after it.
    speed_s
        (n, runs) the instant at the end of the averaging time.

    ``placement_m``, ``speed_error`` and ``speed_s`` are empty unless requested.
    """

    stitches: Stitches
    down_s: FloatArray
    actual: FloatArray
    begun: FloatArray
    length_error: FloatArray
    placement_m: FloatArray
    speed_error: FloatArray
    speed_s: FloatArray


class StitchFollower:
    """Takes the tool's position and returns the stitches sewn meanwhile.

    Between samples the path is the cubic Hermite interpolant of positions and velocities (``bow``).
    Without velocities it is taken as straight; the error is at most a T^2 / 8 with an acceleration
    a and a sample interval T. Stitches are returned as soon as they are complete, so only the
    samples of a stitch and of a block are kept.

    Parameters
    ----------
    setting
        Plan and recording.
    delay_s
        Delay of the needle-down after the command: the head's lag, to which the needle is set. A
        head that itself follows the motion has no delay.
    over_s
        Longest averaging time of the head's speed.
    figures
        The requested results; placement and speed take most of the time, and are optional.
    """

    def __init__(
        self,
        setting: Setting,
        delay_s: float,
        over_s: float = 0.002,
        figures: Collection[Figure] = _ALL,
    ) -> None:
        self._source = planned_stitches(setting.plan)
        self._columns = [setting.axes.index(axis) for axis in setting.plan.job.axes]
        self._geared = TrajectoryReader(setting.plan.motion.of_needle)
        self._radius_m = setting.radius_m
        self._delay_s = delay_s if setting.plan.motion.of_loads is None else 0.0
        self._over_s, self._figures = over_s, figures
        self._clock, self._begun_s = SewnClock(), np.full(_TO_SPEED, -np.inf)
        self._pending: list[Stitches] = []
        self._exhausted = False
        self._time_s: FloatArray = np.empty(0)
        self._points: FloatArray = np.empty((0, len(self._columns), setting.runs))
        self._bows, self._speeds_m_s = bows(setting), self._points
        self._seam: FloatArray | None = None  # needle points before the pending ones

    @property
    def unsewn(self) -> Stitches | None:
        """The stitches from the first one that no sample reached, if any."""
        self._pull(1)
        return self._pending[0] if self._pending else None

    def feed(self, block: Block) -> list[SewnStitches]:
        """Return the stitches, in groups, that are complete with the samples of a block."""
        time_s, actual = block.time_s, block.actual
        assert actual is not None
        used = self._rows_used(time_s)
        self._clock.take(block, used)
        points = self._at_tool(actual[used])
        self._time_s = np.concatenate([self._time_s, time_s[used]])
        self._points = np.concatenate([self._points, points])
        if self._bows and block.velocity is not None:
            speeds = self._at_tool(block.velocity[used])
            self._speeds_m_s = np.concatenate([self._speeds_m_s, speeds])
        sewn = []
        while True:
            self._pull(1 + _AHEAD)  # the seam ahead of the last stitch
            if not self._pending:
                break
            run = self._pending[0]
            down_s = self._clock.when(run.down_s) + self._delay_s
            due = int(np.searchsorted(down_s, time_s[-1], side="right"))
            if not due:
                break
            self._pending[:1] = [run.rows(slice(due, None))] if due < len(run) else []
            sewn.append(self._finish(run.rows(slice(due))))
        keep_s = time_s[-1]
        if self._pending:
            keep_s = self._clock.when(self._pending[0].from_s[:1])[0] + self._delay_s
        keep_s -= self._over_s
        first = max(int(np.searchsorted(self._time_s, keep_s, side="right")) - 2, 0)
        self._time_s, self._points = self._time_s[first:], self._points[first:]
        self._speeds_m_s = self._speeds_m_s[first:]
        self._clock.drop(keep_s - self._delay_s, float(self._begun_s[0]) - self._over_s)
        return sewn

    def _at_tool(self, values: FloatArray) -> FloatArray:
        """Return (n, axes, runs) lengths at the tool of (n, runs, axes) values, axes of the job."""
        return np.asarray(lanes(values)[:, self._columns] * self._radius_m[self._columns, None])

    def _rows_used(self, time_s: FloatArray) -> IntArray:
        """Return the rows of a block to use: all of them, unless ticks are very short.

        A stitch may last a million ticks of a nanosecond: a fine part of the averaging time is
        enough.
        """
        rows = np.arange(len(time_s))
        lasts_s = float(time_s[-1] - time_s[0])
        apart_s = min(self._over_s, _FINE_S) / _PARTS
        every = int(apart_s * (len(rows) - 1) / lasts_s) if lasts_s > 0.0 else 1
        return rows if every < 2 else np.unique(np.append(rows[::every], rows[-1]))

    def _pull(self, runs: int) -> None:
        while len(self._pending) < runs and not self._exhausted:
            run = next(self._source, None)
            if run is None:
                self._exhausted = True
            else:
                self._pending.append(run)

    def _at(self, time_s: FloatArray) -> FloatArray:
        """Return (m, axes, runs) tool positions at instants between the buffered samples."""
        last = len(self._time_s) - 1
        # For a few instants np.clip takes three times as long as both its halves.
        after = np.maximum(np.searchsorted(self._time_s, time_s, side="right"), 1)
        after = np.minimum(after, max(last, 1))
        before, after = np.minimum(after - 1, last), np.minimum(after, last)
        from_s = self._time_s[before]
        long_s = np.where(after > before, self._time_s[after] - from_s, 1.0)
        part = np.minimum(np.maximum((time_s - from_s) / long_s, 0.0), 1.0)[:, None, None]
        start = self._points[before]
        step = self._points[after] - start
        if not self._bows:
            return np.asarray(start + part * step)
        long_s = long_s[:, None, None]
        m0, m1 = (self._speeds_m_s[k] * long_s - step for k in (before, after))
        deviation = part * (1.0 - part) * ((1.0 - part) * m0 - part * m1)
        return np.asarray(start + part * step + deviation)

    def _finish(self, run: Stitches) -> SewnStitches:
        down_s = self._clock.when(run.down_s) + self._delay_s
        actual = self._at(down_s)
        begin_s = self._clock.when(run.from_s) + self._delay_s
        begun = self._at(begin_s)
        moved = np.sqrt(((actual - begun) ** 2).sum(axis=1))
        placement = speed_error = speed_s = np.empty((0, actual.shape[2]))
        if "placement" in self._figures:
            placement = self._placed(run, actual)
        if "speed" in self._figures:
            speed_error, speed_s = self._speeds(run)
        self._begun_s = np.concatenate([self._begun_s, begin_s])[-_TO_SPEED:]
        return SewnStitches(
            stitches=run,
            down_s=down_s,
            actual=actual,
            begun=begun,
            length_error=moved / run.target_m[:, None] - 1.0,
            placement_m=placement,
            speed_error=speed_error,
            speed_s=speed_s,
        )

    def _placed(self, run: Stitches, actual: FloatArray) -> FloatArray:
        """Return (n, runs) distances of needle-downs from the nearby seam."""
        behind = run.from_point[:1] if self._seam is None else self._seam
        coming = [pending.point for pending in self._pending[:_AHEAD]] or [run.point[-1:]]
        ahead = np.concatenate(coming)[:_AHEAD]
        seam = np.concatenate([behind, run.point, ahead])
        self._seam = seam[: len(behind) + len(run)][-_BEHIND:]
        return _to_seam(actual, seam, len(behind))

    def _speeds(self, run: Stitches) -> tuple[FloatArray, FloatArray]:
        """Return (n, runs) the largest relative error of the speed in each stitch, and its time.

        Instants are the samples within the stitch, except during the first averaging time, and its
        end.
        """
        begin_s, end_s = (self._clock.when(s) + self._delay_s for s in (run.from_s, run.down_s))
        at_s = np.unique(np.concatenate([self._time_s, end_s]))
        stitch = np.searchsorted(end_s, at_s, side="left")
        stitch = np.minimum(stitch, len(run) - 1)
        lasts_s = run.down_s - run.from_s
        part_s = np.minimum(self._over_s, PART_OF_STITCH * lasts_s)
        over_s = np.where(lasts_s > 0.0, part_s, self._over_s)[stitch]
        within = (at_s >= begin_s[stitch] + over_s) & (at_s <= end_s[stitch])
        within |= at_s == end_s[stitch]
        at_s, stitch, over_s = at_s[within], stitch[within], over_s[within]
        way = self._at(at_s) - self._at(at_s - over_s)
        # A stitch far below the resolution of the timing may take no time: its speed is infinite.
        with np.errstate(divide="ignore"):
            set_speed = (run.target_m / lasts_s)[stitch]
            if run.follows.any():
                own = run.follows[stitch]
                way_m = np.linalg.norm(run.point - run.from_point, axis=1)
                share = (run.target_m / way_m)[stitch[own]]
                due_s = self._clock.due(at_s[own] - self._delay_s)
                geared = share * self._geared_m_s(due_s, over_s[own])
                # The planned speed falls to zero beside a rest, where stitches are exempt.
                least = _SLOWEST * (run.target_m * run.fastest_hz)[stitch[own]]
                set_speed[own] = np.maximum(geared, least)
            set_speed = set_speed[:, None]
        error = np.sqrt((way**2).sum(axis=1)) / over_s[:, None] / set_speed - 1.0
        starts = np.minimum(np.searchsorted(stitch, np.arange(len(run))), len(stitch) - 1)
        sizes = np.abs(error)
        # The first sample of each stitch with its largest error.
        worst = np.repeat(
            np.maximum.reduceat(sizes, starts), np.diff(starts, append=len(stitch)), axis=0
        )
        rows = np.arange(len(stitch))[:, None]
        first = np.minimum.reduceat(np.where(sizes == worst, rows, len(stitch)), starts)
        first = np.minimum(first, len(stitch) - 1)
        worst_error = np.take_along_axis(error, first, axis=0)
        # After a hold the head regains its speed within ``_TO_SPEED`` stitches, as after a rest.
        since_s = np.concatenate([self._begun_s, begin_s])
        worst_error[self._clock.slowed(since_s[: len(run)] - self._over_s, end_s)] = np.nan
        return worst_error, at_s[first]

    def _geared_m_s(self, time_s: FloatArray, over_s: FloatArray) -> FloatArray:
        """Return (m,) planned mean speeds of the head over ``over_s`` up to ascending instants."""
        if not len(time_s):
            return np.zeros(0)
        begin_s = time_s - over_s
        both, back = np.unique(np.concatenate([begin_s, time_s]), return_inverse=True)
        at_m = self._geared.derivatives(both, 1)[back, 0][:, self._columns]
        self._geared.drop(float(begin_s[-1]) - self._over_s)
        way_m = (at_m[len(begin_s) :] - at_m[: len(begin_s)]) * self._radius_m[self._columns]
        return np.asarray(np.linalg.norm(way_m, axis=1) / over_s)


def sewn_stitches(plan: Plan, recording: Recording, delay_s: float) -> Iterator[SewnStitches]:
    """Yield the stitches of a recording in groups; nothing if the job has none.

    Parameters
    ----------
    plan, recording
        The intended work, and the recording; without a tool or load channel nothing is yielded.
    delay_s
        As for ``StitchFollower``.
    """
    axes = plan.motion.programmed.axes
    known = all(find_first(recording, _ACTUAL, axis) is not None for axis in axes)
    if not known or not has_stitches(plan.job):
        return
    follower = StitchFollower(setting_of(plan, recording), delay_s)
    for block in judged_blocks(recording, axes, 0, None):
        if block.actual is not None:
            yield from follower.feed(block)


def _to_seam(points: FloatArray, seam: FloatArray, offset: int) -> FloatArray:
    """Return (n, runs) distances of point i to the chords of ``seam`` around ``seam[offset + i]``.

    ``points`` are (n, axes, runs).
    """
    # Chord c ends at vertex c of the seam.
    own = np.arange(len(points)) + offset
    most = max(len(seam) - 1, 1)
    begin = np.clip(own - _BEHIND + 1, 1, most)
    end = np.clip(own + _AHEAD, 1, most)
    vertices = seam if len(seam) > 1 else np.repeat(seam, 2, axis=0)
    squared, _ = nearest_chords(np.ascontiguousarray(points), begin, end, vertices)
    return np.sqrt(squared)
