"""Short timed moves joined into straight chords, each with the highest speed of its moves.

A plan of an hour has millions of moves, so the loops over moves are compiled.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.commands.planned_job import CHORD_TOLERANCE_M

CLOSE_M = 1e-7
"""Largest error of an end point rounded to 0.0001 mm or degrees, with a margin."""
_RISE = 1e-3  # share of a speed
_STRAIGHT = 1e-6  # one minus the cosine of a turn that is none


class Part(NamedTuple):
    """The moves from ``first`` up to ``stop``, not included, as one chord at ``speed`` at most."""

    first: int
    stop: int
    speed: float


def merged(
    points: FloatArray, speeds: FloatArray, within_m: float = CHORD_TOLERANCE_M
) -> list[Part]:
    """Return the chords of moves along (n + 1, axes) ``points`` of the tool at (n,) ``speeds``.

    No point is farther than ``within_m`` from its chord.
    """
    points = np.ascontiguousarray(points, dtype=float)
    first, stop, fastest = _chords(points, np.ascontiguousarray(speeds, dtype=float), within_m)
    return [Part(*one) for one in zip(first.tolist(), stop.tolist(), fastest.tolist(), strict=True)]


@njit(nogil=True)
def _chords(
    points: FloatArray, speeds: FloatArray, within_m: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return the first move of each chord, the move behind its last one, and its speed."""
    moves = len(speeds)
    starts, stops = np.empty(moves, np.int64), np.empty(moves, np.int64)
    fastest = np.empty(moves)
    first, count = 0, 0
    for last in _humps(speeds, points):
        while first < last:
            stop = first + _longest(points, first, last, within_m)
            starts[count], stops[count] = first, stop
            fastest[count] = speeds[first:stop].max()
            count += 1
            first = stop
    kept = _without_slivers(starts, stops, fastest, count, points, within_m)
    return starts[:kept], stops[:kept], fastest[:kept]


@njit(nogil=True)
def _humps(speeds: FloatArray, points: FloatArray) -> IntArray:
    """Return the end of each stretch of (n,) speeds that rises and then falls at most once.

    Changes below ``_RISE`` of the speed do not count, because end points of moves are rounded. A
    stretch ends at the sharpest turn of (n + 1, axes) ``points`` between its slowest moves: the
    moves into and out of a corner are equally slow, and the corner belongs between them.
    """
    ends, count = np.empty(len(speeds) + 1, np.int64), 0
    highest = lowest = speeds[0]
    slowest = 0  # the first of the slowest moves that come one after the other
    for at in range(len(speeds)):
        speed = speeds[at]
        fallen = lowest < highest * (1.0 - _RISE)
        if fallen and speed > lowest * (1.0 + _RISE):
            ends[count] = _sharpest(points, slowest + 1, at)
            count += 1
            highest = lowest = speed
            slowest = at
        elif speed > highest:
            highest = lowest = speed
            slowest = at
        else:
            if speed < lowest * (1.0 - _RISE):
                slowest = at
            lowest = min(lowest, speed)
    ends[count] = len(speeds)
    return ends[: count + 1]


@njit(nogil=True)
def _sharpest(points: FloatArray, first: int, last: int) -> int:
    """Return the sharpest turn of the points from ``first`` to ``last``; the last of equal ones."""
    found, most = last, -1.0
    for k in range(first, last + 1):
        along = before = after = 0.0
        for a in range(points.shape[1]):
            into, out = points[k, a] - points[k - 1, a], points[k + 1, a] - points[k, a]
            along += into * out
            before += into * into
            after += out * out
        lengths = np.sqrt(before) * np.sqrt(after)
        turn = 1.0 - along / lengths if lengths > 0.0 else 0.0
        turn = turn if turn > _STRAIGHT else 0.0
        if turn >= most:
            found, most = k, turn
    return found


@njit(nogil=True)
def _without_slivers(
    first: IntArray, stop: IntArray, speed: FloatArray, count: int, points: FloatArray,
    within_m: float,
) -> int:  # fmt: skip
    """Join each chord shorter than the tolerance to its neighbour; return how many are left.

    Where a planned speed falls and rises again in the middle of a move, the rest of the move would
    become a block of its own. The joined chord takes the speed of the longer one: a speed over less
    than the tolerance of a chord has no effect.
    """
    kept = 0
    for k in range(count):
        if kept:
            before = kept - 1
            sliver = _short(points, first[before], stop[before], within_m)
            joins = sliver or _short(points, first[k], stop[k], within_m)
            if joins and _within(points, first[before], stop[k], within_m, within_m):
                stop[before] = stop[k]
                if sliver:
                    speed[before] = speed[k]
                continue
        first[kept], stop[kept], speed[kept] = first[k], stop[k], speed[k]
        kept += 1
    return kept


@njit(nogil=True)
def _short(points: FloatArray, first: int, stop: int, within_m: float) -> bool:
    """Return whether no point is as far as the tolerance from the first one."""
    for k in range(first, stop + 1):
        squared = 0.0
        for a in range(points.shape[1]):
            squared += (points[k, a] - points[first, a]) ** 2
        if squared >= within_m**2:
            return False
    return True


@njit(nogil=True)
def _longest(points: FloatArray, first: int, last: int, within_m: float) -> int:
    """Return how many moves from ``first`` on, up to ``last``, fit one chord, at least 1."""
    most = last - first
    good = 1
    while good < most and _within(points, first, first + min(2 * good, most), within_m, CLOSE_M):
        good = min(2 * good, most)
    bad = min(2 * good, most + 1)
    while bad - good > 1:
        middle = (good + bad) // 2
        if middle <= most and _within(points, first, first + middle, within_m, CLOSE_M):
            good = middle
        else:
            bad = middle
    return good


@njit(nogil=True)
def _within(points: FloatArray, first: int, last: int, most_m: float, back_m: float) -> bool:
    """Say whether points lie within ``most_m`` of the line from ``first`` to ``last``, in order.

    No step goes back along the line by more than ``back_m``, and no point lies more than ``back_m``
    beyond the ends of the line.
    """
    axes = points.shape[1]
    length = 0.0
    for a in range(axes):
        length += (points[last, a] - points[first, a]) ** 2
    length = np.sqrt(length)
    if length == 0.0:
        return False
    way = (points[last] - points[first]) / length
    before = 0.0
    for k in range(first, last + 1):
        along = away = 0.0
        for a in range(axes):
            along += (points[k, a] - points[first, a]) * way[a]
        if along - before < -back_m or along < -back_m or along > length + back_m:
            return False
        for a in range(axes):
            away += (points[k, a] - points[first, a] - along * way[a]) ** 2
        if not np.sqrt(away) <= most_m:
            return False
        before = along
    return True
