"""Rows of counts that LinuxCNC's HAL plays, driven by the messages of an executor.

Sent rows are kept here as in the simulated machine, and the clock advances by the samples of HAL: a
tick is over when its sample has come back. HAL's commands to the drives must equal the sent rows,
count by count.
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
"""Lateness is measured in ticks, or in this time, s, if a tick is shorter."""


class _Played(RowSession):
    """Rows that HAL plays: measured values are HAL's samples."""

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
        return False  # nothing is wired to HAL

    def _read(self, part: Part) -> Mapping[Any, FloatArray]:
        """Return the samples of the ticks of a part."""
        samples = self._sampled(len(part.travelled))
        self._tick += len(part.travelled)
        difference = np.abs(samples.commanded - self._start - part.travelled).max(initial=0.0)
        if difference and not self.failed:
            self.fail(
                f"HAL's commands to the drives differ from the sent rows by {difference:.0f} counts"
            )
        return {"commanded": samples.commanded, "read": np.rint(samples.read)}

    def fail(self, why: str) -> None:
        """Record a fault, after which nothing is known."""
        self.failed = True
        self._rows.clear()
        self._events.clear()
        self._halted, self._held = None, False
        self._ended, self._final = (RunEnd.FAULT, why), True
        self._record_event("fault", name=why)

    def _block(self, first: int, parts: list[Part]) -> RecordingBlock:
        no_rows = np.zeros((0, len(self._start)))
        commanded, read = (
            np.concatenate([no_rows, *(part.read[name] for part in parts)])
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
        clock_name = self._machine.tick_clock.name
        return RecordingBlock(first_tick={clock_name: first}, samples=samples, events=events)


def _channels(machine: Machine, *, plant: bool) -> list[Channel]:
    clock, kinds = machine.tick_clock, [ChannelKind.COMMANDED]
    if plant:
        kinds.append(ChannelKind.MEASURED)
    channels = [
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
    return [*channels, operation]


class HalRows(SimRows):
    """A machine whose rows HAL plays; see ``SimMachine``.

    Parameters
    ----------
    machine, start, tell
        See ``SimMachine``.
    hal
        The running HAL.
    plant
        Whether HAL contains a plant.
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
        self._first_record = 0  # record number of the first tick of the run
        self._came: list[Samples] = []
        super().__init__(machine, start, tell)
        self._period_s = float(machine.tick_clock.period_s)
        self._silent_s = 0.0

    def _new_session(self) -> RowSession:
        return _Played(self._machine, self._start, self._take_samples, plant=self._plant)

    def _start_anew(self) -> str:
        why = super()._start_anew()
        self._hal.fill()
        self._first_record = self._hal.end  # after the waiting records, all at rest
        self._came = []
        return why

    def _take_refill(self, message: Message) -> str:
        """Replace the rows from a tick on, in HAL, too."""
        first = int(message.head["first"])
        position, counts = message.arrays["at"], message.arrays["counts"]
        if why := self._unfit(first, position):
            return why
        moved_counts = np.cumsum(np.asarray(counts, np.float64), axis=0)
        new_positions = (
            self._start
            + position
            + (moved_counts if len(moved_counts) else np.zeros((1, len(position))))
        )
        # At the tick ``first`` the axes still stand at ``position``, whatever follows.
        if not self._hal.replace(self._first_record + first + 1, new_positions):
            return "that tick is past"
        return super()._take_refill(message)

    def go_on(self, waited_s: float) -> None:
        """Take HAL's samples; report them if a run has begun.

        Parameters
        ----------
        waited_s
            Time since the last call.
        """
        self._hal.fill()
        samples = self._hal.samples()
        is_new = np.diff(samples.record, prepend=-1) > 0  # at an underrun the last record repeats
        self._silent_s = 0.0 if len(samples.record) else self._silent_s + waited_s
        if not self.begun or self._session.failed:
            return
        is_of_run = is_new & (samples.record >= self._first_record)
        late_s = np.max(samples.interval_s, initial=0.0) - self._period_s
        late_s += self._period_s * np.count_nonzero(~is_new)
        due_samples = Samples.joined([*self._came, samples.at(is_of_run)])
        record_numbers = due_samples.record
        why = ""
        if self._hal.lost:
            why = f"{self._hal.lost} samples of HAL were lost"
        elif (np.diff(record_numbers) != 1).any():
            why = "samples of HAL are missing"
        elif self._silent_s > SILENT_S:
            why = f"HAL's thread has stood still for {self._silent_s:.1f} s"
        self._came = [due_samples]
        if why:
            assert isinstance(self._session, _Played)
            self._session.fail(why)
            self._report(self.tick, [self._session.advance(ticks=0)], 0.0)
        elif len(record_numbers):
            self.play(len(record_numbers), float(late_s / max(self._period_s, _REPORTS_S)))

    def _take_samples(self, ticks: int) -> Samples:
        """Return the samples of the next ticks."""
        arrived = Samples.joined(self._came)
        if len(arrived.record) < ticks:
            raise LinkFaultError(f"{ticks} ticks of HAL were due, {len(arrived.record)} have come")
        self._came = [arrived.at(slice(ticks, None))]
        return arrived.at(slice(ticks))
