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
    projection, length2 = 0.0, 0.0
    for k in range(len(point)):
        direction = end[k] - start[k]
        projection += (point[k] - start[k]) * direction
        length2 += direction * direction
    place = 0.0 if length2 <= 0.0 else min(max(projection / length2, 0.0), 1.0)
    distance2 = 0.0
    for k in range(len(point)):
        gap = point[k] - start[k] - place * (end[k] - start[k])
        distance2 += gap * gap
    return distance2, place


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
    largest2 = np.zeros(len(way))
    out = np.zeros((len(way), axes))
    tick = np.zeros(len(way), dtype=np.int64)
    for k in range(window, len(load)):
        least2, nearest, place = np.inf, 0, 0.0
        last_point = min(k * fine, len(way) - 1)
        for f in range(max(last_point - window * fine, 0), max(last_point, 1)):
            distance2, place_found = _squared(load[k], way[f], way[f + 1])
            if distance2 < least2:
                least2, nearest, place = distance2, f, place_found
        if least2 > largest2[nearest]:
            largest2[nearest], tick[nearest] = least2, k
            for a in range(axes):
                out[nearest, a] = (
                    load[k, a] - way[nearest, a] - place * (way[nearest + 1, a] - way[nearest, a])
                )
    for f in range(window * fine, len(way)):
        least2, nearest, place = np.inf, 0, 0.0
        begin = f // fine
        for k in range(begin, min(begin + window, len(load) - 1)):
            distance2, place_found = _squared(way[f], load[k], load[k + 1])
            if distance2 < least2:
                least2, nearest, place = distance2, k, place_found
        if largest2[f] < least2 < np.inf:
            largest2[f], tick[f] = least2, nearest
            for a in range(axes):
                out[f, a] = (
                    load[nearest, a] + place * (load[nearest + 1, a] - load[nearest, a]) - way[f, a]
                )
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
        error_m = np.sqrt((error[f] ** 2).sum())
        if error_m <= tolerance:
            continue
        excess = np.log(error_m / tolerance)
        load_point = min(tick[f] * fine, len(error) - 1)
        largest_share = 0.0
        for d in range(min(len(swing), load_point + 1)):
            share[d] = (error[f] * swing[d] * acceleration[load_point - d]).sum()
            largest_share = max(largest_share, share[d])
        for d in range(min(len(swing), load_point + 1)):
            if share[d] > 0.0:
                weight = min(1.0, 2.0 * share[d] / largest_share)
                out[load_point - d] = max(out[load_point - d], weight * excess)
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
        oldest_s = block.end_s - 2.0 * self._memory_s
        self._blocks = [old_block for old_block in self._blocks if old_block.end_s > oldest_s]
        self._blocks.append(block)

    def commanded(self, block: TrajectoryBlock, time_s: FloatArray) -> FloatArray:
        """Return (n, axes) commanded positions at ascending times; ``block`` is the last block."""
        blocks = [*self._blocks, block]
        positions = np.tile(blocks[0].coefficients[0, 0], (len(time_s), 1))
        for part in blocks:
            inside = time_s >= part.start_s[0]
            positions[inside] = part.evaluate(time_s[inside])
        return positions


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
        per_velocity, per_acceleration = (
            np.full(len(self.answers), lag),
            np.full(len(self.answers), 0.5 * lag**2),
        )
        for k, answer in enumerate(self.answers):
            if answer is not None:
                first_moment, second_moment = answer.moments
                per_velocity[k] -= first_moment
                per_acceleration[k] += second_moment - lag * first_moment
        return per_velocity, per_acceleration

    def swing(self, step_s: float) -> FloatArray:
        """Return the (d, axes) error in m that a unit change of velocity leaves, d steps later."""
        time_s = np.arange(0.0, self.memory_s, step_s)
        swings = np.zeros((len(time_s), len(self.answers)))
        for k, answer in enumerate(self.answers):
            if answer is not None:
                tick = np.arange(len(answer.taps) + 1, dtype=np.float64)
                ramp = np.asarray(tick * answer.period_s)
                ramp_error = answer.load(ramp) - np.maximum(ramp - answer.moments[0], 0.0)
                swings[:, k] = np.interp(time_s, ramp, ramp_error)
        return swings

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
        allowed_m = (self.tolerance_m * ease)[:, None, None]

        def across(vectors: FloatArray) -> FloatArray:
            along = np.einsum("nka,na->nk", vectors, tangent)
            return np.asarray(
                vectors - (straight[:, None] * along)[:, :, None] * tangent[:, None, :]
            )

        guard = across(c * push) / allowed_m
        largest = np.abs(guard).max(axis=(1, 2), keepdims=True)
        guard[np.abs(guard) < 1e-9 * np.maximum(largest, 1e-300)] = 0.0
        rate = np.abs(
            across((c * speed)[:, 1:] * np.arange(1.0, c.shape[1])[None, :, None]) / allowed_m
        )
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
        history_ticks = ceil(self.memory_s / tick) + 2 * window
        begin_s = float(block.start_s[0])
        count = history_ticks + ceil((block.end_s - begin_s) / tick) + 2 * window
        tick_times_s = begin_s + (np.arange(count) - history_ticks) * tick
        fine = max(1, ceil(tick / _FINE_S))
        path_times_s = tick_times_s[0] + np.arange((count - 1) * fine + 1) * (tick / fine)
        path_m = past.commanded(block, path_times_s) * self.radius_m
        load = np.empty((count, path_m.shape[1]))
        for k, answer in enumerate(self.answers):
            if answer is None:
                load[:, k] = path_m[::fine, k]
                continue
            axis_times_s = np.arange(
                tick_times_s[0], tick_times_s[-1] + answer.period_s, answer.period_s
            )
            commanded = past.commanded(block, axis_times_s)[:, k] * self.radius_m[k]
            load[:, k] = np.interp(tick_times_s, axis_times_s, answer.load(commanded))
        first_tick = history_ticks - 2 * window
        error, seen_ticks = strayed(load[first_tick:], path_m[first_tick * fine :], fine, window)
        return Strays(
            time_s=path_times_s[first_tick * fine :],
            error_m=error,
            tick=seen_ticks,
            fine=fine,
            follower=self,
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
        largest_nearby = maximum_filter1d(
            self.share, width, origin=before - width // 2, mode="nearest"
        )
        return np.asarray(np.interp(places_s, self.time_s, largest_nearby))

    def due(self, block: TrajectoryBlock, places_s: FloatArray) -> FloatArray:
        """Return the (n,) logarithms by which to change the accelerations at some times."""
        step = float(self.time_s[1] - self.time_s[0])
        log_excess = np.log(np.maximum(self.worst(self.time_s) / _AIM, _LEAST_SHARE))
        inside = (self.time_s >= block.start_s[0]) & (self.time_s <= block.end_s)
        acceleration = np.zeros_like(self.error_m)
        acceleration[inside] = block.evaluate(self.time_s[inside], 2) * self.follower.radius_m
        log_blame = blamed(
            self.error_m,
            self.tick,
            self.fine,
            acceleration,
            self.follower.swing(step),
            _AIM * self.follower.tolerance_m,
        )
        # Where an error exceeds the tolerance, only its causes are tightened, and nothing is eased.
        change = np.where(log_excess > 0.0, -_TIGHTENED * log_blame, -_EASED * log_excess)
        return np.asarray(np.interp(places_s, self.time_s, change))


def tangents(elements: Elements, radius_m: FloatArray) -> FloatArray:
    """Return the (n, axes) directions from start to end of each element, at the tool.

    If the last axis is the travelled path length, it is left out.
    """
    displacement = elements.c[:, 1:, : len(radius_m)].sum(axis=1) * radius_m
    length = np.linalg.norm(displacement, axis=1, keepdims=True)
    return np.asarray(displacement / np.where(length > 0.0, length, 1.0))
