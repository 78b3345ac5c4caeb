"""The search for feeds finds every interval, not only the first, and names the limit."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from threadline.cli.search_text import forbidden_words, isolated_words
from threadline.machine import load_machine
from threadline.search import feed_range_m_s, find_fastest
from threadline.search.fastest import Grid
from threadline.search.feed_ranges import joined
from threadline.verdict import Result, Status, Verdict


def verdict(excess: float) -> Verdict:
    """A verdict with one criterion, which measures ``excess`` times its limit of 1."""
    status = Status.PASSED if excess <= 1.0 else Status.FAILED
    result = Result(
        name="contour_error", axis="", measured=excess, limit=1.0, unit="m", status=status
    )
    return Verdict(results=(result,), simulated=True)


def test_two_intervals_are_both_reported_the_faster_first() -> None:
    """Feeds below 1 and between 3 and 5 pass: a search that assumes monotony would stop at 1."""
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


@pytest.mark.parametrize("every", [True, False])
def test_two_feeds_stand_for_all_between_them_where_the_planner_keeps_the_limits(
    every: bool,
) -> None:
    """If an end fails, the search is the same as without this assumption."""
    grid = Grid(near=16, every=every, between=True)
    found = find_fastest(lambda _: verdict(0.5), 0.1, 10.0, grid)
    assert found.tried == 2 and found.best == 10.0 and found.step == 0.0
    assert len(found.intervals) == 1 and (found.intervals[0].low == 0.1) == every

    def judged(feed: float) -> Verdict:
        return verdict(0.5 if 0.3 <= feed <= 2.0 else 2.0)

    plain, other = (
        find_fastest(judged, 0.1, 10.0, replace(grid, between=between)) for between in (False, True)
    )
    assert other.intervals == plain.intervals and other.step == plain.step > 0.0


def test_narrow_intervals_beyond_an_edge_are_found() -> None:
    """Because times are rounded to whole ticks, feeds with thin margins pass and fail in turn."""
    expected = [(0.1, 0.93), (0.94, 1.0), (1.02, 1.03), (1.06, 1.07), (3.0, 3.4)]

    def judged(feed: float) -> Verdict:
        return verdict(0.99 if any(low <= feed <= high for low, high in expected) else 1.01)

    found = find_fastest(judged, 0.1, 10.0, Grid(near=16))

    assert [(i.low, i.high) for i in reversed(found.intervals)] == [
        (pytest.approx(low, rel=2.1e-3), pytest.approx(high, rel=2.1e-3)) for low, high in expected
    ]
    # 47 steps from 0.1 to 10, and 17 in place of one step of the scan.
    assert found.step == pytest.approx(100 ** (1 / 47) - 1)
    assert found.near_step == pytest.approx(100 ** (1 / (47 * 17)) - 1)


def test_a_feed_that_passes_alone_is_not_the_fastest() -> None:
    """Above 1 all feeds fail but a thousandth about 1.05, narrower than edges are refined."""

    def judged(feed: float) -> Verdict:
        return verdict(0.99 if feed <= 1.0 or 1.0495 <= feed <= 1.0505 else 1.01)

    found = find_fastest(judged, 0.1, 10.0, Grid(points=48, near=400))
    assert [i.isolated for i in found.intervals] == [True, False]
    assert found.isolated == (pytest.approx(1.05, rel=1e-3),)
    assert found.best == pytest.approx(1.0, rel=2.1e-3) and found.best <= 1.0
    assert found.verdict.passed and found.limited_by == "contour_error"
    assert isolated_words(found, "mm/s", 1e3) == (
        f"in spec alone, out of it within 0.2% on both sides: {found.isolated[0] * 1e3:.12g} mm/s"
    )

    def nowhere_else(feed: float) -> Verdict:
        return judged(feed) if feed > 1.02 else verdict(3.0)

    only = find_fastest(nowhere_else, 1.049, 1.06, Grid(points=12, near=16))
    assert only.fastest is not None and only.fastest.isolated
    assert only.best == only.isolated[0]
    assert isolated_words(only, "m/s").endswith("m/s; no range is in spec")


def test_an_end_of_the_search_is_not_alone() -> None:
    """A feed that passes at the end of a search has no failing neighbour there."""
    found = find_fastest(lambda f: verdict(0.9 if f >= 1.0595 else 1.1), 1.0, 1.06, Grid(near=16))
    assert [(i.high, i.isolated) for i in found.intervals] == [(1.06, False)]
    assert not found.isolated and isolated_words(found, "m/s") == ""


def test_nothing_passes_and_what_fails_is_said_where_it_came_closest() -> None:
    """The smallest excess is at 2.0, inside the range, not at the slowest or fastest feed."""
    found = find_fastest(lambda f: verdict(1.5 + abs(f - 2.0)), 0.1, 10.0, Grid(points=41))
    assert found.best is None
    assert found.intervals == ()
    assert found.limited_by == "contour_error"
    assert not found.verdict.passed
    assert found.verdict.results[0].measured == pytest.approx(1.5, abs=0.12)


def spread_at(feed: float) -> Verdict:
    """Below 1 one run passes and the spread of twenty fails; above 1 a single run fails already."""
    if feed > 1.0:
        return verdict(1.0 + 0.01 * feed)
    row = replace(verdict(1.2 + feed).results[0], name="repeatability")
    return replace(verdict(0.5), results=(*verdict(0.5).results, row), runs=20)


def test_verdict_failing_in_one_run_ranks_behind_verdict_failing_over_twenty() -> None:
    """One run does not show the spread, so its small excess does not come closest."""
    found = find_fastest(spread_at, 0.1, 10.0, Grid(points=21))
    assert found.limited_by == "repeatability" and found.verdict.runs == 20
    assert found.verdict.results[1].measured == pytest.approx(1.3)
    slow, fast = found.forbidden
    assert (slow.name, slow.low, slow.feeds, slow.repeated) == ("repeatability", 0.1, 11, 11)
    assert (fast.name, fast.high, fast.feeds, fast.repeated) == ("contour_error", 10.0, 10, 0)
    assert slow.high < fast.low
    again = joined([*found.forbidden, *found.forbidden])
    assert [(one.name, one.feeds) for one in again] == [
        ("repeatability", 22),
        ("contour_error", 20),
    ]
    lines = list(forbidden_words(found.forbidden, found.limited_by, "F {:.3g}".format))
    assert lines[0] == ("repeatability fails from F 0.1 to F 1, contour_error from F 1.26 to F 10")
    assert lines[1].startswith("11 of them pass in one run")


def test_criterion_that_forbids_every_feed_fails_at_every_one() -> None:
    found = find_fastest(lambda _: verdict(2.0), 0.1, 10.0, Grid(points=3))
    assert list(forbidden_words(found.forbidden, found.limited_by, str)) == [
        "contour_error fails at every one"
    ]


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


def several(**excess: float | None) -> Verdict:
    """A verdict with a required criterion for each name; None: the criterion was not measured."""
    results = []
    for name, value in excess.items():
        status = Status.PASSED if value is not None and value <= 1.0 else Status.FAILED
        status = Status.NOT_MEASURED if value is None else status
        results.append(
            Result(
                name=name,
                axis="",
                measured=value,
                limit=1.0,
                unit="m",
                status=status,
                required=True,
            )
        )
    return Verdict(results=tuple(results), simulated=True)


def test_limiting_criterion_fails_first_above_the_best_feed() -> None:
    """The contour fails from 2 on, the jerk from 5 on by far more: the contour is named."""
    found = find_fastest(lambda f: several(jerk=(f / 5.0) ** 9, contour=f / 2.0), 0.1, 10.0)
    assert found.limited_by == "contour"
    assert found.best is not None
    # The verdict is the verdict at the best feed, not at another passing feed.
    assert found.verdict.result("contour").measured == found.best / 2.0


def test_a_required_criterion_that_is_not_measured_ends_an_interval() -> None:
    """No other criterion fails above 3, so it is named. A measured excess counts as closer."""
    found = find_fastest(lambda f: several(settling=0.5 if f <= 3.0 else None), 0.1, 10.0)
    assert found.limited_by == "settling"
    assert found.best == pytest.approx(3.0, rel=2.1e-3)

    none = find_fastest(
        lambda f: several(settling=None, contour=1.1) if f < 1.0 else several(contour=50.0), 0.1, 9
    )
    assert none.best is None
    assert none.verdict.result("contour").measured == 50.0


def test_the_scan_is_even_on_a_logarithmic_scale_and_judges_no_feed_twice() -> None:
    """From 0.2 to 0.25 there are 1.5 of 47 logarithmic steps, but 1/40 of a linear step."""
    tried: list[float] = []

    def judged(feed: float) -> Verdict:
        tried.append(feed)
        return verdict(0.5 if 0.2 <= feed <= 0.25 else 2.0)

    found = find_fastest(judged, 0.1, 100.0)
    assert found.best == pytest.approx(0.25, rel=2.1e-3)
    assert len(set(tried)) == len(tried) == found.tried


@pytest.mark.parametrize(("low", "high", "points"), [(1.0, 1.0, 8), (0.0, 1.0, 8), (1.0, 2.0, 1)])
def test_an_empty_range_is_refused(low: float, high: float, points: int) -> None:
    with pytest.raises(ValueError, match="nothing to scan"):
        find_fastest(lambda _: verdict(0.5), low, high, Grid(points=points))


def test_feeds_can_be_typed_back() -> None:
    """A search to 0.2 % needs no sixteen digits; the printed feed is the tried feed."""
    tried: list[float] = []

    def judged(feed: float) -> Verdict:
        tried.append(feed)
        return verdict(0.5 if feed <= 0.0312345678 else 2.0)

    found = find_fastest(judged, 1e-3, 1.0)
    assert found.best in tried
    assert all(len(f"{feed:g}") <= 8 and float(f"{feed:.6g}") == feed for feed in tried)
    assert found.best == pytest.approx(0.0312345678, rel=2.1e-3)
    close = find_fastest(judged, 1.0, 1.0 + 1e-12, Grid(points=5))
    assert close.tried == 5  # so close to each other that every digit is needed


def test_highest_feed_of_a_machine_has_six_digits() -> None:
    """A velocity limit in deg/s on a radius has 16 digits; the tried feed has six."""
    machine = load_machine("lathe-winder")
    low, high = feed_range_m_s(machine)
    assert all(feed == float(f"{feed:.6g}") for feed in (low, high))
    limit = float((machine.velocity_limit * machine.radius_m).max())
    assert high == pytest.approx(limit, rel=5e-6)
    found = find_fastest(lambda f: verdict(0.5), low, high)
    assert found.best == high
    assert len(repr(found.best)) <= 8
