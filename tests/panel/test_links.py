"""The panel at a controller with grbl, and at LinuxCNC's HAL."""

from __future__ import annotations

import os
import random
import re
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import pytest

from tests.live.bench import winder
from tests.live.grbl_model import GrblModel
from tests.live.hal_bench import awake, hal_alone, unhurried
from tests.live.kill_bench import child
from tests.live.memory_sink import MemorySink
from tests.live.test_grbl import settings
from tests.panel.bench import Operator, operator, proven, served
from threadline.live import grbl_run
from threadline.live.grbl_controller import AHEAD_S, Controller
from threadline.live.grbl_operated import GrblOperated
from threadline.live.links import at_link
from threadline.live.port import Port
from threadline.live.states import Desk, State
from threadline.live.store.run_store import opened
from threadline.machine import load_machine

STEPPER = load_machine("stepper-winder")
RUN_ON_GRBL = "tests/live/test_grbl.py::test_a_hold_stands_on_the_path_and_goes_on_from_there"
PATIENCE_S = 60.0  # on a busy computer
MANUAL_MM_S = 40.0
"""A tenth of the limit of X, for the machine has no manual feed of its own."""


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give a model without processor time more time: on a busy computer the link is not lost."""
    monkeypatch.setattr(grbl_run, "SILENCE_S", 3.0)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("project")
    proven(folder, "stepper-winder")
    return folder


@contextmanager
def grbl(project: Path, model: GrblModel, *, ready: bool = True) -> Iterator[Operator]:
    model.start()
    link = f"grbl:{model.address}"
    try:
        with served(project, machine=STEPPER, link=link) as client, operator(client) as anna:
            if ready:
                anna.ready()
            yield anna
    finally:
        model.close()


def wait(anna: Operator, until: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not until():
        assert time.monotonic() < end, str(anna.state)
        if anna.hear()["type"] == "state" and anna.lease:
            anna.say(type="alive", lease=anna.lease)


def started(anna: Operator) -> None:
    assert anna.act("calculate", program="there.gcode") == ""
    proof = anna.until("state")["proven"]["proof"]
    assert anna.act("start", proof=proof, override=None) == ""
    # On a busy computer the check of a start may outlast the lease of control, which nobody renews.
    anna.take().wait(lambda state: state["state"] == "running")


def moved_by(anna: Operator, there: Callable[[], bool], what: str, **words: str) -> None:
    """Send a move until it arrives: again if a busy computer has renewed it too late."""
    end = time.monotonic() + 60.0
    while anna.until("state")["state"] != "idle" or not there():
        assert time.monotonic() < end, anna.state
        if what in anna.state["allowed"] and not there():
            anna.ask(what, **words)
        else:
            anna.ask("renew")


@pytest.mark.long(shown_by=RUN_ON_GRBL)
def test_a_program_is_run_on_grbl_twice_with_a_hold(project: Path) -> None:
    """The hold takes effect at once; the kept run shows the sent lines, and proves no more."""
    model = GrblModel(settings(), faster=0.5)
    with grbl(project, model) as anna:
        welcome = next(one for one in anna.heard if one["type"] == "welcome")
        assert not welcome["simulated"]
        assert welcome["link"].startswith("grbl:")
        assert set(welcome["lacks"]) == {"disable"}
        for _ in range(2):
            started(anna)
            wait(anna, lambda: anna.x_mm() > 5.0)
            assert anna.act("hold") == ""
            anna.see("holding")
            wait(anna, lambda: model.state == "Hold")
            held = model.at.copy()
            time.sleep(0.3)
            assert (model.at == held).all()
            assert anna.act("resume") == ""
            wait(anna, lambda: bool((anna.state["progress"] or {}).get("verdict")))
            progress = anna.state["progress"]
            assert (progress["ended"], progress["why"]) == ("completed", "")
            assert progress["time_s"] == pytest.approx(progress["duration_s"])
            assert progress["verdict"].startswith("NOT PROVEN")
            assert anna.x_mm() == pytest.approx(0.0, abs=0.02)
            moved_by(
                anna, lambda: model.at == pytest.approx([0.0] * 4, abs=2e-3), "zero-axis", axis="A"
            )
    store = opened(project / "runs")
    assert store is not None
    assert {record.link for record in store.index.runs()} == {welcome["link"]}
    assert list((project / "runs").glob("*/sent/program.nc"))


@pytest.mark.long(shown_by=RUN_ON_GRBL)
def test_a_run_on_grbl_is_stopped_and_its_rest_done(project: Path) -> None:
    """After homing and a confirmation, the rest begins with the line that was interrupted."""
    model = GrblModel(settings(), faster=0.5)
    with grbl(project, model) as anna:
        started(anna)
        wait(anna, lambda: anna.x_mm() > 30.0)  # on the second line, from 20 to 60 mm
        anna.say(type="stop")
        anna.see("idle")
        wait(anna, lambda: model.state == "Idle" and not model.blocks)
        at = model.at.copy()
        time.sleep(0.3)
        assert (model.at == at).all()
        assert anna.state["progress"]["ended"] == "stopped"
        wait(anna, lambda: bool(anna.state["progress"]["verdict"]))
        run, proof = anna.state["progress"]["run"], anna.state["proven"]["proof"]
        sent = len(model.heard)
        assert anna.act("continue", run=run, proof=proof) == ""
        wait(anna, lambda: anna.state["rest"] is not None)
        assert "the work begins again at line 4 of the job" in anna.state["rest"]["notes"][0]
        assert "the run begins at" in anna.act("start-rest")  # the machine stands elsewhere
        begins = [float(at) for at in re.findall(r"to (-?[0-9.]+)", anna.state["rest"]["notes"][0])]
        assert begins == pytest.approx([40.0, 20.0], abs=0.5)  # where the second line begins
        there = pytest.approx(begins, abs=0.01)
        moved_by(anna, lambda: model.at[[3, 0]] == there, "approach-rest")
        assert b"G1" not in bytes(model.heard)[sent:].replace(b"$J=G21G90G53", b"")
        assert anna.act("start-rest") == ""
        wait(anna, lambda: (anna.state["progress"] or {}).get("run") != run)
        wait(anna, lambda: bool((anna.state["progress"] or {}).get("verdict")))
        progress = anna.state["progress"]
        assert (progress["ended"], progress["why"]) == ("completed", "")
        assert progress["time_s"] == pytest.approx(progress["duration_s"])
        assert progress["verdict"].endswith(
            f"Judged as one with what {run} did before the work began again"
        )
        assert model.at[[3, 0]] == pytest.approx([80.0, 0.0], abs=0.02)


def test_a_jog_on_grbl_ends_where_nobody_renews_it(project: Path) -> None:
    """So little is sent ahead that the machine soon comes to rest by itself."""
    model = GrblModel(settings())
    with grbl(project, model) as anna:
        for _ in range(20):  # a busy computer may cancel it before the model gets a processor
            there = model.at[0]
            assert anna.act("jog", axis="X", share=1.0) == ""
            anna.see("idle")
            assert "nobody has renewed its lease" in anna.state["why"]
            # 250 ms of lease, then a report on its way, and the steps of the model.
            assert model.at[0] - there <= MANUAL_MM_S * (0.25 + 0.35)
            assert b"\x85" in model.heard
            assert model.ahead_s <= AHEAD_S + 1e-6
            if model.at[0] - there > 2.0:
                break
        else:
            pytest.fail("20 jogs did not move it")
        for _ in range(20):  # a jog that was renewed too late has ended by itself
            there = model.at[0]
            assert anna.act("jog", axis="X", share=0.5) == ""
            for _ in range(8):
                anna.ask("renew")
                anna.until("state")
            anna.act("let-go")
            anna.see("idle")
            if anna.state["why"] == "":
                break
        assert anna.state["why"] == ""
        assert model.at[0] > there


def test_a_step_on_grbl_is_as_long_as_asked_and_stays_in_the_travel(project: Path) -> None:
    model = GrblModel(settings())
    with grbl(project, model) as anna:
        assert anna.act("step", axis="X", by=1e-3) == ""
        wait(anna, lambda: anna.state["state"] == "idle" and abs(anna.x_mm() - 1.0) < 0.02)
        assert model.at[0] == pytest.approx(1.0, abs=0.5 / 80.0)  # a count
        assert anna.act("step", axis="X", by=0.9) == ""
        assert "beyond its travel" in anna.until("said")["text"]
        assert "not possible now" in anna.act("disable")


def test_a_link_that_is_lost_in_a_jog_leaves_a_controller_that_stands(project: Path) -> None:
    """The controller executes its buffer, which ends at rest, and nobody sends more."""
    model = GrblModel(settings())
    with grbl(project, model) as anna:
        assert anna.act("jog", axis="X", share=1.0) == ""
        anna.until("state")
        assert model.client is not None
        model.stuck = True  # no more report comes
        wait(anna, lambda: anna.state["state"] in {"fault", "idle"})
        wait(anna, lambda: not (model.blocks or model.rx))  # the motion in the buffer
        time.sleep(0.05)  # the step under way
        at = model.at[0]
        time.sleep(0.3)
        assert model.at[0] == at
        assert at <= MANUAL_MM_S * (0.25 + 0.35)


def jog_on(address: str, moves: int) -> None:
    """Jog X and renew it, as the panel's process does for a held key; report when X moves."""
    desk = Desk()
    one = GrblOperated(Controller(Port(address), STEPPER), desk, MemorySink())
    one.connect()
    one.enable()
    one.home()
    one.jog("X", MANUAL_MM_S / 1e3)
    is_sent = False
    while True:
        if one.state is State.JOGGING:
            one.renew()
        one.step()
        if not is_sent and one.latest["X.commanded"] > 0.0:
            is_sent = bool(os.write(moves, b"!"))


def test_kill_the_process_that_jogs_on_grbl() -> None:
    """At 10 random moments: the controller executes only the motion in its buffer, and stands."""
    chance = random.Random(1989)
    for _ in range(10):
        model, (there, here) = GrblModel(settings()), os.pipe()
        model.start()
        pid = child(partial(jog_on, model.address, here))
        os.close(here)
        assert os.read(there, 1) == b"!"
        time.sleep(chance.uniform(0.0, 0.3))
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)
        os.close(there)
        killed_mm = model.at[0]
        end = time.monotonic() + 60.0
        while model.state != "Idle" or model.blocks or model.rx:
            assert time.monotonic() < end
            time.sleep(0.02)
        stood = model.at[0]
        time.sleep(0.05)
        assert model.at[0] == stood
        assert 0.0 <= stood - killed_mm <= MANUAL_MM_S * 0.2 + 0.5  # one step of the model
        assert 0.0 < model.ahead_s <= 0.2 + 1e-6
        model.close()


def test_an_alarm_at_rest_is_a_fault_and_a_reset_leaves_it(project: Path) -> None:
    model = GrblModel(settings())
    with grbl(project, model) as anna:
        model.state = "Alarm"
        wait(anna, lambda: anna.hear()["type"] == "state" and anna.state["state"] == "fault")
        assert "Alarm" in anna.state["why"]
        assert anna.act("reset") == ""
        assert anna.act("enable") == ""
        assert anna.act("home") == ""
        anna.see("idle")
        assert b"$X\n" in model.heard or model.state == "Idle"


def test_homing_of_grbl_is_seen_and_stopped(project: Path) -> None:
    """The panel keeps reporting while the controller homes, and a stop resets it."""
    model = GrblModel(settings() | {22: 1.0})
    model.homing_s = 30.0
    with grbl(project, model, ready=False) as anna:
        anna.take().see("disabled")
        assert anna.act("enable") == ""
        anna.until("state")
        anna.ask("home")
        anna.see("homing")
        for _ in range(5):
            anna.until("state")
        anna.say(type="stop")
        wait(anna, lambda: anna.hear()["type"] == "state" and anna.state["state"] == "fault")
        assert "stopped by the operator while it homed" in anna.state["why"]
        while not bytes(model.heard).rstrip(b"?").endswith(b"$H\n\x18"):
            time.sleep(0.05)


def test_a_controller_that_does_not_answer_is_said(project: Path) -> None:
    link = "grbl:127.0.0.1:1"
    with served(project, machine=STEPPER, link=link) as client, operator(client) as anna:
        wait(anna, lambda: anna.until("state")["state"] == "gone")
        assert "nothing answers at '127.0.0.1:1'" in anna.state["why"]
        assert anna.state["allowed"] == ["reconnect"]


@pytest.mark.waits
@awake
def test_hal_is_homed_jogged_run_held_and_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The panel says that a loopback measures nothing, and the verdict proves nothing."""
    with hal_alone(monkeypatch), unhurried(monkeypatch):
        proven(tmp_path)
        link, machine = "hal:loopback", winder()
        assert "loopback" in at_link(link, machine, 1.0).label
        with served(tmp_path, machine=machine, link=link) as client, operator(client) as anna:
            welcome = next(one for one in anna.heard if one["type"] == "welcome")
            assert (welcome["link"], welcome["simulated"]) == (link, False)
            assert "nothing is measured" in welcome["label"]
            anna.ready()
            assert anna.act("step", axis="X", by=1e-3) == ""
            wait(anna, lambda: anna.state["state"] == "idle" and anna.x_mm() > 0.9)
            assert anna.act("zero-axis", axis="X") == ""
            wait(anna, lambda: anna.state["state"] == "idle" and abs(anna.x_mm()) < 1e-6)
            assert anna.act("calculate", program="there.prg") == ""
            proof = anna.until("state")["proven"]["proof"]
            assert anna.act("start", proof=proof) == ""
            wait(anna, lambda: anna.x_mm() > 3.0)
            assert anna.act("hold") == ""
            anna.see("holding")
            assert anna.act("resume") == ""
            wait(anna, lambda: anna.state["state"] == "running")
            anna.say(type="stop")
            anna.see("idle")
            wait(anna, lambda: bool(anna.state["progress"]["verdict"]))
            assert anna.state["progress"]["verdict"].startswith("NOT PROVEN")
    store = opened(tmp_path / "runs")
    assert store is not None
    (record,) = store.index.runs()
    assert record.link == link


def test_inputs_that_nothing_simulated_switches_are_said() -> None:
    """They are lit at rest: without a word an operator would look for the letter that is held."""
    placer = load_machine("letter-placer")
    progress = (
        "nobody is at the simulated machine: its inputs start button, letter held, acknowledge and "
        "home button are on from the start"
    )
    assert at_link("sim", placer, 1.0).notes == (progress,)
    assert at_link("sim:slower", placer, 1.0).notes[1:] == (progress,)
    assert at_link("sim", load_machine("lathe-winder"), 1.0).notes == ()
