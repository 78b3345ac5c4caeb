"""Limits of travel and velocity are measured on a recording; results of its plan are marked."""

from __future__ import annotations

import numpy as np
import pytest

from tests.verdict.builders import TICK_S, follow, plan_through, record, spec_of, winder
from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.files import ChannelKind
from threadline.verdict import Criterion, Judge, Status, judge, verdict_json, verdict_rows

AXES = ("X", "Y")
POINTS = [[0.0, 0.0], [0.1, 0.0], [0.1, 0.05], [0.0, 0.0]]
PER_MOVE = 40
PLACED_M = 0.5e-3
MACHINE = winder()
SPEC = spec_of(
    Criterion(name="contour_error", limit=PLACED_M),
    *(
        Criterion(name="travel", limit=0.0, hard=True, axis=axis, every_axis=True) for axis in AXES
    ),
    *(
        Criterion(
            name="velocity", limit=MACHINE.axes[axis].velocity.si, hard=True, axis=axis,
            every_axis=True,
        )
        for axis in AXES
    ),
    Criterion(name="acceleration"),
)  # fmt: skip


def plan_of() -> Plan:
    return plan_through(POINTS, AXES, move_s=PER_MOVE * TICK_S)


def positions() -> FloatArray:
    return follow(POINTS, PER_MOVE)[0]


def judged(load: FloatArray, kind: ChannelKind = ChannelKind.LOAD, *, simulated: bool = False):
    run = record(AXES, {kind: load}, follow(POINTS, PER_MOVE)[1], simulated=simulated)
    return judge([run], plan_of(), SPEC)


def test_a_recording_that_keeps_its_limits_is_measured_itself() -> None:
    """By hand: 120 mm/s along X, and 50 mm to the end of the travel of Y at -50 mm."""
    load = positions() * 1.2
    verdict = judged(load)

    velocity = verdict.result("velocity", "X")
    assert velocity.of == "recording"
    assert velocity.measured == pytest.approx(1.2 * 0.1 / (PER_MOVE * TICK_S))
    assert velocity.status is Status.PASSED
    travel = verdict.result("travel", "Y")
    assert travel.of == "recording"
    assert travel.measured == pytest.approx(-0.05)
    assert verdict.result("acceleration", "X").of == "plan"


@pytest.mark.parametrize("simulated", [False, True])
@pytest.mark.parametrize("kind", [ChannelKind.LOAD, ChannelKind.MEASURED, ChannelKind.TOOL])
def test_limit_broken_in_a_recording_is_failed(kind: ChannelKind, simulated: bool) -> None:
    """An axis is 40 mm beyond its travel for some ticks, and gets there by a jump of 540 mm."""
    load = positions()
    load[50:60, 0] = -0.54
    verdict = judged(load, kind, simulated=simulated)

    travel = verdict.result("travel", "X")
    assert travel.status is Status.FAILED
    assert travel.measured == pytest.approx(0.04)
    assert travel.limit == pytest.approx(PLACED_M)  # placement may be off by this
    assert travel.time_s == pytest.approx(50 * TICK_S)
    assert travel.job_line == 20
    velocity = verdict.result("velocity", "X")
    assert velocity.status is Status.FAILED
    # From 100 mm to -540 mm within the 20 ms over which a velocity is measured.
    assert velocity.measured == pytest.approx(0.64 / 0.02)
    assert velocity.limit == pytest.approx(1.1 * MACHINE.axes["X"].velocity.si)
    assert not verdict.passed


def test_ringing_about_the_command_breaks_nothing() -> None:
    """A load may swing beyond its travel by as much as it may be beside its path."""
    load = positions()
    load[5, 0] = -0.5 - 0.9 * PLACED_M
    assert judged(load).result("travel", "X").status is Status.PASSED
    load[5, 0] = -0.5 - 1.1 * PLACED_M
    assert judged(load).result("travel", "X").status is Status.FAILED


def test_values_of_the_plan_are_marked() -> None:
    """In the table and in JSON; a proof, whose runs follow its plan, needs no mark in its table."""
    verdict = judged(positions())
    _, rows = verdict_rows(verdict, every_axis=True)
    notes = {(row[0], row[1]): row[-1] for row in rows}
    assert notes["acceleration", "X"].startswith("of the plan")
    assert notes["travel", "X"].startswith("of the recording; ")
    assert notes["velocity", "X"].startswith("of the recording; over 20 ms")
    of = {(c["name"], c["axis"]): c["of"] for c in verdict_json(verdict, plan_of())["criteria"]}
    assert of["acceleration", "X"] == "plan"
    assert of["travel", "X"] == "recording"
    assert of["contour_error", ""] == "run"

    run = record(AXES, {ChannelKind.LOAD: positions()}, follow(POINTS, PER_MOVE)[1])
    proved = Judge(plan_of(), SPEC).verdict([run])
    _, rows = verdict_rows(proved, every_axis=True)
    assert not any("of the" in row[-1] for row in rows)


def test_without_a_position_the_plan_is_told_and_marked() -> None:
    commanded = positions()
    run = record(AXES, {ChannelKind.COMMANDED: commanded}, follow(POINTS, PER_MOVE)[1])
    verdict = judge([run], plan_of(), SPEC)
    assert {r.of for r in verdict.results if r.name in ("travel", "velocity")} == {"plan"}
    assert np.isfinite(verdict.result("travel", "X").measured or 0.0)


def test_a_jump_is_told_as_missing_samples_may_look() -> None:
    """It needs 3.2 m/s, 3 times X's limit of 1 m/s; a fifth above the limit is no jump."""
    load = positions()
    load[50:, 0] -= 3.2 * 0.02
    found = judged(load, ChannelKind.MEASURED).result("velocity", "X")
    assert found.status is Status.FAILED
    assert "a jump, as where lines of a file without times are missing" in found.note
    load = positions()
    load[50:60, 0] -= 1.3 * TICK_S * np.arange(10)
    load[60:, 0] -= 1.3 * TICK_S * 9
    found = judged(load, ChannelKind.MEASURED).result("velocity", "X")
    assert found.status is Status.FAILED
    assert "jump" not in found.note
