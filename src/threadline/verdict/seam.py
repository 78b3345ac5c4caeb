"""Seam error: distance between the sewn stitches and the drawn line, in both directions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.verdict.finding import RunFindings, Worst
from threadline.verdict.measure import Measure
from threadline.verdict.needle import has_stitches
from threadline.verdict.samples import Block, Setting
from threadline.verdict.sewn import SewnStitches, StitchFollower
from threadline.verdict.stitch_run import too_short

if TYPE_CHECKING:
    from threadline.geometry.contours import DrawnLine

_PARTS = 16  # of the drawn stretch of a stitch: a sagitta of 0.25 mm leaves 1 um in each part
_NEAR = 4  # stitches before and after its own that a point is compared with: the free lag
_NONE = "the job has no drawing"


class _Seam:
    """The worst place of a seam, measured both ways.

    For every drawn point: the distance to the stitches around the stitch that covers it. For every
    needle-down: the distance to the part of the line that those stitches cover. The thread is
    straight between needle-downs, so these two distances bound its distance from the line.
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

    def finish(self) -> Sequence[RunFindings]:
        left = None if self._follower is None else self._follower.unsewn
        if left is not None:
            return [too_short(left, self._runs)]
        if self._held is not None:
            self._judge(len(self._held.contour))
        return [self._worst.found()]

    def _judge(self, until: int) -> None:
        """Judge the buffered stitches up to ``until``; discard stitches no longer needed."""
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


class _Stitches(NamedTuple):
    """Consecutive stitches: (stitches, axes, runs) start and end, and the contour of each.

    ``drawn``, (stitches, points, axes), are points along the drawn stretch of each stitch.
    """

    drawn: FloatArray
    begin: FloatArray
    end: FloatArray
    contour: IntArray


class _Apart(NamedTuple):
    """Distances between line and stitches, (n, runs).

    ``missed`` is the largest distance of a stitch's drawn stretch from the stitches around it, and
    ``part`` the drawn point there; ``strayed`` is the distance of its needle-down from the line.
    """

    missed: FloatArray
    part: IntArray
    strayed: FloatArray


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

    def apart(self, begin: int, until: int) -> _Apart:
        """Return the distances between the line and the stitches ``begin`` up to ``until``."""
        shape = until - begin, self.end.shape[2]
        found = _Apart(np.empty(shape), np.empty(shape, dtype=np.int64), np.empty(shape))
        stitches = _Stitches(
            self.drawn,
            np.ascontiguousarray(self.begin),
            np.ascontiguousarray(self.end),
            self.contour,
        )
        _measure_fast(stitches, (0,) * self.end.shape[1], begin, found)
        return found


def _measure(stitches: _Stitches, axes: tuple[int, ...], first: int, found: _Apart) -> None:
    """Fill in the distances of the stitches from ``first`` on.

    ``axes`` is a tuple with one entry per axis: its length is known at compile time.
    """
    drawn, begin, end, contour = stitches
    missed, part, strayed = found
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
                        step = end[other, a, r] - begin[other, a, r]
                        along += (drawn[own, p, a] - begin[other, a, r]) * step
                    where = min(1.0, max(0.0, along / length[r]))
                    away = 0.0
                    for a in range(len(axes)):
                        step = end[other, a, r] - begin[other, a, r]
                        gap = drawn[own, p, a] - begin[other, a, r] - where * step
                        away += gap * gap
                    best[p, r] = min(best[p, r], away)
            for p in range(1, places):
                squared = 0.0
                for a in range(len(axes)):
                    squared += (drawn[other, p, a] - drawn[other, p - 1, a]) ** 2
                whole = squared if squared > 0.0 else 1.0
                for r in range(runs):
                    along = 0.0
                    for a in range(len(axes)):
                        step = drawn[other, p, a] - drawn[other, p - 1, a]
                        along += (end[own, a, r] - drawn[other, p - 1, a]) * step
                    where = min(1.0, max(0.0, along / whole))
                    away = 0.0
                    for a in range(len(axes)):
                        step = drawn[other, p, a] - drawn[other, p - 1, a]
                        gap = end[own, a, r] - drawn[other, p - 1, a] - where * step
                        away += gap * gap
                    strayed[i, r] = min(strayed[i, r], away)
        for r in range(runs):
            farthest, at = -1.0, 0
            for p in range(places):
                if best[p, r] > farthest:
                    farthest, at = best[p, r], p
            missed[i, r], part[i, r] = np.sqrt(farthest), at
            strayed[i, r] = np.sqrt(strayed[i, r])


_measure_fast = njit(nogil=True)(_measure)


def start_seam(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the distance between the sewn stitches and the drawn line, both ways."""
    return _Seam(setting, options["delay"])
