"""Intervals, indices and distributions of a yield, compared with published numbers and scipy."""

from __future__ import annotations

import numpy as np
import pytest

from threadline.search.influence import influence
from threadline.verdict.each_run import clopper_pearson


@pytest.mark.parametrize(("passed", "tried"), [(1, 10), (37, 50), (9_990, 10_000)])
def test_the_interval_leaves_each_tail_its_share(passed: int, tried: int) -> None:
    """Compared with the binomial distribution itself: 2.5 % at either end."""
    from scipy.stats import binom

    low, high = clopper_pearson(passed, tried)
    assert binom.sf(passed - 1, tried, low) == pytest.approx(0.025, rel=1e-9)
    assert binom.cdf(passed, tried, high) == pytest.approx(0.025, rel=1e-9)


def test_yield_bound_of_machines_that_all_pass_has_a_closed_form() -> None:
    """p^n = 2.5 %, in closed form."""
    assert clopper_pearson(10_000, 10_000) == (pytest.approx(0.025 ** (1 / 10_000)), 1.0)
    assert clopper_pearson(0, 10) == (0.0, pytest.approx(1.0 - 0.025**0.1))


@pytest.mark.long(shown_by="test_a_number_that_does_nothing_has_no_share_and_no_spread")
def test_indices_are_those_of_ishigami() -> None:
    """sin x1 + a sin^2 x2 + b x3^4 sin x1 on [-pi, pi]^3, a = 7, b = 0.1.

    Closed form (Ishigami and Homma, 1990): V1 = (1 + b pi^4 / 5)^2 / 2, V2 = a^2 / 8,
    V13 = b^2 pi^8 (1 / 18 - 1 / 50), and nothing else. 1 % is what 2^12 samples give.
    """
    a, b = 7.0, 0.1

    def ishigami(parts: np.ndarray) -> np.ndarray:
        x = np.pi * parts
        return np.sin(x[:, 0]) * (1.0 + b * x[:, 2] ** 4) + a * np.sin(x[:, 1]) ** 2

    found = influence(ishigami, [False] * 3, 2**12, 1)
    one = 0.5 * (1.0 + b * np.pi**4 / 5.0) ** 2
    two, both = a**2 / 8.0, b**2 * np.pi**8 * (1.0 / 18.0 - 1.0 / 50.0)
    whole = one + two + both
    assert found.first == pytest.approx([one / whole, two / whole, 0.0], abs=0.01)
    assert found.total == pytest.approx([(one + both) / whole, two / whole, both / whole], abs=0.01)
    for values, ends in (
        (found.first, found.first_interval),
        (found.total, found.total_interval),
    ):
        assert (ends[0] <= values).all() and (values <= ends[1]).all()
    # The same seed gives the same bits, ends of the intervals included.
    again = influence(ishigami, [False] * 3, 2**6, 1)
    other = influence(ishigami, [False] * 3, 2**6, 1)
    np.testing.assert_array_equal(again.first_interval, other.first_interval)
    np.testing.assert_array_equal(again.total_interval, other.total_interval)
    # The true shares lie in most of the intervals of other seeds, and no interval is too wide.
    within = []
    for seed in range(12):
        few = influence(ishigami, [False] * 3, 2**7, seed)
        for ends, true in (
            (few.first_interval, [one / whole, two / whole, 0.0]),
            (few.total_interval, [(one + both) / whole, two / whole, both / whole]),
        ):
            within += ((ends[0] <= true) & (true <= ends[1])).tolist()
            assert (ends[1] - ends[0] < 0.8).all()
    assert np.mean(within) >= 0.8


def test_a_normal_number_is_cut_off_at_three_deviations() -> None:
    seen: list[np.ndarray] = []

    def result(parts: np.ndarray) -> np.ndarray:
        seen.append(parts)
        return parts.sum(axis=1)

    influence(result, [True, False], 2**8, 1)
    parts = np.concatenate(seen)
    assert np.abs(parts[:, 0]).max() <= 1.5 < 10 * np.abs(parts[:, 0]).max()
    assert parts[:, 0].std() == pytest.approx(0.4933, abs=0.02)  # of a normal cut off at 3
    assert np.abs(parts[:, 1]).max() <= 1.0


def test_shares_are_those_of_scipy() -> None:
    """The estimates of scipy itself, for samples of the same seed."""
    from scipy.stats import sobol_indices, uniform

    def bowl(parts: np.ndarray) -> np.ndarray:
        return parts[:, 0] ** 2 + parts[:, 0] * parts[:, 1] + 0.3 * parts[:, 2]

    own = influence(bowl, [False] * 3, 2**6, 5)
    theirs = sobol_indices(
        func=lambda x: bowl(x.T)[None], n=2**6, dists=[uniform(-1.0, 2.0)] * 3,
        rng=np.random.default_rng(5),
    )  # fmt: skip
    np.testing.assert_allclose(own.first, theirs.first_order, rtol=1e-12)
    np.testing.assert_allclose(own.total, theirs.total_order, rtol=1e-12)


def test_a_number_that_does_nothing_has_no_share_and_no_spread() -> None:
    """The interval of such a number was NaN, which JSON does not have, with a warning of scipy."""
    found = influence(lambda x: x[:, 0], [False, False], 2**6, 1)
    assert found.first[1] == found.total[1] == 0.0
    assert found.first_interval[:, 1].tolist() == found.total_interval[:, 1].tolist() == [0.0, 0.0]
    assert np.isfinite(found.first_interval).all() and np.isfinite(found.total_interval).all()
