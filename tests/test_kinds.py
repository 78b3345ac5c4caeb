"""The table of kinds of work is complete, and every kind goes through the same functions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from threadline.errors import OptionError, ThreadlineError
from threadline.machine import Machine, library_names, load_machine
from threadline.proof.kinds import KINDS, kind_of, kind_of_commands
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, prove, prove_plan, simulate, write
from threadline.report.proof import REPORTS
from threadline.search.report_data import REPORT_DATA
from threadline.verdict import judge, load_spec
from threadline.verdict.judge import RUNS
from threadline.verdict.measure import OfPlan
from threadline.verdict.registry import MEASURES

EXAMPLES = Path(__file__).parents[1] / "examples"
WORK = {
    "ticks": ("x-180.prg", "lathe-winder", "csv"),
    "switches": ("letter-cycle.toml", "letter-placer", "st"),
    "steps": ("rosette.dst", "schiffli-frame", "steps"),
}


def test_every_table_has_a_row_for_every_kind() -> None:
    """Judge and reports have a row for each kind in their own tables."""
    assert set(KINDS) == set(WORK)
    assert {kind.intent for kind in KINDS.values()} == set(RUNS)
    assert set(RUNS) == set(REPORTS) == set(REPORT_DATA)
    assert {kind_of(load_machine(name)).name for name in library_names()} <= set(KINDS)
    names = [name for kind in KINDS.values() for name in kind.targets]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("name", KINDS)
def test_one_way_leads_through_the_house(name: str, tmp_path: Path) -> None:
    """The same functions lead from job to verdict and files, step by step as in ``prove``."""
    file, reference, target = WORK[name]
    machine: Machine = load_machine(reference)
    options = Options()
    spec = load_spec(None, machine)
    proof = prove(EXAMPLES / file, machine, spec, options)

    plan = plan_job(open_job(EXAMPLES / file, machine, options), machine, options)
    assert kind_of(machine) is kind_of_commands(plan.commands) is KINDS[name]
    assert isinstance(plan.intent, KINDS[name].intent)
    assert plan.axes == tuple(machine.moving)
    recording = simulate(plan.commands, machine)
    again = judge([recording], plan, spec)
    assert again.results == proof.verdict.results
    assert again.passed == proof.verdict.passed
    assert plan.duration_s == proof.plan.duration_s > 0.0
    (first, *_) = write(plan, target, tmp_path / f"out.{target}")
    assert first.path.stat().st_size > 0


@pytest.mark.parametrize("name", KINDS)
def test_another_day_is_another_run_of_the_same_commands(name: str) -> None:
    """The same seed gives the same run, another one another."""
    file, reference, _ = WORK[name]
    overlay = {"ticks": "+stiction", "switches": "+hysteresis"}.get(name, "")
    machine = load_machine(reference + overlay)
    plan = plan_job(open_job(EXAMPLES / file, machine, Options()), machine, Options())
    kind = KINDS[name]

    def load(seed: int) -> np.ndarray:
        days = kind.days(plan.commands, machine, 2, np.random.default_rng(seed))
        loads = [days[-1].samples(f"{axis}.load")[1] for axis in plan.axes]
        return np.sum([load if load.ndim == 1 else load[:, 1] for load in loads], axis=0)

    same, other = load(1), load(2)
    assert np.array_equal(same, load(1))
    size = min(len(same), len(other))
    assert not np.array_equal(same[:size], other[:size])


def test_a_measure_reads_one_input() -> None:
    """The plan alone, one run or many: every form reads the same input, except for the travel."""
    mixed = {
        kind.name
        for kind in MEASURES.values()
        if len({type(reading) for reading in kind.reads}) != 1
    }
    assert mixed == {"travel"}
    assert any(isinstance(reading, OfPlan) for reading in MEASURES["travel"].reads)


@pytest.mark.parametrize("machine", ["lathe-winder", "letter-placer", "table-embroiderer"])
@pytest.mark.parametrize(
    "file", ["x-180.prg", "letter-cycle.toml", "rosette.dst", "strap.seam.toml"]
)
def test_a_job_is_planned_or_refused_in_one_line(machine: str, file: str) -> None:
    """Jobs of one kind of machine on another: no defect, and a message that names the job."""
    chosen = load_machine(machine)
    own = {"lathe-winder": (".prg", ".seam.toml"), "letter-placer": ("letter-cycle.toml",),
           "table-embroiderer": (".dst",)}[machine]  # fmt: skip
    if file.endswith(own):
        assert open_job(EXAMPLES / file, chosen, Options()).file
        return
    with pytest.raises(ThreadlineError) as refused:
        plan_job(open_job(EXAMPLES / file, chosen, Options()), chosen, Options())
    assert str(refused.value).startswith((f"[JOB] {file}: ", f"[PLAN] {file}: "))
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("name", "file", "number"),
    [
        ("letter-placer", "letter-cycle.toml", "bodies.table.inertia"),
        ("table-embroiderer", "rosette.dst", "bodies.x_frame.inertia"),
    ],
)
def test_another_machine_of_the_kind_plays_the_plan(
    name: str, file: str, number: str, tmp_path: Path
) -> None:
    """It differs in one number, has a file and a hash of its own, and rings differently."""
    machine = load_machine(name)
    overlay = tmp_path / "heavy.toml"
    overlay.write_text(f'base = "{name}"\n{number} = "120 kg exact, assumed: heavier"\n')
    plan = plan_job(open_job(EXAMPLES / file, machine, Options()), machine, Options())
    spec = load_spec(None, machine)
    own, other = (
        prove_plan(plan, spec, actual=one).verdict for one in (None, load_machine(overlay))
    )
    assert [r.measured for r in own.results] != [r.measured for r in other.results]
    with pytest.raises(OptionError, match=r"lathe-winder cannot play what is planned for"):
        prove_plan(plan, spec, actual=load_machine("lathe-winder"))
