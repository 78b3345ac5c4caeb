"""An overridden run is judged by the plan's time; a run that it would spoil is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.live.bench import Bench, winder
from tests.live.test_held_runs import SPEC, alike, plan_of
from tests.live.test_hold_deviation import planned
from threadline.commands.plan import Plan
from threadline.errors import RecordingError
from threadline.files import Recording, RunEnd, Stream
from threadline.files.formats import read_recording, write_recording
from threadline.live.hold_deviation import (
    hold_deviation_m,
    override_exceeds,
    spoiled_by_override,
)
from threadline.live.states import Cause, Hold, State
from threadline.live.supervised import interventions
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job, simulate
from threadline.verdict import Spec, happened_lines, judge, load_spec

ZIGZAG = "".join(f"G1 X{k % 2} F3000\n" for k in range(60))
"""A millimetre to and fro, faster than the first mode of X lets the load follow."""


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return plan_of(tmp_path_factory.mktemp("overridden"))


@pytest.fixture(scope="module")
def overridden(plan: Plan) -> Recording:
    """A run at 70 % on its way forth, and at 30 % with a hold on its way back."""
    bench = Bench().ready()
    bench.executor.start(plan.commands, loads_follow=True)
    bench.go_on(60)
    bench.desk.override(70)
    while bench.executor.state is not State.HOLDING:
        bench.executor.step()  # up to the stop of the program
    bench.desk.override(30)
    bench.desk.ask(Cause.RESUME)
    bench.go_on(bench.executor.tick + 250)
    bench.desk.ask(Cause.HOLD)
    bench.go_on(bench.executor.tick + 100)
    bench.desk.ask(Cause.RESUME)
    bench.go_on()
    assert bench.executor.ended == (RunEnd.COMPLETED, "")
    return bench.sink.recording(plan)


def test_overridden_run_has_the_verdict_of_a_run_at_full_feed(
    plan: Plan, overridden: Recording
) -> None:
    verdict = judge([overridden], plan, SPEC)
    assert verdict.passed
    assert alike(verdict, judge([simulate(plan.commands, winder())], plan, SPEC))
    lines = [line for line in happened_lines(verdict) if "overrides" in line]
    assert len(lines) == 2
    assert "overrides set in the run: feed 70 %" in lines[0] and "line 2" in lines[0]
    assert "overrides set in the run: feed 30 %" in lines[1] and "line 4" in lines[1]
    assert " s" in lines[0]


def test_without_what_it_tells_it_is_seconds_behind(plan: Plan, overridden: Recording) -> None:
    blocks = [
        replace(block, events=tuple(replace(e, name="") if e.kind == "plan" else e
                                    for e in block.events))
        for block in overridden
    ]  # fmt: skip
    verdict = judge([replace(overridden, blocks=Stream.of(blocks))], plan, SPEC)
    assert not verdict.passed


def test_load_motion_during_an_override_is_judged(plan: Plan, overridden: Recording) -> None:
    blocks = []
    for block in overridden:
        first, load = block.first_tick["servo"], block.samples["X.load"].copy()
        load[[180 <= tick < 200 for tick in range(first, first + len(load))]] += 8e-4
        blocks.append(replace(block, samples={**block.samples, "X.load": load}))
    verdict = judge([replace(overridden, blocks=Stream.of(blocks))], plan, SPEC)
    assert not verdict.passed
    assert (verdict.result("progress_error").measured or 0.0) > 7e-4


@pytest.mark.parametrize("ending", ["npz", "mcap", "csv"])
def test_every_file_keeps_the_rates(
    ending: str, plan: Plan, overridden: Recording, tmp_path: Path
) -> None:
    file = tmp_path / f"overridden.{ending}"
    write_recording(overridden, file)
    assert judge([read_recording(file)], plan, SPEC).results == (
        judge([overridden], plan, SPEC).results
    )


@pytest.mark.parametrize("rate", ["-0.5", "0", "1.5", "nan", "fast"])
def test_a_rate_that_no_run_has_is_refused(rate: str, plan: Plan, overridden: Recording) -> None:
    blocks = [
        replace(block, events=tuple(replace(e, name=rate) if e.kind == "plan" else e
                                    for e in block.events))
        for block in overridden
    ]  # fmt: skip
    with pytest.raises(RecordingError, match="goes on at the rate"):
        judge([replace(overridden, blocks=Stream.of(blocks))], plan, SPEC)


# --- before the run ------------------------------------------------------------------------


def zigzag(folder: Path) -> tuple[Plan, Spec]:
    """Return a plan on steppers that keeps 0.08 mm of contour error, and the specification."""
    job, machine = folder / "zigzag.gcode", load_machine("stepper-winder")
    job.write_text(f"G21\nG90\nG1 X0 F6000\n{ZIGZAG}M30\n", "utf-8")
    plan = plan_job(open_job(job, machine, Options()), machine, Options())
    spec = load_spec(None, machine)
    criteria = tuple(
        replace(c, limit=8e-5) if c.name == "contour_error" else c for c in spec.criteria
    )
    return plan, replace(spec, criteria=criteria)


def test_a_rate_that_meets_a_mode_is_foreseen_and_named(tmp_path: Path) -> None:
    """The executor's own recording on the simulated machine shows the same."""
    plan, spec = zigzag(tmp_path)
    assert judge([simulate(plan.commands, plan.machine)], plan, spec).result(
        "contour_error"
    ).measured == pytest.approx(7.4e-5, rel=0.02)
    percent, spoiled = spoiled_by_override(plan, spec, Hold.AT_REST)
    assert [result.name for result in spoiled] == ["contour_error"]
    may = interventions(plan, spec)
    assert f"at {percent} % its loads would shake (contour error 0." in may.no_override
    assert "of 0.08 mm)" in may.no_override
    assert may.notes[-1] == f"the feed of this run cannot be overridden: {may.no_override}"

    bench = Bench(other=plan.machine, same=True).ready()
    bench.executor.start(plan.commands)
    bench.executor.override(percent)
    bench.go_on()
    judged = judge([bench.sink.recording(plan)], plan, spec)
    assert judged.result("contour_error").measured == pytest.approx(
        spoiled[0].measured or 0.0, rel=0.15
    )
    assert not judged.passed


def test_slower_rows_that_jerk_an_axis_beyond_its_limit_are_refused(tmp_path: Path) -> None:
    """With 12.5 nm a count, 4 m/s^2 in a tick exceeds 200 m/s^3; with 12.5 um it is no count."""
    plan, spec = zigzag(tmp_path)
    assert override_exceeds(plan) == 100
    fine = 1000.0 * plan.machine.axes["X"].counts.si
    axis = plan.machine.axes["X"]
    machine = replace(plan.machine, axes={
        **plan.machine.axes, "X": replace(axis, counts=replace(axis.counts, si=fine)),
    })  # fmt: skip
    finer = plan_job(open_job(tmp_path / "zigzag.gcode", machine, Options()), machine, Options())
    may = interventions(finer, spec)
    assert "% its rows would go beyond the acceleration or jerk of an axis" in may.no_override


def test_a_plan_that_stays_in_spec_may_be_overridden(tmp_path: Path) -> None:
    plan, spec = zigzag(tmp_path)
    wide = replace(
        spec, criteria=tuple(replace(c, limit=c.limit and 10.0 * c.limit) for c in spec.criteria)
    )
    assert spoiled_by_override(plan, wide, Hold.AT_ONCE) == (100, ())
    slow = planned("x-180.prg", "lathe-winder")
    may = interventions(slow, load_spec(None, slow.machine))
    assert may.no_override == ""
    assert may.notes == []


def test_failure_at_full_feed_is_not_blamed_on_an_override(tmp_path: Path) -> None:
    plan, spec = zigzag(tmp_path)
    hard = replace(spec, criteria=tuple(replace(c, limit=c.limit and 1e-7) for c in spec.criteria))
    assert spoiled_by_override(plan, hard, Hold.AT_ONCE) == (100, ())


def test_feed_forward_that_would_leave_its_path_slower_is_refused() -> None:
    plan = planned("stitcher-test-path.seam.toml", "stitcher", feed_forward_s=0.04)
    may = interventions(plan, load_spec(None, plan.machine))
    leaves = 1e3 * hold_deviation_m(plan)
    assert may.hold is Hold.AT_REST
    assert "make the loads follow the path at the full feed alone" in may.no_override
    stated = float(may.no_override.split("up to ")[1].split(" mm")[0])
    assert stated >= round(leaves, 2) > 0.0


@pytest.mark.parametrize(
    ("job", "machine", "words"),
    [
        ("letter-cycle.toml", "letter-placer", "its cylinders move as fast as their air"),
        ("rosette.dst", "schiffli-frame", "by the turns of the main shaft"),
    ],
)
def test_cylinders_and_frames_refuse_it_in_words(job: str, machine: str, words: str) -> None:
    plan = planned(job, machine)
    may = interventions(plan, load_spec(None, plan.machine))
    assert words in may.no_override
    assert not any("overridden" in note for note in may.notes)
