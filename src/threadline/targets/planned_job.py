"""The planned motion as a job of short timed moves: what a controller of moves can follow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from math import ceil, comb, degrees, radians, sqrt
from operator import sub

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
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
from threadline.signals import Stream
from threadline.trajectory.types import Trajectory

CHORD_TOLERANCE_M = 1e-5
_DECIMALS = 6  # of a millimetre or a degree: a nanometre is far below the chords' tolerance
_PARTS_OF_UNIT = 1_000_000
_STAYS = 1e-9  # m or rad: a path leaves out a vertex so near to the one before


def planned_job(
    job: Job, trajectory: Trajectory, machine: Machine, tolerance_m: float = CHORD_TOLERANCE_M
) -> Job:
    """Return ``job`` with its moves replaced by chords of ``trajectory``, each with its time.

    Everything but moves stays where it was, dwells included; what happens as a move begins happens
    as the first chord of that move does.

    Parameters
    ----------
    job, trajectory, machine
        What was planned.
    tolerance_m
        Largest distance of a chord from the trajectory at the same instant, per axis; a rotary
        axis acts at its radius.

    Notes
    -----
    Ends are rounded to 1e-6 mm and degrees, from where they are and not from each other.
    Linear interpolation over a step h is off by at most h^2 max|f''| / 8.
    """
    return replace(job, operations=Stream(_operations, job, trajectory, machine, tolerance_m))


def _operations(
    job: Job, trajectory: Trajectory, machine: Machine, tolerance_m: float
) -> Iterator[Operation]:
    return (item for item, _ in planned_operations(job, trajectory, machine, tolerance_m))


def planned_operations(
    job: Job, trajectory: Trajectory, machine: Machine, tolerance_m: float = CHORD_TOLERANCE_M
) -> Iterator[tuple[Operation, Feed | None]]:
    """Yield the operations of ``planned_job``, each chord with the feed of its programmed move."""
    column = [machine.axis_names.index(axis) for axis in trajectory.axes]
    radius = machine.radius_m[column]
    order = [trajectory.axes.index(axis) for axis in job.axes]
    linear = [machine.axes[axis].kind == "linear" for axis in job.axes]
    merged = _Merged(job)
    for block in trajectory:
        changes: NDArray[np.bool_] = block.coefficients[:, 1:] != 0.0
        pieces = zip(
            block.operation.tolist(),
            block.duration_s.tolist(),
            block.coefficients,
            [bool(piece.any()) for piece in changes],
            _parts(block.coefficients, radius, tolerance_m),
            strict=True,
        )
        for operation, duration_s, coefficients, moves, parts in pieces:
            yield from ((item, None) for item in merged.before(operation))
            if not moves:
                if not merged.dwells_next():
                    yield Dwell(duration_s, merged.source), None
                continue
            feed = Feed(FeedMode.INVERSE_TIME, parts / duration_s)
            ends = _powers(parts, len(coefficients)) @ coefficients
            for target in ends[:, order].tolist():
                rounded = tuple(map(_rounded, target, linear))
                yield Move(rounded, feed, merged.source, acts=merged.acts), merged.feed
                merged.acts = ()
    yield from ((item, None) for item in merged.rest())


def _rounded(position_si: float, linear: bool) -> float:
    """Return the nearest position that is a short decimal of mm or degrees."""
    if linear:
        return round(position_si * 1e3 * _PARTS_OF_UNIT) / (1000 * _PARTS_OF_UNIT)
    return radians(round(degrees(position_si), _DECIMALS))


@lru_cache(maxsize=64)
def _powers(parts: int, count: int) -> FloatArray:
    """Return the ``count`` powers of the ends of ``parts`` even parts of [0, 1]."""
    u = np.arange(1, parts + 1) / parts
    powers: FloatArray = u[:, None] ** np.arange(count)
    powers.flags.writeable = False
    return powers


def _parts(coefficients: FloatArray, radius: FloatArray, tolerance_m: float) -> list[int]:
    """Return into how many chords each of (N, degree + 1, A) pieces has to be divided.

    A polynomial on [0, 1] lies between its smallest and largest Bernstein coefficient.
    """
    second = coefficients * radius
    for _ in range(2):
        count = second.shape[1]
        second = second[:, 1:] * np.arange(1.0, count)[:, None] if count > 1 else 0.0 * second
    n = second.shape[1] - 1
    to_bernstein = [[comb(i, j) / comb(n, j) for j in range(n + 1)] for i in range(n + 1)]
    bounds = np.abs(np.array(to_bernstein) @ second).max(axis=(1, 2)).tolist()
    return [max(1, ceil(sqrt(bound / (8.0 * tolerance_m)))) for bound in bounds]


class _Merged:
    """Gives out what is not a move when the pieces of the moves around it pass by."""

    def __init__(self, job: Job) -> None:
        self._operations = enumerate(job)
        self._waiting: list[tuple[int, Operation]] = []
        self._moves: dict[int, Move] = {}
        self._target = job.start
        self._read = -1
        self._ended = False
        self.source = Source(job.file, 0)
        self.feed: Feed | None = None
        self.acts: tuple[ToolEvent, ...] = ()  # of the moves that have begun, for the next chord

    def _read_group_after(self, operation: int) -> None:
        """Read on to the first move behind ``operation`` that goes anywhere.

        A move that stays has no pieces of its own: the pause behind it stands at the move before.
        """
        while not self._ended and self._read <= operation:
            self._read, found = next(self._operations, (self._read, None))
            if found is None:
                self._ended = True
            elif isinstance(found, Move):
                self._moves[self._read] = found
                if max(map(abs, map(sub, found.target, self._target))) <= _STAYS:
                    operation = max(operation, self._read)
                self._target = found.target
            else:
                self._waiting.append((self._read, found))
                operation = max(operation, self._read)  # the group goes on

    def before(self, operation: int) -> Iterator[Operation]:
        """Yield what comes before the pieces of ``operation``."""
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
        """Yield the first that waits, behind what moves without a way of their own leave."""
        yield from self.acts
        self.acts = ()
        yield self._waiting.pop(0)[1]

    def dwells_next(self) -> bool:
        """Say whether a dwell of the job comes before its next move."""
        return any(isinstance(found, Dwell) for _, found in self._waiting)

    def rest(self) -> Iterator[Operation]:
        """Yield what comes after the last piece."""
        yield from self.before(1 << 62)
        yield from self.acts
