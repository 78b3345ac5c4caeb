"""Traces of other controllers: operations from the plan, and refusals where these do not do.

The reference is the same trace with the commanded operations recorded beside it.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from threadline.errors import RecordingError
from threadline.files import ChannelKind, Clock, Recording
from threadline.verdict import Criterion, Status, closing, judge
from threadline.verdict.registry import MEASURES
from threadline.verdict.samples import Setting

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
    verdict = judge([record(XY, load, operation)], plan, SPEC)
    untold = judge([record(XY, load, None, per_block=per_block)], plan, SPEC)

    for name in ("contour_error", "turning_point_error"):
        with_, without = verdict.result(name), untold.result(name)
        assert without.measured == with_.measured
        assert (without.operation, without.time_s) == (with_.operation, with_.time_s)
        assert "operations from the plan by time" in without.note
        assert "operations from the plan" not in with_.note


@pytest.mark.parametrize(
    ("clock", "stride"), [(Clock("logger", Fraction(15, 1000)), 1), (SERVO, 3)]
)
def test_another_clock_and_a_later_beginning_count_from_the_same_start(clock, stride) -> None:
    """Every third sample from the seventh tick on, on a clock of its own or on the machine's.

    Nothing moves before: the first move leads to the present position, and takes 0.1 s.
    """
    points = [POINTS[0], *POINTS]
    commanded, operation = follow(points, 20)
    actual = commanded + np.random.default_rng(3).normal(0.0, 1e-4, commanded.shape)
    plan = plan_through(points, XY)
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
    assert results[0].measured is not None
    assert results[0].operation == results[1].operation
    assert SERVO.period_s * 3 == clock.period_s * stride


def test_without_the_load_nothing_is_proved_and_the_remedy_is_named() -> None:
    """An encoder's trace lies on the path: placement is not measured, and nothing fails."""
    commanded, _ = follow(POINTS, 20)
    plan = plan_through(POINTS, XY)
    verdict = judge([record(XY, {ChannelKind.MEASURED: commanded}, None)], plan, SPEC)
    contour = verdict.result("contour_error")

    assert contour.status is Status.NOT_MEASURED
    assert 'name the column "X.load" if it was measured at the load' in contour.note
    assert 'a column "X.commanded" gives it' in verdict.result("tracking_error").note
    assert not verdict.passed
    assert closing(verdict) == "NOT PROVEN (nominal: 1 run): contour error was not measured"

    far = {ChannelKind.LOAD: commanded + 1e-2}
    failed = judge([record(XY, far, None)], plan, SPEC)
    # 10 mm aside in both axes, 14.14 mm against 0.5 mm.
    assert failed.result("contour_error").measured == pytest.approx(14.14e-3, rel=1e-3)
    assert closing(failed) == (
        "OUT OF SPEC (nominal: 1 run; more than 1000 % of contour_error used)"
    )
    passed = judge([record(XY, {ChannelKind.LOAD: commanded}, None)], plan, SPEC)
    assert closing(passed) == (
        "IN SPEC (nominal: 1 run; 0 % of contour_error used; 1 criterion not measured)"
    )


def _coarse(interval_ms: int, kinds=(ChannelKind.LOAD, ChannelKind.COMMANDED), slow=()):
    """Return X forth and back in 1.6 s, with Y 5 mm off for 60 ms, at a sample interval."""
    times = np.arange(0.0, 2.0, interval_ms / 1000)
    x = np.interp(times, [0.0, 0.8, 1.6], [0.0, 0.1, 0.0])
    bump = np.where((times > 0.33) & (times < 0.39), 5e-3, 0.0)
    channels = {
        kind: np.column_stack([x, bump if kind is ChannelKind.LOAD else 0.0 * x]) for kind in kinds
    }
    made = record(XY, channels, None, clock=Clock("logger", Fraction(interval_ms, 1000)))
    return replace(made, simulated=False)


FOLLOWING = [name for name, kind in MEASURES.items() if kind.needs and kind.follows]


def test_every_measure_of_the_tool_position_follows_the_path() -> None:
    at_tool = {
        name
        for name, kind in MEASURES.items()
        for reading in kind.reads
        if getattr(reading, "run", None) is Setting
        and any(ChannelKind.LOAD in alternatives for alternatives in reading.needs)
    }
    assert set(FOLLOWING) == at_tool
    assert {"contour_error", "turning_point_error", "stitch_placement_error"} <= at_tool


def test_a_trace_coarser_than_the_lag_measures_nothing_of_the_path() -> None:
    """The 5 mm lie between the samples at 0.2 and 0.4 s: the trace does not contain them."""
    plan = plan_through([[0, 0], [0.1, 0], [0, 0]], XY, move_s=0.8)
    criteria = [
        Criterion(name=n, limit=5e-4, required=n == "contour_error")
        for n in FOLLOWING
        if n not in {"repeatability", "tension_variation"}  # of many runs; of a tension
    ]
    verdict = judge([_coarse(200)], plan, spec_of(*criteria, lag_s=0.1))

    assert {r.status for r in verdict.results} == {Status.NOT_MEASURED}
    assert all("a sample every 200 ms" in r.note for r in verdict.results)
    assert all("record every 100 ms at least" in r.note for r in verdict.results)
    assert closing(verdict) == "NOT PROVEN (nominal: 1 run): contour error was not measured"

    # The same motion with finer samples shows its error.
    fine = judge([_coarse(20)], plan, spec_of(*criteria, lag_s=0.1)).result("contour_error")
    assert fine.measured == pytest.approx(5e-3, abs=1e-9)
    # 100 ms is the coarsest interval that the lag allows; it proves no small error either.
    limit = judge([_coarse(100)], plan, spec_of(*criteria, lag_s=0.1)).result("contour_error")
    assert "the lag of the specification" not in limit.note
    assert "a sample every 100 ms" in limit.note
    reported = spec_of(Criterion(name="contour_error"), lag_s=0.1)
    assert judge([_coarse(100)], plan, reported).result("contour_error").measured is not None
    many = spec_of(Criterion(name="repeatability", options={"recordings": 2.0}))
    spread = judge([_coarse(200), _coarse(200)], plan, many).result("repeatability")
    assert "a sample every 200 ms" in spread.note


def test_the_lag_is_not_rounded_up_to_a_sample() -> None:
    """A sample every 60 ms of a load that is 100 ms late at 1 m/s, with 70 ms of lag.

    At 0.66 s the load is at 0.56 m, 40 mm short of the corner that the command left at 0.6 s: the
    previous sample is within the lag and past the corner, and the one before that is outside the
    lag.
    """
    plan = plan_through([[0, 0], [0.6, 0], [0.6, 0.6]], XY, move_s=0.6)
    late = np.clip(0.06 * np.arange(27) - 0.1, 0.0, 1.2)
    load = np.column_stack([np.minimum(late, 0.6), np.maximum(late - 0.6, 0.0)])
    clock = Clock("logger", Fraction(60, 1000))
    made = record(XY, {ChannelKind.LOAD: load}, None, clock=clock)
    spec = spec_of(Criterion(name="contour_error"), lag_s=0.07)
    result = judge([made], plan, spec).result("contour_error")

    assert result.measured == pytest.approx(0.04, abs=1e-9)
    assert result.time_s == pytest.approx(0.66)


def test_a_column_without_operations_is_as_good_as_none() -> None:
    """The column is -1 throughout: the verdict is the same, word by word, as without it."""
    actual, _ = off_the_path()
    plan = plan_through(POINTS, XY)
    load = {ChannelKind.LOAD: actual}
    nothing = replace(record(XY, load, np.full(len(actual), -1.0)), simulated=False)
    missing = replace(record(XY, load, None), simulated=False)
    assert judge([nothing], plan, SPEC) == judge([missing], plan, SPEC)


@pytest.mark.parametrize(("last", "refused"), [(4.0, False), (5.0, True), (1e9, True)])
def test_operations_that_the_job_does_not_have_are_refused(last: float, refused: bool) -> None:
    """The job has five moves, 0 to 4."""
    commanded, operation = follow(POINTS, 20)
    operation[-3:] = last
    plan = plan_through(POINTS, XY)
    made = replace(record(XY, {ChannelKind.LOAD: commanded}, operation), simulated=False)
    if refused:
        when = (len(commanded) - 3) * float(SERVO.period_s)
        message = rf"the operation at {when:g} s is .*by hand has 5, from 0 to 4"
        with pytest.raises(RecordingError, match=message):
            judge([made], plan, SPEC)
    else:
        assert judge([made], plan, SPEC).result("contour_error").measured < 1e-12


STRAIGHT = plan_through([[0, 0], [0.18, 0]], XY, move_s=4.5)


def _sampled(every_ms: int, beside_m: float = 0.0, off_m: float = 0.0) -> Recording:
    """Return a trace along X, in which Y deviates for 88 ms from 0.901 s on."""
    time_s = 1e-3 * every_ms * np.arange(int(4500 / every_ms) + 2)
    part = np.clip((time_s - 0.901) / 0.088, 0.0, 1.0)
    y = beside_m * np.sin(np.pi * part) ** 2 + off_m
    load = np.column_stack([np.minimum(0.04 * time_s, 0.18), y])
    clock = Clock("logger", Fraction(every_ms, 1000))
    return record(XY, {ChannelKind.LOAD: load}, None, clock=clock, simulated=False)


def test_deviation_that_fits_between_two_samples_is_not_proven() -> None:
    """5 mm beside the path for 88 ms, between the samples at 0.90 s and 0.99 s.

    At 10.5 and 4.65 m/s^2, 11.48 together, a deviation of 11.6 mm is possible in 90 ms.
    """
    spec = spec_of(Criterion(name="contour_error", limit=5e-4, required=True), lag_s=0.1)
    hidden = judge([_sampled(90, 5e-3)], STRAIGHT, spec)
    result = hidden.result("contour_error")
    assert (result.status, result.measured) == (Status.NOT_MEASURED, None)
    assert "has a sample every 90 ms: between two of them" in result.note
    assert "11.63 mm" in result.note
    longest_ms = 1e3 * np.sqrt(8.0 * 5e-4 / np.hypot(10.5, 4.65))
    assert f"record every {longest_ms:.3g} ms at least" in result.note
    assert closing(hidden).startswith("NOT PROVEN")
    # With a sample at each tick the deviation shows.
    seen = judge([_sampled(5, 5e-3)], STRAIGHT, spec).result("contour_error")
    assert seen.status is Status.FAILED
    assert seen.measured == pytest.approx(5e-3, rel=0.01)


def test_the_longest_interval_is_where_both_together_are_the_limit() -> None:
    """0.2 mm off the path, of 0.5 mm: 14.46 ms. A sample beyond the limit fails."""
    spec = spec_of(Criterion(name="contour_error", limit=5e-4, required=True), lag_s=0.1)
    for every_ms, status in ((14, Status.PASSED), (15, Status.NOT_MEASURED)):
        result = judge([_sampled(every_ms, off_m=2e-4)], STRAIGHT, spec).result("contour_error")
        assert result.status is status
    assert "record every 14.5 ms at least" in result.note
    broken = judge([_sampled(90, off_m=6e-4)], STRAIGHT, spec).result("contour_error")
    assert (broken.status, broken.measured) == (Status.FAILED, pytest.approx(6e-4))


def test_speeds_need_a_sample_in_each_of_their_means() -> None:
    spec = spec_of(Criterion(name="velocity_ripple", limit=1.5, options={"over": 0.02}))
    coarse = judge([_sampled(30)], STRAIGHT, spec).result("velocity_ripple")
    assert coarse.status is Status.NOT_MEASURED
    assert "says nothing of speeds over 20 ms; record every 20 ms at least" in coarse.note
    fine = judge([_sampled(20)], STRAIGHT, spec).result("velocity_ripple")
    assert fine.status is Status.PASSED


def test_a_trace_of_centuries_later_measures_nothing() -> None:
    """Its instants are beyond any row: 1e300 s is not a number of ticks."""
    actual, _ = off_the_path()
    clock = Clock("logger", Fraction(10**300))
    verdict = judge(
        [record(XY, {ChannelKind.LOAD: actual}, None, clock=clock)], plan_through(POINTS, XY), SPEC
    )
    assert verdict.result("contour_error").status is Status.NOT_MEASURED
    assert not verdict.passed


@pytest.mark.parametrize("every_ms", [20, 45, 90])
@pytest.mark.parametrize(
    ("ahead_s", "ahead_m", "status"),
    [(-0.03, 0.0, {Status.PASSED, Status.NOT_MEASURED}), (0.0, 6e-3, {Status.FAILED})],
    ids=["trails its command within the lag", "runs ahead of it"],
)
def test_a_command_that_turns_between_two_samples_lets_no_tool_seem_ahead(
    every_ms, ahead_s, ahead_m, status
) -> None:
    """X goes 180 mm forth and back, and turns within a sample: up to 1.8 mm are not sampled."""
    turn_s = 4.5 + 0.4e-3 * every_ms
    there_and_back = plan_through([[0, 0], [0.18, 0], [0, 0]], XY, move_s=turn_s)
    time_s = 1e-3 * every_ms * np.arange(int(2100 * turn_s / every_ms))
    at_m = 0.18 * (1.0 - np.abs(np.clip((time_s + ahead_s) / turn_s, 0.0, 2.0) - 1.0))
    at_m += np.where(np.abs(time_s - 2.0) < 0.5, ahead_m, 0.0)
    load = np.column_stack([at_m, np.zeros(len(at_m))])
    clock = Clock("logger", Fraction(every_ms, 1000))
    recording = record(XY, {ChannelKind.LOAD: load}, None, clock=clock, simulated=False)
    names = ("progress_error", "contour_error", "turning_point_error")
    limits = [Criterion(name=name, limit=2e-4, required=True) for name in names]
    verdict = judge([recording], there_and_back, spec_of(*limits, lag_s=0.1))
    assert verdict.result("progress_error").status in status
    # The farthest sample is short of the turning point; between samples the tool may reach it.
    found = {result.status for result in verdict.results if result.name != "progress_error"}
    assert Status.FAILED not in found


def test_samples_off_the_path_fail_beside_a_point_that_only_their_lines_miss() -> None:
    """0.3 mm beside the path, and a turning point between two samples: 0.3 mm exceeds 0.2 mm."""
    there_and_back = plan_through([[0, 0], [0.18, 0], [0, 0]], XY, move_s=4.536)
    time_s = 0.09 * np.arange(102)
    at_m = 0.18 * (1.0 - np.abs(np.clip(time_s / 4.536, 0.0, 2.0) - 1.0))
    load = np.column_stack([at_m, np.where(np.abs(time_s - 2.0) < 0.5, 3e-4, 0.0)])
    clock = Clock("logger", Fraction(90, 1000))
    recording = record(XY, {ChannelKind.LOAD: load}, None, clock=clock, simulated=False)
    limit = Criterion(name="contour_error", limit=2e-4, required=True)
    found = judge([recording], there_and_back, spec_of(limit, lag_s=0.1)).result("contour_error")
    assert found.status is Status.FAILED
