"""The three ways to pull the spline to its turning points."""

import numpy as np
import pytest
from scipy.interpolate import BSpline

from threadline.errors import OptionError
from threadline.jobs.operations import Feed
from threadline.machine import load_machine
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.timing import plan_trajectory

from .builders import COUNTS, job_of, there_and_back

WINDER = load_machine("lathe-winder")
FEED = Feed(COUNTS, 80)
SECOND_DIFFERENCE = 2 * 0.18 / 7


def pulled(pull, points=None):
    points = there_and_back() if points is None else points
    programmed = programmed_path(job_of(points, ("X",), FEED), WINDER, FEED)
    path = plan_path(programmed, WINDER, "b-spline-pulled", pull=pull)
    return path, plan_trajectory(path, WINDER)


@pytest.mark.parametrize(
    ("pull", "missed"),
    [
        ("repeat", 0.0),
        ("points", SECOND_DIFFERENCE / 48),
        ("spacing", SECOND_DIFFERENCE * 0.125 / (2 * 1.25)),
    ],
)
def test_turning_point_is_missed_by_the_closed_form(pull, missed):
    _, trajectory = pulled(pull)
    furthest = trajectory(np.linspace(0, trajectory.duration_s, 200_001)).max()
    assert 0.18 - furthest == pytest.approx(missed, abs=1e-8)


@pytest.mark.parametrize("pull", ["repeat", "points", "spacing"])
def test_fastest_interval_meets_the_feed_and_motion_is_smooth(pull):
    _, trajectory = pulled(pull)
    times = np.linspace(0, trajectory.duration_s, 400_001)
    fastest = np.abs(trajectory(times, 1)).max()
    feed = 80 / 55_358 / 0.005
    assert fastest <= feed * (1 + 1e-9)
    # With close knots the fastest place is at the reversal, where the bound is not met.
    assert fastest >= feed * (0.95 if pull == "spacing" else 1 - 1e-6)
    knots = np.concatenate([block.start_s for block in trajectory])[1:]
    for order in (1, 2):
        step = np.abs(trajectory(knots - 1e-12, order) - trajectory(knots, order)).max()
        assert step <= 1e-6 * np.abs(trajectory(times, order)).max()


def test_uneven_knots_agree_with_scipy():
    """Knot intervals of 1/8 beside the turning points: scipy's de Boor evaluation, to 1e-12."""
    points = [0.0, 0.02, 0.05, 0.03, 0.04, 0.09]  # turns at 0.05 and 0.03
    path, _ = pulled("spacing", [[x] for x in points])
    control = np.array([points[0]] * 2 + points + [points[-1]] * 2)
    span = np.array([1, 1, 1, 1 / 8, 1 / 8, 1 / 8, 1, 1, 1])  # of the legs between them
    at = np.concatenate([[0.0], np.cumsum(span)])  # knot of each control point
    knots = np.concatenate([[-2, -1], at, at[-1] + np.array([1, 2])])
    reference = BSpline(knots, control, 3)
    c = np.concatenate([block.coefficients for block in path])[:, :, 0]
    assert len(c) == len(control) - 3
    for u in (0.0, 0.4, 1.0):
        ours = sum(c[:, k] * u**k for k in range(4))
        expected = reference(at[1:-2] + u * span[1:-1] * (1 - 1e-15))
        assert ours == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("pull", ["points", "spacing"])
def test_streaming_leaves_no_seam(pull):
    way = 0.2 * np.sin(np.linspace(0, 3000, 10_001))
    path, _ = pulled(pull, [[x] for x in way])
    c = np.concatenate([block.coefficients for block in path])
    assert c.sum(axis=1)[:-1] == pytest.approx(c[1:, 0], abs=1e-13)
    turning = int((np.diff(np.sign(np.diff(way))) != 0).sum())
    added = 2 * turning if pull == "points" else 0
    assert len(c) == 10_001 + added + 1


def test_unknown_way_is_refused():
    with pytest.raises(OptionError, match="repeat, points, spacing"):
        pulled("magnet")
