"""A simulated machine with axes: it holds rows that end in a braking tail, one for each tick."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.live.pace import Pace
from threadline.live.sim_faults import SimFault
from threadline.live.sim_machine import SimMachine
from threadline.live.wire import Message, event_of
from threadline.machine import Machine
from threadline.signals import Channel, Ended, Event, RecordingBlock, TickBlock
from threadline.twin import session_of
from threadline.twin.row_session import RowSession


class SimRows(SimMachine):
    """A machine that plays a row of counts at each tick; see ``SimMachine``."""

    def __init__(
        self,
        machine: Machine,
        start: IntArray,
        tell: Callable[[Message], None],
        fault: SimFault | None = None,
    ) -> None:
        super().__init__(machine, start, tell, fault)
        self._session = self._new_session()
        self._rows = np.zeros((0, len(machine.axes)), np.int64)  # held, for the ticks from now on
        self._operations = np.zeros(0, np.int64)  # of these rows
        self._places = np.zeros(0)  # of the table, behind each of them
        self._pace = Pace(machine.tick_clock)
        self._events: deque[Event] = deque()
        self._wanted_until = 0  # tick from which on what is held is the spare tail
        self._position = np.zeros(len(machine.axes), dtype=np.int64)
        self._last = False  # what is held ends with the last row of the run

    def _new_session(self) -> RowSession:
        """Return what the rows are played on, at rest at the start."""
        return session_of(self._machine, self._start)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels that it reports."""
        return self._session.channels

    @property
    def tick(self) -> int:
        """Ticks since the beginning of the run."""
        return self._session.tick

    @property
    def held(self) -> int:
        """Number of rows that it holds."""
        return len(self._rows)

    @property
    def position(self) -> IntArray:
        """(axes,) counts commanded since the beginning of the run."""
        return self._position

    @property
    def wanted(self) -> int:
        """Number of rows that it holds, without the braking tail."""
        return max(0, self._wanted_until - self.tick)

    def _drop(self) -> None:
        self._hold_nothing()
        self._events.clear()

    def _hold_nothing(self) -> None:
        self._rows, self._operations = self._rows[:0], self._operations[:0]
        self._places = self._places[:0]

    def _start_anew(self) -> str:
        if self._session.tick:
            self._start = self._start + self._position
            self._position = np.zeros_like(self._position)
            self._session = self._new_session()
        self._pace = Pace(self._machine.tick_clock)
        self._wanted_until, self._last = 0, False
        return ""

    def _take_refill(self, message: Message) -> str:
        """Replace the rows from a tick on; refuse rows that do not continue those before them."""
        first, wanted = int(message.head["first"]), int(message.head["wanted"])
        counts, operation = message.arrays["counts"], message.arrays["operation"]
        if why := self._unfit(first, message.arrays["at"]):
            return why
        kept = first - self.tick
        rest = np.zeros((max(kept - len(self._rows), 0), len(self._position)), np.int64)
        self._rows = np.concatenate([self._rows[:kept], rest, counts.astype(np.int64, copy=False)])
        self._operations = np.concatenate(
            [self._operations[:kept], rest[:, 0], operation.astype(np.int64, copy=False)]
        )
        places = self._places[:kept]
        stands = places[-1] if len(places) else self._pace.place
        # A jog has no places: it is no part of a plan.
        behind = message.arrays.get("place", stands + np.arange(1.0, len(counts) + 1.0))
        self._places = np.concatenate([places, np.full(len(rest), stands), behind])
        self._events = deque(event for event in self._events if event.tick < first)
        self._events.extend(event_of(told) for told in message.head["events"])
        self._wanted_until = first + wanted
        self._last = bool(message.head["last"])
        return ""

    def _unfit(self, first: int, at: FloatArray | IntArray) -> str:
        if first < self.tick:
            return "that tick is past"
        stands = self._position + self._rows[: first - self.tick].sum(axis=0)
        if not np.array_equal(stands, at):
            return "its rows do not go on from where those before them end"
        return ""

    def _tell_end(self, ended: Ended, text: str) -> None:
        self._session.resume()
        self._session.finish(ended, text)

    def _simulate(self, ticks: int) -> list[RecordingBlock]:
        until = self.tick + ticks
        parts: list[RecordingBlock] = []
        while self.tick < until and not self._session.failed:
            room = until - self.tick
            parts.append(self._row_block(room) if len(self._rows) else self._stand(room))
        if self._session.failed:  # nothing is known of it any more
            self._hold_nothing()
        return parts

    def _row_block(self, room: int) -> RecordingBlock:
        """Play at most ``room`` of the rows that are held."""
        n = min(room, len(self._rows))
        counts, self._rows = self._rows[:n], self._rows[n:]
        operation, self._operations = self._operations[:n], self._operations[n:]
        places, self._places = self._places[:n], self._places[n:]
        session, first = self._session, self.tick
        session.resume()
        due = []
        while self._events and self._events[0].tick <= self.tick + n:
            event = self._events.popleft()
            due.append(replace(event, tick=session.row + event.tick - self.tick))
        rows = TickBlock(
            first_tick=session.row,
            counts=counts,
            operation=operation,
            events=tuple(due),
        )
        self._position = self._position + counts.sum(axis=0)
        if self.tick + n > self._wanted_until:
            self.starved = True
        block = session.advance(rows)
        return _telling(block, self._pace.played(first, places[: self.tick - first]))

    def _stand(self, room: int) -> RecordingBlock:
        session, first = self._session, self.tick
        stands = session.row > 0 and not self._last and session.ended is None
        if self._last:
            session.finish()
        elif stands and not self.starved:
            session.hold()
        block = session.advance(ticks=room)
        return _telling(block, self._pace.stood(first, self.tick - first) if stands else ())


def _telling(block: RecordingBlock, more: tuple[Event, ...]) -> RecordingBlock:
    """Return a block that tells of more events, in the order of their ticks."""
    if not more:
        return block
    return replace(block, events=tuple(sorted([*block.events, *more], key=lambda e: e.tick)))
