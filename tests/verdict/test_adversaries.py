"""Wrong motions that touch the path everywhere: each must be out of spec.

Each keeps to the drawn lines, or visits most of them; the expected errors follow from the geometry.
"""

from __future__ import annotations

import numpy as np
import pytest

from threadline.files import ChannelKind
from threadline.verdict import Criterion, Status, Verdict, judge

from .builders import TICK_S, follow, plan_through, record, spec_of
from .test_seam import COUNT, RADIUS_M, circle, on_circle, plan_of, sewn

CRITERIA = tuple(Criterion(name=n, limit=5e-4) for n in ("contour_error", "progress_error"))
LAG_S = 0.1
SIDE_M = 0.02
SQUARE = SIDE_M * np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]], dtype=float)


def verdict_of(points, actual, operation, per_move, *, command) -> Verdict:
    plan = plan_through(points, move_s=per_move * TICK_S)
    channels = {ChannelKind.LOAD: actual, ChannelKind.COMMANDED: command}
    recording = record(("X", "Y"), channels, operation)
    return judge([recording], plan, spec_of(*CRITERIA, lag_s=LAG_S))


def failing(verdict: Verdict) -> dict[str, float]:
    failed = [r for r in verdict.results if r.status is Status.FAILED]
    return {r.name: r.measured for r in failed if r.measured is not None}


def lobes(radius_m: float, corners: int) -> tuple[np.ndarray, np.ndarray]:
    """A figure of eight in two lobes, which begin and end at the crossing."""
    turn = np.linspace(0.0, 2.0 * np.pi, corners + 1)
    right = radius_m * np.column_stack([1.0 - np.cos(turn), np.sin(turn)])
    return right, -right


def test_the_reference_is_in_spec() -> None:
    """A tool that follows the command has no error here, so the other motions fail on their own."""
    command, operation = follow(SQUARE, 60)
    assert not failing(verdict_of(SQUARE, command, operation, 60, command=command))


def test_a_square_in_the_other_sense_is_out_by_its_diagonal() -> None:
    """After a quarter the two are at opposite corners, much longer than the lag.

    The commanded corner is then one side away from the two legs next to the tool's corner.
    """
    command, operation = follow(SQUARE, 60)
    other, _ = follow(SQUARE[::-1], 60)
    found = failing(verdict_of(SQUARE, other, operation, 60, command=command))
    assert found["contour_error"] > 0.5 * SIDE_M
    assert found["progress_error"] > 0.1 * SIDE_M


def test_legs_in_another_order_are_out() -> None:
    """Forth and back to the right, then forth and back upwards; the tool goes upwards first."""
    points = SIDE_M * np.array([[0, 0], [1, 0], [0, 0], [0, 1], [0, 0]], dtype=float)
    command, operation = follow(points, 60)
    swapped, _ = follow(points[[0, 3, 2, 1, 4]], 60)
    found = failing(verdict_of(points, swapped, operation, 60, command=command))
    assert found["contour_error"] == pytest.approx(SIDE_M, rel=1e-9)


@pytest.mark.parametrize("radius_m", [3e-4, 1e-3])
def test_a_loop_that_is_skipped_within_the_lag_is_out_by_its_width(radius_m: float) -> None:
    """Line, a loop in 60 ms of a lag of 100 ms, line: the tool waits at the begin of the loop."""
    right, _ = lobes(radius_m, 12)
    loop = np.array([SIDE_M, 0.0]) + right[:, ::-1]
    points = np.concatenate([[[0.0, 0.0]], loop, [[2 * SIDE_M, 0.0]]])
    ends = np.concatenate([[0], np.full(1, 60), 60 + np.arange(1, 13), [132]])
    at = np.arange(ends[-1] + 41)
    command = np.column_stack([np.interp(at, ends, axis) for axis in points.T])
    operation = np.clip(np.searchsorted(ends, at, side="right") - 1, 0, 13)
    skipped = command.copy()
    skipped[60:73] = loop[0]
    # Operations are given, because a plan with equal moves would have other times.
    found = failing(verdict_of(points, skipped, operation, 1, command=command))
    assert found["contour_error"] == pytest.approx(2 * radius_m, rel=1e-9)


@pytest.mark.parametrize("per_chord", [1, 10])
def test_a_lobe_of_an_eight_in_the_wrong_sense_is_out(per_chord: int) -> None:
    """The lobe takes 60 ms or 600 ms, below or above the lag of 100 ms.

    The samples of the quick lobe are all on the drawn line. Its progress error shows it: a tool
    that goes the wrong way round has to be ahead first, and to step back all the time.
    """
    radius_m = 5e-3
    right, left = lobes(radius_m, 12)
    points = np.concatenate([right, left[1:]])
    command, operation = follow(points, per_chord)
    wrong = command.copy()
    lobe = slice(0, 12 * per_chord + 1)
    wrong[lobe] = command[lobe][::-1]
    found = failing(verdict_of(points, wrong, operation, per_chord, command=command))
    assert found["progress_error"] > 0.2 * radius_m
    if per_chord == 10:
        assert found["contour_error"] > radius_m


@pytest.mark.parametrize("per_chord", [1, 10])
def test_the_lobes_of_an_eight_in_the_wrong_order_are_out(per_chord: int) -> None:
    radius_m = 5e-3
    right, left = lobes(radius_m, 12)
    points = np.concatenate([right, left[1:]])
    command, operation = follow(points, per_chord)
    swapped, _ = follow(np.concatenate([left, right[1:]]), per_chord)
    found = failing(verdict_of(points, swapped, operation, per_chord, command=command))
    assert max(found.values()) > 0.5 * radius_m


def test_a_circle_that_is_gone_round_once_instead_of_twice_is_out() -> None:
    """At half the speed the tool is on the other side after a quarter of the time."""
    turn = np.linspace(0.0, 4.0 * np.pi, 49)
    points = 0.02 * np.column_stack([np.cos(turn), np.sin(turn)])
    command, operation = follow(points, 10)
    angle = np.linspace(0.0, 2.0 * np.pi, 481)
    once = 0.02 * np.column_stack([np.cos(angle), np.sin(angle)])
    actual = np.concatenate([once, np.repeat(once[-1:], len(command) - len(once), axis=0)])
    found = failing(verdict_of(points, actual, operation, 10, command=command))
    assert found["contour_error"] > 0.02


def test_ringing_along_the_stroke_counts_behind_a_trailing_load_too() -> None:
    """A swing of 8 mm at 25 Hz on a load that trails by 6 of the 10 mm that the lag allows.

    It steps back by far more than a sample's way, so half of the step is an error, wherever the
    load trails.
    """
    points = [[0.0, 0.0], [0.2, 0.0]]
    per_move = 400  # 0.1 m/s: 0.5 mm in a sample
    command, operation = follow(points, per_move, standstill=60)
    time_s = TICK_S * np.arange(len(command))
    ring = 4e-3 * np.sin(2 * np.pi * 25.0 * time_s) * (time_s < 1.8)
    actual = command.copy()
    actual[:, 0] = np.interp(time_s - 0.06, time_s, command[:, 0], left=0.0) + ring
    actual[:, 0] = np.clip(actual[:, 0], 0.0, 0.2)
    verdict = verdict_of(points, actual, operation, per_move, command=command)
    found = failing(verdict)
    assert verdict.result("contour_error").measured == pytest.approx(0.0, abs=1e-12)
    # From a top to the bottom half a period later the load advances by 0.1 / 50.
    back_m = 2 * 4e-3 * np.cos(np.pi * 25.0 * TICK_S) - 0.1 / 50
    assert 0.4 * back_m < found["progress_error"] < 8e-3


def test_a_seam_that_is_sewn_in_the_other_sense_is_out() -> None:
    """Every needle-down is on the drawn circle, and far from its place at that time."""
    at_m = np.linspace(0.0, 2 * np.pi * RADIUS_M, COUNT + 1)
    plan = plan_of(on_circle(RADIUS_M), at_m, circle())
    found = failing(sewn(plan, on_circle(RADIUS_M)[::-1]))
    # The lag of 100 ms is five of the circle's twelve stitches, each way.
    assert found["contour_error"] > 0.99 * RADIUS_M


def test_a_loop_of_a_seam_that_is_sewn_on_one_spot_is_out_by_its_width() -> None:
    """The needle keeps its time, but the head stays at the begin of the circle."""
    at_m = np.linspace(0.0, 2 * np.pi * RADIUS_M, COUNT + 1)
    plan = plan_of(on_circle(RADIUS_M), at_m, circle())
    found = failing(sewn(plan, [on_circle(RADIUS_M)[0]] * (COUNT + 1)))
    assert found["seam_error"] == pytest.approx(2 * RADIUS_M, rel=1e-2)
    assert found["contour_error"] == pytest.approx(2 * RADIUS_M, rel=1e-9)
