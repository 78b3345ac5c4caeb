"""The search must find every interval, not the first one, and say what ends it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.search import find_fastest
from threadline.verdict import Result, Status, Verdict


def verdict(excess: float) -> Verdict:
    """A verdict with one criterion, ``excess`` times its limit of 1."""
    status = Status.PASSED if excess <= 1.0 else Status.FAILED
    result = Result(
        name="contour_error", axis="", measured=excess, limit=1.0, unit="m", status=status
    )
    return Verdict(results=(result,), simulated=True)


def test_two_intervals_are_both_reported_the_faster_first() -> None:
    """Pass below 1 and between 3 and 5: a search that assumes monotony would stop at 1."""
    found = find_fastest(lambda f: verdict(0.5 if f <= 1.0 or 3.0 <= f <= 5.0 else 2.0), 0.1, 10.0)

    assert [(i.low, i.high) for i in found.intervals] == [
        (pytest.approx(3.0, rel=2e-3), pytest.approx(5.0, rel=2e-3)),
        (pytest.approx(0.1), pytest.approx(1.0, rel=2e-3)),
    ]
    assert found.best is not None
    assert found.intervals[0].low >= 3.0
    assert found.best <= 5.0
    assert found.limited_by == "contour_error"
    assert found.verdict.passed


def test_nothing_passes_and_what_fails_is_said_where_it_came_closest() -> None:
    """The least excess is at 2.0, inside the range: neither the slowest nor the fastest feed."""
    found = find_fastest(lambda f: verdict(1.5 + abs(f - 2.0)), 0.1, 10.0, points=41)
    assert found.best is None
    assert found.intervals == ()
    assert found.limited_by == "contour_error"
    assert not found.verdict.passed
    assert found.verdict.results[0].measured == pytest.approx(1.5, abs=0.12)


def test_everything_passes_up_to_the_end_of_the_range() -> None:
    found = find_fastest(lambda _: verdict(0.5), 0.1, 10.0)
    assert [(i.low, i.high) for i in found.intervals] == [(0.1, 10.0)]
    assert found.limited_by == "range"


@given(edge=st.floats(0.15, 9.0))
def test_the_edge_is_found_from_the_passing_side(edge: float) -> None:
    """Wherever the limit lies, the answer passes and is within the stated 0.2 % of it."""
    found = find_fastest(lambda f: verdict(f / edge), 0.1, 10.0)
    assert found.best is not None
    assert edge * (1 - 2.1e-3) <= found.best <= edge


@pytest.mark.parametrize(("low", "high", "points"), [(1.0, 1.0, 8), (0.0, 1.0, 8), (1.0, 2.0, 1)])
def test_an_empty_range_is_refused(low: float, high: float, points: int) -> None:
    with pytest.raises(ValueError, match="nothing to scan"):
        find_fastest(lambda _: verdict(0.5), low, high, points=points)
