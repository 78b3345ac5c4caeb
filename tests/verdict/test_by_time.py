"""Traces of other controllers: operations from the plan, and what is said where that isn't enough.

The reference is the same trace with the operations that were commanded recorded beside it.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from threadline.signals import ChannelKind, Clock
from threadline.verdict import Criterion, Status, closing, judge

from .builders import SERVO, follow, plan_through, record, spec_of

XY = ("X", "Y")
# The fourth chord crosses the first, the last retraces the third.
POINTS = [[0, 0], [0.1, 0], [0.1, 0.05], [0.05, 0.05], [0.05, -0.05], [0.05, 0.05]]
SPEC = spec_of(
    Criterion(name="contour_error", limit=5e-4, required=True),
    Criterion(name="turning_point_error", limit=5e-4),
    Criterion(name="tracking_error"),
    lag_s=0.02,
)


def off_the_path(seed: int = 3):
    commanded, operation = follow(POINTS, 20)
    random = np.random.default_rng(seed)
    return commanded + random.normal(0.0, 1e-4, commanded.shape), operation


@pytest.mark.parametrize("per_block", [1, 7, 10_000])
def test_a_trace_without_operations_is_judged_as_one_with_them(per_block: int) -> None:
    actual, operation = off_the_path()
    plan = plan_through(POINTS, XY)
    load = {ChannelKind.LOAD: actual}
    told = judge([record(XY, load, operation)], plan, SPEC)
    untold = judge([record(XY, load, None, per_block=per_block)], plan, SPEC)

    for name in ("contour_error", "turning_point_error"):
        with_, without = told.result(name), untold.result(name)
        assert without.measured == with_.measured
        assert (without.operation, without.time_s) == (with_.operation, with_.time_s)
        assert "operations from the plan by time" in without.note
        assert "operations from the plan" not in with_.note


@pytest.mark.parametrize(
    ("clock", "stride"), [(Clock("logger", Fraction(15, 1000)), 1), (SERVO, 3)]
)
def test_another_clock_and_a_later_beginning_count_from_the_same_start(clock, stride) -> None:
    """Every third sample from the seventh tick on, on a clock of its own or on the machine's."""
    actual, operation = off_the_path()
    plan = plan_through(POINTS, XY)
    sparse, rows = actual[6::3], operation[6::3]
    results = []
    for given in (rows, None):
        made = record(XY, {ChannelKind.LOAD: sparse}, given, clock=clock, stride=stride)
        blocks = [
            type(b)(
                first_tick={clock.name: b.first_tick[clock.name] + 2 * stride}, samples=b.samples
            )
            for b in made
        ]
        shifted = type(made)(
            channels=made.channels,
            blocks=type(made.blocks).of(blocks),
            job_sha256="job",
            machine_sha256="",
            simulated=False,
        )
        results.append(judge([shifted], plan, SPEC).result("contour_error"))
    assert results[0].measured == results[1].measured
    assert results[0].operation == results[1].operation
    assert SERVO.period_s * 3 == clock.period_s * stride


def test_without_the_load_nothing_is_proved_and_the_remedy_is_named() -> None:
    """An encoder's trace, all of it on the path: placement is not measured, and nothing failed."""
    commanded, _ = follow(POINTS, 20)
    plan = plan_through(POINTS, XY)
    verdict = judge([record(XY, {ChannelKind.MEASURED: commanded}, None)], plan, SPEC)
    contour = verdict.result("contour_error")

    assert contour.status is Status.NOT_MEASURED
    assert 'name the column "X.load" if it was measured at the load' in contour.note
    assert 'a column "X.commanded" gives it' in verdict.result("tracking_error").note
    assert not verdict.passed
    assert closing(verdict) == "NOT PROVEN: contour error was not measured"

    far = {ChannelKind.LOAD: commanded + 1e-2}
    failed = judge([record(XY, far, None)], plan, SPEC)
    assert closing(failed) == "OUT OF SPEC"
    passed = judge([record(XY, {ChannelKind.LOAD: commanded}, None)], plan, SPEC)
    assert closing(passed) == "IN SPEC (1 criterion not measured)"
