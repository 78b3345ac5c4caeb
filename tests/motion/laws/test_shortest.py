"""Shortest moves: printed durations, the condition for the least time, limits by integration."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.errors import OptionError
from threadline.motion.laws import shortest_move

SIZES = st.floats(-3.0, 3.0).map(lambda power: 10.0**power)


@pytest.mark.parametrize(
    ("limits", "printed_s"),
    [
        ((1.0, 0.5, 2.0), 2.25),  # a trapezoid: no limit of jerk
        ((1.0, 2.0, 1.0), 2.0),  # a triangle
        ((1.0, 1.0, 5.0, 50.0), 1.3),  # all seven phases
        ((0.05, 1.0, 5.0, 50.0), 0.31748),  # jerk alone
        ((1.0, 0.2, 5.0, 10.0), 5.0 + 2.0 * np.sqrt(0.02)),  # jerk and velocity
        ((0.0, 1.0, 5.0, 50.0), 0.0),
    ],
)
def test_durations_are_those_that_are_printed(limits, printed_s):
    assert shortest_move(*limits).duration_s == pytest.approx(printed_s, abs=6e-6)


@given(SIZES, SIZES, SIZES, SIZES)
def test_some_limit_is_reached_at_every_instant(distance, velocity, acceleration, jerk):
    """Pontryagin's condition for the least time: no instant at which all limits are free."""
    move = shortest_move(distance, velocity, acceleration, jerk)
    half = [move.jerk_s, move.push_s, move.jerk_s]
    phases = np.array([*half, move.cruise_s, *half])
    middles = np.cumsum(phases) - 0.5 * phases
    # A phase that only rounding leaves does not count; the others are at their places.
    seen = phases > 1e-6 * move.duration_s
    times, step = middles[seen], 0.25 * phases[seen]
    a, v = move(times, 2), move(times, 1)
    j = np.abs(move(times + step, 2) - move(times - step, 2)) / (2.0 * step)
    used = np.maximum(np.abs(a) / acceleration, np.maximum(v / velocity, j / jerk))
    assert used.min() > 1.0 - 1e-6


@given(SIZES, SIZES, SIZES, st.one_of(st.just(np.inf), SIZES))
def test_shortest_move_ends_at_rest_within_its_limits(distance, velocity, acceleration, jerk):
    """Sums at the middles of 20 000 steps reach distance and rest, to their error."""
    move = shortest_move(distance, velocity, acceleration, jerk)
    n = 20_000
    times = (np.arange(n) + 0.5) * (move.duration_s / n)
    a, v, s = (move(times, order) for order in (2, 1, 0))
    step = move.duration_s / n
    assert np.abs(a).max() <= acceleration * (1 + 1e-9)
    assert v.max() <= velocity * (1 + 1e-9) and v.min() >= -1e-9 * velocity
    assert (a.sum() * step) == pytest.approx(0.0, abs=1e-3 * velocity)
    assert v.sum() * step == pytest.approx(distance, rel=1e-5)
    assert (np.diff(s) >= -1e-12 * distance).all()
    if np.isfinite(jerk):
        assert np.abs(np.diff(a)).max() <= jerk * step * (1 + 1e-6) + 1e-9 * acceleration
    ends = move(np.array([-1.0, move.duration_s + 1.0]))
    assert ends[0] == 0.0 and ends[1] == distance


@pytest.mark.parametrize(
    ("limits", "named"),
    [
        ((-1.0, 1.0, 1.0, 1.0), "distance"),
        ((1.0, 0.0, 1.0, 1.0), "velocity"),
        ((1.0, 1.0, np.inf, 1.0), "acceleration"),
        ((1.0, 1.0, 1.0, np.nan), "jerk"),
    ],
)
def test_impossible_limit_is_refused_by_name(limits, named):
    with pytest.raises(OptionError, match=named):
        shortest_move(*limits)
