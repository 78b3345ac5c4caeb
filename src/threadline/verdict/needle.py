"""When and where the needle goes down, stitch by stitch, as planned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Motion, Plan
from threadline.files import CachedStream
from threadline.jobs.operations import (
    Feed,
    FeedMode,
    Job,
    Move,
    MoveRun,
    ToolEvent,
    lacking,
    move_runs,
)
from threadline.motion.timing.types import Trajectory, TrajectoryBlock
from threadline.verdict.samples import PLANNED_RESOLUTION
from threadline.verdict.window import TrajectoryFollower

_MOST_MOVES = 1024  # in memory at once
_ROUNDING = 1e-9  # of the time: pieces no farther apart than this are adjacent
_TAGS = (
    "contour", "exempt", "target_m", "slowest_hz", "fastest_hz", "most_hz_s", "from_m", "to_m",
)  # fmt: skip
_SEWN = frozenset({"stitch", "contour", "exempt", "target_m"})  # tags of every stitch of a seam


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stitches:
    """Consecutive stitches of a job, n of them.

    Parameters
    ----------
    operation, line
        (n,) operation and job line of each stitch.
    contour
        (n,) number of its contour; the first stitch of a contour has ``first``.
    first, exempt
        (n,) bool.
    point
        (n, axes) intended needle-down point, lengths at the tool.
    from_point, from_s
        (n, axes) point and (n,) time of the previous needle-down.
    down_s
        (n,) time of the needle-down, from the start of the trajectory.
    target_m, period_s
        (n,) wanted length, and programmed time of one turn of the needle; for a needle that follows
        the head, the planned time from the departure of the head.
    slowest_hz, fastest_hz
        (n,) speed range of a needle that follows the head; NaN for any other needle.
    most_hz_s
        (n,) largest change rate of such a needle's speed, stitch/s^2; NaN without a limit.
    departs, stops
        (n,) bool: the head rests before the stitch, and after it.
    from_m, to_m
        (n,) stretch of the drawn line that each stitch covers; NaN without a drawing.
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
        """(n,) whether the needle turns with the motion of the head."""
        return ~np.isnan(self.fastest_hz)

    def rows(self, rows: slice) -> Stitches:
        """Return some of the stitches."""
        return Stitches(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


_FOUND: WeakKeyDictionary[Plan, CachedStream[Stitches]] = WeakKeyDictionary()
"""Stitches of existing plans; the entries do not keep a plan alive."""


def has_stitches(job: Job) -> bool:
    """Return whether the moves of a job have the tags of stitches; reads up to the first stitch.

    A seam begins with a tool event ``sew``. Part programs may name tags of their own, such as
    ``stitch``, without being seams.
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
    """Yield the stitches of ``plan`` in groups, in one reading of the job and its trajectory.

    The needle is geared to the motion: it is down when the commanded head passes the end of the
    stitch's move, in the order of the job. If the loads follow by feed-forward, the needle keeps
    the times of the job, from before smoothing. The stitches of a short job are computed once,
    however many measures and runs read them.
    """
    return iter(_FOUND.setdefault(plan, CachedStream(_found, plan.job, plan.motion)))


def _found(job: Job, intended: Motion) -> Iterator[Stitches]:
    motion = intended.of_needle
    axes = [intended.programmed.axes.index(axis) for axis in job.axes]
    radius = intended.programmed.radius_m[axes]
    columns = [motion.axes.index(axis) for axis in job.axes]
    start = np.asarray(job.start, dtype=np.float64) * radius
    moving = _Moving(motion)
    follower = TrajectoryFollower(moving, columns, radius, start)
    before_s, contour = follower.time_s, -1.0
    runs = _runs(job)
    waiting: _Moves | None = None
    while True:
        while waiting is None or len(waiting) < _MOST_MOVES:
            more = next(runs, None)
            if more is None:
                break
            waiting = more if waiting is None else waiting.with_more(more)
        if waiting is None or not len(waiting):
            return
        points = waiting.target[:_MOST_MOVES] * radius
        down = follower.times(points)
        done = len(down)
        taken, waiting = waiting.rows(slice(done)), waiting.rows(slice(done, None))
        points = points[:done]
        came_from = np.concatenate([start[None], points[:-1]])
        came_s = np.concatenate([[before_s], down[:-1]])
        start, before_s = points[-1], float(down[-1])
        sewn = taken.sewn
        if not sewn.any():
            continue
        stitched = taken.rows(sewn)
        tags = dict(zip(_TAGS, np.ascontiguousarray(stitched.tags.T), strict=True))
        number = tags["contour"]
        before = np.concatenate([[contour], number[:-1]])
        contour = float(number[-1])
        from_s, down_s = came_s[sewn], down[sewn]
        planned_s = down_s - np.where(stitched.begins, moving.departs(from_s, down_s), from_s)
        yield Stitches(
            operation=stitched.operation,
            line=stitched.line,
            contour=number.astype(np.int64),
            first=number != before,
            exempt=tags["exempt"] != 0.0,
            point=points[sewn],
            from_point=came_from[sewn],
            from_s=from_s,
            down_s=down_s,
            target_m=tags["target_m"],
            period_s=np.where(np.isnan(tags["fastest_hz"]), stitched.period_s, planned_s),
            slowest_hz=tags["slowest_hz"],
            fastest_hz=tags["fastest_hz"],
            most_hz_s=tags["most_hz_s"],
            departs=stitched.begins,
            stops=stitched.ends,
            from_m=tags["from_m"],
            to_m=tags["to_m"],
        )


def _period_s(feed: Feed | None) -> float:
    if feed is None or feed.mode is not FeedMode.INVERSE_TIME:
        return float("nan")
    return 1.0 / feed.value


@dataclass(frozen=True, slots=True)
class _Moves:
    """Consecutive moves, n of them, from which stitches are made.

    Parameters
    ----------
    operation, line, target, period_s
        (n,) number in the job, (n,) job line, (n, axes) end, and (n,) programmed time.
    begins, ends
        (n,) bool: the head rests before the move, and after it.
    sewn, tags
        (n,) bool: whether it is a stitch; (n, tags) in the order of ``_TAGS``, NaN if missing.
    """

    operation: IntArray
    line: IntArray
    target: FloatArray
    period_s: FloatArray
    begins: NDArray[np.bool_]
    ends: NDArray[np.bool_]
    sewn: NDArray[np.bool_]
    tags: FloatArray

    @classmethod
    def of(cls, run: MoveRun, first: int, *, rested: bool) -> _Moves:
        """Return the moves of a run whose first move has the number ``first`` in the job."""
        count = len(run)
        period_s, begins = np.full(count, np.nan), np.zeros(count, dtype=np.bool_)
        for at, feed in run.feeds:
            period_s[at:] = _period_s(feed)
        begins[:1] = rested
        stitch = run.columns.get("stitch")
        return cls(
            operation=np.arange(first, first + count),
            line=run.line,
            target=run.targets,
            period_s=period_s,
            begins=begins,
            ends=np.zeros(count, dtype=np.bool_),
            sewn=np.zeros(count, dtype=np.bool_) if stitch is None else ~lacking(stitch),
            tags=np.stack([_numbers(run, name) for name in _TAGS], axis=1),
        )

    def __len__(self) -> int:
        return len(self.line)

    def rows(self, rows: slice | NDArray[np.bool_]) -> _Moves:
        """Return some of the moves."""
        return _Moves(*(getattr(self, field.name)[rows] for field in fields(self)))

    def with_more(self, more: _Moves) -> _Moves:
        """Return these moves followed by more."""
        return _Moves(
            *(np.concatenate([getattr(one, f.name) for one in (self, more)]) for f in fields(self))
        )


def _numbers(run: MoveRun, name: str) -> FloatArray:
    """Return (n,) the numbers of a tag, NaN if a move lacks it."""
    column = run.columns.get(name)
    if column is None:
        return np.full(len(run), np.nan)
    if column.dtype.kind in "fi":
        return column.astype(np.float64)
    found = np.full(len(run), np.nan)
    for k in np.flatnonzero(~lacking(column)):
        found[k] = float(column[k])
    return found


def _runs(job: Job) -> Iterator[_Moves]:
    """Yield the moves of a job in groups; the head rests at any other operation."""
    rested, number, last = True, 0, None
    for item in move_runs(job):
        if isinstance(item, MoveRun) and not len(item):
            continue
        if last is not None:
            last.ends[-1] = not isinstance(item, MoveRun)
            yield last
        last = _Moves.of(item, number, rested=rested) if isinstance(item, MoveRun) else None
        rested = last is None
        number += 1 if last is None else len(last)
    if last is not None:
        last.ends[-1] = True
        yield last


class _Moving:
    """The pieces of a trajectory that move: the needle is down before any rest after a stitch.

    Parameters
    ----------
    trajectory
        Trajectory with its rests.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self._source = trajectory
        self._departs_s: list[float] = []  # end of each rest that takes time

    def __iter__(self) -> Iterator[TrajectoryBlock]:
        end_s = 0.0
        for block in self._source:
            farthest = np.abs(block.coefficients[:, 1:]).sum(axis=1)
            moves = (farthest >= PLANNED_RESOLUTION).any(axis=1)
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
        """Return (n,) departure times of the head for stitches that begin with a rest.

        ``from_s`` and ``until_s`` are (n,) the times at the start and end of each stitch. Rests
        before the last end are discarded.
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
