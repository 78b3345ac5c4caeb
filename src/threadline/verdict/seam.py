"""Measures of a seam: its stitches against the drawing, and the time to reach its speed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.verdict.finding import Finding, Found, Worst
from threadline.verdict.measure import Measure, Option
from threadline.verdict.needle import Stitches, has_stitches, planned_stitches
from threadline.verdict.samples import Block, Setting, enough_of, lanes
from threadline.verdict.sewn import PART_OF_STITCH, SewnStitches, StitchFollower
from threadline.verdict.stitch_run import too_short

if TYPE_CHECKING:
    from threadline.geometry.contours import DrawnLine

_PARTS = 16  # of the drawn stretch of a stitch: a bow of 0.25 mm between two places is 1 um
_NEAR = 4  # neighbouring stitches that a place may lie on: the free lag
_NONE = "the job has no drawing"


class _Seam:
    """The worst place of a seam, measured both ways.

    For every drawn place: the distance to the stitches around its own. For every needle-down: the
    distance to the line that those stitches cover. Between needle-downs the thread is straight, so
    it is no further from the line than these two.
    """

    def __init__(self, setting: Setting, delay_s: float) -> None:
        job = setting.plan.job
        self._lines = job.drawn
        self._axes = [setting.axes.index(a) for a in job.axes]
        self._radius_m = setting.radius_m[self._axes]
        known = bool(self._lines) and has_stitches(job)
        self._follower = StitchFollower(setting, delay_s, figures=()) if known else None
        self._held: _Sewn | None = None
        self._judged = 0  # of the buffered stitches
        self._runs = setting.runs
        self._worst = Worst(setting.runs, len(self._axes), note=_NONE)

    def feed(self, block: Block) -> None:
        assert block.actual is not None
        if self._follower is None:
            return
        for run in self._follower.feed(block):
            self._held = _Sewn(run, self._lines, self._held)
            self._judge(len(self._held.contour) - _NEAR)

    def finish(self) -> Sequence[Found]:
        left = None if self._follower is None else self._follower.unsewn
        if left is not None:
            return [too_short(left, self._runs)]
        if self._held is not None:
            self._judge(len(self._held.contour))
        return [self._worst.found()]

    def _judge(self, until: int) -> None:
        """Judge the buffered stitches up to ``until``; discard those that no other needs."""
        held = self._held
        if held is None or until <= self._judged:
            return
        missed, part, strayed = held.apart(self._judged, until)
        values = np.maximum(missed, strayed)
        at, runs = np.argmax(values, axis=0), np.arange(self._runs)
        k = at + self._judged
        drawn = missed[at, runs] >= strayed[at, runs]
        place = np.where(drawn[:, None], held.drawn[k, part[at, runs]], held.end[k, :, runs])
        self._worst.offer(
            values[at, runs],
            time_s=held.down_s[k],
            operation=held.operation[k],
            line=held.job_line[k],
            position=place / self._radius_m,
            note=np.where(drawn, "drawn there, and sewn elsewhere", "").astype(object),
        )
        first = max(until - _NEAR, 0)
        self._held, self._judged = held.after(first), until - first


class _Sewn:
    """Buffered stitches: start and end of each, and its drawn stretch in parts."""

    def __init__(self, run: SewnStitches, lines: Sequence[DrawnLine], before: _Sewn | None) -> None:
        s = run.stitches
        # A copy: numba compiles a second version for a locked array.
        self.contour: IntArray = s.contour.copy()
        self.operation, self.job_line = s.operation, s.line
        self.down_s, self.begin, self.end = run.down_s, run.begun, run.actual
        share = np.linspace(0.0, 1.0, _PARTS + 1)
        at_m = s.from_m[:, None] + (s.to_m - s.from_m)[:, None] * share
        self.drawn = np.empty((len(s), _PARTS + 1, run.actual.shape[1]))
        for contour in np.unique(s.contour).tolist():
            own = s.contour == contour
            points = lines[contour].points(at_m[own].ravel())
            self.drawn[own] = points.reshape(-1, _PARTS + 1, points.shape[1])
        if before is not None:
            for name in self._ARRAYS:
                joined = np.concatenate([getattr(before, name), getattr(self, name)])
                setattr(self, name, joined)

    _ARRAYS = ("contour", "operation", "job_line", "down_s", "begin", "end", "drawn")

    def after(self, first: int) -> _Sewn:
        """Return the stitches from ``first`` on."""
        rest = object.__new__(_Sewn)
        for name in self._ARRAYS:
            setattr(rest, name, getattr(self, name)[first:])
        return rest

    def apart(self, begin: int, until: int) -> tuple[FloatArray, IntArray, FloatArray]:
        """Return the distances between the line and the stitches ``begin`` up to ``until``.

        Returns
        -------
        tuple
            (n, runs) the largest distance of the drawn stretch of a stitch from the stitches around
            it, the place that has it, and the distance of its needle-down from the line around it.
        """
        runs = self.end.shape[2]
        missed, strayed = np.empty((until - begin, runs)), np.empty((until - begin, runs))
        part = np.empty((until - begin, runs), dtype=np.int64)
        _apart_fast(
            self.drawn,
            np.ascontiguousarray(self.begin),
            np.ascontiguousarray(self.end),
            self.contour,
            (0,) * self.end.shape[1],
            begin,
            missed,
            part,
            strayed,
        )
        return missed, part, strayed


def _apart(
    drawn: FloatArray,
    begin: FloatArray,
    end: FloatArray,
    contour: IntArray,
    axes: tuple[int, ...],
    first: int,
    missed: FloatArray,
    part: IntArray,
    strayed: FloatArray,
) -> None:
    """Fill in ``missed``, ``part`` and ``strayed`` of the stitches from ``first`` on.

    ``drawn`` is (stitches, places, axes), ``begin`` and ``end`` are (stitches, axes, runs).
    ``axes`` is a tuple with one entry per axis: its length is known at compile time.
    """
    count, runs = missed.shape
    places = drawn.shape[1]
    best, length = np.empty((places, runs)), np.empty(runs)
    for i in range(count):
        own = first + i
        best[:] = np.inf
        strayed[i] = np.inf
        for other in range(max(own - _NEAR, 0), min(own + _NEAR + 1, len(contour))):
            if contour[other] != contour[own]:
                continue
            for r in range(runs):
                squared = 0.0
                for a in range(len(axes)):
                    squared += (end[other, a, r] - begin[other, a, r]) ** 2
                length[r] = squared if squared > 0.0 else 1.0
            for p in range(places):
                for r in range(runs):
                    along = 0.0
                    for a in range(len(axes)):
                        way = end[other, a, r] - begin[other, a, r]
                        along += (drawn[own, p, a] - begin[other, a, r]) * way
                    where = along / length[r]
                    where = where if where > 0.0 else 0.0
                    where = where if where < 1.0 else 1.0
                    away = 0.0
                    for a in range(len(axes)):
                        way = end[other, a, r] - begin[other, a, r]
                        gap = drawn[own, p, a] - begin[other, a, r] - where * way
                        away += gap * gap
                    best[p, r] = away if away < best[p, r] else best[p, r]
            for p in range(1, places):
                squared = 0.0
                for a in range(len(axes)):
                    squared += (drawn[other, p, a] - drawn[other, p - 1, a]) ** 2
                whole = squared if squared > 0.0 else 1.0
                for r in range(runs):
                    along = 0.0
                    for a in range(len(axes)):
                        way = drawn[other, p, a] - drawn[other, p - 1, a]
                        along += (end[own, a, r] - drawn[other, p - 1, a]) * way
                    where = along / whole
                    where = where if where > 0.0 else 0.0
                    where = where if where < 1.0 else 1.0
                    away = 0.0
                    for a in range(len(axes)):
                        way = drawn[other, p, a] - drawn[other, p - 1, a]
                        gap = end[own, a, r] - drawn[other, p - 1, a] - where * way
                        away += gap * gap
                    strayed[i, r] = away if away < strayed[i, r] else strayed[i, r]
        for r in range(runs):
            farthest, at = -1.0, 0
            for p in range(places):
                if best[p, r] > farthest:
                    farthest, at = best[p, r], p
            missed[i, r], part[i, r] = np.sqrt(farthest), at
            strayed[i, r] = np.sqrt(strayed[i, r])


_apart_fast = njit(nogil=True)(_apart)


def start_seam(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the distance between the sewn stitches and the drawn line, both ways."""
    return _Seam(setting, options["delay"])


OPTIONS = {"over": Option(unit="s", default=0.002)}
_HIGH, _STILL = 0.95, 0.01  # of the set speed
_MOVES = 0.02  # of the highest speed of a following needle: a slower head rests


class _Instant(NamedTuple):
    """A sample, as a finding without a value, and the plan's time at it in s."""

    finding: Finding
    due_s: float


@dataclass(slots=True)
class _Dip:
    """A stretch in which the command is below its speed.

    ``turn`` is when the head starts again: the last instant at which the command stands, or its
    slowest instant if it does not stop. ``stop`` is the first such instant.
    """

    least: float
    stop: _Instant
    turn: _Instant


class _Rise:
    """The longest time to reach the speed, or to stop from it, in turns of the needle.

    If the needle follows the head, the set speed is the commanded speed of the head at that
    instant. Stitches sewn in a hold, or while the head regains its speed after one, do not count;
    times are the plan's, which stands still in a hold.

    A rise lasts from the turn of a dip of the command until the head has 95 % of the set speed, a
    fall from the last time that it had this speed until the command stops. Speeds are means over
    ``over``, or over ``PART_OF_STITCH`` of the shortest first stitch if that is less: a mean over
    more than a dip would not see the dip.
    """

    def __init__(self, setting: Setting, over_s: float) -> None:
        self._columns = [setting.axes.index(axis) for axis in setting.plan.job.axes]
        self._radius_m = setting.radius_m[self._columns, None]
        self._source: Iterator[Stitches] = (
            planned_stitches(setting.plan) if has_stitches(setting.plan.job) else iter(())
        )
        self._run: Stitches | None = next(self._source, None)
        if self._run is not None:
            least_s = float(np.fmin.reduce(self._run.period_s, initial=np.inf))
            over_s = min(over_s, PART_OF_STITCH * least_s)
        self._every = enough_of(over_s, setting.interval_s)
        interval_s = self._every * setting.interval_s
        self._span = max(round(over_s / interval_s), 1)
        self._over_s = self._span * interval_s
        self._sews = self._run is not None
        self._tail: list[FloatArray] = []
        self._legs = [_Legs() for _ in range(setting.runs)]

    def feed(self, block: Block) -> None:
        block = block.every(self._every)
        assert block.actual is not None
        rests = block.rests
        if rests is None or not self._sews or not len(block):
            return
        taken = (rests[:, :, None], lanes(block.actual))
        points = [p[:, self._columns] * self._radius_m for p in taken]
        tails = self._tail or [np.repeat(p[:1], self._span, axis=0) for p in points]
        whole = [np.concatenate([tail, p]) for tail, p in zip(tails, points, strict=True)]
        self._tail = [p[-self._span :] for p in whole]
        meant, actual = (
            np.linalg.norm(p[self._span :] - p[: -self._span], axis=1) / self._over_s for p in whole
        )
        wanted, period_s, follows, sewn = self._set(block.due_s)
        if block.slow is not None:  # a hold is the operator's choice
            sewn &= ~block.slow
        # For a following needle the set speed is the commanded speed, while it moves at all.
        geared = np.maximum(meant[:, 0], _MOVES * wanted)
        wanted = np.where(follows, geared, wanted)
        at = np.flatnonzero(sewn)
        if not len(at):
            return
        share = meant[at, 0] / wanted[at]
        for run, legs in enumerate(self._legs):
            legs.take(block, at, share, actual[at, run] / wanted[at], period_s[at])

    def finish(self) -> Sequence[Found]:
        note = "no leg of the seam comes to its speed" if self._sews else "the job has no stitches"
        none = Finding(value=None, note=note)
        return [Found.made([legs.worst or none for legs in self._legs])]

    def _set(
        self, due_s: FloatArray
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], NDArray[np.bool_]]:
        """Return (n,) set speed, turn of the needle, whether it follows, and whether it sews.

        At (n,) instants of the plan. For a following needle the speed is its highest.
        """
        wanted, period_s = np.ones(len(due_s)), np.ones(len(due_s))
        follows = np.zeros(len(due_s), dtype=np.bool_)
        known = np.zeros(len(due_s), dtype=np.bool_)
        while self._run is not None:
            run = self._run
            mine = ~known & (due_s <= run.down_s[-1])
            if not mine.any():
                break
            stitch = np.searchsorted(run.down_s, due_s[mine], side="left")
            speed = np.where(run.follows, run.fastest_hz, 1.0 / run.period_s)
            wanted[mine] = (run.target_m * speed)[stitch]
            follows[mine] = run.follows[stitch]
            period_s[mine] = run.period_s[stitch]
            known |= mine
            if due_s[-1] <= run.down_s[-1]:
                break
            self._run = next(self._source, None)
        return wanted, period_s, follows, known & np.isfinite(period_s)


class _Legs:
    """The stretches of one run in which the head reaches its speed, and stops from it.

    Attributes
    ----------
    worst
        The longest so far.
    """

    def __init__(self) -> None:
        self._dip: _Dip | None = None
        self._turn: _Instant | None = None  # of the last dip, until the head has its speed
        self._fast: _Instant | None = None  # when the head last had its speed
        self.worst: Finding | None = None

    def take(
        self,
        block: Block,
        at: NDArray[np.intp],
        meant: FloatArray,
        actual: FloatArray,
        period_s: FloatArray,
    ) -> None:
        """Follow relative speeds through stretches in which the command has its speed or not."""
        low, fast = meant < _HIGH, actual >= _HIGH
        edges = np.flatnonzero(np.diff(low)) + 1
        for part in np.split(np.arange(len(at)), edges):
            if low[part[0]]:
                self._fall(block, at[part], meant[part], fast[part], period_s[part])
            else:
                self._rise(block, at[part], fast[part], period_s[part])

    def _fall(
        self,
        block: Block,
        at: NDArray[np.intp],
        meant: FloatArray,
        fast: NDArray[np.bool_],
        period_s: FloatArray,
    ) -> None:
        still = np.flatnonzero(meant <= _STILL)
        least = int(np.argmin(meant))
        first, last = (int(still[0]), int(still[-1])) if len(still) else (least, least)
        if self._dip is None or (self._dip.least > _STILL and meant[least] < self._dip.least):
            before = np.flatnonzero(fast[:first])
            if len(before):
                self._fast = self._at(block, int(at[before[-1]]))
            stop = self._at(block, int(at[first]))
            self._dip = _Dip(float(meant[least]), stop, self._at(block, int(at[last])))
            if self._fast is not None:
                self._count(self._fast, stop, float(period_s[first]), "to the stop")
        elif len(still):
            self._dip.turn = self._at(block, int(at[last]))

    def _rise(
        self,
        block: Block,
        at: NDArray[np.intp],
        fast: NDArray[np.bool_],
        period_s: FloatArray,
    ) -> None:
        if self._dip is not None:
            self._turn, self._dip = self._dip.turn, None
        reached = np.flatnonzero(fast)
        if not len(reached):
            return
        if self._turn is not None:
            there = self._at(block, int(at[reached[0]]))
            self._count(self._turn, there, float(period_s[reached[0]]), "from the start")
            self._turn = None
        self._fast = self._at(block, int(at[reached[-1]]))

    def _at(self, block: Block, index: int) -> _Instant:
        finding = Finding(
            value=None,
            time_s=float(block.time_s[index]),
            operation=None if block.operation is None else int(block.operation[index]),
            position=_position(block, index),
        )
        return _Instant(finding, float(block.due_s[index]))

    def _count(self, begin: _Instant, end: _Instant, period_s: float, note: str) -> None:
        value = max(end.due_s - begin.due_s, 0.0) / period_s
        if self.worst is None or self.worst.value is None or value > self.worst.value:
            self.worst = replace(end.finding, value=value, note=note)


def _position(block: Block, index: int) -> tuple[float, ...] | None:
    assert block.commanded is not None
    position = block.commanded[index]
    return tuple(position.tolist()) if np.isfinite(position).all() else None


def start_rise(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the time that the head takes to reach its speed."""
    return _Rise(setting, options["over"])
