"""Reasons why a program's fibre is never known, and the mandrel that would fit it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.winding import programs
from threadline.commands.plan import Plan
from threadline.machine import Machine, load_machine
from threadline.proof.options import options_of
from threadline.proof.pipeline import open_job, plan_job
from threadline.verdict.fibre import measure_planned
from threadline.verdict.finding import Finding
from threadline.winding.eye import centre
from threadline.winding.fit import Witness, fitting_radius
from threadline.winding.product import product_of_text, product_text

VESSEL = Path(__file__).parents[2] / "examples" / "vessel.wind.toml"


@pytest.fixture(scope="module")
def machine() -> Machine:
    return load_machine("lathe-winder")


def _found(plan: Plan) -> dict[str, Finding]:
    return {name: finding for name, (finding,) in measure_planned(plan).items()}


@pytest.mark.parametrize(
    ("start", "step", "times", "message"),
    [
        ("Y 60;\nX 20;\nX 100;", "X -1", 20, "the mandrel never turns, so that nothing is laid"),
        ("Y 40;\nX 20;", "A 30 X 3", 20, "10 mm inside the mandrel; a mandrel of 40 mm at its w"),
        ("Y 60;\nX -400;", "A 30 X 3", 20, "end, and the mandrel is 200 mm long"),
        ("Y 40;\nX 20;", "A 1200 X 30", 1, "up to 10 mm inside the mandrel"),
        ("Y 240;\nX 20;", "A 30 X 3", 20, "lengths in a row, needed are 5, and the free length"),
    ],
)
def test_a_program_that_lays_nothing_says_why(
    tmp_path: Path, machine: Machine, start: str, step: str, times: int, message: str
) -> None:
    """One criterion gives the reason; the others only say that the fibre is never known."""
    product = tmp_path / "c.wind.toml"
    product.write_text(
        '[[part]]\nkind = "cylinder"\nradius = "50 mm"\nlength = "200 mm"\n'
        '[band]\nwidth = "5 mm"\n[friction]\nvalue = "0.3"\n'
    )
    steps = "\n".join([f"{step};"] * times)
    text = f"%\nO 998;\nG01 F 1200;\nG91;\n{start}\n{steps}\nM30;\n%\n"
    file = tmp_path / "p.prg"
    file.write_text(text)
    options = options_of(product=str(product), interpolation="linear")
    found = _found(plan_job(open_job(file, machine, options), machine, options))
    assert message in found["planned_slip_tendency"].note
    assert found["planned_lifting"].note == "the fibre is never known"


@pytest.mark.parametrize(
    ("moves", "message"),
    [
        ("G1 X900 F6000\nG1 A3600 X1100\n", "stays beside the mandrel, at 900 to 1100 mm"),
        ("G1 A360 X900 F6000\n", "free lengths in a row, needed are 5"),
    ],
)
def test_an_eye_at_a_fixed_distance_is_not_inside_the_mandrel(
    tmp_path: Path, moves: str, message: str
) -> None:
    """Its carrier has no axis across: the pay-out point is 80 mm from the axis."""
    product = tmp_path / "c.wind.toml"
    product.write_text(
        '[[part]]\nkind = "cylinder"\nradius = "50 mm"\nlength = "200 mm"\n'
        '[band]\nwidth = "5 mm"\n[friction]\nvalue = "0.3"\n'
    )
    file, winder = tmp_path / "p.gcode", load_machine("stepper-winder+xab")
    file.write_text(f"G21\nG90\nG94\n{moves}M30\n")
    options = options_of(product=str(product), interpolation="linear")
    note = _found(plan_job(open_job(file, winder, options), winder, options))
    assert message in note["planned_slip_tendency"].note


def test_the_reason_counts_the_pay_out_point_as_the_replay_does() -> None:
    """With yaw and roll, compared with the compiled code of the replay."""
    rng = np.random.default_rng(3)
    eyes, offset = rng.uniform(-1.0, 1.0, (50, 6)), (0.02, 0.08, -0.03)
    surface = product_of_text(product_text(VESSEL)).surface
    found = np.column_stack(Witness(surface, offset).payout_points(eyes))
    payout = np.array([*offset, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0])
    expected = [centre(one, np.zeros(6), payout)[:3] for one in eyes]
    assert found == pytest.approx(np.array(expected), abs=1e-15)


def test_the_radius_that_would_fit_is_found() -> None:
    """The program of the vessel is wound on mandrels 6 mm thinner and 12 mm thicker."""
    tool = load_machine("lathe-winder").tool
    assert tool is not None
    vessel = product_of_text(product_text(VESSEL))
    circuit = programs.eyes(vessel.surface, programs.geodesic(vessel.surface)[1])
    turn = np.array([circuit[-1, 0] - circuit[0, 0], 0.0, 0.0])
    laps = np.vstack([circuit[:1], *(circuit[1:] + k * turn for k in range(3))])
    eyes = np.hstack([laps - [0.0, programs.AT_M, 0.0], np.zeros((len(laps), 3))])
    assert fitting_radius(vessel.surface, tool, eyes, 0.2, None, 0.01) is None
    for by in (-0.006, 0.012):
        found = fitting_radius(vessel.surface.grown(by), tool, eyes, 0.2, None, 0.01 - by)
        assert found == pytest.approx(-by, abs=2e-4)
