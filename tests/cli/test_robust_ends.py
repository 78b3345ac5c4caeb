"""``fastest --robust`` and ``prove --ends``: one plan on machines at the ends of tolerances."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest

import threadline as tl
from threadline.cli.main import main
from threadline.errors import OptionError
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.machine.vary import band_parts, ends_of, mode_off, off_tolerance
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, Trials, plan_job, prove_plan, try_plan
from threadline.verdict import Result, Status, Verdict, load_spec
from threadline.verdict.each_run import worst_of

pytestmark = pytest.mark.usefixtures("coarse_search")

EXAMPLES = Path(__file__).parents[2] / "examples"
X180 = str(EXAMPLES / "x-180.prg")
SPAN = ("--low", "36 mm/s", "--high", "40 mm/s", "--nominal")


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as stopped:
        main([*words])
    captured = capsys.readouterr()
    return int(stopped.value.code or 0), captured.out, captured.err


@pytest.mark.long(shown_by="test_the_worst_of_each_criterion_counts")
def test_one_plan_holds_on_every_machine_and_what_that_costs_is_said(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The inertia of X is +-5 %: the lag, and with it the error, grows with it.

    Each machine alone shows that the plan holds, and that a faster plan does not.
    """
    asked = ("fastest", X180, "-m", "lathe-winder", "--interpolation", "linear", *SPAN)
    code, out, _ = run(capsys, *asked, "--robust", "100 %", "--json")
    content = json.loads(out)
    assert code == 0
    answer = content["certainty"]
    assert answer["machines"] == 3  # no springs: nominal, lighter and heavier loads
    assert answer["unit"] == "s"
    assert answer["alone"] < answer["best"] == content["duration_s"]
    assert answer["slower"] == pytest.approx(answer["best"] / answer["alone"] - 1.0)
    machine = load_machine("lathe-winder")
    spec = load_spec(None, machine)

    def passes(feed_m_s: float) -> list[bool]:
        feed = parse_feed(f"{feed_m_s!r} m/s")
        options = Options(interpolation="linear", feed=feed)
        plan = plan_job(read_job(X180, machine), machine, options)
        actual = [machine, *(off_tolerance(machine, mass=m) for m in (-1.0, 1.0))]
        return [try_plan(plan, spec, NOMINAL, one).verdict.passed for one in actual]

    assert passes(content["best"]) == [True] * 3
    faster = passes(39.4e-3)
    assert faster[0] and not all(faster)
    # The printed command is typed back: in spec, by the same worst machine.
    words = shlex.split(content["command"])
    assert words[0] == "threadline"
    code, out, _ = run(capsys, *words[1:])
    assert code == 0
    assert "2 at the ends of the tolerances of loads and springs, one run each" in out


def test_a_proof_says_on_which_machine_it_was_worst(capsys: pytest.CaptureFixture[str]) -> None:
    words = ("prove", X180, "-m", "lathe-winder", "--interpolation", "linear", "--nominal")
    assert run(capsys, *words, "--feed", "39.4 mm/s")[0] == 0
    code, out, _ = run(capsys, *words, "--feed", "39.4 mm/s", "--ends", "100 %", "--json")
    assert code == 1
    content = json.loads(out)
    worst = next(c for c in content["criteria"] if c["name"] == "contour_error")
    assert worst["status"] == "failed"
    assert "loads" in worst["note"]


def test_options_on_tolerance_ends_are_refused_without_tolerances(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    placer = ("fastest", str(EXAMPLES / "letter-cycle.toml"), "-m", "letter-placer")
    code, _, err = run(capsys, *placer, "--robust", "100 %")
    assert code == 2
    assert "--robust '100 %' does not apply" in err and "--band" in err
    code, _, err = run(capsys, "prove", X180, "-m", "lathe-winder", "--ends", "0 %")
    assert code == 2 and "ends '0 %' must be above 0 %" in err
    exact = tmp_path / "exact.toml"
    exact.write_text(
        'base = "lathe-winder"\n'
        + "".join(f'[bodies.{n}]\ninertia = "3.6e-4 kg m^2 exact, assumed"\n' for n in "xya"),
        encoding="utf-8",
    )
    code, _, err = run(capsys, "prove", X180, "-m", str(exact), "--ends", "100 %")
    assert code == 2 and "have no tolerances" in err


@pytest.mark.long(but="x-180.prg")
@pytest.mark.parametrize(
    ("name", "file"),
    [("schiffli-frame", "rosette.dst"), ("lathe-winder+springy", "x-180.prg")],
    ids=["rosette.dst", "x-180.prg"],
)
def test_every_kind_with_axes_or_a_shaft_is_judged_at_its_ends(name: str, file: str) -> None:
    machine = load_machine(name)
    job = read_job(EXAMPLES / file, machine)
    plan = plan_job(job, machine, Options())
    verdict = prove_plan(plan, load_spec(None, machine), None, Trials(ends=1.0)).verdict
    assert verdict.ends == len(ends_of(machine, 1.0)) > 0


def test_the_worst_of_each_criterion_counts() -> None:
    def verdict(*measured: float | None) -> Verdict:
        return Verdict(
            results=tuple(
                Result(
                    name=f"c{k}", axis="", measured=value, limit=1.0, unit="m",
                    status=Status.NOT_MEASURED if value is None
                    else Status.PASSED if value <= 1.0 else Status.FAILED,
                )
                for k, value in enumerate(measured)
            ),
            simulated=True,
        )  # fmt: skip

    both = worst_of(
        verdict(0.5, 0.9, 0.2), [("a", verdict(0.7, 0.8, None)), ("b", verdict(0.6, 1.2, 0.1))]
    )
    assert [r.measured for r in both.results] == [0.7, 1.2, 0.2]
    assert [r.note for r in both.results] == ["a", "b", ""]
    assert not both.passed and both.ends == 2


@pytest.mark.long(shown_by="test_the_worst_of_each_criterion_counts")
def test_ends_ask_of_a_plan_for_the_file_what_robust_asks(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """If plans are made for the file alone, both judge the file's plan on the other machines."""
    asked = ("fastest", X180, "-m", "lathe-winder", "--interpolation", "linear", *SPAN, "--json")
    answer = [
        json.loads(run(capsys, *asked, option, "100 %")[1]) for option in ("--ends", "--robust")
    ]
    assert answer[0] == answer[1]
    assert answer[0]["certainty"]["machines"] == 3


def test_modes_all_over_a_band_are_judged_one_machine_at_a_time(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The verdict's worst is the worst of seventeen machines that are proved one by one."""
    machine = load_machine("lathe-winder+springy")
    spec, options = load_spec(None, machine), Options(interpolation="linear")
    plan = plan_job(read_job(X180, machine), machine, options)
    over = prove_plan(plan, spec, None, Trials(band=0.3)).verdict
    assert (over.band, over.ends, over.level) == (17, 0, "nominal")
    each = [
        prove_plan(plan, spec, actual=mode_off(machine, part)).verdict for part in band_parts(0.3)
    ]
    worst = [one.result("contour_error").measured for one in each]
    assert over.result("contour_error").measured == pytest.approx(max(filter(None, worst)))
    code, _, err = run(capsys, "prove", X180, "-m", "lathe-winder", "--band", "20 %")
    assert code == 2 and "no link with a stiffness" in err


@pytest.mark.long(shown_by="test_every_kind_with_axes_or_a_shaft_is_judged_at_its_ends")
def test_a_search_in_python_takes_what_the_command_takes() -> None:
    words: dict[str, Any] = {"interpolation": "linear", "level": "nominal", "low": "36 mm/s"}
    found = tl.fastest(X180, "lathe-winder", **words, high="40 mm/s", mismatch=True)
    assert found.best is not None and 0.036 <= found.best <= 0.040
    assert [(cell.mass, cell.stiffness) for cell in found.mismatch] == [
        (mass, stiffness) for mass in (-1.0, 0.0, 1.0) for stiffness in (-1.0, 0.0, 1.0)
    ]
    with pytest.raises(OptionError, match="no plan could be judged in that time"):
        tl.fastest(X180, "lathe-winder", **words, high="40 mm/s", within="1 us")
    with pytest.raises(OptionError, match="exclude each other"):
        tl.fastest(X180, "lathe-winder", **words, mismatch=True, actual="lathe-winder")
