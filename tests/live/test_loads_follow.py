"""Feed-forward moves motors faster than the limit of their loads, which is no fault."""

from __future__ import annotations

from contextlib import closing
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.live.bench import Bench
from tests.live.memory_sink import MemorySink
from tests.made import read_once
from threadline.commands.plan import Plan
from threadline.dynamics.analysis import fastest
from threadline.errors import LimitError
from threadline.files import RunEnd, Stream, TickBlock, TickTable, tick_table
from threadline.live.kinds_run import run_kind_of
from threadline.live.links import SimLink
from threadline.live.states import Desk, Hold
from threadline.live.supervised import Conduct
from threadline.machine import Machine, load_machine
from threadline.proof.options import options_of
from threadline.proof.pipeline import open_job, plan_job, simulate
from threadline.verdict import judge, load_spec

EXAMPLES = Path(__file__).parents[2] / "examples"


@cache
def planned() -> Plan:
    machine = load_machine("stitcher")
    options = options_of("auto", None, "0.1 mm", feed_forward=True, robust="0 %")
    return plan_job(open_job(EXAMPLES / "stitcher-even.seam.toml", machine, options), machine,
                    options)  # fmt: skip


def fastest_row(plan: Plan) -> float:
    return max(float(np.abs(block.counts).max()) for block in tick_table(plan.commands))


@pytest.mark.long(shown_by="tests/live/test_checked.py::test_the_command_runs_what_it_proves")
@pytest.mark.usefixtures("forked_machine")
def test_a_seam_at_67_stitches_a_second_runs_as_it_was_proved() -> None:
    """Its rows have twice the loads' limits; they are played to the bit, and judged so."""
    plan = planned()
    machine = plan.machine
    tick_s = float(machine.tick_clock.period_s)
    of_load = machine.velocity_limit * machine.counts_per_unit * tick_s
    assert fastest_row(plan) > 2.0 * of_load.max()
    sink = MemorySink()
    with closing(Desk()) as desk:
        ended, why = SimLink(0.0, None).run(plan, desk, sink, Conduct(hold=Hold.AT_REST))
    assert (ended, why) == (RunEnd.COMPLETED, "")
    proved, ran = read_once(simulate(plan.commands, machine)), read_once(sink.recording(plan))
    assert proved.channels == ran.channels
    for channel in proved.channels:
        assert np.array_equal(proved.samples(channel.name), ran.samples(channel.name))
    spec = load_spec(None, machine)
    verdicts = [judge([recording], plan, spec) for recording in (proved, ran)]
    assert verdicts[0].results == verdicts[1].results
    assert verdicts[1].passed
    speeds = [one.measured for one in verdicts[1].results if one.name == "velocity"]
    # Limits of the loads, which the plan keeps.
    assert max(one for one in speeds if one is not None) < machine.velocity_limit.max()


def test_without_feed_forward_the_limit_of_the_load_is_that_of_the_rows() -> None:
    plan = planned()
    assert run_kind_of(plan.machine).loads_follow(plan)
    bench = Bench(other=plan.machine, same=True).ready()
    with pytest.raises(LimitError, match=r"axis X: a row asks for \d+ counts in a tick"):
        bench.executor.start(plan.commands)
    assert bench.executor.state == "idle"


def of_one_motor(machine: Machine) -> float:
    """Return the closed form for X: full voltage, against back EMF and damping."""
    drive, body = machine.motors["x"], machine.bodies["x_motor"]
    assert body.damping is not None
    volts = drive.amplifier.gain.si * machine.controller_of("X").dac.range.si
    torque, emf, ohm = drive.torque_constant.si, drive.back_emf.si, drive.resistance.si
    speed_rad_s = volts * torque / (ohm * body.damping.si + torque * emf)
    return speed_rad_s * machine.links["x_belt"].stretch["x_motor"].si


def test_no_row_is_faster_than_a_motor_can_turn() -> None:
    machine = load_machine("stitcher")
    expected = of_one_motor(machine)
    # Both are closed forms with the same constants; they differ by rounding.
    assert fastest(machine, "X") == pytest.approx(expected, rel=1e-6)
    tick_s, start = float(machine.tick_clock.period_s), np.zeros(2, np.int64)
    most = int(expected * machine.counts_per_unit[0] * tick_s)
    for counts, refused in ((most, False), (most + 4, True)):
        rows = np.zeros((40, 2), np.int64)
        rows[20, 0] = counts
        block = TickBlock(first_tick=0, counts=rows, operation=np.zeros(40, np.int64))
        other = TickTable(
            clock=machine.tick_clock, axes=machine.axis_names,
            counts_per_unit=machine.counts_per_unit, start_counts=start,
            blocks=Stream.of([block]), job_sha256="", machine_sha256=machine.sha256,
        )  # fmt: skip
        bench = Bench(start=start, other=machine, same=True).ready()
        if refused:
            with pytest.raises(LimitError, match=f"{counts} counts in a tick, the limit is {most}"):
                bench.executor.start(other, loads_follow=True)
        else:
            bench.executor.start(other, loads_follow=True)
            assert bench.executor.state == "running"
