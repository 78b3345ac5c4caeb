"""Progress error: how far ahead of its command the tool is along the path, or behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numba import njit

from threadline.arrays import FloatArray, IntArray
from threadline.trajectory import TrajectoryReader
from threadline.verdict.measure import Finding, Measure
from threadline.verdict.nearest import squared_distances, squared_to_segment
from threadline.verdict.samples import Block, Setting

COMMAND_BY_TIME = "command from the plan by time"
"""Note of a result that relies on it."""


def _advance(
    points: FloatArray,
    off: FloatArray,
    command: FloatArray,
    heading: FloatArray,
    first: int,
    number: int,
    lag: int,
    low: int,
    value: FloatArray,
    origin: IntArray,
    side: FloatArray,
) -> int:
    """Advance ``value`` by the samples ``points``; return the first place that still counts.

    Place k is the way of the command from its sample k - 1 to k. ``value[k]`` is the least of
    the largest errors with which the tool can have come to place k by now without going back;
    ``origin`` is the sample of that largest error and ``side`` its sign. Sample i, the
    ``number + i``-th of all, belongs to place ``first + i``. ``off`` is its squared distance from
    the path, which is no error of progress.
    """
    for i in range(len(points)):
        last = first + i
        begin = max(last - lag, 0)
        carry, carried, carried_side = np.inf, -1, 0.0
        if number + i == 0:
            carry = 0.0
        for k in range(low, begin):  # the lag excuses them no longer: the tool has moved on
            if value[k] < carry:
                carry, carried, carried_side = value[k], origin[k], side[k]
        for k in range(begin, last + 1):
            if k < last and number + i > 0 and value[k] < carry:
                carry, carried, carried_side = value[k], origin[k], side[k]
            before = k - 1 if k > begin else k
            squared, where = squared_to_segment(points[i], command[before], command[k])
            error = np.sqrt(max(squared - off[i], 0.0))
            if error > carry or carried < 0:
                along = 0.0
                for j in range(points.shape[1]):
                    foot = command[before, j] + where * (command[k, j] - command[before, j])
                    along += (points[i, j] - foot) * heading[k, j]
                value[k], origin[k], side[k] = error, number + i, along
            else:
                value[k], origin[k], side[k] = carry, carried, carried_side
        low = begin
    return low


_advance_fast = njit(cache=True, nogil=True)(_advance)


class _Progress:
    """Largest distance along the path between the tool and where its command was.

    Every sample is held against the way of the command within the lag before it, and the places
    there may only go forward from sample to sample: the least error that allows it, which is the
    Frechet distance of the two ways within the lag, less what the tool is off the path there (that
    is ``contour_error``). Trailing by less than the lag costs nothing; running ahead costs its
    length; a step back costs half of it at least, for it lies between two places.

    A recording without the command of every axis is held against the plan at the same instant.

    Lengths at the tool, over all axes, rotary ones times their radius. Between two samples the
    tool can be ahead or behind by half its way in a sample interval more.
    """

    def __init__(self, setting: Setting) -> None:
        axes = len(setting.axes)
        self._radius_m = setting.radius_m
        self._lag = setting.lag_samples
        self._number = 0  # samples so far
        self._low = 0
        # The command's places within the lag, and one before them.
        self._command: FloatArray = np.empty((0, axes))
        self._heading: FloatArray = np.empty((0, axes))
        self._value: FloatArray = np.empty(0)
        self._origin: IntArray = np.empty(0, dtype=np.int64)
        self._side: FloatArray = np.empty(0)
        self._places: dict[int, Finding] = {}  # of the samples that an origin names
        self._trajectory = setting.plan.motion.trajectory
        self._columns = [self._trajectory.axes.index(axis) for axis in setting.axes]
        self._planned: TrajectoryReader | None = None

    def feed(self, block: Block) -> None:
        """Take the next samples."""
        assert block.actual is not None
        points = np.ascontiguousarray(block.actual * self._radius_m)
        path, begin, end = block.window()
        fresh = self._commanded(block) * self._radius_m
        first, count = len(self._command), len(block)
        command = np.concatenate([self._command, fresh])
        heading = np.concatenate([self._heading, _headings(self._command, self._heading, fresh)])
        value = np.concatenate([self._value, np.zeros(count)])
        origin = np.concatenate([self._origin, np.full(count, -1)])
        side = np.concatenate([self._side, np.zeros(count)])
        off = squared_distances(points, begin, end, path.vertices)
        low = _advance_fast(
            points,
            off,
            command,
            heading,
            first,
            self._number,
            self._lag,
            self._low,
            value,
            origin,
            side,
        )
        keep = max(low - 1, 0)
        self._low = low - keep
        self._command, self._heading = command[keep:], heading[keep:]
        self._value, self._origin, self._side = value[keep:], origin[keep:], side[keep:]
        self._remember(block)
        self._number += count

    def finish(self) -> Sequence[Finding]:
        """Return the least error with which the tool can have come to any place by the end."""
        if not self._number:
            return [Finding(value=None, note="the recording is empty")]
        at = self._low + int(np.argmin(self._value[self._low :]))
        side = self._side[at]
        note = "ahead" if side > 0.0 else "behind" if side < 0.0 else ""
        if self._planned is not None:
            note = "; ".join(filter(None, (note, COMMAND_BY_TIME)))
        place = self._places[int(self._origin[at])]
        return [replace(place, value=float(self._value[at]), note=note)]

    def _commanded(self, block: Block) -> FloatArray:
        """Return (n, axes) the command of a block, from the plan where an axis has none."""
        if block.commanded is not None and np.isfinite(block.commanded).all():
            return block.commanded
        if self._planned is None:
            self._planned = TrajectoryReader(self._trajectory)
        found = self._planned.ladder(block.time_s, 1)[:, 0, self._columns]
        self._planned.drop(float(block.time_s[-1]))
        return np.asarray(found)

    def _remember(self, block: Block) -> None:
        """Keep the places of the samples that may turn out to be the worst, and no others."""
        named = np.unique(self._origin[self._low :])
        kept = {n: self._places[n] for n in named[named < self._number].tolist()}
        for number in named[named >= self._number].tolist():
            at = number - self._number
            kept[number] = Finding(
                value=0.0,
                time_s=float(block.time_s[at]),
                operation=block.operation_at(at),
                position=block.position_at(at),
            )
        self._places = kept


def _headings(before: FloatArray, heading: FloatArray, fresh: FloatArray) -> FloatArray:
    """Return (n, axes) the way that led to each new place; of one that stands, the last there was.

    0 before the first motion.
    """
    start = before[-1:] if len(before) else fresh[:1]
    way = np.diff(fresh, axis=0, prepend=start)
    known = heading[-1:] if len(heading) else np.zeros((1, fresh.shape[1]))
    way = np.concatenate([known, way])
    moved = (way != 0.0).any(axis=1)
    latest = np.maximum.accumulate(np.where(moved, np.arange(len(way)), 0))
    return np.asarray(way[latest][1:])


def start_progress(setting: Setting, options: Mapping[str, float]) -> Measure:  # noqa: ARG001
    """Begin measuring the progress error."""
    return _Progress(setting)
