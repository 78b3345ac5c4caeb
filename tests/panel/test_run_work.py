"""The work of other processes for the owner of a machine, before and after a run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.panel.bench import EXAMPLES, operator, proven, served
from threadline.commands.plan import Plan
from threadline.errors import CommandError
from threadline.live.supervised import Interventions, interventions
from threadline.machine import load_machine
from threadline.panel import run_work, stored_runs
from threadline.proof.options import options_of
from threadline.proof.pipeline import open_job, plan_job
from threadline.verdict import Spec, load_spec

STAYS_SMALL = f"""
from pathlib import Path
from threadline.machine import load_machine
from threadline.panel.run_work import interventions_apart
from threadline.proof.options import options_of
from threadline.proof.pipeline import open_job, plan_job
from threadline.verdict import load_spec

def memory_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

machine, options = load_machine("lathe-winder"), options_of()
plan = plan_job(open_job(Path({str(EXAMPLES / "x-180.prg")!r}), machine, options), machine, options)
list(plan.commands.blocks)
before = memory_mb()
interventions_apart(plan, load_spec(None, machine))
print(memory_mb() - before)
"""


def planned() -> tuple[Plan, Spec]:
    machine, options = load_machine("stitcher"), options_of(feed_forward=True)
    job = open_job(EXAMPLES / "stitcher-even.seam.toml", machine, options)
    return plan_job(job, machine, options), load_spec(None, machine)


def test_another_process_finds_the_same() -> None:
    plan, spec = planned()
    found, here = run_work.interventions_apart(plan, spec), interventions(plan, spec)
    assert found.hold_deviation_m == here.hold_deviation_m
    assert found.hold is here.hold
    assert found.no_override == here.no_override
    assert found.notes == here.notes
    assert found.notes, "an operator is told nothing of holds: this compares nothing"


def test_the_owner_stays_small() -> None:
    """In its own process the simulation takes more than 50 MB, which are not returned."""
    done = subprocess.run(
        [sys.executable, "-c", STAYS_SMALL], check=True, capture_output=True, text=True
    )
    assert float(done.stdout) < 10.0


def test_a_process_that_cannot_be_started_refuses_the_start(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    with pytest.raises(CommandError, match="simulates holds and overrides cannot be started"):
        run_work.interventions_apart(*planned())


def test_a_proof_that_is_started_again_is_not_simulated_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[str]()

    def counted(plan: Plan, spec: Spec) -> Interventions:
        asked.append(plan.job.name)
        return interventions(plan, spec)

    monkeypatch.setattr(stored_runs, "interventions_apart", counted)
    proven(tmp_path)
    with served(tmp_path) as client, operator(client) as anna:
        anna.ready()
        assert anna.act("calculate", program="there.prg") == ""
        proof = anna.until("state")["proven"]["proof"]
        assert anna.act("start", proof=proof) == ""
        anna.see("running")
        anna.see("idle")
        anna.allows("start")
        assert "axis A stands at" in anna.take().act("start", proof=proof)  # it was checked
    assert asked == ["there.prg"]


def test_a_judge_that_fails_is_told_in_place_of_a_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise the operator would wait for a verdict that never comes."""

    def ends(*_: object) -> None:
        raise CommandError("the process that judges has ended without an answer")

    monkeypatch.setattr(stored_runs, "judged_apart", ends)
    proven(tmp_path)
    with served(tmp_path) as client, operator(client) as anna:
        anna.ready()
        assert anna.act("calculate", program="there.prg") == ""
        assert anna.act("start", proof=anna.until("state")["proven"]["proof"]) == ""
        anna.see("running")
        anna.say(type="stop")
        anna.see("idle")
        while not anna.until("state")["progress"]["verdict"]:
            pass
        verdict = anna.state["progress"]["verdict"]
        assert verdict.startswith("NOT JUDGED: the process that judges has ended without an answer")
        assert anna.state["busy"] == ""
