"""The panel at other machines: the placer's cylinders, an embroidery frame, a stitcher."""

from __future__ import annotations

import re
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.panel.bench import Operator, operator, proven, served
from threadline.machine import Machine, load_machine

SPEED = 2.0
SEWING = 40.0


@cache
def machine(name: str) -> Machine:
    return load_machine(name)


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    return tmp_path_factory.mktemp("project")


def started(anna: Operator, name: str, project: Path) -> Operator:
    proven(project, name)
    anna.see("disabled")
    anna.ready()
    if name != "stitcher":
        refuses_jogs(anna)
    assert anna.act("calculate", program="") == ""
    proof = anna.until("state")["proven"]["proof"]
    assert anna.act("start", proof=proof) == ""
    anna.see("running")
    return anna


def refuses_jogs(anna: Operator) -> None:
    assert not {"jog", "step", "zero", "approach"} & set(anna.state["allowed"])
    (welcome,) = (one for one in anna.heard if one["type"] == "welcome")
    assert welcome["untaught"].endswith(", no part programs")
    assert "not possible now" in anna.act("jog", axis="X", share=1.0)


def test_a_client_is_told_what_cylinders_there_are(project: Path) -> None:
    """The cylinders come with the outputs of both ways and the end switches."""
    with served(project, machine=machine("letter-placer")) as client, operator(client) as anna:
        (welcome,) = (one for one in anna.heard if one["type"] == "welcome")
    x, z = welcome["cylinders"]
    assert (x["name"], x["unit"], x["stroke"]) == ("X", "m", 0.2)
    assert x["forward"] == ["x_right", "x_right_a1", "x_right_a2"]
    assert z["back"][0] == "z_up"
    assert {one["name"]: (one["at"], one["beyond"]) for one in x["contacts"]} == {
        "x_is_left": (0.006, "below"),
        "x_is_right": (0.194, "above"),
    }
    assert welcome["axes"] == [] and "knife" in welcome["outputs"]
    assert "light_grid" in welcome["inputs"]


def test_a_homed_placer_tells_pistons_contacts_and_outputs_before_any_run(project: Path) -> None:
    """Homing moves the cylinders to their starts; from then on their state is known and shown."""
    with served(project, machine=machine("letter-placer")) as client, operator(client) as anna:
        before = anna.see("disabled")
        assert {at["load"] for at in before["axes"].values()} == {None} and not before["signals"]
        seen = anna.ready().state
        assert {name: at["load"] for name, at in seen["axes"].items()} == {"X": 0.0, "Z": 0.0}
        assert set(seen["signals"]) >= {*machine("letter-placer").outputs}
        assert seen["signals"]["x_is_left"] == 1.0 and seen["signals"]["x_is_right"] == 0.0
        assert seen["signals"]["x_right"] == 0.0


def test_a_state_in_which_nothing_changes_is_sent_half_as_often(project: Path) -> None:
    with served(project, machine=machine("letter-placer")) as client, operator(client) as anna:
        anna.see("disabled")
        seqs = [anna.until("state")["seq"] for _ in range(12)]
        assert sorted(np.diff(seqs[2:]))[len(seqs) // 2] == 2


def verdict(anna: Operator) -> dict[str, str]:
    anna.see("idle", "enabled")
    while not (anna.hear()["type"] == "state" and anna.state["progress"]["verdict"]):
        pass
    found: dict[str, str] = anna.state["progress"]
    return found


def test_the_placers_cycle_with_a_hold(project: Path) -> None:
    """The hold takes effect where no cylinder moves; progress and signals are shown."""
    name = "letter-placer"
    with served(project, SPEED, machine=machine(name)) as client, operator(client) as anna:
        started(anna, name, project)
        anna.wait(lambda state: (state["axes"]["X"]["load"] or 0.0) >= 0.05)
        assert anna.act("hold") == ""
        seen = anna.see("holding")
        assert set(seen["axes"]) == {"X", "Z"}
        assert set(seen["signals"]) >= {*machine(name).outputs, *machine(name).contacts}
        held_s = seen["progress"]["time_s"]
        end = time.monotonic() + 60.0
        gone = lambda state: state["progress"]["time_s"] - held_s > 0.2  # noqa: E731
        anna.wait(lambda state: gone(state) or time.monotonic() > end)
        assert gone(anna.state) and anna.state["state"] == "holding"
        assert anna.act("resume") == ""
        found = verdict(anna)
        assert found["ended"] == "completed"
        assert re.match(r"IN SPEC", found["verdict"])


@pytest.mark.long(shown_by="test_the_placers_cycle_with_a_hold")
def test_a_stopped_placer_has_to_be_homed(project: Path) -> None:
    name = "letter-placer"
    with served(project, SPEED, machine=machine(name)) as client, operator(client) as anna:
        started(anna, name, project)
        anna.say(type="stop")
        assert verdict(anna)["ended"] == "stopped"
        assert anna.see("enabled")["allowed"] == ["disable", "home", "calculate"]
        anna.take()  # judging on a busy computer can outlast the lease
        assert anna.act("home") == ""
        assert anna.act("start", proof=anna.state["proven"]["proof"]) == ""
        anna.see("running")
        anna.say(type="stop")
        verdict(anna)


@pytest.mark.long(shown_by="test_the_placers_cycle_with_a_hold")
def test_an_embroidery_frame_sews_stops_and_begins_again_at_home(project: Path) -> None:
    name = "schiffli-frame"
    with served(project, SEWING, machine=machine(name)) as client, operator(client) as anna:
        started(anna, name, project)
        anna.wait(lambda state: abs(state["axes"]["X"]["commanded"] or 0.0) >= 1e-3)
        anna.say(type="stop")
        assert verdict(anna)["ended"] == "stopped"
        proof = anna.state["proven"]["proof"]
        anna.take()  # judging on a busy computer can outlast the lease
        assert "the frame stands at" in anna.act("start", proof=proof)
        anna.allows("home")  # a refused run is put aside
        assert anna.act("home") == ""
        anna.see("idle")
        assert anna.act("start", proof=proof) == ""
        anna.see("running")
        found = verdict(anna)
        assert (found["ended"], found["verdict"][:7]) == ("completed", "IN SPEC")


@pytest.mark.long(shown_by="test_the_placers_cycle_with_a_hold")
def test_a_seam_is_sewn_with_a_hold(project: Path) -> None:
    """The loads follow, so a hold takes effect at the next rest of the seam."""
    name = "stitcher"
    with served(project, SPEED, machine=machine(name)) as client, operator(client) as anna:
        started(anna, name, project)
        anna.wait(lambda state: (state["axes"]["X"]["commanded"] or 0.0) >= 0.01)
        assert anna.act("hold") == ""
        assert anna.see("holding", "idle")["axes"]["X"]["load"] is not None
        if anna.state["state"] == "holding":
            assert anna.act("resume") == ""
        found = verdict(anna)
        assert (found["ended"], found["verdict"][:7]) == ("completed", "IN SPEC")
