"""The yield over the tolerances: each machine as if alone, the worst machine, and the command."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import threadline as tl
from tests.search.plans import JOB
from threadline.base.arrays import FloatArray
from threadline.base.workers import Done
from threadline.cli.main import main
from threadline.commands.plan import Plan
from threadline.files import tick_table
from threadline.machine import load_machine
from threadline.machine.variants import drawn, uncertain, variant
from threadline.proof import judge_runs, pipeline
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.proof.worst_machine import Worst, shares_of
from threadline.proof.worst_search import WorstSearch
from threadline.search import machine_yield
from threadline.search.machine_yield import MachineYield
from threadline.twin import simulate
from threadline.verdict import EachRun, Spec, judge, load_spec


def test_each_machine_is_judged_as_it_is_alone(asked: tuple[Plan, Spec], monkeypatch) -> None:
    """Parts of any size and any number of threads give the same bits; some are judged alone."""
    plan, spec = asked
    monkeypatch.setattr(machine_yield, "AT_ONCE", 23)
    through: list[int] = []
    monkeypatch.setattr(judge_runs, "AT_ONCE", 9)
    found = MachineYield(plan, spec, threads=3).drawn(60, 5, through.append)
    assert sum(through) == found.found.runs == 60
    monkeypatch.setattr(machine_yield, "AT_ONCE", 4096)
    monkeypatch.setattr(judge_runs, "AT_ONCE", 256)
    again = MachineYield(plan, spec).drawn(60, 5)
    for one, other in zip(found.found.rows, again.found.rows, strict=True):
        np.testing.assert_array_equal(one.values, other.values)
    parts = drawn(plan.machine, 5, np.arange(60))
    for index in (0, 31):
        machine = variant(plan.machine, parts[index])
        verdict = judge([simulate(tick_table(plan.commands), machine)], plan, spec)
        own = verdict.result("contour_error")
        assert found.found.row("contour_error").values[index] == pytest.approx(
            own.measured, rel=1e-9, abs=1e-12
        )
        assert bool(found.found.passed[index]) == verdict.passed
    assert 0 < found.passed < 60
    low, high = found.interval
    assert low < found.share < high


def test_the_worst_machine_is_no_better_than_any_drawn_and_can_be_proved(
    asked: tuple[Plan, Spec], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, _ = asked
    worst, folder = tmp_path / "worst.toml", tmp_path / "report"
    words = ["yield", str(JOB), "-m", "lathe-winder", "--variants", "300", "--worst", str(worst)]
    with pytest.raises(SystemExit) as ended:
        main([*words, "--report", str(folder), "--json"])
    assert ended.value.code == 1
    content = json.loads(capsys.readouterr().out)
    assert content["variants"] == 300
    assert (content["level"], content["runs"]) == ("drawn machines", 1)
    undrawn = content["not_drawn"]
    assert undrawn["axes.X.acceleration"] == "it affects only plans"
    assert {number.name for number in uncertain(plan.machine)}.isdisjoint(undrawn)
    assert content["interval"][0] < content["yield"] < content["interval"][1]
    contour = next(c for c in content["criteria"] if c["name"] == "contour_error")
    bad = content["worst"]
    assert bad["share_of_limit"] >= contour["quantiles"]["1.0"] / contour["limit"]
    assert (folder / "yield.png").stat().st_size > 10_000
    with pytest.raises(SystemExit):
        main(["prove", str(JOB), "-m", str(worst), "--nominal", "--json"])
    proved = json.loads(capsys.readouterr().out)
    shares = [
        c["measured"] / c["limit"]
        for c in proved["criteria"]
        if c["limit"] and c["name"] in ("contour_error", "progress_error", "turning_point_error")
    ]
    assert max(shares) == bad["share_of_limit"]
    assert len(uncertain(plan.machine)) > 12 and not bad["of_corners"]


def test_corners_lie_as_far_off_as_machines_are_drawn(tmp_path: Path) -> None:
    """The corner of a normal number is at three deviations, one and a half times its tolerance."""
    file = tmp_path / "mine.toml"
    names = [name for number in uncertain(load_machine("lathe-winder")) for name in number.numbers]
    others = [name for name in names if name != "bodies.x.inertia"]
    file.write_text(
        'base = "lathe-winder"\nname = "mine"\n[tolerances]\nnormal = ["bodies.x.inertia"]\n'
        f"exclude = {json.dumps(others)}\n",
        encoding="utf-8",
    )
    machine = load_machine(file)
    assert [number.name for number in uncertain(machine)] == ["bodies.x.inertia"]
    plan = plan_job(open_job(JOB, machine, Options()), machine, Options())
    study = MachineYield(plan, load_spec(None, machine))
    worst = study.worst()
    assert worst.of_corners and np.abs(worst.parts).tolist() == [1.5]
    shares, _ = machine_yield.shares_of(study.drawn(200, 1).found)
    assert worst.share >= shares.max()


def test_counts_per_unit_are_a_number_like_any_other(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With a pulley 1 % larger the load goes 1.8 mm beyond 180 mm, and ``prove`` finds the same."""
    file = tmp_path / "pulley.toml"
    names = [name for number in uncertain(load_machine("lathe-winder")) for name in number.numbers]
    others = [name for name in names if name != "axes.X.counts"]
    file.write_text(
        'base = "lathe-winder"\nname = "pulley"\n[axes.X]\n'
        'counts = "55.358 count/mm +- 1 %, assumed"\n'
        f"[tolerances]\nexclude = {json.dumps(others)}\n",
        encoding="utf-8",
    )
    words = [str(JOB), "-m", str(file)]
    with pytest.raises(SystemExit):
        worst = ["--worst", str(tmp_path / "worst.toml")]
        main(["yield", *words, "--variants", "20", *worst, "--json"])
    bad = json.loads(capsys.readouterr().out)["worst"]
    with pytest.raises(SystemExit):
        main(["prove", *words, "--actual", str(tmp_path / "worst.toml"), "--nominal", "--json"])
    criteria = json.loads(capsys.readouterr().out)["criteria"]
    contour = next(c for c in criteria if c["name"] == "contour_error")
    assert contour["measured"] / contour["limit"] == bad["share_of_limit"]
    # At full speed it trails by less than half a millimetre; at the turning point it overshoots.
    assert contour["measured"] == pytest.approx(180e-3 / 0.99 - 180e-3, abs=0.5e-3)


def test_a_climb_comes_to_the_worst_of_all_corners(tmp_path: Path) -> None:
    """Six numbers have 64 corners; the climb finds the worst of them in fewer than 64 trials.

    Each number alone is worst at its upper end, but the worst corner has the first at the lower.
    """
    file = tmp_path / "six.toml"
    six = ("x.torque_constant", "x.back_emf", "x.resistance", "y.torque_constant", "y.back_emf")
    varied = ["bodies.x.inertia", *(f"drives.{name}" for name in six)]
    names = [name for number in uncertain(load_machine("lathe-winder")) for name in number.numbers]
    others = [name for name in names if name not in varied]
    file.write_text(
        f'base = "lathe-winder"\nname = "six"\n[tolerances]\nexclude = {json.dumps(others)}\n'
    )
    machine = load_machine(file)
    plan = plan_job(open_job(JOB, machine, Options()), machine, Options())
    study = Made(plan, load_spec(None, machine))
    weights = np.array([0.03, 0.04, 0.03, 0.03, 0.03, 0.03])
    study.share_at = lambda parts: 0.5 + parts @ weights - 0.1 * parts[:, 0] * parts[:, 1]
    assert len(study.numbers) == 6
    found = study.worst()
    assert found.of_corners and found.parts.tolist() == [-1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    climb = WorstSearch(study, 50, corners=0)
    climb.begin()
    climb.go_on()
    share = shares_of(climb.found)[0][climb.worst()]
    assert share == pytest.approx(found.share, rel=1e-12)
    assert climb.searched < 64


class Made(MachineYield):
    """Machines with made-up used shares, which are a function of their (k, n) parts."""

    share_at: Callable[[FloatArray], FloatArray]

    def judged(self, parts: FloatArray, done: Done | None = None) -> EachRun:
        found, shares = super().judged(parts, done), self.share_at(parts)
        rows = [replace(row, values=row.limit * shares) if row.limit else row for row in found.rows]
        return replace(found, rows=rows)

    def worst_at(
        self, parts: FloatArray, share: float, binding: str, *, of_corners: bool = False
    ) -> Worst:
        found = super().worst_at(parts, share, binding, of_corners=of_corners)
        return replace(found, share=share)  # by itself the machine has its real share


@pytest.mark.parametrize("most_corners", [12, 0])
def test_the_worst_machine_may_lie_inside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, most_corners: int
) -> None:
    """The used share is largest half-way to an end of the tolerance: no corner is as bad."""
    file = tmp_path / "one.toml"
    names = [name for number in uncertain(load_machine("lathe-winder")) for name in number.numbers]
    others = [name for name in names if name != "bodies.x.inertia"]
    file.write_text(
        f'base = "lathe-winder"\nname = "one"\n[tolerances]\nexclude = {json.dumps(others)}\n',
        encoding="utf-8",
    )
    machine = load_machine(file)
    plan = plan_job(open_job(JOB, machine, Options()), machine, Options())
    study = Made(plan, load_spec(None, machine))
    study.share_at = lambda parts: np.interp(
        parts[:, 0], [-1.0, 0.0, 0.5, 1.0], [0.1, 0.7, 1.0, 0.8]
    )
    monkeypatch.setattr(machine_yield, "MOST_CORNERS", most_corners)
    worst = study.worst()
    assert (worst.parts.tolist(), worst.share, worst.of_corners) == ([0.5], 1.0, False)
    known = study.drawn(20, 1)
    worst = study.worst(known)
    assert worst.share >= shares_of(known.found)[0].max() > 0.9
    assert np.all(np.abs(worst.parts) < 1.0) and not worst.of_corners


@pytest.mark.long(but="50")
@pytest.mark.parametrize("drawn", [50, 200])
def test_half_a_tolerance_of_what_matters_helps_most(asked: tuple[Plan, Spec], drawn: int) -> None:
    plan, spec = asked
    judged = MachineYield(plan, spec)
    own = judged.drawn(drawn, 1).share
    halves = dict(zip((n.name for n in judged.numbers), judged.halved(drawn, 1), strict=True))
    # A limit switch that is never reached has no effect on the machine.
    assert halves["inputs.x_low.at"] == own
    assert max(halves.values()) > own


@pytest.mark.parametrize(
    ("job", "name", "measure"),
    [
        ("letter-cycle.toml", "letter-placer", "residual_vibration"),
        ("rosette.dst", "schiffli-frame", "stitch_residual"),
        ("x-180.prg", "stepper-winder", "step_loss"),
    ],
)
def test_machines_of_every_kind_are_drawn(job: str, name: str, measure: str) -> None:
    """On/off machines, frames and steppers: each equals its variant simulated and judged alone."""
    machine = load_machine(name)
    plan = plan_job(open_job(JOB.parent / job, machine, Options()), machine, Options())
    spec = load_spec(None, machine)
    found = MachineYield(plan, spec).drawn(2, 1)
    assert found.found.runs == 2
    for index, parts in enumerate(drawn(machine, 1, np.arange(2))):
        # By hand: the same commands on the other machine.
        made = variant(machine, parts)
        table = replace(plan.commands, machine_sha256=made.sha256)
        verdict = judge([pipeline.simulate(table, made)], plan, spec)
        assert found.found.passed[index] == verdict.passed
        for row in found.found.rows:
            if row.name == measure:
                own = [
                    r.measured
                    for r in verdict.results
                    if (r.name, r.axis, r.step) == (row.name, row.axis, row.step)
                ]
                assert own == [row.values[index]]
    assert any(row.name == measure for row in found.found.rows)


@pytest.mark.parametrize(
    ("job", "name", "overlay", "words"),
    [
        ("x-180.prg", "lathe-winder", "stiction", {"interpolation": "linear"}),
        ("letter-cycle.toml", "letter-placer", "own-damping", {}),
        ("rosette.dst", "schiffli-frame", "ten-yards", {"feed": "60 stitch/min"}),
    ],
)
def test_machines_like_the_one_that_runs_are_drawn(
    job: str, name: str, overlay: str, words: dict[str, str]
) -> None:
    """The overlay leaves the commands as they are, so the other machine's own yield is the same."""
    file = JOB.parent / job
    found = tl.yields(file, name, actual=f"{name}+{overlay}", variants=2, **words)
    own = tl.yields(file, f"{name}+{overlay}", variants=2, **words)
    planned_for = tl.yields(file, name, variants=2, **words)
    measured, alone, other = (
        np.stack([row.values for row in one.found.rows]) for one in (found, own, planned_for)
    )
    assert np.array_equal(measured, alone, equal_nan=True)
    assert not np.array_equal(measured, other, equal_nan=True)


@pytest.mark.long(only="rosette.dst-schiffli-frame-more0")
@pytest.mark.parametrize(
    ("job", "name", "more"),
    [
        # The frame and the feed-forward are planned with numbers that vary.
        ("rosette.dst", "schiffli-frame", []),
        ("x-180.prg", "lathe-winder", ["--feed-forward", "--tolerance", "0.05 mm"]),
        ("x-180.prg", "stepper-winder", []),
        # The worst machine is one like the machine that runs.
        ("x-180.prg", "lathe-winder", ["--actual", "lathe-winder+stiction"]),
    ],
)
def test_the_command_that_is_told_proves_the_worst_machine(
    job: str, name: str, more: list[str], tmp_path: Path, capsys, monkeypatch
) -> None:
    """It plays the commands planned for the file's machine, to the bit."""
    monkeypatch.setattr(WorstSearch, "begin", lambda _: None)
    monkeypatch.setattr(WorstSearch, "go_on", lambda _: None)
    worst = str(tmp_path / "worst machine.toml")
    words = ["yield", str(JOB.parent / job), "-m", name, *more, "--variants", "2"]
    with pytest.raises(SystemExit):
        main([*words, "--worst", worst, "--json"])
    content = json.loads(capsys.readouterr().out)
    command = shlex.split(content["command"])
    assert command[:2] == ["threadline", "prove"]
    with pytest.raises(SystemExit):
        main([*command[1:], "--json"])
    proved = json.loads(capsys.readouterr().out)
    shares = {
        " ".join(filter(None, (c["name"], c["axis"]))): c["measured"] / c["limit"]
        for c in proved["criteria"]
        if c["limit"] and c["measured"] is not None
    }
    bad = content["worst"]
    assert shares[bad["criterion"]] == bad["share_of_limit"]


@pytest.mark.long(shown_by="test_machines_of_every_kind_are_drawn")
def test_machines_over_tolerances_of_a_frame_are_proved() -> None:
    """Each machine has the commands of the file's machine, and a hash of its own."""
    machine = load_machine("schiffli-frame")
    plan = plan_job(open_job(JOB.parent / "rosette.dst", machine, Options()), machine, Options())
    trials = pipeline.Trials(repeats=1, machines=2)
    proof = pipeline.prove_plan(plan, load_spec(None, machine), trials=trials)
    assert proof.verdict.machines == 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["x-180.prg", "-m", "lathe-winder", "--variants", "0"], "--variants"),
    ],
)
def test_yield_refuses_an_impossible_request_in_one_line(
    words, message, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["yield", str(JOB.parent / words[0]), *words[1:]])
    captured = capsys.readouterr()
    assert (ended.value.code, captured.out, captured.err.count("\n")) == (2, "", 1)
    assert message in captured.err


def test_a_worst_machine_beyond_a_limit_of_0_is_told_by_what_it_does(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """One sample at the clamp has no share of a limit of 0; once it was "cannot be simulated"."""
    worst, spec = tmp_path / "worst.toml", tmp_path / "wide.spec.toml"
    spec.write_text('name = "wide"\n[[criteria]]\nname = "dac_saturation"\nlimit = "0 %"\n')
    words = [
        str(JOB), "-m", "lathe-winder", "--limits", "19 %", "--feed", "1000 count/tick",
        "-s", str(spec),
    ]  # fmt: skip
    with pytest.raises(SystemExit):
        main(["yield", *words, "--variants", "20", "--seed", "3", "--worst", str(worst)])
    output = " ".join(capsys.readouterr().out.split())
    found = re.search(r"worst machine, [a-z ]+: ([\d.]+) % of dac_saturation X, limit 0 %", output)
    assert found, output
    assert "of dac_saturation X, limit 0 %" in worst.read_text(encoding="utf-8")
    with pytest.raises(SystemExit):
        main(["prove", *words, "--actual", str(worst), "--nominal", "--json"])
    rows = json.loads(capsys.readouterr().out)["criteria"]
    (row,) = (r for r in rows if (r["name"], r["axis"]) == ("dac_saturation", "X"))
    assert row["status"] == "failed"
    assert 100.0 * row["measured"] == pytest.approx(float(found[1]), rel=1e-2)


def test_machines_of_equal_dead_times_are_simulated_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each machine of the stitcher has two dead times; alone it would cost ten times as much."""
    machine = load_machine("stitcher")
    job = JOB.with_name("stitcher-test-path.seam.toml")
    plan = plan_job(open_job(job, machine, Options()), machine, Options())
    study = MachineYield(plan, load_spec(None, machine))
    together: list[int] = []

    def counted(self: object, item: judge_runs.Variants, done: object = None) -> None:
        together.append(item.count)
        raise EOFError

    monkeypatch.setattr(judge_runs.RunsJudge, "answer", counted)
    with pytest.raises(EOFError):
        study.drawn(20_000, 5)
    assert together[0] > 16  # the rarest pairs of dead times: a 400th of 16 384
