"""Limits along and across the path, and braking, checked from outside the planner.

Speeds and accelerations along the path are computed here from the motion's velocities,
accelerations and jerks at random instants, by the formulas of a curve in space.
"""

from __future__ import annotations

import numpy as np
import pytest

from threadline.errors import PlanError
from threadline.motion.timing.retime import retime

TURN = np.linspace(0.0, 9.0, 60)
CURVE = np.stack([np.sin(TURN), np.cos(1.3 * TURN), 0.1 * TURN], axis=1)
CORNERS = np.random.default_rng(1).normal(size=(12, 3))
BACK = np.array([[0, 0, 0], [1, 0, 0], [0.2, 0, 0], [0.2, 0.5, 0], [0.2, 0.1, 0.01], [1, 1, 1.0]])
PATHS = {"curve": CURVE, "corners": CORNERS, "back": BACK}
GIVEN = {
    "deceleration": [3.0, 20.0, 8.0],
    "centripetal": 2.0,
    "path_velocity": 0.8,
    "path_acceleration": 4.0,
    "path_jerk": 100.0,
}


def seen(motion, count):
    """Return the largest of each quantity at random instants, as the limits are named."""
    times = np.random.default_rng(3).uniform(0.0, motion.duration_s, count)
    v, a, j = (motion(times, order) for order in (1, 2, 3))
    speed = np.linalg.norm(v, axis=1)
    moving = speed > 1e-3 * speed.max()  # almost at rest there is no direction
    v, a, j, speed = v[moving], a[moving], j[moving], speed[moving]
    along = v / speed[:, None]
    push = (along * a).sum(axis=1)
    across = np.linalg.norm(a - push[:, None] * along, axis=1)
    speeding = v * a > 0.0
    return {
        "velocity": np.abs(v).max(axis=0),
        "acceleration": np.where(speeding, np.abs(a), 0.0).max(axis=0),
        "deceleration": np.where(speeding, 0.0, np.abs(a)).max(axis=0),
        "jerk": np.abs(j).max(axis=0),
        "path_velocity": speed.max(),
        "path_acceleration": np.abs(push).max(),
        "path_jerk": np.abs((along * j).sum(axis=1) + across**2 / speed).max(),
        "centripetal": across.max(),
    }


@pytest.mark.parametrize("name", list(PATHS))
def test_all_limits_hold_at_a_million_instants(name):
    """A third of a million instants on each path, all limits at once; none is exceeded by 0.1 %."""
    limits = {"velocity": 1.0, "acceleration": 8.0, "jerk": 200.0}
    motion = retime(PATHS[name], *limits.values(), tolerance=0.01, **GIVEN)
    found = seen(motion, 340_000)
    for quantity, limit in {**limits, **GIVEN}.items():
        assert np.all(found[quantity] <= 1.001 * np.array(limit)), quantity
    assert motion.bound <= 1.001
    assert np.abs(motion(motion.duration_s)[0] - PATHS[name][-1]).max() < 1e-12


@pytest.mark.parametrize("quantity", list(GIVEN))
@pytest.mark.parametrize("name", ["curve", "corners"])
def test_each_limit_binds_where_it_is_the_only_one(name, quantity):
    """At least 0.98 of it is used, and without it the motion would be faster and far beyond it."""
    given = GIVEN[quantity] if quantity != "deceleration" else [3.0, 3.0, 3.0]
    free = retime(PATHS[name], 1.0, 8.0, 200.0, 0.01)
    motion = retime(PATHS[name], 1.0, 8.0, 200.0, 0.01, **{quantity: given})
    used = np.max(seen(motion, 50_000)[quantity] / given)
    assert 0.98 < used <= 1.001
    assert np.max(seen(free, 50_000)[quantity] / given) > 1.2
    assert motion.duration_s > free.duration_s * 1.005


def test_the_bound_lies_above_what_is_seen_and_near_to_it():
    """Every share is at least the largest of 10^5 instants, and at most 3 % more."""
    motion = retime(CURVE, 1.0, 8.0, 200.0, 0.01, **GIVEN)
    found = seen(motion, 100_000)
    limits = {"velocity": 1.0, "jerk": 200.0, **GIVEN}
    for name, share in motion.shares.items():
        own = found[name] / np.array(limits.get(name, 8.0))
        if name == "acceleration":
            own = np.maximum(own, found["deceleration"] / np.array(GIVEN["deceleration"]))
        assert (share >= own * (1.0 - 1e-6)).all(), name
        assert (share <= own * 1.03).all(), name
    assert motion.bound == pytest.approx(1.0, abs=1e-3)


def test_braking_harder_than_speeding_up_takes_the_time_of_the_closed_form():
    """A straight way without jerk: v^2 / 2 a to accelerate, v^2 / 2 d to brake, the rest at v."""
    length, v, a, d = 1.0, 1.0, 4.0, 10.0
    least_s = length / v + 0.5 * v / a + 0.5 * v / d
    motion = retime([[0.0, 0.0], [0.0, -length]], v, a, deceleration=d)
    assert least_s <= motion.duration_s * (1 + 1e-9) and motion.duration_s < 1.003 * least_s
    slower = retime([[0.0, 0.0], [0.0, -length]], v, d, deceleration=a)
    assert slower.duration_s == pytest.approx(motion.duration_s, rel=1e-3)


@pytest.mark.long(shown_by="test_each_limit_binds_where_it_is_the_only_one")
def test_a_round_at_a_centripetal_limit_takes_the_time_of_its_circumference():
    """v^2 = a r: four rounds of 1 m at 2 m/s^2, and less than a second to accelerate and brake."""
    turn = np.linspace(0.0, 8.0 * np.pi, 2000)
    points = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    motion = retime(points, 10.0, 50.0, 5000.0, 1e-4, centripetal=2.0)
    even_s = 8.0 * np.pi / np.sqrt(2.0)
    assert even_s < motion.duration_s < even_s + 1.0


def test_a_straight_way_has_no_centripetal_acceleration():
    points = [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [2.0, 4.0, 6.0]]
    free, held = (retime(points, 1.0, 5.0, 50.0, **k) for k in ({}, {"centripetal": 1e-6}))
    assert held.duration_s == pytest.approx(free.duration_s, rel=1e-3)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"centripetal": 0.0}, "centripetal is 0.0"),
        ({"path_jerk": -1.0}, "path_jerk is -1.0"),
        ({"path_velocity": np.nan}, "path_velocity is nan"),
        ({"path_acceleration": [1.0]}, "must be one number"),
        ({"deceleration": 0.0}, "deceleration of axis 0 is 0.0"),
        ({"deceleration": np.inf}, "deceleration of axis 0 is inf"),
    ],
)
def test_impossible_path_limit_is_refused_by_name(given, message):
    with pytest.raises(PlanError, match=message):
        retime([[0.0, 0.0], [1.0, 1.0]], 1.0, 1.0, **given)
