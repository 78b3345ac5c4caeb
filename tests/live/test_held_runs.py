"""A held and halted run is judged like a run without a hold, from its recorded plan times."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.live.bench import Bench, winder
from threadline.commands.plan import Plan
from threadline.files import Recording, RunEnd, Stream
from threadline.files.formats import read_recording, write_recording
from threadline.jobs import read_job
from threadline.live.states import Cause, State
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, simulate
from threadline.verdict import Verdict, judge, load_spec

PROGRAM = "G91\nG1 X10 F480\nM00\nX-10\nM30\n"
"""There and back at 8 mm/s with a stop between: in a hold the load is a lag of X ahead, 0.24 mm."""
SPEC = load_spec(None, winder())


def plan_of(folder: Path) -> Plan:
    """Return a plan in which the loads follow, so that the motors' commands differ."""
    job = folder / "there.prg"
    job.write_text(PROGRAM, "utf-8")
    return plan_job(read_job(job, winder()), winder(), Options(feed_forward_s=0.04))


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    return plan_of(tmp_path_factory.mktemp("held"))


@pytest.fixture(scope="module")
def held(plan: Plan) -> Recording:
    """A run that is held on its way forth and back; its stop is answered after a second."""
    bench = Bench().ready()
    bench.executor.start(plan.commands, loads_follow=True)
    for tick in (130, 720):
        bench.go_on(tick)
        bench.desk.ask(Cause.HOLD)
        bench.go_on(tick + 100)
        assert bench.executor.state is State.HOLDING
        bench.desk.ask(Cause.RESUME)
        if tick == 130:
            while bench.executor.state is not State.HOLDING or bench.executor.tick < 580:
                bench.executor.step()  # up to the stop of the program, and on
            bench.desk.ask(Cause.RESUME)
    bench.go_on()
    assert bench.executor.ended == (RunEnd.COMPLETED, "")
    return bench.sink.recording(plan)


@pytest.fixture(scope="module")
def verdict(plan: Plan, held: Recording) -> Verdict:
    return judge([held], plan, SPEC)


def alike(ours: Verdict, other: Verdict) -> bool:
    """Return whether two verdicts have the same lines with the same results."""
    statuses = [[(r.name, r.axis, r.status) for r in one.results] for one in (ours, other)]
    return statuses[0] == statuses[1] and ours.passed == other.passed


def test_held_run_has_the_verdict_of_a_run_without_holds(plan: Plan, verdict: Verdict) -> None:
    assert verdict.passed
    assert alike(verdict, judge([simulate(plan.commands, winder())], plan, SPEC))
    ahead = verdict.result("progress_error")
    assert ahead.note == "ahead"  # the verdict mentions the hold
    assert ahead.measured == pytest.approx(8e-3 * 29.4e-3, rel=0.2)


def test_without_the_record_it_is_seconds_behind(plan: Plan, held: Recording) -> None:
    blocks = [
        replace(block, events=tuple(e for e in block.events if e.kind != "plan")) for block in held
    ]
    verdict = judge([replace(held, blocks=Stream.of(blocks))], plan, SPEC)
    assert not verdict.passed
    behind = verdict.result("progress_error").measured
    assert behind is not None
    assert behind > 5e-3


@pytest.mark.parametrize("ending", ["npz", "mcap", "csv"])
def test_every_file_keeps_the_record(
    ending: str, plan: Plan, held: Recording, verdict: Verdict, tmp_path: Path
) -> None:
    file = tmp_path / f"held.{ending}"
    write_recording(held, file)
    assert judge([read_recording(file)], plan, SPEC).results == verdict.results


def test_load_motion_during_a_hold_is_judged(plan: Plan, held: Recording) -> None:
    """A load that slips by 0.6 mm during a hold is out of spec, as at any other time."""
    blocks = []
    for block in held:
        first, load = block.first_tick["servo"], block.samples["X.load"].copy()
        ticks = range(first, first + len(load))
        load[[180 <= tick < 200 for tick in ticks]] += 6e-4
        blocks.append(replace(block, samples={**block.samples, "X.load": load}))
    verdict = judge([replace(held, blocks=Stream.of(blocks))], plan, SPEC)
    assert not verdict.passed
    assert verdict.result("progress_error").measured == pytest.approx(
        6e-4 + 8e-3 * 29.4e-3, rel=0.1
    )
