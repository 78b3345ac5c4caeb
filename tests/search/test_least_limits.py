"""A smaller share of the limits can finish the job sooner, and the search must find it."""

from __future__ import annotations

from dataclasses import replace
from math import degrees, log2
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from threadline.jobs import read_job
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import load_machine
from threadline.proof.option_words import parse_share, share_words
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, prove_plan
from threadline.search import fastest_job, least_limits
from threadline.search.allowance import FastestJob
from threadline.search.fastest import Fastest
from threadline.search.feed import feed_range_m_s
from threadline.search.feed_ranges import Interval
from threadline.search.paced import Question
from threadline.verdict import Verdict, load_spec


@pytest.mark.usefixtures("coarse_scan")
def test_part_of_the_limits_beats_all_of_them(examples: Path) -> None:
    """On the reversal test the full limits are in spec only at a crawl."""
    machine = load_machine("lathe-winder")
    job = read_job(examples / "x-180.prg", machine)
    spec = load_spec(None, machine)
    result = fastest_job(
        Question(job=job, machine=machine, spec=spec, options=Options(), low=0.05, high=0.5)
    )
    all_limits = next(candidate for candidate in result.candidates if candidate.share == 1.0)

    assert result.best.share < 1.0
    assert result.best.duration_s is not None
    # 360 mm; with the full limits the job crawls, if it is in spec at all.
    assert result.best.duration_s < 1.2
    assert all_limits.duration_s is None or all_limits.duration_s > 1.5 * result.best.duration_s
    assert result.best.duration_s == min(r.duration_s for r in result.candidates if r.duration_s)
    # The ladder halves the share; near its best share the search has steps of the fourth root of 2.
    assert {1.0, 0.5, 0.25, 0.125, 0.0625, 0.03125} < {
        candidate.share for candidate in result.candidates
    }
    # The duration belongs to the found feed and share.
    chosen = Options(
        feed=Feed(FeedMode.FASTEST_AXIS, result.best.found.best), limit_share=result.best.share
    )
    again = plan_job(job, machine, chosen)
    assert again.duration_s == result.best.duration_s
    assert prove_plan(again, spec).verdict.passed


def shares_where_the_best_is(monkeypatch: pytest.MonkeyPatch, wanted: float) -> FastestJob:
    """Search the shares of the limits of jobs that take longer the farther they are from one."""

    def found(_asked: Question, *_: object) -> Fastest:
        return Fastest(
            intervals=(Interval(low=1.0, high=1.0),),
            limited_by="range",
            verdict=Verdict(results=(), simulated=True),
            tried=1,
        )

    def planned(_asked: Question, share: float, _feed: float) -> SimpleNamespace:
        return SimpleNamespace(duration_s=1.0 + abs(log2(share / wanted)))

    monkeypatch.setattr(least_limits, "fastest_feed", found)
    monkeypatch.setattr(least_limits, "planned_at", planned)
    monkeypatch.setattr(least_limits, "ignores_limits", lambda *_: False)
    machine = load_machine("lathe-winder")
    job = read_job(Path(__file__).parents[2] / "examples" / "x-180.prg", machine)
    return fastest_job(
        Question(job=job, machine=machine, spec=load_spec(None, machine), options=Options())
    )


def test_shares_of_the_limits_are_read_as_they_are_printed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Steps of the fourth root of 2 have sixteen digits; the tried shares have six decimals."""
    found = shares_where_the_best_is(monkeypatch, 0.19)
    candidates = [one.share for one in found.candidates]
    assert len(candidates) > 6
    for share in (*candidates, *np.random.default_rng(5).uniform(0.01, 1.0, 300).round(6).tolist()):
        assert parse_share(share_words(share)) == share
        assert len(share_words(share)) <= len("18.1234 %")
    assert parse_share(share_words(0.1 + 0.2)) == 0.1 + 0.2


def test_the_range_of_feeds_is_a_count_a_tick_to_the_velocity_limit() -> None:
    """At 100 mm, A is the coarsest axis, with 35.18159 counts a degree, and the fastest.

    Six digits of each end can be typed, and lie within the range.
    """
    machine = load_machine("lathe-winder")
    low, high = feed_range_m_s(machine)
    slowest, fastest = 0.1 / degrees(35.18159) / 0.005, 0.1 * machine.axes["A"].velocity.si
    assert slowest <= low * (1.0 + 1e-7) <= slowest * (1.0 + 1e-5)
    assert fastest * (1.0 - 1e-5) <= high <= fastest
    assert (low, high) == (float(f"{low:.6g}"), float(f"{high:.6g}"))
    assert high > machine.axes["X"].velocity.si == machine.axes["Y"].velocity.si


@pytest.mark.long(shown_by="test_part_of_the_limits_beats_all_of_them")
def test_historical_interpolations_are_searched_by_feed_alone(examples: Path) -> None:
    machine = load_machine("lathe-winder")
    job = read_job(examples / "x-180.prg", machine)
    spec = load_spec(None, machine)
    options = Options(interpolation="linear")
    result = fastest_job(
        Question(job=job, machine=machine, spec=spec, options=options, low=0.03, high=0.05)
    )

    assert [candidate.share for candidate in result.candidates] == [1.0]
    # The 1994 controller: 100 mm/s linear over an unprinted path; 0.5 mm of turning point at
    # 38 mm/s on the facts sheet's reversal test (0.47 mm at 36 mm/s, in proportion).
    best = result.best.found.best
    assert best is not None
    assert 0.036 < best < 0.040
    # Moves take whole ticks: 131 ticks for each are in spec, and 132 and 134 are not, so a search
    # that stops at the first failing feed misses 131.
    in_131_ticks = Feed(FeedMode.FASTEST_AXIS, 25.716e-3 / (131 * 5e-3) * 1.00001)
    plan = plan_job(job, machine, replace(options, feed=in_131_ticks))
    assert prove_plan(plan, spec).verdict.passed
    assert best >= in_131_ticks.value
    assert len(result.best.found.intervals) == 3


@pytest.mark.parametrize(("expected", "tried_share"), [(-0.25, 1.0), (-0.75, 0.5)])
def test_the_ladder_is_left_to_either_side(
    monkeypatch: pytest.MonkeyPatch, expected: float, tried_share: float
) -> None:
    """The best share is a quarter of a step below or above the ladder's best, but at most 1."""
    result = shares_where_the_best_is(monkeypatch, 2.0**expected)
    tried = [one.share for one in result.candidates]
    assert max(tried) == 1.0
    assert tried_share in tried
    assert result.best.share == round(2.0**expected, 6)
    # After the best share the search ends: two shares between, or one if the way up finds it.
    between = sorted({share for share in tried if 0.5 < share < 1.0})
    assert between[0] == pytest.approx(2.0 ** (-0.5 if expected > -0.5 else -0.75), abs=1e-5)
