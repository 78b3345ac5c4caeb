"""A wanted yield: proved, searched, designed for, and reached with the fewest halved tolerances."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.search.test_design import CORNER, NO_REGION, PLACE, two_parameters
from threadline.base.arrays import FloatArray, IntArray
from threadline.cli.main import main
from threadline.commands.plan import Plan
from threadline.errors import OptionError
from threadline.files import tick_table
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.machine.variants import drawn, uncertain, variant
from threadline.machine.vary import REPEAT_SEED
from threadline.proof import pipeline
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, prove_plan, yielding
from threadline.proof.request import trials_of
from threadline.search.design import Requirements, design
from threadline.search.design_evaluate import Evaluator, Tried
from threadline.search.design_proof import ProvedDesign
from threadline.search.influence import cheapest_set
from threadline.search.machine_yield import MachineYield
from threadline.twin import simulate
from threadline.verdict import Spec, judge, load_spec
from threadline.verdict.each_run import clopper_pearson
from threadline.verdict.types import Level

JOB = Path(__file__).parents[2] / "examples" / "x-180.prg"


@pytest.fixture(scope="module")
def asked() -> tuple[Plan, Spec]:
    machine = load_machine("lathe-winder")
    plan = plan_job(open_job(JOB, machine, Options()), machine, Options())
    return plan, load_spec(None, machine)


def test_rejects_are_the_machines_that_fail_alone(asked: tuple[Plan, Spec]) -> None:
    """Compared with each machine simulated and judged alone, at the drawn encoder phases."""
    plan, spec = asked
    trials = replace(yielding(0.5), repeats=20, machines=12)
    proof = prove_plan(plan, spec, trials=trials)
    random = np.random.default_rng(REPEAT_SEED)
    random.uniform(size=(19, 2 + len(plan.axes)))  # the days of the 20 runs are drawn first
    phases = random.uniform(0.0, 1.0, (12, len(plan.axes)))
    failed = 0
    for parts, phase in zip(
        drawn(plan.machine, pipeline.VARIANT_SEED, np.arange(12)), phases, strict=True
    ):
        made = variant(plan.machine, parts)
        single = simulate(tick_table(plan.commands), made, encoder_phase=phase)
        failed += not judge([single], plan, spec).passed
    rejects = proof.verdict.result("rejects")
    assert rejects.note == f"{failed} of 12 machines within the tolerances are out of specification"
    assert rejects.measured == pytest.approx(1.0 - clopper_pearson(12 - failed, 12)[0], rel=1e-12)
    assert (rejects.limit, proof.verdict.level) == (0.5, Level.YIELD)
    assert 0 < failed < 12


def test_no_more_machines_are_tried_than_say_that_it_fails(asked: tuple[Plan, Spec]) -> None:
    plan, spec = asked
    proof = prove_plan(plan, spec, trials=replace(yielding(0.99), machines=1000))
    assert proof.verdict.machines == 256  # some 50 of these fail, and 3 of 1000 may
    assert not proof.verdict.passed
    # The machine of the file is in specification in 20 runs.
    assert [r.name for r in proof.verdict.results if r.status == "failed"] == ["rejects"]


@pytest.mark.parametrize("text", ["100 %", "0 %", "99", "-1 %", "many"])
def test_a_yield_is_a_share_below_the_whole(text: str) -> None:
    with pytest.raises(OptionError, match="yield"):
        trials_of(yield_=text)
    with pytest.raises(OptionError, match="different levels"):
        trials_of(nominal=True, yield_="99 %")


@pytest.mark.long(shown_by="test_a_yield_that_no_tolerance_reaches_is_said")
@pytest.mark.usefixtures("coarse_search")
def test_fastest_with_a_yield_can_be_typed_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """95 % of the machines allow a lower feed than the file's machine alone (39.5 mm/s)."""
    job = tmp_path / "turn.prg"  # the reversal test
    job.write_text("G91\nG1 X25.714 F2160\nG1 X-25.714\nM30\n", encoding="utf-8")
    words = [str(job), "-m", "lathe-winder", "--interpolation", "linear", "--yield", "95 %"]
    with pytest.raises(SystemExit) as ended:
        main(["fastest", *words, "--low", "32 mm/s", "--high", "33 mm/s", "--json"])
    found = json.loads(capsys.readouterr().out)
    assert ended.value.code == 0
    assert found["limited_by"] == "rejects"
    assert 0.032 < found["best"] < 0.033
    with pytest.raises(SystemExit) as ended:
        main(["prove", *words, "--feed", f"{found['best']!r} m/s", "--json"])
    proved = json.loads(capsys.readouterr().out)
    assert ended.value.code == 0
    assert proved["level"] == "yield over tolerances" and proved["machines"] == 1000
    assert "--yield" in found["command"]


@pytest.mark.long(shown_by="test_a_yield_that_no_tolerance_reaches_is_said")
def test_no_halving_can_be_left_out_of_the_cheapest_set(asked: tuple[Plan, Spec]) -> None:
    plan, spec = asked
    judged = MachineYield(plan, spec)
    found = cheapest_set(judged, 0.9, 1, machines=200)
    assert found.reached and found.interval[0] >= 0.9 and 1 <= found.halvings <= 8
    parts = drawn(plan.machine, 1, np.arange(200))
    assert int(judged.judged(parts * found.factors).passed.sum()) == found.passed
    assert clopper_pearson(int(judged.judged(parts).passed.sum()), 200)[0] < 0.9
    names = [number.name for number in judged.numbers]
    for k in np.flatnonzero(found.factors < 1.0):
        assert names[k].split(".")[1] == "x"  # the only axis that moves
        less = found.factors.copy()
        less[k] *= 2.0
        passed = int(judged.judged(parts * less).passed.sum())
        assert clopper_pearson(passed, 200)[0] < 0.9


def test_a_yield_that_no_tolerance_reaches_is_said(asked: tuple[Plan, Spec]) -> None:
    """With 20 machines, all of them in spec, the interval still begins at 83 %."""
    plan, spec = asked
    found = cheapest_set(MachineYield(plan, spec), 0.9, 1, machines=20)
    assert not found.reached


@pytest.mark.long(shown_by="test_a_yield_that_no_tolerance_reaches_is_said")
def test_the_set_is_told_where_the_yield_is_too_low(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One corner of the reversal test, with a move on either side.

    The numbers of the axes that stand still are exact; otherwise each would be halved once without
    effect.
    """
    job, machine = tmp_path / "turn.prg", tmp_path / "turner.toml"
    still = [f"{part}.{axis}.*" for part in ("bodies", "drives") for axis in "ya"]
    still += [f"axes.{axis}.*" for axis in "YA"] + ["inputs.*"]
    machine.write_text(
        f'base = "lathe-winder"\nname = "turner"\n[tolerances]\nexclude = {json.dumps(still)}\n'
    )
    job.write_text("G91\nG1 X25.714 F2160\nG1 X-25.714\nM30\n", encoding="utf-8")
    words = ["yield", str(job), "-m", str(machine), "--variants", "100", "--json"]
    with pytest.raises(SystemExit) as ended:
        main([*words, "--at-least", "85 %"])
    content = json.loads(capsys.readouterr().out)
    assert ended.value.code == 1 and content["interval"][0] < 0.85
    assert content["level"] == "drawn machines"
    assert content["cheapest"]["reached"]
    assert set(content["cheapest"]["factors"].values()) <= {0.5, 0.25, 0.125, 0.0625}
    with pytest.raises(SystemExit) as ended:
        main([*words, "--at-least", "60 %"])
    content = json.loads(capsys.readouterr().out)
    assert ended.value.code == 0 and "cheapest" not in content


@pytest.fixture
def judged_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Judge a candidate of a redesign only once if a second search needs it in the same runs.

    The candidates are the same with and without a yield; only the proved ones differ.
    """
    known: dict[object, Tried] = {}
    judge = Evaluator.tried

    def tried(
        self: Evaluator, points: FloatArray, level: IntArray, *, beyond: float = 1.0
    ) -> Tried:
        runs = id(self.space.machine), self.others.repeats, self.others.corners, beyond
        key = *runs, points.tobytes(), level.tobytes()
        if key not in known:
            known[key] = judge(self, points, level, beyond=beyond)
        return known[key]

    monkeypatch.setattr(Evaluator, "tried", tried)


@pytest.mark.long(shown_by="test_rejects_are_the_machines_that_fail_alone")
@pytest.mark.usefixtures("judged_once")
def test_a_design_is_refused_whose_machines_are_out(tmp_path: Path) -> None:
    """The design in spec in 20 runs misses the yield: one in thirteen drawn machines passes."""
    stitcher = load_machine("stitcher")
    file = tmp_path / "corner.seam.toml"
    file.write_text(CORNER)
    spec = load_spec(PLACE, stitcher)
    # Each dead time needs its own kernel: for a thousand machines these take minutes.
    tolerances = replace(
        stitcher.tolerances, exclude=(*stitcher.tolerances.exclude, "drives.*.delay")
    )
    machine = replace(two_parameters(stitcher, (1.0, 30.0)), tolerances=tolerances)
    plain = design(file, machine, spec, Options(), Requirements(effort=NO_REGION)).found
    assert plain is not None and plain.verdict.passed
    plan = plan_job(read_job(file, plain.machine), plain.machine, Options())
    assert MachineYield(plan, plain.spec).drawn(600, 7).interval[1] < 0.125
    for_yield = design(
        file, machine, spec, Options(), Requirements(trials=yielding(0.125), effort=NO_REGION)
    )
    assert "rejects" in for_yield.refused
    assert for_yield.found is not None
    assert for_yield.found.candidate.cost > plain.candidate.cost


@pytest.mark.long(shown_by="test_rejects_are_the_machines_that_fail_alone")
@pytest.mark.usefixtures("judged_once")
def test_a_design_is_found_whose_machines_are_in(tmp_path: Path) -> None:
    """At 50 stitch/s settings alone bring the file's machine into spec, but not the drawn machines.

    Among candidates that trade cost for margin the cheapest that reaches 80 % is chosen; 200
    machines of another seed check it.
    """
    stitcher = load_machine("stitcher")
    file = tmp_path / "corner.seam.toml"
    file.write_text(CORNER.replace("75 stitch", "50 stitch"))
    spec = load_spec(PLACE, stitcher)
    varies = {
        f"{part}.{table}"
        for part, table in (("bodies.x_head", "inertia"), ("bodies.y_head", "inertia"),
                            ("links.x_belt", "stiffness"), ("links.y_belt", "stiffness"))
    }  # fmt: skip
    held = [path for one in uncertain(stitcher) for path in one.numbers if path not in varies]
    tolerances = replace(stitcher.tolerances, exclude=(*stitcher.tolerances.exclude, *held))
    machine = replace(two_parameters(stitcher, (1.0, 8.0)), tolerances=tolerances)

    def drawn_by_hand(found: ProvedDesign) -> tuple[float, float]:
        plan = plan_job(read_job(file, found.machine), found.machine, Options())
        return MachineYield(plan, found.spec).drawn(200, 7).interval

    plain = design(file, machine, spec, Options(), Requirements(effort=NO_REGION)).found
    assert plain is not None and plain.candidate.cost == 0.0
    assert drawn_by_hand(plain)[1] < 0.7
    for_yield = design(
        file, machine, spec, Options(), Requirements(trials=yielding(0.8), effort=NO_REGION)
    ).found
    assert for_yield is not None and for_yield.verdict.passed
    assert for_yield.verdict.result("rejects").measured <= 0.2
    assert for_yield.candidate.cost > 0.1
    assert drawn_by_hand(for_yield)[0] > 0.8
