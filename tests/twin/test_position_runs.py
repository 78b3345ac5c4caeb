"""Machines with position drives side by side, each compared with a run of its own."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.cli.main import main
from threadline.files import tick_table
from threadline.machine import Machine, load_machine
from threadline.machine.vary import vary
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.twin import simulate, simulate_position_runs
from threadline.verdict import Judge, load_spec

ROOT = Path(__file__).parents[2]
SETTINGS = ROOT / "examples/grbl-settings.txt"
OWNED = (
    "torque=1.26 N m", "current=2.8 A", "resistance=0.9 ohm", "inductance=2.5 mH", "supply=36 V",
    "microsteps=16", "mass=1.2 kg", "inertia=4e-3 kg m^2", "radius=50 mm", "rotary=A",
)  # fmt: skip
PROGRAM = "G21 G90 G94\nF9000\nG1 X0\nG1 X30 A40\nG4 P0.2\nG1 X12 A90\nG1 X0 A0\nM30\n"


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A machine made from settings: every axis is rigid behind its stepper."""
    folder = tmp_path_factory.mktemp("positions") / "made"
    words = [word for owned in OWNED for word in ("--set", owned)]
    with pytest.raises(SystemExit) as end:
        main(["new", "grbl", str(folder), "--from", str(SETTINGS), *words])
    assert end.value.code == 0
    (folder / "job.gcode").write_text(PROGRAM)
    return folder


def others(machine: Machine) -> list[Machine]:
    """Four machines with other friction and supply."""
    return [vary(machine, friction=f, supply=s) for f, s in ((1, 1), (1.3, 1), (0.7, 0.95), (1, 2))]


def test_each_run_is_that_of_its_own_to_the_bit(project: Path) -> None:
    machine = load_machine(str(project / "machine.toml"))
    plan = plan_job(open_job(project / "job.gcode", machine, Options()), machine, Options())
    table, phases = tick_table(plan.commands), np.random.default_rng(4).uniform(size=(4, 2))
    machines = others(machine)
    beside = simulate_position_runs(table, machines, encoder_phase=phases)
    assert beside is not None and beside.runs == 4
    for number, (one, phase) in enumerate(zip(machines, phases, strict=True), start=1):
        single = simulate(table, one, encoder_phase=phase)
        same = beside.run(number)
        for channel in single.channels:
            expected, found = single.samples(channel.name), same.samples(channel.name)
            np.testing.assert_array_equal(found[0], expected[0])
            np.testing.assert_array_equal(found[1], expected[1])
        assert single.outcome() == same.outcome()
    # Otherwise nothing would be compared.
    shares = [beside.run(n).samples("X.torque_share")[1].max() for n in (1, 2, 3)]
    assert len(set(shares)) == 3


def test_the_judge_finds_the_same_side_by_side(project: Path) -> None:
    machine = load_machine(str(project / "machine.toml"))
    plan = plan_job(open_job(project / "job.gcode", machine, Options()), machine, Options())
    table, phases = tick_table(plan.commands), np.random.default_rng(5).uniform(size=(4, 2))
    spec = load_spec(project / "spec.toml", machine)
    beside = simulate_position_runs(table, others(machine), encoder_phase=phases)
    assert beside is not None
    one_by_one = [
        simulate(table, one, encoder_phase=phase)
        for one, phase in zip(others(machine), phases, strict=True)
    ]
    together, single = (Judge(plan, spec).verdict(rows) for rows in ([beside], one_by_one))
    assert together.results and together.runs == single.runs == 4
    assert [replace(one, note="") for one in together.results] == [
        replace(one, note="") for one in single.results
    ]


def test_a_belt_that_may_fall_slack_is_not_run_side_by_side() -> None:
    machine = load_machine("stepper-winder")
    plan = plan_job(
        open_job(ROOT / "examples/x-180.prg", machine, Options()), machine, Options(feed=None)
    )
    phases = np.full((2, 2), 0.5)
    table = tick_table(plan.commands)
    assert simulate_position_runs(table, [machine, machine], encoder_phase=phases) is None
