"""The fastest motion through points without a machine."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.errors import PlanError
from threadline.trajectory import retime


def largest(motion, order, count=20_001):
    times = np.linspace(0.0, motion.duration_s, count)
    return np.abs(motion(times, order)).max(axis=0)


def test_a_single_move_has_the_time_of_its_closed_form():
    """L 1, v 0.5, a 2, no jerk limit: L / v + v / a = 2.25 s; 1, 1, 5, 50: 1.3 s."""
    assert 2.25 <= retime([[0.0], [1.0]], 0.5, 2.0).duration_s <= 2.25 * 1.005
    assert 1.3 <= retime([[0.0], [1.0]], 1.0, 5.0, 50.0).duration_s <= 1.3 * 1.005


def test_every_limit_holds_and_one_is_used():
    random = np.random.default_rng(7)
    points = random.normal(size=(40, 3))
    velocity, acceleration, jerk = [3.0, 2.0, 5.0], [20.0, 10.0, 30.0], [900.0, 700.0, 2000.0]
    motion = retime(points, velocity, acceleration, jerk, tolerance=0.05)
    shares = [
        largest(motion, order) / limit
        for order, limit in enumerate((velocity, acceleration, jerk), start=1)
    ]
    assert np.max(shares) <= 1.001
    assert np.max(shares[1]) > 0.99 and np.max(shares[2]) > 0.99
    assert motion(0.0)[0] == pytest.approx(points[0]) and motion(motion.duration_s)[
        0
    ] == pytest.approx(points[-1])


def test_a_wider_tolerance_is_faster_and_is_kept():
    points = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    durations = []
    for tolerance in (1e-4, 1e-3, 1e-2, 1e-1):
        motion = retime(points, 2.0, 10.0, 500.0, tolerance)
        durations.append(motion.duration_s)
        place = motion(np.linspace(0.0, motion.duration_s, 4001))
        edges = [np.abs(place[:, 1]), np.abs(place[:, 0] - 1.0), np.abs(place[:, 1] - 1.0)]
        assert np.min(edges, axis=0).max() <= tolerance
    assert sorted(durations, reverse=True) == durations and durations[-1] < 0.8 * durations[0]


@pytest.mark.parametrize(
    "points",
    [
        [[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]],
        [[0.0, 0.0], [0.1, 0.1], [0.10001, 0.1]],
        [[0.0, 0.0], [1e-9, 1e-9], [1e6, 0.0], [1e6, 1e-6], [0.1, 0.1]],
    ],
)
@pytest.mark.parametrize("tolerance", [1e-3, 0.2, 100.0])
def test_the_motion_ends_at_the_last_point_whatever_the_tolerance(points, tolerance):
    """Also where points lie nearer to each other than the tolerance can tell apart."""
    motion = retime(points, 1.0, 5.0, 50.0, tolerance)
    span = np.abs(points).max()
    # Digits of the largest coordinate.
    assert np.abs(motion(motion.duration_s)[0] - points[-1]).max() <= 1e-15 * span
    assert np.abs(motion(0.0)[0] - points[0]).max() <= 1e-15 * span


def test_a_path_far_shorter_than_its_tolerance_takes_the_straight_way():
    """Jerk-limited from rest to rest: T = 4 (h / 2 j)^(1/3); the barrier ends 0.3 % above it."""
    motion = retime([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]], 1.0, 5.0, 50.0, 100.0)
    assert motion.duration_s == pytest.approx(4.0 * (0.1 / 100.0) ** (1 / 3), rel=5e-3)


def test_one_point_and_equal_points_are_no_motion():
    assert retime([[1.0, 2.0]], 1.0, 1.0).duration_s == 0.0
    assert retime([[1.0, 2.0]] * 5, 1.0, 1.0, 1.0).duration_s == 0.0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"points": [[0.0], [np.nan]]}, "point 1 is"),
        ({"points": [0.0, 1.0]}, "shape"),
        ({"points": "abc"}, "not an array of numbers"),
        ({"velocity": 0.0}, "velocity of axis 0 is 0.0"),
        ({"velocity": np.inf}, "velocity of axis 0 is inf"),
        ({"acceleration": [1.0, 1.0]}, "one for each of 1 axes"),
        ({"jerk": -1.0}, "jerk of axis 0 is -1.0"),
        ({"tolerance": 0.0}, "tolerance is 0.0"),
        ({"tolerance": np.nan}, "tolerance is nan"),
    ],
)
def test_what_is_no_number_in_range_is_refused_by_name(given, said):
    asked = {"points": [[0.0], [1.0]], "velocity": 1.0, "acceleration": 1.0, **given}
    with pytest.raises(PlanError, match=said):
        retime(**asked)
