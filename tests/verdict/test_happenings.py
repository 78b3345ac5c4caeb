"""Events that changed a run's motion are named with time and line; a stop fails nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.verdict.builders import SERVO, TICK_S, follow, plan_through, record, spec_of
from threadline.commands.plan import Plan
from threadline.errors import MachineError
from threadline.files import Channel, ChannelKind, Event, Recording, RecordingBlock, Stream
from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import prove
from threadline.verdict import (
    Criterion,
    Result,
    Status,
    Verdict,
    closing,
    happened_lines,
    happened_rows,
    judge,
    load_spec,
    verdict_json,
)
from threadline.verdict.coverage import effects_in

AXES = ("X", "Y")
POINTS = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1], [0.0, 0.0]]
PER_MOVE = 40
STOP, END = 60, 70  # ticks of the stop, and of the standstill
SPEC = spec_of(
    Criterion(name="contour_error", limit=1e-3, required=True),
    Criterion(name="tracking_error", limit=1e-3),
    Criterion(name="turning_point_error", limit=1e-3),
)


def plan_of() -> Plan:
    return plan_through(POINTS, AXES, move_s=PER_MOVE * TICK_S)


def run_until(tick: int, off_from: int, events: list[Event], off_m: float = 5e-3) -> Recording:
    """Return a run that ends at a tick, with its load beside the path from ``off_from`` on."""
    at, operation = follow(POINTS, PER_MOVE)
    commanded = at[:tick]
    load = commanded + off_m * (np.arange(tick) >= off_from)[:, None]
    channels = {ChannelKind.LOAD: load, ChannelKind.COMMANDED: commanded}
    run = record(AXES, channels, operation[:tick], per_block=10_000, simulated=False)
    (block,) = run
    return replace(run, blocks=Stream.of([replace(block, events=tuple(events))]))


def stopped() -> list[Event]:
    return [
        Event(tick=STOP, kind="hold", operation=1),
        Event(tick=END, kind="resume", operation=1),
        Event(tick=END, kind="stopped", operation=1, name="stopped by the operator"),
    ]


def test_error_caused_by_a_stop_fails_no_criterion() -> None:
    """The load swings off its path while it brakes: the stop causes this, and nothing is proved."""
    verdict = judge([run_until(END, STOP, stopped())], plan_of(), SPEC)

    assert not verdict.passed
    assert all(r.status is Status.NOT_MEASURED for r in verdict.results)
    assert closing(verdict).startswith("NOT PROVEN")
    assert "until then" in verdict.result("contour_error").note


def test_failure_before_a_stop_stays_failed() -> None:
    verdict = judge([run_until(END, 20, stopped())], plan_of(), SPEC)

    assert verdict.result("contour_error").status is Status.FAILED
    assert closing(verdict).startswith("OUT OF SPEC")


def test_a_fault_hides_no_failure() -> None:
    """A criterion that fails while a fault brakes the machine has failed."""
    fault = [Event(tick=STOP, kind="fault", operation=1, name="the link is gone")]
    verdict = judge([run_until(END, STOP, fault)], plan_of(), SPEC)

    assert verdict.result("contour_error").status is Status.FAILED


def listed(verdict: Verdict) -> list[tuple[str, float, int | None]]:
    return [(h.change.value, round(h.time_s or 0.0, 9), h.job_line) for h in verdict.disturbances]


def test_holds_lateness_and_ends_are_told_with_time_and_line() -> None:
    """The braking of an early end is no hold."""
    events = [
        Event(tick=10, kind="hold", operation=0),
        Event(tick=20, kind="resume", operation=0),
        Event(tick=30, kind="late", operation=0, value=2.0),
        *stopped(),
    ]
    plan = plan_of()
    verdict = judge([run_until(END, 10_000, events)], plan, SPEC)

    assert listed(verdict) == [
        ("hold", round(10 * TICK_S, 9), 10),
        ("late", round(30 * TICK_S, 9), 10),
        ("stopped", round(END * TICK_S, 9), 20),
    ]
    lines = happened_lines(verdict)
    assert lines[0] == "What changed the motion: it was held for 0.05 s at 0.050 s, line 10"
    header, rows = happened_rows(verdict)
    assert header == ["what changed the motion", "at", "line", "run"]
    assert [row[1:3] for row in rows] == [["0.050 s", "10"], ["0.150 s", "10"], ["0.350 s", "20"]]
    kinds = [one["kind"] for one in verdict_json(verdict, plan)["events"]]
    assert kinds == ["hold", "late", "stopped"]


def test_a_limit_switch_that_cut_a_motor_is_named() -> None:
    """The first sample with the input on gives the time, and its operation the line."""
    at, operation = follow(POINTS, PER_MOVE)
    run = record(AXES, {ChannelKind.LOAD: at, ChannelKind.COMMANDED: at}, operation)
    switch = Channel(name="x_high", kind=ChannelKind.INPUT, unit="", clock=SERVO, axis="X")
    on = (np.arange(len(at)) >= 50).astype(float)
    blocks = []
    for block in run:
        first = block.first_tick["servo"]
        count = len(block.samples["X.load"])
        samples = {**block.samples, "x_high": on[first : first + count]}
        blocks.append(RecordingBlock(first_tick=block.first_tick, samples=samples))
    run = replace(run, channels=(*run.channels, switch), blocks=Stream.of(blocks))

    plan = plan_of()
    verdict = judge([run], plan, SPEC)

    assert listed(verdict) == [("limit-switch", 50 * TICK_S, 20)]
    message = "the limit switch x_high of X cut the supply of drives.x at 0.250 s, line 20"
    assert message in closing(verdict)
    assert verdict_json(verdict, plan)["events"][0]["axis"] == "X"


def test_a_motor_without_supply_is_named_in_a_proof(tmp_path: Path) -> None:
    """The switch is 1 um beyond the travel; a stiff loop overshoots, and the supply is cut."""
    machine = tmp_path / "soft.toml"
    machine.write_text(
        'base = "lathe-winder"\nname = "soft"\n'
        '[axes.X]\ntravel = ["-500 mm exact, assumed", "200 mm exact, assumed"]\n'
        '[inputs.x_high]\nat = "200.001 mm exact, assumed"\n'
        '[controllers.x]\nkp = "8 dac/count exact, assumed"\nkd = "0.1 dac/count exact, assumed"\n'
    )
    job = tmp_path / "far.prg"
    job.write_text("G21 G90 G94\nG1 X200 F9000\nG1 X0\nM30\n")
    chosen = load_machine(str(machine))

    proof = prove(job, chosen, load_spec(None, chosen), Options(interpolation="linear"))

    cuts = [h for h in proof.verdict.disturbances if h.change.value == "limit-switch"]
    assert [h.axis for h in cuts] == ["X"]
    assert cuts[0].time_s is not None and 1.3 < cuts[0].time_s < 1.6  # 200 mm at 150 mm/s
    assert cuts[0].job_line in (2, 3)
    assert "x_high" in closing(proof.verdict)
    assert not proof.verdict.passed


def test_a_limit_switch_within_the_travel_is_refused_as_the_machine_is_loaded(
    tmp_path: Path,
) -> None:
    """The message names it, both places and the remedy, also for a switch at the travel's end."""
    file = tmp_path / "long.toml"
    for end, refused in (("1500", True), ("510", True), ("509", False)):
        file.write_text(
            'base = "lathe-winder"\nname = "long"\n[axes.X]\n'
            f'travel = ["-500 mm exact, assumed", "{end} mm exact, assumed"]\n'
        )
        if not refused:
            assert load_machine(str(file)).inputs["x_high"].at.si == pytest.approx(0.51)
            continue
        with pytest.raises(MachineError, match=r"inputs\.x_high\.at") as error:
            load_machine(str(file))
        assert "cuts drives.x from 510 mm on" in error.value.message
        assert f"-500 mm to {end} mm" in error.value.message
        assert f"above {end} mm" in str(error.value)


@pytest.mark.parametrize(
    ("name", "measured", "change"),
    [
        ("dac_saturation", 0.5, "saturation"),
        ("dac_saturation", 0.0, None),
        ("step_loss", 1.2, "lost-steps"),
        ("step_loss", 0.9, None),
        ("current_peak", 4.0, "saturation"),
        ("current_peak", 3.9, None),
    ],
)
def test_saturation_and_lost_steps_are_told_by_what_was_measured(
    name: str, measured: float, change: str | None
) -> None:
    """X of the winder has 4 A."""
    result = Result(
        name=name, axis="X", measured=measured, limit=None, unit="", status=Status.REPORTED,
        time_s=1.5, job_line=7,
    )  # fmt: skip
    found = effects_in([result], load_machine("lathe-winder"))
    assert [one.change.value for one in found] == ([] if change is None else [change])
    assert all((one.time_s, one.job_line, one.axis) == (1.5, 7, "X") for one in found)
