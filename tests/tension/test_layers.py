"""Tension by layer: wanted by a job, followed by the brake, and judged."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.tension.conftest import EXAMPLES, VESSEL
from threadline.commands.plan import Plan
from threadline.errors import JobError
from threadline.files import Recording
from threadline.jobs import read_job
from threadline.jobs.tensions import tensions_of
from threadline.live import links
from threadline.machine import Machine, load_machine
from threadline.proof.pipeline import open_job, plan_job, with_product
from threadline.proof.request import options_of
from threadline.twin import simulate
from threadline.verdict import Spec, judge
from threadline.verdict.types import Criterion, Result, Status
from threadline.winding.product import product_text, with_mandrel

BLOCKS, CHANGE = 110, 55  # operations of the circuit, and the first one with the second tension
ASKED = 8.4, 7.4


def program(folder: Path, *asked: float) -> Path:
    """Write the first blocks of the circuit, half of them with each tension."""
    lines = (EXAMPLES / "vessel-circuit.prg").read_text().split("\n")
    blocks = lines[2 : 2 + BLOCKS]
    for k, block in enumerate(blocks):
        tension = asked[0] if k < CHANGE else asked[-1]
        blocks[k] = f"{block.rstrip(';')} ; tension_N={tension}"
    file = folder / "two.prg"
    file.write_text("\n".join([*lines[:2], *blocks, *lines[lines.index("M99;") :]]))
    return file


def planned(file: Path, machine: Machine) -> Plan:
    options = options_of(product=str(VESSEL), interpolation="linear", feed="60 mm/s")
    return plan_job(open_job(file, machine, options), machine, options)


def variation(recording: Recording, plan: Plan) -> Result:
    limit = Criterion(name="tension_variation", limit=0.05, options={"after": 0.04})
    found = judge([recording], plan, Spec(name="t", criteria=(limit,), lag_s=0.1))
    return found.results[0]


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    file = program(tmp_path_factory.mktemp("two"), *ASKED)
    return planned(file, load_machine("lathe-winder+spool"))


@pytest.fixture(scope="module")
def recorded(plan: Plan) -> Recording:
    recording = simulate(plan.commands, plan.machine)
    return replace(recording, blocks=tuple(recording.blocks), origin=dict(plan.options))


def test_a_program_says_its_tensions_in_comments(plan: Plan) -> None:
    (first, one), (second, other) = tensions_of(plan.job)
    assert (one, other) == ASKED
    assert second - first == CHANGE


def test_each_layer_of_a_planned_winding_has_its_own() -> None:
    """15 N for the first layer, and 5 % less for each further one."""
    job = read_job(EXAMPLES / "vessel-laminate.wind.toml", load_machine("lathe-winder"))
    asked = [tension for _, tension in tensions_of(job)]
    assert asked == pytest.approx([15.0, 14.25, 13.5375])
    lines = {o: item.source.line for o, item in enumerate(job)}
    assert len({lines[operation] for operation, _ in tensions_of(job)}) == 3


def test_the_brake_follows_the_program(plan: Plan, recorded: Recording) -> None:
    """Each part has its wanted tension as its mean; with a fixed brake it is the machine's."""
    operation = recorded.samples("operation")[1].astype(int)
    tension = recorded.samples("tension")[1]
    (first, _), (second, _) = tensions_of(plan.job)
    parts = (operation > first + 20) & (operation < second), operation > second + 20
    for rows, asked in zip(parts, ASKED, strict=True):
        assert tension[rows].mean() == pytest.approx(asked, rel=0.015)
    spool = plan.machine.spool
    assert spool is not None
    fixed = planned(
        Path(plan.job.file),
        replace(plan.machine, mounted=None, spool=replace(spool, most_torque=None)),
    )
    one_by_one = simulate(fixed.commands, fixed.machine).samples("tension")[1]
    for rows in parts:
        assert one_by_one[rows].mean() == pytest.approx(spool.tension_n, rel=0.01)


def test_fibre_is_tied_under_the_tension_of_the_first_layer(recorded: Recording) -> None:
    assert recorded.samples("tension")[1][0] == pytest.approx(ASKED[0], rel=1e-9)


def test_each_part_is_judged_against_its_own_mean(plan: Plan, recorded: Recording) -> None:
    """The two tensions differ by 12 %; each is even within 2 %."""
    found = variation(recorded, plan)
    assert found.status is Status.PASSED
    assert found.measured is not None and found.measured < 0.02
    assert f"asked {ASKED[0]:g} N" in found.note or f"asked {ASKED[1]:g} N" in found.note
    tension = recorded.samples("tension")[1]
    assert np.abs(tension / tension.mean() - 1.0).max() > 0.05  # against a single mean


def test_the_beginning_of_a_layer_does_not_count_and_its_middle_does(
    plan: Plan, recorded: Recording
) -> None:
    operation = recorded.samples("operation")[1].astype(int)
    second = tensions_of(plan.job)[1][0]
    at = int((operation >= second).argmax()) + 3
    for tick, counts in ((at, False), (int((operation >= second + 45).argmax()), True)):
        blocks = []
        for block in recorded.blocks:
            own, first = block.samples["tension"].copy(), next(iter(block.first_tick.values()))
            if 0 <= tick - first < len(own):
                own[tick - first] = 12.0
            blocks.append(replace(block, samples={**block.samples, "tension": own}))
        found = variation(replace(recorded, blocks=tuple(blocks)), plan)
        assert (found.status is Status.FAILED) is counts, tick


def test_a_tension_beyond_the_brake_is_refused_by_its_line(tmp_path: Path) -> None:
    file = program(tmp_path, 8.0, 60.0)
    with pytest.raises(JobError) as refused:
        planned(file, load_machine("lathe-winder+spool"))
    assert f"two.prg:{3 + CHANGE}: " in str(refused.value)
    assert "a tension of 60 N needs a torque of 3.473 N m" in str(refused.value)
    assert "from above 0 to 2 N m" in str(refused.value)


def test_the_arm_takes_up_least_at_the_lowest_tension(tmp_path: Path) -> None:
    """The layer with the least room of the arm sets the limit of the slack."""
    file = tmp_path / "p.wind.toml"
    text = VESSEL.read_text().replace('take_up = "50 mm"\n', "")
    file.write_text(text + 'tension = "6 N"\n')
    machine, own = load_machine("lathe-winder+spool"), Spec(name="own", criteria=(), lag_s=0.1)
    asked = with_product(own, machine, options_of(product=str(file)))
    (limit,) = [c.limit for c in asked.criteria if c.name == "slack"]
    assert limit == pytest.approx(2.0 * (2.0 * 6.0 / 1.1 - 8.4) / 120.0)


def test_numbers_of_a_brake_vary_with_each_tension(plan: Plan) -> None:
    """A brake that gives 5 % more gives 5 % more in every layer."""
    assert plan.machine.mounted is not None and plan.machine.spool is not None
    torque = plan.machine.spool.torque
    stronger = replace(plan.machine.spool, torque=replace(torque, si=1.05 * torque.si))
    recording = simulate(plan.commands, replace(plan.machine, spool=stronger))
    tension = recording.samples("tension")[1]
    assert np.ptp(tension[len(tension) // 4 :]) > 0.8
    assert tension[0] > 1.02 * ASKED[0]  # the arm loosens a stronger brake


def test_a_simulated_run_on_another_machine_winds_the_same_mandrel(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The machine of ``run --actual`` has its own spool, and the mandrel of the job."""
    seen: list[Machine] = []

    @contextmanager
    def kept(machine: Machine, *_: object) -> Iterator[None]:
        seen.append(machine)
        yield None

    monkeypatch.setattr(links, "sim_link", kept)
    spool = load_machine("lathe-winder+spool")
    planned_on = with_mandrel(spool, product_text(VESSEL))
    assert planned_on.mounted is not None
    for name, expected in (("lathe-winder+spool", planned_on.mounted), ("lathe-winder", None)):
        link = links.SimLink(0.0, None, load_machine(name))
        with link._connected(planned_on, np.zeros(3, dtype=np.int64)):
            assert seen[-1].mounted is expected
