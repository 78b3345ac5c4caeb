"""Simulated machines with axes, cylinders and an embroidery frame, behind one link.

The simulated valve controller holds a piece of the schedule, a place that it does not pass, and a
scan from which on it switches everything off. Each refill moves both on.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.files import (
    Channel,
    Clock,
    Event,
    RecordingBlock,
    RunEnd,
    StepPlay,
    StepTable,
    StitchBlock,
    Stream,
    TickBlock,
)
from threadline.files.step_play import CountedBy
from threadline.live.pace import Pace
from threadline.live.sim_machine import SimMachine
from threadline.live.wire import Message, creep_of, event_of
from threadline.twin import session_of
from threadline.twin.row_session import RowSession
from threadline.twin.stitching import COLUMNS, StitchingSession, stitching_channels
from threadline.twin.switching_session import SwitchingSession


class SimRows(SimMachine):
    """A machine that plays a row of counts at each tick; see ``SimMachine``."""

    def _set_up(self) -> None:
        self._session, axes = self._new_session(), len(self._machine.axes)
        self._rows = np.zeros((0, axes), np.int64)  # held, for the ticks from now on
        self._operations = np.zeros(0, np.int64)  # of these rows
        self._places = np.zeros(0)  # in the table, after each of them
        self._pace = Pace(self._machine.tick_clock)
        self._events: deque[Event] = deque()
        self._tail_from = 0  # tick from which on the held rows are the spare tail
        self._position = np.zeros(axes, dtype=np.int64)
        self._last = False  # the held rows end with the last row of the run

    def _new_session(self) -> RowSession:
        """Return the session that plays the rows, at rest at the start."""
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
        return max(0, self._tail_from - self.tick)

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
        self._tail_from, self._last = 0, False
        return ""

    def _take_refill(self, message: Message) -> str:
        """Replace the rows from a tick on; refuse rows that do not continue the earlier ones."""
        first, row_count = int(message.head["first"]), int(message.head["wanted"])
        counts, operation = message.arrays["counts"], message.arrays["operation"]
        if why := self._unfit(first, message.arrays["at"]):
            return why
        kept_count = first - self.tick
        rest_rows = np.zeros((max(kept_count - len(self._rows), 0), len(self._position)), np.int64)
        self._rows = np.concatenate(
            [self._rows[:kept_count], rest_rows, counts.astype(np.int64, copy=False)]
        )
        self._operations = np.concatenate(
            [self._operations[:kept_count], rest_rows[:, 0], operation.astype(np.int64, copy=False)]
        )
        places = self._places[:kept_count]
        last_place = places[-1] if len(places) else self._pace.place
        # A jog has no places: it belongs to no plan.
        new_places = message.arrays.get("place", last_place + np.arange(1.0, len(counts) + 1.0))
        self._places = np.concatenate([places, np.full(len(rest_rows), last_place), new_places])
        self._events = deque(event for event in self._events if event.tick < first)
        self._events.extend(event_of(listed) for listed in message.head["events"])
        self._tail_from = first + row_count
        self._last = bool(message.head["last"])
        return ""

    def _unfit(self, first: int, position: FloatArray | IntArray) -> str:
        if first < self.tick:
            return "that tick is past"
        end_position = self._position + self._rows[: first - self.tick].sum(axis=0)
        if not np.array_equal(end_position, position):
            return "its rows do not go on from where those before them end"
        return ""

    def _tell_end(self, ended: RunEnd, text: str) -> None:
        self._session.resume()
        self._session.finish(ended, text)

    def _simulate(self, ticks: int) -> list[RecordingBlock]:
        end_tick = self.tick + ticks
        blocks: list[RecordingBlock] = []
        while self.tick < end_tick and not self._session.failed:
            ticks_left = end_tick - self.tick
            blocks.append(
                self._row_block(ticks_left) if len(self._rows) else self._stand(ticks_left)
            )
        if self._session.failed:  # its state is unknown
            self._hold_nothing()
        return blocks

    def _row_block(self, max_rows: int) -> RecordingBlock:
        """Play at most ``max_rows`` of the held rows."""
        n = min(max_rows, len(self._rows))
        counts, self._rows = self._rows[:n], self._rows[n:]
        operation, self._operations = self._operations[:n], self._operations[n:]
        places, self._places = self._places[:n], self._places[n:]
        session, first = self._session, self.tick
        session.resume()
        due_events = []
        while self._events and self._events[0].tick <= self.tick + n:
            event = self._events.popleft()
            due_events.append(replace(event, tick=session.row + event.tick - self.tick))
        tick_block = TickBlock(
            first_tick=session.row, counts=counts, operation=operation, events=tuple(due_events)
        )
        self._position = self._position + counts.sum(axis=0)
        if self.tick + n > self._tail_from:
            self.starved = True
        block = session.advance(tick_block)
        return _telling(block, self._pace.played(first, places[: self.tick - first]))

    def _stand(self, ticks: int) -> RecordingBlock:
        session, first = self._session, self.tick
        is_waiting = session.row > 0 and not self._last and session.ended is None
        if self._last:
            session.finish()
        elif is_waiting and not self.starved:
            session.hold()
        block = session.advance(ticks=ticks)
        passed_ticks = self.tick - first
        if self._last:
            return _telling(block, self._pace.after_end(first, passed_ticks))
        return _telling(block, self._pace.stood(first, passed_ticks) if is_waiting else ())


def _telling(block: RecordingBlock, events: tuple[Event, ...]) -> RecordingBlock:
    """Return a block with more events, in the order of their ticks."""
    if not events:
        return block
    return replace(
        block, events=tuple(sorted([*block.events, *events], key=lambda event: event.tick))
    )


class SimScans(SimMachine):
    """A machine that plays a schedule of outputs; see ``SimMachine``."""

    def _set_up(self) -> None:
        self._session = self._at_home()
        self._last = False  # it has all of the schedule, or was told to stop

    def _at_home(self) -> SwitchingSession:
        fault = self._fault
        broken = fault is not None and fault.kind == "light-grid"
        scan_s = float(self._machine.command_clock.period_s)
        return SwitchingSession(
            self._machine, break_s=fault.tick * scan_s if broken and fault is not None else None
        )

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels that it reports."""
        return self._session.channels

    @property
    def tick(self) -> int:
        """Scans since the beginning of the run."""
        return self._session.tick

    @property
    def held(self) -> int:
        """1 while the schedule goes on, 0 when everything is off."""
        return int(self._begun and self._session.switched_off_at is None)

    @property
    def position(self) -> IntArray:
        """(0,): a valve controller has no positions."""
        return np.zeros(0, dtype=np.int64)

    def _drop(self) -> None:
        self._session.switch_off_at(self.tick)

    def _start_anew(self) -> str:
        if self._session.tick:  # homed since: the cylinders stand at their starts again
            self._session = self._at_home()
        self._last = False
        return ""

    def _take_refill(self, message: Message) -> str:
        head, arrays = message.head, message.arrays
        if "after" in head:
            if int(head["after"]) != self._session.taken:
                return f"it has {self._session.taken} rows, and got rows after {head['after']}"
            self._session.take(
                np.asarray(arrays["ticks"], dtype=np.int64),
                np.asarray(arrays["levels"], dtype=np.int64),
                np.asarray(arrays["operation"], dtype=np.int64),
                [event_of(listed) for listed in head["events"]],
                reach=int(head["reach"]),
                duration=None if head["duration"] is None else int(head["duration"]),
                creeps=[creep_of(row) for row in head["creeps"]],
            )
        self._last = bool(head["last"])
        self._session.switch_off_at(int(head["off"]))
        return ""

    def _at_home_samples(self) -> dict[str, FloatArray]:
        """Return the places of the pistons at home, the contacts they close, and the outputs."""
        samples = self._at_home().advance(1).samples
        return {name: values[:1].astype(np.float64) for name, values in samples.items()}

    def _tell_end(self, ended: RunEnd, text: str) -> None:
        self._session.finish(ended, text)

    def _simulate(self, ticks: int) -> list[RecordingBlock]:
        block = self._session.advance(ticks)
        self.starved = self.starved or (self._session.ran_dry and not self._last)
        return [block]

    def _urgent(self) -> tuple[object, ...]:
        return *super()._urgent(), self._session.failure

    def _extra_entries(self) -> dict[str, Any]:
        session = self._session
        return {"place": session.place, "off": session.switched_off_at, "failure": session.failure}


class SimTurns(SimMachine):
    """A machine that plays a table of steps for each turn and axis; see ``SimMachine``."""

    def _set_up(self) -> None:
        self._home_at = self._start
        self._session: StitchingSession | None = None  # until it has its tables
        self._idle = 0  # samples without tables
        self._last = False
        self._until = 0  # sample up to which the beginnings of turns are known

    @property
    def channels(self) -> tuple[Channel, ...]:
        """Channels that it reports."""
        return tuple(stitching_channels(self._machine))

    @property
    def tick(self) -> int:
        """Samples since the beginning of the run."""
        return self._idle if self._session is None else self._session.tick

    @property
    def held(self) -> int:
        """Samples until the frame rests."""
        return 0 if self._session is None else max(self._session.rests_at - self.tick, 0)

    @property
    def position(self) -> IntArray:
        """(A,) steps commanded since the beginning of the run."""
        if self._session is None:
            return np.zeros(len(self._machine.axes), dtype=np.int64)
        return np.rint(self._session.steps).astype(np.int64)

    def _drop(self) -> None:
        if self._session is not None:
            self._session.drop_from(self.tick)

    def _home(self, message: Message) -> None:
        if self._enabled and self.standing:  # the frame returns to its place at switch-on
            self._start, self._session = self._home_at, None
        super()._home(message)

    def _start_anew(self) -> str:
        self._start = self._start + self.position
        self._session, self._idle, self._last, self._until = None, 0, False, 0
        return ""

    def _take_refill(self, message: Message) -> str:
        head, arrays = message.head, message.arrays
        if "drop" in head:
            if self._session is None or int(head["drop"]) < self.tick:
                return "that tick is past"
            self._session.drop_from(int(head["drop"]))
            self._last, self._until = True, int(head["drop"])
            return ""
        if "lengths" in arrays:
            self._session = StitchingSession(self._machine, self._with_tables(message))
        session = self._session
        if session is None or int(head["after"]) != session.taken:
            return f"it got the turns after {head['after']}, and has others"
        columns = {name: np.asarray(arrays[name], dtype=np.int64) for name in COLUMNS}
        events = tuple(event_of(listed) for listed in head["events"])
        turns = StitchBlock(first_stitch=session.taken, events=events, **columns)
        following = head["following"]
        try:
            session.take(turns, None if following is None else (following[0], following[1]))
        except OptionError as error:
            return error.message
        self._last, self._until = bool(head["last"]), int(head["until"])
        return ""

    def _with_tables(self, message: Message) -> StepPlay:
        """Return commands without turns that have the tables of a first refill."""
        head, arrays = message.head, message.arrays
        ends = np.cumsum(arrays["lengths"])
        library = tuple(
            StepTable(units=int(units), intervals=np.asarray(part, dtype=np.int64))
            for units, part in zip(
                arrays["units"], np.split(arrays["intervals"], ends[:-1]), strict=True
            )
        )
        return self._without_turns(
            library,
            self._machine.clock(str(head["clock"])),
            head["counted_by"],
            (int(head["window_angle"]), int(head["steps_per_turn"])),
            np.asarray(arrays["steps_per_unit"], dtype=np.float64),
        )

    def _without_turns(
        self,
        library: tuple[StepTable, ...],
        clock: Clock,
        counted_by: CountedBy,
        window: tuple[int, int],
        steps_per_unit: FloatArray,
    ) -> StepPlay:
        """Return commands of this machine; ``window`` is a fraction of a turn."""
        return StepPlay(
            clock=clock,
            counted_by=counted_by,
            steps_per_turn=window[1],
            window_angle=window[0],
            axes=self._machine.axis_names,
            steps_per_unit=steps_per_unit,
            start_steps=self._start,
            library=library,
            blocks=Stream.of(()),
            duration_ticks=0,
            job_sha256="",
            machine_sha256=self._machine.sha256,
        )

    def _play_a_moment(self) -> None:
        """Play one turn with one step on each axis: without tables nothing would be played."""
        axes, machine = len(self._machine.axes), self._machine
        table = StepTable(units=1, intervals=np.ones(1, np.int64))
        play = self._without_turns((table,), machine.tick_clock, "time", (1, 2), np.ones(axes))
        session = StitchingSession(machine, play)
        one = np.ones(1, np.int64)
        turn = StitchBlock(
            first_stitch=0,
            begin=0 * one,
            window=one,
            table=np.zeros((1, axes), np.int64),
            sign=np.ones((1, axes), np.int64),
            start=0 * one,
            needle=one,
            operation=0 * one,
        )
        session.take(turn, None)
        session.advance(2)

    def _tell_end(self, ended: RunEnd, text: str) -> None:
        if self._session is not None:
            self._session.finish(ended, text)

    def _simulate(self, ticks: int) -> list[RecordingBlock]:
        if self._session is None:
            self._idle += ticks
            return []
        block = self._session.advance(ticks)
        if self.tick > self._until and not self._last:
            self.starved = True
        return [block]

    def _extra_entries(self) -> dict[str, Any]:
        return {"rests_at": 0 if self._session is None else self._session.rests_at}
