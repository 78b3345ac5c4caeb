"""The path between two samples, where the velocity of the load is recorded as well.

Within a tick no controller acts. A load with acceleration a leaves the straight segment between two
samples, a time T apart, by a T^2 / 8. Positions and velocities at both ends define a cubic Hermite
interpolant. It is exact if the acceleration is constant over the tick. Its error is at most
b T^2 / 62 if the acceleration steps by b within the tick, and a T^4 / (384 tau^2) if the motion
decays as exp(-t / tau).

Few paths need to be examined: for almost all of them a bound shows that they are no farther from
the programmed path than the worst place so far.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.files import ChannelKind
from threadline.verdict.nearest import Farthest, Nearest, Search, Track, weighted_to_segment
from threadline.verdict.samples import Block, Setting, lanes

NO_VELOCITY = "the velocity of a load has fewer samples than its position"
"""Why nothing is measured if velocities end before positions do."""

FOLLOWED = {
    "contour_error", "progress_error", "turning_point_error", "stitch_length_error",
    "stitch_speed_error", "stitch_placement_error", "seam_error",
}  # fmt: skip
"""Measures that follow the loads between samples, by their velocities."""

_NOTHING_M2 = 1e-26  # a point this close to the path lies on it, up to rounding
_PARTS = 8  # of a path that is examined: within a part, the deviation is a 64th of the whole
_MORE = 1.0 + 1e-9  # factor on a bound, for rounding in the value that it is compared with


class Span(NamedTuple):
    """The path between two successive samples, a cubic Hermite interpolant.

    ``start`` and ``end`` are the positions, ``m0`` and ``m1`` the tangents: velocity times sample
    interval. All are (axes,) for one run, or (axes, runs).
    """

    start: FloatArray
    end: FloatArray
    m0: FloatArray
    m1: FloatArray


class Bows(NamedTuple):
    """Deviation of the path from the straight segments that lead to n samples.

    ``tangents``, (n + 1, axes, runs), are velocities times the sample interval, as lengths at the
    tool; row 0 belongs to the sample before. ``most``, (n, 1, runs), is an upper bound of the
    squared deviation. Without velocities ``known`` is False, and both are empty.
    """

    known: bool
    tangents: FloatArray
    most: FloatArray


NO_BOWS = Bows(False, np.empty((0, 0, 0)), np.empty((0, 0, 0)))


def _bound(points: FloatArray, share: FloatArray | None, bows: Bows) -> None:
    """Fill in the bounds for (n + 1, axes, runs) points, the first of them the sample before.

    The deviation is s (1 - s) times a mean of the differences between tangents and segment, and
    s (1 - s) is at most 1/4.
    """
    _, tangents, most = bows
    rows, axes, runs = points.shape
    for i in range(rows - 1):
        for r in range(runs):
            most[i, 0, r] = 0.0
        for a in range(axes):
            for r in range(runs):
                step = points[i + 1, a, r] - points[i, a, r]
                first, last = tangents[i, a, r] - step, tangents[i + 1, a, r] - step
                first, last = first * first, last * last
                larger = max(last, first)
                if share is not None:
                    larger *= share[i, a, r] * share[i, a, r]
                most[i, 0, r] += larger * (_MORE / 16.0)


bound_bows = njit(nogil=True)(_bound)


def _deviation(s: float, step: float, m0: float, m1: float) -> float:
    """Return the deviation of one axis from the straight segment, at s (0..1).

    Source: the cubic Hermite interpolant with the tangents ``m0`` and ``m1``, less its chord
    ``step``.
    """
    return s * (1.0 - s) * ((1.0 - s) * (m0 - step) - s * (m1 - step))


deviation = njit(nogil=True)(_deviation)


def _search_span(
    span: Span, share: FloatArray, search: Search, farthest: Farthest, r: int, number: int
) -> None:
    """Raise the farthest place of run ``r`` where the path to sample ``number`` is farther."""
    start, end, m0, m1 = span
    vertices, low, high, _, _ = search
    worst, at, part, worst_chord = farthest
    axes = len(start)
    point = np.empty(axes)
    for k in range(1, _PARTS):
        s = k / _PARTS
        for a in range(axes):
            step = end[a] - start[a]
            point[a] = start[a] + s * step + deviation(s, step, m0[a], m1[a])
        best, nearest = np.inf, -1
        for c in range(low, high + 1):
            away = weighted_to_segment(point, vertices[c - 1], vertices[c], share)
            if away < best:
                best, nearest = away, c
        if best > worst[r]:
            worst[r], at[r], part[r], worst_chord[r] = best, number, s, nearest


search_span = njit(nogil=True)(_search_span)


def _bow_across(span: Span, share: FloatArray, search: Search, bow: float) -> float:
    """Return an upper bound of the squared deviation across the chord ``search.near_end``.

    A load that accelerates deviates along its chord, which is no error. Near an end of the chord
    the whole deviation ``bow``, squared, counts.
    """
    start, end, m0, m1 = span
    vertices, _, _, _, c = search
    length, first, second, m0_along, m1_along = 0.0, 0.0, 0.0, 0.0, 0.0
    for a in range(len(start)):
        vector, step = share[a] * (vertices[c, a] - vertices[c - 1, a]), end[a] - start[a]
        length += vector * vector
        first += share[a] * (start[a] - vertices[c - 1, a]) * vector
        second += share[a] * (end[a] - vertices[c - 1, a]) * vector
        m0_along += share[a] * (m0[a] - step) * vector
        m1_along += share[a] * (m1[a] - step) * vector
    most = np.sqrt(bow * length)
    if not (min(first, second) >= most and max(first, second) <= length - most):
        return bow
    lead, trail = 0.0, 0.0
    for a in range(len(start)):
        vector = share[a] * (vertices[c, a] - vertices[c - 1, a]) / length
        step = end[a] - start[a]
        lead += (share[a] * (m0[a] - step) - m0_along * vector) ** 2
        trail += (share[a] * (m1[a] - step) - m1_along * vector) ** 2
    return float(max(lead, trail) * (_MORE / 16.0))


bow_across = njit(nogil=True)(_bow_across)


def _may_be_farther(first: float, second: float, long: float, bow: float, worst: float) -> bool:
    """Return whether the path may be farther from the programmed path than ``worst``.

    ``first`` and ``second`` are the distances of its ends, and ``bow`` bounds its deviation; all
    are squared. ``long`` is the length of the segment if its ends are nearest to different chords,
    else 0.
    """
    off = max(first, second)
    if long > 0.0:
        off = max(off, (0.5 * (np.sqrt(first) + np.sqrt(second) + long)) ** 2)
    worst = max(worst, _NOTHING_M2)
    return bool(bow > 0.0 and (off + bow + 2.0 * np.sqrt(off * bow)) * _MORE > worst)


may_be_farther = njit(nogil=True)(_may_be_farther)


def _some_run_may_be_farther(
    span: Span,
    start: FloatArray,
    end: FloatArray,
    each: tuple[int, ...],
    off: FloatArray,
    most: FloatArray,
    worst: FloatArray,
) -> bool:
    """Return whether the path of any run may be farther than its worst, as ``bow_across``.

    All runs are nearest to the chord from ``start`` to ``end``, (axes,). ``off``, (2, runs), are
    the squared distances of the samples at both ends of the span, ``most``, (runs,), bounds the
    squared deviation, and ``worst`` is (runs,), squared. ``each`` has an entry for each axis, so
    that the loop over the runs becomes vector instructions.
    """
    before, points, m0, m1 = span
    length = 0.0
    for a in range(len(each)):
        length += (end[a] - start[a]) * (end[a] - start[a])
    length = length if length > 0.0 else 1.0
    larger = 0
    for r in range(points.shape[1]):
        low, high, m0_along, m1_along = 0.0, 0.0, 0.0, 0.0
        for a in range(len(each)):
            vector, step = end[a] - start[a], points[a, r] - before[a, r]
            low += (before[a, r] - start[a]) * vector
            high += (points[a, r] - start[a]) * vector
            m0_along += (m0[a, r] - step) * vector
            m1_along += (m1[a, r] - step) * vector
        lead, trail = 0.0, 0.0
        for a in range(len(each)):
            vector, step = (end[a] - start[a]) / length, points[a, r] - before[a, r]
            lead += (m0[a, r] - step - m0_along * vector) * (m0[a, r] - step - m0_along * vector)
            trail += (m1[a, r] - step - m1_along * vector) * (m1[a, r] - step - m1_along * vector)
        reach = np.sqrt(most[r] * length)
        lead = max(trail, lead) * (_MORE / 16.0)
        inside = (min(high, low) >= reach) & (max(low, high) <= length - reach)
        bow = lead if inside else most[r]
        away = max(off[1, r], off[0, r])
        least = max(_NOTHING_M2, worst[r])
        larger += (away + bow + 2.0 * np.sqrt(away * bow)) * _MORE > least
    return larger > 0


_some_run_may_be_farther_fast = njit(nogil=True)(_some_run_may_be_farther)


def _raise_to_bows(
    track: Track,
    bows: Bows,
    nearest: Nearest,
    vertices: FloatArray,
    each: tuple[int, ...],
    share: FloatArray | None,
    farthest: Farthest,
) -> None:
    """Raise the farthest places where the path between two samples is farther.

    ``nearest`` has a row for each row of ``track``. ``share``, (n, axes, runs), weighs the axes;
    empty means equal weights. ``each`` has an entry for each axis.
    """
    points, _, begin, end, number = track
    _, tangents, most = bows
    off, chord, common = nearest
    worst = farthest.squared
    rows, axes, runs = points.shape
    here, there, weights = np.empty(axes), np.empty(axes), np.ones(axes)
    m0, m1 = np.empty(axes), np.empty(axes)
    for i in range(rows - 1):
        alike = common[i] >= 0 and common[i] == common[i + 1]
        if alike:
            larger = 0
            for r in range(runs):
                worse = max(off[i + 1, r], off[i, r])
                bow = most[i, 0, r]
                larger += (worse + bow + 2.0 * np.sqrt(worse * bow)) * _MORE > worst[r]
            if not larger:
                continue
            if share is None:
                span = Span(points[i], points[i + 1], tangents[i], tangents[i + 1])
                start, end_of = vertices[common[i] - 1], vertices[common[i]]
                if not _some_run_may_be_farther_fast(
                    span, start, end_of, each, off[i : i + 2], most[i, 0], worst
                ):
                    continue
        for r in range(runs):
            near_start = common[i] if common[i] >= 0 else chord[i, r]
            near_end = common[i + 1] if common[i + 1] >= 0 else chord[i + 1, r]
            long = 0.0
            for a in range(axes):
                here[a], there[a] = points[i, a, r], points[i + 1, a, r]
                if share is not None:
                    weights[a] = share[i, a, r]
                long += (weights[a] * (there[a] - here[a])) ** 2
            long = 0.0 if near_start == near_end else np.sqrt(long)
            bow = most[i, 0, r]
            if not may_be_farther(off[i, r], off[i + 1, r], long, bow, worst[r]):
                continue
            for a in range(axes):
                m0[a], m1[a] = tangents[i, a, r], tangents[i + 1, a, r]
            span = Span(here, there, m0, m1)
            low, high = min(begin[i], begin[i + 1]), max(end[i], end[i + 1])
            search = Search(vertices, low, high, near_start, near_end)
            if long == 0.0:
                bow = bow_across(span, weights, search, bow)
            if may_be_farther(off[i, r], off[i + 1, r], long, bow, worst[r]):
                search_span(span, weights, search, farthest, r, number + i)


raise_to_bows = njit(nogil=True)(_raise_to_bows)


def bows(setting: Setting) -> bool:
    """Return whether a recording has the velocities of all loads at each tick of the commands.

    They must have the instants of the positions. Then the path between samples is known, as no
    controller acts between ticks.
    """
    tick_s = float(setting.plan.commands.clock.period_s)
    if setting.interval_s > tick_s * (1.0 + 1e-9):
        return False
    position = setting.recording.find(ChannelKind.LOAD, setting.axes[0])
    found = [setting.recording.find(ChannelKind.VELOCITY, axis) for axis in setting.axes]
    return position is not None and all(
        one is not None and one.clock == position.clock and one.stride == position.stride
        for one in found
    )


class Between(NamedTuple):
    """Arrays that a sweep over a block reads for the paths between its samples.

    ``velocity`` is (n, axes, runs), empty if unknown; ``scale``, (axes,), makes Hermite tangents of
    velocities: sample interval times length at the tool. ``before`` and ``tangent``, (axes, runs),
    are position and tangent at the sample before the block, left by the previous sweep; ``begun``
    is 0 if there is no such sample.
    """

    velocity: FloatArray
    scale: FloatArray
    before: FloatArray
    tangent: FloatArray
    begun: IntArray


NO_BETWEEN = Between(
    np.empty((0, 0, 0)), np.empty(0), np.empty((0, 0)), np.empty((0, 0)), np.zeros(1, np.int64)
)


class MotionBetween:
    """Makes ``Between`` for each block of a recording that has velocities at its samples.

    ``incomplete`` becomes True if velocities end before positions do.
    """

    def __init__(self, setting: Setting) -> None:
        shape = len(setting.axes), setting.runs
        self._known, self.incomplete = bows(setting), False
        self._scale = setting.interval_s * setting.radius_m
        self._before, self._tangent = np.zeros(shape), np.zeros(shape)
        self._begun = np.zeros(1, dtype=np.int64)

    def part(self, block: Block) -> Between:
        """Return the arrays of a block; ``NO_BETWEEN`` if velocities are unknown."""
        if not self._known or block.velocity is None:
            return NO_BETWEEN
        velocity = lanes(block.velocity)
        # After the last velocity, all are NaN.
        self.incomplete = self.incomplete or not np.isfinite(velocity[-1]).all()
        return Between(velocity, self._scale, self._before, self._tangent, self._begun)


def _turns(step: float, m0: float, m1: float) -> bool:
    """Return whether one axis may reverse between two samples, ``step`` apart.

    Otherwise the cubic with the tangents ``m0`` and ``m1`` is monotone (Fritsch and Carlson,
    "Monotone piecewise cubic interpolation", SIAM J. Numer. Anal. 17, 1980).
    """
    most = 3.0 * abs(step)
    # A reversal that comes from rounding alone is too small to reach any limit.
    on = (m0 * step >= 0.0) & (m1 * step >= 0.0) & (abs(m0) <= most) & (abs(m1) <= most)
    return not on


turns = njit(nogil=True)(_turns)


def _turning_places(step: float, m0: float, m1: float) -> tuple[float, float]:
    """Return where (0..1) between two samples one axis reverses, in order; NaN if it does not.

    Source: the roots of the derivative of the cubic Hermite interpolant,
    ``3 (m0 + m1 - 2 step) s^2 + 2 (3 step - 2 m0 - m1) s + m0``.
    """
    a, b, c = 3.0 * (m0 + m1 - 2.0 * step), 2.0 * (3.0 * step - 2.0 * m0 - m1), m0
    under = b * b - 4.0 * a * c
    first, second = np.nan, np.nan
    if under >= 0.0:
        q = -0.5 * (b + (np.sqrt(under) if b >= 0.0 else -np.sqrt(under)))
        if q != 0.0 and 0.0 < c / q < 1.0:
            first = c / q
        if a != 0.0 and 0.0 < q / a < 1.0:
            second = q / a
    if not first <= second:  # either may be NaN
        first, second = second, first
    return first, second


turning_places = njit(nogil=True)(_turning_places)


def _charge(points: FloatArray, low: int, between: Between, charge: FloatArray) -> None:
    """Raise ``charge``, (runs,), to a bound of the distance between path and straight segment.

    ``points``, (n, axes, runs), are samples, the first of them ``low`` of the block. A path that
    advances along its segment, at any speed, leaves it only across; a path that turns back also
    leaves it by its distance beyond an end.
    """
    velocity, scale, before, tangent, begun = between
    samples, axes, runs = points.shape
    m0, m1 = np.empty(axes), np.empty(axes)  # less the segment
    for i in range(samples):
        if i == 0 and begun[0] == 0:
            continue
        for r in range(runs):
            length, m0_along, m1_along, first, last = 0.0, 0.0, 0.0, 0.0, 0.0
            for a in range(axes):
                start = before[a, r] if i == 0 else points[i - 1, a, r]
                step = points[i, a, r] - start
                m0[a] = (tangent[a, r] if i == 0 else scale[a] * velocity[low + i - 1, a, r]) - step
                m1[a] = scale[a] * velocity[low + i, a, r] - step
                length += step * step
                m0_along += m0[a] * step
                m1_along += m1[a] * step
                first += m0[a] * m0[a]
                last += m1[a] * m1[a]
            bow = max(first, last)
            if not bow > 16.0 * charge[r] * charge[r]:
                continue
            if length > 0.0:
                bow = max(first - m0_along * m0_along / length, last - m1_along * m1_along / length)
                bow = max(bow, 0.0)
                # With tangents between 0 and three times the segment the path advances along it.
                if min(m0_along, m1_along) < -length or max(m0_along, m1_along) > 2.0 * length:
                    long = np.sqrt(length)
                    leave, come, over = m0_along / long + long, m1_along / long + long, 0.0
                    for s in turning_places(long, leave, come):
                        if s > 0.0:  # or NaN
                            place = s * long + deviation(s, long, leave, come)
                            over = max(over, -place, place - long)
                    bow += 16.0 * over * over
            if bow > 16.0 * charge[r] * charge[r]:
                charge[r] = 0.25 * np.sqrt(bow)
    for a in range(axes):
        for r in range(runs):
            before[a, r] = points[samples - 1, a, r]
            tangent[a, r] = scale[a] * velocity[low + samples - 1, a, r]
    begun[0] = 1


charge_bows = njit(nogil=True)(_charge)
