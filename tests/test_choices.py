"""Path, timing and following are three choices, with whatever options they were typed."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.path.builders import job_of
from threadline.commands.plan import Following
from threadline.errors import OptionError
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import load_machine
from threadline.motion.path import CHORDS, chord_path, plan_path, programmed_path
from threadline.motion.path.interpolations import KEEPING_TOLERANCE, interpolation_names
from threadline.motion.timing import Pace, plan_trajectory
from threadline.proof.options import Options, describe, options_from, options_of
from threadline.proof.pipeline import plan_job

MACHINE = load_machine("lathe-winder")
POINTS = [[0.0], [0.012], [0.02], [0.004]]
FEED = Feed(FeedMode.FASTEST_AXIS, 0.02)


def test_without_feed_forward_motors_follow_within_the_limits() -> None:
    options = Options(interpolation="b-spline", tolerance_m=2e-4, limit_share=0.5, shaper="zv:9Hz")
    assert (options.path.interpolation, options.path.tolerance_m) == ("b-spline", 2e-4)
    assert (options.timing.pace, options.timing.limit_share) == (Pace.LIMITED, 0.5)
    assert (options.timing.smoothing_s, options.timing.shaper) == (None, "zv:9Hz")
    assert options.following is Following.MOTOR


def test_feed_forward_is_a_word_for_three_choices() -> None:
    """``auto`` then plans chords at their times, smoothed, which the loads follow."""
    options = Options(feed_forward_s=0.04)
    assert options.path.interpolation == CHORDS
    assert (options.timing.pace, options.timing.smoothing_s) == (Pace.PROGRAMMED, 0.04)
    assert options.following is Following.LOAD
    # A path that was given by name stays, with its own timing.
    named = Options(interpolation="linear", feed_forward_s=0.04)
    assert (named.path.interpolation, named.timing.pace) == ("linear", Pace.LIMITED)
    assert named.following is Following.LOAD


def test_chords_are_no_interpolation_that_can_be_typed() -> None:
    assert CHORDS not in interpolation_names()
    assert CHORDS not in KEEPING_TOLERANCE
    with pytest.raises(OptionError, match="unknown interpolation 'chords'"):
        plan_path(programmed_path(job_of(POINTS, ("X",), FEED), MACHINE), MACHINE, CHORDS)


def test_programmed_times_are_kept_exactly() -> None:
    """Ways of 12, 8 and 16 mm at 20 mm/s: 0.6, 0.4 and 0.8 s, at constant speed in between."""
    path = chord_path(programmed_path(job_of(POINTS, ("X",), FEED), MACHINE))
    trajectory = plan_trajectory(path, MACHINE, Pace.PROGRAMMED)
    assert trajectory.historical  # its velocity steps until it is smoothed
    assert trajectory.duration_s == pytest.approx(1.8, rel=1e-12)
    instants = np.array([0.0, 0.3, 0.6, 0.8, 1.0, 1.4, 1.8])
    expected = [0.0, 0.006, 0.012, 0.016, 0.02, 0.012, 0.004]
    assert trajectory(instants)[:, 0] == pytest.approx(expected, abs=1e-15)
    assert trajectory(np.array([0.3, 1.4]), 1)[:, 0] == pytest.approx([0.02, -0.02], rel=1e-12)


def test_a_curved_path_has_no_programmed_times() -> None:
    path = plan_path(programmed_path(job_of(POINTS, ("X",), FEED), MACHINE), MACHINE, "auto")
    with pytest.raises(OptionError, match="only chords keep their programmed times, not auto"):
        plan_trajectory(path, MACHINE, Pace.PROGRAMMED)


def test_a_plan_says_what_follows_and_what_was_intended() -> None:
    job = job_of(POINTS, ("X",), FEED)
    options = plan_job(job, MACHINE, Options()).motion
    assert (options.following, options.of_loads, options.timed) == (Following.MOTOR, None, None)
    assert options.of_needle is options.trajectory
    shaped = plan_job(job, MACHINE, Options(shaper="zv:12Hz:0.02")).motion
    assert shaped.timed is not None
    assert shaped.of_loads is None
    assert shaped.of_needle is shaped.trajectory
    led = plan_job(job, MACHINE, Options(feed_forward_s=0.2)).motion
    assert led.following is Following.LOAD
    assert led.of_loads is led.trajectory
    assert led.of_needle is led.timed
    assert {demand.axis for demand in led.demands} == {"X"}
    assert led.path.interpolation == CHORDS
    assert not led.historical


def test_the_contour_is_of_optimal_followed_by_motors() -> None:
    """0.3 mm by default; if the loads follow, it bounds only the ends of the table."""
    assert Options(interpolation="optimal").timing.contour_m == 3e-4
    assert Options().timing.contour_m == np.inf
    assert Options(interpolation="optimal", feed_forward_s=0.01).timing.contour_m == np.inf
    named = options_of("optimal", None, "0.1 mm", contour="50 um")
    assert named.timing.contour_m == pytest.approx(5e-5, rel=1e-12)
    assert options_of("optimal", None, "0.1 mm", contour="none").timing.contour_m == np.inf
    with pytest.raises(OptionError, match="bounds the path deviation with optimal"):
        options_of("auto", None, "0.1 mm", contour="0.3 mm")
    at_ends = options_of("optimal", None, "0.1 mm", feed_forward=True, contour="0.2 mm").timing
    assert at_ends.ends_m == pytest.approx(2e-4, rel=1e-12)
    assert at_ends.contour_m == np.inf
    for text in ("0 mm", "-1 mm", "0.9 um"):
        with pytest.raises(OptionError, match="at least 1 um"):
            options_of("optimal", None, "0.1 mm", contour=text)


def test_the_contour_is_told_and_read_again() -> None:
    job = job_of(POINTS, ("X",), FEED)
    for contour_m in (None, 5e-5, np.inf):
        options = Options(interpolation="optimal", contour_m=contour_m)
        described = describe(job, MACHINE, options)
        assert options_from(described).timing == options.timing
    assert "contour" not in describe(job, MACHINE, Options())


def test_feed_forward_smooths_optimal_less() -> None:
    assert options_of("auto", None, "0.1 mm", feed_forward=True).feed_forward_s == 0.04
    assert options_of("optimal", None, "0.1 mm", feed_forward=True).feed_forward_s == 0.01
