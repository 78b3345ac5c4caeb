"""A simulated machine with cylinders: its controller plays a schedule, scan by scan.

It holds a piece of the schedule, a place that it does not pass, and a scan from which on it
switches everything off. Each refill moves both on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from threadline.arrays import IntArray
from threadline.live.sim_faults import SimFault
from threadline.live.sim_machine import SimMachine
from threadline.live.wire import Message, event_of
from threadline.machine import Machine
from threadline.signals import Channel, Ended, RecordingBlock
from threadline.twin.switching_session import SwitchingSession


class SimScans(SimMachine):
    """A machine that plays a schedule of outputs; see ``SimMachine``."""

    def __init__(
        self,
        machine: Machine,
        start: IntArray,
        tell: Callable[[Message], None],
        fault: SimFault | None = None,
    ) -> None:
        super().__init__(machine, start, tell, fault)
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
        """(0,): a controller of valves knows no positions."""
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
                return f"it has {self._session.taken} rows, and is told those after {head['after']}"
            self._session.take(
                np.asarray(arrays["ticks"], dtype=np.int64),
                np.asarray(arrays["levels"], dtype=np.int64),
                np.asarray(arrays["operation"], dtype=np.int64),
                [event_of(told) for told in head["events"]],
                reach=int(head["reach"]),
                duration=None if head["duration"] is None else int(head["duration"]),
            )
        self._last = bool(head["last"])
        self._session.switch_off_at(int(head["off"]))
        return ""

    def _tell_end(self, ended: Ended, text: str) -> None:
        self._session.finish(ended, text)

    def _simulate(self, ticks: int) -> list[RecordingBlock]:
        block = self._session.advance(ticks)
        self.starved = self.starved or (self._session.ran_dry and not self._last)
        return [block]

    def _told_besides(self) -> dict[str, Any]:
        session = self._session
        return {
            "place": session.place,
            "off": session.switched_off_at,
            "failure": session.failure,
        }
