"""Job -> programmed path: vertices in axis space, with the time that the feed gives each move."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import LimitError, PlanError
from threadline.jobs.operations import Dwell, Feed, FeedMode, Job, Move
from threadline.machine import Machine
from threadline.path.feeds import check_feed, feed_time_s
from threadline.path.types import ProgrammedPath, VertexBlock
from threadline.signals import Stream

BLOCK = 4096
_NONE_YET = Feed(FeedMode.RAPID, 0.0)
_TRAVEL_SLACK = 1e-9  # m or rad: sums of incremental moves end a rounding beyond the limit


def programmed_path(job: Job, machine: Machine, feed: Feed | None = None) -> ProgrammedPath:
    """Return what ``job`` says, as a stream of vertices on the axes of the job.

    The motion rests where something else than a move follows: a dwell, an output, a wait, a
    stop, a tool event, the end.

    Parameters
    ----------
    job, machine
        What is to be done, and on what.
    feed
        Replaces the feed of every move but the rapid ones. Without it the job's feeds count,
        each no faster than the operator's normal feed where the machine file has one; how many
        moves that slowed is in ``VertexBlock.slowed``.

    Raises
    ------
    PlanError
        If an axis of the job is not on the machine. While the stream is read: if a feed is
        missing or not above 0, or (as ``LimitError``) a move ends outside the travel.
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
    column = [machine.axis_names.index(axis) for axis in job.axes]
    return ProgrammedPath(
        axes=job.axes,
        radius_m=machine.radius_m[column],
        blocks=Stream(lambda: _blocks(job, machine, feed)),
    )


@dataclass(slots=True)
class _Pending:
    """Vertices that are not yet in a block; the last may still get a rest."""

    targets: list[tuple[float, ...]] = field(default_factory=list)
    operation: list[int] = field(default_factory=list)
    moves: list[Move | None] = field(default_factory=list)
    rest: list[int] = field(default_factory=list)
    dwell_s: list[float] = field(default_factory=list)
    feeds: list[tuple[int, Feed | None]] = field(default_factory=list)


def _blocks(job: Job, machine: Machine, feed: Feed | None) -> Iterator[VertexBlock]:
    pending = _Pending([job.start], [0], [None], [1], [0.0])
    _check_start(job, machine)
    previous = np.array(job.start)
    latest: Feed | None = _NONE_YET
    for index, operation in enumerate(job.operations):
        if type(operation) is Move:
            if len(pending.targets) > BLOCK:
                block = _block(pending, BLOCK, previous, job, machine, feed)
                previous = block.positions[-1]
                yield block
                pending = _rest_of(pending, latest)
            if operation.feed is not latest:
                latest = operation.feed
                pending.feeds.append((len(pending.targets), latest))
            pending.targets.append(operation.target)
            pending.operation.append(index)
            pending.moves.append(operation)
            pending.rest.append(0)
            pending.dwell_s.append(0.0)
            continue
        pending.rest[-1] = 1
        if isinstance(operation, Dwell):
            pending.dwell_s[-1] += operation.duration_s
    pending.rest[-1] = 1
    yield _block(pending, len(pending.targets), previous, job, machine, feed)


def _rest_of(pending: _Pending, latest: Feed | None) -> _Pending:
    return _Pending(
        pending.targets[BLOCK:],
        pending.operation[BLOCK:],
        pending.moves[BLOCK:],
        pending.rest[BLOCK:],
        pending.dwell_s[BLOCK:],
        [(0, latest)],
    )


def _block(
    pending: _Pending,
    size: int,
    previous: FloatArray,
    job: Job,
    machine: Machine,
    feed: Feed | None,
) -> VertexBlock:
    positions = np.array(pending.targets[:size], dtype=np.float64).reshape(size, len(job.axes))
    _check_travel(positions, pending.moves, job, machine)
    displacement = np.diff(positions, axis=0, prepend=previous[None])
    nominal = np.zeros(size)
    slowed = 0
    ends = [begin for begin, _ in pending.feeds[1:]] + [size]
    for (begin, programmed), following in zip(pending.feeds, ends, strict=True):
        end = min(following, size)
        if begin >= end:
            continue
        here = displacement[begin:end]
        nominal[begin:end], late = _nominal(
            here, _wanted(programmed, feed, pending.moves[begin], job, machine), feed, job, machine
        )
        slowed += late
    moves = pending.moves[:size]
    return VertexBlock(
        positions=positions,
        operation=np.array(pending.operation[:size], dtype=np.int64),
        nominal_s=nominal,
        rest=np.array(pending.rest[:size], dtype=np.int64),
        dwell_s=np.array(pending.dwell_s[:size]),
        line=np.array([0 if m is None else m.source.line for m in moves], dtype=np.int64),
        slowed=slowed,
    )


def _wanted(
    programmed: Feed | None, feed: Feed | None, move: Move | None, job: Job, machine: Machine
) -> Feed:
    """Return the feed that counts for a move."""
    place = None if move is None else move.source.place
    if programmed is not None and programmed.mode is FeedMode.RAPID:
        return programmed
    if feed is not None:
        return feed
    if programmed is None:
        if machine.operator is None:
            raise PlanError(
                "a move has no feed", place=place, remedy="Program a feed (F), or give one."
            )
        return Feed(FeedMode.COUNT_PER_TICK, machine.operator.normal_feed.si)
    check_feed(programmed, job.axes, place)
    return programmed


def _nominal(
    displacement: FloatArray, wanted: Feed, given: Feed | None, job: Job, machine: Machine
) -> tuple[FloatArray, int]:
    """Return the times, and how many moves the operator's normal feed slowed."""
    nominal = feed_time_s(displacement, wanted, job.axes, machine)
    operator = machine.operator
    if given is not None or operator is None or wanted.mode is FeedMode.RAPID:
        return nominal, 0
    normal = Feed(FeedMode.COUNT_PER_TICK, operator.normal_feed.si)
    slowest = feed_time_s(displacement, normal, job.axes, machine)
    return np.maximum(nominal, slowest), int((slowest > nominal * (1 + 1e-9)).sum())


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
    positions: FloatArray, moves: list[Move | None], job: Job, machine: Machine
) -> None:
    column = [machine.axis_names.index(axis) for axis in job.axes]
    low, high = machine.travel[column].T
    inside = (positions >= low - _TRAVEL_SLACK) & (positions <= high + _TRAVEL_SLACK)
    if inside.all():
        return
    row, j = np.argwhere(~inside)[0]
    move, axis = moves[row], job.axes[j]
    value = float(positions[row, j])
    limit = float(low[j] if value < low[j] else high[j])
    raise LimitError(
        f"axis {axis} would move to {_shown(axis, value, machine)}; "
        f"its travel ends at {_shown(axis, limit, machine)}",
        axis=axis,
        quantity="travel",
        value_si=value,
        limit_si=limit,
        place=None if move is None else move.source.place,
        remedy="Shorten the move or shift the start of the job.",
    )


def _shown(axis: str, value_si: float, machine: Machine) -> str:
    if machine.axes[axis].kind == "linear":
        return f"{value_si * 1e3:.6g} mm"
    return f"{np.degrees(value_si):.6g} deg"
