"""The levels of a verdict: one run, twenty runs, other machines within the tolerances."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from fractions import Fraction
from math import comb
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
from threadline.machine.vary import Days, drawn_days, vary
from threadline.proof import worst_search
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
from threadline.proof.worst_machine import WithinTolerances
from threadline.proof.worst_search import WorstSearch
from threadline.twin import simulate
from threadline.verdict import (
    Criterion,
    CriterionRow,
    EachRun,
    Spec,
    Status,
    closing,
    judge,
    load_spec,
    with_lines,
)
from threadline.verdict.each_run import at_least, with_other_machines

EXAMPLES = Path(__file__).parents[1] / "examples"


def plan_of(reference: str) -> tuple[Plan, Spec]:
    machine = load_machine(reference)
    job = open_job(EXAMPLES / "x-180.prg", machine, Options())
    return plan_job(job, machine, Options()), load_spec(None, machine)


def test_twenty_runs_side_by_side_are_twenty_runs_one_after_the_other() -> None:
    """Each day is simulated and judged alone, with the factors drawn again: the same verdict."""
    plan, spec = plan_of("lathe-winder+stiction")
    proof = prove_plan(plan, spec, trials=REPEATED)
    random, days = np.random.default_rng(1994), [simulate(tick_table(plan.commands), plan.machine)]
    for _ in range(19):
        machine = vary(
            plan.machine, friction=random.uniform(0.7, 1.3), supply=random.uniform(0.95, 1.05)
        )
        phase = random.uniform(0.0, 1.0, len(plan.axes))
        days.append(simulate(tick_table(plan.commands), machine, encoder_phase=phase))
    single = judge(days, plan, spec)
    assert proof.verdict.runs == single.runs == 20
    assert proof.verdict.level == single.level == "repeated"
    for mine, theirs in zip(proof.verdict.results, single.results, strict=True):
        assert (mine.name, mine.axis, mine.status) == (theirs.name, theirs.axis, theirs.status)
        # Lengths in m, currents in A: the effect of other time steps of the matrix exponential.
        assert mine.measured == pytest.approx(theirs.measured, rel=1e-9, abs=1e-12)
        assert mine.job_line == theirs.job_line
    spread = proof.verdict.result("repeatability")
    assert spread.status is not Status.NOT_MEASURED
    assert spread.measured is not None and spread.measured > 1e-6
    assert closing(proof.verdict).split("(")[1].startswith("repeated: 20 runs")


@pytest.mark.long(shown_by="test_twenty_runs_side_by_side_are_twenty_runs_one_after_the_other")
def test_twenty_runs_near_a_limit_are_not_believed() -> None:
    """0.039 mm of 0.045 mm in the 20 runs of our seed; 1200 runs have 0.048 mm, which is out."""
    machine = load_machine("lathe-winder")
    spec = load_spec(None, machine)
    criteria = tuple(
        replace(one, limit=45e-6) if one.name == "repeatability" else one for one in spec.criteria
    )
    tight = replace(spec, criteria=criteria)
    words = {"interpolation": "optimal", "feed": "1000 count/tick", "feed_forward": True}
    job = EXAMPLES / "cone-dome-cylinder.prg"
    few = tl.prove(job, "lathe-winder", repeats=21, spec=tight, **words)
    assert few.passed and few.verdict.runs == 21
    many = tl.prove(job, "lathe-winder", spec=tight, **words)
    spread = many.verdict.result("repeatability")
    assert (many.verdict.runs, many.verdict.level, many.passed) == (1200, "repeated", False)
    assert spread.measured > 45e-6 and "in the first 20 runs" in spread.note
    assert "1200 runs, at least 99.7 % of all runs" in closing(many.verdict)
    # Enough for the worst of any 20 runs in 19 of 20 cases.
    assert many.json()["covers"] ** 20 >= 0.95
    far = tl.prove(job, "lathe-winder", **words)
    assert far.verdict.runs == 20 and far.passed


@pytest.mark.parametrize(("passed", "tried"), [(200, 200), (197, 200), (1, 40), (0, 9)])
def test_the_bound_of_drawn_machines_is_that_of_the_binomial(passed: int, tried: int) -> None:
    """At the bound the chance of so many passes or more is 5 %, by exact fractions."""
    least = Fraction(at_least(passed, tried))
    chance = sum(
        comb(tried, k) * least**k * (1 - least) ** (tried - k) for k in range(passed, tried + 1)
    )
    assert float(chance) == pytest.approx(0.05 if passed else 1.0, rel=1e-9)


@pytest.mark.long(shown_by="test_the_worst_of_other_machines_has_the_line_of_its_own_proof")
def test_the_worst_machine_counts_in_twenty_runs_as_it_is_proved_alone() -> None:
    """Its file, planned for the machine of the file, gives every figure to the bit."""
    plan, spec = plan_of("lathe-winder")
    repeated = prove_plan(plan, spec, trials=REPEATED).verdict
    proof = prove_plan(plan, spec, trials=Trials(repeats=20, machines=12))
    over, tolerances = proof.verdict, proof.verdict.tolerances
    assert (over.level, over.runs, over.machines) == ("over tolerances", 20, 12)
    assert tolerances is not None and proof.worst is not None
    single = prove_plan(
        plan, spec, trials=REPEATED, actual=variant(plan.machine, proof.worst.parts)
    ).verdict
    assert single.tightest is not None and over.tightest is not None
    assert tolerances.share == single.tightest.measured / single.tightest.limit
    assert tolerances.criterion == single.tightest.name == "contour_error"
    assert over.tightest.measured == single.tightest.measured > repeated.tightest.measured
    spread = over.result("repeatability").measured
    assert spread == max(v.result("repeatability").measured for v in (repeated, single))
    # The worst run is kept, so that a report can draw it.
    worst = over.result("contour_error")
    assert worst.run is not None and worst.run > 20 and worst.note.endswith("machine searched")
    assert proof.run(worst.run).runs == 1
    assert closing(over) == (
        f"OUT OF SPEC (over tolerances: 20 runs; the worst of {tolerances.searched} machines "
        "searched uses 124 % of contour_error; 10 of 12 drawn machines in spec, so "
        "at least 56.1 % of all, with 95 % confidence)"
    )
    assert TOLERANCES.machines == 200


def test_the_worst_of_other_machines_has_the_line_of_its_own_proof() -> None:
    plan, spec = plan_of("lathe-winder")
    within = WithinTolerances(plan, spec)
    parts = within.singles[:8]
    # The order of the machines is kept; the last one would be left out.
    found = EachRun.joined([within.judged(parts[4:]), within.judged(parts[:4])])
    found = found.taken(np.array([4, 5, 6, 7, 0, 1, 2]))
    nominal = prove_plan(plan, spec).verdict
    results = with_lines(with_other_machines(nominal, found).results, plan)
    others = [r for r in results if r.note.endswith("a machine within the tolerances")]
    assert {"contour_error", "progress_error", "tracking_error"} <= {r.name for r in others}
    one_by_one = [
        prove_plan(plan, spec, actual=variant(plan.machine, one)).verdict for one in parts[:7]
    ]
    for result in others:
        same = [one.result(result.name, result.axis) for one in one_by_one]
        worst = max(same, key=lambda r: -1.0 if r.measured is None else r.measured)
        assert result.measured == pytest.approx(worst.measured, rel=1e-9)
        assert (result.time_s, result.job_line) == (worst.time_s, worst.job_line)
        assert result.passes == worst.passes
        assert (result.job_line is None) == (result.name == "current_rms"), result


def test_drawn_machines_that_all_pass_do_not_make_a_pass() -> None:
    """With 17.6777 % of the limits 200 of 200 drawn machines pass, and others reach 118 %."""
    words = {"limits": "17.6777 %", "feed": "1000 count/tick"}
    proof = tl.prove(EXAMPLES / "x-180.prg", "lathe-winder", level="over tolerances", **words)
    tolerances = proof.json()["tolerances"]
    assert (tolerances["drawn"], tolerances["passed"], tolerances["confidence"]) == (200, 200, 0.95)
    assert tolerances["at_least"] == pytest.approx(0.05 ** (1 / 200))
    assert tolerances["worst_share"] > 1.17 and not proof.passed


def test_a_search_tries_first_what_failed_before() -> None:
    """A search ends at a failing machine, which is tried first at the next pace."""
    plan, spec = plan_of("lathe-winder")
    suspects: list[np.ndarray] = []
    first = try_plan(plan, spec, TOLERANCES, suspects=suspects).verdict
    assert not first.passed and len(suspects) == 1 and first.level == "over tolerances"
    again = try_plan(plan, spec, TOLERANCES, suspects=suspects).verdict
    assert not again.passed and again.tolerances is not None
    assert (again.tolerances.searched, again.tolerances.drawn) == (1, 0)
    # A plan that passes with suspects passes without them, to the bit.
    wide = replace(spec, criteria=tuple(replace(c, limit=1.0) for c in spec.criteria if not c.hard))
    hasty = try_plan(plan, wide, Trials(repeats=2, machines=3), suspects=suspects).verdict
    assert hasty == prove_plan(plan, wide, trials=Trials(repeats=2, machines=3)).verdict
    assert hasty.passed


class Rugged:
    """Machines with a criterion that depends on 12 numbers, and on pairs of them."""

    together = True
    replayed = False

    def __init__(self, plan: Plan, seed: int) -> None:
        self.plan, self.numbers = plan, uncertain(plan.machine)
        self.ends = np.ones(len(self.numbers))
        self.singles = np.kron(np.eye(len(self.numbers)), [[-1.0], [1.0]])
        random = np.random.default_rng(seed)
        self._alone, self._pairs = random.normal(size=12), np.triu(random.normal(size=(12, 12)), 1)

    def shares(self, parts: np.ndarray) -> np.ndarray:
        own = parts[:, :12]
        together = np.einsum("ki,ij,kj->k", own, self._pairs, own)
        return np.asarray(0.5 + 0.01 * (own @ self._alone + together))

    def judged(self, parts: np.ndarray, done: object = None) -> EachRun:
        return one_criterion(self.shares(parts))

    def in_days(self, parts: np.ndarray, days: Days) -> EachRun:
        """On the last day the last machine is by far the worst."""
        shares = np.repeat(self.shares(parts), len(days))
        shares[-1] += 1.0
        return one_criterion(shares)


def one_criterion(values: np.ndarray) -> EachRun:
    row = CriterionRow(
        name="contour_error", axis="", step="", limit=1.0, unit="m", required=True, hard=False,
        values=values, failed=values > 1.0,
    )  # fmt: skip
    return EachRun(rows=(row,), runs=len(values))


@pytest.mark.parametrize("landscape", [2, 7])
def test_searches_of_different_seeds_find_the_worst_of_all_corners(landscape: int) -> None:
    """4096 corners of twelve numbers that act in pairs: each search tries a quarter of them."""
    plan, _ = plan_of("lathe-winder")
    rugged = Rugged(plan, landscape)
    ends = np.zeros((1 << 12, len(rugged.numbers)))
    ends[:, :12] = np.where((np.arange(1 << 12)[:, None] >> np.arange(12)) & 1, 1.0, -1.0)
    most = rugged.shares(ends).max()
    for seed in range(5):
        search = WorstSearch(rugged, 1000, seed=seed)  # type: ignore[arg-type]
        search.begin()
        search.go_on()
        assert rugged.shares(search.parts[[search.worst()]])[0] > most - 0.02 * most
        assert search.searched < 1100


def test_the_worst_machine_is_the_worst_over_several_days() -> None:
    plan, _ = plan_of("lathe-winder")
    search = WorstSearch(Rugged(plan, 0))  # type: ignore[arg-type]
    search.begin()
    search.go_on()
    at = search.worst_of_days(drawn_days(4, 3, np.random.default_rng(1)))
    assert at != search.worst()


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


@pytest.mark.long(but="x-180.prg-lathe-winder-1")
@pytest.mark.parametrize(
    ("job", "machine", "status"),
    [
        ("x-180.prg", "lathe-winder", 1),
        ("stitcher-test-path.seam.toml", "exact.toml", 1),
        ("x-180.prg", "stepper-winder", 0),
    ],
)
def test_the_file_of_the_worst_machine_gives_its_figure_to_the_bit(
    job: str,
    machine: str,
    status: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """This holds for any machine found in a short search; each dead time would need a kernel."""
    base, exact = EXAMPLES / "stitcher-75-place.toml", 'delay = "3 ms exact, printed"'
    monkeypatch.chdir(tmp_path)
    Path("exact.toml").write_text(f'base = "{base}"\n[drives.x]\n{exact}\n[drives.y]\n{exact}\n')
    monkeypatch.setattr(worst_search, "SEARCHED", 60)
    monkeypatch.setattr(worst_search, "SEARCHED_SERIAL", 10)
    file = tmp_path / "deep" / "worst.toml"
    words = ["prove", str(EXAMPLES / job), "-m", machine]
    with pytest.raises(SystemExit) as ended:
        main([*words, "--tolerances", "--worst", str(file), "--json"])
    assert ended.value.code == status
    over = json.loads(capsys.readouterr().out)
    again = shlex.split(over["worst"]["command"])
    assert again[0] == "threadline" and again[-2:] == ["--actual", str(file)]
    with pytest.raises(SystemExit):
        main([*again[1:], "--json"])
    single = json.loads(capsys.readouterr().out)
    assert single["level"] == "repeated"
    assert single["tightest"]["share_of_limit"] == over["tolerances"]["worst_share"]
    assert single["tightest"]["name"] == over["tolerances"]["worst_criterion"]


def test_a_report_in_python_has_the_worst_machine_as_on_the_command_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same bytes by both doors; but no report replaces the machine file of its own proof."""
    monkeypatch.setattr(worst_search, "SEARCHED", 12)
    monkeypatch.setattr(worst_search, "SEARCHED_SERIAL", 10)
    monkeypatch.chdir(tmp_path)
    job = tmp_path / "turn.prg"
    job.write_text("G91\nG1 X2 F1000\nM30\n", encoding="utf-8")
    typed = ["prove", str(job), "-m", "lathe-winder", "--tolerances", "--report", "typed"]
    with pytest.raises(SystemExit):
        main(typed)
    proof = tl.prove(job, "lathe-winder", level="over tolerances")
    page = proof.report("called")
    assert page.parent == Path("called")
    written = Path("called/worst.toml").read_bytes()
    assert written and written == Path("typed/worst.toml").read_bytes()
    tl.prove(job, "lathe-winder", level="nominal").report("plain")
    assert not Path("plain/worst.toml").exists()
    actual = tl.load_machine("called/worst.toml")
    own = replace(proof, of=replace(proof.of, actual=actual))
    with pytest.raises(OptionError, match=r"worst\.toml"):
        own.report("called")
    assert Path("called/worst.toml").read_bytes() == written


def test_the_worst_machine_is_of_one_level_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["prove", str(EXAMPLES / "x-180.prg"), "-m", "lathe-winder", "--worst", "w.toml"])
    assert ended.value.code == 2
    assert "Give --tolerances as well" in capsys.readouterr().err


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
    for words, message in (
        ([], "repeated: 20 runs"),
        (["--nominal"], "nominal: 1 run"),
        (["--repeats", "3"], "nominal: 3 runs"),
    ):
        with pytest.raises(SystemExit):
            main(["prove", *job, *words])
        assert message in capsys.readouterr().out.splitlines()[-1]
    with pytest.raises(SystemExit) as ended:
        main(["prove", *job, "--nominal", "--tolerances"])
    assert ended.value.code == 2
    assert "--nominal and --tolerances ask for different levels" in capsys.readouterr().err


def test_the_list_of_runs_says_how_far_each_proof_reaches(tmp_path: Path) -> None:
    """A run is one run; its proof may have one run, twenty, or other machines as well."""
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
    (tmp_path / "proof.json").write_text("[", "utf-8")  # only the index is left
    assert listed(other, tmp_path)[5] == "not passed (over tolerances)"
