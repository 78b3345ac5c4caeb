"""The fastest motion along a planned path as polynomials in time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.motion.path.types import PieceBlock, PlannedPath
from threadline.motion.timing.optimal.along_path import with_acceleration
from threadline.motion.timing.optimal.elements import DENSE, PiecesAhead
from threadline.motion.timing.optimal.first_guess import straight_run
from threadline.motion.timing.optimal.followers import Follower, Past
from threadline.motion.timing.optimal.following_error import followed
from threadline.motion.timing.optimal.in_time import in_time
from threadline.motion.timing.optimal.motion_limits import Limits, limits_of
from threadline.motion.timing.optimal.run_elements import run_elements
from threadline.motion.timing.optimal.solve import fastest
from threadline.motion.timing.optimal.windows import ADDED, SEEN, windowed
from threadline.motion.timing.types import TrajectoryBlock, held_block

if TYPE_CHECKING:
    from threadline.machine import Machine

MOST_PIECES = ADDED + SEEN
"""Pieces of one run that are solved together; a longer run is planned in windows."""
MOST_FOLLOWED = 20_000
"""Pieces of one run whose loads follow; a longer run rests in between."""
GAP = 1e-4


def fastest_blocks(
    path: PlannedPath,
    machine: Machine,
    contour_m: float = np.inf,
    *,
    of_loads: bool = False,
    along_m_s2: float = np.inf,
) -> Iterator[TrajectoryBlock]:
    """Yield the fastest trajectory of ``path`` within the limits of the axes and their drives.

    Parameters
    ----------
    contour_m
        Allowed contour error of the loads due to their loops, at the tool; infinite for no limit.
    of_loads
        Whether the loads follow the trajectory, not the motors.
    along_m_s2
        Largest acceleration along the path, at the tool; infinite for none.
    """
    follower = follower_of(path, machine, contour_m) if np.isfinite(contour_m) else None
    if follower is not None and all(answer is None for answer in follower.answers):
        follower = None  # none of these axes has a known loop
    limits = limits_of(machine, path.axes, path.radius_m, of_loads=of_loads)
    limits = replace(limits, along=with_acceleration(limits.along, along_m_s2, path.radius_m))
    yield from limited_blocks(path, limits, follower)


def follower_of(path: PlannedPath, machine: Machine, contour_m: float) -> Follower:
    """Return the loop models of a machine whose loads follow ``path``."""
    from threadline.dynamics.responses import answers_of  # it brings the models of machines

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
    now_s = 0.0
    past = Past(0.0 if follower is None else follower.memory_s)
    ahead = PiecesAhead(path)
    limits_with_length = limits.with_length()
    most_pieces = max(DENSE, MOST_PIECES) if follower is None else MOST_FOLLOWED
    while (run := ahead.take(most_pieces)) is not None:
        if follower is None and len(run) > MOST_PIECES:
            ahead.put_back(run)
            dense = not run.rest_after[-1]
            del run  # free its memory, which may be large
            run, now_s = yield from windowed(
                ahead, path.radius_m, limits_with_length, GAP, now_s, dense=dense
            )
            if run is None:
                return
            dwell_s, operation, end = _rest_after(run)
        else:
            dwell_s, operation, end = _rest_after(run)
            block = None
            if follower is None and len(run) == 1 and not run.coefficients[0, 2:].any():
                block = _line(run, limits, now_s)
            if (
                block is None
                and (shape := run_elements(run, path.radius_m, limits_with_length)) is not None
            ):
                del run  # likewise
                elements = shape.elements
                del shape
                if follower is None:
                    block = in_time(
                        fastest(elements, limits_with_length, GAP), limits_with_length, now_s
                    )
                else:
                    block = followed(elements, limits_with_length, follower, past, now_s)
            if block is not None:
                now_s = block.end_s
                past.add(block)
                yield block
        if dwell_s > 0.0:
            rest_block = held_block(end, now_s, dwell_s, operation)
            past.add(rest_block)
            yield rest_block
            now_s += dwell_s


def _rest_after(run: PieceBlock) -> tuple[float, int, FloatArray]:
    """Return the rest time at the end of a run, its operation, and the position."""
    return (
        float(run.dwell_s[-1]),
        int(run.operation[-1]),
        np.asarray(run.coefficients[-1].sum(axis=0)),
    )


def _line(run: PieceBlock, limits: Limits, begin_s: float) -> TrajectoryBlock | None:
    """Return the motion along a run that is one straight line, if a closed form is known."""
    if not run.coefficients[0, 1].any():
        return None
    return straight_run(
        run.coefficients[0], run.nominal_s[0], int(run.operation[0]), limits, begin_s
    )
