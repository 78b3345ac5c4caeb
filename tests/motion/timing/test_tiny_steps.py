"""Steps with hardly a digit at their place: no motion, and no step of an acceleration."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from tools.random_paths import Tally, run_case, without_drives

from threadline.machine import load_machine
from threadline.motion.timing.retime import retime


@pytest.mark.parametrize(
    "number",
    [
        317877,  # the last digit of half a million metres: the timing was no number
        325595,  # 1.7e-12 m back: steps of the acceleration by rounding, an infinite jerk
        340078,  # the same in two axes, 1.6e-11 m
        311512,  # 2 um after 0.6 m: the corner has pieces of picometres that take 0.6 us
        318564,  # 22 nm at the end of a curve: leaving them out turned the piece before
        360213,  # the same with a kink of 6 % between two axes
        361226,  # 0.4 nm after 0.28 m: the move ended in a curve as short, 3.6 % too late
    ],
)
def test_random_paths_that_failed_keep_every_limit(number: int) -> None:
    tally = Tally(Counter(), [])
    run_case(number, without_drives(load_machine("lathe-winder")), tally)
    assert tally.failed == []
    assert 0.99 < tally.worst <= 1.001


@pytest.mark.parametrize("number", [340614, 303594, 346753])
def test_corners_that_a_tolerance_of_a_metre_lets_be_cut_are_passed_no_slower_than_by_auto(number):
    """They took 8.6, 3.8 and 1.1 % longer while the spline left the ends of the run evenly."""
    tally = Tally(Counter(), [])
    run_case(number, without_drives(load_machine("lathe-winder")), tally)
    assert tally.failed == [] and 0.0 < tally.slowest < 1.0


@pytest.mark.parametrize(
    "number",
    [
        325193,  # a jerk that is reached in 1.4 ms of 520 ms of acceleration: 0.4 of it was used
        335391,  # 51 s at the feed, which is reached in 0.9 ms
    ],
)
def test_the_jerk_is_used_from_the_start_where_the_feed_is_far_off(number: int) -> None:
    """They were slower than by ``auto``, by 3e-6 and 4e-5: the feed limited the lead-in."""
    tally = Tally(Counter(), [])
    run_case(number, without_drives(load_machine("lathe-winder")), tally)
    assert tally.failed == [] and 0.9 < tally.worst <= 1.001 and 0.0 < tally.slowest < 0.99998


def test_the_last_digit_of_a_place_is_no_way_and_a_nanometre_is_one() -> None:
    given = {"velocity": [0.07], "acceleration": [3.135], "jerk": [2.793], "tolerance": 9.1e-7}
    far = 484458.8216178251
    there = retime([[0.0], [far]], **given)
    beside = retime([[0.0], [far], [np.nextafter(far, np.inf)]], **given)
    assert beside.duration_s == there.duration_s
    near = retime([[0.0], [1e-9]], **given)
    assert near(near.duration_s)[0, 0] == pytest.approx(1e-9, rel=1e-12)
    assert near.duration_s == pytest.approx((32.0 * 1e-9 / 2.793) ** (1.0 / 3.0), rel=1e-9)
