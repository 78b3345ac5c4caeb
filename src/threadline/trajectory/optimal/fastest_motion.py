"""The fastest motion along a planned path as polynomials in time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from threadline.arrays import FloatArray
from threadline.machine import Machine
from threadline.path.types import PieceBlock, PlannedPath
from threadline.plant.closed_loop import answers_of
from threadline.trajectory.optimal.drives import limits_of
from threadline.trajectory.optimal.following_error import Follower, Past, followed
from threadline.trajectory.optimal.in_time import in_time
from threadline.trajectory.optimal.path_elements import Elements, elements_of
from threadline.trajectory.optimal.solve import Limits, fastest
from threadline.trajectory.pieces import factors
from threadline.trajectory.timed import held_block
from threadline.trajectory.types import TrajectoryBlock

MOST_PIECES = 20_000
"""Pieces of one run that are solved together; where a run has more, the motion rests between."""
GAP = 1e-4
_LEAD_RAMPS = 4.0  # of the time that the jerk takes: how long a lead-in lasts at the feed


def fastest_blocks(
    path: PlannedPath, machine: Machine, contour_m: float = np.inf, *, of_loads: bool = False
) -> Iterator[TrajectoryBlock]:
    """Yield the fastest trajectory of ``path`` within what the axes and their drives can do.

    Parameters
    ----------
    contour_m
        How far the loads may be from the path while their loops follow the motion, at the tool;
        infinite where that is no limit.
    of_loads
        Whether loads are to follow it, and no motors.
    """
    follower = follower_of(path, machine, contour_m) if np.isfinite(contour_m) else None
    yield from limited_blocks(path, limits_of(machine, path.axes, of_loads=of_loads), follower)


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
    for run in _runs(path):
        moves = np.abs(run.coefficients[:, 1:]).max(axis=(1, 2)) > 0.0
        if moves.any():
            elements = _elements(run, moves, path.radius_m, _LEAD_RAMPS * limits.ramp_s)
            if follower is None:
                block = in_time(fastest(elements, limits, GAP), limits, now)
            else:
                block = followed(elements, limits, follower, past, now)
            now = block.end_s
            past.add(block)
            yield block
        dwell_s = float(run.dwell_s[-1])
        if dwell_s > 0.0:
            end = run.coefficients[-1].sum(axis=0)
            still = held_block(end, now, dwell_s, int(run.operation[-1]))
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
                    yield _joined(pending)
                    pending, count = [], 0
    if pending:
        yield _joined(pending)


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


def _elements(
    run: PieceBlock,
    moves: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    radius_m: FloatArray,
    lead_s: float,
) -> Elements:
    c = run.coefficients[moves]
    if c.shape[1] < 4:
        c = np.pad(c, ((0, 0), (0, 4 - c.shape[1]), (0, 0)))
    return elements_of(
        c,
        1.0 / np.sqrt(factors(c, radius_m)[:-1]),
        run.nominal_s[moves],
        run.operation[moves],
        1.0,
        from_rest=True,
        to_rest=True,
        lead_s=lead_s,
    )
