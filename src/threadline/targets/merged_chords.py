"""Which moves of a plan that follow each other become one chord."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from threadline.arrays import FloatArray
from threadline.targets.planned_job import CHORD_TOLERANCE_M

CLOSE_M = 1e-7
"""By how far an end that is rounded to 0.0001 mm or degrees lies off, and a little."""
_RISE = 1e-3  # of a speed


class Part(NamedTuple):
    """The moves from ``first`` up to ``stop`` as one chord, at ``speed`` at most."""

    first: int
    stop: int
    speed: float


def merged(points: FloatArray, speeds: FloatArray) -> list[Part]:
    """Return the chords of moves along (n + 1, axes) ``points`` at the tool, at (n,) ``speeds``."""
    first, parts = 0, list[Part]()
    for last in _humps(speeds):
        while first < last:
            count = _longest(points[first : last + 1])
            speed = float(speeds[first : first + count].max())
            parts.append(Part(first, first + count, speed))
            first += count
    return _without_slivers(parts, points)


def _humps(speeds: FloatArray) -> Iterator[int]:
    """Yield where each stretch of (n,) speeds ends that rises and then falls once at most.

    What is less than ``_RISE`` of a speed is none: ends of moves are rounded.
    """
    highest = lowest = float(speeds[0])
    for at, speed in enumerate(speeds.tolist()):
        fallen = lowest < highest * (1.0 - _RISE)
        if fallen and speed > lowest * (1.0 + _RISE):
            yield at
            highest = lowest = speed
        elif speed > highest:
            highest = lowest = speed
        else:
            lowest = min(lowest, speed)
    yield len(speeds)


def _without_slivers(parts: list[Part], points: FloatArray) -> list[Part]:
    """Return ``parts`` with each that is shorter than the tolerance in the one beside it.

    Where a planned speed falls and rises again in the middle of a move, the rest of the move would
    be a block of its own. It takes the speed of the other part: within the tolerance of a
    chord nothing is made of a speed.
    """
    kept: list[Part] = []
    for part in parts:
        if kept and (_short(kept[-1], points) or _short(part, points)):
            before = kept[-1]
            both = points[before.first : part.stop + 1]
            if _within(both, CHORD_TOLERANCE_M, back_m=CHORD_TOLERANCE_M):
                longer = part if _short(before, points) else before
                kept[-1] = Part(before.first, part.stop, longer.speed)
                continue
        kept.append(part)
    return kept


def _short(part: Part, points: FloatArray) -> bool:
    way = points[part.first : part.stop + 1] - points[part.first]
    return bool(float((way**2).sum(axis=1).max()) < CHORD_TOLERANCE_M**2)


def _longest(points: FloatArray) -> int:
    """Return how many moves from the first of (n, axes) points on make a chord, 1 at least."""
    most = len(points) - 1
    good = 1
    while good < most and _within(points[: min(2 * good, most) + 1], CHORD_TOLERANCE_M):
        good = min(2 * good, most)
    bad = min(2 * good, most + 1)
    while bad - good > 1:
        middle = (good + bad) // 2
        if middle <= most and _within(points[: middle + 1], CHORD_TOLERANCE_M):
            good = middle
        else:
            bad = middle
    return good


def _within(points: FloatArray, most_m: float, back_m: float = CLOSE_M) -> bool:
    """Say whether (n, axes) points lie along the line from first to last, in their order.

    No step goes back along it by more than ``back_m``, and none lies that far beyond its ends.
    """
    way = points[-1] - points[0]
    length = float(np.linalg.norm(way))
    if length == 0.0:
        return False
    along = (points - points[0]) @ (way / length)
    if (np.diff(along) < -back_m).any() or along.min() < -back_m or along.max() > length + back_m:
        return False
    away = points - points[0] - along[:, None] * (way / length)
    return bool(float(np.sqrt((away**2).sum(axis=1).max())) <= most_m)
