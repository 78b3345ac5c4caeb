"""When and where the needle goes down, stitch by stitch, as planned."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.jobs.operations import FeedMode, Job, Move, MoveRun, ToolEvent
from threadline.plan import Plan
from threadline.trajectory.types import Trajectory, TrajectoryBlock

_ROUNDS = 3
_SEWN = frozenset({"stitch", "contour", "exempt", "target_m"})  # tags of every stitch of a seam


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stitches:
    """Consecutive stitches of a job, n of them.

    Parameters
    ----------
    operation, line
        (n,) of the move of each.
    contour
        (n,) number of the contour that it belongs to; a contour's first stitch has ``first``.
    first, exempt
        (n,) bool.
    point
        (n, axes) where the needle is to go down, lengths at the tool.
    from_point, from_s
        (n, axes) and (n,) the same of the needle-down before.
    down_s
        (n,) when it goes down, from the start of the trajectory.
    target_m, period_s
        (n,) wanted length, and programmed time of one turn of the needle.
    from_m, to_m
        (n,) the stretch of the drawn line that each covers; NaN where nothing is drawn.
    """

    operation: IntArray
    line: IntArray
    contour: IntArray
    first: NDArray[np.bool_]
    exempt: NDArray[np.bool_]
    point: FloatArray
    from_point: FloatArray
    from_s: FloatArray
    down_s: FloatArray
    target_m: FloatArray
    period_s: FloatArray
    from_m: FloatArray
    to_m: FloatArray

    def __len__(self) -> int:
        return len(self.operation)


def has_stitches(job: Job) -> bool:
    """Say whether the moves of a job carry the tags of a seam's stitches; reads up to the first.

    A seam begins with a tool event ``sew``. Part programs may name tags of their own, ``stitch``
    among them, without being seams.
    """
    for item in job.runs():
        if isinstance(item, ToolEvent) and item.name == "sew":
            return True
        if isinstance(item, Move) and item.tags.keys() >= _SEWN:
            return True
        if isinstance(item, MoveRun) and item.columns.keys() >= _SEWN:
            return True
    return False


def planned_stitches(plan: Plan) -> Iterator[Stitches]:
    """Yield the stitches of ``plan`` in runs, in one reading of the job and of its trajectory.

    The needle is geared with the motion: it is down when the commanded head is at the end of
    the stitch's move. The planner labels pieces on a grid of its own, so the instant is refined
    to where the trajectory is nearest to the stitch's point. Where the loads follow the motion by
    feed-forward the needle keeps the times before smoothing, which are those of the job.
    """
    motion = plan.motion.of_needle
    axes = [plan.motion.programmed.axes.index(axis) for axis in plan.job.axes]
    radius = plan.motion.programmed.radius_m[axes]
    moves = ((i, o) for i, o in enumerate(plan.job) if isinstance(o, Move))
    start = np.asarray(plan.job.start, dtype=np.float64)
    before_s, contour = 0.0, -1.0
    begun = False
    for block, operation, end_s in _operation_ends(_moving(motion)):
        if not begun:
            before_s, begun = float(block.start_s[0]), True
        taken: list[Move] = []
        index: list[int] = []
        for i, move in moves:
            taken.append(move)
            index.append(i)
            if i >= operation[-1]:
                break
        if not taken:
            return
        at = np.array(index, dtype=np.int64)
        points = np.array([move.target for move in taken], dtype=np.float64)
        # A move that goes nowhere has no piece of motion: it ends when the move before it ends.
        found = np.searchsorted(operation, at, side="right") - 1
        down = np.where(found >= 0, end_s[np.maximum(found, 0)], before_s)
        own = (found >= 0) & (operation[np.maximum(found, 0)] == at)
        columns = [motion.axes.index(axis) for axis in plan.job.axes]
        down[own] = _nearest_s(block, down[own], points[own] * radius, columns, radius)
        came_from = np.concatenate([start[None], points[:-1]])
        came_s = np.concatenate([[before_s], down[:-1]])
        start, before_s = points[-1], float(down[-1])
        sewn = np.array([move.tags.keys() >= _SEWN for move in taken], dtype=np.bool_)
        if not sewn.any():
            continue
        tags = [move.tags for move in taken if move.tags.keys() >= _SEWN]
        number = np.array([float(t["contour"]) for t in tags])
        before = np.concatenate([[contour], number[:-1]])
        contour = float(number[-1])
        yield Stitches(
            operation=at[sewn],
            line=np.array([m.source.line for m in taken], dtype=np.int64)[sewn],
            contour=number.astype(np.int64),
            first=number != before,
            exempt=np.array([bool(t["exempt"]) for t in tags]),
            point=points[sewn] * radius,
            from_point=came_from[sewn] * radius,
            from_s=came_s[sewn],
            down_s=down[sewn],
            target_m=np.array([float(t["target_m"]) for t in tags]),
            period_s=np.array([_period_s(m) for m in taken if m.tags.keys() >= _SEWN]),
            from_m=np.array([float(t.get("from_m", np.nan)) for t in tags]),
            to_m=np.array([float(t.get("to_m", np.nan)) for t in tags]),
        )


def _period_s(move: Move) -> float:
    if move.feed is None or move.feed.mode is not FeedMode.INVERSE_TIME:
        return float("nan")
    return 1.0 / move.feed.value


def _moving(trajectory: Trajectory) -> Iterator[TrajectoryBlock]:
    """Yield the pieces that move: the needle is down when a stitch ends, not its rest after it."""
    for block in trajectory:
        moves = (block.coefficients[:, 1:] != 0.0).any(axis=(1, 2))
        if moves.all():
            yield block
        elif moves.any():
            yield TrajectoryBlock(
                start_s=block.start_s[moves],
                duration_s=block.duration_s[moves],
                coefficients=block.coefficients[moves],
                operation=block.operation[moves],
            )


def _operation_ends(
    blocks: Iterable[TrajectoryBlock],
) -> Iterator[tuple[TrajectoryBlock, IntArray, FloatArray]]:
    """Yield, block by block, the operations that end in it and when."""
    held: TrajectoryBlock | None = None
    for block in blocks:
        if not len(block):
            continue
        if held is not None and block.operation[0] != held.operation[-1]:
            yield held, held.operation[-1:], np.array([held.end_s])
        change = np.flatnonzero(np.diff(block.operation))
        if len(change):
            ends = block.start_s[change] + block.duration_s[change]
            yield block, block.operation[change], ends
        held = block
    if held is not None:
        yield held, held.operation[-1:], np.array([held.end_s])


def _nearest_s(
    block: TrajectoryBlock,
    time_s: FloatArray,
    points: FloatArray,
    columns: list[int],
    radius: FloatArray,
) -> FloatArray:
    """Return (n,) when the trajectory is nearest to each point, about ``time_s``; Newton steps."""
    if not len(time_s):
        return time_s
    piece = np.clip(np.searchsorted(block.start_s, time_s, side="right") - 1, 0, len(block) - 1)
    reach = np.maximum(block.duration_s[piece], block.duration_s[np.maximum(piece - 1, 0)])
    low = np.maximum(time_s - reach, block.start_s[0])
    high = np.minimum(time_s + reach, block.end_s)
    at = time_s
    for _ in range(_ROUNDS):
        away = block.evaluate(at)[:, columns] * radius - points
        speed = block.evaluate(at, 1)[:, columns] * radius
        squared = (speed**2).sum(axis=1)
        step = np.zeros_like(at)
        np.divide((away * speed).sum(axis=1), squared, out=step, where=squared > 1e-12)
        at = np.clip(at - step, low, high)
    return at
