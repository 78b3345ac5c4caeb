"""The yield over the tolerances: intervals, distributions, the worst machine, what it hangs on."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom

from threadline.cli.main import main
from threadline.machine import load_machine
from threadline.machine.variants import drawn, uncertain, variant
from threadline.options import Options
from threadline.pipeline import open_job, plan_job
from threadline.plan import Plan
from threadline.search import judge_runs, machine_yield
from threadline.search.influence import influence
from threadline.search.machine_yield import MachineYield, clopper_pearson
from threadline.signals import tick_table
from threadline.twin import simulate
from threadline.verdict import Spec, judge, load_spec

JOB = Path(__file__).parents[2] / "examples" / "x-180.prg"


@pytest.fixture(scope="module")
def asked() -> tuple[Plan, Spec]:
    machine = load_machine("lathe-winder")
    plan = plan_job(open_job(JOB, machine, Options()), machine, Options())
    return plan, load_spec(None, machine)


@pytest.mark.parametrize(("passed", "tried"), [(1, 10), (37, 50), (9_990, 10_000)])
def test_the_interval_leaves_each_tail_its_share(passed: int, tried: int) -> None:
    """Against the binomial distribution itself: 2.5 % at either end."""
    low, high = clopper_pearson(passed, tried)
    assert binom.sf(passed - 1, tried, low) == pytest.approx(0.025, rel=1e-9)
    assert binom.cdf(passed, tried, high) == pytest.approx(0.025, rel=1e-9)


def test_all_of_them_say_at_least_so_much() -> None:
    """p^n = 2.5 %, in closed form."""
    assert clopper_pearson(10_000, 10_000) == (pytest.approx(0.025 ** (1 / 10_000)), 1.0)
    assert clopper_pearson(0, 10) == (0.0, pytest.approx(1.0 - 0.025**0.1))


def test_each_machine_is_judged_as_it_is_alone(asked: tuple[Plan, Spec], monkeypatch) -> None:
    """In parts of any size and by any threads the same bits; some simulated and judged alone."""
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
    assert content["interval"][0] < content["yield"] < content["interval"][1]
    contour = next(c for c in content["criteria"] if c["name"] == "contour_error")
    bad = content["worst"]
    # Counts per unit stay as they are in the worst machine, and not in those that were drawn.
    assert bad["share_of_limit"] > 0.99 * contour["quantiles"]["1.0"] / contour["limit"]
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


def test_half_a_tolerance_of_what_matters_helps_most(asked: tuple[Plan, Spec]) -> None:
    plan, spec = asked
    judged = MachineYield(plan, spec)
    own = judged.drawn(200, 1).share
    halves = dict(zip((n.name for n in judged.numbers), judged.halved(200, 1), strict=True))
    # A limit switch that is never met changes nothing, to the machine.
    assert halves["inputs.x_low.at"] == own
    assert max(halves.values()) > own


def test_indices_are_those_of_ishigami() -> None:
    """sin x1 + a sin^2 x2 + b x3^4 sin x1 on [-pi, pi]^3, a = 7, b = 0.1.

    Closed form (Ishigami and Homma, 1990): V1 = (1 + b pi^4 / 5)^2 / 2, V2 = a^2 / 8,
    V13 = b^2 pi^8 (1 / 18 - 1 / 50), and nothing else. 1 % is what 2^14 samples give.
    """
    a, b = 7.0, 0.1

    def ishigami(parts: np.ndarray) -> np.ndarray:
        x = np.pi * parts
        return np.sin(x[:, 0]) * (1.0 + b * x[:, 2] ** 4) + a * np.sin(x[:, 1]) ** 2

    found = influence(ishigami, [False] * 3, 2**14, 1)
    one = 0.5 * (1.0 + b * np.pi**4 / 5.0) ** 2
    two, both = a**2 / 8.0, b**2 * np.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    whole = one + two + both
    assert found.first == pytest.approx([one / whole, two / whole, 0.0], abs=0.01)
    assert found.total == pytest.approx([(one + both) / whole, two / whole, both / whole], abs=0.01)
    for values, ends in (
        (found.first, found.first_interval),
        (found.total, found.total_interval),
    ):
        assert (ends[0] <= values).all() and (values <= ends[1]).all()


def test_a_normal_number_is_cut_off_at_three_deviations() -> None:
    seen: list[np.ndarray] = []

    def result(parts: np.ndarray) -> np.ndarray:
        seen.append(parts)
        return parts.sum(axis=1)

    influence(result, [True, False], 2**8, 1)
    parts = np.concatenate(seen)
    assert np.abs(parts[:, 0]).max() <= 1.5 < 10 * np.abs(parts[:, 0]).max()
    assert parts[:, 0].std() == pytest.approx(0.4933, abs=0.02)  # of a normal cut off at 3
    assert np.abs(parts[:, 1]).max() <= 1.0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["letter-cycle.toml", "-m", "letter-placer"],
            "letter-placer has none. Judge drawn machines of it with threadline prove --tolerances",
        ),
        (["x-180.prg", "-m", "lathe-winder", "--variants", "0"], "--variants"),
    ],
)
def test_what_cannot_be_drawn_is_refused(words, said, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["yield", str(JOB.parent / words[0]), *words[1:]])
    told = capsys.readouterr()
    assert (ended.value.code, told.out, told.err.count("\n")) == (2, "", 1)
    assert said in told.err
