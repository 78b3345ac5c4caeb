"""The panel: clients on one side, the owner of the machine on the other, and permissions."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Mapping
from typing import Any, assert_never

from threadline.errors import CommandError, ThreadlineError
from threadline.live.feed_override import MAY_OVERRIDE
from threadline.live.guards import clock_s
from threadline.live.jogging import manual_feed
from threadline.live.kinds_run import run_kind_of
from threadline.live.links import AtLink
from threadline.live.states import TRANSITIONS, Cause, State
from threadline.live.wire import Message
from threadline.machine import Machine
from threadline.panel import protocol as say
from threadline.panel.calculation import Calculation
from threadline.panel.control import SEEN_S, Client, ControlLease, Lease
from threadline.panel.message_parts import Board, Console, Exchange, Fill
from threadline.panel.owner import TELL_S
from threadline.panel.owner_process import OwnerLink
from threadline.panel.welcoming import welcome_of

BEAT_S = 0.05
"""Period of the states sent to clients, s."""
_REST_BEATS = 2
"""Beats between two states if nothing has changed."""
_VOLATILE: Any = {"seq": True, "age_s": True, "control": {"left_s"}}
"""Fields that differ in every state, and are ignored in a comparison of states."""
_ALIVE_BEATS = 4
"""Beats between two signs of life to the owner: 0.2 s, a fifth of the silence that it allows."""
_STANDS_S = 10.0
"""Longest time in s for which the panel, at its end, waits until the machine stands."""
_LINES_KEPT = 400  # number of console lines kept for a page that is loaded again
_STOPS_KNOWN = 64  # stops remembered: a stop that comes by websocket and HTTP is reported once
_NOT_AWAITED = "the machine's own process stops it; the panel did not wait for that"
_MOVING = frozenset({State.HOMING, State.JOGGING, State.RUNNING, State.HOLDING, State.STOPPING})
_SAFE = frozenset({"let-go", "hold"})
"""Commands for which the age of the client's latest state does not matter."""
_CAUSES = {
    "enable": Cause.ENABLE, "disable": Cause.DISABLE, "home": Cause.HOME, "jog": Cause.JOG,
    "step": Cause.JOG, "zero": Cause.JOG, "zero-axis": Cause.JOG, "approach": Cause.JOG,
    "approach-rest": Cause.JOG, "start": Cause.START, "continue": Cause.START,
    "start-rest": Cause.START,
    "hold": Cause.HOLD, "resume": Cause.RESUME, "reset": Cause.RESET,
}  # fmt: skip
_OF_PROVEN = frozenset({"start", "approach", "continue", "approach-rest", "start-rest"})
_OF_REST = frozenset({"approach-rest", "start-rest"})
_NEED_REST = frozenset({Cause.JOG, Cause.HOME})
"""Causes of commands that need a machine at rest; switching off is possible at any time."""
_BROKEN = frozenset({State.FAULT, State.DISABLED})
"""States in which the link may be started again."""


class Panel:
    """Passes commands of the client in control to the owner, and shows the state to all.

    Parameters
    ----------
    machine
        The machine.
    owner
        The connection to the process that owns it.
    calculation
        Calculates and proves programs.
    link, far_end
        Name of the link to the machine, and the description of its far end.

    Attributes
    ----------
    machine
        The machine.
    ended
        State of the machine when the panel ended.
    """

    def __init__(
        self,
        machine: Machine,
        owner: OwnerLink,
        calculation: Calculation,
        link: str = "sim",
        far_end: AtLink | None = None,
    ) -> None:
        self.machine, self._owner, self.calculation = machine, owner, calculation
        self._link, self._far_end = link, far_end or AtLink()
        self.ended = _NOT_AWAITED
        self._control = ControlLease()
        self._clients: dict[int, Client] = {}
        self._numbers = 0
        self._seq = 0
        self._asked: dict[int, tuple[int, int]] = {}  # client and its command number, by request
        self._requests = 0
        self._stops: deque[tuple[int, int | None]] = deque(maxlen=_STOPS_KNOWN)
        self._board: Board | None = None
        self._lines: deque[Exchange] = deque(maxlen=_LINES_KEPT)

    def connect(self) -> None:
        """Start an owner of the machine; call it on the event loop."""
        self._owner.connect(self._take)

    def busy(self) -> str:
        """Return why no run and no calculation can begin now, for people; empty if they can."""
        if self.calculation.share is not None:
            return "a program is being calculated"
        return str(self._owner.now.get("busy", ""))

    async def close(self) -> None:
        """Stop the machine, leave the owner, and end a calculation; sets ``ended``."""
        self.ended = await self._stopped()
        await self.calculation.close()
        await self._owner.close()

    async def _stopped(self) -> str:
        """Stop the machine, wait for the report that it stands, and return its final state."""
        owner, since_s = self._owner, clock_s()
        if not owner.gone and not owner.now:
            return "the machine was not reached yet"
        owner.send("stop")
        while not owner.gone and clock_s() < since_s + _STANDS_S:
            has_reported = (
                owner.heard_s > since_s + 2.0 * TELL_S
            )  # the report is newer than the stop
            if (
                has_reported
                and not owner.now["moving"]
                and State(owner.now["state"]) not in _MOVING
            ):
                return end_words(owner.now)
            owner.send("alive")
            await asyncio.sleep(BEAT_S)
        return owner.gone or "the machine was told to stop, and has not reported that it stands"

    # --- clients ---------------------------------------------------------------------------

    def welcome(self, name: str) -> Client:
        """Register a client, and greet it."""
        self._numbers += 1
        client = Client(self._numbers, name)
        self._clients[client.number] = client
        client.tell(welcome_of(self.machine, client.number, self._link, self._far_end))
        if self.calculation.figures is not None:
            client.tell(self.calculation.figures)
        if self._board is not None:
            client.tell(self._board)
        if self._lines:
            client.tell(Console(lines=list(self._lines), whole=True))
        return client

    def leave(self, client: Client) -> None:
        """Unregister a client; end its moves by hand."""
        self._clients.pop(client.number, None)
        if self._control.release(client.number):
            self._owner.send("let-go")

    def take(self, client: Client, message: say.Stop | say.Control | say.Alive | say.Act) -> None:
        """Act on a message of a client; a refused command gets an answer with the reason."""
        now_s = clock_s()
        match message:
            case say.Stop():
                self.stop(client.number, message.number)
            case say.Control():
                self._word(client, message.word, now_s)
            case say.Alive():
                self._control.renew(message.lease, now_s, client.number)
            case say.Act():
                try:
                    self._act(client, message, now_s)
                except ThreadlineError as error:
                    client.tell(say.Answer(number=message.number, ok=False, text=str(error)))
            case _:
                assert_never(message)

    def stop(self, who: int, number: int | None) -> None:
        """Stop the machine; every client may ask for it.

        Parameters
        ----------
        who, number
            Number of the client, 0 for an unknown sender, and number of its stop: a stop that comes
            twice is reported once.
        """
        self._owner.send("stop")
        if number is not None and (who, number) in self._stops:
            return
        self._stops.append((who, number))
        client = self._clients.get(who)
        asked_by = "a request" if client is None else f"{client.name} ({client.number})"
        self._tell_all(say.Said(text=f"stopped by {asked_by}"))

    def may_change(self, lease: str) -> bool:
        """Return whether a lease is the one in force, and renew it."""
        return self._control.renew(lease, clock_s())

    def _word(self, client: Client, word: str, now_s: float) -> None:
        if word == "take":
            self._granted(self._control.take(client.number, now_s))
        elif word == "give":
            self._granted(self._control.give(client.number, now_s))
        elif word == "keep":
            self._control.keep(client.number, now_s)
        elif self._control.release(client.number):
            self._owner.send("let-go")

    def _granted(self, lease: Lease | None) -> None:
        if lease is None:
            return
        self._owner.send("let-go")  # ends another client's move by hand
        if (client := self._clients.get(lease.client)) is not None:
            client.tell(say.Leased(lease=lease.word))

    # --- commands --------------------------------------------------------------------------

    def _act(self, client: Client, act: say.Act, now_s: float) -> None:
        command = act.command
        if not client.is_next(act.number):
            raise CommandError(f"the command {act.number} came before", remedy="Reload the page.")
        if not self._control.renew(act.lease, now_s, client.number):
            raise CommandError("you are not in control", remedy="Take control first.")
        if command.what not in _SAFE and not client.saw(act.seen, now_s):
            raise CommandError(
                f"the state that you have seen is older than {SEEN_S:g} s", remedy="Look again."
            )
        if command.what not in {*self.allowed(), "renew", "let-go"}:
            starts_work = command.what == "calculate" or _CAUSES.get(command.what) is Cause.START
            busy = self.busy() if starts_work else ""
            lost = self._owner.gone or self._owner.now.get("lost", False)
            raise CommandError(
                f"{command.what!r} is not possible now: the machine is {self.state().state}"
                f"{f', and {busy}' if busy else ''}",
                remedy="Reconnect." if lost else "Wait." if busy else "",
            )
        if isinstance(command, say.Calculate):
            self.calculation.begin(command, self._show_result)
        elif command.what == "cancel":
            self.calculation.cancel()
        elif command.what == "reconnect":
            self._owner.connect(self._take)
        else:
            self._requests += 1
            self._asked[self._requests] = (client.number, act.number)
            self._pass_on(command, self._requests)
            return
        client.tell(say.Answer(number=act.number, ok=True))

    def _pass_on(
        self,
        command: say.Simple
        | say.ZeroAxis
        | say.Jog
        | say.Step
        | say.ConsoleLine
        | say.OverrideFeed
        | say.Start
        | say.Continue,
        number: int,
    ) -> None:
        owner, machine = self._owner, self.machine
        names = list(machine.axes)
        match command:
            case say.Jog():
                k = self._axis(command.axis)
                tick_s = float(machine.tick_clock.period_s)
                manual_feeds = manual_feed(machine)[k] / machine.counts_per_unit[k] / tick_s
                owner.send(
                    "jog",
                    number=number,
                    axis=command.axis,
                    velocity=command.share * float(manual_feeds),
                )
            case say.Step():
                step_counts = round(command.by * machine.counts_per_unit[self._axis(command.axis)])
                owner.send("step", number=number, axis=command.axis, by=step_counts)
            case say.ZeroAxis():
                self._axis(command.axis)
                owner.send("zero-axis", number=number, to=[[command.axis, 0]])
            case say.ConsoleLine():
                owner.send("console", number=number, line=command.line)
            case say.OverrideFeed():
                owner.send("override-feed", number=number, percent=command.percent)
            case say.Start():
                proven = self.calculation.to_start(command.proof)
                owner.send("start", number=number, override=command.override, **proven)
            case say.Continue():
                proven = self.calculation.to_start(command.proof)
                rest = {"run": command.run, "at": command.at, "override": command.override}
                owner.send("continue", number=number, **rest, **proven)
            case say.Simple(what="zero"):
                owner.send("zero", number=number, to=[[name, 0] for name in self._in_order()])
            case say.Simple(what="approach"):
                starts = dict(zip(names, self.calculation.starts, strict=True))
                targets = [[name, starts[name]] for name in self._in_order()]
                owner.send("approach", number=number, to=targets)
            case say.Simple():
                owner.send(command.what, number=number)
            case _:
                assert_never(command)

    def _in_order(self) -> list[str]:
        """Return the axes in the order in which they move to 0: linear ones first."""
        axes = self.machine.axes
        return sorted(axes, key=lambda name: axes[name].kind != "linear")

    def _axis(self, name: str) -> int:
        names = list(self.machine.axes)
        if name not in names:
            raise CommandError(f"there is no axis {name[:20]!r}", remedy="Reload the page.")
        return names.index(name)

    def allowed(self) -> list[str]:
        """Return the commands that are possible now, besides a stop."""
        if self._owner.gone:
            return ["reconnect"]
        now, calculation = self._owner.now, self.calculation
        if not now:
            return []
        state, stands = State(now["state"]), not now["moving"]
        free = stands and not self.busy()
        commands = [
            what
            for what, cause in _CAUSES.items()
            if (state, cause) in TRANSITIONS
            and (stands or cause not in _NEED_REST)
            and (free or cause is not Cause.START)
        ]
        if not run_kind_of(self.machine).by_hand:
            commands = [what for what in commands if _CAUSES[what] is not Cause.JOG]
        if state in MAY_OVERRIDE and not now["no_override"]:
            commands.append("override-feed")
        if self._far_end.console and stands and state not in _MOVING and not self.busy():
            commands.append("console")
        if calculation.proven is None:
            commands = [what for what in commands if what not in _OF_PROVEN]
        if now["rest"] is None:
            commands = [what for what in commands if what not in _OF_REST]
        commands = [what for what in commands if what not in self._far_end.lacks]
        if now["lost"]:
            commands.clear()  # no owner can execute a command
        if stands and (state in _BROKEN or now["lost"]):
            commands.append("reconnect")
        if calculation.share is not None:
            return [*commands, "cancel"]
        return [*commands, *(["calculate"] if free else [])]

    # --- what is shown ---------------------------------------------------------------------

    def _take(self, message: Message) -> None:
        """Process messages of the owner other than its reports."""
        head = message.head
        if message.kind == "said":
            self._tell_all(say.Said(text=str(head["text"]), wrong=bool(head["wrong"])))
        elif message.kind == "answer":
            client, number = self._asked.pop(int(head["number"]), (0, 0))
            if client in self._clients:
                answer = say.Answer(number=number, ok=bool(head["ok"]), text=str(head["text"]))
                self._clients[client].tell(answer)

        elif message.kind == "board":
            self._board = Board.model_validate(head)
            self._tell_all(self._board)
        elif message.kind == "console":
            lines = Console.model_validate(head)
            self._lines.extend(lines.lines)
            self._tell_all(lines)

    def _show_result(self, found: say.Figures | str) -> None:
        """Show the result of a calculation, or why there is none."""
        self._tell_all(say.Said(text=found, wrong=True) if isinstance(found, str) else found)

    def _tell_all(self, message: say.Said | say.Figures | Board | Console) -> None:
        for client in self._clients.values():
            client.tell(message)

    def proven_run_s(self) -> float | None:
        """Return the time of a run of the latest calculation, s; None if none is under way."""
        progress, proven = self._owner.now.get("progress"), self.calculation.proven
        if progress is None or proven is None or progress.get("ended") is not None:
            return None
        return float(progress["time_s"]) if progress["file"] == proven.program else None

    def state(self) -> say.State:
        """Return the present state, without its sequence number."""
        now_s, now, control = clock_s(), self._owner.now, self._control
        held = control.holder(now_s)
        names = {number: client.name for number, client in self._clients.items()}
        holder = None if held is None else held.client
        progress = now.get("progress")
        gone = self._owner.gone
        return say.State(
            seq=self._seq,
            state="gone" if gone else str(now.get("state", "connecting")),
            why=gone or str(now.get("why", "")),
            allowed=self.allowed(),
            age_s=round(now_s - self._owner.heard_s + float(now.get("age_s", 0.0)), 3),
            time_s=float(now.get("time_s", 0.0)),
            axes={
                name: say.Where(commanded=at[0], measured=at[1], load=at[2])
                for name, at in now.get("axes", {}).items()
            },
            signals=now.get("signals", {}),
            readings={
                name: say.Reading(value=value, unit=unit)
                for name, (value, unit) in now.get("readings", {}).items()
            },
            late_ticks=int(now.get("late_ticks", 0)),
            feed_percent=int(now.get("percent", 100)),
            no_override=str(now.get("no_override", "")),
            control=say.Holder(
                client=holder,
                name=names.get(holder or 0, ""),
                left_s=round(control.left_s(now_s), 1),
                asks=control.asks,
                asks_name=names.get(control.asks or 0, ""),
                passes_in_s=round(control.passes_in_s(now_s), 1),
            ),
            progress=None if progress is None else say.Progress.model_validate(progress),
            rest=None if not now.get("rest") else say.RestOfRun.model_validate(now["rest"]),
            proven=self.calculation.proven,
            calculating=self.calculation.share,
            board=None if not now.get("board") else Fill.model_validate(now["board"]),
            busy=self.busy(),
            clients=len(self._clients),
        )

    async def beat(self) -> None:
        """Show the state to all clients periodically, and tell the owner that the server lives.

        An unchanged state is sent half as often, because a page needs as much work for it as for a
        new one.
        """
        shown: dict[str, Any] = {}
        while True:
            # The owner reads from its first report on.
            if self._owner.now and self._seq % _ALIVE_BEATS == 0:
                self._owner.send("alive")
            self._granted(self._control.pass_if_due(clock_s()))
            self._seq += 1
            state = self.state()
            compared = state.model_dump(exclude=_VOLATILE)
            if compared != shown or self._seq % _REST_BEATS == 0:
                shown, text = compared, state.model_dump_json()
                for client in self._clients.values():
                    client.show(self._seq, text)
            await asyncio.sleep(BEAT_S)


def end_words(now: Mapping[str, Any]) -> str:
    """Return the final state of a machine that was stopped, in words."""
    if State(now["state"]) is State.FAULT:
        return f"the machine stands, in a fault: {now['why'] or 'no reason is known'}"
    return f"the machine was stopped, and is {now['state']}"
