"""Places of the command that the tools of many runs can have reached, sample by sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.verdict.boxes import MORE, Boxes

_CEILING = 4.0  # times the largest squared error: a worse trailing place is dropped


def _given_up(value: FloatArray, row: int, ceiling: float, dropped: FloatArray) -> bool:
    """Return whether all values of a row exceed the ceiling; if so lower ``dropped`` to them."""
    near = 0
    for r in range(len(dropped)):
        near += value[row, r] <= ceiling
    if near:
        return False
    for r in range(len(dropped)):
        dropped[r] = value[row, r] if value[row, r] < dropped[r] else dropped[r]
    return True


_given_up_fast = njit(nogil=True)(_given_up)


def _ahead(
    point: FloatArray, start: FloatArray, way: FloatArray, per_length: float, heading: FloatArray
) -> float:
    """Return how far a point is from the nearest place of a segment, along a heading."""
    length, along = 0.0, 0.0
    for a in range(len(point)):
        length += (point[a] - start[a]) * way[a]
    where = min(max(length * per_length, 0.0), 1.0)
    for a in range(len(point)):
        along += (point[a] - start[a] - where * way[a]) * heading[a]
    return along


ahead = njit(nogil=True)(_ahead)


def _bounds(
    lower: FloatArray,
    upper: FloatArray,
    i: int,
    command: FloatArray,
    start: int,
    way: FloatArray,
    k: int,
    per_length: float,
) -> tuple[float, float]:
    """Return a lower and an upper bound of the distance of box i to segment k, both squared."""
    middle, half = 0.0, 0.0
    for a in range(way.shape[1]):
        place = 0.5 * (lower[i, a] + upper[i, a])
        middle += (place - command[start, a]) * way[k, a]
        half += (0.5 * (upper[i, a] - lower[i, a])) ** 2
    nearest = min(max(middle * per_length, 0.0), 1.0)
    away = 0.0
    for a in range(way.shape[1]):
        place = 0.5 * (lower[i, a] + upper[i, a])
        away += (place - command[start, a] - nearest * way[k, a]) ** 2
    away, half = np.sqrt(away), np.sqrt(half)
    return max(away - half, 0.0) ** 2 / MORE, MORE * (away + half) ** 2


_bounds_fast = njit(nogil=True)(_bounds)


def _stay_at(
    points: FloatArray,
    off: FloatArray,
    i: int,
    command: FloatArray,
    start: int,
    way: FloatArray,
    k: int,
    per_length: float,
    axes: tuple[int, ...] | FloatArray,
    value: FloatArray,
    row: int,
    carry: FloatArray,
    least: FloatArray,
    worst: FloatArray,
    ceiling: float,
) -> tuple[int, int, int]:
    """Advance ``row`` of ``value``, the row of place k, by sample i, and ``carry``, ``least``.

    Return the number of runs in which the row exceeds ``worst``, in which it is at most
    ``ceiling``, and in which the least of all places so far exceeds ``worst``. ``axes`` is a tuple
    with one entry per axis: its length is known at compile time, and loops over axes are unrolled.
    """
    more, near, farther = 0, 0, 0
    for r in range(len(carry)):
        carried = value[row, r] if value[row, r] < carry[r] else carry[r]
        along = 0.0
        for a in range(len(axes)):
            along += (points[i, a, r] - command[start, a]) * way[k, a]
        where = along * per_length
        where = where if where > 0.0 else 0.0
        where = where if where < 1.0 else 1.0
        away = 0.0
        for a in range(len(axes)):
            gap = points[i, a, r] - command[start, a] - where * way[k, a]
            away += gap * gap
        error = away - off[i, r]
        error = error if error > carried else carried
        carry[r] = carried
        value[row, r] = error
        least[r] = error if error < least[r] else least[r]
        more += error > worst[r]
        near += error <= ceiling
        farther += least[r] > worst[r]
    return more, near, farther


_stay_at_fast = njit(nogil=True)(_stay_at)


class ProgressPart(NamedTuple):
    """Arrays that a sweep over a block reads and updates for the progress error: see ``_advance``.

    Place ``first`` belongs to the first sample of the block, which has the number ``number``.
    ``places`` are the first and the last place with a value; ``ceiling`` has one entry.
    """

    command: FloatArray
    way: FloatArray
    inverse: FloatArray
    heading: FloatArray
    first: int
    number: int
    lag: int
    places: IntArray
    value: FloatArray
    worst: FloatArray
    at: IntArray
    side: FloatArray
    ceiling: FloatArray
    dropped: FloatArray


def _advance(  # noqa: PLR0915 - one loop over the places; each call would be compiled once more
    points: FloatArray, boxes: Boxes, off: FloatArray, beginning: int, part: ProgressPart
) -> None:
    """Advance the places of the command by the samples ``points``, the first of them ``beginning``.

    Place k is the segment of the command from its sample k - 1 to k. The value of place k, in each
    run, is the least possible largest squared error of a tool that has reached place k by now
    without going back. Sample i, with the number ``number + i``, belongs to place ``first + i``.
    ``off`` is its squared distance from the path, which is not an error of progress. The least of
    all values can only grow: ``worst`` is its present value, ``at`` the sample at which it was
    reached, and ``side`` the tool's position then, along the command from its best matching place.

    Places before the first and after the last of ``places`` have no value. The first place with a
    value is dropped if it exceeds ``ceiling`` in every run: ``dropped`` is the least dropped value
    of each run, or a lower bound from the box of all runs. As long as it exceeds ``worst``, nothing
    was lost: the ceiling stays at least four times the largest ``worst``.

    A value of at most ``worst`` is as good as 0, for it cannot change the result. A place where
    this holds in every run is quiet; if the box of all runs shows that it stays so, it is skipped,
    and its value is 0 from then on.

    Loops over the axes of a place are compiled for two axes, for three, and for any number; the
    rest is compiled once.
    """
    # Each tuple access would count references.
    known, lower, upper, _, _ = boxes
    (
        command, way, inverse, heading, first, number, lag, places, value, worst, at, side,
        ceilings, dropped,
    ) = part  # fmt: skip
    samples, axes, runs = points.shape
    rows, origin = len(value), number - first
    first, number = first + beginning, number + beginning
    low, high, ceiling = places[0], places[1], ceilings[0]
    carry, least = np.empty(runs), np.empty(runs)
    # For each place: whether it is quiet, whether its value was skipped, and where it is near.
    quiet, blank = np.zeros(rows, dtype=np.bool_), np.zeros(rows, dtype=np.bool_)
    near = np.zeros(rows, dtype=np.int64)
    raised, floor, lost = known, 0.0, np.inf
    for i in range(samples):
        last = first + i
        begin = max(last - lag, 0)
        for r in range(runs):
            carry[r] = 0.0 if number + i == 0 else np.inf
            least[r] = np.inf
        row = (origin + last) % rows
        for r in range(runs):
            value[row, r] = np.inf
        quiet[row] = blank[row] = False
        if raised and known:
            floor = np.inf
            for r in range(runs):
                floor = min(floor, worst[r])
        raised = carried_quiet = cleared = False
        for k in range(low, begin):  # beyond the lag: the tool must have passed these
            row = (origin + k) % rows
            carried_quiet = carried_quiet or quiet[row]
            for r in range(0 if carried_quiet else runs):
                carry[r] = value[row, r] if value[row, r] < carry[r] else carry[r]
        low, farther = max(low, begin), 0
        for k in range(low, last + 1):
            # Only the end of the first place is within the lag.
            start = k - 1 if k > begin else k
            per_length = inverse[k] if k > begin else 0.0
            row = (origin + k) % rows
            carried_quiet = carried_quiet or quiet[row]
            if known:
                apart, across = _bounds_fast(
                    lower, upper, i + 1, command, start, way, k, per_length
                )
                if carried_quiet and across <= floor:
                    quiet[row] = blank[row] = True
                    farther = 0
                    break
                if k == low and k < last and apart > ceiling:
                    near[row] = 0
                    for r in range(runs):
                        near[row] += apart - off[i, r] <= ceiling
                    if not near[row]:  # dropped without a value
                        lost = min(lost, ceiling)
                        for r in range(0 if carried_quiet else runs):
                            carry[r] = value[row, r] if value[row, r] < carry[r] else carry[r]
                        low += 1
                        continue
                if carried_quiet and not cleared:
                    for r in range(runs):
                        carry[r] = 0.0
                    cleared = True
            if blank[row]:
                for r in range(runs):
                    value[row, r] = 0.0
                blank[row] = False
            if axes == 3:
                more, near[row], farther = _stay_at_fast(
                    points, off, i, command, start, way, k, per_length, (0, 0, 0), value, row,
                    carry, least, worst, ceiling,
                )  # fmt: skip
            elif axes == 2:
                more, near[row], farther = _stay_at_fast(
                    points, off, i, command, start, way, k, per_length, (0, 0), value, row,
                    carry, least, worst, ceiling,
                )  # fmt: skip
            else:
                more, near[row], farther = _stay_at_fast(
                    points, off, i, command, start, way, k, per_length, way[k], value, row,
                    carry, least, worst, ceiling,
                )  # fmt: skip
            quiet[row] = more == 0 and known
            if not farther:  # good enough in every run: no later place is better
                break
        for later in range(k + 1, high + 1):
            row = (origin + later) % rows
            for r in range(runs):
                value[row, r] = np.inf
            quiet[row] = blank[row] = False
        high = k
        if farther:
            raised = True
            for r in range(runs):
                if least[r] > worst[r]:
                    worst[r], at[r] = least[r], number + i
                    ceiling = max(ceiling, _CEILING * worst[r])
                    k = low
                    while value[(origin + k) % rows, r] > least[r]:
                        k += 1
                    start = k - 1 if k > begin else k
                    side[r] = ahead(
                        points[i, :, r],
                        command[start],
                        way[k],
                        inverse[k] if k > begin else 0.0,
                        heading[k],
                    )
        while low < high:
            row = (origin + low) % rows
            if quiet[row] or (near[row] and not raised):
                break
            if not _given_up_fast(value, row, ceiling, dropped):
                break
            low += 1
    for row in range(rows):
        if blank[row]:
            for r in range(runs):
                value[row, r] = 0.0
    if lost < np.inf:
        for r in range(runs):
            dropped[r] = min(dropped[r], lost)
    places[0], places[1], ceilings[0] = low, high, ceiling


move_on = njit(nogil=True)(_advance)
