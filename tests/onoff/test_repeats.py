"""Runs of an on/off machine on other days, and shapers side by side."""

from __future__ import annotations

import json
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.blank_pictures import blank_pictures
from threadline.cli.main import main
from threadline.commands.plan import Plan
from threadline.errors import RecordingError
from threadline.files import Recording
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.machine.variants import uncertain, variant
from threadline.proof import over_tolerances
from threadline.proof.kinds import kind_of
from threadline.proof.kinds.variants import with_machine_hash
from threadline.proof.options import Options
from threadline.proof.pipeline import Trials, plan_job, prove_plan, simulate
from threadline.proof.worst_search import WorstSearch
from threadline.verdict import Criterion, Spec, Status, judge, load_spec

CYCLE = Path(__file__).resolve().parents[2] / "examples" / "letter-cycle.toml"
OWN = "letter-placer+whole-scans+own-damping"


def plan_of(reference: str) -> Plan:
    machine = load_machine(reference)
    return plan_job(read_job(CYCLE, machine), machine, Options(shaper="zv"))


def run(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main([str(word) for word in words])
    out, err = capsys.readouterr()
    return int(ended.value.code or 0), out, err


def test_another_day_differs_in_friction_and_stiffness_alone() -> None:
    """The running machine differs from the plan's by two factors; the speed of its flows stays."""
    plan = plan_of(f"{OWN}+hysteresis")
    machine = plan.machine
    _, day = kind_of(machine).days(plan.commands, machine, 2, np.random.default_rng(3))
    random = np.random.default_rng(3)
    friction, supply = random.uniform(0.7, 1.3), random.uniform(0.95, 1.05)

    def varied(part):
        return replace(
            part,
            friction=replace(part.friction, si=part.friction.si * friction),
            stiction=replace(part.stiction, si=part.stiction.si * friction),
            air_stiffness=replace(part.air_stiffness, si=part.air_stiffness.si * supply),
        )

    cylinders = {name: varied(part) for name, part in machine.cylinders.items()}
    expected = simulate(plan.commands, replace(machine, cylinders=cylinders))
    frames = [f"{axis}.frame" for axis in plan.axes]
    ours, theirs = (r.samples_of(frames) for r in (day, expected))
    for name in frames:
        assert np.array_equal(ours[name][1], theirs[name][1])


def test_runs_are_held_one_by_one() -> None:
    """Four times as many runs, judged together, take no more memory: one at a time is kept."""
    plan = plan_of(OWN)
    spec = load_spec(None, plan.machine)

    def days(count: int) -> list[Recording]:
        random = np.random.default_rng(3)
        return list(kind_of(plan.machine).days(plan.commands, plan.machine, count, random))

    def peak(count: int) -> int:
        recordings = days(count)
        tracemalloc.start()
        try:
            judge(recordings, plan, spec)
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    judge(days(1), plan, spec)  # compiled first: slow while memory is traced
    peak(1)  # created once
    assert peak(12) < 1.3 * peak(3)


def test_repeatability_is_the_spread_of_where_pistons_stand() -> None:
    """By numpy from the recordings: at the end of each move's rest, the farthest from the mean."""
    plan = plan_of(f"{OWN}+hysteresis")
    spec = Spec(name="", criteria=(Criterion(name="repeatability", options={"recordings": 3.0}),))
    random = np.random.default_rng(5)
    days = kind_of(plan.machine).days(plan.commands, plan.machine, 4, random)[1:]
    result = judge(days, plan, spec).result("repeatability")

    # X stands from the end of "across" to "return": its place is read while Z goes down to leave.
    # It
    # still creeps by a tenth of a micrometre from there to the instant that the judge looks at.
    steps = {e.name: e for e in plan.scheduled.commands.events if e.kind == "tool"}
    leaves_s = steps["leave"].tick * float(plan.commands.clock.period_s) + 0.5
    stands = [np.interp(leaves_s, *r.samples("X.load")) for r in days]
    away = np.abs(np.array(stands) - np.mean(stands))
    assert result.measured == pytest.approx(away.max(), abs=2e-7)
    assert result.note == f"across: X, recording {away.argmax() + 1}"
    assert result.status is Status.REPORTED
    few = judge(days[:2], plan, spec).result("repeatability")
    assert few.status is Status.NOT_MEASURED
    assert few.note == "needs 3 recordings, has 2"


def test_repeats_are_drawn_from_a_fixed_seed_and_the_worst_counts() -> None:
    plan = plan_of(f"{OWN}+hysteresis")
    spec = Spec(name="", criteria=(Criterion(name="residual_vibration", axis="X"),))
    once = prove_plan(plan, spec).verdict.result("residual_vibration").measured
    first, second = (prove_plan(plan, spec, trials=Trials(repeats=4)) for _ in range(2))
    found = [p.verdict.result("residual_vibration").measured for p in (first, second)]
    assert found[0] == found[1]
    assert once is not None
    assert found[0] is not None
    assert found[0] > once


@pytest.mark.long(shown_by="test_repeats_are_drawn_from_a_fixed_seed_and_the_worst_counts")
def test_shapers_stand_side_by_side(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By default; a shaper that the valves cannot follow is listed with the reason."""
    blank_pictures(monkeypatch)
    folder = tmp_path / "report"
    words = ["compare", CYCLE, "-m", "letter-placer", "--shaper", "none, zv, um-zv"]
    code, out, _ = run(capsys, *words, "--report", folder)
    assert code == 1  # the unshaped cycle is out of spec
    rows = [line.split() for line in out.splitlines()]
    assert ["um-zv", "8.730", "8.730", "0.073"] in [row[:4] for row in rows]
    assert ["zv", "refused"] in rows
    assert "zv is refused: no valves of 'z_down' make the level 0.5064" in out
    page = (folder / "comparison.html").read_text(encoding="utf-8")
    assert 'id="residual"' in page and 'id="cycle-um-zv"' in page

    code, out, _ = run(capsys, "compare", CYCLE, "-m", OWN, "--json", "--shaper", "zv,um-zvd")
    content = json.loads(out)
    assert code == 0
    assert [p["shaper"] for p in content["proofs"]] == ["zv", "um-zvd"]
    assert all(p["passed"] for p in content["proofs"])
    assert content["fastest"] == {} and content["refused"] == []


def test_options_without_effect_on_repeats_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["compare", CYCLE, "-m", OWN]
    for more in (["--interpolation", "linear"], ["--feed", "1 mm/s"], ["--shaper", "zvd"]):
        code, out, err = run(capsys, *words, *more)
        assert (code, out, err.count("\n")) == (2, "", 1)


def test_a_machine_that_waits_forever_is_out_of_specification_and_counted(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A slow piston stops short of a switch farther out: that is no error of input.

    It creeps to the switch unless the list forbids that.
    """
    machine = load_machine("letter-placer")
    file = tmp_path / "list.toml"
    file.write_text(CYCLE.read_text().replace('wait = "x_is_r', 'creep = false\nwait = "x_is_r'))
    plan = plan_job(read_job(file, machine), machine, Options())
    names = [one.numbers[0] for one in uncertain(machine)]
    parts = np.zeros((3, len(names)))
    parts[0, names.index("contacts.x_is_right.at")] = -1.0
    for name, end in (
        ("contacts.x_is_right.at", 1.0),
        ("cylinders.X.speed", -1.0),
        ("cylinders.X.forward.flows.x_right_a1", -1.0),
    ):
        parts[2, names.index(name)] = end
    one_by_one = []
    for row in parts:
        try:
            own = variant(machine, row)
            for _ in kind_of(own).simulate(with_machine_hash(plan.commands, own), own):
                pass
            one_by_one.append("")
        except RecordingError as error:
            one_by_one.append(error.message)
    stuck = [why for why in one_by_one if why]
    assert len(stuck) == 1 and "'x_is_right' did not become on" in stuck[0]

    monkeypatch.setattr(over_tolerances, "drawn", lambda *_: parts)
    monkeypatch.setattr(WorstSearch, "begin", lambda _: None)
    monkeypatch.setattr(WorstSearch, "go_on", lambda _: None)
    spec = load_spec(None, machine)
    verdict = prove_plan(plan, spec, trials=Trials(repeats=2, machines=3)).verdict
    result = verdict.result("unanswered")
    assert (result.measured, result.status) == (pytest.approx(1 / 3), Status.FAILED)
    assert result.note == f"1 of 3 machines within the tolerances never end: {stuck[0]}"
    assert verdict.machines == 3 and not verdict.passed
    assert verdict.tolerances is not None and verdict.tolerances.share is None
    # The results of the other runs are still reported.
    assert verdict.result("residual_vibration").measured is not None


def test_scans_jitter_from_run_to_run_and_not_in_the_nominal_one() -> None:
    plan = plan_of(f"{OWN}+jitter")
    kind, even = kind_of(plan.machine), plan_of(OWN)

    def switched(recording: Recording) -> list[int]:
        outputs = recording.samples_of(plan.machine.outputs).values()
        return [int(at) for _, one in outputs for at in np.flatnonzero(np.diff(one))]

    nominal, day, other = (
        switched(run) for run in kind.days(plan.commands, plan.machine, 3, np.random.default_rng(3))
    )
    assert nominal == switched(kind.simulate(even.commands, even.machine))
    assert nominal != day != other
    assert max(abs(a - b) for a, b in zip(nominal, day, strict=True)) <= 2 + 2  # ms, twice a fifth
    parts = np.zeros((2, len(uncertain(plan.machine))))
    one, two = kind.others(plan.commands, plan.machine, parts, np.random.default_rng(3))
    assert switched(one) != switched(two) != nominal
