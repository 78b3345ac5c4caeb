"""Distances between the actual path and the programmed one, within a window of operations."""

from __future__ import annotations

import numpy as np
from numba import njit

from threadline.arrays import FloatArray, IntArray


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


def _path_to_chords(
    points: FloatArray, begin: IntArray, end: IntArray, vertices: FloatArray
) -> tuple[float, int, int]:
    """Return the largest squared distance of any point to its chords, its index and the chord."""
    worst, worst_point, worst_chord = -1.0, -1, -1
    for i in range(len(points)):
        best, best_chord = np.inf, -1
        for chord in range(begin[i], end[i] + 1):
            squared, _ = squared_to_segment(points[i], vertices[chord - 1], vertices[chord])
            if squared < best:
                best, best_chord = squared, chord
        if best > worst:
            worst, worst_point, worst_chord = best, i, best_chord
    return worst, worst_point, worst_chord


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


path_to_chords = njit(cache=True, nogil=True)(_path_to_chords)
vertices_to_path = njit(cache=True, nogil=True)(_vertices_to_path)
