"""Bounds for many runs at once, from the box that encloses them at an instant.

Runs of one machine are close together across the path. The corners of their box usually decide
which chord is nearest to all of them, and which vertex they approach. If the box cannot decide,
each run is computed. The results are equal to the bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.verdict.bow import Bows, Span, deviation
from threadline.verdict.nearest import (
    Candidates,
    Chords,
    Closest,
    Nearest,
    Track,
    nearest_of_all,
)

COMPANY = 8
"""Number of runs from which on a box saves more than it costs."""
MORE = 1.0 + 1e-9  # factor on a bound, for rounding in the value that it is compared with


class Boxes(NamedTuple):
    """(n + 1, axes) lower corner ``least`` and upper corner ``most`` of all runs.

    Row 0 belongs to the sample before. ``known`` is False for few runs, which have no boxes.
    ``lows`` and ``highs``, (runs,), are work arrays.
    """

    known: bool
    least: FloatArray
    most: FloatArray
    lows: FloatArray
    highs: FloatArray


_NO_TANGENT = np.empty((0, 0))
NO_BOXES = Boxes(False, np.empty((0, 0)), np.empty((0, 0)), np.empty(0), np.empty(0))


def _ends_of(
    values: FloatArray, i: int, k: int, lows: FloatArray, highs: FloatArray
) -> tuple[float, float]:
    """Return the least and the largest of the numbers ``values[i, k]``, at least four of them.

    A plain loop would wait for the previous comparison at each number. The row is folded in four,
    repeatedly, which gives vector instructions. ``lows`` and ``highs`` are work arrays for a
    quarter of a row.
    """
    count = values.shape[2]
    part = count // 4
    for j in range(part):
        a, b = values[i, k, j], values[i, k, part + j]
        c, d = values[i, k, 2 * part + j], values[i, k, 3 * part + j]
        low, high = min(b, a), max(b, a)
        lower, higher = min(d, c), max(d, c)
        lows[j], highs[j] = min(lower, low), max(higher, high)
    while part >= 16 and part % 4 == 0:
        part //= 4
        for j in range(part):
            a, b, c, d = lows[j], lows[part + j], lows[2 * part + j], lows[3 * part + j]
            low, lower = min(b, a), min(d, c)
            lows[j] = min(lower, low)
            a, b, c, d = highs[j], highs[part + j], highs[2 * part + j], highs[3 * part + j]
            high, higher = max(b, a), max(d, c)
            highs[j] = max(higher, high)
    least, most = np.inf, -np.inf
    for j in range(part):
        least = min(least, lows[j])
        most = max(most, highs[j])
    for r in range(count // 4 * 4, count):
        least = min(least, values[i, k, r])
        most = max(most, values[i, k, r])
    return least, most


ends_of = njit(nogil=True)(_ends_of)


def _enclose(points: FloatArray, boxes: Boxes) -> None:
    """Fill in the boxes of (n + 1, axes, runs) samples; row 0 is the sample before."""
    _, lower, upper, lows, highs = boxes  # each tuple access would count references
    for i in range(len(points)):
        for a in range(points.shape[1]):
            lower[i, a], upper[i, a] = ends_of(points, i, a, lows, highs)


enclose = njit(nogil=True)(_enclose)


def _to_one_chord(
    points: FloatArray,
    i: int,
    c: int,
    chords: Chords,
    axes: tuple[int, ...],
    squared: FloatArray,
) -> None:
    """Fill in the squared distance of each run to chord c at sample i."""
    vertices, vector, length = chords
    for r in range(squared.shape[1]):
        along = 0.0
        for a in range(len(axes)):
            along += (points[i, a, r] - vertices[c - 1, a]) * vector[c, a]
        where = min(1.0, max(0.0, along / length[c]))
        away = 0.0
        for a in range(len(axes)):
            gap = points[i, a, r] - vertices[c - 1, a] - where * vector[c, a]
            away += gap * gap
        squared[i, r] = away


_to_one_chord_fast = njit(nogil=True)(_to_one_chord)


def _nearest_chords(
    points: FloatArray,
    candidates: Candidates,
    chords: Chords,
    axes: tuple[int, ...],
    nearest: Nearest,
) -> None:
    """Fill in the nearest candidate chord of each of (n, axes, runs) samples."""
    begin, end = candidates
    squared, chord, common = nearest
    for i in range(len(points)):
        first, last = begin[i], end[i]
        if last == first:
            common[i] = first
            _to_one_chord_fast(points, i, first, chords, axes, squared)
        else:
            common[i] = -1
            nearest_of_all(points[i], first, last, chords, axes, None, squared[i], chord[i])


nearest_in_boxes = njit(nogil=True)(_nearest_chords)


def _approach(
    span: Span,
    from_s: float,
    long_s: float,
    vertex: FloatArray,
    axes: tuple[int, ...],
    share: FloatArray | None,
    closest: Closest,
) -> None:
    """Lower the closest approach to a vertex, (runs,), where a span comes nearer in a run.

    The span begins at ``from_s`` and takes ``long_s``. The place nearest on its straight segment
    counts, moved by the deviation there if the tangents are known, or its end.
    """
    start, point, m0, m1 = span
    best, best_time_s = closest
    bowed = len(m0) > 0
    for r in range(len(best)):
        along = 0.0
        size = 0.0
        for a in range(len(axes)):
            step = point[a, r] - start[a, r]
            if share is None:
                along += (vertex[a] - start[a, r]) * step
                size += step * step
            else:
                weighted = share[a] * step
                along += share[a] * (vertex[a] - start[a, r]) * weighted
                size += weighted * weighted
        size = size if size > 0.0 else 1.0
        where = min(1.0, max(0.0, along / size))
        away = 0.0
        for a in range(len(axes)):
            gap = vertex[a] - start[a, r] - where * (point[a, r] - start[a, r])
            if bowed:
                gap -= deviation(where, point[a, r] - start[a, r], m0[a, r], m1[a, r])
            if share is not None:
                gap *= share[a]
            away += gap * gap
        if bowed:
            last = 0.0
            for a in range(len(axes)):
                gap = vertex[a] - point[a, r]
                if share is not None:
                    gap *= share[a]
                last += gap * gap
            where = 1.0 if last < away else where
            away = min(away, last)
        nearer = away < best[r]
        best[r] = away if nearer else best[r]
        best_time_s[r] = from_s + where * long_s if nearer else best_time_s[r]


_approach_fast = njit(nogil=True)(_approach)


def _vertices_to_path(
    track: Track,
    bows: Bows,
    boxes: Boxes,
    vertices: FloatArray,
    axes: tuple[int, ...],
    share: FloatArray | None,
    worst: FloatArray,
    closest: Closest,
) -> None:
    """Lower the closest approaches to (m, axes) vertices, where a span of a run comes nearer.

    Span i leads from row i of the track to row i + 1; it counts for the vertices of the chords
    ``begin[i]`` to ``end[i + 1]``. ``share``, (vertices, axes), weighs the axes; None means equal
    weights.

    A vertex is skipped if every run already passes it as closely as ``worst``, (runs,) squared, or
    if another span comes nearer to it in every run.
    """
    points, time_s, begin, end, _ = track
    best, best_time_s = closest
    samples = len(points) - 1
    low, high = vertices.shape[0], -1
    for i in range(samples):
        low, high = min(low, begin[i] - 1), max(high, end[i + 1])
    known, lower, upper, lows, highs = boxes
    bowed, tangents, most = bows
    boxed = known and share is None
    near, bow = np.zeros(samples), np.zeros(samples)
    if bowed and boxed:
        for i in range(samples):
            for k in range(most.shape[1]):  # one row; for 0 itself ends_of is compiled once more
                bow[i] = np.sqrt(ends_of(most, i, k, lows, highs)[1]) * MORE
    for v in range(low, high + 1):
        limit = np.inf
        if boxed:
            settled, limit = True, -np.inf
            for r in range(len(worst)):
                settled = settled and best[v, r] <= worst[r]
                limit = max(limit, best[v, r])
            if settled:
                continue
            for i in range(samples):
                if begin[i] - 1 <= v <= end[i + 1]:
                    apart, across = 0.0, 0.0
                    for a in range(len(axes)):
                        place, under, over = vertices[v, a], lower[i + 1, a], upper[i + 1, a]
                        gap = max(min(lower[i, a], under) - place, place - max(upper[i, a], over))
                        apart += max(gap, 0.0) ** 2
                        across += max(over - place, place - under) ** 2
                    near[i] = apart
                    if bowed:
                        near[i] = max(np.sqrt(apart) - bow[i], 0.0) ** 2
                    limit = min(limit, across)
            limit *= MORE
        for i in range(samples):
            if not (begin[i] - 1 <= v <= end[i + 1] and near[i] <= limit):
                continue
            from_s, long_s = time_s[i], time_s[i + 1] - time_s[i]
            m0, m1 = (tangents[i], tangents[i + 1]) if bowed else (_NO_TANGENT, _NO_TANGENT)
            span = Span(points[i], points[i + 1], m0, m1)
            own = Closest(best[v], best_time_s[v])
            if share is None:
                _approach_fast(span, from_s, long_s, vertices[v], axes, None, own)
            else:
                _approach_fast(span, from_s, long_s, vertices[v], axes, share[v], own)


vertices_to_path = njit(nogil=True)(_vertices_to_path)
