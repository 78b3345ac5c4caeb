"""A run on a grbl controller: lines are sent as its buffer has room, and its reports recorded.

The controller plans its own ramps, and executes buffered lines by itself when the link is lost.
Only its position reports tell what moves: an answer means that a line was received, not executed.
"""

from __future__ import annotations

import select

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import CommandError, LinkFaultError
from threadline.files import RunEnd
from threadline.live.at_rest import OPERATOR
from threadline.live.feed_override import refuse_override
from threadline.live.grbl_controller import Controller
from threadline.live.grbl_program import ReportTrace
from threadline.live.grbl_progress import OFF_PATH_M, Way, refuse_program, way_passed
from threadline.live.grbl_words import (
    HOLD,
    PAUSES,
    RESET,
    RESUME,
    STATUS,
    CharacterCount,
    Overrides,
    Program,
    Status,
    in_words,
    program_of,
    status_of,
)
from threadline.live.guards import clock_s
from threadline.live.states import MOVING, Cause, Desk, Sink, State, homed_after, next_state

POLL_S = 0.1  # interval of position requests
SILENCE_S = 1.0
"""Time in s without a report after which the link counts as lost."""
FRESH_S = 5.0  # largest age of the latest report at a start
_SETTLE_S = 0.5
OBEYS_S = 1.0  # time within which a controller reports that it obeys a hold or a resume
_STANDS_S = 1.0  # a run fails if the controller stands short of its end for longer
ANSWERS_S = 30.0  # wait for answers beyond the time of the lines: a spindle may have to start
_LISTENS_S = 0.05  # longest listening at a time: the operator may have sent a command meanwhile
_HOLDS_S = 2.0  # a hold fails if it takes longer than twice the braking time plus this


class GrblRun:
    """One run of a program on a grbl controller.

    Parameters
    ----------
    controller
        The controller, connected by ``Controller.meet``.
    desk, sink
        Queue of the operator's commands; receiver of samples, events and changes of state.
    pass_stops
        Whether the controller is told to pass each M0 of the program at once.

    Attributes
    ----------
    state
        State of the run, as in an executor.
    executed
        Number of lines whose ends the position reports have passed.
    ended
        How the run ended, and why; None before.
    why
        Reason for the latest change of state; empty without one.
    homed
        Whether the positions of the axes are known, or were known when a fault came.
    stops
        Number of stop commands received, in any state.
    """

    late_ticks = 0

    def __init__(
        self, controller: Controller, desk: Desk, sink: Sink, *, pass_stops: bool = False
    ) -> None:
        self.controller, self._desk, self._sink = controller, desk, sink
        self._pass_stops = pass_stops
        self._port, self._machine = controller.port, controller.machine
        machine = self._machine
        self.state, self.stops, self.stopped_by = State.DISABLED, 0, OPERATOR
        self.homed = False
        self.why = ""
        self._at: FloatArray = np.zeros(len(machine.axes))
        self._asked_s = self._heard_s = 0.0
        self._overrides = Overrides()
        self._none = program_of(b"", machine.axis_names, np.ones(len(machine.axes)), self._at)
        self._trace = ReportTrace(machine, sink)
        self._forget()

    def _forget(self) -> None:
        """Reset all data of the last run."""
        self.ended: tuple[RunEnd, str] | None = None
        self.over = False
        self.executed = self.acknowledged = 0
        self._count = CharacterCount(self.controller.room)
        self._program = self._none
        self._way = Way(self._none, self._machine, self._at)
        self._begun_s = 0.0
        self._settled_s: float | None = None
        self._braking = False
        self._brakes_until_s = self._stood_s = np.inf
        self._command_s = -np.inf  # time of the last hold or resume command
        self._looked_s = clock_s()
        self.no_override = ""
        self._overrides.forget_request()
        self._last_state_words = ""  # reported by the controller while it holds
        self._unready = ""  # why it cannot resume
        self._passed = -1  # line of the M0 that was passed last

    @property
    def lost(self) -> bool:
        """Whether the link is gone, so that only connecting again reaches the machine."""
        return self._port.lost

    @property
    def time_s(self) -> float:
        """Time since the beginning of the run, s."""
        return clock_s() - self._begun_s if self._begun_s else 0.0

    @property
    def _all_answered(self) -> bool:
        return self.acknowledged == len(self._program.lines)

    def enable(self) -> None:
        """Do nothing but change the state: grbl switches its drives by itself."""
        self._go(Cause.ENABLE)

    def home(self) -> None:
        """Home the machine, and listen for a stop meanwhile; see ``Controller.home``."""
        self._go(Cause.HOME)
        try:
            self._at = self.controller.home(self._stopped)
        except LinkFaultError as error:
            self._go(Cause.FAULT, error.message)
            raise
        self._heard_s = clock_s()
        self._trace.begin(self._at)
        switches = self.controller.has_switches
        self._go(Cause.HOMED, "" if switches else "no homing switches: reported positions are used")

    def _stopped(self) -> bool:
        """Process commands while it homes; return whether one was a stop."""
        while (cause := self._desk.take()) is not None:
            if cause is Cause.STOP:
                self._go(cause)
                return True
        return False

    def start(self, program: Program, starts: FloatArray, *, no_override: str = "") -> None:
        """Begin a run.

        Parameters
        ----------
        program
            The program to send.
        starts
            (axes,) starting position, m or rad.
        no_override
            Why the feed of this run cannot be overridden; empty if it can.

        Raises
        ------
        CommandError
            If the machine is not idle, stands elsewhere or has not reported recently, or if a line
            is too long for the controller or ends beyond the travel.
        """
        next_state(self.state, Cause.START)
        self.refuse_program(program, starts)
        if (silent_s := clock_s() - self._heard_s) > FRESH_S:
            raise CommandError(
                f"the controller was last heard {silent_s:.0f} s ago: this computer slept, or this "
                "program was stopped",
                remedy="Check the machine, and start again.",
            )
        self._forget()
        self._trace.again(self._at)
        self._program, self.no_override = program, no_override
        self._go(Cause.START)
        self._way = Way(program, self._machine, starts)
        self._begun_s = self._heard_s = clock_s()
        if not self._overrides.as_is:
            self._note_overrides()
        self._feed()

    def refuse_program(self, program: Program, starts: FloatArray) -> None:
        """Refuse a program that begins elsewhere, or leaves the travel; see ``start``."""
        refuse_program(program, self.controller, self._at, starts)

    def step(self) -> None:
        """Wait for a line or a command and act on it; call it until ``over`` is True."""
        self._wait(POLL_S)
        self._judge_silence()
        self._obey()
        self._listen()

    def _judge_silence(self) -> None:
        """End a run or a jog during which this program was suspended; call it first.

        The computer slept, or the process was stopped. The controller went on with its buffered
        lines, and its position is unknown. Answers that wait to be read would release more lines;
        so it is told to hold, and is reset once it stands.
        """
        now_s = clock_s()
        suspended_s, self._looked_s = now_s - self._looked_s, now_s
        if suspended_s <= SILENCE_S or self.over:
            return
        self._port.forget_reports()
        self._heard_s = now_s
        if self._settled_s is None and self.state in MOVING:
            self._fault(
                f"this program did not run for {suspended_s:.1f} s: the computer slept, or it was "
                "stopped; the controller was told to hold"
            )

    def _wait(self, longest_s: float) -> None:
        """Request the position if that is due, and wait until there is something to do."""
        now_s = clock_s()
        if now_s - self._asked_s >= POLL_S:
            self._ask(now_s)
        if not self._port.waiting and not self._port.lost:
            wait_s = max(self._asked_s + POLL_S - clock_s(), 0.0)
            descriptors = [self._desk.fileno(), self._port.fileno()]
            ready, _, _ = select.select(descriptors, [], [], min(wait_s, longest_s))
            if self._desk.fileno() in ready:
                self._desk.woken()

    def _ask(self, now_s: float) -> None:
        self._asked_s = now_s
        self._port.send(STATUS)

    def _obey(self) -> None:
        """Execute the operator's commands."""
        while (cause := self._desk.take()) is not None:
            self.stops += cause is Cause.STOP
            try:
                self._command(cause)
            except CommandError as error:
                self._sink.state(self._trace.tick, self.state, cause, error.message)
        if (percent := self._desk.take_override()) is not None:
            try:
                self.override(percent)
            except CommandError as error:
                self._sink.state(self._trace.tick, self.state, Cause.OVERRIDE, error.message)

    @property
    def percent(self) -> int:
        """Override of the feed that the controller has reported, %."""
        return self._overrides.percent

    @property
    def plan_s(self) -> float:
        """Nominal time, at its feeds, of the program up to the latest report, s."""
        return self._way.time_s(self.executed, self._at)

    def override(self, percent: int) -> None:
        """Override the feed at the controller, step by step; see ``Executor.override``."""
        refuse_override(percent, self.state, self.no_override)
        self._overrides.want(percent, clock_s())
        self._override_on()

    def _override_on(self) -> None:
        """Send the next step to the requested override, or report that it was not reached."""
        sent, failed = self._overrides.step(clock_s())
        if sent:
            self._port.send(sent)
        if failed:
            self._sink.state(self._trace.tick, self.state, Cause.OVERRIDE, failed)

    def _listen(self) -> None:
        """Act on the controller's messages, or on its silence."""
        until_s = clock_s() + _LISTENS_S
        try:
            while not self.over and (line := self._port.receive(0.0)) is not None:
                self._hear(line)
                if clock_s() >= until_s:
                    break
        except LinkFaultError as error:
            self._fault(error.message)
        if self._port.lost and not self.over:
            self._lost("the link is gone")
        elif clock_s() - self._heard_s > SILENCE_S and not self.over:
            self._lost(f"the controller was silent for {SILENCE_S:g} s")

    def _command(self, cause: Cause) -> None:
        cause.refuse_after(self.ended)
        moving = self.state in MOVING
        if cause is Cause.RESUME and self._unready:
            raise CommandError(self._unready, remedy="Close the door, then go on.")
        self._go(cause)
        if cause is Cause.STOP and moving:
            self.ended = (RunEnd.STOPPED, f"stopped by {self.stopped_by}")
            self._brake()
        elif cause in (Cause.HOLD, Cause.RESUME):
            self._port.send(HOLD if cause is Cause.HOLD else RESUME)
            self._command_s, self._last_state_words = clock_s(), ""

    def _brake(self) -> None:
        """Hold the feed. Once the machine stands, or fails to, a reset drops all other lines."""
        self._braking = True
        timeout_s = 2.0 * self.controller.brakes_s + _HOLDS_S
        self._brakes_until_s = min(self._brakes_until_s, clock_s() + timeout_s)
        self._port.send(HOLD)

    def _feed(self) -> None:
        """Send as many lines as the controller has room for."""
        sent_count = self.acknowledged + self._count.open
        while self.state is State.RUNNING and sent_count < len(self._program.lines):
            if clock_s() - self._looked_s > SILENCE_S:
                return  # this program was suspended, which ends the run first
            line = self._program.lines[sent_count]
            if not self._count.fits(line):
                return
            self._port.send(line)
            self._count.sent(line)
            sent_count += 1

    def _hear(self, line: str) -> None:
        status = status_of(line)
        if status is not None:
            self._report(status)
        elif line == "ok":
            self._count.answered()
            self.acknowledged += 1
            self._feed()
        elif line.startswith("error"):
            index = self.acknowledged
            refused = self._program.lines[index] if index < len(self._program.lines) else b""
            self._count.answered()
            self.acknowledged += 1
            self._fault(f"the controller refused {refused.decode().strip()!r}: {in_words(line)}")
        elif line.startswith("ALARM"):
            self._fault(f"the controller is in alarm: {in_words(line)}")
        elif line.lower().startswith("grbl"):
            self._overrides.reset()
            if not (self._braking and self._settled_s):
                self._fault("the controller was reset")

    def _report(self, status: Status) -> None:
        last_position, last_executed = self._at, self.executed
        self._at = self.controller.position(status)
        self._heard_s = clock_s()
        if self._settled_s is None:
            self._pass_lines()
        line_changes = way_passed(
            self._program, self._machine, (last_position, self._at), (last_executed, self.executed)
        )
        self._trace.record(self._heard_s - self._begun_s, self._at, *line_changes)
        if self._settled_s is not None:
            self.over = self._heard_s >= self._settled_s
            if self.over and self.state in (State.STOPPING, State.RUNNING):
                self._go(Cause.AT_REST if self.state is State.STOPPING else Cause.COMPLETED)
            return
        self._overrides.take(status)
        if status.overrides is not None or self._overrides.waited_s(self._heard_s) > OBEYS_S:
            self._override_on()
        if self._overrides.to_note:
            self._note_overrides()
        if status.state != "Idle":
            self._stood_s = np.inf
        if name := self.controller.beyond(self._at):
            self._fault(f"axis {name} is beyond its travel")
        if self._braking and status.stands:
            self._port.send(RESET)
            self._end()
        elif status.state == "Alarm" and not self._braking:
            self._fault("the controller is in alarm")
        elif self._heard_s > self._brakes_until_s:
            self._fault(f"the controller was told to hold, reports {status.state}, and was reset")
            self._port.send(RESET)
            self._end()
        elif not self._braking:
            self._follow(status)

    def _note_overrides(self) -> None:
        """Write the overrides, set at the controller itself, into recording and log."""
        text = self._overrides.noted()
        self._trace.note("override", text, self._operation)
        text = f"overrides set at the controller: {text}"
        self._sink.state(self._trace.tick, self.state, Cause.OVERRIDE, text)

    @property
    def _operation(self) -> int:
        """Operation of the job that is executed; -1 if unknown."""
        operations = self._program.operations
        return int(operations[min(self.executed, len(operations) - 1)]) if len(operations) else -1

    def _follow(self, status: Status) -> None:
        """Follow the controller's own changes: hold, resume, or end if it cannot go on."""
        is_fresh = self._heard_s - self._command_s > OBEYS_S  # else it may predate the command
        if status.state in PAUSES:
            door, next_line = status.state == "Door", self.acknowledged
            self._unready = status.words if door and status.detail in (1, 2) else ""
            if (
                self._pass_stops
                and not door
                and next_line != self._passed
                and self._way.stands_at_stop(next_line, self._at)
            ):
                self._passed = next_line
                self._port.send(RESUME)
                self._command_s = clock_s()
                return
            if self.state is State.RUNNING and is_fresh and not (door and status.detail == 3):
                self._go(Cause.HOLD, status.words)
                self._last_state_words = status.words
            elif (
                self.state is State.HOLDING
                and (door or self._last_state_words)
                and status.words != self._last_state_words
            ):
                self._last_state_words = self.why = status.words
                self._sink.state(self._trace.tick, self.state, Cause.HOLD, status.words)
            return
        self._unready = ""
        if status.state not in {"Idle", "Run"}:
            self._fault(status.words)
        elif self.state is State.HOLDING and is_fresh:  # by its own button, or at its end
            self._go(Cause.RESUME, "the controller goes on by itself")
            self._feed()
        elif self.state is State.RUNNING and status.state == "Idle":
            if self._all_answered:
                self._stand_at_end()
            else:
                self._stand_unanswered()

    def _stand_unanswered(self) -> None:
        """Accept a standing controller with open lines for as long as these lines may wait."""
        self._stood_s = min(self._stood_s, self._heard_s)
        open_lines = slice(self.acknowledged, self.acknowledged + self._count.open)
        timeout_s = ANSWERS_S + float(self._program.durations_s[open_lines].sum())
        if self._heard_s - self._stood_s > timeout_s:
            self._fault(f"the controller stands, and has not answered {self._count.open} lines")

    def _stand_at_end(self) -> None:
        """End a run with all lines answered once the controller stands at their end.

        A report from before the last line began may show it elsewhere for a moment.
        """
        distance_m = self._way.end_away_m(self._at)
        if distance_m <= OFF_PATH_M:
            self.executed = self.acknowledged
            self.ended = (RunEnd.COMPLETED, "")
            self._end()
            return
        self._stood_s = min(self._stood_s, self._heard_s)
        if self._heard_s - self._stood_s > _STANDS_S:
            self._fault(
                f"the controller has received every line, and stands {1e3 * distance_m:.3g} mm "
                "from the end of the last"
            )

    def _pass_lines(self) -> None:
        """Advance along the answered lines to the reported position."""
        if self._braking or not len(self._program.lines):
            return
        lines = range(self.executed, min(self.acknowledged + 1, len(self._program.ends)))
        executed, beside_m = self._way.passed(lines, self._at)
        if executed is not None:
            self.executed = executed
        elif beside_m > OFF_PATH_M and np.isfinite(beside_m):
            self._fault(f"the controller is {1e3 * beside_m:.3g} mm beside the lines it was sent")

    def _end(self) -> None:
        assert self.ended is not None
        ended, text = self.ended
        self._trace.end(ended, text)
        self._settled_s = clock_s() + _SETTLE_S

    def _fault(self, text: str) -> None:
        if self.ended is not None and self.ended[0] is RunEnd.FAULT:
            return
        self.ended = (RunEnd.FAULT, text)
        self._go(Cause.FAULT, text)
        self._brake()

    def _lost(self, text: str) -> None:
        """Note that nothing can be sent any more: the controller executes its buffer."""
        open_count = int(self._count.open)
        earlier_texts = [] if self.ended is None else [self.ended[1]]
        buffered = f"the controller executes by itself {open_count} lines and its planner's blocks"
        self.ended = (RunEnd.FAULT, "; ".join([*filter(None, earlier_texts), text, buffered]))
        self._trace.end(*self.ended)
        self._go(Cause.FAULT, text)
        self.over = True

    def _go(self, cause: Cause, text: str = "") -> None:
        self.state = next_state(self.state, cause)
        self.homed = homed_after(cause, self.homed)
        self.why = text
        if cause is Cause.HOLD:
            self._trace.note("hold", text, self._operation)
        elif cause is Cause.RESUME:
            self._trace.note("resume", text, self._operation)
        self._sink.state(self._trace.tick, self.state, cause, text)
