"""How far a verdict reaches: one run, twenty, other machines within the tolerances."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import threadline as tl
from threadline.cli.main import main
from threadline.cli.runs_ import listed
from threadline.commands.plan import Plan
from threadline.errors import OptionError
from threadline.files import tick_table
from threadline.live.store.index import RunRecord
from threadline.machine import load_machine
from threadline.machine.variants import uncertain, variant
from threadline.machine.vary import vary
from threadline.proof.options import Options
from threadline.proof.pipeline import (
    REPEATED,
    TOLERANCES,
    Trials,
    open_job,
    plan_job,
    prove_plan,
    try_plan,
)
from threadline.twin import simulate
from threadline.verdict import Criterion, Spec, Status, closing, judge, load_spec

EXAMPLES = Path(__file__).parents[1] / "examples"


def plan_of(reference: str) -> tuple[Plan, Spec]:
    machine = load_machine(reference)
    job = open_job(EXAMPLES / "x-180.prg", machine, Options())
    return plan_job(job, machine, Options()), load_spec(None, machine)


def test_twenty_runs_side_by_side_are_twenty_runs_one_after_the_other() -> None:
    """Each day simulated and judged alone, with the factors drawn again: the same verdict."""
    plan, spec = plan_of("lathe-winder+stiction")
    proof = prove_plan(plan, spec, trials=REPEATED)
    random, days = np.random.default_rng(1994), [simulate(tick_table(plan.commands), plan.machine)]
    for _ in range(19):
        machine = vary(
            plan.machine, friction=random.uniform(0.7, 1.3), supply=random.uniform(0.95, 1.05)
        )
        phase = random.uniform(0.0, 1.0, len(plan.axes))
        days.append(simulate(tick_table(plan.commands), machine, encoder_phase=phase))
    alone = judge(days, plan, spec)
    assert proof.verdict.runs == alone.runs == 20
    assert proof.verdict.level == alone.level == "repeated"
    for mine, theirs in zip(proof.verdict.results, alone.results, strict=True):
        assert (mine.name, mine.axis, mine.status) == (theirs.name, theirs.axis, theirs.status)
        # Lengths in m, currents in A: what other time steps of the matrix exponential make of them.
        assert mine.measured == pytest.approx(theirs.measured, rel=1e-9, abs=1e-12)
        assert mine.job_line == theirs.job_line
    spread = proof.verdict.result("repeatability")
    assert spread.status is not Status.NOT_MEASURED
    assert spread.measured is not None and spread.measured > 1e-6
    assert closing(proof.verdict).split("(")[1].startswith("repeated: 20 runs")


def test_other_machines_count_and_do_not_repeat() -> None:
    """The worst of them counts, and the spread is that of the runs of one machine."""
    plan, spec = plan_of("lathe-winder")
    repeated = prove_plan(plan, spec, trials=REPEATED).verdict
    over = prove_plan(plan, spec, trials=Trials(repeats=20, machines=12)).verdict
    assert (over.level, over.runs, over.machines) == ("over tolerances", 20, 12)
    assert "over tolerances: 20 runs, 12 machines within them" in closing(over)
    spread = "repeatability"
    assert over.result(spread).measured == repeated.result(spread).measured
    contour = over.result("contour_error").measured, repeated.result("contour_error").measured
    assert contour[0] > contour[1]
    # The first of the others is the first number at its lower end, alone.
    random = np.random.default_rng(1994)
    for _ in range(19):
        random.uniform(0.7, 1.3), random.uniform(0.95, 1.05), random.uniform(0.0, 1.0, 3)
    phase = random.uniform(0.0, 1.0, (12, 3))[0]
    parts = np.zeros(len(uncertain(plan.machine)))
    parts[0] = -1.0
    one = simulate(tick_table(plan.commands), variant(plan.machine, parts), encoder_phase=phase)
    alone = judge([one], plan, spec).result("contour_error").measured
    assert alone is not None
    assert contour[0] >= alone - 1e-12
    assert TOLERANCES.machines == 200


def test_a_machine_without_tolerances_is_refused() -> None:
    plan, spec = plan_of("lathe-winder")
    every = tuple(path for number in uncertain(plan.machine) for path in number.numbers)
    rules = replace(plan.machine.tolerances, exclude=every, normal=(), groups={})
    bare = replace(plan, machine=replace(plan.machine, tolerances=rules))
    with pytest.raises(OptionError, match="no number of lathe-winder has a tolerance"):
        prove_plan(bare, spec, trials=TOLERANCES)


def test_a_search_ends_at_one_run_that_is_out_of_spec() -> None:
    plan, _ = plan_of("lathe-winder")
    strict = Spec(name="", criteria=(Criterion(name="contour_error", limit=1e-6),))
    assert try_plan(plan, strict, REPEATED).verdict.runs == 1
    wide = Spec(name="", criteria=(Criterion(name="contour_error", limit=1.0),))
    assert try_plan(plan, wide, REPEATED).verdict.runs == 20


@pytest.mark.parametrize(
    ("level", "runs"), [("nominal", 1), ("repeated", 20), ("over tolerances", 20)]
)
def test_the_face_proves_at_the_level_that_is_asked(level: str, runs: int) -> None:
    proof = tl.prove(EXAMPLES / "x-180.prg", "lathe-winder", level=level)
    assert proof.verdict.level == level
    assert proof.verdict.runs == runs
    assert proof.json()["level"] == level


def test_the_default_is_repeated_and_levels_exclude_each_other(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert tl.prove(EXAMPLES / "x-180.prg", "lathe-winder").verdict.level == "repeated"
    with pytest.raises(OptionError, match="unknown level 'sure'"):
        tl.prove(EXAMPLES / "x-180.prg", "lathe-winder", level="sure")
    job = [str(EXAMPLES / "x-180.prg"), "-m", "lathe-winder"]
    for words, said in (
        ([], "repeated: 20 runs"),
        (["--nominal"], "nominal: 1 run"),
        (["--repeats", "3"], "nominal: 3 runs"),
    ):
        with pytest.raises(SystemExit):
            main(["prove", *job, *words])
        assert said in capsys.readouterr().out.splitlines()[-1]
    with pytest.raises(SystemExit) as ended:
        main(["prove", *job, "--nominal", "--tolerances"])
    assert ended.value.code == 2
    assert "--nominal and --tolerances ask for different levels" in capsys.readouterr().err


def test_the_list_of_runs_says_how_far_each_proof_reaches(tmp_path: Path) -> None:
    """A run is one run; what it was proved by may be one, twenty, or other machines as well."""
    record = RunRecord(
        run="a",
        started="2026-11-23T04:00:00+00:00",
        job="x.prg",
        machine="lathe-winder",
        link="sim",
        speed=0.0,
        level="nominal",
        proof_passed=True,
        job_sha256="",
        machine_sha256="",
        commands_sha256="",
        proof_sha256="",
        threadline="",
        ended="done",
        passed=True,
    )
    assert listed(record, tmp_path)[4:6] == ["in spec", "in spec (nominal)"]
    other = replace(record, proof_passed=False, level="over tolerances", passed=False)
    missing = {"passed": False, "criteria": [{"status": "not-measured", "required": True}]}
    failed = {"passed": False, "criteria": [{"status": "passed"}, {"status": "failed"}]}
    (tmp_path / "verdict.json").write_text(json.dumps({**missing, "level": "nominal"}), "utf-8")
    proof = {"level": "over tolerances", "verdict": failed}
    (tmp_path / "proof.json").write_text(json.dumps(proof), "utf-8")
    assert listed(other, tmp_path)[4:6] == ["not proven", "out of spec (over tolerances)"]
    kept = {"level": "limits and time alone", "verdict": {"passed": True, "criteria": []}}
    (tmp_path / "proof.json").write_text(json.dumps(kept), "utf-8")
    limits = replace(record, level="limits and time alone", passed=None)
    assert listed(limits, tmp_path)[4:6] == ["not judged", "limits kept (limits and time alone)"]
    stopped = replace(record, ended="stopped", text="stopped by the operator")
    assert (listed(stopped, tmp_path)[3], listed(stopped, tmp_path)[7]) == (
        "stopped", "by the operator",
    )  # fmt: skip
    (tmp_path / "proof.json").write_text("[", "utf-8")  # the index is what is left
    assert listed(other, tmp_path)[5] == "not passed (over tolerances)"
