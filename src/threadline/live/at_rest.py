"""An executor while nothing moves: connection, drives, homing, listening."""

from __future__ import annotations

import select
from collections.abc import Mapping

import numpy as np

from threadline.base.arrays import IntArray
from threadline.errors import CommandError, LinkFaultError
from threadline.files import RunEnd
from threadline.live.far_end import FarEnd
from threadline.live.states import Cause, Desk, Sink, State, homed_after, next_state
from threadline.live.wire import Connection, Message
from threadline.machine import Machine

OPERATOR = "the operator"


class AtRest:
    """The part of an executor that works between motions.

    Parameters
    ----------
    link
        The link to the machine, which has not sent its greeting yet.
    machine
        The machine that must be at the end of the link.
    desk
        Queue of the operator's commands.
    sink
        Receiver of samples, events and changes of state.

    Attributes
    ----------
    latest
        Last sample of each channel that the machine has reported.
    homed
        Whether the positions of the axes are known, or were known when a fault came.
    why
        Reason for the latest change of state; empty without one.
    stops
        Number of stop commands received, in any state.
    stopped_by
        Who stopped the motion, if it was stopped.
    """

    def __init__(self, link: Connection, machine: Machine, desk: Desk, sink: Sink) -> None:
        self._link, self._machine, self._desk, self._sink = link, machine, desk, sink
        self.far_end = FarEnd(link, machine)
        self.state = State.DISABLED
        self._period_s = float(machine.command_clock.period_s)
        self.tick = 0  # of the machine, as last reported
        self.late_ticks = 0
        self.ended: tuple[RunEnd, str] | None = None
        self.over = False  # the run has ended and the machine has settled
        self.latest: Mapping[str, float] = {}
        self.homed, self.why = False, ""
        self._homed = False
        self._stands = np.zeros(len(machine.axes), dtype=np.int64)
        self._began = self._stands  # where the run began
        self.stops = 0
        self.stopped_by = OPERATOR
        self._number = 0  # of runs and jogs since the machine greeted

    @property
    def machine(self) -> Machine:
        """The machine that must be at the end of the link."""
        return self._machine

    @property
    def position_counts(self) -> IntArray:
        """Commanded position, (axes,) in the units of the commands; known once it is homed."""
        return self._stands

    @property
    def lost(self) -> bool:
        """Whether the link is gone, so that only connecting again reaches the machine."""
        return self._link.lost

    @property
    def time_s(self) -> float:
        """Time of the machine since the beginning of the run, in s."""
        return self.tick * self._period_s

    def connect(self) -> None:
        """Receive the greeting of the machine.

        Raises
        ------
        LinkFaultError
            If the machine does not answer.
        CommandError
            If it is another machine, or speaks another version of the protocol.
        """
        simulated = self.far_end.greet()
        self._sink.begin(self.far_end.channels, simulated)

    def enable(self) -> None:
        """Switch the drives on."""
        next_state(self.state, Cause.ENABLE)
        self.far_end.enable()
        self._go(Cause.ENABLE)

    def disable(self) -> None:
        """Switch the drives off, at rest only; the machine must be homed before the next run."""
        self._go(Cause.DISABLE)
        self._homed = False
        self.far_end.disable()

    def reset(self) -> None:
        """Leave a fault, with the drives off; the machine must be homed then.

        Raises
        ------
        CommandError
            If there is no fault, the machine still brakes, or the link is gone.
        """
        if self._link.lost:
            raise CommandError("the link is gone", remedy="Reconnect.")
        if self.state is State.FAULT and not self.over and self._number:
            raise CommandError("the machine is still braking", remedy="Wait until it stands.")
        self._go(Cause.RESET)
        self._homed = False
        self.far_end.disable()

    def close(self) -> None:
        """End the connection; a machine that moves plays its braking tail."""
        self.far_end.leave()

    def home(self) -> None:
        """Home the machine; a stop ends homing and leaves it enabled, not homed.

        Positions that were reported before are forgotten, because the machine stands elsewhere now;
        the values in its answer are kept.

        Raises
        ------
        LinkFaultError
            If homing fails; the state is then a fault.
        """
        self._go(Cause.HOME)
        try:
            homed_position = self.far_end.home(self._desk.fileno(), self._stopped)
        except LinkFaultError as error:
            self._fault(error.message)
            self.over = True
            raise
        self._homed = homed_position is not None
        if homed_position is None:
            self._go(Cause.AT_REST_UNHOMED)
            return
        self._stands, reported = homed_position
        position_channels = {channel.name for channel in self.far_end.channels if channel.axis}
        other_samples = {
            name: at for name, at in self.latest.items() if name not in position_channels
        }
        self.latest = {**other_samples, **reported}
        self._go(Cause.HOMED)

    def _stopped(self) -> bool:
        """Process commands while the machine homes; return whether one was a stop."""
        self._desk.woken()
        self.obey()
        return self.state is State.STOPPING

    def stand(self, patience_s: float) -> None:
        """Listen to a machine at rest for at most ``patience_s``, and execute commands."""
        is_lost = self._link.lost
        waited_on = [self._desk.fileno(), *([] if is_lost else [self._link.fileno()])]
        if not self._link.waiting:
            ready, _, _ = select.select(waited_on, [], [], patience_s)
            if self._desk.fileno() in ready:
                self._desk.woken()
        self.obey()
        if is_lost:
            return
        try:
            message = self._link.receive(0.0)
        except LinkFaultError as error:
            self._lost(error.message)
            return
        if message is not None and message.kind == "report":
            self._keep_latest(message)
            faults = [one[3] for one in message.head["events"] if one[1] == "fault"]
            if faults and self.state is not State.FAULT:
                self._fault(faults[0])
                self.over = True
        elif message is None and self._link.lost:
            self._lost("the link is gone")

    def _keep_latest(self, report: Message) -> dict[str, float]:
        """Keep the last sample of each channel in a report, and return these."""
        last_samples = {name: float(a[-1]) for name, a in report.arrays.items() if len(a)}
        self.latest = {**self.latest, **last_samples}
        return last_samples

    def obey(self) -> None:
        """Execute the commands of the desk; an impossible one is recorded and dropped."""
        while (cause := self._desk.take()) is not None:
            try:
                self._command(cause)
            except CommandError as error:
                self._sink.state(self.tick, self.state, cause, error.message)

    def _command(self, cause: Cause) -> None:
        """Execute a command; at rest it only changes the state."""
        self._go(cause)

    def _go(self, cause: Cause, text: str = "") -> None:
        self.state = next_state(self.state, cause)
        self.homed = homed_after(cause, self.homed)
        self.why = text
        self.stops += cause is Cause.STOP
        self._sink.state(self.tick, self.state, cause, text)

    def _fault(self, text: str) -> None:
        """Go to the state of a fault."""
        self.ended = (RunEnd.FAULT, text)
        self._homed = False
        self._go(Cause.FAULT, text)

    def _lost(self, text: str) -> None:
        """Record that the link is lost; the machine plays its braking tail."""
        self.ended, self.over, self._homed = (RunEnd.FAULT, text), True, False
        self._go(Cause.FAULT, text)
        self._sink.block(self.far_end.lost(self.tick, text))
