"""The process that owns the machine: it executes the web server's requests, and can stop alone.

It does not need the web server to be safe. A separate thread receives a stop, ahead of all other
requests. If the server is gone, or silent for ``SILENT_S``, nobody could stop the machine any more;
so it is stopped, along its path.
"""

from __future__ import annotations

import select
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from threadline.errors import CommandError, LinkFaultError, ThreadlineError
from threadline.files import RunEnd
from threadline.live.at_rest import OPERATOR
from threadline.live.executor import LEASE_S
from threadline.live.grbl_console import Exchange
from threadline.live.guards import clock_s
from threadline.live.operated import Operated
from threadline.live.states import TRANSITIONS, Cause, Desk, State
from threadline.live.wire import Connection, Message
from threadline.machine import Machine
from threadline.panel.stored_runs import Prepared, StoredRuns
from threadline.panel.welcoming import positions, readings, signals

LINES_PERIOD_S = 0.25
"""Shortest time between two reports of the lines of a run, s."""
_MOST_LINES_AT_ONCE = 40  # largest number of lines of a run in one report


class MoveSequence:
    """The remaining moves of a sequence; they are dropped if one does not reach its end.

    Time is an argument, in s.
    """

    def __init__(self) -> None:
        self._queued: deque[tuple[str, int]] = deque()
        self._stops = 0  # stops received before the sequence was requested
        self._renewed_s = 0.0
        self._begun = False

    @property
    def left(self) -> int:
        """Number of moves that have not begun."""
        return len(self._queued)

    def begin(self, moves: Iterable[tuple[str, int]], stops: int, now_s: float) -> None:
        """Begin a sequence of moves: the axis, and its target in counts."""
        self._queued, self._stops, self._begun = deque(moves), stops, False
        self._renewed_s = now_s

    def renew(self, now_s: float) -> None:
        """Renew the lease of the sequence: a client still wants it."""
        self._renewed_s = now_s

    def lease_s(self, now_s: float) -> float:
        """Return the remaining lease since the last renewal, s."""
        return LEASE_S - (now_s - self._renewed_s)

    def clear(self) -> None:
        """Drop the remaining moves."""
        self._queued.clear()

    def next_one(
        self, stops: int, ended: tuple[RunEnd, str] | None, now_s: float
    ) -> tuple[str, int] | None:
        """Return the next move to begin, or None; drop all moves if the sequence has to end.

        Parameters
        ----------
        stops
            Number of stops received so far.
        ended
            How the previous motion ended.
        now_s
            The time.
        """
        completed = not self._begun or ended == (RunEnd.COMPLETED, "")
        if stops != self._stops or not completed or self.lease_s(now_s) <= 0.0:
            self.clear()
        if not self._queued:
            return None
        self._begun = True
        return self._queued.popleft()


SILENT_S = 1.0
"""Silence of the server in s after which the machine is stopped."""
TELL_S = 0.05
"""Period of the reports to the server, s."""
_PATIENCE_S = 0.02
_OLD_S = 3.0
"""Age in s above which a request is refused, because the situation may have changed."""
_SAFE = frozenset({"let-go", "hold"})
_BY_DESK = {"hold": Cause.HOLD, "resume": Cause.RESUME}
_LATER = frozenset({"start", "continue"})
"""Requests that are answered only after a check, which takes seconds."""
_MOVES = frozenset({"zero", "zero-axis", "approach"})
_DRIVES = frozenset({"enable", "disable", "home", "reset"})
_NO_START = frozenset({"disable", "home", "jog", "step", "approach-rest", "start-rest", *_MOVES})
"""Requests that cancel a start being checked, because they move the machine or switch it off."""


@dataclass(frozen=True, slots=True)
class _Request:
    """A request of the server, and the number of stops received before it."""

    what: str
    head: Mapping[str, Any]
    stops: int


class Owner:
    """Owns a machine, and executes the web server's requests.

    Parameters
    ----------
    server
        Connection to the web server.
    executor
        Executor of the machine, not connected to it yet.
    machine
        The machine.
    desk
        Queue of the operator's commands for the executor.
    runs
        Keeps the runs.
    """

    def __init__(
        self, server: Connection, executor: Operated, machine: Machine, desk: Desk, runs: StoredRuns
    ) -> None:
        self._server, self._machine, self._runs = server, machine, runs
        self._desk, self._executor = desk, executor
        executor.meanwhile = self._tell
        self._asked: deque[_Request] = deque()
        self._stops = 0
        self._heard_s = clock_s()
        self._leaving = False
        self._moves = MoveSequence()
        self._rest: Prepared | None = None  # rest of an interrupted run that is not confirmed yet
        self._sent_s, self._sent_state = 0.0, State.DISABLED
        self._board = BoardReports(executor)

    def serve(self) -> None:
        """Serve until the server has left and the machine stands."""
        threading.Thread(target=self._listen, daemon=True).start()
        executor = self._executor
        failed: BaseException | None = None
        try:
            executor.connect()
            while not (self._leaving and not executor.under_way):
                if executor.under_way:
                    executor.step()
                else:
                    executor.stand(_PATIENCE_S)
                self._watch_server()
                self._take_requests()
                self._go_on()
                self._tell()
            self._runs.end(executor)
        except (ThreadlineError, OSError) as error:
            # The link ends with this process after any error, and the rows sent ahead brake the
            # machine.
            failed = error
            self._tell_board()
            self._say("dead", why=str(error))
        finally:
            executor.close()
            self._runs.close(failed)

    # --- the server ------------------------------------------------------------------------

    def _listen(self) -> None:
        """Receive messages in a separate thread; a stop is executed before all other requests."""
        while True:
            try:
                message = self._server.receive()
            except LinkFaultError:
                message = None
            if message is None:
                break
            self._heard_s = clock_s()
            if message.kind == "stop":
                self._executor.stopped_by = OPERATOR
                self._stop()
            elif message.kind != "alive":
                self._asked.append(_Request(message.kind, message.head, self._stops))
                self._desk.wake()
        self._leaving = True
        self._stop_for("the panel, whose web server has ended")

    def _stop_for(self, whom: str) -> None:
        """Stop the machine, and record ``whom`` as the cause in place of the operator."""
        self._executor.stopped_by = whom
        self._stop()

    def _stop(self) -> None:
        self._stops += 1
        self._desk.ask(Cause.STOP)

    def _watch_server(self) -> None:
        silent_s = clock_s() - self._heard_s
        if silent_s > SILENT_S and self._executor.under_way:
            self._heard_s = clock_s()
            self._stop_for("the panel, whose web server was silent")
            self._say("said", text="the web server is silent: stopped", wrong=True)

    def _take_requests(self) -> None:
        while self._asked:
            request = self._asked.popleft()
            number = request.head.get("number", 0)
            if request.stops != self._stops:
                self._say("answer", number=number, ok=False, text="it was stopped before it began")
                continue
            age_s = clock_s() - float(request.head.get("at_s", clock_s()))
            if age_s > _OLD_S and request.what not in _SAFE:
                text = f"it was asked for {age_s:.0f} s ago: this computer slept"
                self._say("answer", number=number, ok=False, text=text)
                continue
            try:
                self._obey(request)
            except ThreadlineError as error:
                self._say("answer", number=number, ok=False, text=str(error))
            else:
                self._tell()  # the result is reported before the answer
                if request.what not in _LATER:
                    self._say("answer", number=number, ok=True, text="")

    def _obey(self, request: _Request) -> None:
        executor, head = self._executor, request.head
        what = request.what
        if what in _NO_START:
            self._runs.give_up(what)
        if what in _BY_DESK:
            self._refuse_impossible(_BY_DESK[what])
            self._desk.ask(_BY_DESK[what])
        elif what == "renew":
            self._moves.renew(clock_s())
            if executor.state is State.JOGGING or not self._moves.left:
                executor.renew()
        elif what == "let-go":
            self._moves.clear()
            executor.let_go()
        elif what == "jog":
            self._refuse_impossible(Cause.JOG)
            executor.jog(str(head["axis"]), float(head["velocity"]))
        elif what in _MOVES:
            self._refuse_impossible(Cause.JOG)
            moves = [(str(axis), int(to)) for axis, to in head["to"]]
            self._moves.begin(moves, request.stops, clock_s())
        elif what == "step":
            self._refuse_impossible(Cause.JOG)
            k = self._machine.axis_names.index(str(head["axis"]))
            to = int(executor.position_counts[k]) + int(head["by"])
            self._moves.begin([(str(head["axis"]), to)], request.stops, clock_s())
        elif what == "console":
            self._refuse_console()
            executor.type_line(str(head["line"]))
        elif what == "override-feed":
            executor.override(int(head["percent"]))
        elif what in _LATER:
            self._refuse_impossible(Cause.START)
            self._rest = None
            self._runs.prepare(head, request.stops, executor)
        elif what == "approach-rest":
            self._refuse_impossible(Cause.JOG)
            moves = self._ready_rest().moves(self._machine)
            self._moves.begin(moves, request.stops, clock_s())
        elif what == "start-rest":
            self._refuse_impossible(Cause.START)
            self._runs.set_out(self._ready_rest(), executor)
            self._rest = None
        elif what in _DRIVES:
            self._obey_drives(what)
        else:
            raise CommandError(f"{what[:40]!r} is no command", remedy="Use the panel's own page.")

    def _refuse_console(self) -> None:
        """Refuse a typed line while something else is about to move."""
        if self._moves.left:
            raise CommandError("the machine makes an earlier move", remedy="Wait.")
        if self._runs.busy:
            raise CommandError(f"the console waits: {self._runs.busy}", remedy="Wait.")

    def _obey_drives(self, what: str) -> None:
        """Switch or home the machine; moves that have not begun are dropped."""
        self._moves.clear()
        if what == "home":
            self._rest = None
        executor = self._executor
        {
            "enable": executor.enable,
            "disable": executor.disable,
            "home": executor.home,
            "reset": executor.reset,
        }[what]()

    def _ready_rest(self) -> Prepared:
        if self._rest is None:
            raise CommandError("no run was chosen to be continued", remedy="Choose it again.")
        return self._rest

    def _refuse_impossible(self, cause: Cause) -> None:
        if (self._executor.state, cause) not in TRANSITIONS:
            raise CommandError(
                f"{cause.value!r} is not possible while the machine is {self._executor.state.value}"
            )
        cause.refuse_after(self._executor.ended)
        if cause in (Cause.JOG, Cause.START) and self._moves.left:
            raise CommandError("the machine makes an earlier move", remedy="Wait.")
        if cause is Cause.START and self._runs.busy:
            raise CommandError(f"no run can begin now: {self._runs.busy}", remedy="Wait.")

    # --- continuous work -------------------------------------------------------------------

    def _go_on(self) -> None:
        """Begin a prepared run or the next move; end a run that is over."""
        executor = self._executor
        if self._rest is not None and (
            self._rest.stops != self._stops or executor.state not in {State.IDLE, State.JOGGING}
        ):
            self._rest = None
        if executor.under_way:
            return
        self._runs.end(executor)
        self._next_move()
        prepared = self._runs.prepared()
        if prepared is None:
            return
        if not isinstance(prepared, Prepared):
            number, why = prepared
            self._tell(at_once=True)  # the report clears ``busy``
            self._say("answer", number=number, ok=False, text=why)
            return
        ok, text = True, ""
        try:
            if prepared.stops != self._stops or self._leaving:
                raise CommandError("it was stopped before it began", remedy="Start it again.")
            if executor.under_way:
                raise CommandError("the machine moves", remedy="Wait until it stands.")
            if prepared.again is None:
                self._runs.set_out(prepared, executor)
            else:
                self._rest = prepared
                self._tell(at_once=True)
        except ThreadlineError as error:
            ok, text = False, str(error)
        self._say("answer", number=prepared.number, ok=ok, text=text)

    def _next_move(self) -> None:
        """Begin the next move of the sequence, if there is one and the machine is idle."""
        executor, now_s = self._executor, clock_s()
        if executor.state is not State.IDLE:
            self._moves.clear()
            return
        move = self._moves.next_one(self._stops, executor.ended, now_s)
        if move is None:
            return
        try:
            executor.move(*move, self._moves.lease_s(now_s))
        except CommandError as error:
            self._moves.clear()
            self._say("said", text=str(error), wrong=True)

    # --- reports ---------------------------------------------------------------------------

    def _tell(self, *, at_once: bool = False) -> None:
        """Report the machine's state to the server every ``TELL_S`` and at each change."""
        now_s, executor, machine = clock_s(), self._executor, self._machine
        if not at_once and now_s - self._sent_s < TELL_S and executor.state is self._sent_state:
            return
        self._sent_s, self._sent_state = now_s, executor.state
        channels = executor.channels
        self._say(
            "now",
            state=executor.state.value,
            why=self._runs.why,
            time_s=executor.time_s,
            axes=positions(
                channels,
                executor.latest,
                machine,
                executor.position_counts if executor.homed else None,
            ),
            signals=signals(channels, executor.latest),
            readings=readings(channels, executor.latest),
            late_ticks=executor.late_ticks,
            percent=executor.percent if executor.under_way else 100,
            no_override=executor.no_override,
            moving=executor.under_way or bool(self._moves.left),
            busy=self._runs.busy,
            lost=executor.lost,
            progress=self._runs.progress(executor),
            rest=None if self._rest is None else self._rest.rest_notes(),
            age_s=executor.age_s,
            board=self._board.fill(),
        )
        self._tell_board()

    def _tell_board(self) -> None:
        """Report the news of a controller's board since the last report."""
        for kind, head in self._board.news(clock_s()):
            self._say(kind, **head)

    def _say(self, kind: str, **head: Any) -> None:
        """Send the server a message; drop the message if the server does not read."""
        if self._server.lost or not select.select([], [self._server.fileno()], [], 0.0)[1]:
            return
        self._server.send(Message(kind, head))


class BoardReports:
    """Reports on a controller's settings and lines, each sent once.

    Parameters
    ----------
    executor
        The machine; without a board there are no reports.
    """

    def __init__(self, executor: Operated) -> None:
        self._executor = executor
        self._readings = 0
        self._waiting: list[Exchange] = []
        self._sent_s = 0.0

    def fill(self) -> dict[str, int] | None:
        """Return how full the controller is; None if it does not report it."""
        board = self._executor.board
        return None if board is None or board.fill is None else asdict(board.fill)

    def news(self, now_s: float) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield kind and content of each report that is due.

        The lines of a program come in batches: the latest ``_MOST_LINES_AT_ONCE`` of each batch.
        """
        board = self._executor.board
        if board is None:
            return
        if board.readings != self._readings and board.settings:
            self._readings = board.readings
            rows = [asdict(one) for one in board.settings]
            yield "board", {"firmware": board.identity, "settings": rows}
        self._waiting += board.take()
        program_only = all(one.kind == "program" for one in self._waiting)
        if not self._waiting or (program_only and now_s - self._sent_s < LINES_PERIOD_S):
            return
        left_out = max(len(self._waiting) - _MOST_LINES_AT_ONCE, 0) if program_only else 0
        lines = [asdict(one) for one in self._waiting[left_out:]]
        self._waiting, self._sent_s = [], now_s
        yield "console", {"lines": lines, "left_out": left_out}
