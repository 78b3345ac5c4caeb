"""The evenness of the fibre's speed, as a measure and as a criterion with a limit."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from threadline.machine import load_machine
from threadline.proof.options import options_of
from threadline.proof.pipeline import NOMINAL, open_job, plan_job, prove_plan, with_shaping
from threadline.verdict import Criterion, load_spec
from threadline.verdict.types import Result

TUBE = """[[part]]
kind = "cylinder"
radius = "50 mm"
length = "300 mm"
[band]
width = "6 mm"
[friction]
value = 0.25
[fibre]
tied = "20 mm"
"""
SECONDS = 8.0


def _program(turns: tuple[float, ...], rest: str = "") -> str:
    """Return hoops: each turn of ``turns``, deg, takes the same time, with the eye beside it."""
    lines = ["G21", "G90", "G1 Y60 F1200", "G1 X20 F1200", "G91", "G93"]
    rate = 60.0 / SECONDS
    for turn in turns:
        lines.append(f"G1 A{turn} X{6.0 * turn / 360.0:.6f} F{rate}")
        lines += [rest] if rest else []
    return "\n".join([*lines, "M30", ""])


def _judged(folder: Path, program: str, limit: float | None) -> Result:
    (folder / "tube.wind.toml").write_text(TUBE)
    (folder / "hoops.ngc").write_text(program)
    machine = load_machine("lathe-winder")
    options = options_of(
        product=str(folder / "tube.wind.toml"), interpolation="optimal", dialect="linuxcnc"
    )
    plan = plan_job(open_job(folder / "hoops.ngc", machine, options), machine, options)
    spec = with_shaping(load_spec(None, machine), machine, options)
    name = "fibre_speed_variation"
    asked = tuple(c for c in spec.criteria if c.name != name)
    if limit is not None:
        asked += (Criterion(name=name, limit=limit),)
        spec = replace(spec, criteria=asked)
    verdict = prove_plan(plan, spec, None, NOMINAL).verdict
    return next(result for result in verdict.results if result.name == name)


@pytest.mark.long(shown_by="test_a_rest_is_not_even")
def test_two_speeds_of_equal_time_have_the_deviation_of_two_values(tmp_path: Path) -> None:
    """Speeds v and 2 v for equal times: mean 1.5 v, deviation 0.5 v, a third of the mean.

    The fibre of a hoop leaves the eye at the mandrel's radius times its rate.
    """
    found = _judged(tmp_path, _program((180.0, 360.0) * 3), 0.1)
    assert found.measured == pytest.approx(1.0 / 3.0, rel=0.02)
    assert str(found.status) == "failed"
    mean = 0.05 * math.radians(270.0) / SECONDS
    assert f"mean {1e3 * mean:.2g}" in found.note


@pytest.mark.long(shown_by="test_a_rest_is_not_even")
def test_one_speed_is_even(tmp_path: Path) -> None:
    """Only the start from rest is left."""
    even = _judged(tmp_path, _program((360.0,) * 6), 0.1)
    assert even.measured is not None and even.measured < 0.05
    assert str(even.status) == "passed"


def test_a_rest_is_not_even(tmp_path: Path) -> None:
    """Equal times at v and at rest would be 100 %; a rest of 2 s in every 10 s is half of that.

    With a share p at rest the mean is (1 - p) v and the deviation v sqrt(p (1 - p)).
    """
    found = _judged(tmp_path, _program((360.0,) * 6, "G4 P2"), None)
    times, rests = 6 * SECONDS, 5 * 2.0  # the rest at the end does not count
    share = rests / (times + rests)
    assert found.measured == pytest.approx(math.sqrt(share / (1.0 - share)), rel=0.03)
    assert str(found.status) == "reported"
