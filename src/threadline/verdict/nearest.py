"""Distances between the actual path and the programmed one, within a window of operations."""

from __future__ import annotations

import numpy as np
from numba import njit

from threadline.arrays import FloatArray, IntArray

_FINEST = 1.0 / 4096  # of the way between two points: finer parts of it are not looked at
_MOST_PARTS = 32  # of a way that wait: one more for each halving, down to the finest


def _squared_to_segment(
    point: FloatArray, start: FloatArray, end: FloatArray
) -> tuple[float, float]:
    """Return the squared distance of a point to a segment, and where on it (0..1)."""
    along = 0.0
    length = 0.0
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


squared_to_segment = njit(cache=True, inline="always")(_squared_to_segment)


def _nearest(point: FloatArray, low: int, high: int, vertices: FloatArray) -> tuple[float, int]:
    """Return the squared distance of a point to the nearest of some chords, and which it is."""
    best, best_chord = np.inf, -1
    for chord in range(low, high + 1):
        squared, _ = squared_to_segment(point, vertices[chord - 1], vertices[chord])
        if squared < best:
            best, best_chord = squared, chord
    return best, best_chord


_nearest_fast = njit(cache=True)(_nearest)


def _path_to_chords(
    points: FloatArray, begin: IntArray, end: IntArray, vertices: FloatArray
) -> tuple[float, int, float, int]:
    """Return the largest squared distance of the way through the points to its chords, and where.

    Point i is held against the chords ``begin[i]`` to ``end[i]``, and the straight way to it
    against those of both its ends. Where: the index of the point before, the part of the way to
    the next one (0..1), and the nearest chord.
    """
    worst, at, part, worst_chord = -1.0, -1, 0.0, -1
    before = -1
    lows, highs = np.empty(_MOST_PARTS), np.empty(_MOST_PARTS)
    for i in range(len(points)):
        best, chord = _nearest_fast(points[i], begin[i], end[i], vertices)
        if best > worst:
            worst, at, part, worst_chord = best, i, 0.0, chord
        # The distance to one chord is largest at an end of the way; to two it may not be.
        if i and chord != before:
            low, high = min(begin[i - 1], begin[i]), max(end[i - 1], end[i])
            left = 1
            lows[0], highs[0] = 0.0, 1.0
            while left:
                left -= 1
                a, b = lows[left], highs[left]
                start = points[i - 1] + a * (points[i] - points[i - 1])
                stop = points[i - 1] + b * (points[i] - points[i - 1])
                # No place of this part is farther than its ends from any one chord.
                bound = np.inf
                for c in range(low, high + 1):
                    first, _ = squared_to_segment(start, vertices[c - 1], vertices[c])
                    second, _ = squared_to_segment(stop, vertices[c - 1], vertices[c])
                    bound = min(bound, max(first, second))
                if bound <= worst or b - a < _FINEST:
                    continue
                middle = 0.5 * (a + b)
                best, nearest = _nearest_fast(0.5 * (start + stop), low, high, vertices)
                if best > worst:
                    worst, at, part, worst_chord = best, i - 1, middle, nearest
                if left + 2 <= _MOST_PARTS:
                    lows[left], highs[left] = a, middle
                    lows[left + 1], highs[left + 1] = middle, b
                    left += 2
        before = chord
    return worst, at, part, worst_chord


def _vertices_to_path(
    points: FloatArray,
    time_s: FloatArray,
    begin: IntArray,
    end: IntArray,
    vertices: FloatArray,
    best: FloatArray,
    best_time_s: FloatArray,
) -> None:
    """Lower ``best``, the squared distance of each vertex to the path, where a segment is nearer.

    Segment i runs from point i to point i + 1; it counts for the vertices of the chords
    ``begin[i]`` to ``end[i + 1]``.
    """
    for i in range(len(points) - 1):
        for vertex in range(begin[i] - 1, end[i + 1] + 1):
            squared, where = squared_to_segment(vertices[vertex], points[i], points[i + 1])
            if squared < best[vertex]:
                best[vertex] = squared
                best_time_s[vertex] = time_s[i] + where * (time_s[i + 1] - time_s[i])


def _squared_distances(
    points: FloatArray, begin: IntArray, end: IntArray, vertices: FloatArray
) -> FloatArray:
    """Return the (n,) squared distance of each point to the chords ``begin[i]`` to ``end[i]``."""
    found = np.empty(len(points))
    for i in range(len(points)):
        best = np.inf
        for chord in range(begin[i], end[i] + 1):
            squared, _ = squared_to_segment(points[i], vertices[chord - 1], vertices[chord])
            best = min(best, squared)
        found[i] = best
    return found


path_to_chords = njit(cache=True, nogil=True)(_path_to_chords)
vertices_to_path = njit(cache=True, nogil=True)(_vertices_to_path)
squared_distances = njit(cache=True, nogil=True)(_squared_distances)
