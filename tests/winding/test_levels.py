"""Faulty programs fail at the line of their fault at every level; a sound one passes in runs.

The programs are short, and the search for the worst machine tries few machines: the test is that a
fault stays at its line whichever machine is the worst, not how bad the worst machine is.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.winding import programs
from threadline.base.arrays import FloatArray
from threadline.machine import load_machine
from threadline.proof.options import options_of
from threadline.proof.pipeline import (
    NOMINAL,
    Trials,
    open_job,
    plan_job,
    prove_plan,
    with_shaping,
)
from threadline.verdict import Verdict, load_spec
from threadline.verdict.types import Status
from threadline.winding.product import product_of_text, product_text

EXAMPLES = Path(__file__).parents[2] / "examples"
VESSEL, WAIST = EXAMPLES / "vessel.wind.toml", EXAMPLES / "vessel-waist.wind.toml"
LEVELS = {
    "nominal": NOMINAL,
    "repeated": Trials(repeats=20),
    "over tolerances": Trials(repeats=20, machines=10),
}
HEAD = 6
"""Lines before the first block."""
TUBE = """
[mandrel]
at = "100 mm +- 0.5 mm"
radius_error = "0 mm +- 0.1 mm"
[[part]]
kind = "cylinder"
radius = "50 mm"
length = "200 mm"
[band]
width = "20 mm +- 0.2 mm"
[friction]
value = "0.6 +- 0.05"
[fibre]
tied = "50 mm"
[coverage]
begin = "60 mm"
end = "100 mm"
gap = "0.5 mm"
"""
STEP_DEG, LEAD_M, WIDE = 6.0, 0.018, slice(120, 150)
"""Blocks of a hoop, its lead, and the blocks in which the eye goes 8 mm too far."""


FAULTS = ("slip_tendency", "lifting", "bridging", "coverage_gap")


@dataclass(frozen=True)
class Case:
    """A program with its product, and the first and last line at which it has to fail."""

    text: str
    product: str
    lines: tuple[int, int]


def _program(rows: FloatArray, first: FloatArray, feed: int) -> str:
    along, across = 1e3 * first[1], 1e3 * first[2]
    head = ["%", "O 998;", f"G01 F {feed};", "G91;", f"Y {across:.3f};", f"X {along:.3f};"]
    blocks = [programs.block(10 * k, row) for k, row in enumerate(rows, start=1)]
    return "\n".join([*head, *blocks, "M30;", "%", ""])


def _hoop(too_far_mm: float) -> str:
    rows = np.zeros((240, 3))
    rows[:, 0], rows[:, 1] = STEP_DEG, 1e3 * LEAD_M * STEP_DEG / 360.0
    rows[WIDE, 1] += too_far_mm / (WIDE.stop - WIDE.start)
    eye = np.array([0.0, programs.AT_M + 0.05, np.hypot(0.05, programs.FREE_M)])
    return _program(np.round(rows, 3), eye, 3000)


@functools.cache
def _cases() -> dict[str, Case]:
    """Return the programs of ``FAULTS``, made when the first test asks for one."""
    surface = product_of_text(product_text(VESSEL)).surface
    circuit = programs.eyes(surface, programs.geodesic(surface)[1])
    vessel, waist = (file.read_text().split("[coverage]")[0] for file in (VESSEL, WAIST))
    count, faulty = programs.FAULTY + 12, HEAD + 1 + programs.FAULTY

    def part(rows: FloatArray) -> str:
        return _program(rows, circuit[0], 1200)

    # The fibre enters the waist where the cylinder begins.
    x = surface.at(programs.geodesic(surface)[1][:, 0])[0][:, 0]
    enters = HEAD + 1 + int(np.argmax(x > 0.045)), HEAD + 1 + int(np.argmax(x > 0.1))
    return {
        "slip_tendency": Case(part(programs.slipping(circuit)[:count]), vessel, (faulty, faulty)),
        "lifting": Case(part(programs.lifting(circuit)[:count]), vessel, (faulty, faulty)),
        "bridging": Case(part(programs.steps(circuit)[:110]), waist, enters),
        # The band beside the gap is the last one before the eye went too far, or the first after.
        "coverage_gap": Case(_hoop(8.0), TUBE, (HEAD + WIDE.start - 60, HEAD + WIDE.stop + 60)),
    }


def _judged(folder: Path, case: Case, trials: Trials) -> Verdict:
    file, product = folder / "p.prg", folder / "p.wind.toml"
    file.write_text(case.text)
    product.write_text(case.product)
    machine, options = load_machine("lathe-winder"), options_of(product=str(product))
    spec = with_shaping(load_spec(None, machine), machine, options)
    plan = plan_job(open_job(file, machine, options), machine, options)
    return prove_plan(plan, spec, None, trials).verdict


@pytest.mark.long(
    only=(
        "coverage_gap-over tolerances",
        "bridging-over tolerances",
        "lifting-over tolerances",
    )
)
@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_fails_at_its_line_at_every_level(
    name: str, level: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("threadline.proof.worst_search.SEARCHED", 4)
    monkeypatch.setattr("threadline.proof.pipeline.MOST_RUNS", 20)
    case = _cases()[name]
    verdict = _judged(tmp_path, case, LEVELS[level])
    assert not verdict.passed and verdict.level == level
    first, last = case.lines
    results = {result.name for result in verdict.results}
    assert {name, f"planned_{name}"} <= results
    for result in verdict.results:
        if result.name in (name, f"planned_{name}"):
            assert result.status is Status.FAILED
            assert result.job_line is not None, result.name
            assert first <= result.job_line <= last, result.job_line
    if level == "over tolerances":
        assert verdict.tolerances is not None
        assert (verdict.tolerances.drawn, verdict.tolerances.passed) == (10, 0)


def test_a_hoop_without_a_fault_passes_in_runs(tmp_path: Path) -> None:
    """So a gap of the faulty program comes from its fault."""
    verdict = _judged(tmp_path, Case(_hoop(0.0), TUBE, (0, 0)), LEVELS["repeated"])
    assert verdict.passed
