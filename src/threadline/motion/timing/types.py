"""Axis positions over time: piecewise polynomials, so that every limit can be checked exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import prod

import numpy as np

from threadline.base.arrays import (
    FloatArray,
    IntArray,
    Locked,
    read_only,
    read_only_int,
    real_numbers,
)
from threadline.errors import PlanError
from threadline.files import Stream


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrajectoryBlock(Locked):
    """A run of consecutive polynomial pieces in time.

    Parameters
    ----------
    start_s
        (n,) when each piece starts, from the start of the trajectory; strictly increasing.
    duration_s
        (n,) > 0; piece i + 1 starts where piece i ends.
    coefficients
        (n, order, axes): position of piece i at ``start_s[i] + u * duration_s[i]`` is
        ``sum(coefficients[i, k] * u**k)`` for u in [0, 1], m or rad.
    operation
        (n,) int: the operation under way.
    """

    start_s: FloatArray
    duration_s: FloatArray
    coefficients: FloatArray
    operation: IntArray

    def __post_init__(self) -> None:
        for name in ("start_s", "duration_s"):
            object.__setattr__(self, name, read_only(getattr(self, name), name, ndim=1))
        object.__setattr__(
            self, "coefficients", read_only(self.coefficients, "coefficients", ndim=3)
        )
        object.__setattr__(self, "operation", read_only_int(self.operation, "operation", ndim=1))
        lengths = {len(self.start_s), len(self.duration_s), len(self.coefficients)}
        if len(lengths | {len(self.operation)}) > 1:
            raise ValueError("trajectory block has columns of unequal length")
        if len(self.duration_s) and not (self.duration_s > 0).all():
            raise ValueError("every piece must last longer than 0 s")

    def __len__(self) -> int:
        return len(self.start_s)

    @property
    def end_s(self) -> float:
        """Time at which the last piece ends, s."""
        return float(self.start_s[-1] + self.duration_s[-1])

    def evaluate(self, time_s: FloatArray, derivative: int = 0) -> FloatArray:
        """Return the (m, axes) ``derivative``-th time derivative at times within the block."""
        piece = np.searchsorted(self.start_s, time_s, side="right") - 1
        # For a few instants np.clip takes three times as long as both its halves.
        piece = np.minimum(np.maximum(piece, 0), len(self.start_s) - 1)
        duration = self.duration_s[piece]
        u = np.minimum(np.maximum((time_s - self.start_s[piece]) / duration, 0.0), 1.0)
        # One row per axis: loops over a short inner axis would take four times as long.
        result = np.zeros((self.coefficients.shape[2], len(time_s)))
        for k in range(self.coefficients.shape[1] - 1, derivative - 1, -1):
            column = self.coefficients[:, k].T.take(piece, axis=1)
            if derivative:
                column *= float(prod(range(k - derivative + 1, k + 1)))
            result *= u
            result += column
        if derivative:
            result /= duration**derivative
        return np.ascontiguousarray(result.T)


def _checked_times(time_s: FloatArray | float) -> FloatArray:
    try:
        times = np.atleast_1d(real_numbers(time_s))
    except (TypeError, ValueError) as error:
        raise PlanError(
            f"the times are {' '.join(repr(time_s).split())[:60]}; they must be numbers, in s",
            remedy="Give one time, or a list of them.",
        ) from error
    if times.ndim != 1:
        raise PlanError(
            f"the times have shape {times.shape}; they must be one number, or a row of them",
            remedy="Give times.ravel(), and reshape the result.",
        )
    wrong_times = np.flatnonzero(~np.isfinite(times))
    if len(wrong_times):
        raise PlanError(
            f"time {wrong_times[0]} is {times[wrong_times[0]].item()!r}; every time must be a "
            "finite number of seconds",
            remedy="Correct it, or leave it out.",
        )
    return times


_SPAN = "span_s"
"""Attribute in which a trajectory keeps its duration and its time of motion, once it was read."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """Axis positions over time, from rest to rest.

    Parameters
    ----------
    axes
        Names, in the order of the columns.
    blocks
        Re-iterable, consecutive from 0 s.
    historical
        As for the planned path.
    """

    axes: tuple[str, ...]
    blocks: Stream[TrajectoryBlock]
    historical: bool = False

    def __iter__(self) -> Iterator[TrajectoryBlock]:
        return iter(self.blocks) if _SPAN in self.__dict__ else self._first_reading()

    def _first_reading(self) -> Iterator[TrajectoryBlock]:
        """Yield the blocks; after the last keep duration and time of motion."""
        end_s, moves_s = 0.0, (0.0, 0.0)
        moved = False
        for block in self.blocks:
            end_s = block.end_s
            rates = block.coefficients[:, 1:]
            if rates[-1].any() and (moved or rates[0].any()):  # by far the most frequent case
                moves_s = moves_s[0] if moved else float(block.start_s[0]), end_s
                moved = True
            else:
                moving = (rates != 0.0).any(axis=(1, 2))
                if moving.any():
                    begin_s = moves_s[0] if moved else float(block.start_s[moving][0])
                    moves_s = begin_s, float((block.start_s + block.duration_s)[moving][-1])
                    moved = True
            yield block
        self.__dict__[_SPAN] = end_s, moves_s

    def _span_s(self) -> tuple[float, tuple[float, float]]:
        if _SPAN not in self.__dict__:
            for _ in self:
                pass
        span_s: tuple[float, tuple[float, float]] = self.__dict__[_SPAN]
        return span_s

    @property
    def duration_s(self) -> float:
        """Duration; reads the whole trajectory, unless it was read before."""
        return self._span_s()[0]

    @property
    def moves_s(self) -> tuple[float, float]:
        """Start of the motion and its final rest, s; read like ``duration_s``."""
        return self._span_s()[1]

    def __call__(self, time_s: FloatArray | float, derivative: int = 0) -> FloatArray:
        """Return the (m, axes) ``derivative``-th derivative at ``time_s``, held before and after.

        Times may come in any order; the trajectory is read once.

        Raises
        ------
        PlanError
            If ``time_s`` is neither a number nor a row of numbers, or one of them is not finite;
            or if ``derivative`` is no whole number from 0 on.
        """
        if not isinstance(derivative, int | np.integer) or derivative < 0:
            raise PlanError(
                f"the derivative is {derivative!r}; it must be a whole number from 0 on",
                remedy="0 is the place, 1 the velocity, 2 the acceleration.",
            )
        times_s = _checked_times(time_s)
        result = np.zeros((len(times_s), len(self.axes)))
        last_block = None
        for block in self:
            begin = -np.inf if last_block is None else float(block.start_s[0])
            inside = (times_s >= begin) & (times_s <= block.end_s)
            if inside.any():
                result[inside] = block.evaluate(times_s[inside], derivative)
            last_block = block
        if last_block is not None:
            is_after = times_s > last_block.end_s
            if is_after.any():
                end = np.full(int(is_after.sum()), last_block.end_s)
                result[is_after] = last_block.evaluate(end) if derivative == 0 else 0.0
        return result


class TrajectoryReader:
    """Reads position and derivatives of a trajectory at times that ``drop`` has not discarded.

    The trajectory is held at its first and last position before and after.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self._source = iter(trajectory)
        self._axes = len(trajectory.axes)
        self._blocks: list[TrajectoryBlock] = []
        self._exhausted = False

    def derivatives(self, time_s: FloatArray, orders: int) -> FloatArray:
        """Return the (n, orders, axes) position and derivatives at (n,) ascending times."""
        derivatives = np.zeros((len(time_s), orders, self._axes))
        if not len(time_s):
            return derivatives
        self._reach(float(time_s[-1]))
        if not self._blocks:
            return derivatives
        edges = np.searchsorted(time_s, [block.end_s for block in self._blocks], side="right")
        edges[-1] = len(time_s)
        begin = 0
        for block, end in zip(self._blocks, edges.tolist(), strict=True):
            if end > begin:
                part = slice(begin, end)
                for order in range(orders):
                    derivatives[part, order] = block.evaluate(time_s[part], order)
                begin = end
        outside = (time_s < self._blocks[0].start_s[0]) | (time_s > self._blocks[-1].end_s)
        derivatives[outside, 1:] = 0.0
        return derivatives

    def drop(self, before_s: float) -> None:
        """Discard pieces that end before an instant, except the last known block."""
        while len(self._blocks) > 1 and self._blocks[0].end_s < before_s:
            self._blocks.pop(0)

    def _reach(self, time_s: float) -> None:
        while not self._exhausted and (not self._blocks or self._blocks[-1].end_s < time_s):
            block = next(self._source, None)
            if block is None:
                self._exhausted = True
            elif len(block):
                self._blocks.append(block)


def held_block(
    position: FloatArray, begin_s: float, dwell_s: float, operation: int
) -> TrajectoryBlock:
    """Return a block that stands still."""
    coefficients = np.zeros((1, 4, len(position)))
    coefficients[0, 0] = position
    return TrajectoryBlock(
        start_s=np.array([begin_s]),
        duration_s=np.array([dwell_s]),
        coefficients=coefficients,
        operation=np.array([operation]),
    )
