"""kill -9 of the web server, and of a browser's connection, at random moments of jogs and runs.

Server, owner and machine are forks of this process, so that ten of each take seconds.
"""

from __future__ import annotations

import json
import os
import random
import signal
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import uvicorn
from websockets.sync.client import ClientConnection, connect

from tests.live.bench import winder
from tests.live.test_killed import Watched
from tests.panel.bench import Operator, app_of, child, machine_thread, own_here, proven
from threadline.live.sim_kinds import SimRows
from threadline.live.wire import Connection
from threadline.machine import Machine

SPEED = 0.5
TIMES = 10


class Spoken:
    """A websocket of the library with the method names of the test client."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket = socket

    def send_text(self, text: str) -> None:
        self._socket.send(text)

    def receive_text(self) -> str:
        found = self._socket.recv(100.0)
        assert isinstance(found, str)
        return found


class Plant:
    """A machine, its owner and its web server, each a process."""

    def __init__(
        self, folder: Path, box: Path, speed: float = SPEED, machine: Machine | None = None, *,
        port: int = 0, token: str = "",
    ) -> None:  # fmt: skip
        self.box = box
        made = machine or winder()
        listening = socket.create_server(("127.0.0.1", port))
        self.port = listening.getsockname()[1]
        ours, theirs = socket.socketpair()
        link, far = socket.socketpair()
        ends = (listening, ours, theirs, link, far)

        def only(*counts: socket.socket) -> None:
            for end in ends:
                if end not in counts:
                    end.close()

        def machine_main() -> None:
            only(far)
            Watched.box = {"a": [], "x": [], "load": [], "heard": [0.0], "held": [0.0]}
            connection = Connection(far)
            watched = None
            if made.name == winder().name:
                watched = Watched(winder(), np.zeros(3, np.int64), connection.send)
            machine_thread(far, speed, made, watched)
            box.write_text(json.dumps(Watched.box), "utf-8")

        def owner_main() -> None:
            only(theirs, link)
            own_here(theirs, link, folder, speed, made)

        def be_server() -> None:
            only(listening, ours)
            app = app_of(folder, lambda: (None, Connection(ours)), token, machine=made)
            config = uvicorn.Config(app, log_level="critical", ws="websockets-sansio")
            uvicorn.Server(config).run(sockets=[listening])

        self.machine, self.owner = child(machine_main), child(owner_main)
        self.server = child(be_server)
        for end in ends:
            end.close()

    def connect(self) -> ClientConnection:
        address = f"127.0.0.1:{self.port}"
        return connect(
            f"ws://{address}/api/live", origin=f"http://{address}", max_size=None,
            open_timeout=30, close_timeout=1,
        )  # fmt: skip

    def end(self) -> dict[str, list[float]]:
        """Wait for owner and machine, which end by themselves; return what the machine did."""
        for pid in (self.owner, self.machine):
            assert os.waitpid(pid, 0)[1] == 0
        counts: dict[str, list[float]] = json.loads(self.box.read_text("utf-8"))
        assert counts["held"] == [0.0]
        return counts


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A proven program; the twin is compiled here, so that every fork has it."""
    folder = tmp_path_factory.mktemp("project")
    proven(folder)
    SimRows(winder(), np.zeros(3, np.int64), lambda _: None)
    return folder


def moments() -> list[float]:
    return [round(random.Random(1994 + k).uniform(0.05, 0.6), 3) for k in range(TIMES)]


def jog(anna: Operator) -> None:
    assert anna.act("jog", axis="X", share=1.0) == ""


def run(anna: Operator) -> None:
    anna.allows("calculate")  # the previous run may still be judged
    assert anna.act("calculate", program="there.prg") == ""
    proof = anna.until("state")["proven"]["proof"]
    assert anna.act("start", proof=proof) == ""


def moving(anna: Operator, begin: Callable[[Operator], None], until_s: float) -> float:
    """Begin, wait for a while, and return the last commanded X in mm."""
    begin(anna)
    end = time.monotonic() + until_s
    while time.monotonic() < end:
        anna.until("state")
        if anna.state["state"] == "jogging":
            anna.ask("renew")
    return anna.x_mm()


def at_clock(counts: dict[str, list[float]], clock_s: float) -> float:
    """Return the commanded X in mm at a time of the clock."""
    played = np.array(counts["played"])[np.array(counts["clock"]) <= clock_s]
    return 1e3 * counts["x"][int(played[-1]) - 1] if len(played) and played[-1] else 0.0


@pytest.mark.long(but=("jog-15.0-0.114", "jog-15.0-0.472", "run-9.0-0.114"))
@pytest.mark.parametrize("after_s", moments())
@pytest.mark.parametrize(("begin", "most_mm"), [(jog, 15.0), (run, 9.0)])
def test_kill_the_server(
    begin: Callable[[Operator], None], most_mm: float, after_s: float, project: Path, tmp_path: Path
) -> None:
    """The owner stops the machine at once along its path, and ends; the machine stands.

    From the server's death a stop takes a report, 25 ms, and its braking: 2.3 mm of a jog, 1 mm of
    a run. The rest of the limit allows for a busy computer, at least 0.35 s of its clock. If only
    the second of silence stopped it, the run would go 18 mm; if only the lease did, the jog would,
    too.
    """
    plant = Plant(project, tmp_path / "black-box")
    with plant.connect() as socket:
        anna = Operator(Spoken(socket)).ready()
        moving(anna, begin, after_s)
        killed_s = time.monotonic()
        os.kill(plant.server, signal.SIGKILL)
        os.waitpid(plant.server, 0)
        counts = plant.end()
    x_mm = 1e3 * np.array(counts["x"])
    assert abs(x_mm[-1] - at_clock(counts, killed_s)) <= most_mm
    assert np.abs(np.diff(x_mm[-20:])).max() <= 0.362 * 2  # it brakes: no step to rest


@pytest.fixture(scope="module")
def plant(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    found = Plant(project, tmp_path_factory.mktemp("box") / "black-box")
    yield found
    os.kill(found.server, signal.SIGKILL)
    os.waitpid(found.server, 0)
    found.end()


def in_control(anna: Operator) -> Operator:
    """Take control, of a machine that is idle then."""
    if anna.see("disabled", "idle")["state"] == "disabled":
        return anna.ready()
    return anna.take()


def cut(connection: ClientConnection) -> None:
    """End the connection without a closing message, as when a browser is killed."""
    connection.socket.shutdown(socket.SHUT_RDWR)


@pytest.mark.parametrize("after_s", moments())
def test_cut_the_connection_in_a_jog(after_s: float, plant: Plant) -> None:
    """The jog ends at once, not when its lease ends; another client takes control.

    A jog that this computer renewed too late has ended before, and is started again.
    """
    with plant.connect() as watching, plant.connect() as connection:
        ben = Operator(Spoken(watching), "Ben")
        anna = Operator(Spoken(connection))
        in_control(anna)
        for _ in range(20):
            begin_mm = moving(anna, jog, after_s)
            if anna.state["state"] == "jogging":
                break
        cut(connection)
        ben.take()
        ben.see("idle")
        assert abs(ben.x_mm() - begin_mm) <= 26.0
        assert ben.state["why"] == ""  # the client that is told that its lease has ended
        home(ben, "X")
        ben.say(type="control", word="release")
        ben.until("state")


def home(ben: Operator, *axes: str) -> None:
    """Move the axes back, and wait until they are there."""
    for axis in axes:
        end = time.monotonic() + 60.0
        while ben.until("state")["axes"][axis]["commanded"] or ben.state["state"] != "idle":
            assert time.monotonic() < end, ben.state
            # Refused while the previous run is judged, or if a busy computer sends it too late.
            if "zero-axis" in ben.state["allowed"]:
                ben.ask("zero-axis", axis=axis)
            else:
                ben.ask("renew")


@pytest.mark.parametrize("after_s", moments()[:3])
def test_a_run_goes_on_when_a_browser_is_gone(after_s: float, plant: Plant, project: Path) -> None:
    """Its connection is cut; another client without control watches the run and stops it."""
    with plant.connect() as watching, plant.connect() as connection:
        ben = Operator(Spoken(watching), "Ben")
        anna = in_control(Operator(Spoken(connection)))
        at_mm = moving(anna, run, after_s)
        cut(connection)
        while ben.until("state")["seq"] <= anna.state["seq"]:
            pass  # messages sent before
        while ben.x_mm() <= at_mm + 2.0:
            assert ben.until("state")["state"] == "running"
        ben.say(type="stop")
        ben.see("idle")
        assert ben.state["progress"]["ended"] == "stopped"
        ben.take()
        home(ben, "X", "A")
        ben.say(type="control", word="release")
        ben.until("state")


@pytest.mark.long(shown_by="test_kill_the_server")
def test_a_server_that_hangs_is_a_server_that_is_gone(project: Path, tmp_path: Path) -> None:
    """The server is paused, not killed: its connection stays, and no message comes."""
    plant = Plant(project, tmp_path / "black-box")
    with plant.connect() as socket:
        anna = Operator(Spoken(socket)).ready()
        at_mm = moving(anna, run, 0.2)
        os.kill(plant.server, signal.SIGSTOP)
        time.sleep(2.0)
        os.kill(plant.server, signal.SIGCONT)
        seen: dict[str, Any] = anna.see("idle")
        assert seen["progress"]["ended"] == "stopped"
        assert seen["progress"]["why"] == "stopped by the panel, whose web server was silent"
        assert anna.x_mm() - at_mm <= 36.2 * SPEED * (1.0 + 1.0) + 5.0
        os.kill(plant.server, signal.SIGKILL)
        os.waitpid(plant.server, 0)
        plant.end()
