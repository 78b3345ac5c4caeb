"""A clock by the angle of a shaft: angles and times are each other's inverse, within the bound."""

from __future__ import annotations

import pickle
from fractions import Fraction

import numpy as np
import pytest

from threadline.signals import ShaftClock
from threadline.signals.shaft import TIME_BOUND_S

RUN_UP = ShaftClock(
    "main",
    3600,
    (Fraction(0), Fraction(1, 2), Fraction(2), Fraction(3)),
    (Fraction(0), Fraction(5, 2), Fraction(5, 2), Fraction(7, 3)),
)


def test_a_constant_speed_is_exact_both_ways() -> None:
    """167 turns a minute: a step every 1/10020 s, no fraction of which a float has."""
    clock = ShaftClock("main", 3600, (Fraction(0),), (Fraction(167, 60),))
    assert clock.time_of(1) == Fraction(1, 10020)
    for tick in (0, 1, 7, 3600, 10**9 + 7):
        assert clock.angle_at(clock.time_of(tick)) == Fraction(tick, 3600)
        assert clock.ticks_at(clock.time_of(tick)) == tick
    assert clock.ticks_at(clock.time_of(7) - Fraction(1, 10**12)) == 6


def test_ramps_are_inverted_within_the_bound() -> None:
    """At most TIME_BOUND_S early, against the exact angle; steps 0 to 30 000 in all pieces."""
    before = Fraction(-1)
    for tick in [*range(40), *range(40, 30_000, 371)]:
        time = RUN_UP.time_of(tick)
        assert time > before
        before = time
        wanted = Fraction(tick, 3600)
        assert RUN_UP.angle_at(time) <= wanted <= RUN_UP.angle_at(time + TIME_BOUND_S)


def test_the_run_up_is_what_the_closed_form_says() -> None:
    """From rest at 5 turns/s^2: sqrt(2 angle / 5), and half a turn of a second's 2.5 after it."""
    ticks = np.arange(0, 2250, 50)
    np.testing.assert_allclose(
        RUN_UP.times_s_of(0, 2250)[::50], np.sqrt(2 * ticks / 3600 / 5), rtol=1e-15, atol=1e-15
    )
    assert RUN_UP.angle_at(Fraction(1, 2)) == Fraction(5, 8)
    assert RUN_UP.time_of(2250) == Fraction(1, 2)
    assert RUN_UP.angle_at(Fraction(1)) == Fraction(5, 8) + Fraction(5, 4)
    assert RUN_UP.angle_at(Fraction(-1)) == 0
    # Beyond the last knot the speed of that knot holds.
    assert RUN_UP.angle_at(Fraction(4)) - RUN_UP.angle_at(Fraction(3)) == Fraction(7, 3)
    assert pickle.loads(pickle.dumps(RUN_UP)).time_of(99) == RUN_UP.time_of(99)


@pytest.mark.parametrize(
    ("steps", "times", "speeds", "message"),
    [
        (0, (Fraction(0),), (Fraction(1),), "steps per turn must be 1 or more, got 0"),
        (1, (Fraction(0), Fraction(1)), (Fraction(1),), "2 times and 1 speeds"),
        (1, (Fraction(1),), (Fraction(1),), "must rise from 0 s"),
        (1, (Fraction(0), Fraction(0)), (Fraction(1), Fraction(1)), "must rise from 0 s"),
        (1, (Fraction(0), Fraction(1)), (Fraction(1), Fraction(-1)), "turns backwards, at -1"),
        (1, (Fraction(0), Fraction(1)), (Fraction(1), Fraction(0)), "stands still"),
        (
            1,
            (Fraction(0), Fraction(1), Fraction(2)),
            (Fraction(0), Fraction(0), Fraction(1)),
            "stands still",
        ),
    ],
)
def test_schedules_that_have_no_inverse_are_refused(steps, times, speeds, message) -> None:
    with pytest.raises(ValueError, match=message):
        ShaftClock("main", steps, times, speeds)
    with pytest.raises(ValueError, match="tick -1 is before the start"):
        RUN_UP.time_of(-1)
