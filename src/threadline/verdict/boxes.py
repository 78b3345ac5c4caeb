"""Bounds for many runs at once, from the box that encloses them at an instant.

Runs of one machine are close together across the path. The corners of their box usually decide
which chord is nearest to all of them, and which vertex they approach. Where the box cannot decide,
each run is computed; the results are equal bit for bit.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.verdict.bow import Bows, beside
from threadline.verdict.nearest import nearest_of_all

COMPANY = 8
"""Number of runs above which a box saves more than it costs."""
MORE = 1.0 + 1e-9  # factor on a bound, for rounding in the value that it is compared with


class Boxes(NamedTuple):
    """(n + 1, axes) lower corner ``least`` and upper corner ``most`` of all runs.

    Row 0 belongs to the previous sample. ``known`` is False for few runs, which have no boxes.
    ``lows`` and ``highs``, (runs,), are work arrays.
    """

    known: bool
    least: FloatArray
    most: FloatArray
    lows: FloatArray
    highs: FloatArray


_NO_PACE = np.empty((0, 0))
NO_BOXES = Boxes(False, np.empty((0, 0)), np.empty((0, 0)), np.empty(0), np.empty(0))


def _ends_of(
    values: FloatArray, i: int, k: int, lows: FloatArray, highs: FloatArray
) -> tuple[float, float]:
    """Return the least and the largest of the numbers ``values[i, k]``, at least four of them.

    A plain loop would wait for the previous comparison at each number; folding the row in four,
    repeatedly, gives vector instructions. ``lows`` and ``highs`` are work arrays for a quarter row.
    """
    count = values.shape[2]
    part = count // 4
    for j in range(part):
        a, b = values[i, k, j], values[i, k, part + j]
        c, d = values[i, k, 2 * part + j], values[i, k, 3 * part + j]
        low, high = a if a < b else b, a if a > b else b
        lower, higher = c if c < d else d, c if c > d else d
        lows[j], highs[j] = low if low < lower else lower, high if high > higher else higher
    while part >= 16 and part % 4 == 0:
        part //= 4
        for j in range(part):
            a, b, c, d = lows[j], lows[part + j], lows[2 * part + j], lows[3 * part + j]
            low, lower = a if a < b else b, c if c < d else d
            lows[j] = low if low < lower else lower
            a, b, c, d = highs[j], highs[part + j], highs[2 * part + j], highs[3 * part + j]
            high, higher = a if a > b else b, c if c > d else d
            highs[j] = high if high > higher else higher
    least, most = np.inf, -np.inf
    for j in range(part):
        least = lows[j] if lows[j] < least else least
        most = highs[j] if highs[j] > most else most
    for r in range(count // 4 * 4, count):
        least = values[i, k, r] if values[i, k, r] < least else least
        most = values[i, k, r] if values[i, k, r] > most else most
    return least, most


ends_of = njit(nogil=True)(_ends_of)


def _enclose(points: FloatArray, boxes: Boxes) -> None:
    """Fill in the boxes of (n + 1, axes, runs) samples; row 0 is the previous sample."""
    _, lower, upper, lows, highs = boxes  # each tuple access would count references
    for i in range(len(points)):
        for a in range(points.shape[1]):
            lower[i, a], upper[i, a] = ends_of(points, i, a, lows, highs)


enclose = njit(nogil=True)(_enclose)


def _to_one_chord(
    points: FloatArray,
    i: int,
    c: int,
    vertices: FloatArray,
    way: FloatArray,
    length: FloatArray,
    axes: tuple[int, ...],
    squared: FloatArray,
) -> None:
    """Fill in the squared distance of each run to chord c at sample i."""
    for r in range(squared.shape[1]):
        along = 0.0
        for a in range(len(axes)):
            along += (points[i, a, r] - vertices[c - 1, a]) * way[c, a]
        where = along / length[c]
        where = where if where > 0.0 else 0.0
        where = where if where < 1.0 else 1.0
        away = 0.0
        for a in range(len(axes)):
            gap = points[i, a, r] - vertices[c - 1, a] - where * way[c, a]
            away += gap * gap
        squared[i, r] = away


_to_one_chord_fast = njit(nogil=True)(_to_one_chord)


def _nearest_chords(
    points: FloatArray,
    begin: IntArray,
    end: IntArray,
    vertices: FloatArray,
    way: FloatArray,
    length: FloatArray,
    axes: tuple[int, ...],
    squared: FloatArray,
    chord: IntArray,
    only: IntArray,
) -> None:
    """Fill in the squared distance of each sample to the chords ``begin[i]`` to ``end[i]``.

    ``only`` is the nearest chord of all runs, or -1 if ``chord`` has one for each run.
    """
    for i in range(len(points)):
        first, last = begin[i], end[i]
        if last == first:
            only[i] = first
            _to_one_chord_fast(points, i, first, vertices, way, length, axes, squared)
        else:
            only[i] = -1
            nearest_of_all(
                points[i], first, last, vertices, way, length, axes, None, squared[i], chord[i]
            )


nearest_in_boxes = njit(nogil=True)(_nearest_chords)


def _approach(
    point: FloatArray,
    start: FloatArray,
    from_s: float,
    long_s: float,
    vertex: FloatArray,
    axes: tuple[int, ...],
    share: FloatArray | None,
    out: FloatArray,
    back: FloatArray,
    best: FloatArray,
    best_time_s: FloatArray,
) -> None:
    """Lower ``best``, (runs,) squared, where the segment ``start`` to ``point`` is nearer.

    With the ways ``out`` and ``back`` of its ends, (axes, runs), it is the place beside the
    segment's nearest one that counts, or its end.
    """
    bowed = len(out) > 0
    for r in range(len(best)):
        along = 0.0
        size = 0.0
        for a in range(len(axes)):
            step = point[a, r] - start[a, r]
            if share is None:
                along += (vertex[a] - start[a, r]) * step
                size += step * step
            else:
                weighed = share[a] * step
                along += share[a] * (vertex[a] - start[a, r]) * weighed
                size += weighed * weighed
        size = size if size > 0.0 else 1.0
        where = along / size
        where = where if where > 0.0 else 0.0
        where = where if where < 1.0 else 1.0
        away = 0.0
        for a in range(len(axes)):
            gap = vertex[a] - start[a, r] - where * (point[a, r] - start[a, r])
            if bowed:
                gap -= beside(where, point[a, r] - start[a, r], out[a, r], back[a, r])
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
            away = last if last < away else away
        nearer = away < best[r]
        best[r] = away if nearer else best[r]
        best_time_s[r] = from_s + where * long_s if nearer else best_time_s[r]


_approach_fast = njit(nogil=True)(_approach)


def _vertices_to_path(
    points: FloatArray,
    before: FloatArray,
    time_s: FloatArray,
    begin: IntArray,
    end: IntArray,
    vertices: FloatArray,
    axes: tuple[int, ...],
    share: FloatArray,
    boxes: Boxes,
    bows: Bows,
    worst: FloatArray,
    best: FloatArray,
    best_time_s: FloatArray,
) -> None:
    """Lower ``best``, (vertices, runs) squared, where a segment of a run's path is nearer.

    Segment i leads to point i, the first one from ``before``; it counts for the vertices of the
    chords ``begin[i]`` to ``end[i + 1]``. ``begin``, ``end`` and ``time_s`` have one more entry
    than the points, for the point before. ``share``, (vertices, axes), weighs the axes; empty
    means equal weights.

    A vertex is skipped if every run already passes it as closely as ``worst``, (runs,) squared, or
    if another segment comes nearer to it in every run.
    """
    samples = len(points)
    low, high = vertices.shape[0], -1
    for i in range(samples):
        low, high = min(low, begin[i] - 1), max(high, end[i + 1])
    known, lower, upper, lows, highs = boxes
    bowed, pace, most = bows
    weighed = len(share) > 0
    boxed = known and not weighed
    near, bow = np.zeros(samples), np.zeros(samples)
    if bowed and boxed:
        for i in range(samples):
            bow[i] = np.sqrt(ends_of(most, i, 0, lows, highs)[1]) * MORE
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
            start = before if i == 0 else points[i - 1]
            from_s, long_s = time_s[i], time_s[i + 1] - time_s[i]
            out, back = (pace[i], pace[i + 1]) if bowed else (_NO_PACE, _NO_PACE)
            if weighed:
                _approach_fast(
                    points[i], start, from_s, long_s, vertices[v], axes, share[v], out, back,
                    best[v], best_time_s[v],
                )  # fmt: skip
            else:
                _approach_fast(
                    points[i], start, from_s, long_s, vertices[v], axes, None, out, back,
                    best[v], best_time_s[v],
                )  # fmt: skip


vertices_to_path = njit(nogil=True)(_vertices_to_path)
