"""The error of a hold is computed before the start; beyond a limit the hold waits for a rest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.live.bench import Bench, table_of_counts, there_and_back
from threadline.commands.plan import Plan
from threadline.files import RunEnd, Stream, TickBlock, tick_table
from threadline.live.braking import MOST_PLACES, CountLimits, brake
from threadline.live.grbl_operated import GrblOperated
from threadline.live.hold_deviation import (
    hold_ahead_m,
    hold_deviation_m,
    hold_limit_m,
    hold_waits,
    hold_words,
    rests_within,
    spoiled_by_holds,
)
from threadline.live.links import GrblLink, RowsOperated, SimLink
from threadline.live.path_window import PathWindow
from threadline.live.states import Cause, Hold, State
from threadline.live.supervised import interventions
from threadline.machine import load_machine
from threadline.proof.option_form import Door
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, simulate, with_product
from threadline.proof.request import Words
from threadline.verdict import load_spec

TICK_S = 0.005
EXAMPLES = Path(__file__).parents[2] / "examples"


def planned(job: str, name: str, **options: object) -> Plan:
    machine, how = load_machine(name), Options(**options)  # type: ignore[arg-type]
    return plan_job(open_job(EXAMPLES / job, machine, how), machine, how)


def test_motors_that_are_told_the_path_leave_nothing() -> None:
    assert hold_deviation_m(planned("x-180.prg", "lathe-winder", interpolation="linear")) == 0.0


@pytest.mark.parametrize(
    ("job", "machine", "options"),
    [
        ("x-180.prg", "lathe-winder", {"interpolation": "linear", "shaper": "zv:12Hz:0.02"}),
        ("stitcher-test-path.seam.toml", "stitcher", {"feed_forward_s": 0.04}),
    ],
)
def test_deviation_of_a_hold_is_the_distance_of_rows_from_the_path(
    job: str, machine: str, options: dict[str, object]
) -> None:
    """Every place of the table is compared with each of 40 000 points of the path."""
    plan = planned(job, machine, **options)
    timed, table = plan.motion.timed, tick_table(plan.commands)
    assert timed is not None
    rows = np.concatenate([block.counts for block in table])
    radius = plan.machine.radius_m
    places = np.cumsum(rows, axis=0) / plan.machine.counts_per_unit * radius
    path = timed(np.linspace(0.0, timed.duration_s, 40_000)) * radius
    worst = max(
        float(np.sqrt(((path - place) ** 2).sum(axis=1)).min())
        for place in places[:: max(len(places) // 400, 1)]
    )
    found = hold_deviation_m(plan)
    # A 400th of the places misses the worst by little; points of the path are 0.03 mm apart.
    assert worst - 3e-5 <= found <= worst * 1.05 + 3e-5


def test_the_stitchers_feed_forward_may_not_be_held_anywhere() -> None:
    plan = planned("stitcher-test-path.seam.toml", "stitcher", feed_forward_s=0.04)
    assert hold_deviation_m(plan) > hold_limit_m(load_spec(None, plan.machine)) > 0.0


def test_a_hold_then_stands_at_the_next_rest_and_goes_on_from_there() -> None:
    rows = there_and_back(40.0, cruise=100)  # X reverses within 8 rows: too short for a rest
    rows = np.concatenate([rows, np.zeros((12, 3), np.int64), rows])
    bench = Bench().ready()
    bench.executor.start(table_of_counts(rows), hold=Hold.AT_REST)
    bench.go_on(150)
    bench.desk.ask(Cause.HOLD)
    bench.go_on(900)
    assert bench.executor.state is State.HOLDING
    assert [text for *_, cause, text in bench.sink.log if cause is Cause.HOLD] == [
        "it goes on to the next rest and stands there"
    ]
    counts = bench.commanded()
    # It has played the first half unchanged, and stands in the rest after it.
    half = np.cumsum(rows[: len(rows) // 2], axis=0)
    assert counts[899].tolist() == half[-1].tolist()
    assert np.array_equal(counts[1 : len(half) + 1], half)
    bench.desk.ask(Cause.RESUME)
    bench.go_on()
    assert bench.executor.ended == (RunEnd.COMPLETED, "")
    assert bench.commanded()[-1].tolist() == rows.sum(axis=0).tolist()


def test_a_hold_in_a_rest_stands_there() -> None:
    """Braking rows after the sent rows are not played: they would be unwanted motion."""
    rows = there_and_back(40.0, cruise=100)
    rows = np.concatenate([rows, np.zeros((200, 3), np.int64), rows])
    bench = Bench().ready()
    bench.executor.start(table_of_counts(rows), hold=Hold.AT_REST)
    bench.go_on(len(rows) // 2 - 60)
    bench.desk.ask(Cause.HOLD)
    bench.go_on(len(rows) + 100)
    assert bench.executor.state is State.HOLDING
    bench.desk.ask(Cause.RESUME)
    bench.go_on()
    assert bench.executor.ended == (RunEnd.COMPLETED, "")
    assert bench.commanded()[-1].tolist() == rows.sum(axis=0).tolist()


def test_hold_waits_for_a_rest_if_loads_would_run_on_along_the_path() -> None:
    """At 36 mm/s the motor is 29.4 ms ahead of its load, which catches up in a hold."""
    plan = planned("x-180.prg", "lathe-winder", feed_forward_s=0.04)
    meant, table = plan.motion.of_loads, tick_table(plan.commands)
    assert meant is not None
    rows = np.concatenate([block.counts for block in table])
    commanded = np.cumsum(rows, axis=0) / plan.machine.counts_per_unit
    at = meant(TICK_S * np.arange(1, len(rows) + 1))
    worst = np.linalg.norm((commanded - at) * plan.machine.radius_m, axis=1).max()
    assert hold_ahead_m(plan) == pytest.approx(worst)
    assert 36e-3 * 29.4e-3 < worst < 2e-3  # most of all at the reversal
    spec = load_spec(None, plan.machine)
    assert hold_waits(plan, spec, leaves_m=1e-6)
    words = hold_words(plan, 1e-4, Hold.AT_REST)
    assert f"0.10 mm beside the path or {1e3 * worst:.2f} mm from where it is due" in words
    assert words.endswith("there is none before the end")
    assert hold_words(plan, 1e-4, Hold.AT_ONCE).endswith("within the limit")
    wide = replace(spec, criteria=[
        replace(c, limit=2e-3) if c.name == "progress_error" else c for c in spec.criteria
    ])  # fmt: skip
    assert not hold_waits(plan, wide, leaves_m=1e-6)
    motors = planned("x-180.prg", "lathe-winder", interpolation="linear")
    assert hold_ahead_m(motors) == 0.0
    assert hold_words(motors, 0.0, Hold.AT_ONCE) == ""
    assert not hold_waits(motors, spec, leaves_m=0.0)


@pytest.mark.parametrize(("rest", "long"), [(0, False), (1, False), (2, True), (40, True)])
def test_plan_knows_whether_a_hold_finds_a_rest(rest: int, long: bool) -> None:
    """Compared with the executor: it stands before the end if the plan says that it can."""
    rows = there_and_back(40.0, cruise=30)
    whole = np.concatenate([np.zeros((30, 3), np.int64), rows, np.zeros((rest, 3), np.int64), rows])
    table = table_of_counts(whole)
    bench = Bench().ready()
    bench.executor.start(table, hold=Hold.AT_REST)
    bench.go_on(100)
    bench.desk.ask(Cause.HOLD)
    bench.go_on(len(whole) + 30)
    plan = planned("x-180.prg", "lathe-winder", interpolation="linear")
    known = rests_within(replace(plan, commands=table))
    assert bool(bench.commanded()[-1, 0] < whole[:, 0].sum()) is known
    assert known is long  # 50 ms, with the surrounding rows without counts


def test_braking_that_shakes_the_load_out_of_spec_is_foreseen() -> None:
    """Steppers play the path itself: a hold is on it, but its braking shakes the belt."""
    plan = planned("helix.gcode", "stepper-winder")
    spec = load_spec(None, plan.machine)
    assert hold_deviation_m(plan) == 0.0
    assert not hold_waits(plan, spec, leaves_m=0.0)

    spoiled = spoiled_by_holds(plan, spec)

    found = {result.name: result for result in spoiled}
    assert set(found) == {"contour_error", "progress_error"}
    for result in found.values():
        assert result.measured is not None and result.limit == pytest.approx(0.5e-3)
        assert result.limit < result.measured < 1e-3
    words = hold_words(plan, 0.0, Hold.AT_REST, spoiled=spoiled)
    assert "contour error" in words and "of 0.5 mm" in words
    assert words.endswith("so a hold stands at the end, for there is no rest")


def test_simulated_hold_has_the_predicted_error() -> None:
    """The executor brakes the simulated machine at the fastest row: its trace has this error.

    The test uses only the row from the prediction.
    """
    plan = planned("helix.gcode", "stepper-winder")
    spec = load_spec(None, plan.machine)
    table = tick_table(plan.commands)
    rows = np.concatenate([block.counts for block in table])
    at = np.argmax(np.linalg.norm(rows / plan.machine.counts_per_unit, axis=1))
    held = int(at) + 1
    window = PathWindow(table)
    window.reach(held + 2.0 * MOST_PLACES)
    down = brake(window, (held - 2.0, held - 1.0, float(held)), CountLimits.of(plan.machine))
    stands = np.full(400, down[-1])
    travelled = np.vstack([window.rounded(np.arange(held + 1.0)), window.rounded(down),
                           window.rounded(stands)])  # fmt: skip
    load = simulate_rows(plan, np.diff(travelled, axis=0))
    due = travelled / plan.machine.counts_per_unit * plan.machine.radius_m
    shaken = np.linalg.norm((load - due[: len(load)])[held:], axis=1).max()

    (worst,) = [r for r in spoiled_by_holds(plan, spec) if r.name == "progress_error"]

    assert worst.measured is not None
    assert worst.measured == pytest.approx(shaken, rel=0.35)


def test_a_controller_that_holds_by_itself_is_not_told_to_wait() -> None:
    """Its hold stands where it is asked for: the note says what that does, and no rest is waited
    for."""
    plan = planned("helix.gcode", "stepper-winder")
    may = interventions(plan, load_spec(None, plan.machine))
    assert may.hold is Hold.GENTLY and "so a hold brakes within 0.26 s" in may.notes[0]
    by_itself = may.at_once()
    assert by_itself.hold is Hold.AT_ONCE
    assert by_itself.notes[0].startswith("the controller holds at once: at full speed that shakes")
    assert "stands at" not in "".join(by_itself.notes)
    assert GrblLink.holds_at_once and GrblOperated.holds_at_once
    assert not RowsOperated.holds_at_once and not SimLink.holds_at_once


def test_a_gentle_hold_keeps_the_work_in_spec() -> None:
    """Half a second of braking lets the belts follow, where braking at once shakes them."""
    plan = planned("helix.gcode", "stepper-winder")
    assert spoiled_by_holds(plan, load_spec(None, plan.machine), Hold.GENTLY) == ()


def test_a_hold_that_lifts_the_fibre_is_foreseen_wherever_it_lifts() -> None:
    """The loops close up their lags in a hold, and the eye swings. At the fastest rows that lifts
    nothing."""
    job = EXAMPLES / "vessel.wind.toml"
    machine = load_machine("lathe-winder")
    how = Words.of(
        "prove", Door.PYTHON, {"feed": "70 mm/s", "product": str(job)}
    ).options(str(job))  # fmt: skip
    plan = plan_job(open_job(job, machine, how), machine, how)
    spec = with_product(load_spec(None, machine), machine, how)

    spoiled = spoiled_by_holds(plan, spec)

    (lifting,) = [result for result in spoiled if result.name == "lifting"]
    assert lifting.measured is not None and lifting.limit == pytest.approx(5e-5)
    assert lifting.measured > 2.0 * lifting.limit
    assert spoiled_by_holds(plan, spec, Hold.GENTLY) == ()


def braked(hold: Hold, stop_after: int | None = None) -> tuple[Bench, int, int]:
    """Return a held run, the tick at which its rows slow down, and the tick at which it rests."""
    rows = there_and_back(40.0, cruise=600)
    bench = Bench().ready()
    bench.executor.start(table_of_counts(rows), hold=hold)
    bench.go_on(200)
    bench.desk.ask(Cause.HOLD)
    if stop_after is not None:
        bench.go_on(200 + stop_after)
        bench.desk.ask(Cause.STOP)
    bench.go_on(560)
    steps = np.diff(bench.commanded()[:, 0])
    planned_steps = rows[: len(steps), 0]
    slows = int(np.argmax(steps != planned_steps))
    return bench, slows, int(np.flatnonzero(steps)[-1]) + 1


def test_a_gentle_hold_brakes_for_half_a_second_and_starts_as_gently() -> None:
    at_once, slows, rests = braked(Hold.AT_ONCE)
    gently, slows_too, rests_later = braked(Hold.GENTLY)
    assert at_once.executor.state is gently.executor.state is State.HOLDING
    assert slows_too == pytest.approx(slows, abs=8)  # it begins to brake with slope 0
    assert rests - slows < 0.25 / TICK_S < 0.5 / TICK_S <= rests_later - slows
    stood = len(gently.commanded())
    gently.desk.ask(Cause.RESUME)
    gently.go_on()
    assert gently.executor.ended == (RunEnd.COMPLETED, "")
    counts = gently.commanded()[:, 0]
    assert counts[-1] == there_and_back(40.0, cruise=600)[:, 0].sum()
    steps = np.diff(counts[stood - 1 :])
    full = int(np.argmax(steps == steps.max())) - int(np.argmax(steps > 0))
    assert full >= 0.4 / TICK_S  # it starts as slowly as it braked


def test_a_stop_in_a_gentle_hold_brakes_at_once() -> None:
    _, slows, rests_later = braked(Hold.GENTLY)
    stopped, slows_too, rests = braked(Hold.GENTLY, stop_after=15)
    assert stopped.executor.ended is not None and stopped.executor.ended[0] is RunEnd.STOPPED
    assert rests - slows_too < 0.6 * (rests_later - slows)


def test_a_hold_that_stays_in_spec_is_left_alone() -> None:
    """The same machine with limits of 5 mm, and a winder whose loops damp the braking."""
    plan = planned("helix.gcode", "stepper-winder")
    spec = load_spec(None, plan.machine)
    wide = replace(
        spec, criteria=tuple(replace(c, limit=c.limit and 10.0 * c.limit) for c in spec.criteria)
    )
    assert spoiled_by_holds(plan, wide) == ()
    slow = planned("x-180.prg", "lathe-winder")
    assert spoiled_by_holds(slow, load_spec(None, slow.machine)) == ()


def test_failure_without_a_hold_is_not_blamed_on_holds() -> None:
    """A plan that is out of specification by itself is run with an override."""
    plan = planned("helix.gcode", "stepper-winder")
    spec = load_spec(None, plan.machine)
    hard = replace(spec, criteria=tuple(replace(c, limit=c.limit and 1e-6) for c in spec.criteria))
    assert spoiled_by_holds(plan, hard) == ()


def simulate_rows(plan: Plan, counts: np.ndarray) -> np.ndarray:
    """Return (n, axes) places of the load, lengths at the tool, at the ticks of some rows."""
    table = tick_table(plan.commands)
    block = TickBlock(first_tick=0, counts=counts, operation=np.zeros(len(counts), dtype=np.int64))
    run = simulate(replace(table, blocks=Stream.of([block])), plan.machine)
    places = [run.samples(f"{axis}.load")[1] for axis in plan.machine.axis_names]
    return np.stack(places, axis=1)[: len(counts)] * plan.machine.radius_m
