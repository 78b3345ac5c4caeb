"""Puts what is not motion (outputs, waits, stops, dwells) on the ticks of the motion around it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil

import numpy as np

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
from threadline.signals import Clock, Event
from threadline.signals.event import EventKind
from threadline.trajectory.types import TrajectoryBlock

TICK_SLACK = 1e-6
"""Fraction of a tick by which an instant may miss a tick and still be taken for it: the rounding
of sums of durations must not cost a tick."""


def first_tick_from(time_s: float, clock: Clock) -> int:
    """Return the first tick at or after ``time_s``, but for ``TICK_SLACK``."""
    return max(0, ceil(time_s / float(clock.period_s) - TICK_SLACK))


@dataclass(frozen=True, slots=True)
class _Group:
    """Operations between two moves: ``first`` is the index of the first of them.

    Without a rest they are what happens as a move begins, which has that index.
    """

    first: int
    operations: tuple[Operation, ...]
    rests: bool = True

    @property
    def dwell_s(self) -> float:
        return sum(op.duration_s for op in self.operations if isinstance(op, Dwell))


class EventPlacer:
    """Finds the tick of every event while the blocks of the trajectory pass by, in order.

    The motion rests between two moves that have anything between them. The first event of such a
    group belongs to the instant at which the rest begins, each later one to the end of the dwells
    before it. The rest begins where the dwell of the group begins in the trajectory; failing
    that (a shaped motion ends later and its dwell is shorter) where the next move begins, less
    the dwells. What happens as a move begins (``Move.acts``) belongs to that instant.

    Parameters
    ----------
    job
        Its operations are read once, in step with the trajectory; None for no events.
    clock
        On which the ticks are counted.
    """

    def __init__(self, job: Job | None, clock: Clock) -> None:
        self._clock = clock
        self._groups = _groups(job) if job is not None else iter(())
        self._next = next(self._groups, None)

    def events_in(self, block: TrajectoryBlock) -> list[Event]:
        """Return the events that ``block`` settles."""
        found: list[Event] = []
        while self._next is not None:
            begin_s = self._rest_begin_s(self._next, block)
            if begin_s is None:
                break
            found += self._place(self._next, begin_s)
            self._next = next(self._groups, None)
        return found

    def events_at_end(self, end_s: float) -> list[Event]:
        """Return the events that nothing came after."""
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
            # Operations before the first move rest at the start vertex, which has index 0.
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
