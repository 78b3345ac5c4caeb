"""The programmed path of a job: vertices in axis space, with the time of each move at its feed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import LimitError, Place, PlanError
from threadline.files import CachedStream
from threadline.jobs.feed_times import check_feed, feed_of_move, nominal_time_s
from threadline.jobs.operations import (
    Dwell,
    Feed,
    FeedMode,
    Job,
    MoveRun,
    ToolEvent,
    move_runs,
)
from threadline.machine import Machine
from threadline.motion.path.types import ProgrammedPath, VertexBlock

if TYPE_CHECKING:
    from threadline.jobs.program_limits import ProgramLimits

BLOCK = 4096
_NONE_YET = Feed(FeedMode.RAPID, 0.0)
_TRAVEL_SLACK = 1e-9  # m or rad: rounding of sums of incremental moves that end at a limit


def programmed_path(
    job: Job, machine: Machine, feed: Feed | None = None, *, at_limits: bool = False
) -> ProgrammedPath:
    """Return the programmed path of ``job``, a stream of vertices on the axes of the job.

    The motion rests before anything that is not a move: a dwell, an output, a wait, a stop, a tool
    event, the end.

    Parameters
    ----------
    job, machine
        The job, and its machine.
    feed
        Feed of every move except rapid ones. None: each move has its programmed feed, limited to
        the operator's normal feed if the machine file has one; ``VertexBlock.slowed`` counts the
        moves slowed by that limit.
    at_limits
        Whether times are the shortest that a timing by limits may use (``Feed.most``): a needle
        that follows the head then turns at its fastest.

    Raises
    ------
    PlanError
        If an axis of the job is not on the machine, or ``feed`` is not above 0. While the stream is
        read: if a feed is missing or not above 0.
    LimitError
        While the stream is read: if the start or the end of a move is outside the travel.
    """
    for axis in job.axes:
        if axis not in machine.axes:
            raise PlanError(
                f"axis {axis} of job {job.name!r} is not an axis of machine {machine.name!r}, "
                f"which has {', '.join(machine.axis_names)}",
                remedy="Use another machine file, or take the axis out of the job.",
            )
    if feed is not None:
        check_feed(feed, job.axes, None)
    columns = [machine.axis_names.index(axis) for axis in job.axes]
    return ProgrammedPath(
        axes=job.axes,
        radius_m=machine.radius_m[columns],
        blocks=CachedStream(_blocks, job, machine, feed, at_limits),
        local=machine.local_radii(job.axes),
        limits=_limits_of(job) if job.sets_limits else None,
    )


def _limits_of(job: Job) -> ProgramLimits:
    """Return the limits that the program sets, by the operation from which they hold."""
    from threadline.jobs.program_limits import GrowingLimits

    limits, index = GrowingLimits(), 0
    for item in move_runs(job):
        if isinstance(item, MoveRun):
            acting_events = [(move_index, act) for move_index, acts in item.acts for act in acts]
            index, begin = index + len(item), index
        else:
            acting_events = [(0, item)] if isinstance(item, ToolEvent) else []
            index, begin = index + 1, index
        for move_index, act in acting_events:
            if act.limits is not None:
                limits.take(act.limits, begin + move_index)
    return limits.table()


@dataclass(slots=True)
class _Pending:
    """Vertices that are not yet in a block; the last may still get a rest.

    ``rests`` holds the pause at each vertex with a rest, by its index; ``feeds`` the feed from a
    vertex on, with the line of its first move (None for the start).
    """

    targets: list[FloatArray]
    line: list[IntArray]
    operation: list[IntArray]
    rests: dict[int, float]
    feeds: list[tuple[int, Feed | None]]
    file: str
    count: int = 1

    def add(self, run: MoveRun, operation: int) -> None:
        """Append a run of moves, the first of them with number ``operation``."""
        self.file = run.file
        for begin, feed in run.feeds:
            if feed is not self.feeds[-1][1]:
                self.feeds.append((self.count + begin, feed))
        self.targets.append(run.targets)
        self.line.append(run.line)
        self.operation.append(np.arange(operation, operation + len(run), dtype=np.int64))
        self.count += len(run)

    def rest(self, dwell_s: float) -> None:
        """Add a rest of ``dwell_s`` at the latest vertex."""
        self.rests[self.count - 1] = self.rests.get(self.count - 1, 0.0) + dwell_s

    def after(self, size: int) -> _Pending:
        """Return the vertices after the first ``size``, which are in a block already."""
        return _Pending(
            [np.concatenate(self.targets)[size:]],
            [np.concatenate(self.line)[size:]],
            [np.concatenate(self.operation)[size:]],
            {index - size: dwell_s for index, dwell_s in self.rests.items() if index >= size},
            [(0, self.feeds[-1][1])],
            self.file,
            self.count - size,
        )


def _blocks(
    job: Job, machine: Machine, feed: Feed | None, at_limits: bool
) -> Iterator[VertexBlock]:
    _check_start(job, machine)
    previous = np.array(job.start)
    zero = [np.zeros(1, dtype=np.int64)]
    pending = _Pending([previous[None]], [*zero], [*zero], {0: 0.0}, [(0, _NONE_YET)], job.file)
    index = 0
    for item in move_runs(job):
        if isinstance(item, MoveRun):
            run = replace(item, feeds=_at_limits(item.feeds)) if at_limits else item
            pending.add(run, index)
            index += len(item)
            if pending.count > BLOCK:
                size = pending.count - 1
                block = _block(pending, size, previous, job, machine, feed)
                previous = block.positions[-1]
                yield block
                pending = pending.after(size)
            continue
        pending.rest(item.duration_s if isinstance(item, Dwell) else 0.0)
        index += 1
    pending.rest(0.0)
    yield _block(pending, pending.count, previous, job, machine, feed)


def _at_limits(feeds: Sequence[tuple[int, Feed | None]]) -> tuple[tuple[int, Feed | None], ...]:
    """Return the fastest permitted feeds for a timing by limits, equal ones merged."""
    merged_feeds: list[tuple[int, Feed | None]] = []
    for begin, feed in feeds:
        fastest_feed = None if feed is None else feed.at_limits
        if not merged_feeds or fastest_feed != merged_feeds[-1][1]:
            merged_feeds.append((begin, fastest_feed))
    return tuple(merged_feeds)


def _block(
    pending: _Pending,
    size: int,
    previous: FloatArray,
    job: Job,
    machine: Machine,
    feed: Feed | None,
) -> VertexBlock:
    positions = np.concatenate(pending.targets)[:size]
    line = np.concatenate(pending.line)[:size]
    _check_travel(positions, line, pending.file, job, machine)
    displacement = np.diff(positions, axis=0, prepend=previous[None])
    nominal = np.zeros(size)
    slowed = 0
    ends = [begin for begin, _ in pending.feeds[1:]] + [size]
    for (begin, programmed), next_begin in zip(pending.feeds, ends, strict=True):
        end = min(next_begin, size)
        if begin >= end:
            continue
        place = Place(pending.file, int(line[begin])) if line[begin] else None
        nominal[begin:end], slowed_moves = nominal_time_s(
            displacement[begin:end],
            feed_of_move(programmed, feed, place, job, machine),
            feed,
            job,
            machine,
        )
        slowed += slowed_moves
    rest = np.zeros(size, dtype=np.int64)
    dwell_s = np.zeros(size)
    for vertex, pause_s in pending.rests.items():
        if vertex < size:
            rest[vertex], dwell_s[vertex] = 1, pause_s
    return VertexBlock(
        positions=positions,
        operation=np.concatenate(pending.operation)[:size],
        nominal_s=nominal,
        rest=rest,
        dwell_s=dwell_s,
        line=line,
        slowed=slowed,
    )


def _check_start(job: Job, machine: Machine) -> None:
    for axis, value in zip(job.axes, job.start, strict=True):
        low, high = machine.travel[machine.axis_names.index(axis)]
        if not low - _TRAVEL_SLACK <= value <= high + _TRAVEL_SLACK:
            raise LimitError(
                f"axis {axis} starts at {_shown(axis, value, machine)}, "
                f"outside its travel {_shown(axis, low, machine)} to {_shown(axis, high, machine)}",
                axis=axis,
                quantity="travel",
                value_si=float(value),
                limit_si=float(low if value < low else high),
                remedy="Start the job within the travel.",
            )


def _check_travel(
    positions: FloatArray, line: IntArray, file: str, job: Job, machine: Machine
) -> None:
    columns = [machine.axis_names.index(axis) for axis in job.axes]
    low, high = machine.travel[columns].T
    inside = (positions >= low - _TRAVEL_SLACK) & (positions <= high + _TRAVEL_SLACK)
    if inside.all():
        return
    row, j = np.argwhere(~inside)[0]
    axis = job.axes[j]
    value = float(positions[row, j])
    limit = float(low[j] if value < low[j] else high[j])
    raise LimitError(
        f"axis {axis} would move to {_shown(axis, value, machine)}; "
        f"its travel ends at {_shown(axis, limit, machine)}",
        axis=axis,
        quantity="travel",
        value_si=value,
        limit_si=limit,
        place=Place(file, int(line[row])),
        remedy="Shorten the move or shift the start of the job.",
    )


def _shown(axis: str, value_si: float, machine: Machine) -> str:
    if machine.axes[axis].kind == "linear":
        return f"{value_si * 1e3:.6g} mm"
    return f"{np.degrees(value_si):.6g} deg"
