"""The planned motion as a job of short timed moves, for a controller that follows moves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from math import comb, degrees, radians
from operator import sub
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.files import Stream
from threadline.jobs.operations import (
    Dwell,
    Feed,
    FeedMode,
    Job,
    Move,
    Operation,
    Source,
    ToolEvent,
)
from threadline.machine import Machine
from threadline.motion.timing.types import Trajectory

CHORD_TOLERANCE_M = 1e-5
_DECIMALS = 6  # decimals of a millimetre or a degree: far below the chord tolerance
_PARTS_OF_UNIT = 1_000_000
_STANDS = 1e-12  # m or rad: motion of a piece at its first velocity, if the axes stand there
_STAYS = 1e-9  # m or rad: a path leaves out a vertex this close to the previous one


def planned_job(
    job: Job, trajectory: Trajectory, machine: Machine, tolerance_m: float = CHORD_TOLERANCE_M
) -> Job:
    """Return ``job`` with its moves replaced by chords of ``trajectory``, each with its time.

    All other operations keep their places, dwells included. Actions at the start of a move happen
    at the start of its first chord.

    Parameters
    ----------
    job, trajectory, machine
        Job, its planned trajectory, and the machine of the plan.
    tolerance_m
        Largest distance between chord and trajectory at the same instant, per axis. The distance of
        a rotary axis is measured at its radius.

    Notes
    -----
    End points are rounded to 1e-6 mm and degrees as absolute positions, so errors do not add up.
    Linear interpolation over a step h has an error of at most h^2 max|f''| / 8.
    """
    return replace(job, operations=Stream(_operations, job, trajectory, machine, tolerance_m))


def _operations(
    job: Job, trajectory: Trajectory, machine: Machine, tolerance_m: float
) -> Iterator[Operation]:
    return planned_operations(job, trajectory, machine, tolerance_m)


class ChordRun(NamedTuple):
    """Chords of one programmed move that follow each other.

    Parameters
    ----------
    ends
        (n, axes) end of each chord, m or rad, in the order of the job's axes.
    rates
        (n,) chords per second.
    feed
        Feed of the programmed move.
    source
        Its place.
    acts
        Actions at the start of the first chord.
    rests
        Whether the motion stands where the run begins.
    """

    ends: FloatArray
    rates: FloatArray
    feed: Feed | None
    source: Source
    acts: tuple[ToolEvent, ...]
    rests: bool


def planned_operations(
    job: Job, trajectory: Trajectory, machine: Machine, tolerance_m: float = CHORD_TOLERANCE_M
) -> Iterator[Operation]:
    """Yield the operations of ``planned_job``."""
    for item in planned_runs(job, trajectory, machine, tolerance_m):
        if not isinstance(item, ChordRun):
            yield item
            continue
        acts = item.acts
        for target, rate in zip(item.ends.tolist(), item.rates.tolist(), strict=True):
            feed = Feed(FeedMode.INVERSE_TIME, rate)
            yield Move(tuple(target), feed, item.source, acts=acts)
            acts = ()


def planned_runs(
    job: Job, trajectory: Trajectory, machine: Machine, tolerance_m: float = CHORD_TOLERANCE_M
) -> Iterator[Operation | ChordRun]:
    """Yield the operations of ``planned_job``, with the chords of each programmed move in runs."""
    column = [machine.axis_names.index(axis) for axis in trajectory.axes]
    radius = machine.radius_m[column]
    order = [trajectory.axes.index(axis) for axis in job.axes]
    linear = [machine.axes[axis].kind == "linear" for axis in job.axes]
    merged = _Merged(job)
    for block in trajectory:
        moves = _moving(block.coefficients)
        parts = _parts(block.coefficients, radius, tolerance_m)
        other = np.diff(block.operation) != 0
        new = np.flatnonzero(other | np.diff(moves) | ~moves[1:]) + 1
        edges = [0, *new.tolist(), len(moves)]
        for begin, end in pairwise(edges):
            yield from merged.before(int(block.operation[begin]))
            if not moves[begin]:
                if not merged.dwells_next():
                    yield Dwell(float(block.duration_s[begin]), merged.source)
                continue
            count = parts[begin:end]
            ends = _ends(block.coefficients[begin:end], count)[:, order]
            rates = np.repeat(count / block.duration_s[begin:end], count)
            rests = bool(np.abs(block.coefficients[begin, 1]).max() <= _STANDS)
            yield ChordRun(
                _rounded(ends, linear), rates, merged.feed, merged.source, merged.acts, rests
            )
            merged.acts = ()
    yield from merged.rest()


def _moving(coefficients: FloatArray) -> NDArray[np.bool_]:
    """Return which of (N, degree + 1, A) pieces move, column by column: their rows are short."""
    moving = np.zeros(len(coefficients), dtype=np.bool_)
    for column in coefficients[:, 1:].reshape(len(coefficients), -1).T:
        moving |= column != 0.0
    return moving


def _ends(coefficients: FloatArray, parts: NDArray[np.int64]) -> FloatArray:
    """Return the ends of all chords of (N, degree + 1, A) pieces, each in (N,) equal parts."""
    behind = np.cumsum(parts)
    ends = np.empty((int(behind[-1]), coefficients.shape[2]))
    for count in np.unique(parts).tolist():
        pieces = np.flatnonzero(parts == count)
        rows = (behind[pieces] - count)[:, None] + np.arange(count)
        ends[rows] = _powers(count, coefficients.shape[1]) @ coefficients[pieces]
    return ends


def _rounded(positions_si: FloatArray, linear: Sequence[bool]) -> FloatArray:
    """Return the nearest (n, axes) positions with few decimals in mm or degrees."""
    rounded = np.empty_like(positions_si)
    for k, straight in enumerate(linear):
        column = positions_si[:, k]
        if straight:
            rounded[:, k] = np.rint(column * 1e3 * _PARTS_OF_UNIT) / (1000 * _PARTS_OF_UNIT)
        else:
            rounded[:, k] = [radians(round(degrees(at), _DECIMALS)) for at in column.tolist()]
    return rounded


@lru_cache(maxsize=64)
def _powers(parts: int, count: int) -> FloatArray:
    """Return ``count`` powers of u at the ends of ``parts`` equal parts of [0, 1]."""
    u = np.arange(1, parts + 1) / parts
    powers: FloatArray = u[:, None] ** np.arange(count)
    powers.flags.writeable = False
    return powers


@lru_cache(maxsize=16)
def _second_bernstein(degree: int) -> FloatArray:
    """Return the matrix from powers of u to the Bernstein coefficients of the second derivative.

    It is (degree - 1, degree - 1): the constant and the linear term have none.
    """
    n = degree - 2
    matrix = np.array(
        [[(j + 2) * (j + 1) * comb(i, j) / comb(n, j) for i in range(n + 1)] for j in range(n + 1)]
    )
    matrix.flags.writeable = False
    return matrix


def _parts(coefficients: FloatArray, radius: FloatArray, tolerance_m: float) -> NDArray[np.int64]:
    """Return the (N,) numbers of chords for each of (N, degree + 1, A) pieces.

    A polynomial on [0, 1] lies between its smallest and largest Bernstein coefficient.
    """
    degree, axes = coefficients.shape[1] - 1, coefficients.shape[2]
    if degree < 2:
        return np.ones(len(coefficients), dtype=np.int64)
    # Axis by axis one product of matrices: many small products take five times as long.
    matrix = _second_bernstein(degree)
    bounds = np.zeros(len(coefficients))
    for axis in range(axes):
        second = np.abs(matrix.T * radius[axis] @ coefficients[:, 2:, axis].T)
        np.maximum(bounds, second.max(axis=0), out=bounds)
    parts: NDArray[np.int64] = np.ceil(np.sqrt(bounds / (8.0 * tolerance_m))).astype(np.int64)
    return np.maximum(parts, 1)


class _Merged:
    """Inserts the operations between moves while the pieces of the moves pass by."""

    def __init__(self, job: Job) -> None:
        self._operations = enumerate(job)
        self._waiting: list[tuple[int, Operation]] = []
        self._moves: dict[int, Move] = {}
        self._target = job.start
        self._read = -1
        self._exhausted = False
        self.source = Source(job.file, 0)
        self.feed: Feed | None = None
        self.acts: tuple[ToolEvent, ...] = ()  # actions of begun moves, for the next chord

    def _read_group_after(self, operation: int) -> None:
        """Read up to the first move after ``operation`` that changes the position.

        A move without travel has no pieces; the pause after it belongs to the move before.
        """
        while not self._exhausted and self._read <= operation:
            self._read, found = next(self._operations, (self._read, None))
            if found is None:
                self._exhausted = True
            elif isinstance(found, Move):
                self._moves[self._read] = found
                if max(map(abs, map(sub, found.target, self._target))) <= _STAYS:
                    operation = max(operation, self._read)
                self._target = found.target
            else:
                self._waiting.append((self._read, found))
                operation = max(operation, self._read)  # the group continues

    def before(self, operation: int) -> Iterator[Operation]:
        """Yield the operations before the pieces of ``operation``."""
        self._read_group_after(operation)
        for number in [k for k in self._moves if k <= operation]:
            move = self._moves.pop(number)
            while self._waiting and self._waiting[0][0] < number:
                yield from self._given()
            self.source, self.feed = move.source, move.feed
            self.acts += move.acts
        while self._waiting and self._waiting[0][0] < operation:
            yield from self._given()

    def _given(self) -> Iterator[Operation]:
        """Yield the actions of moves without travel, then the first waiting operation."""
        yield from self.acts
        self.acts = ()
        yield self._waiting.pop(0)[1]

    def dwells_next(self) -> bool:
        """Say whether the job has a dwell before its next move."""
        return any(isinstance(found, Dwell) for _, found in self._waiting)

    def rest(self) -> Iterator[Operation]:
        """Yield the operations after the last piece."""
        yield from self.before(1 << 62)
        yield from self.acts
