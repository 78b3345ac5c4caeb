"""The rest of an interrupted run from the panel: nothing moves before it is confirmed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.panel.bench import Operator, operator, proven, served
from threadline.files.formats import read_recording
from threadline.live.store.run_store import opened


def judged(anna: Operator) -> str:
    while not (anna.hear()["type"] == "state" and anna.state["progress"]["verdict"]):
        anna.say(type="alive", lease=anna.lease)
    return str(anna.state["progress"]["verdict"])


def calculated(anna: Operator) -> str:
    assert anna.act("calculate", program="there.prg") == ""
    return str(anna.until("state")["proven"]["proof"])


def broken_off(anna: Operator) -> str:
    """Start the program, stop it on its way back, and return the name of the run."""
    assert anna.act("start", proof=calculated(anna)) == ""
    while anna.x_mm() < 55.0:
        anna.until("state")
    while anna.x_mm() > 45.0:
        anna.until("state")
    anna.say(type="stop")
    anna.see("idle")
    judged(anna)
    return str(anna.state["progress"]["run"])


def ready_to_go_on(anna: Operator, run: str, proof: str) -> None:
    anna.allows("continue")
    assert anna.act("continue", run=run, proof=proof) == ""
    anna.wait(lambda state: state["rest"] is not None)


@pytest.mark.long(
    shown_by="tests/live/test_continued.py::test_axes_are_moved_there_and_do_the_rest_row_by_row"
)
def test_the_rest_of_a_run_after_homing_and_a_confirmation(tmp_path: Path) -> None:
    proven(tmp_path)
    with served(tmp_path, 4.0) as client, operator(client) as anna:
        anna.ready()
        run = broken_off(anna)

    # A new process, and a machine that was just switched on: at home, and at rest.
    with served(tmp_path, 4.0) as client, operator(client) as anna:
        anna.ready()
        assert "is not possible now" in anna.act("continue", run=run, proof="0" * 64)
        proof = calculated(anna)
        assert "Calculate it again" in anna.act("continue", run=run, proof="0" * 64)
        assert "there is no run 'another'" in anna.act("continue", run="another", proof=proof)
        wrong = anna.act("continue", run=run, proof=proof, at="line 9999")
        assert "the run has not executed it" in wrong
        assert anna.state["rest"] is None

        ready_to_go_on(anna, run, proof)
        assert anna.state["rest"]["run"] == run
        (note,) = anna.state["rest"]["notes"]
        assert note.startswith("the work begins again at line 6 of the job; from home: ")
        assert "A to 20.01 deg at 114 deg/s; then X to 59.99 mm at 72.3 mm/s" in note
        assert "the run begins at" in anna.act("start-rest")  # the machine stands at home
        assert all(at["commanded"] == 0.0 for at in anna.until("state")["axes"].values())

        anna.say(type="stop")  # which drops it
        anna.wait(lambda state: state["rest"] is None)
        assert "is not possible now" in anna.act("start-rest")

        ready_to_go_on(anna, run, proof)
        assert anna.act("approach-rest") == ""
        while anna.x_mm() < 59.98 or anna.state["state"] != "idle":
            anna.ask("renew")
            anna.until("state")
        assert anna.act("start-rest") == ""
        anna.see("running")
        assert anna.until("state")["rest"] is None
        anna.see("idle")
        verdict = judged(anna)
        assert verdict.startswith("IN SPEC")
        assert verdict.endswith(f"Judged as one with what {run} did before the work began again")
        done = anna.state["progress"]
        assert (done["ended"], done["why"]) == ("completed", "")
        assert done["time_s"] >= done["duration_s"]
        assert abs(anna.x_mm()) < 0.02
        anna.allows("continue")
        refused = anna.act("continue", run=done["run"], proof=proof)
        assert "was completed: there is no rest of it" in refused

    recording = read_recording(tmp_path / "runs" / done["run"] / "trace.mcap")
    assert recording.origin["continues"] == run
    x = recording.samples("X.commanded")[1]
    assert abs(x[0] - 0.05999) < 1e-5
    operations = recording.samples("operation")[1]
    assert operations.min() >= float(recording.origin["from_operation"]) > 0.0
    store = opened(tmp_path / "runs")
    assert store is not None
    assert {one.run: one.ended for one in store.index.runs()} == {
        run: "stopped", done["run"]: "completed",
    }  # fmt: skip
