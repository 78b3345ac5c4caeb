"""When and where the needle goes down, stitch by stitch, as planned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from itertools import islice
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.jobs.operations import FeedMode, Job, Move, MoveRun, ToolEvent
from threadline.plan import Motion, Plan
from threadline.signals import KeptStream
from threadline.trajectory.types import Trajectory, TrajectoryBlock
from threadline.verdict.passing import Passing

_MOST_MOVES = 1024  # in hand at once
_ROUNDING = 1e-9  # of the time: pieces that are no farther apart than this meet
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
        (n,) wanted length, and programmed time of one turn of the needle; where the needle follows
        the head it is the planned one, from when the head departs.
    slowest_hz, fastest_hz
        (n,) between which speeds a needle turns that follows the head; NaN for any other.
    most_hz_s
        (n,) most that the speed of such a needle may change by, stitch/s^2; NaN without a limit.
    departs, stops
        (n,) bool: the head rests before the stitch, and after it.
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
    slowest_hz: FloatArray
    fastest_hz: FloatArray
    most_hz_s: FloatArray
    departs: NDArray[np.bool_]
    stops: NDArray[np.bool_]
    from_m: FloatArray
    to_m: FloatArray

    def __post_init__(self) -> None:
        for field in fields(self):
            getattr(self, field.name).flags.writeable = False

    def __len__(self) -> int:
        return len(self.operation)

    @property
    def follows(self) -> NDArray[np.bool_]:
        """(n,) whether the needle turns with the way of the head."""
        return ~np.isnan(self.fastest_hz)

    def rows(self, rows: slice) -> Stitches:
        """Return some of the stitches."""
        return Stitches(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


_FOUND: WeakKeyDictionary[Plan, KeptStream[Stitches]] = WeakKeyDictionary()
"""Stitches of the plans that there are: what finds them does not hold the plan."""


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

    The needle is geared with the motion: it is down when the commanded head passes the end of the
    stitch's move, in the order of the job. Where the loads follow the motion by feed-forward the
    needle keeps the times before smoothing, which are those of the job. The stitches of a short
    job are found once, however many measures and runs read them.
    """
    return iter(_FOUND.setdefault(plan, KeptStream(_found, plan.job, plan.motion)))


def _found(job: Job, intended: Motion) -> Iterator[Stitches]:
    motion = intended.of_needle
    axes = [intended.programmed.axes.index(axis) for axis in job.axes]
    radius = intended.programmed.radius_m[axes]
    columns = [motion.axes.index(axis) for axis in job.axes]
    start = np.asarray(job.start, dtype=np.float64) * radius
    moving = _Moving(motion)
    passing = Passing(moving, columns, radius, start)
    before_s, contour = passing.time_s, -1.0
    moves = _moves(job)
    waiting: list[tuple[int, Move, bool, bool]] = []
    while True:
        waiting += islice(moves, _MOST_MOVES - len(waiting))
        if not waiting:
            return
        points = np.array([move.target for _, move, *_ in waiting], dtype=np.float64) * radius
        down = passing.times(points)
        done = len(down)
        taken, waiting = waiting[:done], waiting[done:]
        points = points[:done]
        came_from = np.concatenate([start[None], points[:-1]])
        came_s = np.concatenate([[before_s], down[:-1]])
        start, before_s = points[-1], float(down[-1])
        sewn = np.array(["stitch" in move.tags for _, move, *_ in taken], dtype=np.bool_)
        if not sewn.any():
            continue
        stitched = [one for one in taken if "stitch" in one[1].tags]
        tags = [move.tags for _, move, *_ in stitched]
        number = np.array([float(t["contour"]) for t in tags])
        before = np.concatenate([[contour], number[:-1]])
        contour = float(number[-1])
        slowest, fastest, most = (
            np.array([float(t.get(name, np.nan)) for t in tags])
            for name in ("slowest_hz", "fastest_hz", "most_hz_s")
        )
        begins = np.array([begins for *_, begins, _ in stitched])
        from_s, down_s = came_s[sewn], down[sewn]
        programmed_s = np.array([_period_s(move) for _, move, *_ in stitched])
        planned_s = down_s - np.where(begins, moving.departs(from_s, down_s), from_s)
        yield Stitches(
            operation=np.array([one[0] for one in stitched], dtype=np.int64),
            line=np.array([one[1].source.line for one in stitched], dtype=np.int64),
            contour=number.astype(np.int64),
            first=number != before,
            exempt=np.array([bool(t["exempt"]) for t in tags]),
            point=points[sewn],
            from_point=came_from[sewn],
            from_s=from_s,
            down_s=down_s,
            target_m=np.array([float(t["target_m"]) for t in tags]),
            period_s=np.where(np.isnan(fastest), programmed_s, planned_s),
            slowest_hz=slowest,
            fastest_hz=fastest,
            most_hz_s=most,
            departs=begins,
            stops=np.array([ends for *_, ends in stitched]),
            from_m=np.array([float(t.get("from_m", np.nan)) for t in tags]),
            to_m=np.array([float(t.get("to_m", np.nan)) for t in tags]),
        )


def _period_s(move: Move) -> float:
    if move.feed is None or move.feed.mode is not FeedMode.INVERSE_TIME:
        return float("nan")
    return 1.0 / move.feed.value


def _moves(job: Job) -> Iterator[tuple[int, Move, bool, bool]]:
    """Yield the number of each move, the move, and whether the head rests before and after it."""
    rested, last = True, None
    for index, item in enumerate(job):
        moves = isinstance(item, Move)
        if last is not None:
            yield (*last, not moves)
        last = (index, item, rested) if isinstance(item, Move) else None
        rested = not moves
    if last is not None:
        yield (*last, True)


class _Moving:
    """The pieces that move: the needle is down when a stitch ends, not its rest after it.

    Parameters
    ----------
    trajectory
        With its rests.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self._source = trajectory
        self._departs_s: list[float] = []  # when the motion goes on after rests that take time

    def __iter__(self) -> Iterator[TrajectoryBlock]:
        end_s = 0.0
        for block in self._source:
            moves = (block.coefficients[:, 1:] != 0.0).any(axis=(1, 2))
            if not moves.any():
                continue
            start_s, duration_s = block.start_s[moves], block.duration_s[moves]
            before_s = np.append(end_s, (start_s + duration_s)[:-1])
            rests = np.flatnonzero(start_s - before_s > _ROUNDING * start_s)
            self._departs_s += start_s[rests].tolist()
            end_s = float(start_s[-1] + duration_s[-1])
            if moves.all():
                yield block
            else:
                yield TrajectoryBlock(
                    start_s=start_s,
                    duration_s=duration_s,
                    coefficients=block.coefficients[moves],
                    operation=block.operation[moves],
                )

    def departs(self, from_s: FloatArray, until_s: FloatArray) -> FloatArray:
        """Return (n,) when the head departs on stitches that begin with a rest.

        ``from_s`` and ``until_s`` are (n,) when it came to where each begins, and ends. What is
        over by the last of them is let go of.
        """
        found = np.array(from_s)
        departs = np.array(self._departs_s)
        if len(departs):
            at = np.minimum(np.searchsorted(departs, from_s, side="right"), len(departs) - 1)
            rest = (departs[at] > from_s) & (departs[at] < until_s)
            found[rest] = departs[at[rest]]
            over = int(np.searchsorted(departs, until_s[-1], side="left"))
            del self._departs_s[:over]
        return found
