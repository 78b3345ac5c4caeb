"""Places along the command that the tools of many runs can have reached, sample by sample."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.verdict.bow import NO_BETWEEN, Between
from threadline.verdict.boxes import MORE, Boxes

CEILING = 4.0  # times the largest squared error: a trailing place with a larger value is dropped


class Command(NamedTuple):
    """The command as segments: segment k leads from row k - 1 to row k.

    ``points``, ``vector`` and ``heading`` are (m, axes): positions at the tool, the vector of each
    segment, and the direction of motion there, which a rest keeps. ``inverse``, (m,), is 1 over the
    squared ``length`` of each segment.
    """

    points: FloatArray
    vector: FloatArray
    inverse: FloatArray
    length: FloatArray
    heading: FloatArray


class _Place(NamedTuple):
    """Segment ``k`` of the command at sample ``i``: from row ``start``, ``length`` m long.

    Of the first place within the lag only the end counts: then ``start`` is ``k``, and ``length``
    and ``inverse`` are 0. ``row`` is its row of values; a run needs the place if its value is at
    most ``limit``.
    """

    i: int
    k: int
    row: int
    start: int
    inverse: float
    length: float
    limit: float


def _exceeds_ceiling(
    value: FloatArray, row: int, long: float, ceiling: float, dropped: FloatArray
) -> bool:
    """Return whether all values of a row exceed the ceiling; if so, lower ``dropped`` to them.

    The ceiling is compared with the least value reachable in the next place, ``long`` m long: the
    root of the value decreases by the distance.
    """
    least, near = np.sqrt(ceiling) + long, 0
    for r in range(len(dropped)):
        near += value[row, r] <= least * least
    if near:
        return False
    for r in range(len(dropped)):
        left = (np.sqrt(value[row, r]) - long) ** 2
        dropped[r] = min(dropped[r], left)
    return True


_exceeds_ceiling_fast = njit(nogil=True)(_exceeds_ceiling)


def _ahead(
    point: FloatArray, start: FloatArray, vector: FloatArray, inverse: float, heading: FloatArray
) -> float:
    """Return how far a point is ahead of the nearest place of a segment, along a heading.

    ``inverse`` is 1 over the squared length of ``vector``, or 0: then only ``start`` counts.
    """
    length, along = 0.0, 0.0
    for a in range(len(point)):
        length += (point[a] - start[a]) * vector[a]
    where = min(max(length * inverse, 0.0), 1.0)
    for a in range(len(point)):
        along += (point[a] - start[a] - where * vector[a]) * heading[a]
    return along


ahead = njit(nogil=True)(_ahead)


def _bounds(
    lower: FloatArray,
    upper: FloatArray,
    points: FloatArray,
    vector: FloatArray,
    place: _Place,
) -> tuple[float, float]:
    """Return a lower and an upper bound of the squared distance of a sample's box to a place."""
    i, k, _, start, inverse, _, _ = place
    i += 1  # row 0 of the boxes is the sample before
    middle, half = 0.0, 0.0
    for a in range(vector.shape[1]):
        centre = 0.5 * (lower[i, a] + upper[i, a])
        middle += (centre - points[start, a]) * vector[k, a]
        half += (0.5 * (upper[i, a] - lower[i, a])) ** 2
    nearest = min(max(middle * inverse, 0.0), 1.0)
    away = 0.0
    for a in range(vector.shape[1]):
        centre = 0.5 * (lower[i, a] + upper[i, a])
        away += (centre - points[start, a] - nearest * vector[k, a]) ** 2
    away, half = np.sqrt(away), np.sqrt(half)
    return max(away - half, 0.0) ** 2 / MORE, MORE * (away + half) ** 2


_bounds_fast = njit(nogil=True)(_bounds)


def _stay_at(
    tool: FloatArray,
    off: FloatArray,
    points: FloatArray,
    vector: FloatArray,
    place: _Place,
    axes: tuple[int, ...],
    value: FloatArray,
    reached: FloatArray,
    worst: FloatArray,
) -> tuple[int, int]:
    """Advance the values of a place of the command by one sample of ``tool``.

    ``off`` is the squared distance of the sample from the path. ``reached``, (2, runs), are the
    previous values at the beginning of the place, and the least values of the places before; both
    are updated. Return the number of runs in which the least value so far is at most
    ``place.limit``, and in which it exceeds ``worst``. ``axes`` is a tuple with one entry per axis:
    its length is known at compile time, and loops over axes are unrolled.

    From the beginning of the place on, the root of the value decreases by the distance, down to the
    value at the end. So the least value is where the tool is nearest, or farther on, where its
    growing distance meets the decreasing root.
    """
    i, k, row, start, inverse, length, limit = place
    near, farther = 0, 0
    for r in range(len(worst)):
        left, held = reached[0, r], value[row, r]
        along = 0.0
        for a in range(len(axes)):
            along += (tool[i, a, r] - points[start, a]) * vector[k, a]
        share = along * inverse
        where = min(1.0, max(0.0, share))
        away = 0.0
        for a in range(len(axes)):
            gap = tool[i, a, r] - points[start, a] - where * vector[k, a]
            away += gap * gap
        error = away - off[i, r]
        behind = np.sqrt(left) - where * length
        beside, room = (where - share) * length, (1.0 - where) * length
        on = (behind * behind - error) / (2.0 * (behind + beside))
        on = min(room, on)  # room too where it is NaN
        on = max(0.0, on)
        on = on if behind > 0.0 and behind * behind > error else 0.0
        error += on * (2.0 * beside + on)
        error = max(held, error)
        least = reached[1, r]
        least = min(least, error)
        reached[0, r], reached[1, r], value[row, r] = held, least, least
        near += least <= limit
        farther += least > worst[r]
    return near, farther


_stay_at_fast = njit(nogil=True)(_stay_at)


class ProgressPart(NamedTuple):
    """Arrays that a sweep over a block reads and updates for the progress error: see ``_advance``.

    Place ``first`` belongs to the first sample of the block, which has the number ``number``.
    ``places`` are the first and the last place with a value; ``ceiling`` has one entry.
    ``charge``, (runs,), bounds the deviation of the path from the straight segment between two
    samples (``bow.charge_bows``).
    """

    command: Command
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
    between: Between = NO_BETWEEN
    charge: FloatArray = np.empty(0)


def _advance(  # noqa: PLR0915 - one loop over the places; each call would be compiled once more
    points: FloatArray,
    boxes: Boxes,
    off: FloatArray,
    beginning: int,
    axes_each: tuple[int, ...],
    part: ProgressPart,
) -> None:
    """Advance the places of the command by the samples ``points``, the first of them ``beginning``.

    Place k is the segment of the command from its sample k - 1 to k. The value of place k, in each
    run, is the least possible largest squared error of a tool that has reached the end of place k,
    or of an earlier one, by now without going back, within a place either: see ``_stay_at``. Sample
    i, with the number ``number + i``, belongs to place ``first + i``. ``off`` is its squared
    distance from the path, which is not an error of progress. The least of all values can only
    grow: ``worst`` is its present value, ``at`` the sample at which it was reached, and ``side``
    the tool's position then, along the command from its best matching place.

    Places before the first of ``places`` have no value; those after the last have its value. The
    first place with a value is dropped if it exceeds ``ceiling`` in every run, together with the
    segment from its end to where the value may have decreased to the ceiling: ``dropped`` is the
    least dropped value of each run, or a lower bound from the box of all runs. As long as it
    exceeds ``worst``, the result is exact: the ceiling stays at least four times the largest
    ``worst``.

    A value of at most ``worst`` is as good as 0, for it cannot change the result. Only the last
    place can have such a value in every run: it is settled. If the box of all runs shows that the
    next place stays settled, it is skipped, and its value is 0 from then on.

    ``axes_each`` is a tuple with one entry per axis: see ``_stay_at``.
    """
    # Each tuple access would count references.
    (
        command, first, number, lag, places, value, worst, at, side, ceilings, dropped, _, _,
    ) = part  # fmt: skip
    known, lower, upper, _, _ = boxes
    commanded, vector, inverse, length, heading = command
    samples, _, runs = points.shape
    rows, origin = len(value), number - first
    first, number = first + beginning, number + beginning
    low, high, ceiling = places[0], places[1], ceilings[0]
    reached = np.empty((2, runs))  # as in ``_stay_at``
    near = np.zeros(rows, dtype=np.int64)  # for each place, number of runs that need it
    settled, raised, floor, skipped, farther = False, known, 0.0, np.inf, 0
    for i in range(samples):
        last = first + i
        begin = max(last - lag, 0)
        for r in range(runs):
            reached[0, r] = 0.0 if number + i == 0 else np.inf
            reached[1, r] = np.inf
        if raised and known:
            floor = np.inf
            for r in range(runs):
                floor = min(floor, worst[r])
        raised = False
        if low < begin:  # beyond the lag: the tool must have passed these
            row = (origin + min(begin - 1, high)) % rows
            for r in range(runs):
                reached[0, r] = value[row, r]
            low = begin
        k, farther = low, 0
        while True:
            # Only the end of the first place is within the lag.
            start, per_square, long = (k - 1, inverse[k], length[k]) if k > begin else (k, 0.0, 0.0)
            limit = (np.sqrt(ceiling) + (length[k + 1] if k < last else 0.0)) ** 2
            row = (origin + k) % rows
            place = _Place(i, k, row, start, per_square, long, limit)
            if k > high:
                for r in range(runs):
                    value[row, r] = reached[0, r]
            apart, across = 0.0, np.inf
            if known:
                apart, across = _bounds_fast(lower, upper, commanded, vector, place)
            if k > high and settled and across <= floor:
                for r in range(runs):
                    value[row, r] = 0.0
                farther = 0
                break
            if k == low and k < last and apart > limit:
                near[row] = 0
                for r in range(runs):
                    near[row] += apart - off[i, r] <= limit
                if not near[row]:  # dropped without a value
                    skipped = min(skipped, ceiling)
                    for r in range(runs):
                        reached[0, r] = value[row, r]
                    low, k = low + 1, k + 1
                    continue
            near[row], farther = _stay_at_fast(
                points, off, commanded, vector, place, axes_each, value, reached, worst
            )
            # If every run is good enough, no later place is better.
            if k == last or not farther:
                break
            k += 1
        high, settled = k, not farther
        if farther:
            raised = True
            for r in range(runs):
                least = reached[1, r]
                if least > worst[r]:
                    worst[r], at[r] = least, number + i
                    ceiling = max(ceiling, CEILING * worst[r])
                    k = low
                    while value[(origin + k) % rows, r] > least:
                        k += 1
                    start = k - 1 if k > begin else k
                    side[r] = ahead(
                        points[i, :, r],
                        commanded[start],
                        vector[k],
                        inverse[k] if k > begin else 0.0,
                        heading[k],
                    )
        while low < high:
            row = (origin + low) % rows
            if near[row] and not raised:
                break
            if not _exceeds_ceiling_fast(value, row, length[low + 1], ceiling, dropped):
                break
            low += 1
    if skipped < np.inf:
        for r in range(runs):
            dropped[r] = min(dropped[r], skipped)
    places[0], places[1], ceilings[0] = low, high, ceiling


move_on = njit(nogil=True)(_advance)
