"""Deviation of a shaped motion from its path, and the rests that it needs.

A delay along the path is no deviation. The deviation is measured in both directions: from each
point of the shaped path to the nearest point of the planned path, and from each point of the
planned path, such as a corner or a turning point, to the nearest point of the shaped path. Paths
cross and retrace themselves, so only points close in time are compared: a shaped point depends only
on the planned points within one duration of the train before it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import OptionError, PlanError
from threadline.machine import Machine
from threadline.motion.shaping.response import compiled
from threadline.motion.timing import Trajectory
from threadline.motion.timing.types import TrajectoryBlock

_AT_REST = 1e-9
"""Largest speed at a joint that counts as zero, over the piece's distance per time."""


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Pieces of a trajectory.

    Parameters
    ----------
    start_s, duration_s, coefficients, operation
        As for a trajectory block.
    run
        (n,) 1 if a piece begins after a prolonged rest, else 0.
    """

    start_s: FloatArray
    duration_s: FloatArray
    coefficients: FloatArray
    operation: IntArray
    run: IntArray

    def __len__(self) -> int:
        return len(self.start_s)

    @property
    def end_s(self) -> float:
        """End of the last piece."""
        return float(self.start_s[-1] + self.duration_s[-1])

    @property
    def still(self) -> NDArray[np.bool_]:
        """(n,) True if the machine stands still in a piece."""
        return np.asarray((self.coefficients[:, 1:] == 0.0).all(axis=(1, 2)))

    def rows(self, first: int, stop: int) -> Pieces:
        """Return some of the pieces."""
        part = slice(first, stop)
        return Pieces(
            self.start_s[part],
            self.duration_s[part],
            self.coefficients[part],
            self.operation[part],
            self.run[part],
        )


def joined(first: Pieces | None, second: Pieces) -> Pieces:
    """Return two runs of pieces joined, with the higher polynomial order."""
    if first is None or not len(first):
        return second
    order = max(first.coefficients.shape[1], second.coefficients.shape[1])
    return Pieces(
        np.concatenate([first.start_s, second.start_s]),
        np.concatenate([first.duration_s, second.duration_s]),
        np.concatenate([padded(first.coefficients, order), padded(second.coefficients, order)]),
        np.concatenate([first.operation, second.operation]),
        np.concatenate([first.run, second.run]),
    )


def padded(coefficients: FloatArray, order: int) -> FloatArray:
    """Return coefficients with zeros up to ``order``."""
    missing = order - coefficients.shape[1]
    return np.pad(coefficients, ((0, 0), (0, missing), (0, 0))) if missing > 0 else coefficients


def with_rests(blocks: Iterator[TrajectoryBlock], hold_s: float) -> Iterator[Pieces]:
    """Yield the pieces of a trajectory; every rest for an operation is longer by ``hold_s``.

    At such a rest the numbers of the operations skip one or more, because operations between two
    moves, such as an output, have no piece of motion. They need the machine at rest. If the rest
    has a piece at standstill, such as a dwell, the piece is prolonged; otherwise a piece is
    inserted.
    """
    held_back: Pieces | None = None
    delay_s = 0.0
    for block in blocks:
        if not len(block):
            continue
        block_pieces = Pieces(
            block.start_s + delay_s,
            block.duration_s,
            block.coefficients,
            block.operation,
            np.zeros(len(block), dtype=np.int64),
        )
        pieces = joined(held_back, block_pieces)
        if hold_s > 0.0:
            pieces, added_s = _prolonged_rests(pieces, hold_s)
            delay_s += added_s
        # The last piece is held back, because the next block may show that it must be prolonged.
        if len(pieces) > 1:
            yield pieces.rows(0, len(pieces) - 1)
        held_back = pieces.rows(len(pieces) - 1, len(pieces))
    if held_back is not None:
        yield held_back


def _prolonged_rests(pieces: Pieces, hold_s: float) -> tuple[Pieces, float]:
    """Return the pieces with their rests prolonged, and the total added time."""
    rest_ends = np.flatnonzero(_rest_before(pieces))
    if not len(rest_ends):
        return pieces, 0.0
    duration = np.array(pieces.duration_s)
    run = np.array(pieces.run)
    run[rest_ends] = 1
    still = pieces.still
    standing_rests = rest_ends[still[rest_ends - 1]]
    duration[standing_rests - 1] += hold_s
    delays_s = np.zeros(len(pieces))
    delays_s[rest_ends] = hold_s
    start = pieces.start_s + np.cumsum(delays_s)
    inserted = rest_ends[~still[rest_ends - 1]]
    standstill = np.zeros((len(inserted), *pieces.coefficients.shape[1:]))
    standstill[:, 0] = pieces.coefficients[inserted - 1].sum(axis=1)
    stretched = Pieces(
        np.insert(start, inserted, start[inserted] - hold_s),
        np.insert(duration, inserted, hold_s),
        np.insert(pieces.coefficients, inserted, standstill, axis=0),
        np.insert(pieces.operation, inserted, pieces.operation[inserted - 1]),
        np.insert(run, inserted, 0),
    )
    return stretched, hold_s * len(rest_ends)


def _rest_before(pieces: Pieces) -> NDArray[np.bool_]:
    """Return (n,) True if the operations skip after a dwell, or between two pieces at rest."""
    skips = np.diff(pieces.operation, prepend=pieces.operation[:1]) > 1
    if not skips.any():
        return np.asarray(skips)
    c = pieces.coefficients
    power = np.arange(c.shape[1])
    distance = np.abs(c[:, 1:]).sum(axis=1) + 1e-300
    ends_at_rest = np.abs((c * power[None, :, None]).sum(axis=1)) <= _AT_REST * distance
    begins_at_rest = (
        np.abs(c[:, 1]) <= _AT_REST * distance if c.shape[1] > 1 else np.ones_like(ends_at_rest)
    )
    comes_to_rest = np.concatenate([[False], ends_at_rest[:-1].all(axis=1)]) & begins_at_rest.all(
        axis=1
    )
    # The speed of historical motion jumps from 0 after a dwell; the dwell is still a rest.
    dwelt = np.concatenate([[False], pieces.still[:-1]])
    return np.asarray(skips & (dwelt | comes_to_rest))


_CHUNK = 1 << 14
SAMPLES_PER_TRAIN = 128
"""Number of samples within the duration of the train. With an acceleration a, the chord between two
samples deviates from the curve by a (duration / 128)^2 / 8."""


@dataclass(frozen=True, slots=True)
class ShapingDeviation:
    """The worst place of a shaped motion.

    Parameters
    ----------
    at_tool_m
        Largest distance at the tool, rotary axes at their radius.
    missed
        True if a planned point is missed, False if the shaped path deviates.
    time_s, operation
        Time and operation of the shaped motion at the worst place; for a missed planned point, the
        time in the planned motion with prolonged rests.
    position
        (axes,) position at the worst place, m or rad.
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
    """Measure the deviation of ``shaped`` from the path of ``planned``, in bounded memory.

    Parameters
    ----------
    planned, shaped
        Trajectory before and after :func:`threadline.motion.shaping.shape_trajectory`.
    machine
        Machine with the radius at which rotary axes act.
    duration_s
        The longest delay of any axis: :func:`threadline.motion.shaping.longest_delay_s`.

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
    planned_samples = _Samples(_with_prolonged_rests(planned, duration_s), radius, step)
    shaped_samples = _Samples(iter(shaped), radius, step)
    reach_rows = SAMPLES_PER_TRAIN + 2
    worst = _Worst()
    first_row = 0
    while True:
        shaped_samples.read(first_row + _CHUNK + reach_rows)
        planned_samples.read(first_row + _CHUNK + reach_rows)
        row_count = min(_CHUNK, max(shaped_samples.end, planned_samples.end) - first_row)
        if row_count <= 0:
            break
        for missed, points, chain, rows_back, rows_ahead in (
            (False, shaped_samples, planned_samples, reach_rows, 2),
            (True, planned_samples, shaped_samples, 2, reach_rows),
        ):
            distance = _distances(
                points.rows(first_row, row_count),
                chain.rows(first_row - rows_back, row_count + rows_back + rows_ahead),
                rows_back,
                rows_ahead,
            )
            farthest = int(np.argmax(distance))
            worst.take(float(distance[farthest]), first_row + farthest, points, missed=missed)
        first_row += row_count
        shaped_samples.drop(first_row - reach_rows)
        planned_samples.drop(first_row - reach_rows)
    return worst.deviation(step, radius)


def _with_prolonged_rests(planned: Trajectory, hold_s: float) -> Iterator[TrajectoryBlock]:
    for pieces in with_rests(iter(planned), hold_s):
        yield TrajectoryBlock(
            start_s=pieces.start_s,
            duration_s=pieces.duration_s,
            coefficients=pieces.coefficients,
            operation=pieces.operation,
        )


class _Samples:
    """Positions at the tool every ``step_s``, held before the start and after the end."""

    def __init__(self, blocks: Iterator[TrajectoryBlock], radius: FloatArray, step_s: float):
        self._blocks, self._radius, self._step = blocks, radius, step_s
        self._first = 0  # index of the first buffered row
        self._rows = np.zeros((0, len(radius)))
        self._operation = np.zeros(0, dtype=np.int64)
        self._last: TrajectoryBlock | None = None
        self.exhausted = False

    @property
    def end(self) -> int:
        """Index after the last sample that has been read."""
        return self._first + len(self._rows)

    def read(self, until: int) -> None:
        """Read samples up to index ``until``, or to the end of the trajectory."""
        while not self.exhausted and self.end < until:
            block = next(self._blocks, None)
            if block is None:
                self.exhausted = True
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
        piece = np.clip(np.searchsorted(block.start_s, time_s, side="right") - 1, 0, None)
        self._rows = np.concatenate([self._rows, block.evaluate(time_s) * self._radius])
        self._operation = np.concatenate([self._operation, block.operation[piece]])

    def rows(self, first: int, count: int) -> FloatArray:
        """Return (count, axes) samples; the ends stand for samples beyond them."""
        row = np.clip(np.arange(first, first + count) - self._first, 0, len(self._rows) - 1)
        return self._rows[row]

    def operation(self, index: int) -> int:
        """Return the operation at a buffered sample."""
        return int(self._operation[min(index - self._first, len(self._rows) - 1)])

    def drop(self, until: int) -> None:
        """Discard samples before index ``until``, but keep the last."""
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
    """Return (n,) distances of point i from the chords of rows i to i + back + ahead."""
    axes = points.shape[1]
    out = np.empty(points.shape[0])
    for i in range(points.shape[0]):
        least2 = np.inf
        for j in range(i, i + back + ahead - 1):
            projection, chord2 = 0.0, 0.0
            for a in range(axes):
                chord = chain[j + 1, a] - chain[j, a]
                projection += chord * (points[i, a] - chain[j, a])
                chord2 += chord * chord
            u = min(1.0, max(0.0, projection / chord2)) if chord2 > 0.0 else 0.0
            distance2 = 0.0
            for a in range(axes):
                component = points[i, a] - chain[j, a] - u * (chain[j + 1, a] - chain[j, a])
                distance2 += component * component
            least2 = min(least2, distance2)
        out[i] = np.sqrt(least2)
    return out
