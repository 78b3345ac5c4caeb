"""Each guard trips at its fault, in time and with its name, and none trips without a fault."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.live.bench import Bench, table_of_counts, there_and_back, winder
from threadline.errors import CommandError, LinkFaultError, OptionError
from threadline.files import RunEnd, tick_table
from threadline.live.executor import Executor
from threadline.live.guards import Guards
from threadline.live.links import link_of
from threadline.live.sim_machine import SimFault, parse_fault
from threadline.live.states import State
from threadline.machine import load_machine
from threadline.machine.model import Machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job
from threadline.twin import simulate

EXAMPLES = Path(__file__).parents[2] / "examples"
TABLE = table_of_counts(there_and_back())
AT = 200  # at 10 counts per tick, on the way out


@pytest.mark.parametrize(
    ("kind", "where", "message", "within_ticks"),
    [
        # Twice the lag of 29 ms at 36 mm/s and 1 mm are 3.1 mm of following error, 2.1 mm more
        # than a sound machine has: that takes 58 ms, and the report after it.
        ("stuck-encoder", "X", "the encoder of X stands still while the axis should move", 12 + 10),
        ("encoder-jump", "A", "the encoder of A jumps by 2", 5),
        ("unheeded-reversal", "Y", "the output of Y changed its sign", 5),
        ("switch-hit", "x_high", "the limit switch x_high is hit", 5),
        ("late-ticks", "", "3 ticks in a row came late", 15),
        ("one-late-tick", "", "a tick came 6 periods late", 5),
    ],
)
def test_a_fault_brakes_on_the_path(kind: str, where: str, message: str, within_ticks: int) -> None:
    bench = Bench(fault=SimFault(kind, AT, where)).ready()
    bench.executor.start(TABLE)
    bench.go_on()
    assert bench.executor.state is State.FAULT
    ended, text = bench.executor.ended or (None, "")
    assert ended is RunEnd.FAULT
    assert message in text
    tripped = next(tick for tick, state, _, _ in bench.sink.log if state is State.FAULT)
    assert AT <= tripped <= AT + within_ticks + 5
    # 10 counts per tick brake within 4 ticks, on the path: A turns a count for each of X.
    counts = bench.commanded()
    assert counts[-1, 0] - counts[tripped, 0] <= 4 * 10
    assert abs(counts[-1, 0] - counts[-1, 1]) <= 1
    events = [event.kind for block in bench.sink.blocks for event in block.events]
    assert events.count("fault") == 1
    # The recording goes on until the machine has settled, as at any other end.
    assert len(counts) - tripped > 100
    assert [state for _, state, _, _ in bench.sink.log].count(State.FAULT) == 1


def report_of(commanded: np.ndarray, read: np.ndarray) -> dict[str, np.ndarray]:
    """Return a report of X with these commands and readings, m, at ticks of 5 ms."""
    return {"X.commanded": commanded, "X.measured": read, "X.voltage": np.zeros(len(commanded))}


def test_an_axis_that_falls_behind_is_a_fault_at_twice_its_lag_and_1_mm() -> None:
    """At 36 mm/s the lag is 29.4 ms: 1.06 mm behind is sound, and 3.1 mm is the limit."""
    positions_m = 0.036 * 0.005 * np.arange(400)
    for behind, trips in ((1.06e-3, False), (3.0e-3, False), (3.3e-3, True)):
        guards = Guards(winder())
        read = np.maximum(positions_m - behind, 0.5 * positions_m)  # it falls behind while it moves
        found = [
            guards.trip(at, report_of(positions_m[at : at + 5], read[at : at + 5]), False, 0.0)
            for at in range(0, 400, 5)
        ]
        assert any(found) is trips, behind
        assert not trips or next(filter(None, found)).startswith("axis X follows 3.")


def test_a_reading_beyond_the_travel_is_a_fault() -> None:
    """The travel of X ends at 0.5 m; 2 mm are allowed for the loop."""
    for reaches, trips in ((0.5019, False), (0.5021, True)):
        places = np.linspace(reaches - 1e-4, reaches, 5)
        found = Guards(winder()).trip(0, report_of(places, places), False, 0.0)
        assert (found == "axis X is beyond its travel") is trips


def test_run_needs_a_homed_machine_that_does_not_jog() -> None:
    """Neither enabling nor a jog leads to a run: homing and rest are needed."""
    bench = Bench()
    bench.executor.enable()
    with pytest.raises(CommandError, match="'start' is not possible while the machine is enabled"):
        bench.executor.start(TABLE)
    bench.executor.home()
    bench.executor.jog("X", 0.02)
    with pytest.raises(CommandError, match="'start' is not possible while the machine is jogging"):
        bench.executor.start(TABLE)
    begun = [message for message in bench.wire.sent if message.kind == "begin"]
    assert len(begun) == 1  # end the jog


def test_a_new_connection_moves_nothing() -> None:
    """A new executor, after one died, finds a machine at rest and has to home it."""
    bench = Bench().ready()
    bench.executor.start(TABLE)
    bench.go_on(AT)
    bench.wire.machine.play(100)  # nobody sends any more: the machine has braked by its tail
    stands = bench.wire.machine.position.copy()
    bench.wire._answers.clear()
    bench.wire.machine.greet()
    again = Executor(bench.wire, winder(), bench.desk, bench.sink, speed=0.0)  # type: ignore[arg-type]
    again.connect()
    assert again.state is State.DISABLED
    for ask in (lambda: again.start(TABLE), lambda: again.jog("X", 0.02)):
        with pytest.raises(CommandError, match="not possible while the machine is disabled"):
            ask()
    bench.wire.machine.play(100)
    assert (bench.wire.machine.position == stands).all()


def test_a_pressed_emergency_stop_is_told_and_nothing_starts_while_it_is() -> None:
    bench = Bench(fault=parse_fault("e-stop@1 s", winder())).ready()
    bench.executor.start(TABLE)
    bench.go_on()
    executor = bench.executor
    assert (executor.state, executor.ended) == (
        State.FAULT, (RunEnd.FAULT, "the emergency stop is pressed"),
    )  # fmt: skip
    assert AT <= executor.tick <= AT + 5
    events = [event for block in bench.sink.blocks for event in block.events]
    assert [event.name for event in events if event.kind == "fault"] == [
        "the emergency stop is pressed"
    ]
    assert bench.wire.machine.standing  # nothing is left to go on when it is released
    executor.reset()
    with pytest.raises(LinkFaultError, match="refused: the emergency stop is pressed"):
        executor.enable()
    assert executor.state is State.DISABLED


@pytest.mark.parametrize("kind", ["lost-link", "power-loss"])
def test_a_link_that_is_gone_is_a_fault_at_once(kind: str) -> None:
    bench = Bench(fault=SimFault(kind, AT)).ready()
    bench.executor.start(TABLE)
    bench.go_on()
    assert bench.executor.ended == (RunEnd.FAULT, "the link is gone")
    assert AT <= bench.executor.tick <= AT + 5
    events = [event for block in bench.sink.blocks for event in block.events]
    assert (events[-1].kind, events[-1].name) == ("fault", "the link is gone")


def test_after_a_fault_nothing_moves_before_reset_enable_and_home() -> None:
    bench = Bench(fault=SimFault("encoder-jump", AT, "X")).ready()
    bench.executor.start(TABLE)
    bench.go_on()
    stands = bench.wire.machine.position.copy()
    bench.executor.reset()
    assert bench.executor.state is State.DISABLED
    bench.executor.enable()
    bench.wire.machine.play(50)
    assert (bench.wire.machine.position == stands).all()


@pytest.mark.parametrize(
    ("job", "machine", "options"),
    [
        ("x-180.prg", "lathe-winder", {"interpolation": "linear"}),
        ("x-180.prg", "lathe-winder+physical+stiction", {"interpolation": "linear"}),
        ("x-180.prg", "lathe-winder", {"interpolation": "linear", "feed": "80 count/tick"}),
        ("x-180.prg", "lathe-winder", {"interpolation": "b-spline", "feed": "80 count/tick"}),
        ("cone-dome-cylinder.prg", "lathe-winder", {"feed": "40 count/tick"}),
        ("stitcher-test-path.seam.toml", "stitcher", {}),
        ("stitcher-test-path.seam.toml", "stitcher", {"feed_forward_s": 0.04}),
    ],
)
def test_a_sound_machine_trips_nothing(job: str, machine: str, options: dict[str, object]) -> None:
    from threadline.proof.option_words import parse_feed

    chosen: Machine = load_machine(machine)
    if "feed" in options:
        options = {**options, "feed": parse_feed(str(options["feed"]))}
    how = Options(**options)  # type: ignore[arg-type]
    plan = plan_job(open_job(EXAMPLES / job, chosen, how), chosen, how)
    guards = Guards(chosen)
    for block in simulate(tick_table(plan.commands), chosen):
        n = len(block.samples["operation"])
        for at in range(0, n, 25):
            part = {name: values[at : at + 25] for name, values in block.samples.items()}
            tick = block.first_tick[chosen.tick_clock.name] + at
            assert guards.trip(tick, part, False, 0.0) == "", (tick, job, machine)


def test_a_drive_that_a_real_switch_cuts_is_a_fault() -> None:
    """The twin's switch at 20 mm cuts the drive's supply; no reading is injected."""
    machine = winder()
    switch = machine.inputs["x_high"]
    near = replace(machine, inputs={"x_high": replace(switch, at=replace(switch.at, si=0.02))})
    bench = Bench(other=near, same=True).ready()
    bench.executor.start(TABLE)
    bench.go_on()
    assert bench.executor.ended == (RunEnd.FAULT, "the limit switch x_high is hit")
    assert bench.channel("X.load").max() >= 0.02
    # The lag of 1.1 mm, a report of 0.9 mm and braking; the load coasts without its drive.
    assert bench.channel("X.commanded").max() <= 0.0235


def test_the_lag_is_the_models() -> None:
    """A ramp through the twin lags by the guard's value: 29.35 ms on X."""
    rows = np.zeros((600, 3), np.int64)
    rows[:, 1] = 10
    recording = simulate(table_of_counts(rows), winder())
    commanded, read = (recording.samples(f"X.{what}")[1] for what in ("commanded", "measured"))
    speed = 10 / winder().counts_per_unit[1] / 0.005
    lag = (commanded - read)[500] / speed
    guards = Guards(winder())
    assert lag == pytest.approx(guards.lag_s["X"], rel=0.02)  # half a count of the encoder


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stuck-encoder:Q@1 s", "has no 'Q'"),
        ("stuck-encoder@1 s", "does not say where"),
        ("explode@1 s", "there is no fault 'explode'"),
        ("lost-link:X@1 s", "takes no axis"),
        ("lost-link", "is no fault"),
        ("lost-link@soon", "soon"),
        ("lost-link@-1 s", "'-1 s' is no time of a run"),
        ("stuck-encoder:X@1e300 s", "'1e300 s' is no time of a run"),
    ],
)
def test_a_fault_that_there_is_not_is_refused(text: str, message: str) -> None:
    with pytest.raises(OptionError, match=message):
        parse_fault(text, winder())


def test_faults_are_read() -> None:
    assert parse_fault("stuck-encoder:X@1.2 s", winder()) == SimFault("stuck-encoder", 240, "X")
    assert parse_fault("late-ticks@500 ms", winder()) == SimFault("late-ticks", 100)


@pytest.mark.parametrize("kind", ["e-stop", "power-loss"])
def test_a_machine_without_supply_is_not_said_to_have_braked(kind: str) -> None:
    link = link_of("sim", winder(), 0.0, parse_fault(f"{kind}@1 s", winder()))
    assert "coasted" in link.after_fault
    assert "come to rest" not in link.after_fault
    lost = link_of("sim", winder(), 0.0, parse_fault("lost-link@1 s", winder()))
    assert "come to rest by itself" in lost.after_fault
