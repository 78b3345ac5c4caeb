"""A link that lets LinuxCNC's HAL play the rows of counts that the executor sends.

The link keeps the rows that HAL has not played yet, as the simulated machine does. Its clock
follows HAL: a tick is over when HAL's sample of this tick has arrived. The positions that HAL
commands to the drives must equal the sent rows to the count.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import LinkFaultError
from threadline.files import Channel, ChannelKind, RecordingBlock, RunEnd
from threadline.live.hal_session import SILENT_S, HalSession, Samples
from threadline.live.sim_kinds import SimRows
from threadline.live.wire import Message
from threadline.machine import Machine
from threadline.twin.row_session import Part, RowSession

_REPORTS_S = 0.005
"""Least unit in which lateness is reported, s; the unit is one tick if a tick is longer."""


class _Played(RowSession):
    """A session whose rows HAL plays; its readings are the samples of HAL."""

    def __init__(
        self, machine: Machine, start: IntArray, sampled: Callable[[int], Samples], *, plant: bool
    ) -> None:
        super().__init__(machine, start)
        self._tick, self._sampled, self._plant = 0, sampled, plant
        self.channels = tuple(_channels(machine, plant=plant))

    @property
    def tick(self) -> int:
        return self._tick

    def _tripped(self, name: str) -> bool:  # noqa: ARG002
        return False  # no limit switch is wired to HAL

    def _read(self, part: Part) -> Mapping[Any, FloatArray]:
        """Return HAL's samples of the ticks of a part; compare its commands with the sent rows."""
        found = self._sampled(len(part.travelled))
        self._tick += len(part.travelled)
        wrong = np.abs(found.commanded - self._start - part.travelled).max(initial=0.0)
        if wrong and not self.failed:
            self.fail(
                f"HAL's commands to the drives differ from the sent rows by {wrong:.0f} counts"
            )
        return {"commanded": found.commanded, "read": np.rint(found.read)}

    def fail(self, why: str) -> None:
        """End the run with a fault: drop the remaining rows and events, and record the reason."""
        self.failed = True
        self._rows.clear()
        self._events.clear()
        self._halted, self._held = None, False
        self._ended, self._final = (RunEnd.FAULT, why), True
        self._record_event("fault", name=why)

    def _block(self, first: int, parts: list[Part]) -> RecordingBlock:
        nothing = np.zeros((0, len(self._start)))
        commanded, read = (
            np.concatenate([nothing, *(part.read[name] for part in parts)])
            / self._machine.counts_per_unit
            for name in ("commanded", "read")
        )
        samples: dict[str, FloatArray] = {}
        for k, name in enumerate(self._machine.axes):
            samples[f"{name}.commanded"] = commanded[:, k]
            if self._plant:
                samples[f"{name}.measured"] = read[:, k]
        samples["operation"] = np.concatenate(
            [np.zeros(0), *(part.operation.astype(np.float64) for part in parts)]
        )
        events, self._pending_events = tuple(self._pending_events), []
        clock = self._machine.tick_clock.name
        return RecordingBlock(first_tick={clock: first}, samples=samples, events=events)


def _channels(machine: Machine, *, plant: bool) -> list[Channel]:
    clock, kinds = machine.tick_clock, [ChannelKind.COMMANDED]
    if plant:
        kinds.append(ChannelKind.MEASURED)
    found = [
        Channel(
            name=f"{name}.{kind.value}",
            kind=kind,
            unit="m" if axis.kind == "linear" else "rad",
            clock=clock,
            axis=name,
        )
        for name, axis in machine.axes.items()
        for kind in kinds
    ]
    operation = Channel(name="operation", kind=ChannelKind.OPERATION, unit="", clock=clock)
    return [*found, operation]


class HalRows(SimRows):
    """A machine whose rows HAL plays; its messages are the messages of ``SimMachine``.

    Parameters
    ----------
    machine, start, tell
        See ``SimMachine``.
    hal
        The session with the running HAL.
    plant
        Whether HAL simulates a plant; without one, no measured positions are reported.
    """

    def __init__(
        self,
        machine: Machine,
        start: IntArray,
        tell: Callable[[Message], None],
        hal: HalSession,
        *,
        plant: bool,
    ) -> None:
        self._hal, self._plant = hal, plant
        self._first_record = 0  # number of HAL's record at the first tick of the run
        self._came: list[Samples] = []
        super().__init__(machine, start, tell)
        self._period_s = float(machine.tick_clock.period_s)
        self._silent_s = 0.0

    def _new_session(self) -> RowSession:
        return _Played(self._machine, self._start, self._take_samples, plant=self._plant)

    def _start_anew(self) -> str:
        why = super()._start_anew()
        self._hal.fill()
        self._first_record = self._hal.end  # the records before it are all at rest
        self._came = []
        return why

    def _take_refill(self, message: Message) -> str:
        """Replace the rows from a tick on, both in HAL and in the link."""
        first = int(message.head["first"])
        at, counts = message.arrays["at"], message.arrays["counts"]
        if why := self._unfit(first, at):
            return why
        moved = np.cumsum(np.asarray(counts, np.float64), axis=0)
        positions = self._start + at + (moved if len(moved) else np.zeros((1, len(at))))
        # The position ``at`` at the tick ``first`` stays: the first new row sets the next record.
        if not self._hal.replace(self._first_record + first + 1, positions):
            return "that tick is past"
        return super()._take_refill(message)

    def go_on(self, waited_s: float) -> None:
        """Read HAL's new samples; if a run has begun, report them, or a fault of HAL.

        Parameters
        ----------
        waited_s
            Time since the last call, s.
        """
        self._hal.fill()
        arrived = self._hal.samples()
        is_new = np.diff(arrived.record, prepend=-1) > 0  # HAL repeats a record at an underrun
        self._silent_s = 0.0 if len(arrived.record) else self._silent_s + waited_s
        if not self.begun or self._session.failed:
            return
        kept = is_new & (arrived.record >= self._first_record)
        late_s = np.max(arrived.interval_s, initial=0.0) - self._period_s
        late_s += self._period_s * np.count_nonzero(~is_new)
        waiting = Samples.joined([*self._came, arrived.at(kept)])
        records = waiting.record
        fault = ""
        if self._hal.lost:
            fault = f"{self._hal.lost} samples of HAL were lost"
        elif (np.diff(records) != 1).any():
            fault = "samples of HAL are missing"
        elif self._silent_s > SILENT_S:
            fault = f"HAL's thread has stood still for {self._silent_s:.1f} s"
        self._came = [waiting]
        if fault:
            assert isinstance(self._session, _Played)
            self._session.fail(fault)
            self._report(self.tick, [self._session.advance(ticks=0)], 0.0)
        elif len(records):
            self.play(len(records), float(late_s / max(self._period_s, _REPORTS_S)))

    def _take_samples(self, ticks: int) -> Samples:
        """Remove the samples of the next ``ticks`` ticks from the waiting samples; return them."""
        waiting = Samples.joined(self._came)
        if len(waiting.record) < ticks:
            raise LinkFaultError(f"{ticks} ticks of HAL were due, {len(waiting.record)} have come")
        self._came = [waiting.at(slice(ticks, None))]
        return waiting.at(slice(ticks))
