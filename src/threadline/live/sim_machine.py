"""The simulated machine at the far end of a link: a twin that plays rows tick by tick.

It knows nothing of jobs and plans. It holds rows that end in a braking tail, and plays one row at
each tick. A refill replaces the rows from a tick on; without refills the tail is played, and the
machine stands. A real machine has to act in the same way on the same messages.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.live.greeting import greeting
from threadline.live.sim_faults import SimFault
from threadline.live.wire import Message, event_of, event_told
from threadline.machine import Machine
from threadline.signals import Ended, Event, RecordingBlock, TickBlock
from threadline.twin import session_of

LATE = 0.5
"""Share of the period by which a report may come later than it is due."""


class SimMachine:
    """A machine that answers the messages of an executor.

    Parameters
    ----------
    machine
        The machine that is simulated.
    start_counts
        (axes,) position when it is switched on, in counts; it is its home, too.
    tell
        Called with each message to the executor.
    fault
        Injected fault, or None.
    """

    def __init__(
        self,
        machine: Machine,
        start_counts: IntArray,
        tell: Callable[[Message], None],
        fault: SimFault | None = None,
    ) -> None:
        self._fault, self._stuck = fault, dict[str, float]()
        self._machine, self._start, self._tell = machine, start_counts, tell
        self._session = session_of(machine, start_counts)
        self._rows: deque[tuple[IntArray, int]] = deque()  # held, one for each tick from now on
        self._events: deque[Event] = deque()
        self._wanted_until = 0  # tick from which on what is held is the spare tail
        self._position = np.zeros(len(machine.axes), dtype=np.int64)  # commanded, from the start
        self._enabled = self._homed = self._begun = False
        self._number = 0  # of runs and jogs since it was switched on
        self._last = False  # what is held ends with the last row of the run
        self.starved = False
        self.left = False  # the executor has said that it is done
        self._answers: dict[str, Callable[[Message], None]] = {
            "enable": self._enable, "disable": self._disable, "home": self._home,
            "begin": self._begin, "refill": self._refill, "finish": self._finish,
            "leave": self._leave, "go": self._go,
        }  # fmt: skip

    @property
    def tick(self) -> int:
        """Ticks since the beginning of the run."""
        return self._session.tick

    @property
    def silenced(self) -> str:
        """Kind of the fault because of which it sends no messages; empty without one."""
        fault = self._fault
        return fault.kind if fault is not None and fault.silences(self.tick) else ""

    @property
    def position(self) -> IntArray:
        """(axes,) counts commanded since the beginning of the run."""
        return self._position

    @property
    def wanted(self) -> int:
        """Number of rows that it holds, without the braking tail."""
        return max(0, self._wanted_until - self.tick)

    @property
    def standing(self) -> bool:
        """Whether it holds no more rows, so that the commands stand still."""
        return not self._rows

    @property
    def begun(self) -> bool:
        """Whether its clock runs."""
        return self._begun

    def greet(self) -> None:
        """Send the greeting."""
        self._say("hello", **greeting(self._machine, self._session.channels))

    def take(self, message: Message) -> None:
        """Act on a message of the executor, or refuse it."""
        answer = self._answers.get(message.kind)
        if answer is None:
            self._say("refused", what=message.kind, why="it is unknown here")
        else:
            answer(message)

    def _say(self, kind: str, **head: Any) -> None:
        self._tell(Message(kind, head))

    # --- what it is told -------------------------------------------------------------------

    def _enable(self, _message: Message) -> None:
        self._enabled = True
        self._say("enabled")

    def _disable(self, _message: Message) -> None:
        self._rows.clear()
        self._events.clear()
        self._enabled = self._homed = self._begun = False

    def _home(self, _message: Message) -> None:
        # It is switched on at its home: there is nothing to look for.
        if self._enabled:
            self._homed, self.starved = True, False
            self._say("homed", position=(self._start + self._position).tolist())
        else:
            self._say("refused", what="home", why="the drives are off")

    def _begin(self, _message: Message) -> None:
        """Begin a run: the clock starts at 0, at the present position."""
        if not (self._enabled and self._homed and self.standing) or self.starved:
            self._say("refused", what="begin", why="it is not enabled, homed and at rest")
            return
        if self._session.tick:
            self._start = self._start + self._position
            self._position = np.zeros_like(self._position)
            self._session = session_of(self._machine, self._start)
        self._wanted_until, self._last, self._begun = 0, False, True
        self._number += 1

    def _refill(self, message: Message) -> None:
        """Replace the rows from a tick on; refuse rows that do not continue those before them."""
        first, wanted = int(message.head["first"]), int(message.head["wanted"])
        counts, operation = message.arrays["counts"], message.arrays["operation"]
        if why := self._unfit(first, message.arrays["at"]):
            self._say("refused", what="refill", why=why, tick=self.tick, first=first)
            return
        kept = first - self.tick
        while len(self._rows) > kept:
            self._rows.pop()
        while len(self._rows) < kept:
            self._rows.append((np.zeros_like(self._position), 0))
        rows = np.asarray(counts, dtype=np.int64)
        self._rows.extend(zip(rows, (int(value) for value in operation), strict=True))
        self._events = deque(event for event in self._events if event.tick < first)
        self._events.extend(event_of(told) for told in message.head["events"])
        self._wanted_until = first + wanted
        self._last = bool(message.head["last"])

    def _unfit(self, first: int, at: FloatArray | IntArray) -> str:
        if not self._begun:
            return "the run has not begun"
        if self.starved:
            return "it has braked since the last refill came too late"
        if first < self.tick:
            return "that tick is past"
        held = list(self._rows)[: first - self.tick]
        stands = self._position + sum((row for row, _ in held), np.zeros_like(self._position))
        if not np.array_equal(stands, at):
            return "its rows do not go on from where those before them end"
        return ""

    def _finish(self, message: Message) -> None:
        self._session.resume()
        self._session.finish(Ended(message.head["ended"]), str(message.head["text"]))

    def _leave(self, _message: Message) -> None:
        self.left = True

    def _go(self, _message: Message) -> None:
        """Do nothing: the message only lets time go on (see ``sim_process``)."""

    # --- what it does ----------------------------------------------------------------------

    def play(self, ticks: int, late_by: float = 0.0) -> None:
        """Simulate a number of ticks, and report them.

        Parameters
        ----------
        ticks
            Number of ticks.
        late_by
            Lateness of the report, as a multiple of the time of all these ticks.
        """
        first = self.tick
        parts: list[RecordingBlock] = []
        while self.tick < first + ticks and not self._session.failed:
            room = first + ticks - self.tick
            parts.append(self._row_block(room) if self._rows else self._stand(room))
        if self._session.failed:  # nothing is known of it any more
            self._rows.clear()
        self._report(first, parts, late_by)

    def _row_block(self, room: int) -> RecordingBlock:
        """Play at most ``room`` of the rows that are held."""
        n = min(room, len(self._rows))
        taken = [self._rows.popleft() for _ in range(n)]
        counts = np.array([row for row, _ in taken], dtype=np.int64)
        session = self._session
        session.resume()
        due = []
        while self._events and self._events[0].tick <= self.tick + n:
            event = self._events.popleft()
            due.append(replace(event, tick=session.row + event.tick - self.tick))
        rows = TickBlock(
            first_tick=session.row,
            counts=counts,
            operation=np.array([operation for _, operation in taken]),
            events=tuple(due),
        )
        self._position = self._position + counts.sum(axis=0)
        if self.tick + n > self._wanted_until:
            self.starved = True
        return session.advance(rows)

    def _stand(self, room: int) -> RecordingBlock:
        session = self._session
        if self._last:
            session.finish()
        elif session.row and session.ended is None and not self.starved:
            session.hold()
        return session.advance(ticks=room)

    def _report(self, first: int, parts: list[RecordingBlock], late_by: float) -> None:
        names = parts[0].samples if parts else ()
        arrays = {
            name: np.concatenate([part.samples[name] for part in parts]).astype(np.float64)
            for name in names
        }
        if self._fault is not None:
            self._fault.told(first, arrays, self._machine, self._stuck)
            late_by = max(late_by, self._fault.late(first))
        late = self.tick - first if late_by > LATE else 0
        events = [event_told(event) for part in parts for event in part.events]
        if late:
            told = Event(tick=first, kind="late", operation=-1, value=float(late))
            events.append(event_told(told))
        head = {
            "run": self._number, "tick": first, "now": self.tick, "held": len(self._rows),
            "starved": self.starved, "late": late, "late_by": late_by, "events": events,
            "position": self._position.tolist(),
        }  # fmt: skip
        self._tell(Message("report", head, arrays))
