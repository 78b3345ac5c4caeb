"""The trajectory of a geometric path: limits everywhere, the path, the feed, the time."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import PPoly

from threadline.errors import BudgetError
from threadline.jobs.operations import Dwell, Feed, FeedMode, Source
from threadline.machine import load_machine
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.timing import check_limits, plan_trajectory

from ..path.builders import COUNTS, job_of, polylines, there_and_back
from ..path.test_auto import gap_to_polyline

WINDER = load_machine("lathe-winder")
RAPID = Feed(FeedMode.RAPID, 0.0)


def followed(points, axes, tolerance_m=1e-4, feed=RAPID, name="auto", **given):
    programmed = programmed_path(job_of(points, axes, feed, **given), WINDER)
    path = plan_path(programmed, WINDER, name, tolerance_m)
    return path, plan_trajectory(path, WINDER)


def ppoly(trajectory):
    """Return the same motion as scipy's piecewise polynomial, (k, pieces, axes)."""
    start = np.concatenate([block.start_s for block in trajectory])
    duration = np.concatenate([block.duration_s for block in trajectory])
    c = np.concatenate([block.coefficients for block in trajectory])
    powers = duration[:, None, None] ** np.arange(c.shape[1])[None, :, None]
    knots = np.append(start, start[-1] + duration[-1])
    return PPoly(np.swapaxes(c / powers, 0, 1)[::-1], knots)


def limits_of(path):
    column = [WINDER.axis_names.index(axis) for axis in path.axes]
    return (
        WINDER.velocity_limit[column],
        WINDER.acceleration_limit[column],
        WINDER.jerk_limit[column],
    )


def within_limits(path, trajectory):
    """Evaluate scipy's derivatives at 9 places of every piece, both ends included."""
    motion = ppoly(trajectory)
    inner = np.linspace(1e-9, 1 - 1e-9, 9)
    times = (motion.x[:-1, None] + np.diff(motion.x)[:, None] * inner).ravel()
    for order, limit in enumerate(limits_of(path), start=1):
        assert np.abs(motion(times, order)).max(axis=0) == pytest.approx(
            np.minimum(np.abs(motion(times, order)).max(axis=0), 1.001 * limit), rel=1e-12
        )


@settings(max_examples=40)
@given(polylines(), st.sampled_from([1e-3, 1e-4, 1e-5]))
def test_limits_ends_and_tolerance(line, tolerance_m):
    """Whatever the polyline: limits to 1.001, both ends met, program followed, C2 in time."""
    axes, points = line
    path, trajectory = followed(points, axes, tolerance_m)
    if trajectory.duration_s == 0.0:
        assert np.ptp(np.array(points), axis=0).max() == 0.0
        return
    assert np.isfinite(trajectory.duration_s)
    within_limits(path, trajectory)
    assert all(peak.ratio <= 1.001 for peak in check_limits(trajectory, WINDER))
    motion = ppoly(trajectory)
    assert motion(motion.x[0]) == pytest.approx(np.array(points[0]), abs=1e-12)
    assert motion(motion.x[-1]) == pytest.approx(np.array(points[-1]), abs=1e-12)
    for order in (1, 2):  # from rest to rest, without a step at any knot
        values = motion(motion.x[[0, -1]], order)
        assert np.abs(values).max() <= 1e-6 * limits_of(path)[order - 1].max()
        before, after = motion(motion.x[1:-1] - 1e-12, order), motion(motion.x[1:-1], order)
        assert np.all(np.abs(after - before) <= 1e-6 * limits_of(path)[order - 1])
    times = np.linspace(motion.x[0], motion.x[-1], 2 * len(motion.x) + 1)
    scaled = motion(times) * path.radius_m
    vertices = np.array(points) * path.radius_m
    assert gap_to_polyline(scaled, vertices).max() <= 1.01 * tolerance_m
    # Vertices are compared with chords of the samples: add the sagitta of the fastest turn.
    sagitta = np.linalg.norm(limits_of(path)[1] * path.radius_m) * (times[1] - times[0]) ** 2 / 8
    assert gap_to_polyline(vertices, scaled).max() <= 1.01 * tolerance_m + sagitta


# Reversals beside chords of some micrometres, and between very long ones: the smoothing sees
# more than the corner there.
NASTY = [
    (("A", "X"), 1.2e-6, [[0, 0], [4.151, 0.0355], [20, 0.057], [4.151, 0.0355]]),
    (("X",), 4.6e-6, [[0], [0.002291519], [0.002291085], [-0.0117063], [-0.0116993]]),
    (
        ("A", "X"),
        3.7e-5,
        [
            [0, 0],
            [-0.009, 0.0002],
            [0.215, 0.0107],
            [1.917, 0.0131],
            [1.91695, 0.01309],
            [1.9, 0.01],
        ],
    ),
    (
        ("X", "Y"),
        1.1e-5,
        [[0, 0], [-0.0787, 0], [-0.2267, -4e-6], [-0.1563, -8e-9], [-0.1563, -2e-5]],
    ),
]


@pytest.mark.parametrize(("axes", "tolerance_m", "points"), NASTY)
def test_short_chords_and_reversals_stay_within_tolerance(axes, tolerance_m, points):
    path, trajectory = followed(points, axes, tolerance_m)
    check_limits(trajectory, WINDER)
    vertices = np.array(points) * path.radius_m
    nearest = np.full(len(vertices), np.inf)
    for block in trajectory:
        at = np.linspace(block.start_s[0], block.end_s, 40 * len(block) + 1)
        scaled = block.evaluate(at) * path.radius_m
        assert gap_to_polyline(scaled, vertices).max() <= tolerance_m
        nearest = np.minimum(nearest, gap_to_polyline(vertices, scaled))
    assert nearest.max() <= tolerance_m


@pytest.mark.parametrize("length_m", [0.002, 0.05, 0.4])
def test_straight_move_takes_the_time_of_the_trapezoid(length_m):
    """L / V + V / A, or 2 sqrt(L / A); the jerk limit adds 2 A / J, the step 2.5 more samples."""
    _, trajectory = followed([[0.0], [length_m]], ("X",))
    v, a, j = 1.0, 10.5, 2100.0
    bound = length_m / v + v / a if length_m > v * v / a else 2 * np.sqrt(length_m / a)
    assert bound + 2 * a / j <= trajectory.duration_s + 1e-9
    assert trajectory.duration_s <= bound + 2 * a / j + 0.004


def test_circle_runs_at_the_acceleration_limit():
    """Two axes around a circle of radius 20 mm: v^2 / r reaches the weaker axis' limit."""
    turn = np.linspace(0, 20 * np.pi, 7201)
    points = np.stack([0.02 * np.sin(turn), 0.02 - 0.02 * np.cos(turn)], axis=1)
    _, trajectory = followed(points.tolist(), ("X", "Y"))
    middle = np.linspace(0.3, 0.7, 400) * trajectory.duration_s
    speed = np.linalg.norm(trajectory(middle, 1), axis=1)
    # Y with 4.65 m/s^2 binds; X has more, and the tangential reserve lets the speed swing.
    assert np.abs(trajectory(middle, 2)[:, 1]).max() == pytest.approx(4.65, rel=0.02)
    assert speed.min() >= 0.95 * np.sqrt(4.65 * 0.02)


def test_reversal_passes_the_cusp_without_a_stop():
    """X 0 -> 180 -> 0 in little more than two trapezoids; the point is met within tolerance."""
    _, trajectory = followed(there_and_back(), ("X",))
    bound = 2 * (0.18 / 1.0 + 1.0 / 10.5)
    assert bound < trajectory.duration_s < 1.06 * bound
    peak = trajectory(np.linspace(0, trajectory.duration_s, 40_001)).max()
    assert 0.18 - 1e-4 <= peak <= 0.18


def test_programmed_feed_is_an_upper_bound_and_reached():
    points = [[0, 0], [0.1, 0], [0.1, 0.1], [0.05, 0.2]]
    feed = Feed(COUNTS, 10)
    _, trajectory = followed(points, ("X", "Y"), feed=feed)
    times = np.linspace(0, trajectory.duration_s, 50_001)
    counts = np.abs(trajectory(times, 1)) * np.array([55_358, 62_294]) * 0.005
    assert counts.max() == pytest.approx(10.0, rel=1e-6)
    nominal = sum(
        max(abs(dx) * 55_358, abs(dy) * 62_294) / 10 * 0.005 for dx, dy in np.diff(points, axis=0)
    )
    assert nominal < trajectory.duration_s < 1.02 * nominal


def test_dwell_lasts_and_stands_still():
    dwell = {1: Dwell(0.5, Source("job.prg", 1))}
    _, trajectory = followed([[0, 0], [0.1, 0], [0.1, 0.1]], ("X", "Y"), extra=dwell)
    duration = np.concatenate([block.duration_s for block in trajectory])
    start = np.concatenate([block.start_s for block in trajectory])
    held = int(np.argmax(duration))
    assert duration[held] == 0.5
    during = trajectory(np.linspace(start[held], start[held] + 0.5, 11))
    assert during == pytest.approx(np.tile([0.1, 0.0], (11, 1)), abs=1e-12)


def test_operations_follow_the_moves():
    """The label of a piece changes where the path passes the vertex, to a few samples."""
    _, trajectory = followed([[0.0], [0.1], [0.2], [0.3]], ("X",))
    operation = np.concatenate([block.operation for block in trajectory])
    start = np.concatenate([block.start_s for block in trajectory])
    assert np.all(np.diff(operation) >= 0)
    for label, edge in ((1, 0.1), (2, 0.2)):
        passed = trajectory(start[[int(np.argmax(operation == label))]])[0, 0]
        assert passed == pytest.approx(edge, abs=0.003)


def test_look_ahead_over_blocks_of_tiny_moves():
    """30 000 moves of 10 um on a line: as fast as one move, except for braking near block ends."""
    whole = 0.3
    points = np.linspace(0, whole, 30_001)[:, None]
    _, trajectory = followed(points.tolist(), ("X",))
    _, single = followed([[0.0], [whole]], ("X",))
    assert trajectory.duration_s == pytest.approx(single.duration_s, abs=2 * 0.00125)
    assert max(len(block) for block in trajectory) <= 16_384


def test_no_motion_is_an_empty_trajectory():
    _, trajectory = followed([[0.0], [0.0]], ("X",))
    assert trajectory.duration_s == 0.0


@pytest.mark.parametrize("name", ["auto", "parabolic", "cubic", "quintic", "linear"])
def test_a_feed_beyond_the_budget_is_refused_before_any_sample(name) -> None:
    """100 mm at 1e-12 m/s: 1e11 s are 2e13 ticks of 5 ms, too many samples for any memory."""
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.0]])
    slow = Feed(FeedMode.FASTEST_AXIS, 1e-12)
    programmed = programmed_path(job_of(points, ("A", "X", "Y"), slow), WINDER)
    trajectory = plan_trajectory(plan_path(programmed, WINDER, name), WINDER)
    with pytest.raises(BudgetError, match="ticks of 5 ms"):
        next(iter(trajectory))
