"""The document on interpolations agrees with the planner."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.with_firmware import winder_with_grbl
from threadline.commands.plan import Plan
from threadline.errors import OptionError
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.motion.path import interpolation_names
from threadline.motion.path.interpolations import FIRMWARE, KEEPING_TOLERANCE
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.verdict.deviation import measure_path_deviation

ROOT = Path(__file__).resolve().parents[3]
TEXT = (ROOT / "docs" / "interpolations.md").read_text(encoding="utf-8")
ROWS = {
    cells[0].strip("` "): [cell.strip() for cell in cells]
    for cells in (line.strip("|").split("|") for line in TEXT.splitlines())
    if len(cells) == 5 and cells[0].strip().startswith("`")
}


BY_A_LAW = "law:modified-sine"
"""One of those by a motion law, which stands for them all."""


def test_document_has_a_row_and_a_paragraph_for_each_interpolation() -> None:
    assert set(ROWS) == {*interpolation_names(), BY_A_LAW}
    assert "## `law:NAME`" in TEXT
    assert set(re.findall(r"^## `([\w-]+)`$", TEXT, re.MULTILINE)) == set(interpolation_names())


# optimal is checked beside others who need the same plan: tests/documents/test_one_plan.py.
@pytest.mark.parametrize("name", sorted({*interpolation_names(), BY_A_LAW} - {"optimal"}))
def test_a_row_says_what_the_planner_does(name: str) -> None:
    machine = winder_with_grbl()
    job = read_job(ROOT / "examples" / "cone-dome-cylinder.prg", machine)
    row_is_of(name, plan_job(job, machine, Options(interpolation=name)))


def row_is_of(name: str, plan: Plan) -> None:
    """Compare a row with a plan of the printed winder program, to the last digit of the row."""
    _, limits, tolerance, _, figures = ROWS[name]
    path = plan.motion.path
    (found,) = measure_path_deviation(plan)
    deviation_m = found.value
    assert deviation_m is not None

    assert (limits == "historical") == path.historical
    assert (tolerance == "keeps it everywhere") == (name in KEEPING_TOLERANCE)
    if name in KEEPING_TOLERANCE:
        assert deviation_m <= 1e-4
    seconds, millimetres = re.findall(r"([\d.]+) (?:s|mm off)", figures)
    assert plan.motion.trajectory.duration_s == pytest.approx(float(seconds), abs=0.051)
    digits = len(millimetres.partition(".")[2])
    assert deviation_m * 1e3 == pytest.approx(float(millimetres), abs=0.6 * 10**-digits)


def test_a_machine_without_a_firmware_is_told_so() -> None:
    machine = load_machine("lathe-winder")
    job = read_job(ROOT / "examples" / "x-180.prg", machine)
    with pytest.raises(OptionError, match=r"has no firmware that plans .* \[planner\]"):
        plan_job(job, machine, Options(interpolation=FIRMWARE))
