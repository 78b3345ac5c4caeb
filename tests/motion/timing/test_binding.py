"""The limits that bind at each instant, compared with the phases of a closed form."""

from __future__ import annotations

import pytest

from tests.motion.path.builders import job_of
from tests.motion.timing.builders import without_drives
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import load_machine
from threadline.motion.path import plan_path, programmed_path
from threadline.motion.timing import plan_trajectory
from threadline.motion.timing.optimal.binding import binding

AS_BUILT = load_machine("lathe-winder")
WINDER = without_drives(AS_BUILT)
CHORD = [[0.0, 0.0, 0.0], [0.0, 0.45, 0.0]]  # 450 mm of X


def bound(machine, feed, **options):
    path = plan_path(
        programmed_path(job_of(CHORD, ("A", "X", "Y"), feed), machine), machine, "optimal"
    )
    trajectory = plan_trajectory(path, machine, **options)
    return binding(trajectory, path, machine, **options), trajectory.duration_s


def test_a_single_move_is_bound_as_its_seven_phases_are() -> None:
    """v 1, a 10.5, j 2100: four phases of a / j, two of v / a - a / j, and the rest at v.

    The bar is 2 %: there are 4001 instants, and a little is lost where one limit replaces another.
    """
    found, duration_s = bound(WINDER, Feed(FeedMode.RAPID, 0.0))
    ramp_s, push_s = 10.5 / 2100.0, 1.0 / 10.5
    whole_s = 0.45 + push_s + ramp_s
    assert duration_s == pytest.approx(whole_s, rel=5e-3)
    binds = found.binds
    assert set(binds) == {"velocity", "acceleration", "jerk", "voltage"}
    assert binds["velocity"] == pytest.approx((0.45 - push_s - ramp_s) / whole_s, abs=0.02)
    assert binds["acceleration"] == pytest.approx(2 * (push_s - ramp_s) / whole_s, abs=0.02)
    assert binds["jerk"] == pytest.approx(4 * ramp_s / whole_s, abs=0.02)
    assert max(share.max() for share in found.shares.values()) <= 1.001


def test_a_feed_binds_where_it_is_the_speed() -> None:
    """At 36 mm/s, the cap of the normal feed: the whole time except two ramps of milliseconds.

    The time is that of the chord at the feed, plus half a percent for ramps and elements: a lead-in
    as long as a share of the chord takes half as much again.
    """
    found, duration_s = bound(WINDER, Feed(FeedMode.FASTEST_AXIS, 0.3))
    nominal_s = 0.45 / (10 / 55358.0 / 5e-3)
    assert nominal_s < duration_s < 1.005 * nominal_s
    assert found.binds["feed"] > 0.99
    assert found.shares["feed"].max() <= 1.001
    assert found.binds["velocity"] == 0.0


def test_drives_and_loops_bind_where_there_are_any() -> None:
    """At 4.5 V and 8.6 V/krpm the volts end the speed; behind a loop the lag binds, too."""
    found, _ = bound(AS_BUILT, Feed(FeedMode.RAPID, 0.0))
    assert found.binds["voltage"] > 0.4
    assert found.binds["current"] > 0.1
    assert "lag" not in found.shares
    found, _ = bound(AS_BUILT, Feed(FeedMode.RAPID, 0.0), contour_m=1e-4)
    assert 0.0 < found.shares["lag"].max() <= 1.0
