"""The sweep of all measures finds the same, however few samples it takes at once.

The reference is a sweep that takes all samples of a block at once, so that every measure reads all
of them before the next one does.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from threadline.commands.plan import Plan
from threadline.dynamics.values import Values
from threadline.files import Recording, tick_table
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.options import options_of
from threadline.proof.pipeline import plan_job
from threadline.twin import simulate_runs
from threadline.verdict import load_spec, sweep
from threadline.verdict.finding import Finding
from threadline.verdict.judge import open_run
from threadline.verdict.one_pass import Pass, read_all
from threadline.verdict.registry import MEASURES

EXAMPLES = Path(__file__).parents[2] / "examples"
RUNS = 24
PROGRAM = """%
O 1;
N 10 G01 F 1500;
N 15 G91;
N 20 X 20 Y 10 A 10;
N 25 X 20 Y -10 A -10;
N 30 X 20 Y 10 A 10;
N 35 X 10;
N 40 M30;
%
"""
CONE = """[axes.A.profile]
along = "X"
at = ["-500 mm exact, measured", "500 mm exact, measured"]
radius = ["20 mm exact, measured", "90 mm exact, measured"]
"""
SWEPT = (
    "contour_error",
    "progress_error",
    "turning_point_error",
    "tracking_error",
    "current_peak",
    "current_rms",
    "dac_saturation",
)


def recorded(plan: Plan) -> Recording:
    """Return the runs, side by side."""
    random = np.random.default_rng(1994)
    phases = random.random((256, 3))[:RUNS]
    own = plan.machine.bodies["x"].inertia.si
    numbers = {"bodies.x.inertia": own * random.uniform(0.95, 1.05, 256)[:RUNS]}
    values = Values.of(plan.machine, numbers)
    return simulate_runs(tick_table(plan.commands), values, encoder_phase=phases)


def found(plan: Plan, names: tuple[str, ...], only: int | None = None) -> list[Finding]:
    """Return every run's finding, or one run's, by axis and measure, with its place."""
    recording = recorded(plan) if only is None else recorded(plan).run(only + 1)
    run = open_run(recording, plan, load_spec(None, plan.machine).lag_s)
    one = Pass(run, {(name, ()): MEASURES[name] for name in names}, together=False)
    read_all([one], [])
    rows = one.found()
    assert set(rows) == {(name, ()) for name in names}
    return [row.of(k) for same in rows.values() for row in same for k in range(recording.runs)]


@pytest.mark.parametrize("profile", ["", CONE], ids=["one radius", "a profile"])
def test_findings_and_places_are_the_same_however_few_samples_are_brought_in(
    tmp_path, monkeypatch, profile
) -> None:
    """With cut corners: between two samples the tool is farther from both chords."""
    (tmp_path / "machine.toml").write_text(f'base = "lathe-winder"\nname = "own"\n{profile}')
    (tmp_path / "job.prg").write_text(PROGRAM)
    machine = load_machine(tmp_path / "machine.toml")
    job = read_job(tmp_path / "job.prg", machine)
    plan = plan_job(job, machine, options_of("linear", None, "0.1 mm"))
    monkeypatch.setattr(sweep, "AT_ONCE", 1 << 24)
    whole = found(plan, SWEPT)
    monkeypatch.setattr(sweep, "AT_ONCE", 7 * RUNS)
    assert found(plan, SWEPT) == whole
    # A measure finds the same alone as together with others.
    one_by_one = [finding for name in SWEPT for finding in found(plan, (name,))]
    assert one_by_one == whole
    # So does a single run, by its own loops as well as by the loops of many runs.
    for own in (True, False):
        monkeypatch.setattr(sweep, "loops_of_one_run_serve", lambda own=own: own)
        for k in (0, RUNS - 1):
            assert found(plan, SWEPT, k) == whole[k::RUNS]
    # Some worst value lies between two samples, which are whole ticks.
    ticks = np.array([finding.time_s for finding in whole[:RUNS]]) / machine.tick_clock.period_s
    assert (np.abs(ticks.astype(float) - np.rint(ticks.astype(float))) > 1e-3).any()


ASKED = """
import threadline
from threadline.verdict.boxes import vertices_to_path
from threadline.verdict.single_run import contour_of_one

threadline.prove({job!r}, "lathe-winder", level={level!r})
print(len(contour_of_one.signatures), len(vertices_to_path.signatures))
"""


@pytest.mark.parametrize(("level", "loops"), [("nominal", "1 0"), ("repeated", "0 1")])
def test_a_proof_compiles_one_form_of_the_loops(level: str, loops: str) -> None:
    """The planned path beside the program is a single run in a proof of many."""
    asked = ASKED.format(job=str(EXAMPLES / "x-180.prg"), level=level)
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[0] == loops
