"""Shares of the limits: skipped shares, answers after an interrupt, and the progress."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tests.jobs.made_machines import made_machine
from tests.search.test_fastest import verdict
from tests.search.test_long_jobs import winding_blocks, written
from threadline.base.progress import Progress, TrialShares
from threadline.cli.search_text import resolution_words, settings_words
from threadline.errors import LimitError
from threadline.machine import Machine
from threadline.proof.options import Options
from threadline.search import fastest_job, least_limits
from threadline.search.deadline import INTERRUPTED, OUT_OF_TIME, Deadline, HaltError
from threadline.search.fastest import RANGE, Fastest, Grid, Interval, find_fastest
from threadline.search.least_limits import Shares
from threadline.search.paced import Question
from threadline.verdict import Result, Status, Verdict, load_spec

SPEC = 'name = "any"\n[[criteria]]\nname = "contour_error"\nlimit = "1 mm"\nrequired = true\n'


def found() -> Fastest:
    best = Interval(low=0.1, high=0.5)
    return Fastest(intervals=(best,), limited_by="x", verdict=verdict(0.5), tried=3)


def shares_of(
    durations: dict[float, float],
    at_top: dict[float, float],
    fractions: list[float] | None = None,
    until: Deadline | None = None,
) -> tuple[Shares, list[float]]:
    """Shares of a search that finds these durations, and the list of searched shares."""
    searched: list[float] = []

    def search(share: float, grid: Grid, telling: Progress | None) -> Fastest:
        searched.append(share)
        for part in (0.25, 0.5, 1.0):
            if telling is not None:
                telling("searching", part)
        return found()

    shares = Shares(
        searched=search,
        duration_s=lambda share, _: durations[share],
        at_top_s=lambda share: at_top[share],
        expected=4,
        progress=None if fractions is None else lambda _, part: fractions.append(part),
        until=until,
    )
    return shares, searched


def test_a_share_that_cannot_be_the_answer_is_left_out() -> None:
    """With a quarter the highest feed is as slow as the best so far; with a half it is faster.

    The lower feeds of a share take longer than its highest feed.
    """
    shares, searched = shares_of({1.0: 1000.0, 0.5: 900.0}, {0.5: 850.0, 0.25: 900.0})
    assert shares.tried(1.0, Grid()) is not None and shares.tried(0.5, Grid()) is not None
    assert shares.tried(0.25, Grid()) is None and shares.tried(0.25, Grid()) is None
    assert (
        searched == [1.0, 0.5]
        and shares.left_out == {0.25}
        and set(shares.candidates) == {1.0, 0.5}
    )
    assert shares.tried(0.5, Grid(near=16)) is not None and searched == [1.0, 0.5, 0.5]


def test_short_job_searches_every_share() -> None:
    shares, searched = shares_of({1.0: 200.0, 0.5: 300.0}, {0.5: 300.0})
    assert shares.tried(1.0, Grid()) is not None and shares.tried(0.5, Grid()) is not None
    assert searched == [1.0, 0.5] and not shares.left_out


def test_share_is_searched_if_its_highest_feed_breaks_a_limit() -> None:
    """With feed-forward the highest feed may break a limit that lower feeds keep."""
    shares, searched = shares_of({1.0: 1000.0, 0.5: 900.0}, {})

    def refused(_: float) -> float:
        raise LimitError("broken", quantity="jerk", axis="X", value_si=2.0, limit_si=1.0)

    shares.at_top_s = refused
    assert shares.tried(1.0, Grid()) is not None and shares.tried(0.5, Grid()) is not None
    assert searched == [1.0, 0.5]


def test_progress_of_the_search_over_shares_only_grows() -> None:
    fractions: list[float] = []
    shares, _ = shares_of({1.0: 1e3, 0.5: 9e2}, {0.5: 1.0, 0.25: 9e2, 0.125: 9e2}, fractions)
    for share in (1.0, 0.5, 0.25, 0.125):
        shares.tried(share, Grid())
    assert fractions == sorted(fractions) and fractions[0] == 0.0 and fractions[-1] == 0.75
    assert {0.0625, 0.125, 0.25, 0.3125, 0.5} <= set(fractions)
    for _ in range(4):
        shares.tried(1.0, Grid(near=16))
    assert fractions == sorted(fractions) and fractions[-1] == 1.0


def test_an_interrupt_while_the_best_is_planned_leaves_it() -> None:
    until = Deadline()
    shares, _ = shares_of({1.0: 1000.0}, {}, until=until)
    planned: list[float] = []

    def interrupted(share: float, _: Fastest) -> float:
        planned.append(share)
        if len(planned) == 1:
            raise KeyboardInterrupt
        return 1000.0

    shares.duration_s = interrupted
    with pytest.raises(HaltError):
        shares.tried(1.0, Grid())
    assert shares.candidates[1.0].duration_s == 1000.0 and until.ended == INTERRUPTED


def test_a_finer_search_that_is_ended_keeps_what_was_known() -> None:
    """It starts from every verdict of the scan, and judges none of these feeds again."""
    asked: list[float] = []

    def judged(feed: float) -> Verdict:
        asked.append(feed)
        return verdict(0.5 if feed < 1.0 else 2.0)

    seen: dict[float, Verdict] = {}
    coarse = find_fastest(judged, 0.1, 10.0, Grid(points=9), seen=seen)
    before = len(asked)
    until = Deadline()
    until.ended = OUT_OF_TIME
    ended = find_fastest(judged, 0.1, 10.0, Grid(points=9, near=4), until=until, seen=seen)
    assert len(asked) == before and not ended.complete and ended.best == coarse.best
    fine = find_fastest(judged, 0.1, 10.0, Grid(points=9, near=4), seen=seen)
    assert len(set(asked)) == len(asked) == fine.tried
    single = find_fastest(judged, 0.1, 10.0, Grid(points=9, near=4))
    assert fine.best is not None and single.best is not None
    assert fine.best == pytest.approx(single.best, rel=4e-3)


@pytest.fixture(scope="module")
def machine(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return made_machine(tmp_path_factory.mktemp("shares"), "X", "A")


def at_the_highest(asked: Question, *_: object) -> Fastest:
    """The answer of a search for a feed: every feed passes."""
    assert asked.high is not None
    best = Interval(low=0.019, high=asked.high)
    return Fastest(intervals=(best,), limited_by="range", verdict=verdict(0.5), tried=20)


def test_a_long_job_is_not_searched_with_limits_that_cannot_be_the_answer(
    tmp_path: Path, machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All limits allow the feed of these 400 moves: a smaller share is slower and not tried.

    Then the whole job is judged; an interrupt there leaves the best so far.
    """
    job = written(tmp_path, winding_blocks(400), machine)
    file = tmp_path / "spec.toml"
    file.write_text(SPEC)

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(least_limits, "fastest_feed", at_the_highest)
    monkeypatch.setattr(Question, "judged", interrupted)
    result = fastest_job(
        Question(
            job=job,
            machine=machine,
            spec=load_spec(file, machine),
            options=Options(),
            low=0.019,
            high=0.02,
            until=Deadline(),
        )
    )
    assert result.best.share == 1.0 and result.best.duration_s > 300.0
    assert set(result.left_out) > {0.5, 0.25, 0.125} and [r.share for r in result.candidates] == [
        1.0
    ]
    assert result.ended == INTERRUPTED and not result.whole and result.parts
    # The accelerations are still printed, because their share was searched.
    assert len(list(settings_words(job, machine, result))) == 2
    with pytest.raises(KeyboardInterrupt):
        fastest_job(
            Question(
                job=job,
                machine=machine,
                spec=load_spec(file, machine),
                options=Options(),
                low=0.019,
                high=0.02,
            )
        )


def test_long_job_examines_only_its_fastest_interval() -> None:
    """A gap in it and a narrow interval above it are found; gaps among slower feeds are not."""
    expected = [(0.1, 0.2), (0.205, 0.3), (1.0, 1.8), (1.82, 2.0), (2.03, 2.06)]

    def judged(feed: float) -> Verdict:
        return verdict(0.99 if any(low <= feed <= high for low, high in expected) else 1.01)

    few = find_fastest(judged, 0.1, 10.0, Grid(points=20, near=16, every=False))
    all_of_them = find_fastest(judged, 0.1, 10.0, Grid(points=20, near=16))
    assert few.best == all_of_them.best == pytest.approx(2.06, rel=2.1e-3)
    assert not few.every and all_of_them.every and few.tried < 0.8 * all_of_them.tried
    assert [i for i in few.intervals if i.low > 0.9] == [
        i for i in all_of_them.intervals if i.low > 0.9
    ]
    assert "about the upper edge of the fastest" in resolution_words(few)
    assert "about the edges of the fastest" in resolution_words(all_of_them)


def test_long_job_tries_no_feed_far_below_the_passing_ones() -> None:
    """Four passing feeds in a row from the top are enough; if none passes, all are tried."""
    tried: list[float] = []

    def judged(feed: float) -> Verdict:
        tried.append(feed)
        return verdict(0.5 if feed > least else 1.5)

    least = 0.0
    found = find_fastest(judged, 0.1, 10.0, Grid(points=20, every=False))
    assert found.best == 10.0 and len(tried) == 4 and found.low == min(tried) > 4.0
    least = 20.0
    assert find_fastest(judged, 0.1, 10.0, Grid(points=20, every=False)).best is None
    assert len(tried) == 24


def test_an_error_that_no_slower_motion_changes_ends_the_scan_from_above() -> None:
    """A pull holds the loops 1.5 mm beside their commands, and the feed adds to this error.

    The scan goes on if an error stays the same because the motion does, or if it shrinks.
    """
    tried: list[float] = []

    def judged(feed: float) -> Verdict:
        tried.append(feed)
        one = verdict(1.5 + shrinks * feed)
        speed = Result(
            name="velocity", axis="X", measured=min(feed, top), limit=None, unit="m/s",
            status=Status.REPORTED,
        )  # fmt: skip
        return replace(one, results=(*one.results, speed))

    shrinks, top = 0.1, 1.0
    found = find_fastest(judged, 0.01, 10.0, Grid(points=20, near=16, every=False))
    # Below 0.15 the feed adds at most 1 %: a third of that is slow enough.
    assert found.best is None and found.limited_by == "contour_error"
    assert found.low == min(tried) > 0.03 and len(tried) < 18
    assert found.fixed == "contour_error"
    assert find_fastest(judged, 0.01, 10.0, Grid(points=20)).low == 0.01
    tried.clear()
    top = 0.0
    assert find_fastest(judged, 0.01, 10.0, Grid(points=20, every=False)).low == 0.01
    tried.clear()
    shrinks, top = 1.0, 1.0
    assert find_fastest(judged, 0.1, 10.0, Grid(points=20, every=False)).low == 0.1


def test_length_of_a_job_is_known_before_the_first_search() -> None:
    for at_top_s, long in ((301.0, True), (299.0, False)):
        shares, searched = shares_of({}, {1.0: at_top_s})
        assert shares.long is long and not searched


def test_below_feeds_that_pass_alone_the_next_interval_is_looked_into() -> None:
    """One feed of the scan passes alone at 10^0.5; below 1 there is a gap that the scan misses."""

    def judged(feed: float) -> Verdict:
        passes = feed <= 0.45 or 0.55 <= feed <= 1.0 or abs(feed - single) < 1e-4
        return verdict(0.99 if passes else 1.01)

    single = float(f"{10.0**0.5:.4g}")
    found = find_fastest(judged, 0.1, 10.0, Grid(points=9, near=16, every=False))
    assert found.isolated == (single,) and found.best == pytest.approx(1.0, rel=2.1e-3)
    # Four feeds in a row pass down to 10^-0.75.
    lows = [i.low for i in found.intervals if not i.isolated]
    assert lows == pytest.approx([0.55, 10.0**-0.75], rel=2.1e-3) and found.low == lows[-1]

    def nothing_holds(feed: float) -> Verdict:
        return verdict(0.99 if abs(feed - single) < 1e-4 else 1.01)

    found = find_fastest(nothing_holds, 0.1, 10.0, Grid(points=9, near=16, every=False))
    assert found.isolated == (single,) and found.best == single


def test_limiting_criterion_ignores_a_feed_that_passes_by_chance() -> None:
    """A known feed that passes by chance right above the edge does not hide the criterion."""

    def judged(feed: float) -> Verdict:
        return verdict(0.99 if feed <= 1.0 or abs(feed - 1.0011) < 1e-5 else 1.01)

    found = find_fastest(judged, 0.1, 10.0, Grid(points=9), seen={1.0011: judged(1.0011)})
    assert found.best is not None and 0.99 < found.best <= 1.0
    assert found.limited_by == "contour_error"
    assert find_fastest(judged, 0.1, 0.9, Grid(points=9)).limited_by == RANGE


def test_a_search_between_two_feeds_is_half_done_behind_the_first() -> None:
    """Two feeds stand for the rest; if one of them fails, the scan gets the rest of the progress.

    As one of fifty trials, the first feed made a search of minutes look like hours.
    """
    fractions: list[float] = []
    trials = TrialShares(lambda _, share: fractions.append(share), "searching", 0.0)

    def judged(feed: float) -> Verdict:
        trials.within(0.5)
        return verdict(0.5 if feed < highest else 2.0)

    highest = 100.0
    grid = Grid(points=9, near=4, between=True)
    find_fastest(judged, 0.1, 10.0, grid, trials=trials)
    assert fractions == pytest.approx([0.245, 0.49, 0.735, 0.98])
    fractions.clear()
    trials, highest = TrialShares(lambda _, share: fractions.append(share), "searching", 0.0), 3.0
    find_fastest(judged, 0.1, 10.0, grid, trials=trials)
    assert (
        fractions == sorted(fractions)
        and fractions[1] == pytest.approx(0.49)
        and fractions[-1] <= 0.98
    )
    assert len(fractions) > 20
