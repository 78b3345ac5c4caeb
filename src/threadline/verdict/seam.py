"""The seam against its drawing: the stitches that were sewn, and the line that was drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.drawing.line import DrawnLine
from threadline.verdict.measure import Finding, Measure
from threadline.verdict.needle import has_stitches
from threadline.verdict.samples import Block, Setting
from threadline.verdict.stitches import SHORT, SewnStitches, StitchFollower

_PARTS = 16  # of the drawn stretch of a stitch: a bow of 0.25 mm between two places is 1 um
_NEAR = 4  # stitches about its own that a place may lie on: the lag that is free
_NONE = "the job has no drawing"


class _Seam:
    """The worst place of a seam, both ways.

    Of every place that is drawn the distance to the stitches about its own, and of every
    needle-down the distance to the line that those stitches are to cover. Between needle-downs the
    thread is straight, so it is no further from the line than these two.
    """

    def __init__(self, setting: Setting, delay_s: float) -> None:
        job = setting.plan.job
        self._lines = job.drawn
        self._axes = [setting.axes.index(a) for a in job.axes]
        self._radius_m = setting.radius_m[self._axes]
        known = bool(self._lines) and has_stitches(job)
        self._follower = StitchFollower(setting, delay_s) if known else None
        self._held: _Sewn | None = None
        self._judged = 0  # of the stitches that are held
        self._worst = Finding(value=None, note=_NONE)

    def feed(self, block: Block) -> None:
        assert block.actual is not None
        if self._follower is None:
            return
        for run in self._follower.feed(block.time_s, block.actual):
            self._held = _Sewn(run, self._lines, self._held)
            self._judge(len(self._held.contour) - _NEAR)

    def finish(self) -> Sequence[Finding]:
        left = None if self._follower is None else self._follower.unsewn
        if left is not None:
            return [
                Finding(
                    value=None,
                    operation=int(left.operation[0]),
                    job_line=int(left.line[0]),
                    note=SHORT,
                )
            ]
        if self._held is not None:
            self._judge(len(self._held.contour))
        return [self._worst]

    def _judge(self, until: int) -> None:
        """Judge the held stitches up to one, and let go of those that no other needs."""
        held = self._held
        if held is None or until <= self._judged:
            return
        own = np.arange(self._judged, until)
        missed, missing = held.drawn_to_sewn(own)
        strayed = held.sewn_to_drawn(own)
        values = np.maximum(missed, strayed)
        at = int(np.argmax(values))
        if self._worst.value is None or values[at] > self._worst.value:
            drawn = missed[at] >= strayed[at]
            k = own[at]
            place = missing[at] if drawn else held.end[k]
            self._worst = Finding(
                value=float(values[at]),
                time_s=float(held.down_s[k]),
                operation=int(held.operation[k]),
                job_line=int(held.job_line[k]),
                position=tuple((place / self._radius_m).tolist()),
                note="drawn there, and sewn elsewhere" if drawn else "",
            )
        first = max(until - _NEAR, 0)
        self._held, self._judged = held.after(first), until - first


class _Sewn:
    """Stitches that are in hand: where each began and ended, and its drawn stretch in parts."""

    def __init__(self, run: SewnStitches, lines: Sequence[DrawnLine], before: _Sewn | None) -> None:
        s = run.stitches
        self.contour: IntArray = s.contour
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
        """Return the stitches from one on."""
        rest = object.__new__(_Sewn)
        for name in self._ARRAYS:
            setattr(rest, name, getattr(self, name)[first:])
        return rest

    def _others(self, own: IntArray) -> list[tuple[IntArray, FloatArray]]:
        """Return stitches about each, and infinity where there is none of the same contour."""
        found = []
        for shift in range(-_NEAR, _NEAR + 1):
            other = np.clip(own + shift, 0, len(self.contour) - 1)
            there = (other == own + shift) & (self.contour[other] == self.contour[own])
            found.append((other, np.where(there, 0.0, np.inf)))
        return found

    def drawn_to_sewn(self, own: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return (n,) how far the drawn stretch is from the stitches, and (n, axes) where."""
        points = self.drawn[own]
        best = np.full(points.shape[:2], np.inf)
        for other, barred in self._others(own):
            begin, end = self.begin[other][:, None], self.end[other][:, None]
            best = np.minimum(best, _to_chords(points, begin, end) + barred[:, None])
        worst = np.argmax(best, axis=1)
        rows = np.arange(len(own))
        return best[rows, worst], points[rows, worst]

    def sewn_to_drawn(self, own: IntArray) -> FloatArray:
        """Return (n,) how far each needle-down is from the drawn line about it."""
        points = self.end[own][:, None]
        best = np.full(len(own), np.inf)
        for other, barred in self._others(own):
            line = self.drawn[other]
            away = _to_chords(points, line[:, :-1], line[:, 1:]).min(axis=1)
            best = np.minimum(best, away + barred)
        return best


def _to_chords(points: FloatArray, begin: FloatArray, end: FloatArray) -> FloatArray:
    """Return distances of points to chords; the shapes but for the last axis are broadcast."""
    chord, away = end - begin, points - begin
    squared = (chord**2).sum(axis=-1)
    along = (away * chord).sum(axis=-1)
    share = np.divide(along, squared, out=np.zeros_like(along), where=squared > 0.0)
    foot = np.clip(share, 0.0, 1.0)[..., None] * chord
    return np.asarray(np.sqrt(((away - foot) ** 2).sum(axis=-1)))


def start_seam(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring how far the sewn stitches are from the drawn line, and it from them."""
    return _Seam(setting, options["delay"])
