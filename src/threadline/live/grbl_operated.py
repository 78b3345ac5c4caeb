"""A grbl controller at an operator's panel: homed, moved by hand, run repeatedly."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.plan import Plan
from threadline.errors import CommandError, LinkFaultError
from threadline.files import Channel, RunEnd
from threadline.live.executor import LEASE_S
from threadline.live.grbl_console import GrblBoard, Traffic, console_line
from threadline.live.grbl_controller import Controller, GrblJog, axis_manual_feed
from threadline.live.grbl_program import notes_on, rest_of_program, written_program
from threadline.live.grbl_run import POLL_S, GrblRun
from threadline.live.grbl_words import Status, in_words
from threadline.live.guards import clock_s
from threadline.live.kinds_run import run_kind_of
from threadline.live.operated import PlanToSend
from threadline.live.states import MOVING, Cause, Desk, Hold, Sink, State, next_state

_AT_REST = frozenset({State.DISABLED, State.ENABLED, State.FAULT})
"""Not homed, or after a fault: no state that the controller reports then is a new fault."""


class GrblOperated(GrblRun):
    """A grbl controller, for one run or jog after the other; see ``Operated``.

    Parameters
    ----------
    controller
        The controller, not connected yet.
    desk, sink
        Queue of the operator's commands; receiver of samples, events and changes of state.
    """

    holds_at_once = True

    def __init__(
        self, controller: Controller, desk: Desk, sink: Sink, *, pass_stops: bool = False
    ) -> None:
        super().__init__(controller, desk, sink, pass_stops=pass_stops)
        self.latest: Mapping[str, float] = {}
        self.meanwhile: Callable[[], None] = lambda: None
        self._set_out = False
        self._jog: GrblJog | None = None
        self._lease_until_s = 0.0
        traffic = Traffic(lambda: self.under_way and self._jog is None, lambda: self.under_way)
        self.board = GrblBoard(controller, traffic)
        self._port.log = traffic

    @property
    def channels(self) -> tuple[Channel, ...]:
        """A commanded position for each axis: nothing else is reported."""
        return self._trace.channels

    @property
    def position_counts(self) -> IntArray:
        """Position commanded by the controller, (axes,) in counts."""
        return np.rint(self._at * self._machine.counts_per_unit).astype(np.int64)

    @property
    def age_s(self) -> float:
        """Age of the latest report beyond the report interval, s."""
        return max(clock_s() - self._heard_s - POLL_S, 0.0)

    @property
    def share_done(self) -> float | None:
        """Share of the program's nominal time, at its feeds, that the reports have passed."""
        whole_s = float(self._program.durations_s.sum())
        return self.plan_s / whole_s if whole_s else 0.0

    @property
    def under_way(self) -> bool:
        """Whether a run or a jog has begun and is not over."""
        return self._set_out and not self.over

    # --- at rest ---------------------------------------------------------------------------

    def connect(self) -> None:
        """Connect to the controller; see ``Controller.greet``.

        Settings for another machine are a fault. A reset clears it once the settings match.
        """
        self.controller.greet()
        self.board.readings += 1
        self._note(self.controller.ask_status())
        self._trace.begin(self._at)
        try:
            self.controller.compare()
        except CommandError as error:
            self._fault_at_rest(f"{error.message}. {error.remedy}")

    def close(self) -> None:
        """Disconnect; a running controller is told to hold first."""
        if self.under_way:
            self._brake()
        self._port.close()

    def disable(self) -> None:
        """Do nothing but change the state; grbl switches its drives by itself."""
        self._go(Cause.DISABLE)

    def home(self) -> None:
        """Home the machine, and listen for a stop meanwhile; see ``Controller.home``."""
        try:
            super().home()
        except LinkFaultError as error:
            self.ended, self.over = (RunEnd.FAULT, error.message), True
            raise
        self._keep_latest()

    def _stopped(self) -> bool:
        self.meanwhile()
        return super()._stopped()

    def reset(self) -> None:
        """Leave a fault, and reset the controller at rest; see ``Controller.unlock``.

        Raises
        ------
        CommandError
            If there is no fault, the machine still brakes, the link is gone, or the settings are
            for another machine: they are read again.
        """
        next_state(self.state, Cause.RESET)
        if self._port.lost:
            raise CommandError("the link is gone", remedy="Reconnect.")
        if self.under_way:
            raise CommandError("the machine is still braking", remedy="Wait until it stands.")
        self.controller.unlock()
        self._overrides.reset()
        self._read_settings()
        self.controller.compare()
        self._go(Cause.RESET)

    def type_line(self, line: str) -> None:
        """Send a line that the operator typed, and wait for its answer.

        After a setting was written, the state is a fault: a reset compares the settings again, and
        the machine must be homed.

        Raises
        ------
        CommandError
            If something moves, the link is gone, or a console must not send the line.
        """
        self._refuse_moving()
        if self._port.lost:
            raise CommandError("the link is gone", remedy="Reconnect.")
        typed = console_line(line)
        try:
            answer = self.board.send(typed, self._stopped)
            self._heard_s = clock_s()
            if typed.setting is None or answer != "ok":
                return
            self._read_settings()
        except LinkFaultError as error:
            self._fault_at_rest(error.message)
            return
        self.homed = False
        self._fault_at_rest(
            f"the setting ${typed.setting} was written: Reset compares it with the machine file, "
            "then home the machine"
        )

    def _refuse_moving(self) -> None:
        """Refuse a typed line in a motion, and in the hold of a run."""
        if self.under_way or self.state in MOVING:
            raise CommandError(
                "the console sends nothing while the machine moves or a run is held: its line "
                "would wait behind the lines of the run",
                remedy="Wait until it stands, or stop it.",
            )

    def _read_settings(self) -> None:
        self.controller.read_settings()
        self.board.readings += 1

    def stand(self, patience_s: float) -> None:
        """Listen to a controller at rest for at most ``patience_s``, and execute commands."""
        if self._port.lost and self.state is State.FAULT:
            time.sleep(patience_s)
            self._obey()
            return
        self._set_out = self.over = False  # the last motion is over: reports count again
        self._wait(patience_s)
        self._judge_silence()
        self._obey()
        self._listen()

    def _report_at_rest(self, found: Status) -> None:
        self._note(found)
        if found.state not in {"Idle", "Sleep"} and self.state not in _AT_REST:
            self._fault_at_rest(found.words)

    def _fault_at_rest(self, text: str) -> None:
        if self.state is State.FAULT:
            return
        self.ended = (RunEnd.FAULT, text)
        self._go(Cause.FAULT, text)

    def _note(self, found: Status) -> None:
        self._at = self.controller.position(found)
        self._heard_s = clock_s()
        self.board.report(found)
        self._overrides.take(found, to_note=False)
        self._keep_latest()

    def _keep_latest(self) -> None:
        places = zip(self._machine.axis_names, self._at.tolist(), strict=True)
        self.latest = {f"{name}.commanded": place for name, place in places}

    # --- runs ------------------------------------------------------------------------------

    def prepare(self, plan: Plan) -> PlanToSend:
        """Write the program of a plan."""
        program, sent = written_program(plan)
        return PlanToSend(plan, sent, notes_on(program, self.controller), program)

    def rest(self, to_send: PlanToSend, operation: int, *, at_rest: bool) -> PlanToSend:  # noqa: ARG002  # it makes its own ramps
        """Return the rest of a plan from an operation on, as lines."""
        assert to_send.program is not None
        rest, program = rest_of_program(to_send.program, to_send.plan, operation)
        notes = notes_on(program, self.controller)
        sent = dict.fromkeys(to_send.sent, b"".join(program.lines))
        return replace(to_send, sent=sent, notes=notes, program=program, rest=rest)

    def refuse(self, to_send: PlanToSend) -> None:
        """Refuse a program that begins elsewhere, or leaves the travel."""
        assert to_send.program is not None
        self.refuse_program(to_send.program, self._starts(to_send))

    def run(self, to_send: PlanToSend, *, hold: Hold, no_override: str = "") -> None:  # noqa: ARG002  # it holds on its path
        """Begin a run."""
        assert to_send.program is not None
        self.start(to_send.program, self._starts(to_send), no_override=no_override)
        self._set_out = True

    def starts(self, to_send: PlanToSend) -> IntArray:
        """Return where a plan begins, (axes,) in counts."""
        return (
            run_kind_of(self._machine).start(to_send.plan.commands)
            if to_send.rest is None
            else to_send.rest.begins
        )

    def _starts(self, to_send: PlanToSend) -> FloatArray:
        return np.asarray(self.starts(to_send) / self._machine.counts_per_unit)

    # --- by hand ---------------------------------------------------------------------------

    def jog(self, axis: str, velocity: float) -> None:
        """Move an axis until ``let_go``, or until the jog was not renewed for ``LEASE_S``.

        Raises
        ------
        CommandError
            If the machine is not idle, has no such axis, or the speed is above the manual feed.
        """
        next_state(self.state, Cause.JOG)
        self._begin_by_hand(axis, velocity, None, LEASE_S)

    def move(self, axis: str, to_counts: int, lease_s: float = LEASE_S) -> None:
        """Move an axis to a position at its manual feed, with the lease of a jog.

        Raises
        ------
        CommandError
            If the machine is not idle, has no such axis, or the position is beyond its travel.
        """
        next_state(self.state, Cause.JOG)
        manual_feed = axis_manual_feed(self.controller, axis)
        k = self._machine.axis_names.index(axis)
        end = to_counts / float(self._machine.counts_per_unit[k])
        velocity = manual_feed if end >= self._at[k] else -manual_feed
        self._begin_by_hand(axis, velocity, end, min(lease_s, LEASE_S))

    def _begin_by_hand(self, axis: str, velocity: float, end: float | None, lease_s: float) -> None:
        k = self._machine.axis_names.index(axis) if axis in self._machine.axes else 0
        jog = GrblJog(self.controller, float(self._at[k]), axis, velocity, end)
        self._forget()
        self._jog, self._set_out = jog, True
        self._begun_s = self._heard_s = clock_s()
        self._lease_until_s = self._begun_s + lease_s
        self._go(Cause.JOG)
        jog.feed(float(self._at[k]))

    def renew(self) -> None:
        """Renew a jog for another ``LEASE_S`` from now.

        Raises
        ------
        CommandError
            If there is no jog, or it has ended already.
        """
        if self.state is not State.JOGGING:
            raise CommandError(
                f"there is no jog: the machine is {self.state.value}", remedy="Begin one anew."
            )
        self._lease_until_s = clock_s() + LEASE_S

    def let_go(self) -> None:
        """End a jog: brake at once."""
        if self._jog is not None and not self._jog.cancelled:
            self._jog.cancel()

    def step(self) -> None:
        """Continue a run or a jog; call it until ``over`` is True."""
        jog = self._jog
        if jog is None:
            super().step()
            self._keep_latest()
            return
        self._wait(max(self._lease_until_s - clock_s(), 0.0))
        self._judge_silence()
        self._obey()
        if clock_s() >= self._lease_until_s and not jog.cancelled:
            jog.why = f"nobody has renewed its lease for {LEASE_S:g} s"
            jog.cancel()
        self._listen()

    def _ask(self, now_s: float) -> None:
        super()._ask(now_s)
        if self._jog is not None:
            self._jog.note_request()

    def _brake(self) -> None:
        if self._jog is None:
            super()._brake()
        else:
            self._jog.cancel()

    def _hear(self, line: str) -> None:
        jog = self._jog
        if jog is None and self.under_way:
            super()._hear(line)
        elif jog is not None and (line == "ok" or line.startswith("error")):
            jog.answered("" if line == "ok" else in_words(line))
            jog.feed(float(self._at[jog.column]))
        elif line.startswith("<"):
            super()._hear(line)
        elif line.startswith("ALARM") and self.state is not State.FAULT:
            self._fault(f"the controller is in alarm: {in_words(line)}")
        elif line.lower().startswith("grbl") and self.state not in _AT_REST:
            self._fault("the controller was reset")

    def _fault(self, text: str) -> None:
        if self.under_way:
            super()._fault(text)
        else:
            self._fault_at_rest(text)

    def _report(self, found: Status) -> None:
        jog = self._jog
        if not self.under_way:
            self._report_at_rest(found)
            return
        self.board.report(found)
        if jog is None:
            super()._report(found)
            return
        self._note(found)
        if self.state is not State.FAULT:
            if name := self.controller.beyond(self._at):
                self._fault(f"axis {name} is beyond its travel")
            elif found.state not in {"Idle", "Jog"}:
                self._fault(found.words)
        if jog.rests(found) or (found.stands and found.state != "Idle"):
            self._end_by_hand(jog)
        else:
            jog.feed(float(self._at[jog.column]))

    def _end_by_hand(self, jog: GrblJog) -> None:
        self._jog, self.over = None, True
        if self.state is State.JOGGING:
            self.ended = (RunEnd.COMPLETED, jog.why)
            self._go(Cause.AT_REST, jog.why)
        elif self.state is State.STOPPING:
            self._go(Cause.AT_REST)

    def _lost(self, text: str) -> None:
        if self.under_way:
            super()._lost(text)
        else:
            self._fault_at_rest(text)
        self._jog = None
