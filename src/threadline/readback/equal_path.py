"""The path and the clock of a program beside its plan, in order along the path."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.readback.equal_found import Curve

PLACE_M = 20e-6
"""Largest distance between a program and its plan: two tolerances of a chord."""
_SAMPLED_M = 1e-6  # a sampled plan leaves the plan by at most this
_SLACK_M = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Points:
    """The ends of a program's moves.

    Parameters
    ----------
    ends
        (n, axes) in m, rotary axes at their radius.
    end_s
        (n,) clock at each end; None where a firmware makes the time.
    where
        Line or block of each.
    """

    ends: FloatArray
    end_s: FloatArray | None
    where: list[str]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Followed:
    """Largest distance in m and clock difference in s, where they are, and both over time.

    ``time_s`` is None where a firmware makes its own time.
    """

    place_m: float
    time_s: float | None
    at: str
    curve: Curve


def radius_m(plan: Plan) -> FloatArray:
    """Return the (axes,) radius of each axis of a plan: 1 for a linear one, m for a rotary one."""
    axes = plan.motion.trajectory.axes
    found: FloatArray = plan.machine.radius_m[
        [plan.machine.axis_names.index(axis) for axis in axes]
    ]
    return found


def _sampled(plan: Plan) -> tuple[FloatArray, FloatArray]:
    """Return (n,) instants and (n, axes) places in m of the plan; chords leave it by 1 um."""
    radii = radius_m(plan)
    times: list[FloatArray] = []
    points: list[FloatArray] = []
    for block in plan.motion.trajectory:
        looked = (np.arange(9) / 8.0)[None] * block.duration_s[:, None] + block.start_s[:, None]
        # The ends of a piece belong to its neighbour; inside it they are safe.
        looked[:, -1] -= 1e-9 * block.duration_s
        bent = np.linalg.norm(block.evaluate(looked.ravel(), 2) * radii, axis=1)
        most = bent.reshape(looked.shape).max(axis=1)
        parts = np.ceil(block.duration_s * np.sqrt(1.2 * most / (8.0 * _SAMPLED_M)))
        parts = np.maximum(parts, 1.0).astype(np.int64)
        first = np.repeat(np.cumsum(parts) - parts, parts)
        share = (np.arange(int(parts.sum())) - first) / np.repeat(parts, parts)
        at = np.repeat(block.start_s, parts) + share * np.repeat(block.duration_s, parts)
        times.append(at)
        points.append(block.evaluate(at) * radii)
        last = np.array([block.end_s])
        end = block.evaluate(last) * radii
    return np.concatenate([*times, last]), np.concatenate([*points, end])


@dataclass(slots=True)
class _Worst:
    value: float = 0.0
    at: str = ""

    def take(self, value: float, at: str) -> None:
        if abs(value) > abs(self.value):
            self.value, self.at = value, at


def followed(plan: Plan, found: Points) -> Followed:
    """Follow the plan from end to end of a program's moves, in order."""
    times, points = _sampled(plan)
    place, clock = _Worst(), _Worst()
    before, rest = points[0], 0
    at_s, offs, lates = list[float](), list[float](), list[float]()
    for k, match in enumerate(_matches(times, points, found.ends)):
        end = found.ends[k]
        # The plan's own points between two ends lie beside the straight move.
        passed = points[match.first : match.last + 1]
        off = float(_from_segment(passed, before, end).max()) if len(passed) else 0.0
        off = max(match.off_m, off)
        place.take(off, found.where[k])
        late = 0.0
        if found.end_s is not None:
            end_s = float(found.end_s[k])
            late = end_s - min(max(end_s, match.from_s), match.to_s)
            clock.take(late, found.where[k])
        if not k:  # a move counts from its begin: the first one from the plan's begin
            at_s, offs = [float(times[0])], [off]
            lates = [0.0]
        lates.append(late)
        at_s.append(match.from_s)
        offs.append(off)
        before, rest = end, match.last
    left = float(np.linalg.norm(points[min(rest + 1, len(points) - 1) :] - before, axis=1).max())
    if left > place.value:
        place.take(left, "its end")
    return Followed(
        place_m=place.value,
        time_s=None if found.end_s is None else clock.value,
        at=place.at if place.value > PLACE_M or not clock.at else clock.at,
        curve=Curve(
            time_s=np.array(at_s),
            place=np.array(offs),
            late_s=np.array(lates) if found.end_s is not None else None,
        ),
    )


@dataclass(frozen=True, slots=True)
class _Match:
    """Where the plan passes an end: first and last point on the way, distance, time from and to."""

    first: int
    last: int
    off_m: float
    from_s: float
    to_s: float


def _matches(times: FloatArray, points: FloatArray, ends: FloatArray) -> Iterator[_Match]:
    """Yield where the plan first comes by each end, always onwards from the one before."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])
    at = 0
    for end in ends:
        reach = 2.0 * float(np.linalg.norm(end - points[at])) + _SLACK_M
        stop = max(int(np.searchsorted(way, way[at] + reach, side="right")), at + 2)
        stop = min(stop, len(points))
        window = points[at:stop]
        off = _from_segments(end, window)
        inside = off <= PLACE_M
        enters, leaves = 0, len(off)
        if inside.any():
            enters = int(np.argmax(inside))
            leaves = enters + int(np.argmin(np.append(inside[enters:], False)))
        # Where the path turns back, the way there and the way back are equally near.
        near = off <= off[enters:leaves].min() + 2.0 * _SAMPLED_M
        low = enters + int(np.argmax(near[enters:leaves]))
        high = low + int(np.argmin(np.append(near[low:leaves], False))) - 1
        best = low + int(np.argmin(off[low : high + 1]))
        span = times[at : stop + 1]
        behind = min(high + 1, len(span) - 1)
        yield _Match(at + 1, at + low, float(off[best]), float(span[low]), float(span[behind]))
        at += low


def _from_segments(point: FloatArray, chain: FloatArray) -> FloatArray:
    """Return the distances of a point from the segments of a chain; of its one point if alone."""
    off: FloatArray
    if len(chain) < 2:
        off = np.linalg.norm(chain - point, axis=1)
        return off
    begin, way = chain[:-1], np.diff(chain, axis=0)
    squared = (way**2).sum(axis=1)
    along = ((point - begin) * way).sum(axis=1)
    share = np.clip(np.divide(along, squared, out=np.zeros_like(along), where=squared > 0), 0, 1)
    off = np.linalg.norm(begin + share[:, None] * way - point, axis=1)
    return off


def _from_segment(points: FloatArray, begin: FloatArray, end: FloatArray) -> FloatArray:
    """Return the (n,) distances of points from one segment."""
    way = end - begin
    squared = float(way @ way)
    share = (
        np.clip((points - begin) @ way / squared, 0.0, 1.0) if squared else np.zeros(len(points))
    )
    off: FloatArray = np.linalg.norm(begin + share[:, None] * way - points, axis=1)
    return off
