"""Deviation of loads from their commanded path, both ways, within a window of time."""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.motion.timing.optimal.elements import Elements
from threadline.motion.timing.types import TrajectoryBlock

if TYPE_CHECKING:
    from threadline.dynamics.responses import Answer


@njit()
def _squared(point, start, end):
    """Return the squared distance of a point from a segment, and the place on it (0..1)."""
    along, length = 0.0, 0.0
    for k in range(len(point)):
        direction = end[k] - start[k]
        along += (point[k] - start[k]) * direction
        length += direction * direction
    where = 0.0 if length <= 0.0 else min(max(along / length, 0.0), 1.0)
    squared = 0.0
    for k in range(len(point)):
        gap = point[k] - start[k] - where * (end[k] - start[k])
        squared += gap * gap
    return squared, where


@njit()
def strayed(load, way, fine, window):
    """Return the distances between load and commanded path, at the points of the path.

    Every load position is compared with the commanded path of the last ``window`` ticks, every
    point of the path with the load of the following ticks: lag along the path is no error. The
    first ``window`` ticks only provide history, and are not judged.

    Parameters
    ----------
    load
        (k, axes) lengths at the tool, a row for each tick.
    way
        (f, axes) the commanded path, ``fine`` points for each tick: row i of the load belongs to
        row ``i * fine`` of the path.

    Returns
    -------
    (f, axes) vectors from path to load, and the (f,) ticks of that load.
    """
    axes = way.shape[1]
    size = np.zeros(len(way))
    out = np.zeros((len(way), axes))
    tick = np.zeros(len(way), dtype=np.int64)
    for k in range(window, len(load)):
        best, at, part = np.inf, 0, 0.0
        last = min(k * fine, len(way) - 1)
        for f in range(max(last - window * fine, 0), max(last, 1)):
            squared, where = _squared(load[k], way[f], way[f + 1])
            if squared < best:
                best, at, part = squared, f, where
        if best > size[at]:
            size[at], tick[at] = best, k
            for a in range(axes):
                out[at, a] = load[k, a] - way[at, a] - part * (way[at + 1, a] - way[at, a])
    for f in range(window * fine, len(way)):
        best, at, part = np.inf, 0, 0.0
        begin = f // fine
        for k in range(begin, min(begin + window, len(load) - 1)):
            squared, where = _squared(way[f], load[k], load[k + 1])
            if squared < best:
                best, at, part = squared, k, where
        if size[f] < best < np.inf:
            size[f], tick[f] = best, at
            for a in range(axes):
                out[f, a] = load[at, a] + part * (load[at + 1, a] - load[at, a]) - way[f, a]
    return out, tick


@njit()
def blamed(error, tick, fine, acceleration, swing, tolerance):
    """Return the (f,) logarithms by which to lower accelerations, 0 for those not at fault.

    Parameters
    ----------
    error, tick
        From ``strayed``.
    acceleration
        (f, axes) of the path, at the tool.
    swing
        (d, axes) error of an axis d path points after a unit change of its velocity.
    """
    out = np.zeros(len(error))
    share = np.zeros(len(swing))
    for f in range(len(error)):
        size = np.sqrt((error[f] ** 2).sum())
        if size <= tolerance:
            continue
        due = np.log(size / tolerance)
        seen = min(tick[f] * fine, len(error) - 1)
        most = 0.0
        for d in range(min(len(swing), seen + 1)):
            share[d] = (error[f] * swing[d] * acceleration[seen - d]).sum()
            most = max(most, share[d])
        for d in range(min(len(swing), seen + 1)):
            if share[d] > 0.0:
                weight = min(1.0, 2.0 * share[d] / most)
                out[seen - d] = max(out[seen - d], weight * due)
    return out


@njit()
def aligned(time_s, tangent, before_s, after_s):
    """Return the (n,) least cosine between a tangent and the tangents within a window of time.

    0 if one of them is at a right angle or points back, or if the motion ends within it.
    """
    n = len(time_s)
    out = np.ones(n)
    low = 0
    for i in range(n):
        while time_s[low] < time_s[i] - before_s:
            low += 1
        if time_s[i] + after_s > time_s[n - 1]:
            out[i] = 0.0
        for j in range(low, n):
            if time_s[j] > time_s[i] + after_s:
                break
            cosine = 0.0
            for a in range(tangent.shape[1]):
                cosine += tangent[i, a] * tangent[j, a]
            out[i] = min(out[i], max(cosine, 0.0))
    return out


_LAGS = 4  # of the mean lag: how far back along the path a load is searched
_FINE_S = 1.25e-3  # from point to point of the path
BEFORE, AFTER = 1.0, 3.0  # lags: between an acceleration and the places where it shows
_AIM = 0.98  # of the tolerance
_LEAST_SHARE = 1e-3  # of the tolerance: smaller shares count as this
_EASED, _TIGHTENED = 0.7, 1.6  # exponents on the unused, or exceeded, share of a guard


class Past:
    """The end of a motion, as far as the loops still remember it.

    Parameters
    ----------
    memory_s
        Memory of the loops, s.
    """

    def __init__(self, memory_s: float) -> None:
        self._memory_s = memory_s
        self._blocks: list[TrajectoryBlock] = []

    def add(self, block: TrajectoryBlock) -> None:
        """Add the next block, and discard blocks that are too old."""
        since = block.end_s - 2.0 * self._memory_s
        self._blocks = [kept for kept in self._blocks if kept.end_s > since]
        self._blocks.append(block)

    def commanded(self, block: TrajectoryBlock, time_s: FloatArray) -> FloatArray:
        """Return (n, axes) commanded positions at ascending times; ``block`` is the last block."""
        blocks = [*self._blocks, block]
        out = np.tile(blocks[0].coefficients[0, 0], (len(time_s), 1))
        for part in blocks:
            inside = time_s >= part.start_s[0]
            out[inside] = part.evaluate(time_s[inside])
        return out


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Follower:
    """Models of the loops, and the allowed deviation of the loads from the path.

    Parameters
    ----------
    answers
        Response of each axis; None for an axis that follows its command exactly.
    radius_m
        (axes,) factors from positions to lengths at the tool.
    tolerance_m
        Allowed distance of the loads from the planned path.
    """

    answers: tuple[Answer | None, ...]
    radius_m: FloatArray
    tolerance_m: float

    @property
    def lag_s(self) -> float:
        """Mean lag of the axes that lag."""
        lags = [a.moments[0] for a in self.answers if a is not None]
        return float(np.mean(lags)) if lags else 0.0

    @property
    def memory_s(self) -> float:
        """Time after which the loops have forgotten a motion, s."""
        return max((a.memory_s for a in self.answers if a is not None), default=0.0)

    @property
    def tick_s(self) -> float:
        """Time between two instants at which the loads are compared with the path, s."""
        return max(min((a.period_s for a in self.answers if a is not None), default=0.0), 1e-3)

    def coefficients(self) -> tuple[FloatArray, FloatArray]:
        """Return the (axes,) errors of a load per velocity, s, and per acceleration, s^2.

        They are errors relative to the motion delayed by the mean lag: a delay common to all axes
        takes no load off the path.
        """
        lag = self.lag_s
        first, second = np.full(len(self.answers), lag), np.full(len(self.answers), 0.5 * lag**2)
        for k, answer in enumerate(self.answers):
            if answer is not None:
                one, two = answer.moments
                first[k] -= one
                second[k] += two - lag * one
        return first, second

    def swing(self, step_s: float) -> FloatArray:
        """Return the (d, axes) error in m that a unit change of velocity leaves, d steps later."""
        time_s = np.arange(0.0, self.memory_s, step_s)
        out = np.zeros((len(time_s), len(self.answers)))
        for k, answer in enumerate(self.answers):
            if answer is not None:
                tick = np.arange(len(answer.taps) + 1, dtype=np.float64)
                ramp = np.asarray(tick * answer.period_s)
                moved = answer.load(ramp) - np.maximum(ramp - answer.moments[0], 0.0)
                out[:, k] = np.interp(time_s, ramp, moved)
        return out

    def guarded(
        self,
        elements: Elements,
        ease: FloatArray,
        straight: FloatArray,
        most: FloatArray | None = None,
    ) -> Elements:
        """Return the elements with guards that keep accelerations within the tolerance.

        Parameters
        ----------
        ease
            (n,) factor by which the error of a steady acceleration may exceed the tolerance: an
            acceleration shorter than the lag hardly shows.
        straight
            (n,) share of the error that is along the path and does not count.
        most
            (n,) largest square of the rate of the common parameter, if any.
        """
        speed, push = self.coefficients()
        c = elements.c[:, :, : len(self.radius_m)] * self.radius_m
        tangent = tangents(elements, self.radius_m)
        room = (self.tolerance_m * ease)[:, None, None]

        def across(vectors: FloatArray) -> FloatArray:
            along = np.einsum("nka,na->nk", vectors, tangent)
            return np.asarray(
                vectors - (straight[:, None] * along)[:, :, None] * tangent[:, None, :]
            )

        guard = across(c * push) / room
        size = np.abs(guard).max(axis=(1, 2), keepdims=True)
        guard[np.abs(guard) < 1e-9 * np.maximum(size, 1e-300)] = 0.0
        rate = np.abs(across((c * speed)[:, 1:] * np.arange(1.0, c.shape[1])[None, :, None]) / room)
        fastest = rate.sum(axis=1).max(axis=1)
        with np.errstate(over="ignore"):  # a rate near zero: no cap
            cap = (
                np.divide(1.0, fastest, out=np.full(len(fastest), np.inf), where=fastest > 0.0) ** 2
            )
        if most is not None:
            cap = np.minimum(cap, most / elements.length**2)
        return replace(elements, guard=guard, guard_cap=cap)

    def strays(self, past: Past, block: TrajectoryBlock) -> Strays:
        """Return the deviation of the loads from the path.

        Parameters
        ----------
        past
            The motion before ``block``.
        """
        tick = self.tick_s
        window = ceil(_LAGS * self.lag_s / tick) + 1
        before = ceil(self.memory_s / tick) + 2 * window
        begin = float(block.start_s[0])
        count = before + ceil((block.end_s - begin) / tick) + 2 * window
        at = begin + (np.arange(count) - before) * tick
        fine = max(1, ceil(tick / _FINE_S))
        way_s = at[0] + np.arange((count - 1) * fine + 1) * (tick / fine)
        way = past.commanded(block, way_s) * self.radius_m
        load = np.empty((count, way.shape[1]))
        for k, answer in enumerate(self.answers):
            if answer is None:
                load[:, k] = way[::fine, k]
                continue
            own_s = np.arange(at[0], at[-1] + answer.period_s, answer.period_s)
            commanded = past.commanded(block, own_s)[:, k] * self.radius_m[k]
            load[:, k] = np.interp(at, own_s, answer.load(commanded))
        first = before - 2 * window
        error, seen = strayed(load[first:], way[first * fine :], fine, window)
        return Strays(
            time_s=way_s[first * fine :], error_m=error, tick=seen, fine=fine, follower=self
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Strays:
    """Deviations of loads from their commanded path.

    Parameters
    ----------
    time_s
        (f,) evenly spaced times of the points of the commanded path.
    error_m
        (f, axes) vectors from the path to the loads, at the tool.
    tick
        (f,) when the loads are there, in ticks of ``fine`` points from the first.
    """

    time_s: FloatArray
    error_m: FloatArray
    tick: IntArray
    fine: int
    follower: Follower

    @property
    def share(self) -> FloatArray:
        """(f,) distances from the path as shares of the tolerance."""
        return np.asarray(np.linalg.norm(self.error_m, axis=1) / self.follower.tolerance_m)

    def worst(self, places_s: FloatArray) -> FloatArray:
        """Return the (n,) largest share of the tolerance caused by the motion at some times."""
        from scipy.ndimage import maximum_filter1d  # slow to import, and few commands need it

        lag, step = self.follower.lag_s, float(self.time_s[1] - self.time_s[0])
        before, after = (ceil(lags * lag / step) for lags in (BEFORE, AFTER))
        width = before + after + 1
        most = maximum_filter1d(self.share, width, origin=before - width // 2, mode="nearest")
        return np.asarray(np.interp(places_s, self.time_s, most))

    def due(self, block: TrajectoryBlock, places_s: FloatArray) -> FloatArray:
        """Return the (n,) logarithms by which to change the accelerations at some times."""
        step = float(self.time_s[1] - self.time_s[0])
        most = np.log(np.maximum(self.worst(self.time_s) / _AIM, _LEAST_SHARE))
        inside = (self.time_s >= block.start_s[0]) & (self.time_s <= block.end_s)
        acceleration = np.zeros_like(self.error_m)
        acceleration[inside] = block.evaluate(self.time_s[inside], 2) * self.follower.radius_m
        blame = blamed(
            self.error_m,
            self.tick,
            self.fine,
            acceleration,
            self.follower.swing(step),
            _AIM * self.follower.tolerance_m,
        )
        # Where an error exceeds the tolerance, only its causes are tightened, and nothing is eased.
        change = np.where(most > 0.0, -_TIGHTENED * blame, -_EASED * most)
        return np.asarray(np.interp(places_s, self.time_s, change))


def tangents(elements: Elements, radius_m: FloatArray) -> FloatArray:
    """Return the (n, axes) directions from start to end of each element, at the tool.

    If the last axis is the travelled path length, it is left out.
    """
    way = elements.c[:, 1:, : len(radius_m)].sum(axis=1) * radius_m
    size = np.linalg.norm(way, axis=1, keepdims=True)
    return np.asarray(way / np.where(size > 0.0, size, 1.0))
