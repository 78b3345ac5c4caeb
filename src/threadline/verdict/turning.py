"""Turning-point error; turning points of the programmed path, found while it streams by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.verdict.bow import (
    NO_BETWEEN,
    NO_VELOCITY,
    Between,
    MotionBetween,
    deviation,
    turning_places,
    turns,
)
from threadline.verdict.boxes import Boxes, ends_of
from threadline.verdict.finding import Finding, RunFindings, Worst, sure_of
from threadline.verdict.measure import Measure, Option, SweptMeasure
from threadline.verdict.samples import Block, Setting
from threadline.verdict.window import PathWindow


@dataclass(frozen=True, slots=True)
class Turning:
    """A value at which an axis turns back, or the end of the path.

    Parameters
    ----------
    value
        Length at the tool.
    direction
        +1 for a maximum, -1 for a minimum, 0 if the axis never moved.
    operation, line, position
        Operation, job line and position, in the units of the axes, of the first vertex there.
    leaves
        Number of the chord that leaves it: the axis may rest there for many chords before.
    """

    value: float
    direction: int
    operation: int
    line: int
    position: tuple[float, ...]
    leaves: int


def _scan(
    vertices: FloatArray,
    column: int,
    smallest: float,
    direction: int,
    value: float,
    found_at: IntArray,
    found_leaves: IntArray,
) -> tuple[int, int, int]:
    """Run the hysteresis over a column of (n, axes) ``vertices``.

    ``direction`` and ``value`` are the direction and the extreme after the previous call. The
    turnings found are the vertices ``found_at``; the axis leaves them at the vertices
    ``found_leaves``. A vertex -1 is the extreme of an earlier call.

    Returns
    -------
    tuple
        Direction and vertex of the running extreme, and number of turnings found.
    """
    count, at = 0, -1
    for i in range(len(vertices)):
        rise = vertices[i, column] - value
        if direction == 0:
            if abs(rise) > smallest:
                direction, value, at = (1 if rise > 0 else -1), vertices[i, column], i
        elif direction * rise > 0:
            value, at = vertices[i, column], i
        elif direction * rise < -smallest:
            found_at[count], found_leaves[count] = at, i
            count += 1
            direction, value, at = -direction, vertices[i, column], i
    return direction, at, count


_scan_fast = njit(nogil=True)(_scan)


class ReversalScan:
    """Finds the turnings of one axis; reversals of no more than ``smallest`` do not count.

    Ignoring so small a reversal can hide an error of at most its size.
    """

    def __init__(self, column: int, smallest: float, radius_m: FloatArray) -> None:
        self._column = column
        self._smallest = smallest
        self._radius_m = radius_m
        self._seen = -1  # number of the next vertex, -1 before the first
        self.direction = 0  # 0 until the axis has moved
        self._extreme: FloatArray = np.zeros(len(radius_m))
        self._operation = self._line = 0

    def scan(self, path: PathWindow) -> list[Turning]:
        """Return the turnings confirmed by the vertices read since the last call."""
        if self._seen < 0:
            self._seen = path.first
            self._keep(path, 0)
        begin = max(self._seen - path.first, 0)
        self._seen = path.first + len(path)
        vertices = path.vertices[begin:]
        if not len(vertices):
            return []
        first_direction = self.direction
        where = np.empty(len(vertices), dtype=np.int64)
        leaves = np.empty(len(vertices), dtype=np.int64)
        self.direction, at, count = _scan_fast(
            vertices, self._column, self._smallest, self.direction,
            float(self._extreme[self._column]), where, leaves,
        )  # fmt: skip
        found = []
        # Only the first turning can be at an extreme of an earlier call. Before it, the axis may
        # have begun to move, so its direction is counted back from the last direction.
        direction = first_direction or (self.direction if count % 2 == 0 else -self.direction)
        for index, leaving in zip(where[:count], leaves[:count], strict=True):
            if index >= 0:
                self._keep(path, begin + int(index))
            found.append(self._turning(direction, path.first + begin + int(leaving)))
            direction = -direction
        if at >= 0:
            self._keep(path, begin + int(at))
        return found

    def end(self) -> Turning:
        """Return the end of the scanned path, which counts as a turning."""
        return self._turning(self.direction, self._seen)

    def _turning(self, direction: int, leaves: int) -> Turning:
        return Turning(
            value=float(self._extreme[self._column]),
            direction=direction,
            operation=self._operation,
            line=self._line,
            position=tuple((self._extreme / self._radius_m).tolist()),
            leaves=leaves,
        )

    def _keep(self, path: PathWindow, index: int) -> None:
        self._extreme = path.vertices[index].copy()
        self._operation = int(path.operation[index])
        self._line = int(path.line[index])


OPTIONS = {"smallest": Option(unit="m", default=5e-5)}


class TurningPart(NamedTuple):
    """Arrays that a sweep over a block reads and updates for the turnings of k axes.

    The turnings that axis k awaits are ``values`` and ``leaves`` from ``starts[k]`` to
    ``starts[k + 1]``; after the sweep ``closed[k]`` of them are passed, with (turnings, runs)
    ``errors`` at ``times_s``. ``whole``, (k, 2), is the direction of each axis and the sample at
    which the command left the turning, or -1; it is the same for all runs. ``real``, (k, 4, runs),
    holds the extreme, its time, the extreme of the opposite direction since then, and its time. An
    axis without a direction is not followed. ``chord``, (n,), is the chord of the command; the
    first sample of the block has the number ``first``. An axis may turn between two samples,
    ``interval_s`` apart: ``between`` defines the path there.
    """

    chord: IntArray
    first: int
    lag: int
    values: FloatArray
    leaves: IntArray
    starts: IntArray
    whole: IntArray
    real: FloatArray
    errors: FloatArray
    times_s: FloatArray
    closed: IntArray
    between: Between = NO_BETWEEN
    interval_s: float = 0.0


def _take(real: FloatArray, k: int, r: int, place: float, at_s: float) -> None:
    """Raise the extremes of an axis to a position, counted in the direction of the axis."""
    farther = place > real[k, 0, r]
    back = farther or -place > real[k, 2, r]  # a new extreme restarts the opposite direction
    real[k, 0, r] = place if farther else real[k, 0, r]
    real[k, 1, r] = at_s if farther else real[k, 1, r]
    real[k, 2, r] = -place if back else real[k, 2, r]
    real[k, 3, r] = at_s if back else real[k, 3, r]


_take_fast = njit(nogil=True)(_take)


def _follow(  # noqa: PLR0915 - one loop over the samples; a call would be compiled once more
    points: FloatArray, boxes: Boxes, time_s: FloatArray, low: int, part: TurningPart
) -> None:
    """Follow every axis through its turnings over samples, the first of them ``low``.

    If the box of all runs exceeds every run's extreme, the sample is the new extreme of every run:
    its index is noted, and written out as soon as a box does not decide. A box does not decide if
    any run may turn between two samples.
    """
    samples, _, runs = points.shape
    # Each tuple access would count references.
    known, lower, upper, lows, highs = boxes
    (
        chord, first, lag, values, leaves, starts, whole, real, errors, times_s, closed, between,
        interval_s,
    ) = part  # fmt: skip
    velocity, scale, before, tangent, begun = between
    bowed = len(velocity) > 0
    of_all = np.full(2, -1)  # samples that are the extreme of all runs, in both directions
    bounds = np.empty(4)  # least and most of the extremes, and of the opposite ones
    for k in range(len(closed)):
        due, end = starts[k] + closed[k], starts[k + 1]
        fresh, side = known, whole[k, 0]
        for i in range(samples if side else 0):
            reported, turned = False, 0
            if bowed and (i > 0 or begun[0] > 0):
                for r in range(runs):
                    step = points[i, k, r] - (before[k, r] if i == 0 else points[i - 1, k, r])
                    m0 = tangent[k, r] if i == 0 else scale[k] * velocity[low + i - 1, k, r]
                    turned += turns(step, m0, scale[k] * velocity[low + i, k, r])
            if known and not turned:
                if fresh:
                    for n in range(2):
                        bounds[2 * n], bounds[2 * n + 1] = ends_of(real, k, 2 * n, lows, highs)
                    fresh = False
                least, most = lower[i + 1, k], upper[i + 1, k]
                least, most = (least, most) if side > 0 else (-most, -least)
                if least > bounds[1]:
                    reported, of_all[0], of_all[1] = True, i, i
                    bounds[0], bounds[1], bounds[2], bounds[3] = least, most, -most, -least
                elif most <= bounds[0] and -most > bounds[3]:
                    reported, of_all[1] = True, i
                    bounds[2], bounds[3] = -most, -least
                elif most <= bounds[0] and -least <= bounds[2]:
                    reported = True
                else:
                    bounds[0], bounds[1] = max(bounds[0], least), max(bounds[1], most)
                    # When a run gets farther, its opposite direction starts again.
                    bounds[2], bounds[3] = min(bounds[2], -most), max(bounds[3], -least)
            closing = False
            if due < end:
                if whole[k, 1] < 0 and chord[low + i] >= leaves[due]:
                    whole[k, 1] = first + low + i
                overtaken = due + 1 < end and chord[low + i] >= leaves[due + 1]
                late = first + low + i - whole[k, 1] >= lag
                closing = whole[k, 1] >= 0 and (overtaken or late)
            if not reported or closing or i + 1 == samples:
                for n in range(2):
                    at, sign = of_all[n], side if n == 0 else -side
                    for r in range(runs if at >= 0 else 0):
                        real[k, 2 * n, r] = sign * points[at, k, r]
                        real[k, 2 * n + 1, r] = time_s[at]
                    of_all[n] = -1
            for r in range(runs if turned else 0):
                start = before[k, r] if i == 0 else points[i - 1, k, r]
                m0 = tangent[k, r] if i == 0 else scale[k] * velocity[low + i - 1, k, r]
                step, m1 = points[i, k, r] - start, scale[k] * velocity[low + i, k, r]
                if turns(step, m0, m1):
                    for s in turning_places(step, m0, m1):
                        if s > 0.0:  # or NaN
                            place = start + s * step + deviation(s, step, m0, m1)
                            at_s = time_s[i] - (1.0 - s) * interval_s
                            _take_fast(real, k, r, side * place, at_s)
            for r in range(0 if reported else runs):
                _take_fast(real, k, r, side * points[i, k, r], time_s[i])
            if turned:
                fresh = known
            if closing:
                for r in range(runs):
                    errors[due, r] = real[k, 0, r] - side * values[due]
                    times_s[due, r] = real[k, 1, r]
                    real[k, 0, r], real[k, 1, r] = real[k, 2, r], real[k, 3, r]
                    real[k, 2, r], real[k, 3, r] = side * points[i, k, r], time_s[i]
                due += 1
                side = -side
                whole[k, 0], whole[k, 1] = side, -1
                fresh = known
        closed[k] = due - starts[k]
    for k in range(len(closed) if bowed else 0):
        for r in range(runs):
            before[k, r] = points[samples - 1, k, r]
            tangent[k, r] = scale[k] * velocity[low + samples - 1, k, r]
    begun[0] = bowed


follow_turnings = njit(nogil=True)(_follow)


_EARLY = "the recording ends before the job"


class _Axis:
    """One axis: the turnings ahead of it, and its farthest position in the current direction.

    ``whole`` and ``real`` are as in ``TurningPart``.
    """

    def __init__(
        self, column: int, setting: Setting, smallest: float, whole: IntArray, real: FloatArray
    ) -> None:
        self._column, self.name = column, setting.axes[column]
        self._scan = ReversalScan(column, smallest, setting.radius_m)
        self.open: list[Turning] = []
        self._whole, self._real = whole, real
        self._worst = Worst(
            setting.runs, len(setting.axes), self.name, note="the recording is empty"
        )
        self._last_s = 0.0
        self._last: FloatArray = np.zeros(setting.runs)
        self._coarse, self._past = setting.coarse, np.zeros(setting.runs)

    def read(self, path: PathWindow) -> None:
        """Take the turnings that the path has reached."""
        self.open.extend(self._scan.scan(path))
        if not self._whole[0]:
            self._whole[0] = self.open[0].direction if self.open else self._scan.direction

    def feed(
        self, last: FloatArray, last_s: float, errors: FloatArray, times_s: FloatArray
    ) -> None:
        """Take the (closed, runs) errors of passed turnings, and the present position."""
        self._last, self._last_s = last, last_s
        for turning, error, at_s in zip(self.open, errors, times_s, strict=False):
            self._offer(turning, error, at_s)
        del self.open[: len(errors)]

    def finish(self, path: PathWindow | None, last: FloatArray | None) -> RunFindings:
        if path is None or last is None:
            return self._worst.found()
        real, direction = self._real, int(self._whole[0])
        for turning in [*self.open, self._scan.end()]:
            if direction:
                self._offer(turning, real[0] - direction * turning.value, real[1])
            else:
                self._offer(turning, np.abs(self._last - turning.value), self._last_s)
            direction = -direction
            # The last turning is followed by the motion to the next; after that comes nothing.
            real = np.stack([real[2], real[3], -real[0], real[1]])
        rest = path.remainder(last)
        if rest is not None:
            self._worst.offer(
                np.abs(self._last - rest.end[self._column]),
                time_s=self._last_s,
                operation=rest.operation,
                line=rest.line,
                position=rest.position,
                note=_EARLY,
            )
        found = self._worst.found()
        return sure_of(found, self._past, unless=_EARLY) if self._coarse else found

    def _offer(self, turning: Turning, error: FloatArray, time_s: FloatArray | float) -> None:
        self._past = np.maximum(self._past, error)
        sides = np.where(error > 0.0, "past", np.where(error < 0.0, "short", ""))
        self._worst.offer(
            np.abs(error),
            time_s=time_s,
            operation=turning.operation,
            line=turning.line,
            position=np.array(turning.position),
            note=sides.astype(object) if turning.direction else "",
        )


class _TurningPoints(SweptMeasure):
    """Per axis: the farthest position at each reversal, against the programmed value.

    Lengths are at the tool (rotary axes times their radius). A reversal is watched from the
    previous reversal until the command left it the lag ago, or has left the next reversal. The end
    of the job counts as the last reversal. Between two samples the extreme of the cubic Hermite
    interpolant counts (``bow``). Without velocities the extreme can be missed by at most a T^2 / 8,
    with the acceleration a and the sample interval T. If a stroke takes less time than the
    machine's lag, the distance not yet covered counts as its error.
    """

    def __init__(self, setting: Setting, smallest: float) -> None:
        axes, self._runs = len(setting.axes), setting.runs
        self._whole: IntArray = np.zeros((axes, 2), dtype=np.int64)
        self._whole[:, 1] = -1
        self._real: FloatArray = np.zeros((axes, 4, setting.runs))
        self._real[:, [0, 2]] = -np.inf
        self._axes = [
            _Axis(column, setting, smallest, self._whole[column], self._real[column])
            for column in range(axes)
        ]
        self._lag, self._interval_s = setting.lag_samples, setting.interval_s
        self._between = MotionBetween(setting)
        self._path: PathWindow | None = None
        self._last: FloatArray | None = None
        self._part: TurningPart | None = None

    def part(self, block: Block) -> TurningPart:
        """Return the arrays for the sweep, with the turnings of the path around the block."""
        assert block.path is not None and block.chord is not None
        for axis in self._axes:
            axis.read(block.path)
        awaited = [turning for axis in self._axes for turning in axis.open]
        shape = len(awaited), self._runs
        self._part = TurningPart(
            chord=block.chord,
            first=block.first,
            lag=self._lag,
            values=np.array([turning.value for turning in awaited], dtype=np.float64),
            leaves=np.array([turning.leaves for turning in awaited], dtype=np.int64),
            starts=np.cumsum([0, *(len(axis.open) for axis in self._axes)]),
            whole=self._whole,
            real=self._real,
            errors=np.empty(shape),
            times_s=np.empty(shape),
            closed=np.zeros(len(self._axes), dtype=np.int64),
            between=self._between.part(block),
            interval_s=self._interval_s,
        )
        return self._part

    def feed(self, block: Block) -> None:
        """Take the sweep's results."""
        found = self._part
        assert found is not None
        self._path, self._last, last_s = block.path, block.last_at_tool, float(block.time_s[-1])
        for column, axis in enumerate(self._axes):
            begin = int(found.starts[column])
            closed = slice(begin, begin + int(found.closed[column]))
            axis.feed(self._last[column], last_s, found.errors[closed], found.times_s[closed])

    def finish(self) -> Sequence[RunFindings]:
        if self._between.incomplete:
            none = [Finding(value=None, axis=axis.name, note=NO_VELOCITY) for axis in self._axes]
            return [RunFindings.alike(one, self._runs) for one in none]
        return [axis.finish(self._path, self._last) for axis in self._axes]


def start_turning(setting: Setting, options: Mapping[str, float]) -> Measure:
    """Begin measuring the turning-point error."""
    return _TurningPoints(setting, options["smallest"])
