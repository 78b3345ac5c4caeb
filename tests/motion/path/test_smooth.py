"""Parabolic blends, cubic and quintic polynomials."""

import numpy as np
import pytest
from hypothesis import given, settings

from threadline.jobs.operations import Dwell, Feed, FeedMode, Source
from threadline.machine import load_machine
from threadline.motion.path import path_deviation, plan_path, programmed_path
from threadline.motion.timing import check_limits, plan_trajectory

from .builders import COUNTS, job_of, polylines
from .test_auto import gap_to_polyline, pieces, sampled

WINDER = load_machine("lathe-winder")
RAPID = Feed(FeedMode.RAPID, 0.0)


def planned(points, axes, name, feed=RAPID, tolerance_m=1e-4, **given):
    programmed = programmed_path(job_of(points, axes, feed, **given), WINDER, feed)
    path = plan_path(programmed, WINDER, name, tolerance_m)
    return programmed, path, plan_trajectory(path, WINDER)


@settings(max_examples=25)
@given(polylines())
def test_parabolic_keeps_tolerance_and_limits(line):
    axes, points = line
    _, path, trajectory = planned(points, axes, "parabolic")
    if trajectory.duration_s == 0.0:
        return
    assert all(peak.ratio <= 1.001 for peak in check_limits(trajectory, WINDER))
    vertices = np.array(points) * path.radius_m
    for block in trajectory:
        at = np.linspace(block.start_s[0], block.end_s, 2 * len(block) + 1)
        scaled = block.evaluate(at) * path.radius_m
        assert gap_to_polyline(scaled, vertices).max() <= 1.01e-4


def test_parabolic_blend_is_a_parabola_that_cuts_by_a_quarter():
    """Closed form: tangent lengths l on both sides cut the corner by l |t2 - t1| / 4."""
    points = [[0, 0], [0.1, 0], [0.1, 0.1]]
    programmed, path, _ = planned(points, ("X", "Y"), "parabolic")
    c = pieces_of_any_order(path)
    reach = 0.1 - c[0, :2].sum(axis=0)[0]  # from the end of the first line to the corner
    deviation = path_deviation(programmed, path)
    assert deviation.at_tool_m == pytest.approx(reach * np.sqrt(2) / 4, rel=1e-9)
    assert deviation.at_tool_m <= 1e-4
    assert np.all(c[1, 2] == c[2, 2])  # one constant second derivative over both halves


def pieces_of_any_order(path):
    return np.concatenate([block.coefficients for block in path])


@settings(max_examples=25)
@given(polylines())
@pytest.mark.parametrize("name", ["cubic", "quintic"])
def test_polynomials_pass_the_points_within_limits(name, line):
    """Pieces meet every vertex exactly; the trajectory keeps all limits, jerk included."""
    axes, points = line
    _, path, trajectory = planned(points, axes, name)
    if trajectory.duration_s == 0.0:
        return
    assert all(peak.ratio <= 1.001 for peak in check_limits(trajectory, WINDER))
    c = pieces_of_any_order(path)
    visited = np.vstack([c[:1, 0], c.sum(axis=1)])
    moved = np.abs(np.diff(points, axis=0)).max(axis=1) > 0
    vertices = np.vstack([points[:1], np.array(points)[1:][moved]])
    assert visited == pytest.approx(vertices, abs=1e-12)
    for block in trajectory:
        u = np.linspace(0, 1, 9)[:, None] ** np.arange(block.coefficients.shape[1])
        positions = np.einsum("uk,ika->iua", u, block.coefficients).reshape(-1, len(axes))
        assert np.all(positions >= vertices.min(axis=0) - 1e-9)  # monotone: never overshoots
        assert np.all(positions <= vertices.max(axis=0) + 1e-9)


def test_quintic_is_continuous_to_the_acceleration():
    points = np.cumsum(np.random.default_rng(3).normal(size=(40, 2)) * 0.02, axis=0)
    points -= points[0]
    points[:, 1] = np.clip(points[:, 1], -0.05, 0.25)
    _, _, trajectory = planned(points.tolist(), ("X", "Y"), "quintic")
    knots = np.concatenate([block.start_s for block in trajectory])[1:]
    for order, limit in ((1, 1.0), (2, 10.5)):
        step = trajectory(knots - 1e-9, order) - trajectory(knots, order)
        assert np.abs(step).max() <= 1e-4 * limit


@pytest.mark.parametrize("name", ["parabolic", "cubic", "quintic"])
def test_feed_is_an_upper_bound_and_dwells_are_kept(name):
    dwell = {2: Dwell(0.4, Source("job.prg", 2))}
    points = [[0, 0], [0.05, 0], [0.05, 0.05], [0.1, 0.05]]
    _, _, trajectory = planned(points, ("X", "Y"), name, Feed(COUNTS, 20), extra=dwell)
    times = np.linspace(0, trajectory.duration_s, 20_001)
    counts = np.abs(trajectory(times, 1)) * np.array([55_358, 62_294]) * 0.005
    assert 19.0 < counts.max() <= 20.0 + 1e-6
    duration = np.concatenate([block.duration_s for block in trajectory])
    assert np.isclose(duration, 0.4).any()
    assert trajectory(np.array([trajectory.duration_s]))[0] == pytest.approx([0.1, 0.05])


@pytest.mark.parametrize("name", ["parabolic", "cubic", "quintic"])
def test_blocks_leave_no_seam(name):
    way = 0.2 * np.sin(np.linspace(0, 60, 9_001))
    _, path, _ = planned([[x] for x in way], ("X",), name)
    c = pieces_of_any_order(path)
    assert c.sum(axis=1)[:-1] == pytest.approx(c[1:, 0], abs=1e-13)
    assert sum(int(block.rest_after.sum()) for block in path) == 1
    assert len(pieces(path)) == len(c) if c.shape[1] == 4 else True
    assert len(sampled(path, 2)) == 2 * len(c) if c.shape[1] == 4 else True
