"""The panel as its operators use it: one has control, the others watch, and all can stop."""

from __future__ import annotations

import io
import json
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from tests.live.bench import winder
from tests.panel.bench import (
    PROGRAM,
    Operator,
    machine_thread,
    operator,
    own_here,
    proven,
    served,
)
from threadline.live.states import Cause, Desk, State
from threadline.live.store.run_store import opened
from threadline.live.wire import Connection, Message
from threadline.panel import calculating, stored_runs
from threadline.panel.panel import end_words
from threadline.panel.protocol import CLIENT_MESSAGE
from threadline.panel.stored_runs import Owned, StoredRuns

SPEED = 2.0


@pytest.fixture
def project(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.getbasetemp() / "proven-project"
    folder.mkdir(exist_ok=True)
    proven(folder)
    yield folder
    (folder / "there.prg").write_text(PROGRAM, "utf-8")


def started(anna: Operator) -> Operator:
    """Calculate and start, from idle."""
    assert anna.act("calculate", program="there.prg") == ""
    proof = anna.until("state")["proven"]["proof"]
    assert anna.act("start", proof=proof) == ""
    anna.see("running")
    return anna


def stands(anna: Operator) -> float:
    """Wait until neither X nor the time of the run advances; return X in mm."""
    seen: list[tuple[float, float]] = []
    end = time.monotonic() + 60.0
    while len(seen) < 10 or seen[-1] != pytest.approx(seen[-10], abs=1e-9):
        assert time.monotonic() < end, "it does not stand"
        anna.until("state")
        seen.append((anna.x_mm(), float(anna.state["progress"]["time_s"])))
    return seen[-1][0]


def test_a_run_from_home_to_verdict(project: Path) -> None:
    with served(project, SPEED) as client, operator(client) as anna:
        started(anna.ready())
        anna.see("idle")
        while not (anna.hear()["type"] == "state" and anna.state["progress"]["verdict"]):
            pass
        progress = anna.state["progress"]
        assert (progress["ended"], progress["why"]) == ("completed", "")
        assert progress["verdict"].startswith("IN SPEC")
        assert progress["time_s"] >= progress["duration_s"] > 3.0
    store = opened(project / "runs")
    assert store is not None
    (record,) = [r for r in store.index.runs() if r.run == progress["run"]]
    assert (record.ended, record.passed, record.link) == ("completed", True, "sim")


def test_hold_resume_and_a_stop_by_who_only_watches(project: Path) -> None:
    with served(project, SPEED) as client, operator(client) as anna, operator(client, "Ben") as ben:
        started(anna.ready())
        while anna.x_mm() < 5.0:
            anna.until("state")
        assert anna.act("hold") == ""
        anna.see("holding")
        held = stands(anna)
        # The plan is at the shown time: braking took fewer rows than ticks.
        figures, progress = proven(project)[1], anna.state["progress"]
        meant = np.interp(progress["time_s"], figures["times_s"], figures["planned"]["X"])
        assert held == pytest.approx(1e3 * meant, abs=0.02)
        assert "resume" in anna.state["allowed"]
        assert anna.act("resume") == ""
        while anna.x_mm() < held + 3.0:
            anna.until("state")
        ben.say(type="stop")
        anna.see("idle")
        assert anna.state["progress"]["ended"] == "stopped"
        assert {"type": "said", "text": "stopped by Ben (2)", "wrong": False} in anna.heard
        # Nothing goes on by itself: only a new start from the begin of the run moves.
        for _ in range(10):
            assert anna.until("state")["state"] == "idle"
        proof = anna.state["proven"]["proof"]
        anna.allows("start")
        assert "the run begins at 0" in anna.act("start", proof=proof)


@pytest.mark.long(
    shown_by="tests/live/test_override.py::test_a_slower_run_takes_longer_and_tells_it_in_a_few_events"
)
def test_the_feed_is_overridden_by_who_has_control_within_what_was_proven(project: Path) -> None:
    with served(project, SPEED) as client, operator(client) as anna, operator(client, "Ben") as ben:
        anna.ready()
        assert "override-feed" not in anna.state["allowed"]
        assert "not possible now: the machine is idle" in anna.act("override-feed", percent=50)
        started(anna)
        anna.allows("override-feed")
        assert "not in control" in ben.act("override-feed", percent=50)
        assert anna.state["feed_percent"] == 100
        assert anna.act("override-feed", percent=50) == ""
        anna.wait(lambda state: state["feed_percent"] == 50)
        assert anna.state["why"] == ""  # the page shows the override by itself
        while anna.state["state"] == "running" and anna.state["progress"]["time_s"] < 2.0:
            anna.until("state")
            anna.say(type="alive", lease=anna.lease)
        done, at = anna.state["progress"]["time_s"], anna.state["time_s"]
        assert done < at  # by the time of the plan, and by the clock
        anna.see("idle")
        while not anna.until("state")["progress"]["verdict"]:
            pass
        assert anna.state["progress"]["verdict"].startswith("IN SPEC")


@pytest.mark.parametrize("percent", [9, 101, 50.5, "50"])
def test_a_message_beyond_what_was_proven_is_none(percent: object) -> None:
    command = {"what": "override-feed", "percent": percent}
    act = {"type": "act", "lease": "x", "seen": 1, "number": 1, "command": command}
    with pytest.raises(ValidationError):
        CLIENT_MESSAGE.validate_json(json.dumps(act))


def test_client_without_control_moves_nothing(project: Path) -> None:
    with served(project, SPEED) as client, operator(client) as anna, operator(client, "Ben") as ben:
        anna.ready()
        for lease in ("", anna.lease[:-1], "x" * 22, anna.lease):
            ben.lease = lease
            assert "you are not in control" in ben.act("jog", axis="X", share=1.0)
        assert ben.until("state")["state"] == "idle"
        ben.say(type="control", word="take")
        while ben.until("state")["control"]["asks"] != ben.number:
            pass
        anna.say(type="control", word="give")
        ben.until("leased")
        assert "you are not in control" in anna.act("jog", axis="X", share=1.0)
        assert ben.act("jog", axis="X", share=0.5) == ""


def test_only_a_fresh_state_is_acted_on(project: Path) -> None:
    with served(project, SPEED) as client, operator(client) as anna:
        anna.ready()
        anna.until("state")
        seen = anna.state["seq"]
        end = time.monotonic() + 0.6
        while time.monotonic() < end:
            anna.hear()
        anna.state["seq"] = seen
        anna.ask("jog", axis="X", share=1.0)
        assert "older than 0.5 s" in anna.until("answer")["text"]
        anna.state["seq"] = 10**9  # a state that was never sent
        anna.ask("jog", axis="X", share=1.0)
        assert "older than 0.5 s" in anna.until("answer")["text"]
        anna._number = 0  # a command that comes twice
        anna.ask("jog", axis="X", share=1.0)
        assert "came before" in anna.until("answer")["text"]
        assert anna.until("state")["state"] == "idle"


def test_a_jog_ends_where_nobody_renews_it(project: Path) -> None:
    """250 ms at the manual feed, and braking: 20.4 mm of command."""
    with served(project, 2.0) as client, operator(client) as anna:
        anna.ready()
        assert anna.act("jog", axis="X", share=1.0) == ""
        anna.see("idle")
        assert 15.0 < anna.x_mm() <= 20.4
        assert "nobody has renewed its lease" in anna.state["why"]
        assert "there is no jog" in anna.act("renew")


def test_a_connection_that_ends_lets_go(project: Path) -> None:
    """At a fifth of real time Ben's jog would have a lease of more than a second."""
    with served(project, 0.2) as client, operator(client) as anna:
        with operator(client, "Ben") as ben:
            ben.ready()
            assert ben.act("jog", axis="X", share=1.0) == ""
            began = ben.until("state")["axes"]["X"]["commanded"]
        anna.catch_up(client).see("idle")
        # It was let go, not run out: X is well under the 18 mm of a lease beyond the last seen
        # place.
        assert anna.x_mm() - 1e3 * began <= 12.0
        assert anna.until("state")["control"]["client"] is None


def test_moves_to_zero_need_somebody_to_the_end(project: Path) -> None:
    with served(project, SPEED) as client, operator(client) as anna:
        anna.ready()
        for axis in ("X", "Y"):
            assert anna.act("jog", axis=axis, share=1.0) == ""
            anna.see("idle")
        assert anna.x_mm() > 15.0
        end = time.monotonic() + 60.0
        while time.monotonic() < end:
            anna.until("state")
            at = [abs(w["commanded"]) for w in anna.state["axes"].values()]
            if anna.state["state"] == "idle" and max(at) < 1e-9:
                break
            # A move that a busy computer renewed too late has ended, and is sent again.
            anna.ask("zero" if "zero" in anna.state["allowed"] else "renew")
        assert max(at) < 1e-9
        # Without renewals the first axis ends by its lease, and no other axis begins.
        for axis in ("X", "X", "Y"):
            assert anna.act("jog", axis=axis, share=1.0) == ""
            anna.see("idle")
        x, y = (anna.state["axes"][axis]["commanded"] for axis in "XY")
        while anna.until("state")["axes"]["X"]["commanded"] == x:
            if "zero" in anna.state["allowed"]:  # until the first axis moves
                anna.ask("zero")
        anna.see("idle")
        for _ in range(20):
            assert anna.until("state")["state"] == "idle"
        assert 0.0 < anna.state["axes"]["X"]["commanded"] < x
        assert anna.state["axes"]["Y"]["commanded"] == y


def test_steps_are_as_long_as_asked_and_need_somebody_to_the_end(project: Path) -> None:
    """A step of 1 mm ends within the lease; a step of 50 mm goes only as far as the lease."""
    with served(project, SPEED) as client, operator(client) as anna:
        anna.ready()
        for by, at_mm in ((1e-3, 1.0), (-1e-3, 0.0)):
            before = anna.x_mm()
            assert anna.act("step", axis="X", by=by) == ""
            moved(anna, before)
            assert anna.x_mm() == pytest.approx(at_mm, abs=0.5 / 55.358)  # one count
            # The machine is idle once the loop has settled, at any speed of the simulation.
            assert 1e3 * anna.state["axes"]["X"]["measured"] == pytest.approx(at_mm, abs=0.03)
        assert anna.act("step", axis="X", by=0.05) == ""
        moved(anna, anna.x_mm())
        assert 5.0 < anna.x_mm() < 26.0
        assert "beyond its travel" in why_of(anna, by=0.9)
        anna.allows("step")  # what was refused is put aside
        assert "there is no axis" in anna.act("step", axis="Q", by=1e-3)


def moved(anna: Operator, from_mm: float) -> None:
    """Wait until X stands elsewhere, because a step is answered before it begins."""
    end = time.monotonic() + 60.0
    while anna.until("state")["state"] != "idle" or anna.x_mm() == from_mm:
        assert time.monotonic() < end, anna.state


def why_of(anna: Operator, by: float) -> str:
    """Send an impossible step, and return the refusal."""
    assert anna.act("step", axis="X", by=by) == ""
    return str(anna.until("said")["text"])


def test_a_program_that_was_changed_since_is_not_run(project: Path) -> None:
    with served(project, SPEED) as client, operator(client) as anna:
        anna.ready()
        assert anna.act("calculate", program="there.prg") == ""
        proof = anna.until("state")["proven"]["proof"]
        assert "not the program that was proven last" in anna.act("start", proof="0" * 64)
        (project / "there.prg").write_text(PROGRAM.replace("X 60", "X 61"), "utf-8")
        assert "the proof does not match the run: job" in anna.act("start", proof=proof)
        assert anna.until("state")["state"] == "idle"


def test_a_silent_server_is_one_that_could_not_stop_it(project: Path) -> None:
    """A jog at a fifth of real time has a lease of 1.25 s; the server is silent after 1 s."""
    (server, theirs), (link, far) = socket.socketpair(), socket.socketpair()
    threads = [
        threading.Thread(target=machine_thread, args=(far, 0.2, winder())),
        threading.Thread(target=own_here, args=(theirs, link, project, 0.2, winder())),
    ]
    for thread in threads:
        thread.start()
    to, text, states = Connection(server), [""], [""]
    for number, (what, words) in enumerate(
        (("enable", {}), ("home", {}), ("jog", {"axis": "X", "velocity": 0.01}))
    ):
        to.send(Message(what, {"number": number, **words}))
    while not text[-1] and states[-2:] != ["jogging", "idle"]:
        message = to.receive(60.0)
        assert message is not None
        if message.kind == "said":
            text.append(message.head["text"])
        elif message.kind == "now" and message.head["state"] != states[-1]:
            states.append(message.head["state"])
    to.close()
    for thread in threads:
        thread.join(20.0)
    assert text[-1] == "the web server is silent: stopped"


def test_a_stop_does_not_take_the_reason_of_a_fault_away(tmp_path: Path) -> None:
    owned = Owned(winder(), None, tmp_path, tmp_path / "runs", 1.0)
    runs = StoredRuns(owned, "", lambda *_: None)
    runs.state(3, State.FAULT, Cause.FAULT, "a tick came 6 periods late")
    runs.state(9, State.FAULT, Cause.STOP, "")
    assert runs.why == "a tick came 6 periods late"
    runs.state(9, State.DISABLED, Cause.RESET, "")
    assert runs.why == ""


def test_a_stop_before_it_begins_ends_a_start(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stop during the check of a start is not lost, and nothing moves afterwards."""
    heard, check, ask = threading.Event(), stored_runs.check_halts, Desk.ask

    def checked(*given: Any, **named: Any) -> None:
        assert heard.wait(60.0)
        check(*given, **named)

    def asked(desk: Desk, cause: Cause) -> None:
        ask(desk, cause)
        if cause is Cause.STOP:
            heard.set()

    monkeypatch.setattr(stored_runs, "check_halts", checked)
    monkeypatch.setattr(Desk, "ask", asked)
    with served(project, SPEED) as client, operator(client) as anna:
        anna.ready()
        assert anna.act("calculate", program="there.prg") == ""
        proof = anna.until("state")["proven"]["proof"]
        anna.until("state")
        anna.ask("start", proof=proof)
        anna.say(type="stop")
        assert "stopped before it began" in anna.until("answer")["text"]
        for _ in range(20):
            assert anna.until("state")["state"] == "idle"


def test_a_stop_by_request(project: Path) -> None:
    with served(project, SPEED) as client, operator(client) as anna:
        started(anna.ready())
        assert client.post("/api/stop").status_code == 204
        anna.see("idle")
        assert anna.state["progress"]["ended"] == "stopped"


def test_a_stop_by_two_ways_is_told_once(project: Path) -> None:
    """Whichever comes first is reported; both stop, and the next stop is reported again."""
    with served(project, SPEED) as client, operator(client) as anna, operator(client, "Ben") as ben:
        anna.see("disabled")
        sent = {"x-stop": f"{ben.number}/1"}
        assert client.post("/api/stop", headers=sent).status_code == 204
        ben.say(type="stop", number=1)
        ben.say(type="stop", number=2)
        client.post("/api/stop", headers={"x-stop": "nobody"})
        while len(messages := [one["text"] for one in anna.heard if one["type"] == "said"]) < 3:
            anna.hear()
        assert messages == [f"stopped by Ben ({ben.number})"] * 2 + ["stopped by a request"]


@pytest.mark.parametrize("state, why, progress", [
    ("fault", "axis X: 3 mm off", "the machine stands, in a fault: axis X: 3 mm off"),
    ("idle", "", "the machine was stopped, and is idle"),
])  # fmt: skip
def test_a_panel_that_ends_tells_how_the_machine_is(state: str, why: str, progress: str) -> None:
    assert end_words({"state": state, "why": why}) == progress


def test_uploads_undo_what_was_proven(project: Path) -> None:
    with served(project, SPEED) as client, operator(client) as anna:
        anna.ready()
        assert anna.act("calculate", program="there.prg") == ""
        assert "start" in anna.until("state")["allowed"]
        headers = {"origin": "http://127.0.0.1", "x-lease": anna.lease}
        sent = client.put("/api/programs/new.prg", content=PROGRAM.encode(), headers=headers)
        assert sent.status_code == 204
        anna.until("state")
        assert "start" not in anna.until("state")["allowed"]


def test_a_calculation_in_a_process_of_its_own(project: Path) -> None:
    """The panel writes the request and reads the answer as usual."""
    words, found = proven(project)
    request = {
        **words,
        "folder": str(project),
        "machine": "lathe-winder",
        "par": None,
        "spec": None,
    }
    done = subprocess.run(
        [sys.executable, "-c", "from threadline.panel.calculating import main; main()"],
        input=json.dumps(request), capture_output=True, text=True, check=True, timeout=300,
    )  # fmt: skip
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert lines[-1]["figures"] == found
    assert lines[-1]["figures"]["points"] == 2


def test_a_calculation_that_cannot_be_made_says_why(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words, _ = proven(project)
    request = {
        **words,
        "folder": str(project),
        "machine": "lathe-winder",
        "par": None,
        "spec": None,
    }
    asked = io.StringIO(json.dumps({**request, "program": "none.prg"}))
    monkeypatch.setattr(sys, "stdin", asked)
    monkeypatch.setattr(os, "nice", lambda _: 0)  # this process goes on with other tests
    calculating.main()
    assert "cannot read job file" in json.loads(capsys.readouterr().out.splitlines()[-1])["error"]
