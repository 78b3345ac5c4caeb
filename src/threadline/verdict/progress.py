"""Which chord of the programmed path the command is on."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit
from threadline.verdict.nearest import squared_to_segment
from threadline.verdict.window import PathWindow

_SAME_M = 1e-6  # two chords nearer to the command than this to each other are the same line there


def _along(heading: FloatArray, start: FloatArray, end: FloatArray) -> float:
    """Return the part of ``heading`` along a chord."""
    along = 0.0
    length = 0.0
    for k in range(len(heading)):
        along += heading[k] * (end[k] - start[k])
        length += (end[k] - start[k]) ** 2
    return along / np.sqrt(length) if length > 0.0 else 0.0


_along_fast = njit(nogil=True)(_along)


def _copy_row(rows: FloatArray, i: int, to: FloatArray) -> None:
    """Copy row ``i``; to take a row out of an array would count references."""
    for k in range(len(to)):
        to[k] = rows[i, k]


_copy_row_fast = njit(nogil=True)(_copy_row)


def _refine(
    points: FloatArray,
    before: FloatArray,
    vertices: FloatArray,
    first: IntArray,
    last: IntArray,
    same_m: float,
) -> None:
    """Widen the chords ``first`` to ``last`` of each point by a neighbour that it is really on."""
    end = len(vertices) - 1
    axes = points.shape[1]
    heading, point = np.zeros(axes), np.empty(axes)
    start, stop = np.empty(axes), np.empty(axes)
    for i in range(len(points)):
        _copy_row_fast(points, i, point)
        for k in range(axes):  # an assignment of the whole row takes seconds to compile
            heading[k] = point[k] - (points[i - 1, k] if i else before[k])
        own = np.inf
        chord = first[i]
        for c in range(first[i], last[i] + 1):
            _copy_row_fast(vertices, c - 1, start)
            _copy_row_fast(vertices, c, stop)
            squared, _ = squared_to_segment(point, start, stop)
            if squared < own:
                own, chord = squared, c
        own = np.sqrt(own)
        _copy_row_fast(vertices, chord - 1, start)
        _copy_row_fast(vertices, chord, stop)
        ahead = _along_fast(heading, start, stop)
        low, high = first[i], last[i]
        for side in range(2):
            other = low - 1 if side == 0 else high + 1
            if other < 1 or other > end:
                continue
            _copy_row_fast(vertices, other - 1, start)
            _copy_row_fast(vertices, other, stop)
            squared, _ = squared_to_segment(point, start, stop)
            nearer = own - np.sqrt(squared)
            if nearer > same_m or (nearer >= -same_m and _along_fast(heading, start, stop) > ahead):
                if side == 0:
                    first[i] = other
                else:
                    last[i] = other


_refine_fast = njit(nogil=True)(_refine)


def chords_under_way(
    path: PathWindow,
    own: tuple[IntArray, IntArray],
    commanded: FloatArray | None,
    before: FloatArray | None,
) -> tuple[IntArray, IntArray]:
    """Return (n,) first and last chord that each command is on, counted from the path's start.

    The chords of its operation, and the one before or after them where the command is nearer to
    that one, or as near and moving along it: a blend round a corner is labelled with one
    operation although it follows two.

    Parameters
    ----------
    path
        Holds the operations and their neighbours.
    own
        (n,) first and last chord of the operation under way, see ``PathWindow.chords``.
    commanded
        (n, axes) lengths at the tool, or None where the command was not recorded.
    before
        (axes,) the command before these, None at the start.
    """
    first, last = own[0].copy(), np.maximum(*own)
    if commanded is not None and np.isfinite(commanded).all():
        points = np.ascontiguousarray(commanded)
        before = points[0] if before is None else before
        _refine_fast(points, before, path.vertices, first, last, _SAME_M)
    return first + path.first, last + path.first
