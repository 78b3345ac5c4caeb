"""The executor of one machine: it sends the rows of a proved plan, always with a way to rest.

Rows are sent at most ``DEPTH_S`` ahead. Each refill ends in a tail that brakes along the path, and
the next refill replaces the tail. If the executor or the link fails, the tail brings the machine to
rest.
"""

from __future__ import annotations

import select
from collections.abc import Mapping

import numpy as np

from threadline.base.arrays import IntArray
from threadline.errors import CommandError, LimitError, LinkFaultError
from threadline.files import Commands, RunEnd
from threadline.live.ahead import Ahead, ticks_in
from threadline.live.at_rest import AtRest
from threadline.live.feed_override import feed_words, refuse_override
from threadline.live.guards import clock_s
from threadline.live.jogging import JogAhead, MoveAhead
from threadline.live.kinds_run import RunAhead, run_kind_of
from threadline.live.states import MOVING, Cause, Desk, Hold, Sink, State, next_state
from threadline.live.wire import Connection, Message
from threadline.machine import Machine

DEPTH_S = 0.1
"""Rows are sent at most this far ahead, s."""
LEASE_S = 0.25
"""Time in s after which a jog ends unless the operator renews it."""
_STEPPED_S = 60.0  # longest silence, in s, of a machine whose clock waits for the executor
_LEAD_S = 0.02
"""Time in s from a stop to its first braking row, in real time: a message takes at most so long."""
MANY_S = 0.09
"""Longest machine time in s per report, if the machine's clock waits for the executor: a run
without commands of the operator then goes as fast as it can."""
_QUICK = 10.0
"""Least speed at which a report may cover ``MANY_S``: commands then wait at most 9 ms."""
_STARVED = "refills came too late, this computer was busy: the machine has braked by itself"
_SENDING = frozenset({State.RUNNING, State.HOLDING, State.JOGGING})


class Executor(AtRest):
    """Runs tables of counts on a machine at the end of a link.

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
    speed
        Seconds of machine time per second; 1 is real time.
    """

    def __init__(
        self, link: Connection, machine: Machine, desk: Desk, sink: Sink, *, speed: float
    ) -> None:
        super().__init__(link, machine, desk, sink)
        self._real_time = speed == 1.0
        self._many = _many(machine) if speed == 0.0 or speed >= _QUICK else 0
        self._run_kind = run_kind_of(machine)
        self._ahead: RunAhead | JogAhead | None = None
        self._hold = Hold.AT_ONCE
        self._gently = False  # the sent braking is gentle
        self._harder = False  # the sent gentle braking is to be replaced by one at once
        self._braked_from = 0  # first tick of the sent braking
        self._lease = ticks_in(LEASE_S, machine)
        self._lease_until = 0
        self._depth = ticks_in(DEPTH_S, machine)
        self._settle = 0
        self._lead = ticks_in(_LEAD_S, machine) if self._real_time else 0
        self._heard_s = clock_s()  # when the last report came
        self._rest: int | None = None  # tick from which on nothing is commanded any more
        self._owes_go = self._brake_again = False
        self._braked = False  # the sent rows end in a requested braking
        self.no_override = self._run_kind.no_override

    @property
    def percent(self) -> int:
        """Feed override of the run, %."""
        ahead = self._ahead
        return round(100.0 * ahead.rate) if ahead and not isinstance(ahead, JogAhead) else 100

    @property
    def plan_s(self) -> float:
        """Time in the plan up to which the machine has reported that it played it, s."""
        ahead = self._ahead
        if not isinstance(ahead, Ahead):
            return self.time_s
        return ahead.place_at(self.tick) * self._period_s  # a row is a tick of the plan

    @property
    def share_done(self) -> float | None:
        """Executed share of a run, 0 to 1; None if it follows from the time of the run."""
        ahead = self._ahead
        return None if ahead is None or isinstance(ahead, JogAhead) else ahead.share_done

    @property
    def under_way(self) -> bool:
        """Whether a run or a jog has begun and is not over: ``step`` must be called."""
        return self._ahead is not None and not self.over

    def start(
        self,
        commands: Commands,
        *,
        pass_stops: bool = False,
        hold: Hold = Hold.AT_ONCE,
        loads_follow: bool = False,
        from_rest: bool = False,
        no_override: str = "",
    ) -> None:
        """Begin a run. The caller has checked the proof; the limits of each row are checked here.

        Parameters
        ----------
        commands
            Commands to run.
        pass_stops
            Whether the run goes on at stops of the program without an answer.
        hold
            When a hold brakes, and how hard, so that it does not spoil the work.
        loads_follow
            Whether the commands make the loads follow the motion (``RunKind.loads_follow``).
        from_rest
            Whether the first rows are at speed, so that the run must start as after a hold.
        no_override
            Why the feed of this run cannot be overridden; empty if it can. The caller has simulated
            the effects of overrides.

        Raises
        ------
        CommandError
            If the machine is not idle.
        LimitError
            If the first rows exceed a limit; nothing has moved then.
        """
        next_state(self.state, Cause.START)  # refused before anything is sent
        ahead = self._run_kind.ahead(
            commands, self._machine, pass_stops=pass_stops, loads_follow=loads_follow
        )
        ahead.refuse_elsewhere(self._stands)
        self._hold, ahead.gently = hold, hold is Hold.GENTLY
        self.no_override = self._run_kind.no_override or no_override
        if from_rest:
            ahead.start_again()
        self._set_out(Cause.START, ahead, ahead.start)

    def jog(self, axis: str, velocity: float) -> None:
        """Move an axis until ``let_go``, or until the jog was not renewed for ``LEASE_S``.

        Parameters
        ----------
        axis, velocity
            Name of the axis, and its speed in m/s or rad/s, at most the manual feed.

        Raises
        ------
        CommandError
            If the machine is not idle, has no such axis, or the speed is above the manual feed.
        """
        self._refuse_by_hand()
        self._set_out_by_hand(JogAhead(self._machine, self._stands, axis, velocity))

    def move(self, axis: str, to_counts: int, lease_s: float = LEASE_S) -> None:
        """Move an axis to a position at its manual feed, with the lease of a jog.

        Parameters
        ----------
        axis, to_counts
            Name of the axis, and the position in counts.
        lease_s
            Remaining lease, s, if this move follows another one.

        Raises
        ------
        CommandError
            If the machine is not idle, has no such axis, or the position is beyond its travel.
        """
        self._refuse_by_hand()
        self._set_out_by_hand(
            MoveAhead(self._machine, self._stands, axis, to_counts), min(lease_s, LEASE_S)
        )

    def _refuse_by_hand(self) -> None:
        """Refuse a jog or move that is not possible now, or never on this machine."""
        next_state(self.state, Cause.JOG)
        if not self._run_kind.by_hand:
            raise CommandError(
                f"{self._machine.name} has no axes that move one at a time by hand",
                remedy="Home it: that brings it to where its programs begin.",
            )

    def _set_out_by_hand(self, jog: JogAhead, lease_s: float = LEASE_S) -> None:
        self._lease_until = ticks_in(lease_s, self._machine)
        self._set_out(Cause.JOG, jog, self._stands)

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
        self._lease_until = self.tick + self._lease

    def let_go(self) -> None:
        """End a jog: brake at once."""
        if self.state is State.JOGGING:
            self._brake()

    def _set_out(self, cause: Cause, ahead: RunAhead | JogAhead, stands: IntArray) -> None:
        first = ahead.extend(self._depth)
        self.tick, self.ended, self.over, self._rest = 0, None, False, None
        self._heard_s = clock_s()
        self._braked = self._brake_again = self._gently = self._harder = False
        self._guards = self._run_kind.guards(self._machine)  # without memory of the last motion
        self._ahead, self._began, self._number = ahead, stands, self._number + 1
        self._settle = ahead.settle_ticks
        self._go(cause)
        self._link.send(Message("begin"))
        self._link.send(first)
        self._owes_go = not self._real_time

    @property
    def _needs_no_decision(self) -> bool:
        """Whether a run needs no decision within the next ``MANY_S``."""
        ahead = self._ahead
        return (
            self._many > 0
            and self.state is State.RUNNING
            and self.ended is None
            and not isinstance(ahead, JogAhead | None)
            and not ahead.complete
            and ahead.halt is None
        )

    def step(self) -> None:
        """Wait for a report or a command and act on it; call it until ``over`` is True."""
        if self._owes_go:  # the machine's clock waits: execute commands before it goes on
            self.obey()
            self._owes_go = False
            self._link.send(Message("go", {"ticks": self._many} if self._needs_no_decision else {}))
        if not self._link.waiting:
            silence_s = 5 * DEPTH_S if self._real_time and self.tick else _STEPPED_S
            waited_on = [self._desk.fileno(), self._link.fileno()]
            ready, _, _ = select.select(waited_on, [], [], silence_s)
            if self._desk.fileno() in ready:
                self._desk.woken()
            elif not ready:
                self._lost(f"the machine was silent for {silence_s:g} s")
                return
        if self._real_time:
            self.obey()
        try:
            message = self._link.receive(0.0)
        except LinkFaultError as error:
            self._lost(error.message)
            return
        if message is not None:
            self._hear(message)
        elif self._link.lost:
            self._lost("the link is gone")

    def obey(self) -> None:
        """Execute the commands of the desk; an impossible one is recorded and dropped."""
        super().obey()
        percent = self._desk.take_override()
        if percent is None:
            return
        try:
            self.override(percent)
        except CommandError as error:
            self._sink.state(self.tick, self.state, Cause.OVERRIDE, error.message)

    def override(self, percent: int) -> None:
        """Override the feed of the run; the change begins with the next refill, a hold keeps it.

        Parameters
        ----------
        percent
            Override, 10 to 100 %: a proof does not cover a higher feed.

        Raises
        ------
        CommandError
            If ``percent`` is out of range, there is no run, or this run allows no override.
        """
        refuse_override(percent, self.state, self.no_override)
        ahead = self._ahead
        assert not isinstance(ahead, JogAhead | None)
        ahead.rate = percent / 100.0
        self._sink.state(self.tick, self.state, Cause.OVERRIDE, feed_words(percent))

    def _command(self, cause: Cause) -> None:
        cause.refuse_after(self.ended)
        moving = self.state in MOVING
        waits_for_rest = cause is Cause.HOLD and self._hold is Hold.AT_REST
        self._go(cause, "it goes on to the next rest and stands there" if waits_for_rest else "")
        if cause is Cause.STOP and moving:
            self._homed = self._homed and (self._ahead is None or self._ahead.keeps_home)
            self.ended = self.ended or (RunEnd.STOPPED, f"stopped by {self.stopped_by}")
            self._brake()
        elif cause is Cause.HOLD:
            if self._hold is Hold.AT_REST and not isinstance(self._ahead, JogAhead | None):
                self._ahead.to_rest = True
                if self._ahead.rests:  # in a rest already: the braking after it is not played
                    self._link.send(self._ahead.extend(self._ahead.end))
            else:
                self._brake(gently=self._hold is Hold.GENTLY)
        elif cause is Cause.RESUME:
            self._start_again()

    @property
    def _soonest(self) -> int:
        """First tick whose row can still be replaced; in real time, estimated by the clock."""
        elapsed_s = min(clock_s() - self._heard_s, DEPTH_S) if self._real_time else 0.0
        return self.tick + int(elapsed_s / self._period_s) + self._lead

    def _brake(self, *, gently: bool = False) -> None:
        """Replace the rows that the machine holds by braking along the path, once.

        Rows that already brake are kept: a second cut after a refused one could not be undone. A
        gentle braking is replaced by one at once when a report shows that the machine plays the
        gentle braking, and so has not refused it.
        """
        ahead = self._ahead
        if ahead is None or self._rest is not None or ahead.end <= self.tick:
            return
        if self._braked:
            if self._gently and not gently:
                self._gently, self._harder = False, True
            return
        self._braked, self._gently, self._harder = True, gently, False
        if not isinstance(ahead, JogAhead):
            ahead.gently = gently
        self._braked_from = self._soonest
        self._link.send(ahead.cut(self._braked_from))

    def _start_again(self) -> None:
        ahead = self._ahead
        assert not isinstance(ahead, JogAhead | None)  # a jog is not held
        was_to_rest, ahead.to_rest, self._braked = ahead.to_rest, False, False
        ahead.rest_until(self._soonest)
        if ahead.halt is not None:
            ahead.pass_halt()  # its rows begin from rest by themselves
        elif was_to_rest:
            pass  # its rows begin from rest, too
        else:
            ahead.start_again()
        if self.tick + self._depth > ahead.end:
            self._link.send(ahead.extend(self.tick + self._depth))

    def _hear(self, message: Message) -> None:
        if message.kind == "refused":
            self._refused(message)
        elif message.kind == "report" and message.head["run"] == self._number:
            if self.state is not State.JOGGING:
                settled = None if self._rest is None else self._rest + self._settle
                self._sink.block(self.far_end.reported(message, settled))
            head = message.head
            self.tick, self._heard_s = int(head["now"]), clock_s()
            self._stands = self._began + np.array(head["position"], dtype=np.int64)
            self.late_ticks += int(head["late"])
            cause = _STARVED if head["starved"] else ""
            samples = {name: np.asarray(a, np.float64) for name, a in message.arrays.items()}
            if isinstance(self._ahead, JogAhead):
                self._ahead.measured(self.tick, samples)
            elif self._ahead is not None:
                cause = self._ahead.hear(head) or cause
            last_samples = self._keep_latest(message)
            if cause and self.state in _SENDING:
                self._fault(cause)
            faults = [one[3] for one in head["events"] if one[1] == "fault"]
            if faults and self.ended is None:  # on its own: later positions are unknown
                self._fault(faults[0])
                self.over = True
                return
            if self.ended is None and self._rest is None:
                cause = self._guards.trip(
                    int(head["tick"]), samples, bool(head["late"]), float(head["late_by"])
                )
                if cause:
                    self._fault(cause)
            try:
                self._go_on(last_samples, standing=not head["held"])
            except LimitError as error:
                self._fault(error.message)
            self._owes_go = not self._real_time and not self.over

    def _refused(self, message: Message) -> None:
        refused_kind, why = message.head.get("what"), message.head.get("why")
        if refused_kind == "refill" and self._ahead is not None and self._ahead.undo():
            # Braking was to begin at a tick in the past; the next report gives a later one.
            self._lead, self._brake_again = max(2 * self._lead, 1), True
            self._braked = self._harder = False
        elif self.state is not State.FAULT:
            self._fault(f"the machine refused a {refused_kind}: {why}")
            self.over = refused_kind == "begin"  # nothing moves, and no report will come

    def _go_on(self, now: Mapping[str, float], *, standing: bool) -> None:
        """Act on a report: extend the rows, stand at a halt, or end the run."""
        ahead = self._ahead
        if ahead is None:
            return
        ahead.forget(self.tick)
        if self._rest is not None:
            if self.tick >= self._rest + self._settle:
                self._leave()
            return
        if self._brake_again:
            self._brake_again = False
            self._brake(gently=self._gently)
        if self._harder and self.tick >= self._braked_from:
            self._braked = False
            self._brake()
        played = standing and self.tick >= ahead.end
        if isinstance(ahead, JogAhead):  # teaching reads the position at the end
            played = played and ahead.settled(self.tick)
        if self.ended is not None:
            if played:
                ended, text = self.ended
                self._link.send(Message("finish", {"ended": ended.value, "text": text}))
                self._rest = self.tick
        elif isinstance(ahead, JogAhead):
            self._go_on_by_hand(ahead, played=played)
        elif self.state is State.RUNNING and ahead.complete:
            if played:
                self.ended, self._rest = (RunEnd.COMPLETED, ""), ahead.end
        elif self.state is State.RUNNING and ahead.halt is not None:
            if played:
                self._go(Cause.HOLD, f"{ahead.halt.kind} {ahead.halt.name}".strip())
        elif self.state is State.HOLDING and played and ahead.met(now):
            self._command(Cause.RESUME)
        elif self.tick + self._depth > ahead.end and self._goes(ahead):
            self._link.send(ahead.extend(self.tick + self._depth))

    def _goes(self, ahead: RunAhead) -> bool:
        """Return whether to send rows: in a run, and in a hold on its way to a rest."""
        return self.state is State.RUNNING or (
            self.state is State.HOLDING and ahead.to_rest and not ahead.rests
        )

    def _go_on_by_hand(self, jog: JogAhead, *, played: bool) -> None:
        if jog.complete:
            if played:
                self.ended, self.over = (RunEnd.COMPLETED, jog.why), True
                self._go(Cause.AT_REST, jog.why)
        elif self.tick >= self._lease_until:
            jog.why = f"nobody has renewed its lease for {LEASE_S:g} s"
            self._brake()
        elif self.tick + self._depth > jog.end:
            self._link.send(jog.extend(self.tick + self._depth))

    def _leave(self) -> None:
        self.over = True
        if self.state is State.STOPPING:
            self._go(Cause.AT_REST if self._homed else Cause.AT_REST_UNHOMED)
        elif self.state is State.RUNNING:
            self._go(Cause.COMPLETED)

    def _fault(self, text: str) -> None:
        """Enter the fault state, and brake."""
        super()._fault(text)
        self._brake()


def _many(machine: Machine) -> int:
    """Return the number of whole ticks in ``MANY_S``, or 0."""
    return int(MANY_S / float(machine.command_clock.period_s) + 1e-9)
