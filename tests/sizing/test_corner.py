"""Corner rules, compared with integrated motion and the printed figures."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.optimize import minimize_scalar

from threadline.sizing import (
    corner_acceleration_m_s2,
    corner_error_m,
    corner_speed_m_s,
    ramp_acceleration_m_s2,
)

IN = 0.0254


def integrated_error(v: float, up: float, turn: float, down: float) -> float:
    """Nearest approach to the corner: the two legs as accelerations, by DOP853."""
    d1, d2 = np.array([1.0, 0.0]), np.array([np.cos(turn), np.sin(turn)])
    start = -(v**2) / (2 * down) * d1  # braking on leg 1 begins here, leg 2 starts
    slow, fast = v / down, v / up

    # Steps end at the two switches, so that each stretch is smooth.
    switches = sorted({0.0, slow, fast, max(slow, fast) * 1.1})
    y = np.concatenate([start, v * d1])
    best = np.inf
    for a, b in itertools.pairwise(switches):
        middle = (a + b) / 2
        brake = -down * d1 if middle < slow else np.zeros(2)
        push = up * d2 if middle < fast else np.zeros(2)
        run = solve_ivp(
            lambda t, s, acc=brake + push: np.concatenate([s[2:], acc]),
            (a, b), y, method="DOP853", rtol=1e-12, atol=1e-14, dense_output=True,
        )  # fmt: skip
        near = minimize_scalar(
            lambda t, run=run: float(np.hypot(*run.sol(t)[:2])),
            bounds=(a, b), method="bounded", options={"xatol": 1e-12 * b},
        )  # fmt: skip
        best = min(best, float(near.fun), float(np.hypot(*run.y[:2, -1])))
        y = run.y[:, -1]
    return best


@given(st.floats(0.01, 1.0), st.floats(0.5, 50.0), st.floats(0.05, 3.1), st.floats(0.2, 5.0))
def test_error_is_that_of_the_integrated_motion(
    v: float, a: float, turn: float, unequal: float
) -> None:
    """Any angle, equal and unequal acceleration; the reference contains no formula."""
    assert corner_error_m(v, a, turn) == pytest.approx(integrated_error(v, a, turn, a), rel=1e-6)
    down = a * unequal
    assert corner_error_m(v, a, turn, down) == pytest.approx(
        integrated_error(v, a, turn, down), rel=1e-6
    )


def test_right_angle_is_the_formula_of_the_thesis() -> None:
    v, a = 0.19, 7.0
    assert corner_error_m(v, a, np.pi / 2) == pytest.approx(np.sqrt(2) * v**2 / (8 * a), rel=1e-14)
    # Unequal rates with equal values: the other branch of the code, one answer.
    assert corner_error_m(v, a, np.pi / 2, a * (1 + 1e-9)) == pytest.approx(
        corner_error_m(v, a, np.pi / 2), rel=1e-6
    )


def test_straight_on_misses_nothing_and_back_overshoots_most() -> None:
    assert corner_error_m(0.2, 5.0, 0.0) == 0.0
    assert corner_speed_m_s(5e-4, 5.0, 0.0) == np.inf
    # Back the way it came, the head turns a quarter of the stopping distance short.
    assert corner_error_m(0.2, 5.0, np.pi) == pytest.approx(0.2**2 / (4 * 5.0), rel=1e-14)


def test_printed_accelerations() -> None:
    """281 in/s2 for two stitches; 546 in/s2 belongs to 7.86 in/s, not to the text's 7.5 in/s."""
    v = 75 * 0.1 * IN
    assert ramp_acceleration_m_s2(v, 0.1 * IN) / IN == pytest.approx(281.25, rel=1e-12)
    assert corner_acceleration_m_s2(v, 0.02 * IN, np.pi / 2) / IN == pytest.approx(497.2, abs=0.05)
    assert corner_speed_m_s(0.02 * IN, 546 * IN, np.pi / 2) / IN == pytest.approx(7.86, abs=0.005)
    assert corner_acceleration_m_s2(7.86 * IN, 0.02 * IN, np.pi / 2) / IN == pytest.approx(
        546, abs=0.5
    )


def test_ramp_is_over_after_its_stitches() -> None:
    """Needle-down places of a head that accelerates from rest: 1/4, then 3/4 of a stitch."""
    length, needle = 2.5e-3, 60.0
    a = ramp_acceleration_m_s2(length * needle, length)
    t = np.arange(4) / needle
    ramp = 2 / needle
    x = np.where(t < ramp, a * t**2 / 2, a * ramp**2 / 2 + a * ramp * (t - ramp))
    assert np.diff(x) / length == pytest.approx([0.25, 0.75, 1.0], rel=1e-12)


@pytest.mark.parametrize(("a", "turn"), [(0.0, 1.0), (-1.0, 1.0), (1.0, -0.1), (1.0, 3.2)])
def test_nonsense_is_refused(a: float, turn: float) -> None:
    with pytest.raises(ValueError, match="got"):
        corner_error_m(0.1, a, turn)
