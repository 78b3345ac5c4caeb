"""The tick table of a trajectory: counts per tick, with outputs, waits, stops and dwells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import ceil

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import BudgetError, LimitError, Place, PlanError
from threadline.files import Clock, Event, Stream, TickBlock, TickTable
from threadline.files.clock import EventKind
from threadline.jobs.feed_times import SLOWER
from threadline.jobs.operations import (
    Dwell,
    Home,
    Job,
    Move,
    MoveRun,
    Operation,
    SetOutput,
    Stop,
    ToolEvent,
    WaitInput,
)
from threadline.machine import Machine
from threadline.motion.timing.types import Trajectory, TrajectoryBlock

TICK_SLACK = 1e-6
"""Fraction of a tick by which an instant may miss a tick and still count as that tick. Rounding of
sums of durations must not add a tick."""


def first_tick_from(time_s: float, clock: Clock) -> int:
    """Return the first tick at or after ``time_s``, within ``TICK_SLACK``."""
    return max(0, ceil(time_s / float(clock.period_s) - TICK_SLACK))


@dataclass(frozen=True, slots=True)
class _Group:
    """Operations between two moves; ``first`` is the index of the first operation.

    A group without a rest holds the actions at the start of a move, whose index is ``first``.
    """

    first: int
    operations: tuple[Operation, ...]
    rests: bool = True

    @property
    def dwell_s(self) -> float:
        return sum(op.duration_s for op in self.operations if isinstance(op, Dwell))


class EventPlacer:
    """Finds the tick of every event while the blocks of the trajectory pass by, in order.

    The motion rests between two moves with other operations between them. The first event of such a
    group happens when the rest begins. Each later event happens at the end of the dwells before it.
    The rest begins where the dwell of the group begins in the trajectory. A shaped motion ends
    later and its dwell is shorter, so the dwell may not be found; then the rest begins at the start
    of the next move, less the dwells. Actions at the start of a move (``Move.acts``) happen at that
    instant.

    Parameters
    ----------
    job
        Job, read once in step with the trajectory; None for no events.
    clock
        Clock of the ticks.
    """

    def __init__(self, job: Job | None, clock: Clock) -> None:
        self._clock = clock
        self._groups = _groups(job) if job is not None else iter(())
        self._next = next(self._groups, None)

    def events_in(self, block: TrajectoryBlock) -> list[Event]:
        """Return the events whose ticks ``block`` determines."""
        found: list[Event] = []
        while self._next is not None:
            begin_s = self._rest_begin_s(self._next, block)
            if begin_s is None:
                break
            found += self._place(self._next, begin_s)
            self._next = next(self._groups, None)
        return found

    def events_at_end(self, end_s: float) -> list[Event]:
        """Return the events with no motion after them."""
        found: list[Event] = []
        while self._next is not None:
            found += self._place(self._next, end_s - self._next.dwell_s)
            self._next = next(self._groups, None)
        return found

    def _rest_begin_s(self, group: _Group, block: TrajectoryBlock) -> float | None:
        operation = block.operation
        if not group.rests:
            at = int(np.searchsorted(operation, group.first))
            return None if at == len(operation) else float(block.start_s[at])
        if group.dwell_s > 0:
            # Operations before the first move rest at the start vertex, whose index is 0.
            move = max(group.first - 1, 0)
            begin, end = np.searchsorted(operation, [move, move + 1])
            length = block.duration_s[begin:end]
            still = (block.coefficients[begin:end, 1:] == 0.0).all(axis=(1, 2))
            match = np.flatnonzero(still & (np.abs(length - group.dwell_s) <= 1e-9 * length))
            if len(match):
                return float(block.start_s[begin + match[-1]])
        last = group.first + len(group.operations) - 1
        after = int(np.searchsorted(operation, last, side="right"))
        if after == len(operation):
            return None
        return float(block.start_s[after]) - group.dwell_s

    def _place(self, group: _Group, begin_s: float) -> Iterator[Event]:
        time_s = begin_s
        for index, operation in enumerate(group.operations, start=group.first):
            of = index if group.rests else group.first
            yield _event(first_tick_from(time_s, self._clock), of, operation)
            if isinstance(operation, Dwell):
                time_s += operation.duration_s


def _groups(job: Job) -> Iterator[_Group]:
    kept: list[Operation] = []
    first = index = 0
    for item in job.runs():
        if isinstance(item, Move | MoveRun):
            if kept:
                yield _Group(first, tuple(kept))
                kept = []
            acts = item.acts if isinstance(item, MoveRun) else ((0, item.acts),)
            yield from (_Group(index + at, own, rests=False) for at, own in acts if own)
            index += len(item) if isinstance(item, MoveRun) else 1
            continue
        if not kept:
            first = index
        kept.append(item)
        index += 1
    if kept:
        yield _Group(first, tuple(kept))


def _event(tick: int, index: int, operation: Operation) -> Event:
    kind: EventKind
    name, value = "", 0.0
    match operation:
        case SetOutput():
            kind, name, value = "output", operation.name, operation.value
        case WaitInput():
            kind, name, value = "wait", operation.name, operation.value
        case ToolEvent():
            kind, name, value = "tool", operation.name, operation.value
        case Dwell():
            kind, value = "dwell", operation.duration_s
        case Stop():
            kind, name = "end" if operation.final else "stop", operation.words
        case Move() | Home():
            raise ValueError(f"a {type(operation).__name__.lower()} is no event")
    return Event(tick=tick, kind=kind, operation=index, name=name, value=value)


ROWS = 1 << 16
"""Rows per block of the table, for any blocks of the trajectory."""

_EXACT_COUNTS = 2.0**53
_ROUNDING_COUNTS = 1.0 + 1e-6  # two roundings of half a count each


def compile_ticks(
    trajectory: Trajectory, machine: Machine, job: Job | None = None, *, rows: int = ROWS
) -> TickTable:
    """Return the counts that each axis travels in each tick.

    Row k is ``round(c p[k+1]) - round(c p[k])``, where p[k] is the position at tick k and c the
    counts per unit. Positions are rounded, never increments. The sum of any run of rows is
    therefore within one count of the travel, and the sum of all rows is exact. If the trajectory is
    not a whole number of ticks long, its end is in the last row.

    Parameters
    ----------
    trajectory
        Axis positions over time, m or rad.
    machine
        Machine; gives clock, scales, velocity limits and tick budget.
    job
        Job; gives the events and the hash. Without a job the table has neither.
    rows
        Rows per block of the table.

    Returns
    -------
    TickTable
        Table, built block by block during reading. Its columns are the axes of the machine; axes
        that are not in the trajectory stay at 0. The operation of a row is the active operation in
        the middle of the tick. Events at the end of the last row are in the last block, with the
        tick after the row.

    Raises
    ------
    PlanError
        If the machine lacks an axis of the trajectory.
    LimitError
        During reading, if a row exceeds the velocity limit of its axis by more than the count that
        rounding adds. Historical trajectories are not checked.
    BudgetError
        During reading, if the table has more ticks than the machine file allows.
    """
    for axis in trajectory.axes:
        if axis not in machine.axes:
            raise PlanError(
                f"axis {axis} is not an axis of machine {machine.name!r}, "
                f"which has {', '.join(machine.axis_names)}"
            )
    return TickTable(
        clock=machine.tick_clock,
        axes=machine.axis_names,
        counts_per_unit=machine.counts_per_unit,
        start_counts=_Scale.of(trajectory, machine).counts(_start(trajectory, job)[None])[0],
        blocks=Stream(_blocks, trajectory, machine, job, rows),
        job_sha256="" if job is None else job.sha256,
        machine_sha256=machine.sha256,
    )


def _start(trajectory: Trajectory, job: Job | None) -> FloatArray:
    for block in trajectory:
        return np.asarray(block.evaluate(block.start_s[:1])[0])
    if job is None:
        return np.zeros(len(trajectory.axes))
    return np.array([job.start[job.axes.index(axis)] for axis in trajectory.axes])


def _blocks(
    trajectory: Trajectory, machine: Machine, job: Job | None, rows: int
) -> Iterator[TickBlock]:
    clock = machine.tick_clock
    table = _Table(
        scale=_Scale.of(trajectory, machine),
        clock=clock,
        budget=machine.tick_budget.si,
        velocity_limit=None if trajectory.historical else machine.velocity_limit,
        job=job,
        rows=rows,
    )
    placer = EventPlacer(job, clock)
    last = None
    for block in trajectory:
        if not len(block):
            continue
        if last is None:
            table.begin(block)
        table.add_events(placer.events_in(block))
        for times_s in table.ticks_before(block.end_s):
            table.add_rows(block.evaluate(times_s), times_s, block)
            yield from table.full_blocks()
        last = block
    table.finish(last)
    table.add_events(placer.events_at_end(0.0 if last is None else last.end_s))
    yield from table.full_blocks()
    yield from table.remaining_block()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Scale:
    """Converts positions of the trajectory's axes into counts of all axes of the machine."""

    axes: tuple[str, ...]
    per_unit: FloatArray  # (axes,)
    column: list[int]  # column of each axis of the trajectory

    @classmethod
    def of(cls, trajectory: Trajectory, machine: Machine) -> _Scale:
        return cls(
            axes=machine.axis_names,
            per_unit=machine.counts_per_unit,
            column=[machine.axis_names.index(axis) for axis in trajectory.axes],
        )

    def counts(self, positions: FloatArray) -> IntArray:
        """Return the (n, machine axes) rounded positions."""
        exact = np.rint(positions * self.per_unit[self.column])
        far = np.abs(exact) >= _EXACT_COUNTS
        if far.any():
            axis = self.axes[self.column[int(np.argwhere(far)[0][1])]]
            raise PlanError(
                f"axis {axis} goes beyond {_EXACT_COUNTS:.3g} counts, "
                "further than a counter can be exact",
                remedy="Divide the job.",
            )
        counts = np.zeros((len(positions), len(self.axes)), dtype=np.int64)
        counts[:, self.column] = exact
        return counts


@dataclass(slots=True, kw_only=True)
class _Table:
    """The unfinished part of the table."""

    scale: _Scale
    clock: Clock
    budget: float
    velocity_limit: FloatArray | None
    job: Job | None
    rows: int
    first_tick: int = 0  # tick of the first row not yet handed out
    buffered: int = 0
    counts: list[IntArray] = field(default_factory=list)
    operation: list[IntArray] = field(default_factory=list)
    labelled: int = 0  # number of rows with a known operation, from tick 0
    events: list[Event] = field(default_factory=list)
    position: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def begin(self, block: TrajectoryBlock) -> None:
        start = block.evaluate(block.start_s[:1])
        self.position = self.scale.counts(start)[0]

    @property
    def end_tick(self) -> int:
        return self.first_tick + self.buffered

    def ticks_before(self, end_s: float) -> Iterator[FloatArray]:
        """Yield the instants of the ticks after the last row and before ``end_s``, in runs."""
        period = float(self.clock.period_s)
        if end_s / period > self.budget:
            raise BudgetError(
                f"the job needs more than {end_s / period:.3g} ticks of {period * 1e3:g} ms, "
                f"the machine file allows {self.budget:.3g}",
                remedy="Shorten the job or raise tick_budget in the machine file.",
            )
        while True:
            tick = self.end_tick + 1
            count = min(self.rows, max(1, int((end_s - self.clock.time_s(tick)) / period) + 2))
            times_s = self.clock.times_s(tick, count)
            inside = int(np.searchsorted(times_s, end_s))
            # The operations reach half a tick further than the positions, so a run without
            # positions may still have an operation.
            yield times_s[:inside]
            if inside < count:
                return

    def add_rows(self, positions: FloatArray, times_s: FloatArray, block: TrajectoryBlock) -> None:
        if len(positions):
            self._append(self.scale.counts(positions))
        self._label(block, len(times_s) + 1)

    def _append(self, target: IntArray) -> None:
        self.counts.append(np.diff(target, axis=0, prepend=self.position[None]))
        self.position = target[-1]
        self.buffered += len(target)

    def _label(self, block: TrajectoryBlock, count: int) -> None:
        """Record the operation in the middle of the next rows, as far as ``block`` reaches."""
        half = Clock(self.clock.name, self.clock.period_s / 2)
        middle_s = half.times_s(2 * self.labelled + 1, count, stride=2)
        middle_s = middle_s[: np.searchsorted(middle_s, block.end_s)]
        piece = np.searchsorted(block.start_s, middle_s, side="right") - 1
        self.operation.append(block.operation[np.maximum(piece, 0)])
        self.labelled += len(middle_s)

    def finish(self, last: TrajectoryBlock | None) -> None:
        """Bring the last row to the end of the trajectory."""
        if last is None:
            return
        ticks = max(1, first_tick_from(last.end_s, self.clock))
        end = self.scale.counts(last.evaluate(np.array([last.end_s])))
        if self.end_tick == ticks:
            self.counts[-1] = self.counts[-1].copy()
            self.counts[-1][-1] += end[0] - self.position
            self.position = end[0]
        else:
            self._append(end)
        missing = max(0, self.end_tick - self.labelled)
        self.operation.append(np.repeat(last.operation[-1:], missing))

    def add_events(self, events: list[Event]) -> None:
        for event in events:
            # A tick can be past only if a shaped motion left no dwell to find.
            late = event.tick < self.first_tick
            self.events.append(
                Event(
                    tick=self.first_tick if late else event.tick,
                    kind=event.kind,
                    operation=event.operation,
                    name=event.name,
                    value=event.value,
                )
            )

    def full_blocks(self) -> Iterator[TickBlock]:
        """Yield full blocks; the last row stays, because ``finish`` may have to change it."""
        while self.buffered > self.rows:
            yield self._take(self.rows, last=False)

    def remaining_block(self) -> Iterator[TickBlock]:
        if self.buffered or self.events:
            yield self._take(self.buffered, last=True)

    def _take(self, size: int, *, last: bool) -> TickBlock:
        none = np.zeros((0, len(self.scale.axes)), dtype=np.int64)
        counts = np.concatenate([none, *self.counts])
        operation = np.concatenate([none[:, 0], *self.operation])
        end = self.first_tick + size
        block = TickBlock(
            first_tick=self.first_tick,
            counts=counts[:size],
            operation=operation[:size],
            events=tuple(e for e in self.events if last or e.tick < end),
        )
        self.events = [] if last else [e for e in self.events if e.tick >= end]
        self.counts, self.operation = [counts[size:]], [operation[size:]]
        self.first_tick, self.buffered = end, self.buffered - size
        self._check(block)
        return block

    def _check(self, block: TickBlock) -> None:
        if self.velocity_limit is None or not len(block):
            return
        allowed = self.velocity_limit * self.scale.per_unit * float(self.clock.period_s)
        over = np.abs(block.counts) > allowed + _ROUNDING_COUNTS
        if not over.any():
            return
        row, axis = np.argwhere(over)[0]
        counts = abs(int(block.counts[row, axis]))
        name = self.scale.axes[axis]
        raise LimitError(
            f"axis {name} travels {counts} counts in tick {block.first_tick + row}, "
            f"its velocity limit is {allowed[axis]:.6g} counts per tick",
            axis=name,
            quantity="velocity",
            value_si=counts / self.scale.per_unit[axis] / float(self.clock.period_s),
            limit_si=float(self.velocity_limit[axis]),
            place=place_of(self.job, int(block.operation[row])),
            remedy=f"{SLOWER['feed' if self.job is None else self.job.paced_by]} there, or use an "
            "interpolation that respects the limits.",
        )


def place_of(job: Job | None, operation: int) -> Place | None:
    """Return file and line of an operation; reads the job up to the operation."""
    if job is not None:
        for index, found in enumerate(job):
            if index == operation:
                return found.source.place
    return None
