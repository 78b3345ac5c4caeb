"""The front of cost against yield: counted again, and no omitted candidate beats it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from scipy.stats import binomtest

from tests.blank_pictures import blank_pictures
from threadline.cli import design as command
from threadline.cli.main import main
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.search import design as of_search
from threadline.search.design_evaluate import Effort
from threadline.search.design_front import CandidateYield, marked
from threadline.search.machine_yield import MachineYield
from threadline.verdict import load_spec

TURN = "G91\nG1 X5 F2000\nG1 X-5\nM30\n"
CLOSE = """
name = "close"
[[criteria]]
name = "tracking_error"
axis = "X"
limit = "1.06 mm"
"""
QUICK = Effort(sample_log2=5, settings_log2=2, proposals=8, rounds=3, trade_rounds=2, side=0)


@pytest.mark.long(shown_by="test_front_keeps_the_cheapest_of_equal_yields")
def test_a_front_is_counted_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    blank_pictures(monkeypatch)
    Path("turn.prg").write_text(TURN)
    Path("close.toml").write_text(CLOSE)
    monkeypatch.setattr(of_search, "THOROUGH", QUICK)
    words = ["design", "turn.prg", "-m", "lathe-winder", "-s", "close.toml", "--nominal"]
    words += ["--interpolation", "linear", "--front", "40", "--json", "--report", "report"]
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 0
    content = json.loads(capsys.readouterr().out)
    front = content["front"]
    costs = [one["cost"] for one in front]
    assert costs == sorted(costs) and costs[0] == 0.0 and len(front) > 2
    for one in front:
        passed, machines = one["passed"], one["machines"]
        exact = binomtest(passed, machines).proportion_ci()
        assert machines == 40 and one["yield"] == passed / 40
        assert one["interval"] == pytest.approx([exact.low, exact.high], abs=1e-9)
        cheaper = [k["passed"] for k in front if k["cost"] <= one["cost"] and k is not one]
        assert one["on_front"] == (passed > max(cheaper, default=-1))
    assert front[-1]["passed"] > front[0]["passed"]  # higher cost buys more machines in spec

    machine, options = load_machine("lathe-winder"), Options(interpolation="linear")
    plan = plan_job(open_job(Path("turn.prg"), machine, options), machine, options)
    own = MachineYield(plan, load_spec(Path("close.toml"), machine)).drawn(40, 1)
    assert own.passed == front[0]["passed"]
    assert (Path("report") / "design-front.png").exists() or list(Path("report").glob("*front*"))


def test_front_keeps_the_cheapest_of_equal_yields() -> None:
    def of(cost: float, passed: int) -> CandidateYield:
        return CandidateYield(cost=cost, factors={"m": cost}, passed=passed, machines=10)

    found = marked([of(3.0, 9), of(0.0, 0), of(1.0, 9), of(1.0, 10), of(2.0, 10)])
    assert [(one.cost, one.passed) for one in found if one.on_front] == [(0.0, 0), (1.0, 10)]


def test_candidates_that_differ_in_settings_alone_are_one_row() -> None:
    """Nobody can tell two rows apart that print the same."""
    found = [
        CandidateYield(cost=cost, factors={"m": 1.0 + cost}, passed=passed, machines=9)
        for cost, passed in ((0.0, 3), (0.0, 5), (2e-4, 5), (0.1, 5))
    ]
    rows = [(one.cost, one.passed, one.on_front) for one in marked(found)]
    assert rows == [(0.0, 5, True), (0.0, 3, False), (0.1, 5, False)]


def test_a_negative_front_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.Seeking().front == 0
    with pytest.raises(SystemExit) as ended:
        main(["design", "turn.prg", "-m", "lathe-winder", "--front", "-1"])
    assert ended.value.code == 2 and "--front" in capsys.readouterr().err
