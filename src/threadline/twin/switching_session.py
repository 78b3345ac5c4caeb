"""A simulated machine with cylinders that receives its switching schedule in pieces.

The simulated PLC plays the schedule scan by scan: it switches outputs and waits for contacts. At
the end of the pieces received so far it holds: the outputs stay as they are until the next
piece arrives. ``switch_off_at`` guards against a sender that fails: at the scan given last, the PLC
switches all outputs off. A sender that works moves this scan on in time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from threadline.base.arrays import IntArray
from threadline.dynamics.values import Values
from threadline.errors import OptionError
from threadline.files import Creep, Event, EventKind, RecordingBlock, RunEnd, SwitchSchedule
from threadline.machine import Machine
from threadline.twin.switching import (
    SAMPLE_S,
    SwitchOptions,
    openings,
    orders_of,
    run_block,
    stall_of,
    states_of,
    switching_channels,
    times_of,
)
from threadline.twin.switching_cylinder import cylinders_of
from threadline.twin.switching_run import (
    CALMING,
    LATER,
    LEFT,
    PHASE,
    ROW,
    RUNNING,
    SAMPLE,
    SCAN,
    STALL,
    STALLED,
    TICK,
    WAIT,
    Orders,
    Progress,
    Record,
    begin,
    run,
)

_ENDLESS = 1 << 60
"""A number of scans that no run reaches."""


class SwitchingSession:
    """One simulated machine with cylinders that receives its switching schedule in pieces.

    If each piece arrives before the schedule reaches the end of the piece before it, the samples
    are equal to the samples of ``simulate_switching``, bit for bit, for any division into pieces.

    Parameters
    ----------
    machine
        The simulated machine. It starts with its cylinders at stroke 0 and all outputs off.
    break_s
        Instant at which a beam of the light grid is broken, s; None for never.

    Attributes
    ----------
    channels
        The channels of the blocks that ``advance`` returns.
    tick
        Number of scans simulated so far, including waits and holds.
    taken
        Number of rows received so far.
    failure
        Which contact a wait did not get in time, in words; empty if no wait failed.
    ran_dry
        Whether all outputs were switched off because the scan of ``switch_off_at`` came first.

    Raises
    ------
    MachineError
        If a cylinder has no equations, or a time is not a whole number of ticks.
    """

    def __init__(self, machine: Machine, *, break_s: float | None = None) -> None:
        self._machine, self._options = machine, SwitchOptions(break_s=break_s)
        self._values = Values.of(machine)
        self._units = times_of(machine, machine.command_clock.period_s, self._values)
        names = tuple(machine.cylinders)
        cylinders = cylinders_of(machine, names, self._values, float(SAMPLE_S))
        self._bank, self._motion = cylinders.bank(0), cylinders.at_rest(0)
        self._outputs = tuple(machine.outputs)
        self.channels = tuple(switching_channels(self._outputs, machine))
        self._ticks = np.zeros(0, dtype=np.int64)
        self._levels = np.zeros((0, len(self._outputs)), dtype=np.int64)
        self._operation = np.zeros(0, dtype=np.int64)
        self._waits: list[Event] = []
        self._creeps: list[Creep] = []
        self._reach, self._duration, self._off_at = 0, _ENDLESS, _ENDLESS
        self.tick = self.taken = 0
        self.failure, self.ran_dry = "", False
        self._pending_events: list[Event] = []
        self._under_way = 0  # the job operation of the last sample
        self._stands = False  # the schedule holds at the end of what was received
        self._orders = self._made()
        self._progress = begin(self._orders)
        self._progress.free[-1] = 0  # the contact of the gate (see _made) stays open

    @property
    def place(self) -> int:
        """Scans of the schedule played so far; scans spent in waits and holds do not count."""
        return int(self._progress.plc[TICK])

    @property
    def sample(self) -> int:
        """Number of samples taken so far."""
        return int(self._progress.plc[SAMPLE])

    @property
    def switched_off_at(self) -> int | None:
        """Scan at which all outputs were switched off; None while the schedule runs."""
        plc = self._progress.plc
        if plc[PHASE] == RUNNING:
            return None
        return int(plc[SCAN] - (self._orders.after - plc[LEFT]))

    def take(
        self,
        ticks: IntArray,
        levels: IntArray,
        operation: IntArray,
        waits: Sequence[Event],
        *,
        reach: int,
        duration: int | None,
        creeps: Sequence[Creep] = (),
    ) -> None:
        """Receive the next piece of the schedule.

        Parameters
        ----------
        ticks, levels, operation
            (n,), (n, outputs) and (n,): the rows, as in ``SwitchSchedule``.
        waits
            Waits of this piece, in order, the last at or before ``reach``.
        reach
            Scan of the schedule at which it holds until the next piece arrives.
        duration
            Length of the whole schedule in scans; None if more pieces follow.
        creeps
            Creeps of cylinders during the waits of this piece.

        Raises
        ------
        OptionError
            If the rows do not follow the previous ones, or are not for this machine.
        """
        last = int(self._ticks[-1]) if len(self._ticks) else -1
        gaps = np.diff(ticks, prepend=last)
        if levels.shape != (len(ticks), len(self._outputs)) or (gaps <= 0).any():
            raise OptionError(f"rows of shape {levels.shape} do not follow scan {last}")
        plc = self._progress.plc
        played = max(int(plc[ROW]), 0)  # rows before the current row
        self._ticks = np.concatenate((self._ticks[played:], ticks))
        self._levels = np.concatenate((self._levels[played:], levels))
        self._operation = np.concatenate((self._operation[played:], operation))
        self._waits = [*self._waits[int(plc[WAIT]) :], *waits]
        self._creeps = [*(c for c in self._creeps if c.tick >= plc[TICK]), *creeps]
        plc[WAIT] = 0
        if played:
            plc[ROW] -= played
            plc[LATER] -= played
        self._reach, self.taken = reach, self.taken + len(ticks)
        self._duration = _ENDLESS if duration is None else duration
        self._orders = self._made()
        self._progress = _carried(self._progress, self._orders)

    def switch_off_at(self, tick: int) -> None:
        """Switch all outputs off at scan ``tick``; each call replaces the scan of the last call."""
        self._off_at = tick

    def finish(self, ended: RunEnd, text: str) -> None:
        """Add an event that says how the run ended to the next block."""
        self._pending_events.append(
            Event(tick=self.sample, kind=ended.value, operation=self._under_way, name=text)
        )

    def advance(self, scans: int) -> RecordingBlock:
        """Simulate ``scans`` scans; return their samples and events.

        The last sample is taken one second after all outputs were switched off.
        """
        until, first = self.tick + scans, self.sample
        parts = []
        while self.tick < until and self._progress.plc[PHASE] <= CALMING:
            plc = self._progress.plc
            if plc[PHASE] == RUNNING and self.tick >= self._off_at:
                plc[PHASE], self.ran_dry = CALMING, True
            bound = min(until, self._off_at) if plc[PHASE] == RUNNING else until
            if plc[WAIT] == len(self._waits):
                plc[STALL] = 0  # holding at the gate has no time limit
            parts.append(self._run(bound))
            self._record_holds(int(plc[SCAN]) - self.tick)
            self.tick = int(plc[SCAN])
            if plc[PHASE] == STALLED:
                self.failure = stall_of(self._waits[int(plc[WAIT])], self._known())
                plc[PHASE] = CALMING
        self.tick = until
        events, self._pending_events = tuple(self._pending_events), []
        events += tuple(event for part in parts for event in part.events)
        if not parts:
            samples = {channel.name: np.empty(0) for channel in self.channels}
        else:
            samples = {
                name: np.concatenate([part.samples[name] for part in parts])
                for name in parts[0].samples
            }
        if len(samples["operation"]):
            self._under_way = int(samples["operation"][-1])
        return RecordingBlock(
            first_tick={self.channels[0].clock.name: first}, samples=samples, events=events
        )

    def _record_holds(self, scans: int) -> None:
        """Record the events ``hold`` and ``resume`` of the last ``scans`` scans."""
        plc = self._progress.plc
        at_gate = plc[PHASE] == RUNNING and plc[WAIT] == len(self._waits)
        held_scans = int(plc[STALL]) if at_gate else 0
        if self._stands and held_scans < scans and plc[PHASE] == RUNNING:
            self._record_event("resume", self.tick)
            self._stands = False
        if held_scans and not self._stands:
            self._record_event("hold", int(plc[SCAN]) - held_scans)
            self._stands = True

    def _record_event(self, kind: EventKind, scan: int) -> None:
        at = -(-scan * self._orders.scan // self._orders.sample)
        self._pending_events.append(Event(tick=at, kind=kind, operation=self._under_way))

    def _run(self, until: int) -> RecordingBlock:
        orders, progress = self._orders, self._progress
        room = orders.room * (until - int(progress.plc[SCAN]) + 1)
        columns = 4 * len(orders.share) + len(orders.contact_cylinder)
        out, rows = np.empty((room, columns)), np.empty((room, 2), dtype=np.int64)
        over = np.empty((len(self._waits) + 1, 2), dtype=np.int64)
        first = self.sample
        record = Record(out, rows, over)
        count, wait_count = run(orders, progress, self._bank, self._motion, record, until)
        return run_block(
            self.channels,
            (out[:count, :-1], rows[:count], over[:wait_count]),
            (self._outputs, self._states, self._operation, self._waits),
            first,
        )

    def _made(self) -> Orders:
        """Return the orders of the schedule received so far, with a gate at its end.

        The gate is a wait for a contact that never closes: it holds the schedule.
        """
        known = self._known()
        self._states = states_of(known.levels, openings(self._waits, known))
        orders = orders_of(known, self._machine, self._options, self._values, self._units)
        flows = orders.creep_flowing.shape[1:]
        return orders._replace(
            wait_tick=np.append(orders.wait_tick, self._reach),
            wait_contact=np.append(orders.wait_contact, len(self._machine.contacts)),
            wait_value=np.append(orders.wait_value, 1),
            wait_given=np.append(orders.wait_given, 1),
            wait_creep=np.vstack((orders.wait_creep, [[0, 0, 0, 0, _ENDLESS]])),
            creep_level=np.vstack((orders.creep_level, np.zeros((1, flows[0])))),
            creep_flowing=np.concatenate((orders.creep_flowing, np.zeros((1, *flows)))),
            contact_cylinder=np.append(orders.contact_cylinder, -1),
            contact_at=np.append(orders.contact_at, 0.0),
            contact_above=np.append(orders.contact_above, 1),
        )

    def _known(self) -> SwitchSchedule:
        """Return the schedule received so far; ``take`` drops the rows played before it."""
        return SwitchSchedule(
            clock=self._machine.command_clock,
            outputs=self._outputs,
            ticks=self._ticks,
            levels=self._levels,
            operation=self._operation,
            duration_ticks=self._duration,
            job_sha256="",
            machine_sha256=self._machine.sha256,
            events=tuple(self._waits),
            creeps=tuple(self._creeps),
        )


def _carried(before: Progress, orders: Orders) -> Progress:
    """Return the progress with queues for the new orders; levels on their way to cylinders stay."""
    fresh = begin(orders)
    pending = before.queue[:, 0] - before.queue[:, 1]
    room = fresh.arrival.shape[1] + int(pending.max(initial=0))
    arrival = np.zeros((len(pending), room), dtype=np.int64)
    coming = np.zeros((len(pending), room))
    queue = np.zeros_like(before.queue)
    for c, count in enumerate(pending):
        sent, came = before.queue[c]
        arrival[c, :count] = before.arrival[c, came:sent]
        coming[c, :count] = before.coming[c, came:sent]
        queue[c, 0] = count
    return before._replace(arrival=arrival, coming=coming, queue=queue)
