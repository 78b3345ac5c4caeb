"""Machines whose drives take positions run as simulated, to the bit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.live.bench import Bench
from tests.live.proved_and_run import check_same_when_run
from tests.made import read_once
from tests.test_limits_alone import MACHINE as LIMITS_ALONE
from threadline.errors import OptionError
from threadline.files import RunEnd, TickTable, tick_table
from threadline.live.sim_machine import parse_fault
from threadline.live.sim_process import group_ticks
from threadline.live.states import State
from threadline.machine import Machine, load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.twin import session_of, simulate

EXAMPLES = Path(__file__).parents[2] / "examples"


def helix(machine: Machine) -> TickTable:
    options = Options()
    plan = plan_job(open_job(EXAMPLES / "helix.gcode", machine, options), machine, options)
    return tick_table(plan.commands)


@pytest.mark.parametrize("name", ["stepper-winder", "limits-alone"])
def test_undisturbed_run_equals_the_simulation_to_the_bit(name: str, tmp_path: Path) -> None:
    file = tmp_path / "limits.toml"
    file.write_text(LIMITS_ALONE, encoding="utf-8")
    machine = load_machine(str(file) if name == "limits-alone" else name)
    table = helix(machine)
    bench = Bench(other=machine, same=True).ready()
    bench.wire.group = group_ticks(machine, 0.0)  # as the process of a machine has it
    bench.executor.start(table)
    bench.go_on()
    assert bench.executor.ended == (RunEnd.COMPLETED, "")
    expected = read_once(simulate(table, machine))
    for channel in expected.channels:
        assert np.array_equal(bench.channel(channel.name), expected.samples(channel.name)[1])
    events = [event for block in bench.sink.blocks for event in block.events]
    assert events == [event for block in expected for event in block.events]


def test_rows_in_pieces_of_any_length_give_the_same_bits() -> None:
    machine = load_machine("stepper-winder")
    (block,) = helix(machine)
    whole = session_of(machine, np.zeros(2, np.int64)).advance(block)
    session, at, parts = session_of(machine, np.zeros(2, np.int64)), 0, []
    while at < len(block):
        n = int(np.random.default_rng(at).integers(1, 400))
        rows = slice(at, at + n)
        parts.append(
            session.advance(
                replace(
                    block,
                    first_tick=at,
                    counts=block.counts[rows],
                    operation=block.operation[rows],
                    events=(),
                )
            )
        )
        at += len(block.counts[rows])
    for name, values in whole.samples.items():
        assert np.array_equal(values, np.concatenate([part.samples[name] for part in parts])), name


def test_a_belt_that_falls_slack_ends_the_run_there() -> None:
    """Nothing is known after that, in the simulation and in the run."""
    machine = load_machine("stepper-winder")
    link = machine.links["x_belt"]
    assert link.preload is not None
    loose = replace(link, preload=replace(link.preload, si=1.0))
    machine = replace(machine, links={**machine.links, "x_belt": loose})
    table = helix(machine)
    bench = Bench(other=machine, same=True).ready()
    bench.executor.start(table)
    bench.go_on()
    ended, text = bench.executor.ended or (None, "")
    assert (bench.executor.state, ended) == (State.FAULT, RunEnd.FAULT)
    assert "links.x_belt: a run falls slack" in text
    known = simulate(table, machine).samples("X.load")[1]
    assert 1 < len(known) < table.tick_count()
    assert np.array_equal(bench.channel("X.load"), known)


def test_a_stepper_has_no_encoder_to_fail() -> None:
    with pytest.raises(OptionError, match="has no part with this fault"):
        parse_fault("stuck-encoder:X@1 s", load_machine("stepper-winder"))


@pytest.mark.long(shown_by="test_undisturbed_run_equals_the_simulation_to_the_bit")
@pytest.mark.usefixtures("forked_machine")
def test_the_command_records_what_it_proves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The machine is in a separate process, and the judge is the same."""
    check_same_when_run(tmp_path, capsys, "helix.gcode", "stepper-winder")
