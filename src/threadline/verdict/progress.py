"""Which chord of the programmed path the command is on."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit
from threadline.verdict.window import PathWindow

_SAME_M = 1e-6  # two chords nearer to the command than this to each other are the same line there


def _squared(points: FloatArray, i: int, vertices: FloatArray, chord: int) -> float:
    """Return the squared distance of point ``i`` to a chord."""
    along, length, squared = 0.0, 0.0, 0.0
    for k in range(points.shape[1]):
        direction = vertices[chord, k] - vertices[chord - 1, k]
        along += (points[i, k] - vertices[chord - 1, k]) * direction
        length += direction * direction
    where = 0.0 if length <= 0.0 else min(max(along / length, 0.0), 1.0)
    for k in range(points.shape[1]):
        start = vertices[chord - 1, k]
        gap = points[i, k] - start - where * (vertices[chord, k] - start)
        squared += gap * gap
    return squared


def _along(
    points: FloatArray, before: FloatArray, i: int, vertices: FloatArray, chord: int
) -> float:
    """Return the part of the way to point ``i`` that is along a chord; ``before`` is point -1."""
    along, length = 0.0, 0.0
    for k in range(points.shape[1]):
        direction = vertices[chord, k] - vertices[chord - 1, k]
        along += (points[i, k] - (points[i - 1, k] if i else before[k])) * direction
        length += direction * direction
    return along / np.sqrt(length) if length > 0.0 else 0.0


_squared_fast = njit(nogil=True)(_squared)
_along_fast = njit(nogil=True)(_along)


def _refine(
    points: FloatArray,
    before: FloatArray,
    vertices: FloatArray,
    first: IntArray,
    last: IntArray,
    same_m: float,
) -> None:
    """Widen the chords ``first`` to ``last`` of each point by a neighbour that it is really on.

    Rows are indexed through: to take one out of an array would count references.
    """
    end = len(vertices) - 1
    for i in range(len(points)):
        low, high = first[i], last[i]
        own, chord = np.inf, low
        for c in range(low, high + 1):
            squared = _squared_fast(points, i, vertices, c)
            if squared < own:
                own, chord = squared, c
        own = np.sqrt(own)
        ahead = _along_fast(points, before, i, vertices, chord)
        for side in range(2):
            other = low - 1 if side == 0 else high + 1
            if other < 1 or other > end:
                continue
            nearer = own - np.sqrt(_squared_fast(points, i, vertices, other))
            if nearer > same_m or (
                nearer >= -same_m and _along_fast(points, before, i, vertices, other) > ahead
            ):
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
