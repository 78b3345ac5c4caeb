"""Base class of the sessions that take rows of counts, one row at each tick.

The derived classes simulate the plant: ``Session`` for machines with control loops,
``PositionSession`` for machines whose drives take positions.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.files import Channel, Event, EventKind, RecordingBlock, RunEnd, TickBlock
from threadline.machine import Machine
from threadline.twin.kernel import Reading


@dataclass(slots=True)
class Part:
    """Consecutive ticks: (n, axes) commanded counts, (n,) operations, and the readings."""

    travelled: IntArray
    operation: IntArray
    read: Mapping[Any, FloatArray] = field(default_factory=dict)


def joined(parts: Sequence[Part], axes: int, runs: int, readings: Sequence[Reading]) -> Part:
    """Return consecutive parts joined into one; a part without ticks if there are none.

    Parameters
    ----------
    axes, runs
        Number of axes and of runs in every part.
    readings
        Readings in every part.
    """
    nothing = np.zeros((0, axes), dtype=np.int64)
    unread = np.zeros((0, runs))
    return Part(
        np.concatenate([nothing, *(part.travelled for part in parts)]),
        np.concatenate([nothing[:, 0], *(part.operation for part in parts)]),
        {
            reading: np.concatenate([unread, *(part.read[reading] for part in parts)])
            for reading in readings
        },
    )


_HALTING = ("stop", "wait")
_AT_ONCE = 1 << 16


class Rows(Protocol):
    """A consumer of rows: a ``RowSession``, or several sessions under the same rows."""

    @property
    def failed(self) -> bool:
        """Whether the simulation has failed."""

    @property
    def halted(self) -> Event | None:
        """The stop or wait that halts the rows; None if they are not halted."""

    def resume(self) -> None:
        """Continue with the rows."""

    def finish(self, ended: RunEnd = ..., text: str = ...) -> None:
        """Declare that no more rows follow."""

    def advance(self, rows: TickBlock | None = ..., *, ticks: int | None = ...) -> RecordingBlock:
        """Take rows, simulate, and return the samples and events."""


class RowSession(ABC):
    """One simulated machine that receives rows of counts in pieces.

    The tick of the machine always goes on; one row is taken at each tick unless the rows are
    halted. While they are halted, the commanded position stands still and the plant moves on. The
    same rows give the same samples, to the bit, however they are divided into pieces.

    Parameters
    ----------
    machine
        The simulated machine; it starts at rest.
    start_counts
        (axes,) commanded position before the first row; 0 when None.

    Attributes
    ----------
    channels
        The channels of the blocks that are returned.
    failed
        Whether the plant has failed; there are no samples from ``tick`` on.

    Raises
    ------
    OptionError
        If the number of start positions differs from the number of axes.
    """

    channels: tuple[Channel, ...]

    def __init__(self, machine: Machine, start_counts: IntArray | None) -> None:
        axes = len(machine.axes)
        start = np.zeros(axes, np.int64) if start_counts is None else np.asarray(start_counts)
        if start.shape != (axes,):
            raise OptionError(f"start_counts has shape {start.shape}, expected {(axes,)}")
        self._machine, self._start = machine, start
        self.failed = False
        self._rows: deque[tuple[IntArray, IntArray]] = deque()
        self._events: deque[Event] = deque()  # of the commands, not reached yet
        self._position = np.zeros(axes, dtype=np.int64)
        self._operation = self._row = 0
        self._halted: Event | None = None
        self._held = False
        self._ended: tuple[RunEnd, str] | None = None
        self._final = False  # the end has been recorded
        self._pending_events: list[Event] = []  # since the last block

    @property
    @abstractmethod
    def tick(self) -> int:
        """Number of ticks simulated so far."""

    @abstractmethod
    def _read(self, part: Part) -> Mapping[Any, FloatArray]:
        """Simulate the plant over a part, and return the readings.

        ``self._position`` is the commanded position after the part.
        """

    @abstractmethod
    def _tripped(self, name: str) -> bool:
        """Return whether a limit switch of the machine has cut its drive."""

    @abstractmethod
    def _block(self, first: int, parts: list[Part]) -> RecordingBlock:
        """Return the block that begins at tick ``first``, and clear the pending events."""

    # --- state -----------------------------------------------------------------------------

    @property
    def row(self) -> int:
        """Number of rows taken so far."""
        return self._row

    @property
    def queued(self) -> int:
        """Number of rows that wait to be taken."""
        return sum(len(counts) for counts, _ in self._rows)

    @property
    def halted(self) -> Event | None:
        """The stop or wait that halts the rows; None if they run or are only held."""
        return self._halted

    @property
    def held(self) -> bool:
        """Whether ``hold`` is in force."""
        return self._held

    @property
    def ended(self) -> RunEnd | None:
        """How the run ended; None while it runs, and while rows are left after ``finish``."""
        return self._ended[0] if self._ended is not None and self._final else None

    # --- control ---------------------------------------------------------------------------

    def hold(self) -> None:
        """Halt the rows from the next tick on; the plant moves on.

        The commanded position stops at once, without regard to the limits of the machine. To stop
        within the limits, send rows that decelerate to rest instead.
        """
        if not self._held:
            self._held = True
            self._record_event("hold")

    def resume(self) -> None:
        """Continue with the rows after ``hold``, after a stop, or instead of a wait.

        If the rows are held at a stop, one call ends both.
        """
        if self._held or self._halted is not None:
            self._held, self._halted = False, None
            self._record_event("resume")

    def finish(self, ended: RunEnd = RunEnd.COMPLETED, text: str = "") -> None:
        """Declare that no more rows follow.

        Parameters
        ----------
        ended
            ``COMPLETED`` to run the rows that still wait, and then end. ``STOPPED`` and ``FAULT``
            take effect at once and drop those rows.
        text
            The reason, for people.
        """
        if self._final:
            return
        self._ended = (ended, text)
        if ended is not RunEnd.COMPLETED:
            self._rows.clear()
            self._events.clear()
            self._halted, self._held = None, False
        self._process_events()

    def advance(self, rows: TickBlock | None = None, *, ticks: int | None = None) -> RecordingBlock:
        """Take rows, simulate, and return the samples and events.

        Parameters
        ----------
        rows
            Rows that follow the previous ones.
        ticks
            Number of ticks to simulate. If a row is missing at a tick, after the first row and
            before ``finish``, the recording counts the tick as late. None simulates until the rows
            are used up, or a stop or a wait halts them.

        Returns
        -------
        RecordingBlock
            Its events are counted in ticks of the machine. It may have no samples.

        Raises
        ------
        OptionError
            If rows have a wrong number of axes, do not follow the previous ones, or come after
            the end.
        MachineError
            If the simulation has no solution.
        """
        if rows is not None:
            self._take(rows)
        first = self.tick
        end = None if ticks is None else first + max(ticks, 0)
        parts: list[Part] = []
        while not self.failed and (end is None or self.tick < end):
            self._process_events()
            part = self._moving(end) or self._standstill(end)
            if part is None:
                break
            part.read = self._read(part)
            parts.append(part)
        return self._block(first, parts)

    # --- rows and events -------------------------------------------------------------------

    def _take(self, rows: TickBlock) -> None:
        if rows.counts.shape[1] != len(self._machine.axes):
            raise OptionError(
                f"rows of {rows.counts.shape[1]} axes for a machine of {len(self._machine.axes)}"
            )
        if self._ended is not None:
            raise OptionError(f"rows after the commands were {self._ended[0].value}")
        if rows.first_tick != self._row + self.queued:
            raise OptionError(
                f"the rows begin at {rows.first_tick}, expected {self._row + self.queued}",
                remedy="Send every row, in order.",
            )
        if len(rows):
            self._rows.append((rows.counts, rows.operation))
        self._events.extend(rows.events)

    def _record_event(
        self, kind: EventKind, *, tick: int | None = None, name: str = "", value: float = 0.0
    ) -> None:
        at = self.tick if tick is None else tick
        self._pending_events.append(
            Event(tick=at, kind=kind, operation=self._operation, name=name, value=value)
        )

    def _process_events(self) -> None:
        """Record the events before the next row; halt at a stop and at an unfulfilled wait."""
        waits = self._halted
        if waits is not None and waits.kind == "wait" and self._met(waits):
            self._halted = None
            self._record_event("resume")
        while self._halted is None and self._events and self._events[0].tick <= self._row:
            event = self._events.popleft()
            self._pending_events.append(replace(event, tick=self.tick))
            if event.kind == "stop" or (event.kind == "wait" and not self._met(event)):
                self._halted = event
        if self._ended is not None and not self._final and self._halted is None and not self._rows:
            self._final = True
            ended, text = self._ended
            self._record_event(ended.value, name=text)

    def _met(self, wait: Event) -> bool:
        inputs = self._machine.inputs
        return wait.name in inputs and self._tripped(wait.name) == bool(wait.value)

    def _moving(self, end: int | None) -> Part | None:
        """Return the rows up to the next halt or the end of the first piece."""
        if self._halted is not None or self._held or not self._rows:
            return None
        counts, operation = self._rows.popleft()
        room = _AT_ONCE if end is None else min(_AT_ONCE, end - self.tick)
        halts = (e.tick - self._row for e in self._events if e.kind in _HALTING)
        n = min(room, len(counts), next(halts, room))
        if n < len(counts):
            self._rows.appendleft((counts[n:], operation[n:]))
        travelled = np.empty((n, len(self._position)), dtype=np.int64)
        travelled[0] = self._position
        np.cumsum(counts[: n - 1], axis=0, out=travelled[1:])
        travelled[1:] += self._position
        while self._events and self._events[0].tick < self._row + n:
            event = self._events.popleft()
            self._pending_events.append(replace(event, tick=self.tick + event.tick - self._row))
        self._position = travelled[-1] + counts[n - 1]
        self._row, self._operation = self._row + n, int(operation[n - 1])
        return Part(travelled, operation[:n])

    def _standstill(self, end: int | None) -> Part | None:
        """Return ticks without rows up to ``end``; None if there is no ``end``."""
        if end is None:
            return None
        n = min(_AT_ONCE, end - self.tick)
        if self._halted is not None and self._halted.name in self._machine.inputs:
            n = 1  # the limit switch can change at any tick
        if self._row and self._halted is None and not self._held and self._ended is None:
            self._record_event("late", value=float(n))
        still = np.broadcast_to(self._position, (n, len(self._position)))
        return Part(still, np.full(n, self._operation))
