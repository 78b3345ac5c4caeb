"""The way between two samples, where the velocity of the load is recorded as well.

Within a tick no controller acts, and a load that accelerates by a leaves the straight line between
its samples by a T^2 / 8. With the places and the velocities at both ends the way between is the
cubic that has them (Hermite). Of a load whose acceleration is steady over the tick it is exact;
where the acceleration steps by b within the tick, it is off by b T^2 / 62 at most, and where the
load moves by exp(-t / tau) by a T^4 / (384 tau^2).

Few ways have to be looked along: a bound tells of almost all that they are no worse than the worst.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.files import ChannelKind
from threadline.verdict.nearest import weighed_to_segment
from threadline.verdict.samples import Block, Setting, lanes

NO_VELOCITY = "the velocity of a load has fewer samples than its position"
"""Why nothing is measured where velocities end before the places do."""

FOLLOWED = {
    "contour_error", "progress_error", "turning_point_error", "stitch_length_error",
    "stitch_speed_error", "stitch_placement_error", "seam_error",
}  # fmt: skip
"""Measures that follow the loads between samples, by their velocities."""

_NOTHING_M2 = 1e-26  # a place this close to the path is on it, up to rounding
_PARTS = 8  # of a way that is looked along: between them it bows by a 64th of the whole
_MORE = 1.0 + 1e-9  # factor on a bound, for rounding in the value that it is compared with


class Bows(NamedTuple):
    """How the ways that lead to n samples bow.

    ``pace``, (n + 1, axes, runs), is the way at the tool that each load would go in a sample
    interval at its velocity; row 0 belongs to the sample before. ``most``, (n, 1, runs), is a
    bound of the squared distance from the straight line. ``known`` is False without velocities,
    and both are empty then.
    """

    known: bool
    pace: FloatArray
    most: FloatArray


NO_BOWS = Bows(False, np.empty((0, 0, 0)), np.empty((0, 0, 0)))


def _bound(points: FloatArray, before: FloatArray, share: FloatArray, bows: Bows) -> None:
    """Fill in the bounds of the ways that lead to (n, axes, runs) points; s(1-s) is at most 1/4."""
    _, pace, most = bows
    weighed = len(share) > 0
    samples, axes, runs = points.shape
    for i in range(samples):
        for r in range(runs):
            most[i, 0, r] = 0.0
        for a in range(axes):
            for r in range(runs):
                start = before[a, r] if i == 0 else points[i - 1, a, r]
                step = points[i, a, r] - start
                out, back = pace[i, a, r] - step, pace[i + 1, a, r] - step
                out, back = out * out, back * back
                larger = out if out > back else back
                if weighed:
                    larger *= share[i, a, r] * share[i, a, r]
                most[i, 0, r] += larger * (_MORE / 16.0)


bound_bows = njit(nogil=True)(_bound)


def _beside(s: float, step: float, out: float, back: float) -> float:
    """Return how far the way is from the straight line at s (0..1), of one axis.

    Source: the cubic through both ends with the slopes ``out`` and ``back``, less its chord.
    """
    return s * (1.0 - s) * ((1.0 - s) * (out - step) - s * (back - step))


beside = njit(nogil=True)(_beside)


def _look_along(
    here: FloatArray,
    there: FloatArray,
    out: FloatArray,
    back: FloatArray,
    low: int,
    high: int,
    vertices: FloatArray,
    of: FloatArray,
    worst: FloatArray,
    at: IntArray,
    part: FloatArray,
    worst_chord: IntArray,
    r: int,
    number: int,
) -> None:
    """Raise ``worst[r]``, squared, where a way is farther from the chords ``low`` to ``high``."""
    axes = len(here)
    point = np.empty(axes)
    for k in range(1, _PARTS):
        s = k / _PARTS
        for a in range(axes):
            step = there[a] - here[a]
            point[a] = here[a] + s * step + beside(s, step, out[a], back[a])
        best, nearest = np.inf, -1
        for c in range(low, high + 1):
            away = weighed_to_segment(point, vertices[c - 1], vertices[c], of)
            if away < best:
                best, nearest = away, c
        if best > worst[r]:
            worst[r], at[r], part[r], worst_chord[r] = best, number, s, nearest


look_along = njit(nogil=True)(_look_along)


def _across(
    here: FloatArray,
    there: FloatArray,
    out: FloatArray,
    back: FloatArray,
    start: FloatArray,
    end: FloatArray,
    of: FloatArray,
    bow: float,
) -> float:
    """Return a bound of how far a way bows across the chord from ``start`` to ``end``, squared.

    A load that speeds up bows along its chord, which is no error. Near an end of the chord all of
    ``bow`` counts.
    """
    length, first, second, of_out, of_back = 0.0, 0.0, 0.0, 0.0, 0.0
    for a in range(len(here)):
        way, step = of[a] * (end[a] - start[a]), there[a] - here[a]
        length += way * way
        first += of[a] * (here[a] - start[a]) * way
        second += of[a] * (there[a] - start[a]) * way
        of_out += of[a] * (out[a] - step) * way
        of_back += of[a] * (back[a] - step) * way
    most = np.sqrt(bow * length)
    if not (min(first, second) >= most and max(first, second) <= length - most):
        return bow
    lead, trail = 0.0, 0.0
    for a in range(len(here)):
        way, step = of[a] * (end[a] - start[a]) / length, there[a] - here[a]
        lead += (of[a] * (out[a] - step) - of_out * way) ** 2
        trail += (of[a] * (back[a] - step) - of_back * way) ** 2
    return float(max(lead, trail) * (_MORE / 16.0))


across = njit(nogil=True)(_across)


def _may_be_farther(first: float, second: float, long: float, bow: float, worst: float) -> bool:
    """Return whether a way may be farther than the worst, all squared but for ``long``.

    ``long`` is the length of a straight line that is near one chord at its start and another at
    its end, else 0.
    """
    off = max(first, second)
    if long > 0.0:
        off = max(off, (0.5 * (np.sqrt(first) + np.sqrt(second) + long)) ** 2)
    worst = max(worst, _NOTHING_M2)
    return bool(bow > 0.0 and (off + bow + 2.0 * np.sqrt(off * bow)) * _MORE > worst)


may_be_farther = njit(nogil=True)(_may_be_farther)


def _any_across(
    points: FloatArray,
    before: FloatArray,
    out: FloatArray,
    back: FloatArray,
    start: FloatArray,
    end: FloatArray,
    each: tuple[int, ...],
    first: FloatArray,
    second: FloatArray,
    most: FloatArray,
    worst: FloatArray,
) -> bool:
    """Return whether a way of any run may be farther than its worst, by ``across``.

    All are (axes, runs) or (runs,), of one sample whose runs are all near the same chord; ``each``
    has an entry for each axis, so that the loop over the runs becomes vector instructions.
    """
    length = 0.0
    for a in range(len(each)):
        length += (end[a] - start[a]) * (end[a] - start[a])
    length = length if length > 0.0 else 1.0
    larger = 0
    for r in range(points.shape[1]):
        low, high, of_out, of_back = 0.0, 0.0, 0.0, 0.0
        for a in range(len(each)):
            way, step = end[a] - start[a], points[a, r] - before[a, r]
            low += (before[a, r] - start[a]) * way
            high += (points[a, r] - start[a]) * way
            of_out += (out[a, r] - step) * way
            of_back += (back[a, r] - step) * way
        lead, trail = 0.0, 0.0
        for a in range(len(each)):
            way, step = (end[a] - start[a]) / length, points[a, r] - before[a, r]
            lead += (out[a, r] - step - of_out * way) * (out[a, r] - step - of_out * way)
            trail += (back[a, r] - step - of_back * way) * (back[a, r] - step - of_back * way)
        reach = np.sqrt(most[r] * length)
        lead = (lead if lead > trail else trail) * (_MORE / 16.0)
        inside = ((low if low < high else high) >= reach) & (
            (high if high > low else low) <= length - reach
        )
        bow = lead if inside else most[r]
        off = first[r] if first[r] > second[r] else second[r]
        least = worst[r] if worst[r] > _NOTHING_M2 else _NOTHING_M2
        larger += (off + bow + 2.0 * np.sqrt(off * bow)) * _MORE > least
    return larger > 0


_any_across_fast = njit(nogil=True)(_any_across)


def _raise_to_bows(
    points: FloatArray,
    before: FloatArray,
    off: FloatArray,
    chord: IntArray,
    chord_before: IntArray,
    only: IntArray,
    begin: IntArray,
    end: IntArray,
    vertices: FloatArray,
    each: tuple[int, ...],
    share: FloatArray,
    bows: Bows,
    worst: FloatArray,
    at: IntArray,
    part: FloatArray,
    worst_chord: IntArray,
    number: int,
) -> None:
    """Raise ``worst``, (runs,) squared, where a way to a point is farther than all before.

    ``off``, (n + 1, runs), are squared distances of the samples, of the one before first. The
    others are as in ``nearest.between``.
    """
    _, pace, most = bows
    samples, axes, runs = points.shape
    here, there, of = np.empty(axes), np.empty(axes), np.ones(axes)
    out, back = np.empty(axes), np.empty(axes)
    for i in range(samples):
        alike = only[i] >= 0 and only[i] == only[i + 1]
        if alike:
            larger = 0
            for r in range(runs):
                worse = off[i, r] if off[i, r] > off[i + 1, r] else off[i + 1, r]
                bow = most[i, 0, r]
                larger += (worse + bow + 2.0 * np.sqrt(worse * bow)) * _MORE > worst[r]
            if not larger or not (len(share) or _any_across_fast(
                points[i], before if i == 0 else points[i - 1], pace[i], pace[i + 1],
                vertices[only[i] - 1], vertices[only[i]], each, off[i], off[i + 1], most[i, 0],
                worst,
            )):  # fmt: skip
                continue
        for r in range(runs):
            left_from = only[i]
            if left_from < 0:
                left_from = chord_before[r] if i == 0 else chord[i - 1, r]
            led_to = only[i + 1] if only[i + 1] >= 0 else chord[i, r]
            long = 0.0
            for a in range(axes):
                here[a] = before[a, r] if i == 0 else points[i - 1, a, r]
                there[a] = points[i, a, r]
                if len(share):
                    of[a] = share[i, a, r]
                long += (of[a] * (there[a] - here[a])) ** 2
            long = 0.0 if left_from == led_to else np.sqrt(long)
            bow = most[i, 0, r]
            if not may_be_farther(off[i, r], off[i + 1, r], long, bow, worst[r]):
                continue
            for a in range(axes):
                out[a], back[a] = pace[i, a, r], pace[i + 1, a, r]
            if long == 0.0:
                c = led_to
                bow = across(here, there, out, back, vertices[c - 1], vertices[c], of, bow)
            if may_be_farther(off[i, r], off[i + 1, r], long, bow, worst[r]):
                low, high = min(begin[i], begin[i + 1]), max(end[i], end[i + 1])
                look_along(
                    here, there, out, back, low, high, vertices, of,
                    worst, at, part, worst_chord, r, number + i,
                )  # fmt: skip


raise_to_bows = njit(nogil=True)(_raise_to_bows)


def bows(setting: Setting) -> bool:
    """Return whether a recording says how the way bows between samples.

    It has the velocities of all loads, at the instants of their places, at each tick of the
    commands: between ticks no controller acts.
    """
    tick_s = float(setting.plan.commands.clock.period_s)
    if setting.interval_s > tick_s * (1.0 + 1e-9):
        return False
    places = setting.recording.find(ChannelKind.LOAD, setting.axes[0])
    found = [setting.recording.find(ChannelKind.VELOCITY, axis) for axis in setting.axes]
    return places is not None and all(
        one is not None and one.clock == places.clock and one.stride == places.stride
        for one in found
    )


class Between(NamedTuple):
    """Arrays that a sweep over a block reads for the ways to its samples.

    ``speed``, (n, axes, runs), are velocities, empty if unknown; ``reach``, (axes,), makes ways of
    them at the tool in a sample interval. ``before`` and ``pace``, (axes, runs), are place and such
    a way at the sample before, after the previous sweep; ``begun`` is 0 where there is none.
    """

    speed: FloatArray
    reach: FloatArray
    before: FloatArray
    pace: FloatArray
    begun: IntArray


NO_BETWEEN = Between(
    np.empty((0, 0, 0)), np.empty(0), np.empty((0, 0)), np.empty((0, 0)), np.zeros(1, np.int64)
)


class MotionBetween:
    """Makes ``Between`` of each block of a recording that has velocities at its samples."""

    def __init__(self, setting: Setting) -> None:
        shape = len(setting.axes), setting.runs
        self.known, self.lost = bows(setting), False
        self._reach = setting.interval_s * setting.radius_m
        self._before, self._pace = np.zeros(shape), np.zeros(shape)
        self._begun = np.zeros(1, dtype=np.int64)

    def part(self, block: Block) -> Between:
        """Return the arrays of a block; ``NO_BETWEEN`` where velocities are unknown."""
        if not self.known or block.velocity is None:
            return NO_BETWEEN
        speed = lanes(block.velocity)
        self.lost = self.lost or not np.isfinite(speed[-1]).all()  # none after the last one
        return Between(speed, self._reach, self._before, self._pace, self._begun)


def _turns(step: float, out: float, back: float) -> bool:
    """Return whether a way of one axis may turn back between its ends.

    Otherwise the cubic with the slopes ``out`` and ``back`` is monotone (Fritsch and Carlson,
    "Monotone piecewise cubic interpolation", SIAM J. Numer. Anal. 17, 1980).
    """
    most = 3.0 * abs(step)
    # A way that only rounding sets in motion turns by less than any limit sees.
    on = (out * step >= 0.0) & (back * step >= 0.0) & (abs(out) <= most) & (abs(back) <= most)
    return not on


turns = njit(nogil=True)(_turns)


def _turning_places(step: float, out: float, back: float) -> tuple[float, float]:
    """Return where (0..1) the way of one axis turns, in order; NaN where it does not.

    Source: the roots of the derivative of the cubic,
    ``3 (out + back - 2 step) s^2 + 2 (3 step - 2 out - back) s + out``.
    """
    a, b, c = 3.0 * (out + back - 2.0 * step), 2.0 * (3.0 * step - 2.0 * out - back), out
    under = b * b - 4.0 * a * c
    first, second = np.nan, np.nan
    if under >= 0.0:
        q = -0.5 * (b + (np.sqrt(under) if b >= 0.0 else -np.sqrt(under)))
        if q != 0.0 and 0.0 < c / q < 1.0:
            first = c / q
        if a != 0.0 and 0.0 < q / a < 1.0:
            second = q / a
    if not first <= second:  # either may be no number
        first, second = second, first
    return first, second


turning_places = njit(nogil=True)(_turning_places)


def _charge(points: FloatArray, low: int, between: Between, charge: FloatArray) -> None:
    """Raise ``charge``, (runs,), to a bound of how far a way leaves the line between its samples.

    ``points``, (n, axes, runs), are samples, the first of them ``low`` of the block. A path that
    moves on along its line, at any speed, leaves it only across; a path that turns back also
    leaves it by its distance beyond an end.
    """
    speed, reach, before, pace, begun = between
    samples, axes, runs = points.shape
    out, back = np.empty(axes), np.empty(axes)
    for i in range(samples):
        if i == 0 and begun[0] == 0:
            continue
        for r in range(runs):
            length, of_out, of_back, first, last = 0.0, 0.0, 0.0, 0.0, 0.0
            for a in range(axes):
                start = before[a, r] if i == 0 else points[i - 1, a, r]
                step = points[i, a, r] - start
                out[a] = (pace[a, r] if i == 0 else reach[a] * speed[low + i - 1, a, r]) - step
                back[a] = reach[a] * speed[low + i, a, r] - step
                length += step * step
                of_out += out[a] * step
                of_back += back[a] * step
                first += out[a] * out[a]
                last += back[a] * back[a]
            bow = max(first, last)
            if not bow > 16.0 * charge[r] * charge[r]:
                continue
            if length > 0.0:
                bow = max(first - of_out * of_out / length, last - of_back * of_back / length)
                bow = max(bow, 0.0)
                # With slopes between 0 and three times the line the way moves on along it.
                if min(of_out, of_back) < -length or max(of_out, of_back) > 2.0 * length:
                    long = np.sqrt(length)
                    leave, come, over = of_out / long + long, of_back / long + long, 0.0
                    for s in turning_places(long, leave, come):
                        if s > 0.0:  # or no number
                            place = s * long + beside(s, long, leave, come)
                            over = max(over, -place, place - long)
                    bow += 16.0 * over * over
            if bow > 16.0 * charge[r] * charge[r]:
                charge[r] = 0.25 * np.sqrt(bow)
    for a in range(axes):
        for r in range(runs):
            before[a, r] = points[samples - 1, a, r]
            pace[a, r] = reach[a] * speed[low + samples - 1, a, r]
    begun[0] = 1


charge_ways = njit(nogil=True)(_charge)
