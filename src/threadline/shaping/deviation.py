"""How far a shaped motion leaves its planned path, in space and at the tool, whenever that is.

Delay along the path is no deviation. What counts is, both ways, the distance from each place of
the shaped path to the nearest place of the planned one, and from each place of the planned path
(a corner, a turning point) to the nearest place of the shaped one. Only places that belong
together in time are compared, because paths cross and retrace themselves: a shaped place is made
of planned ones at most one train earlier.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import OptionError, PlanError
from threadline.machine import Machine
from threadline.shaping.rests import with_rests
from threadline.shaping.vibration import compiled
from threadline.trajectory import Trajectory, TrajectoryBlock

_CHUNK = 1 << 14
SAMPLES_PER_TRAIN = 128
"""Samples within the duration of the train: a chord between two strays from a curve that is
followed with acceleration a by a (duration / 128)^2 / 8."""


@dataclass(frozen=True, slots=True)
class ShapingDeviation:
    """The worst place of a shaped motion.

    Parameters
    ----------
    at_tool_m
        Largest distance at the tool, rotary axes at their radius.
    missed
        True where a planned place is passed by, False where the shaped path strays.
    time_s, operation
        Of the shaped motion, there; of a planned place that is missed, the planned time with
        its rests made longer.
    position
        (axes,) there, m or rad.
    """

    at_tool_m: float
    missed: bool
    time_s: float
    operation: int
    position: tuple[float, ...]

    def within(self, tolerance_m: float) -> bool:
        """Say whether the deviation is at most ``tolerance_m``."""
        return self.at_tool_m <= tolerance_m


def shaping_deviation(
    planned: Trajectory, shaped: Trajectory, machine: Machine, duration_s: float
) -> ShapingDeviation:
    """Measure how far ``shaped`` leaves the path of ``planned``, in bounded memory.

    Parameters
    ----------
    planned, shaped
        Before and after :func:`threadline.shaping.shape_trajectory`.
    machine
        Gives the radius at which rotary axes act.
    duration_s
        The longest delay of any axis: :func:`threadline.shaping.longest_delay_s`.

    Raises
    ------
    OptionError
        If ``duration_s`` is negative.
    PlanError
        If the axes differ.
    """
    if planned.axes != shaped.axes:
        raise PlanError(
            f"shaped axes {', '.join(shaped.axes)} are not the planned ones, "
            f"{', '.join(planned.axes)}"
        )
    if not duration_s >= 0.0:
        raise OptionError(f"shaping deviation: duration_s must be >= 0, got {duration_s!r}")
    if duration_s == 0.0:
        return ShapingDeviation(0.0, False, 0.0, 0, tuple(0.0 for _ in planned.axes))
    radius = machine.radius_m[[machine.axis_names.index(axis) for axis in planned.axes]]
    step = duration_s / SAMPLES_PER_TRAIN
    before = _Samples(_stretched(planned, duration_s), radius, step)
    after = _Samples(iter(shaped), radius, step)
    reach = SAMPLES_PER_TRAIN + 2
    worst = _Worst()
    first = 0
    while True:
        after.read(first + _CHUNK + reach)
        before.read(first + _CHUNK + reach)
        count = min(_CHUNK, max(after.end, before.end) - first)
        if count <= 0:
            break
        for missed, mine, other, back, ahead in (
            (False, after, before, reach, 2),
            (True, before, after, 2, reach),
        ):
            distance = _distances(
                mine.rows(first, count), other.rows(first - back, count + back + ahead), back, ahead
            )
            at = int(np.argmax(distance))
            worst.take(float(distance[at]), first + at, mine, missed=missed)
        first += count
        after.drop(first - reach)
        before.drop(first - reach)
    return worst.deviation(step, radius)


def _stretched(planned: Trajectory, hold_s: float) -> Iterator[TrajectoryBlock]:
    for pieces in with_rests(iter(planned), hold_s):
        yield TrajectoryBlock(
            start_s=pieces.start_s,
            duration_s=pieces.duration_s,
            coefficients=pieces.coefficients,
            operation=pieces.operation,
        )


class _Samples:
    """Places at the tool every ``step_s``, held from before the start until after the end."""

    def __init__(self, blocks: Iterator[TrajectoryBlock], radius: FloatArray, step_s: float):
        self._blocks, self._radius, self._step = blocks, radius, step_s
        self._first = 0  # index of the first row in hand
        self._rows = np.zeros((0, len(radius)))
        self._operation = np.zeros(0, dtype=np.int64)
        self._last: TrajectoryBlock | None = None
        self.ended = False

    @property
    def end(self) -> int:
        """Index behind the last sample that has been read."""
        return self._first + len(self._rows)

    def read(self, until: int) -> None:
        """Read samples up to index ``until``, or to the end of the trajectory."""
        while not self.ended and self.end < until:
            block = next(self._blocks, None)
            if block is None:
                self.ended = True
                if self._last is not None:
                    self._append(self._last, np.array([self._last.end_s]))
                return
            self._last = block
            first = self.end
            stop = max(first, int(np.ceil(block.end_s / self._step)))
            for begin in range(first, stop, _CHUNK):
                index = np.arange(begin, min(begin + _CHUNK, stop))
                self._append(block, np.asarray(index * self._step, dtype=np.float64))

    def _append(self, block: TrajectoryBlock, time_s: FloatArray) -> None:
        at = np.clip(np.searchsorted(block.start_s, time_s, side="right") - 1, 0, None)
        self._rows = np.concatenate([self._rows, block.evaluate(time_s) * self._radius])
        self._operation = np.concatenate([self._operation, block.operation[at]])

    def rows(self, first: int, count: int) -> FloatArray:
        """Return (count, axes) samples; the ends stand for what is beyond them."""
        at = np.clip(np.arange(first, first + count) - self._first, 0, len(self._rows) - 1)
        return self._rows[at]

    def operation(self, index: int) -> int:
        """Return the operation at a sample in hand."""
        return int(self._operation[min(index - self._first, len(self._rows) - 1)])

    def drop(self, until: int) -> None:
        """Let go of samples before index ``until``, but keep the last."""
        count = min(max(until - self._first, 0), len(self._rows) - 1)
        self._rows, self._operation = self._rows[count:], self._operation[count:]
        self._first += count


@dataclass(slots=True)
class _Worst:
    distance: float = -1.0
    index: int = 0
    missed: bool = False
    operation: int = 0
    place: FloatArray | None = None

    def take(self, distance: float, index: int, source: _Samples, *, missed: bool) -> None:
        if distance > self.distance:
            self.distance, self.index, self.missed = distance, index, missed
            self.operation = source.operation(index)
            self.place = source.rows(index, 1)[0]

    def deviation(self, step_s: float, radius: FloatArray) -> ShapingDeviation:
        place = np.zeros(len(radius)) if self.place is None else self.place / radius
        return ShapingDeviation(
            max(0.0, self.distance),
            self.missed,
            self.index * step_s,
            self.operation,
            tuple(place.tolist()),
        )


@compiled
def _distances(points: FloatArray, chain: FloatArray, back: int, ahead: int) -> FloatArray:
    """(n,) distance of point i to the chords of ``chain`` rows i ... i + back + ahead."""
    axes = points.shape[1]
    out = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        best = np.inf
        for j in range(i, i + back + ahead - 1):
            along, square = 0.0, 0.0
            for a in range(axes):
                way = chain[j + 1, a] - chain[j, a]
                along += way * (points[i, a] - chain[j, a])
                square += way * way
            u = min(1.0, max(0.0, along / square)) if square > 0.0 else 0.0
            distance = 0.0
            for a in range(axes):
                off = points[i, a] - chain[j, a] - u * (chain[j + 1, a] - chain[j, a])
                distance += off * off
            best = min(best, distance)
        out[i] = np.sqrt(best)
    return out
