"""The turning-point error, compared with displacements added to the load by hand.

Values are copied, scaled by 1 or by 0.1 m and subtracted: 1e-12 m covers the rounding.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.files import ChannelKind
from threadline.verdict import Criterion, judge

from .builders import TICK_S, follow, move_s, plan_through, record, spec_of

TURNING = Criterion(name="turning_point_error", limit=5e-4)


def turning(
    points, actual, operation, axes=("X",), *, per_block=64, lag_s=0.1, criterion=TURNING, **plan
):
    recording = record(axes, {ChannelKind.LOAD: actual}, operation, per_block=per_block)
    made = plan_through(points, axes, **{"move_s": move_s(operation), **plan})
    return judge([recording], made, spec_of(criterion, lag_s=lag_s))


def late(positions, samples):
    return np.vstack([np.repeat(positions[:1], samples, axis=0), positions[:-samples]])


@pytest.mark.parametrize(("error", "note"), [(-4.7e-4, "short"), (1.6e-4, "past")])
def test_short_and_past(error: float, note: str) -> None:
    """8 points each way to 180 mm; the load trails by 6 samples and turns off by ``error``."""
    way = np.linspace(0, 0.18, 8)
    points = np.concatenate([way, way[-2::-1]])[:, None]
    commanded, operation = follow(points, 20)
    actual = late(commanded, 6)
    peak = int(np.argmax(actual))
    actual[peak - 3 : peak + 4] += error
    if error < 0:
        actual = np.minimum(actual, 0.18 + error)
    result = turning(points, actual, operation).result("turning_point_error", "X")

    assert result.measured == pytest.approx(abs(error), abs=1e-12)
    assert result.note == note
    assert result.job_line == 70
    assert result.operation == 6
    assert result.position == pytest.approx((0.18,))
    assert result.time_s == pytest.approx(actual.argmax() * TICK_S)


def test_a_dwell_at_the_turning_is_one_turning_and_an_overshoot_within_it_counts() -> None:
    """The axis stands at 0.1 m for three moves of another axis, and overshoots in the second."""
    points = [[0, 0], [0.1, 0], [0.1, 0.01], [0.1, 0.02], [0.1, 0.03], [0, 0.03]]
    commanded, operation = follow(points, 40)
    actual = commanded.copy()
    actual[100, 0] += 3e-4
    verdict = turning(points, actual, operation, ("X", "Y"))
    result = verdict.result("turning_point_error", "X")

    assert result.measured == pytest.approx(3e-4, abs=1e-12)
    assert result.job_line == 10
    assert verdict.result("turning_point_error", "Y").measured == pytest.approx(0, abs=1e-12)


def test_standing_still_on_the_way_is_no_turning() -> None:
    points = [[0, 0], [0.05, 0], [0.05, 0.01], [0.1, 0.01]]
    commanded, operation = follow(points, 40)
    actual = commanded.copy()
    actual[50:60, 0] -= 2e-3
    result = turning(points, actual, operation, ("X", "Y")).result("turning_point_error", "X")

    assert result.measured == pytest.approx(0.0, abs=1e-12)


def test_wiggles_below_the_smallest_are_no_turnings() -> None:
    points = [[0.0], [0.05], [0.05 - 2e-5], [0.1], [0.0]]
    commanded, operation = follow(points, 40)
    actual = commanded.copy()
    actual[60:70] += 1e-2  # well past the first wiggle, which is no turning point
    assert turning(points, actual, operation).result("turning_point_error").measured < 1e-12
    fine = Criterion(name="turning_point_error", limit=5e-4, options={"smallest": 1e-5})
    found = turning(points, actual, operation, criterion=fine).result("turning_point_error")
    assert found.measured > 5e-3


def test_the_end_of_the_job_is_a_turning_point() -> None:
    points = [[0.0], [0.1]]
    commanded, operation = follow(points, 40)
    short = turning(points, np.minimum(commanded, 0.1 - 6e-4), operation)
    assert short.result("turning_point_error").measured == pytest.approx(6e-4, abs=1e-12)
    assert short.result("turning_point_error").note == "short"
    assert not short.passed
    ringing = commanded.copy()
    ringing[60] += 2e-4
    past = turning(points, ringing, operation).result("turning_point_error")
    assert past.measured == pytest.approx(2e-4, abs=1e-12)
    assert past.note == "past"


def test_an_axis_that_never_moves_is_judged_where_it_ends() -> None:
    points = [[0, 0.02], [0.1, 0.02]]
    commanded, operation = follow(points, 40)
    actual = commanded.copy()
    actual[-5:, 1] += 1e-4
    result = turning(points, actual, operation, ("X", "Y")).result("turning_point_error", "Y")
    assert result.measured == pytest.approx(1e-4, abs=1e-12)


def test_a_rotary_axis_is_judged_at_the_tool() -> None:
    points = [[0.0], [1.0], [0.0]]
    commanded, operation = follow(points, 40)
    actual = np.minimum(commanded, 1.0 - 3e-3)
    result = turning(points, actual, operation, ("A",)).result("turning_point_error")
    assert result.measured == pytest.approx(3e-4, abs=1e-12)
    assert result.unit == "m"


def test_a_machine_that_stops_on_its_way_fails() -> None:
    points = [[0.0], [0.1], [0.0]]
    commanded, operation = follow(points, 40)
    stands = np.minimum(np.arange(120), 29)
    result = turning(points, commanded[stands], operation[stands], move_s=40 * TICK_S).result(
        "turning_point_error"
    )
    # It stands on the way forth: the reversal is missed by less than the end.
    assert result.measured == pytest.approx(0.1 * 29 / 40, abs=1e-12)
    assert result.note == "short"


@pytest.mark.parametrize("per_block", [2, 1000])
def test_a_machine_that_stops_lacks_the_way_to_the_end_of_the_job(per_block: int) -> None:
    """On the other side of its zero, whether the rest of the path was read by then or not."""
    points = [[0.0], [0.1], *([-0.1 - 0.01 * k] for k in range(5))]
    commanded, operation = follow(points, 40)
    stands = np.minimum(np.arange(len(commanded)), 29)
    result = turning(
        points, commanded[stands], operation[stands], move_s=40 * TICK_S,
        vertices_per_block=per_block,
    ).result("turning_point_error")  # fmt: skip
    assert result.measured == pytest.approx(0.1 * 29 / 40 + 0.14, abs=1e-12)
    assert result.note == "the recording ends before the job"


def test_a_recording_that_ends_early_measures_no_turning() -> None:
    points = [[0.0], [0.1], [0.0]]
    commanded, operation = follow(points, 40)
    made = plan_through(points, ("X",), move_s=40 * TICK_S)
    recording = record(("X",), {ChannelKind.LOAD: commanded[:30]}, operation[:30])
    result = judge([recording], made, spec_of(TURNING)).result("turning_point_error")
    assert result.measured is None
    assert "X.load ends at 0.145 s, the motion at 0.4 s" in result.note


def test_a_turning_that_bears_the_next_operations_name_early() -> None:
    """The command turns 30 samples after its label: the turning is watched until then."""
    points = [[0.0], [0.1], [0.0]]
    commanded, operation = follow(points, 100)
    early = np.concatenate([operation[30:], np.repeat(operation[-1:], 30)])
    recording = record(
        ("X",), {ChannelKind.COMMANDED: commanded, ChannelKind.LOAD: late(commanded, 6)}, early
    )
    spec = spec_of(TURNING, lag_s=20 * TICK_S)
    result = judge([recording], plan_through(points, ("X",)), spec).result("turning_point_error")
    assert result.measured == pytest.approx(0.0, abs=1e-12)


def test_strokes_shorter_than_the_lag_do_not_hide_each_other() -> None:
    """Three peaks of 10 mm, the first 0.3 mm short; the lag spans two strokes."""
    points = [[0.0], [0.01], [0.0], [0.01], [0.0], [0.01], [0.0]]
    moved = [[0.0], [0.0097], *points[2:]]
    _, operation = follow(points, 20)
    actual = late(follow(moved, 20)[0], 6)
    result = turning(points, actual, operation, lag_s=40 * TICK_S).result("turning_point_error")
    assert result.measured == pytest.approx(3e-4, abs=1e-12)
    assert (result.note, result.job_line) == ("short", 10)


@given(
    seed=st.integers(0, 2**32 - 1),
    strokes=st.integers(1, 8),
    splits=st.integers(1, 4),
    lag=st.integers(1, 9),
    per_block=st.integers(1, 60),
    per_vertex_block=st.integers(1, 7),
)
def test_random_strokes(seed, strokes, splits, lag, per_block, per_vertex_block) -> None:
    """Each turning is missed by its own random amount; the largest one is the result.

    The load is the command, late by ``lag`` samples and stretched between displaced turnings, so
    the expected errors are known without a search.
    """
    rng = np.random.default_rng(seed)
    turns = np.cumsum(
        np.concatenate([[0.0], (-1) ** np.arange(strokes) * rng.uniform(0.01, 0.1, strokes)])
    )
    errors = np.concatenate([[0.0], rng.uniform(-2e-3, 2e-3, strokes)])
    direction = np.concatenate([[0.0], (-1) ** np.arange(strokes)])

    def split(values):
        parts = [np.linspace(a, b, splits + 1)[1:] for a, b in pairwise(values)]
        return np.concatenate([values[:1], *parts])[:, None]

    points = split(turns)
    per_move = 40 // splits
    _, operation = follow(points, per_move)
    moved, _ = follow(split(turns + direction * errors), per_move)
    result = turning(
        points,
        late(moved, lag),
        operation,
        per_block=per_block,
        vertices_per_block=per_vertex_block,
        lag_s=20 * TICK_S,
    ).result("turning_point_error")

    assert result.measured == pytest.approx(np.abs(errors).max(), abs=1e-12), (turns, errors)
    signed = errors[np.argmax(np.abs(errors))]
    assert result.note == ("past" if signed > 0 else "short")
