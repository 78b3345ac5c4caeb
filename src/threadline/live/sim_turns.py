"""A simulated embroidery frame: it holds turns of the shaft, each of which ends at rest."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.live.sim_faults import SimFault
from threadline.live.sim_machine import SimMachine
from threadline.live.wire import Message, event_of
from threadline.machine import Machine
from threadline.signals import (
    Channel,
    Clock,
    Ended,
    RecordingBlock,
    StepPlay,
    StepTable,
    StitchBlock,
    Stream,
)
from threadline.signals.step_play import CountedBy
from threadline.twin.stitching import stitching_channels
from threadline.twin.stitching_session import COLUMNS, StitchingSession


class SimTurns(SimMachine):
    """A machine that plays a table of steps for each turn and axis; see ``SimMachine``."""

    def __init__(
        self,
        machine: Machine,
        start: IntArray,
        tell: Callable[[Message], None],
        fault: SimFault | None = None,
    ) -> None:
        super().__init__(machine, start, tell, fault)
        self._home_at = start
        self._session: StitchingSession | None = None  # until it has its tables
        self._idle = 0  # samples without tables
        self._last = False
        self._until = 0  # sample up to which it was told whether turns begin

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
        if self._enabled and self.standing:  # the frame goes back to where it was switched on
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
            return f"it is told the turns after {head['after']}, and has others"
        columns = {name: np.asarray(arrays[name], dtype=np.int64) for name in COLUMNS}
        events = tuple(event_of(told) for told in head["events"])
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
        """Return commands of this machine; ``window`` is a part of so many of a turn."""
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
        """Play one turn of one step on each axis: without tables nothing would be played."""
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

    def _tell_end(self, ended: Ended, text: str) -> None:
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

    def _told_besides(self) -> dict[str, Any]:
        return {"rests_at": 0 if self._session is None else self._session.rests_at}
