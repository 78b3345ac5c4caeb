"""A schedule of valves runs as simulated; it stops, holds at its rests, and switches off."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.live.bench import Bench
from tests.live.proved_and_run import check_same_when_run
from tests.made import read_once
from threadline.commands.plan import Plan
from threadline.errors import CommandError, LimitError
from threadline.files import Recording, RunEnd, switch_schedule
from threadline.live.sim_machine import SimFault, parse_fault
from threadline.live.states import Cause, Hold, State
from threadline.machine import Machine, load_machine
from threadline.machine.quantity import parse_machine_quantity
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.twin.switching import simulate_switching
from threadline.verdict import Criterion, Result, Spec, judge

EXAMPLES = Path(__file__).parents[2] / "examples"
ACROSS = 370  # scan in which X moves across, with the letter held
LEFT_ALONE_SCANS = 10 + 3  # the sent scans, and a report


@cache
def placer() -> Machine:
    return load_machine("letter-placer")


@cache
def planned() -> Plan:
    job = open_job(EXAMPLES / "letter-cycle.toml", placer(), Options())
    return plan_job(job, placer(), Options())


@cache
def simulated() -> Recording:
    return read_once(simulate_switching(switch_schedule(planned().commands), placer()))


def bench(fault: SimFault | None = None) -> Bench:
    made = Bench(other=placer(), same=True, start=np.zeros(0, np.int64), fault=fault).ready()
    made.executor.start(planned().commands, hold=Hold.AT_REST)
    return made


def cycle(recording: Recording) -> Result:
    """Return the results of the cycle time."""
    asked = Criterion(name="cycle_time", limit=None)
    results = judge([recording], planned(), Spec(name="time", criteria=(asked,))).results
    return next(result for result in results if result.name == "cycle_time")


def outputs(made: Bench) -> np.ndarray:
    """Return (samples, outputs) states, every millisecond."""
    return np.stack([made.channel(name) for name in placer().outputs], axis=1)


def test_undisturbed_run_equals_the_simulation_to_the_bit() -> None:
    made = bench()
    made.go_on()
    assert made.executor.ended == (RunEnd.COMPLETED, "")
    for channel in simulated().channels:
        assert np.array_equal(made.channel(channel.name), simulated().samples(channel.name)[1])
    events = [event for block in made.sink.blocks for event in block.events]
    assert events == [event for block in simulated() for event in block.events]


@pytest.mark.parametrize("scan", [3, 160, 250, ACROSS, 500, 700])
def test_a_stop_switches_everything_off_at_the_next_scan(scan: int) -> None:
    made = bench()
    made.go_on(scan)
    at = made.executor.tick
    for cause in (Cause.HOLD, Cause.RESUME, Cause.STOP, Cause.RESUME):
        made.desk.ask(cause)
    made.go_on()
    assert made.executor.ended == (RunEnd.STOPPED, "stopped by the operator")
    on = outputs(made).any(axis=1)
    assert on[10 * at - 1]
    assert not on[10 * at :].any()
    # Cylinders may stand anywhere: the machine must be homed before anything else.
    assert made.executor.state is State.ENABLED
    with pytest.raises(CommandError, match="'start' is not possible"):
        made.executor.start(planned().commands)


@pytest.mark.parametrize("scan", [160, 250, ACROSS, 480, 570])
def test_a_hold_stands_at_the_next_rest_with_the_letter_held(scan: int) -> None:
    made = bench()
    made.go_on(scan)
    made.desk.ask(Cause.HOLD)
    made.go_on(scan + 400)
    held = outputs(made)[-1000:]
    assert made.executor.state is State.HOLDING
    assert (held == held[0]).all()
    kinds = [output.kind for output in placer().outputs.values()]
    on = {kind for kind, level in zip(kinds, held[0], strict=True) if level}
    assert on <= {"soft-start", "vacuum"}
    assert (on == {"soft-start", "vacuum"}) == (238 < scan < 557)
    made.desk.ask(Cause.RESUME)
    made.go_on()
    assert made.executor.ended == (RunEnd.COMPLETED, "")
    # Every switching of the schedule comes once, in order, only later.
    switched = outputs(made)
    whole = np.stack([simulated().samples(name)[1] for name in placer().outputs], axis=1)
    for rows in (switched, whole):
        assert rows.any()
    changes = [rows[1:][np.diff(rows, axis=0).any(axis=1)].tolist() for rows in (switched, whole)]
    assert changes[0] == changes[1]
    # The operator asked for the hold: the cycle time is the time without it.
    took = [cycle(one) for one in (made.sink.recording(planned()), simulated())]
    assert took[0].measured == pytest.approx(took[1].measured, abs=1e-9)
    later_s = (len(switched) - len(whole)) * 1e-3
    assert took[0].note == f"without {later_s:.6g} s in which it was held"
    assert took[1].note == ""
    assert 3000 < len(switched) - len(whole) < 4100  # ms


def test_a_hold_after_the_last_scan_is_refused_and_the_run_ends() -> None:
    made = bench()
    while made.executor.ended is None:
        made.executor.step()
    made.desk.ask(Cause.HOLD)
    made.go_on()
    assert (made.executor.state, made.executor.share_done) == (State.IDLE, 1.0)


def test_a_hold_lasts_longer_than_a_wait_may() -> None:
    """A minute without its contact is a fault in a wait, and no fault in a hold."""
    made = bench()
    made.go_on(ACROSS)
    made.desk.ask(Cause.HOLD)
    made.go_on(ACROSS + 6500)
    assert made.executor.state is State.HOLDING
    made.desk.ask(Cause.STOP)
    made.go_on()
    assert made.executor.ended == (RunEnd.STOPPED, "stopped by the operator")


@pytest.mark.parametrize("scan", [20, 160, ACROSS, 600])
def test_outputs_switch_off_when_refills_stop(scan: int) -> None:
    made = bench()
    made.go_on(scan)
    made.wire.mute = True
    machine = made.wire.machine
    for _ in range(50):
        machine.play(3)
        message = made.wire.receive()
        assert message is not None
        made.sink.block(made.executor.far_end.reported(message, None))
    assert machine.standing
    on = outputs(made).any(axis=1)
    assert not on[10 * (scan + LEFT_ALONE_SCANS) :].any()


def test_a_wait_that_is_not_met_while_nobody_refills_switches_off_too() -> None:
    """The machine's clock counts, not the schedule's, which stands at a wait."""
    made = bench()
    made.go_on(355)  # waits for z_is_up from scan 355 on
    made.wire.mute = True
    machine = made.wire.machine
    machine.play(40)
    assert machine.standing


def test_a_wait_without_its_contact_is_a_fault() -> None:
    held = parse_machine_quantity("100 kN exact, assumed", ("N",))  # X is jammed
    jammed = replace(placer().cylinders["X"], friction=held, stiction=held)
    machine = replace(placer(), cylinders={**placer().cylinders, "X": jammed})
    made = Bench(other=machine, same=True, start=np.zeros(0, np.int64)).ready()
    made.executor.start(planned().commands, hold=Hold.AT_REST)
    made.go_on()
    ended, text = made.executor.ended or (None, "")
    assert (made.executor.state, ended) == (State.FAULT, RunEnd.FAULT)
    assert "the input 'x_is_right' did not become on within 2 s" in text
    assert not outputs(made)[-500:].any()


@pytest.mark.parametrize(
    ("message", "expected_text"),
    [
        ("light-grid@3.7 s", "light_grid is off: a broken beam"),
        ("stuck-contact:z_is_up@0.5 s", "z_is_up and z_is_down are on together"),
        ("stuck-contact:z_is_down@0.5 s", "knife is on, and z_is_down, which it needs, is not"),
        ("late-ticks@1 s", "3 ticks in a row came late"),
        ("one-late-tick@1 s", "a tick came 6 periods late"),
        ("lost-link@1 s", "the link is gone"),
        ("power-loss@1 s", "the link is gone"),
    ],
)
def test_a_fault_switches_everything_off(message: str, expected_text: str) -> None:
    fault = parse_fault(message, placer())
    made = bench(fault)
    made.go_on()
    ended, text = made.executor.ended or (None, "")
    assert (made.executor.state, ended) == (State.FAULT, RunEnd.FAULT)
    assert expected_text in text
    tripped = next(tick for tick, state, _, _ in made.sink.log if state is State.FAULT)
    assert not outputs(made)[10 * tripped :].any()
    if not message.startswith("stuck"):
        assert tripped <= fault.tick + 15  # three reports of five scans


def test_a_row_for_both_sides_of_a_cylinder_is_never_sent() -> None:
    schedule = switch_schedule(planned().commands)
    levels = schedule.levels.copy()
    levels[1, [schedule.outputs.index(name) for name in ("z_down", "z_up")]] = 1
    made = Bench(other=placer(), same=True, start=np.zeros(0, np.int64)).ready()
    made.executor.start(replace(schedule, levels=levels))
    with pytest.raises(LimitError, match="cylinder Z: a row switches both of its valves on"):
        made.executor._ahead.extend(400)  # type: ignore[union-attr]
    made.go_on()
    assert made.executor.state is State.FAULT
    assert not outputs(made)[:, schedule.outputs.index("z_down")].any()


@pytest.mark.usefixtures("forked_machine")
def test_the_command_records_what_it_proves(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The machine is in a separate process, and the judge is the same."""
    check_same_when_run(tmp_path, capsys, "letter-cycle.toml", "letter-placer", "--shaper", "um-zv")
