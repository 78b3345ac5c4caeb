"""Routh's array, compared with the roots; step figures, with closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.dynamics.poles import routh_array, stable_gains, unstable_roots
from threadline.dynamics.responses import read_step

ROOTS = st.lists(
    st.tuples(
        st.floats(-5, 5).filter(lambda x: abs(x) > 0.05),
        st.one_of(st.just(0.0), st.floats(0.1, 5)),
    ),
    min_size=1,
    max_size=4,
)


@given(ROOTS)
def test_sign_changes_count_the_unstable_roots(pairs):
    roots = [complex(re, im) for re, im in pairs] + [complex(re, -im) for re, im in pairs if im]
    found = unstable_roots(np.poly(roots).real.tolist())
    assert found == sum(root.real > 0 for root in roots)


def test_array_of_a_textbook():
    """s^4 + 2 s^3 + 3 s^2 + 4 s + 5: first column 1, 2, 1, -6, 5 (Ogata, example 5-11)."""
    np.testing.assert_allclose(routh_array([1, 2, 3, 4, 5])[:, 0], [1, 2, 1, -6, 5])
    # A row of zeros: (s^2 + 1)(s + 1) has no unstable root, (s^2 - 1)(s + 2) has one.
    assert unstable_roots([1, 1, 1, 1]) == 0
    assert unstable_roots([1, 2, -1, -2]) == 1
    with pytest.raises(ValueError, match="leading coefficient"):
        routh_array([0.0, 1.0])


@pytest.mark.parametrize(
    ("bottom", "top", "expected"),
    [
        ([1, 3, 2, 0], [1], [(0.0, 6.0)]),  # s (s + 1)(s + 2) + K: the textbook's 6
        ([1, -1], [1], [(1.0, np.inf)]),
        ([1, 2, -3, 0], [1, 2], None),  # found by brute force below
        # conditionally stable: 20 < K < 36 appears only if both limits are found
        ([1, 5, -6, 0], [1, 1], None),
        ([1, 0, 0], [-1, 1], []),
    ],
)
def test_stable_gains_against_roots(bottom, top, expected):
    found = stable_gains(np.array(top, dtype=float), np.array(bottom, dtype=float))
    if expected is not None:
        assert [pytest.approx(pair) for pair in expected] == list(found)
    for gain in np.geomspace(1e-2, 1e3, 137):
        roots = np.roots(np.polyadd(np.array(bottom, float), gain * np.array(top, float)))
        inside = any(low < gain < high for low, high in found)
        assert inside == bool((roots.real < 0).all())


@pytest.mark.parametrize("damping", [0.2, 0.5, 0.7])
def test_figures_of_a_second_order_step(damping):
    """Overshoot exp(-pi z / sqrt(1 - z^2)) at pi / wd; rise and settling from the formula."""
    omega = 50.0
    t = np.linspace(0, 2, 400_001)
    damped = omega * np.sqrt(1 - damping**2)

    def y(time):
        phase = damping / np.sqrt(1 - damping**2) * np.sin(damped * time) + np.cos(damped * time)
        return 3.0 * (1 - np.exp(-damping * omega * time) * phase)

    step = read_step(t, y(t), 3.0)
    assert step.overshoot == pytest.approx(
        np.exp(-np.pi * damping / np.sqrt(1 - damping**2)), rel=1e-6
    )
    assert step.peak_s == pytest.approx(np.pi / damped, abs=1e-5)
    assert step.steady_state_error == pytest.approx(-2.0)
    late = t[t > step.settling_s + 1e-6]
    assert np.abs(y(late) / 3 - 1).max() <= 0.02
    assert abs(abs(y(step.settling_s) / 3 - 1) - 0.02) < 1e-6
    low = t[np.searchsorted(y(t[t < np.pi / damped]), 0.3)]
    high = t[np.searchsorted(y(t[t < np.pi / damped]), 2.7)]
    assert step.rise_s == pytest.approx(high - low, abs=2e-5)
