"""Distances between the actual paths of many runs and the programmed one, within a window.

Runs are adjacent in memory, (samples, axes, runs): the geometry of a chord is computed once, and
the innermost loop, over the runs, becomes vector instructions. Each run gets the same operations as
when it is alone, so that its result does not depend on the other runs, bit for bit.
"""

from __future__ import annotations

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit

_FINEST = 1.0 / 4096  # of a segment: it is not subdivided further
_NOTHING_M2 = 1e-26  # a place this close to the path is on it, up to rounding
_MOST_PARTS = 32  # parts of a segment that wait: one for each halving, down to the finest


def _weighed_to_segment(
    point: FloatArray, start: FloatArray, end: FloatArray, share: FloatArray
) -> float:
    """Return the squared distance of a point to a segment, each axis weighed with its share."""
    along = 0.0
    length = 0.0
    for k in range(len(point)):
        direction = share[k] * (end[k] - start[k])
        along += share[k] * (point[k] - start[k]) * direction
        length += direction * direction
    where = 0.0 if length <= 0.0 else min(max(along / length, 0.0), 1.0)
    squared = 0.0
    for k in range(len(point)):
        gap = share[k] * (point[k] - start[k] - where * (end[k] - start[k]))
        squared += gap * gap
    return squared


weighed_to_segment = njit(nogil=True)(_weighed_to_segment)


def chord_vectors(vertices: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (m, axes) direction vector of each chord, and (m,) its squared length.

    Chord c ends at vertex c; row 0 is unused. A chord whose squared length has lost digits, or has
    an infinite inverse, counts as a point, with length 1.
    """
    way = np.diff(vertices, axis=0, prepend=vertices[:1])
    squared = lengths_squared(way)
    return way, np.where(squared > np.finfo(np.float64).tiny, squared, 1.0)


def lengths_squared(ways: FloatArray) -> FloatArray:
    """Return (m,) squared lengths of (m, axes) vectors, faster than numpy's sum over axes."""
    squared = ways[:, 0] ** 2
    for axis in range(1, ways.shape[1]):
        squared += ways[:, axis] ** 2
    return squared


def _nearest_of_all(
    point: FloatArray,
    begin: int,
    end: int,
    vertices: FloatArray,
    way: FloatArray,
    length: FloatArray,
    axes: tuple[int, ...],
    share: FloatArray | None,
    squared: FloatArray,
    chord: IntArray,
) -> None:
    """Fill in the squared distance of a point of each run to the chords ``begin`` to ``end``.

    ``chord`` is the first of the nearest. ``axes`` is a tuple with one entry per axis: its length
    is known at compile time, so that loops over axes are unrolled and tests of ``share`` vanish.
    """
    runs = len(squared)
    for r in range(runs):
        squared[r] = np.inf
        chord[r] = begin
    for c in range(begin, end + 1):
        for r in range(runs):
            along = 0.0
            size = length[c]
            if share is None:
                for a in range(len(axes)):
                    along += (point[a, r] - vertices[c - 1, a]) * way[c, a]
            else:
                size = 0.0
                for a in range(len(axes)):
                    weighed = share[a, r] * way[c, a]
                    along += share[a, r] * (point[a, r] - vertices[c - 1, a]) * weighed
                    size += weighed * weighed
                size = size if size > 0.0 else 1.0
            where = along / size
            where = where if where > 0.0 else 0.0
            where = where if where < 1.0 else 1.0
            away = 0.0
            for a in range(len(axes)):
                gap = point[a, r] - vertices[c - 1, a] - where * way[c, a]
                if share is not None:
                    gap *= share[a, r]
                away += gap * gap
            nearer = away < squared[r]
            squared[r] = away if nearer else squared[r]
            chord[r] = c if nearer else chord[r]


nearest_of_all = njit(nogil=True)(_nearest_of_all)


def _nearest_chords(
    points: FloatArray,
    begin: IntArray,
    end: IntArray,
    vertices: FloatArray,
    way: FloatArray,
    length: FloatArray,
    axes: tuple[int, ...],
    share: FloatArray,
    squared: FloatArray,
    chord: IntArray,
) -> None:
    """Do the same for each of (n, axes, runs) points and the chords ``begin[i]`` to ``end[i]``.

    ``share`` has the shape of the points; empty means equal weights of the axes.
    """
    for i in range(len(points)):
        if len(share):
            nearest_of_all(
                points[i], begin[i], end[i], vertices, way, length, axes, share[i],
                squared[i], chord[i],
            )  # fmt: skip
        else:
            nearest_of_all(
                points[i], begin[i], end[i], vertices, way, length, axes, None,
                squared[i], chord[i],
            )  # fmt: skip


def _most_between(
    first: float, second: float, here: FloatArray, there: FloatArray, share: FloatArray
) -> float:
    """Return an upper bound of squared distances on a segment, given the distances of its ends."""
    squared = 0.0
    for k in range(len(here)):
        squared += (share[k] * (there[k] - here[k])) ** 2
    return float((0.5 * (np.sqrt(first) + np.sqrt(second) + np.sqrt(squared))) ** 2)


_most_between_fast = njit(nogil=True)(_most_between)


def _none_farther(
    here: FloatArray,
    there: FloatArray,
    known: int,
    chord: int,
    vertices: FloatArray,
    share: FloatArray,
    least: float,
) -> bool:
    """Return whether certainly no place between two points is farther than ``least``, squared.

    ``known`` is a chord near the first point, ``chord`` one near the second.
    """
    # One chord near both ends is enough: no place of the segment is farther from it than an end.
    second = weighed_to_segment(there, vertices[chord - 1], vertices[chord], share)
    other = weighed_to_segment(here, vertices[chord - 1], vertices[chord], share)
    if max(other, second) <= least:
        return True
    # Nor can a place be farther than half of the segment plus the distances of both ends.
    first = weighed_to_segment(here, vertices[known - 1], vertices[known], share)
    if _most_between_fast(first, second, here, there, share) <= least:
        return True
    if abs(chord - known) != 1:
        return False
    # The vertex between the chords splits the segment: each part is near its own chord.
    joint = weighed_to_segment(vertices[min(known, chord)], here, there, share)
    return max(first, second, joint) <= least


def _alike(first: IntArray, first_only: int, second: IntArray, second_only: int) -> bool:
    """Return whether all chord numbers are equal; ``only`` counts unless it is below 0."""
    if first_only >= 0 and second_only >= 0:
        return first_only == second_only
    others = 0
    for r in range(len(first)):
        one = first_only if first_only >= 0 else first[r]
        others += one != (second_only if second_only >= 0 else second[r])
    return others == 0


_none_farther_fast = njit(nogil=True)(_none_farther)
_alike_fast = njit(nogil=True)(_alike)


def _look_between(
    here: FloatArray,
    there: FloatArray,
    low: int,
    high: int,
    left_from: int,
    led_to: int,
    vertices: FloatArray,
    of: FloatArray,
    worst: FloatArray,
    at: IntArray,
    part: FloatArray,
    worst_chord: IntArray,
    r: int,
    number: int,
) -> None:
    """Raise ``worst[r]``, squared, where a segment between two points is farther than its ends.

    ``left_from`` is a chord near the first point, ``led_to`` one near the second; ``low`` to
    ``high`` are the candidates. For the place of the worst see ``between``.
    """
    least = max(worst[r], _NOTHING_M2)
    if _none_farther_fast(here, there, max(left_from, low), led_to, vertices, of, least):
        return
    axes = len(here)
    lows, highs = np.empty(_MOST_PARTS), np.empty(_MOST_PARTS)
    start, stop = np.empty(axes), np.empty(axes)
    left = 1
    lows[0], highs[0] = 0.0, 1.0
    while left:
        left -= 1
        a, b = lows[left], highs[left]
        for n in range(axes):
            start[n] = here[n] + a * (there[n] - here[n])
            stop[n] = here[n] + b * (there[n] - here[n])
        # No place of this part is farther than its ends from any single chord.
        bound = np.inf
        for c in range(low, high + 1):
            first = weighed_to_segment(start, vertices[c - 1], vertices[c], of)
            second = weighed_to_segment(stop, vertices[c - 1], vertices[c], of)
            bound = min(bound, max(first, second))
        if bound <= max(worst[r], _NOTHING_M2) or b - a < _FINEST:
            continue
        middle = 0.5 * (a + b)
        for n in range(axes):
            start[n] = 0.5 * (start[n] + stop[n])
        best, nearest = np.inf, -1
        for c in range(low, high + 1):
            away = weighed_to_segment(start, vertices[c - 1], vertices[c], of)
            if away < best:
                best, nearest = away, c
        if best > worst[r]:
            worst[r], at[r], part[r], worst_chord[r] = best, number, middle, nearest
        if left + 2 <= _MOST_PARTS:
            lows[left], highs[left] = a, middle
            lows[left + 1], highs[left + 1] = middle, b
            left += 2


look_between = njit(nogil=True)(_look_between)


def _between(
    points: FloatArray,
    before: FloatArray,
    chord: IntArray,
    chord_before: IntArray,
    only: IntArray,
    begin: IntArray,
    end: IntArray,
    vertices: FloatArray,
    share: FloatArray,
    worst: FloatArray,
    at: IntArray,
    part: FloatArray,
    worst_chord: IntArray,
    number: int,
) -> None:
    """Raise ``worst``, (runs,) squared, where a segment to a point is farther than its ends.

    The distance to one chord is largest at an end of the segment; to two it may not be. ``chord``
    are the nearest ones of each run, unless ``only`` gives one for all. ``begin``, ``end`` and
    ``only`` have one entry more than the points, for the point before. The place of the worst is
    ``at``, the point that the segment leads to, counted from ``number``; ``part`` of the segment
    (0..1); and the nearest chord ``worst_chord``. Axes are weighed with the shares of the point
    that the segment leads to; an empty ``share`` means equal weights.
    """
    axes = points.shape[1]
    here, there, of = np.empty(axes), np.empty(axes), np.ones(axes)
    for i in range(len(points)):
        known = chord_before if i == 0 else chord[i - 1]
        if _alike_fast(chord[i], only[i + 1], known, only[i]):
            continue
        low, high = min(begin[i], begin[i + 1]), max(end[i], end[i + 1])
        for r in range(points.shape[2]):
            left_from = only[i] if only[i] >= 0 else known[r]
            led_to = only[i + 1] if only[i + 1] >= 0 else chord[i, r]
            if led_to == left_from:
                continue
            for a in range(axes):
                here[a] = before[a, r] if i == 0 else points[i - 1, a, r]
                there[a] = points[i, a, r]
                if len(share):
                    of[a] = share[i, a, r]
            look_between(
                here, there, low, high, left_from, led_to, vertices, of,
                worst, at, part, worst_chord, r, number + i,
            )  # fmt: skip


def _charge_trailing(
    points: FloatArray,
    begin: IntArray,
    end: IntArray,
    left: FloatArray,
    vertices: FloatArray,
    share: FloatArray,
    squared: FloatArray,
    chord: IntArray,
    only: IntArray,
) -> None:
    """Raise ``squared``, (n, runs), where the nearest place is one that the command left too early.

    ``left`` is the share of chord ``begin[i]`` that the command had left behind by the lag before
    sample i. ``only`` is the nearest chord of all runs, or -1 if ``chord`` has one for each run.
    ``share``, (n, axes, runs), weighs the axes; empty means equal weights.
    """
    axes = points.shape[1]
    point, of, start = np.empty(axes), np.ones(axes), np.empty(axes)
    for i in range(len(points)):
        first = begin[i]
        if left[i] <= 0.0 or only[i] > first:
            continue
        for r in range(points.shape[2]):
            if only[i] < 0 and chord[i, r] != first:
                continue
            along, length = 0.0, 0.0
            for a in range(axes):
                if len(share):
                    of[a] = share[i, a, r]
                way = of[a] * (vertices[first, a] - vertices[first - 1, a])
                along += of[a] * (points[i, a, r] - vertices[first - 1, a]) * way
                length += way * way
            if along >= left[i] * length:
                continue
            for a in range(axes):
                point[a] = points[i, a, r]
                way = vertices[first, a] - vertices[first - 1, a]
                start[a] = vertices[first - 1, a] + left[i] * way
            least = weighed_to_segment(point, start, vertices[first], of)
            for c in range(first + 1, end[i] + 1):
                least = min(least, weighed_to_segment(point, vertices[c - 1], vertices[c], of))
            squared[i, r] = max(least, squared[i, r])


nearest_chords_each = njit(nogil=True)(_nearest_chords)
charge_trailing = njit(nogil=True)(_charge_trailing)
between = njit(nogil=True)(_between)


def nearest_chords(
    points: FloatArray,
    begin: IntArray,
    end: IntArray,
    vertices: FloatArray,
    share: FloatArray | None = None,
) -> tuple[FloatArray, IntArray]:
    """Return (n, runs) squared distances to the chords ``begin[i]`` to ``end[i]``, and the nearest.

    Parameters
    ----------
    points
        (n, axes, runs).
    vertices
        (m, axes).
    share
        (n, axes, runs) weights of the axes at each point; None for equal weights.
    """
    samples, axes, runs = points.shape
    squared = np.empty((samples, runs))
    chord = np.empty((samples, runs), dtype=np.int64)
    way, length = chord_vectors(vertices)
    each, shares = (0,) * axes, points[:0] if share is None else share
    nearest_chords_each(points, begin, end, vertices, way, length, each, shares, squared, chord)
    return squared, chord
