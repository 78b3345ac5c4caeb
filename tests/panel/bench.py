"""A panel for tests, with an operator; its owner and machine are threads or forks of the test."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from starlette.testclient import TestClient, WebSocketTestSession
from starlette.types import ASGIApp

from tests.live.bench import winder
from threadline.errors import ThreadlineError
from threadline.live.links import RowsOperated, at_link
from threadline.live.sim_machine import SimMachine
from threadline.live.sim_process import group_ticks, in_step
from threadline.live.sim_process import simulated_of as simulated_type
from threadline.live.states import Desk
from threadline.live.wire import Connection, Message
from threadline.machine import Machine
from threadline.panel.admission import Admission
from threadline.panel.calculating import calculate
from threadline.panel.calculation import Calculation, MachineGuide
from threadline.panel.job_views import preview
from threadline.panel.owner import Owner
from threadline.panel.owner_process import OwnerLink, serve_owned
from threadline.panel.panel import Panel
from threadline.panel.protocol import Calculate
from threadline.panel.server import make_app
from threadline.panel.stored_runs import Owned, StoredRuns

PROGRAM = "%\nO 1;\nG91;\nG01 F 2000;\nN 10 A 20 X 60;\nN 20 A 20 X -60;\nM30;\n%\n"
"""There and back on X, 1.7 s each way at the normal feed."""
GCODE = "G21\nG90\nG1 X20 A40 F3000\nX60 A60\nX0 A80\nM30\n"
LOCAL = {"origin": "http://127.0.0.1"}


EXAMPLES = Path(__file__).parents[2] / "examples"
CASES = {
    "lathe-winder": Calculate(
        what="calculate", program="there.prg", interpolation="linear", level="nominal"
    ),
    "letter-placer": Calculate(
        what="calculate", program="letter-cycle.toml", shaper="um-zv", level="nominal"
    ),
    "stitcher": Calculate(
        what="calculate", program="strap.seam.toml", feed_forward=True, level="nominal"
    ),
    "stepper-winder": Calculate(what="calculate", program="there.gcode", level="nominal"),
    "schiffli-frame": Calculate(what="calculate", program="rosette.dst", level="nominal"),
}
"""What is calculated in the tests of each machine."""


@cache
def proven(folder: Path, machine: str = "lathe-winder") -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the words and the figures of a program; the proof is made once for all tests."""
    asked = CASES[machine]
    if asked.program.startswith("there."):
        text = PROGRAM if asked.program.endswith(".prg") else GCODE
        (folder / asked.program).write_text(text, "utf-8")
    elif not (folder / asked.program).exists():
        shutil.copy(EXAMPLES / asked.program, folder)
    if asked.program == "strap.seam.toml":
        shutil.copy(EXAMPLES / "strap.csv", folder)
        seam = (folder / asked.program).read_text("utf-8")
        slower = seam.replace("40 stitch/s", "30 stitch/s")  # the motors keep their speed limit
        assert slower != seam
        (folder / asked.program).write_text(slower, "utf-8")
    request = {**asked.model_dump(exclude={"what"}), "proof_file": str(folder / "proof.json")}
    return request, calculate(
        {**request, "folder": str(folder), "machine": machine, "par": None, "spec": None}
    )


class Known(Calculation):
    """A calculation that returns the figures found before."""

    def begin(self, asked: Calculate, tell: Any) -> None:
        words, found = proven(self._folder, self._machine.name)
        tell(self._taken(dict(found), words))

    async def preview(self, program: str) -> bytes | str:
        """Prepare as usual, but in this process, which has everything loaded."""
        try:
            return json.dumps(preview(self._folder, program, self._machine)).encode()
        except ThreadlineError as error:
            return str(error)


class KnownGuide(MachineGuide):
    """A guide that a separate process makes once for all tests."""

    made: ClassVar[dict[str, MachineGuide]] = {}

    async def tables(self) -> dict[str, Any] | str:
        known = self.made.setdefault(self._reference, self)
        if known is not self and known._found is not None:
            self._folder, self._found = known._folder, known._found
        return await super().tables()


def simulated_of(machine: Machine, tell: Callable[[Message], None]) -> SimMachine:
    return simulated_type(machine)(machine, np.zeros(len(machine.axes), np.int64), tell)


def machine_thread(
    end: socket.socket, speed: float, machine: Machine, made: SimMachine | None = None
) -> None:
    connection = Connection(end)
    simulated = made or simulated_of(machine, connection.send)
    simulated.greet()
    period_s = float(machine.command_clock.period_s)
    in_step(connection, simulated, group_ticks(machine, speed), period_s / speed)
    while not simulated.standing:
        simulated.play(5)
    connection.close()


def own_here(
    server: socket.socket, link: socket.socket, folder: Path, speed: float, machine: Machine
) -> None:
    to = Connection(server)
    runs = StoredRuns(Owned(machine, None, folder, folder / "runs", speed), "", lambda *_: None)
    far, desk = Connection(link), Desk()
    Owner(to, RowsOperated(far, machine, desk, runs, speed=speed), machine, desk, runs).serve()
    for end in (far, desk, to):
        end.close()


def own_at(server: socket.socket, link: str, folder: Path, machine: Machine) -> None:
    """Own a machine whose link does not lead to a simulated one."""
    to = Connection(server)
    serve_owned(to, Owned(machine, None, folder, folder / "runs", 1.0, link))
    to.close()


class InThreads:
    """Starts owners with their machines in threads."""

    def __init__(self, folder: Path, speed: float, machine: Machine, link: str = "sim") -> None:
        self._folder, self._speed, self._machine, self._link = folder, speed, machine, link
        self._threads: list[threading.Thread] = []

    def __call__(self) -> tuple[None, Connection]:
        ours, theirs = socket.socketpair()
        if self._link != "sim":
            self._begin(own_at, theirs, self._link, self._folder, self._machine)
            return None, Connection(ours)
        link, far = socket.socketpair()
        self._begin(machine_thread, far, self._speed, self._machine)
        self._begin(own_here, theirs, link, self._folder, self._speed, self._machine)
        return None, Connection(ours)

    def _begin(self, work: Any, *given: Any) -> None:
        thread = threading.Thread(target=work, args=given, daemon=True)
        self._threads.append(thread)
        thread.start()

    def join(self) -> None:
        for thread in self._threads:
            thread.join(60.0)  # a judge that was begun ends first, on a busy computer late
            assert not thread.is_alive()


def app_of(
    folder: Path,
    start: Callable[[], tuple[subprocess.Popen[bytes] | None, Connection]],
    token: str = "",
    machine: Machine | None = None,
    link: str = "sim",
) -> ASGIApp:
    machine = machine or winder()
    calculation = Known(machine, None, folder, folder)
    far_end = at_link(link, machine, 1.0)
    panel = Panel(machine, OwnerLink(start), calculation, link, far_end)
    guide = KnownGuide(machine, folder.with_name(f"{folder.name}-guide"))
    return make_app(panel, guide, folder, folder / "runs", Admission("127.0.0.1", token))


@contextmanager
def served(
    folder: Path,
    speed: float = 4.0,
    token: str = "",
    machine: Machine | None = None,
    link: str = "sim",
) -> Iterator[TestClient]:
    owners = InThreads(folder, speed, machine or winder(), link)
    app = app_of(folder, owners, token, machine, link)
    with TestClient(app, base_url="http://127.0.0.1", headers=LOCAL) as client:
        yield client
    owners.join()


class Operator:
    """A client at a websocket, with the two methods that a panel uses."""

    def __init__(self, socket: Any, name: str = "Anna", token: str = "") -> None:
        self.socket, self.heard = socket, list[dict[str, Any]]()
        self.state: dict[str, Any] = {}
        self.lease, self._number = "", 0
        self.say(type="hello", protocol=1, name=name, token=token)
        self.number = self.until("welcome")["client"]

    def say(self, **message: Any) -> None:
        self.socket.send_text(json.dumps(message))

    def hear(self) -> dict[str, Any]:
        message: dict[str, Any] = json.loads(self.socket.receive_text())
        if message["type"] == "state":
            self.state = message
        elif message["type"] == "leased":
            self.lease = message["lease"]
        self.heard.append(message)
        return message

    def until(self, kind: str) -> dict[str, Any]:
        while (message := self.hear())["type"] != kind:
            pass
        return message

    def see(self, *states: str) -> dict[str, Any]:
        """Wait for a state; a jog is not renewed meanwhile."""
        end = time.monotonic() + 60.0
        while self.hear()["type"] != "state" or self.state["state"] not in states:
            assert time.monotonic() < end, str(self.state)  # the whole text is compared
            assert self.state.get("state") not in {"fault", "gone"}, str(self.state)
        return self.state

    def wait(self, until: Callable[[dict[str, Any]], bool]) -> None:
        """Wait until a state meets a condition, and keep control meanwhile."""
        while self.until("state") and not until(self.state):
            self.say(type="alive", lease=self.lease)

    def catch_up(self, client: TestClient) -> Operator:
        """Read the waiting messages, up to a state that is sent after this call."""
        seq = client.get("/api/state").json()["seq"]
        while self.until("state")["seq"] <= seq:
            pass
        return self

    def take(self) -> Operator:
        self.say(type="control", word="take")
        self.until("leased")
        return self

    def ask(self, what: str, **words: Any) -> int:
        self._number += 1
        command = {"what": what, **words}
        seen = self.state.get("seq", 0)
        self.say(type="act", lease=self.lease, seen=seen, number=self._number, command=command)
        return self._number

    def act(self, what: str, **words: Any) -> str:
        """Give a command on a fresh state; return why it is refused, or nothing.

        If a busy computer makes the state too old before the command arrives, look again.
        """
        for _ in range(20):
            self.until("state")
            number = self.ask(what, **words)
            while (message := self.until("answer"))["number"] != number:
                pass
            if "Look again." not in message["text"]:
                break
        return "" if message["ok"] else message["text"]

    def ready(self) -> Operator:
        self.take().see("disabled")
        for what in ("enable", "home"):
            self.take()  # on a busy computer LinuxCNC may take longer than the lease to start
            why = self.act(what)
            assert not why, why
        self.see("idle")
        return self

    def allows(self, what: str) -> dict[str, Any]:
        """Wait until a command is possible, and keep control meanwhile; return the state."""
        while what not in self.until("state")["allowed"]:
            self.say(type="alive", lease=self.lease)
        return self.state

    def x_mm(self) -> float:
        return float(self.state["axes"]["X"]["commanded"]) * 1e3


@contextmanager
def operator(client: TestClient, name: str = "Anna", token: str = "") -> Iterator[Operator]:
    session: WebSocketTestSession
    with client.websocket_connect("ws://127.0.0.1/api/live") as session:
        yield Operator(session, name, token)


def child(work: Callable[[], None]) -> int:
    """Fork; run the function in the child, and end the child."""
    pid = os.fork()
    if pid:
        return pid
    with suppress(BaseException):
        work()
        os._exit(0)
    os._exit(1)
