"""One circuit of a vessel on a winder with a spool."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from threadline.commands.plan import Plan
from threadline.files import Recording, TickTable
from threadline.machine import Machine, load_machine
from threadline.proof.pipeline import open_job, plan_job
from threadline.proof.request import options_of
from threadline.twin import simulate

EXAMPLES = Path(__file__).parents[2] / "examples"
VESSEL = EXAMPLES / "vessel.wind.toml"
FIRST_S = 6.0  # part of the circuit: over a dome and along the cylinder


def planned(machine: Machine) -> Plan:
    """Return the plan of one circuit of the vessel at 60 mm/s."""
    options = options_of(product=str(VESSEL), interpolation="auto", feed="60 mm/s")
    return plan_job(open_job(EXAMPLES / "vessel-circuit.prg", machine, options), machine, options)


@pytest.fixture(scope="session")
def plan() -> Plan:
    return planned(load_machine("lathe-winder+spool"))


@pytest.fixture(scope="session")
def beginning(plan: Plan) -> TickTable:
    """Return the first seconds of its table."""
    table = plan.commands
    assert isinstance(table, TickTable)
    rows, left = [], round(FIRST_S / float(table.clock.period_s))
    for block in table:
        if left <= 0:
            break
        part = slice(0, left)
        rows.append(replace(block, counts=block.counts[part], operation=block.operation[part],
                            events=()))  # fmt: skip
        left -= len(rows[-1])
    return replace(table, blocks=tuple(rows))


@pytest.fixture(scope="session")
def recorded(plan: Plan, beginning: TickTable) -> Recording:
    recording = simulate(beginning, plan.machine, settle_s=0.1)
    return replace(recording, blocks=tuple(recording.blocks))


@pytest.fixture(scope="session")
def whole(plan: Plan) -> Recording:
    """Return the recording of the whole circuit."""
    recording = simulate(plan.commands, plan.machine)
    return replace(recording, blocks=tuple(recording.blocks), origin=dict(plan.options))
