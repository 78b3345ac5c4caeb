"""The fastest motion along a planned path as polynomials in time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.machine import Machine
from threadline.path.runs import COINCIDENT_M
from threadline.path.types import PieceBlock, PlannedPath
from threadline.plant.closed_loop import answers_of
from threadline.trajectory.optimal.alone import line_alone
from threadline.trajectory.optimal.along_path import divided, with_acceleration, with_length
from threadline.trajectory.optimal.drives import limits_of
from threadline.trajectory.optimal.followers import Follower, Past
from threadline.trajectory.optimal.following_error import followed
from threadline.trajectory.optimal.in_time import in_time
from threadline.trajectory.optimal.path_elements import Elements, elements_of
from threadline.trajectory.optimal.solve import Limits, fastest
from threadline.trajectory.pieces import factors, slope
from threadline.trajectory.timed import held_block
from threadline.trajectory.types import TrajectoryBlock

BoolArray: TypeAlias = NDArray[np.bool_]

MOST_PIECES = 20_000
"""Pieces of one run that are solved together; where a run has more, the motion rests between."""
GAP = 1e-4
_TURNED = 1e-8  # of a line: by how much it may turn at its joint
_AT_SPEED = 0.1  # of the time until the axes have their speed: a lead-in lasts so long at it


def fastest_blocks(
    path: PlannedPath,
    machine: Machine,
    contour_m: float = np.inf,
    *,
    of_loads: bool = False,
    along_m_s2: float = np.inf,
) -> Iterator[TrajectoryBlock]:
    """Yield the fastest trajectory of ``path`` within what the axes and their drives can do.

    Parameters
    ----------
    contour_m
        How far the loads may be from the path while their loops follow the motion, at the tool;
        infinite where that is no limit.
    of_loads
        Whether loads are to follow it, and no motors.
    along_m_s2
        Most acceleration along the path, at the tool; infinite for none.
    """
    follower = follower_of(path, machine, contour_m) if np.isfinite(contour_m) else None
    if follower is not None and all(answer is None for answer in follower.answers):
        follower = None  # no loop of which anything is known follows these axes
    limits = limits_of(machine, path.axes, path.radius_m, of_loads=of_loads)
    limits = replace(limits, along=with_acceleration(limits.along, along_m_s2, path.radius_m))
    yield from limited_blocks(path, limits, follower)


def follower_of(path: PlannedPath, machine: Machine, contour_m: float) -> Follower:
    """Return what is known of the loops of a machine whose loads follow ``path``."""
    answers = answers_of(machine)
    return Follower(
        answers=tuple(answers.get(axis) for axis in path.axes),
        radius_m=path.radius_m,
        tolerance_m=contour_m,
    )


def least_time_s(path: PlannedPath, limits: Limits) -> float:
    """Return the duration of the fastest motion along ``path`` within ``limits``."""
    return max((block.end_s for block in limited_blocks(path, limits)), default=0.0)


def limited_blocks(
    path: PlannedPath, limits: Limits, follower: Follower | None = None
) -> Iterator[TrajectoryBlock]:
    """Yield the fastest trajectory of ``path`` within limits of its axes, and of their loops."""
    now = 0.0
    past = Past(0.0 if follower is None else follower.memory_s)
    runs = _runs(path)
    while (run := next(runs, None)) is not None:
        dwell_s, operation = float(run.dwell_s[-1]), int(run.operation[-1])
        end = run.coefficients[-1].sum(axis=0)
        moves = np.abs(run.coefficients[:, 1:]).max(axis=(1, 2)) > 0.0
        if moves.any():
            block = None
            if follower is None and len(run) == 1 and not run.coefficients[0, 2:].any():
                block = line_alone(
                    run.coefficients[0], run.nominal_s[0], int(run.operation[0]), limits, now
                )
            if block is None:
                within = limits.with_length()
                elements = _elements(run, path.radius_m, within)
                del run  # it is no longer needed, and there may be much of it
                if follower is None:
                    block = in_time(fastest(elements, within, GAP), within, now)
                else:
                    block = followed(elements, within, follower, past, now)
            now = block.end_s
            past.add(block)
            yield block
        if dwell_s > 0.0:
            still = held_block(end, now, dwell_s, operation)
            past.add(still)
            yield still
            now += dwell_s


def _runs(path: PlannedPath) -> Iterator[PieceBlock]:
    """Yield the pieces from rest to rest."""
    pending: list[PieceBlock] = []
    count = 0
    for block in path:
        first = 0
        for stop in [*(int(k) + 1 for k in np.flatnonzero(block.rest_after)), len(block)]:
            while first < stop:
                last = min(stop, first + MOST_PIECES - count)
                pending.append(_rows(block, first, last))
                count += last - first
                first = last
                if block.rest_after[last - 1] or count == MOST_PIECES:
                    count = 0
                    yield _taken(pending)
    if pending:
        yield _taken(pending)


def _taken(pending: list[PieceBlock]) -> PieceBlock:
    """Return all pieces and keep none: who reads a run may be done with them before its motion."""
    run = _joined(pending)
    pending.clear()
    return run


def _rows(block: PieceBlock, first: int, stop: int) -> PieceBlock:
    rows = slice(first, stop)
    return PieceBlock(
        coefficients=block.coefficients[rows],
        operation=block.operation[rows],
        nominal_s=block.nominal_s[rows],
        rest_after=block.rest_after[rows],
        dwell_s=block.dwell_s[rows],
        line=block.line[rows],
    )


def _joined(parts: list[PieceBlock]) -> PieceBlock:
    order = max(part.coefficients.shape[1] for part in parts)
    padded = [
        np.pad(p.coefficients, ((0, 0), (0, order - p.coefficients.shape[1]), (0, 0)))
        for p in parts
    ]
    return PieceBlock(
        coefficients=np.concatenate(padded),
        operation=np.concatenate([p.operation for p in parts]),
        nominal_s=np.concatenate([p.nominal_s for p in parts]),
        rest_after=np.concatenate([p.rest_after for p in parts]),
        dwell_s=np.concatenate([p.dwell_s for p in parts]),
        line=np.concatenate([p.line for p in parts]),
    )


def _beyond_rounding(run: PieceBlock, moves: BoolArray, radius_m: FloatArray) -> BoolArray:
    """Return ``moves`` without the pieces of no length at the start and the end of the run.

    Beside a chord of nanometres a spline has spans of femtometres: less than the rounding of a
    position, and no motion from rest along them has digits.
    """
    long = np.abs(run.coefficients[:, 1:] * radius_m).sum(axis=1).max(axis=1) > COINCIDENT_M
    inner = np.logical_or.accumulate(long) & np.logical_or.accumulate(long[::-1])[::-1]
    return moves & inner if inner.any() else moves


def _reach_ends(c: FloatArray, start: FloatArray, end: FloatArray) -> None:
    """Move the start of the first piece and the end of the last, in place: by 0.1 nm at most.

    A piece is bent by the third power of the way to its other end, so that it joins the next one as
    smoothly as before. A line that hardly turns by it is moved at its end and stays a line.
    """
    began, ended = start - c[0, 0], end - c[-1].sum(axis=0)
    for k, way, cubic in (
        (-1, ended, np.array([0.0, 0.0, 0.0, 1.0])),
        (0, began, np.array([1.0, -3.0, 3.0, -1.0])),
    ):
        if not way.any():
            continue
        line = not c[k, 2:].any()
        hardly = len(c) == 1 or np.abs(way).max() < _TURNED * np.abs(c[k, 1]).max()
        bend = np.array([cubic[0], 1.0 - 2.0 * cubic[0], 0.0, 0.0]) if line and hardly else cubic
        c[k] += bend[:, None] * way


def _elements(run: PieceBlock, radius_m: FloatArray, limits: Limits) -> Elements:
    """Return the elements of a run; with limits along the path, the way gone is their last axis."""
    if limits.along is not None:
        run = divided(run)
    moves = np.abs(run.coefficients[:, 1:]).max(axis=(1, 2)) > 0.0
    moves = _beyond_rounding(run, moves, radius_m)
    c = run.coefficients[moves].copy()
    if c.shape[1] < 4:
        c = np.pad(c, ((0, 0), (0, 4 - c.shape[1]), (0, 0)))
    _reach_ends(c, run.coefficients[0, 0], run.coefficients[-1].sum(axis=0))
    ratio, last = 1.0 / np.sqrt(factors(c, radius_m)[:-1]), slope(c[-1:])[0]
    if limits.along is not None:
        c = with_length(c, limits.along.radius_m)
        last = np.append(last, c[-1, :, -1] @ np.arange(6.0))
    return elements_of(
        c,
        ratio,
        run.nominal_s[moves],
        run.operation[moves],
        1.0,
        from_rest=True,
        to_rest=True,
        lead_share=(
            _lead_share(c[0, 1], run.nominal_s[moves][0], limits),
            _lead_share(last, run.nominal_s[moves][-1], limits),
        ),
    )


def _lead_share(rate: FloatArray, nominal_s: float, limits: Limits) -> float:
    """Return what a lead-in may be of a piece: what is gone until the axes have their speed.

    The speed is that of the feed, or of the limit of an axis. While the axes have not reached it,
    neither binds. A lead-in that is much longer has a speed that its elements follow badly.
    """
    least_s = max(nominal_s, float((np.abs(rate) / limits.velocity).max()))
    speed = np.abs(rate) / least_s
    rise_s = np.maximum(2.0 * np.sqrt(speed / limits.jerk), speed / limits.acceleration)
    return _AT_SPEED * float(rise_s.max()) / least_s
