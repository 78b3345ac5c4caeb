"""The search over all choices of a plan: on made-up loops with a known answer, and on real ones."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.cli.fastest_optimal import OptimalOutput
from threadline.commands.plan import Plan
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import load_machine
from threadline.proof.option_form import Door
from threadline.proof.option_words import share_words
from threadline.proof.options import Options, describe, options_from, options_of
from threadline.proof.pipeline import NOMINAL, open_job
from threadline.proof.request import Words
from threadline.search import by_pace, chosen_plans
from threadline.search.allowance import Candidate, FastestJob
from threadline.search.by_pace import answered, optimal_words
from threadline.search.choices import (
    CHOSEN,
    Tried,
    best_of,
    boldest,
    chosen,
    improved,
    knobs_of,
    narrowed,
    places_of,
)
from threadline.search.deadline import Deadline
from threadline.search.fastest import Fastest
from threadline.search.least_times import least_on_any_path, shortened_way
from threadline.search.paced import Effort, Question, searching_with
from threadline.search.question import question_of
from threadline.verdict import Result, Status, Verdict, load_spec
from threadline.verdict.contour import POINT_MISSED

EXAMPLES = Path(__file__).parents[2] / "examples"
TICK_S = 0.005


def made_up(places: tuple[float, ...], below_s: float) -> Tried:
    """A made-up plan: each choice saves time, the errors add up, and some plans have luck.

    Four choices save 0.4, 0.3, 0.2 and 0.1 s, and the first two cost the most error. The error also
    jumps up and down from place to place, like the instants at which a DAC steps.
    """
    saved = np.array(places) @ [0.4, 0.3, 0.2, 0.1]
    duration_s = TICK_S * math.ceil((2.0 - saved) / TICK_S - 1e-9)
    luck = 0.03 * math.sin(1e3 * sum((k + 1) * place for k, place in enumerate(places)))
    error = 0.5 + float((np.array(places) ** 2) @ [0.5, 0.3, 0.15, 0.05]) + luck
    judged = duration_s < below_s
    used = {"contour_error": error, "dac_saturation": 1.1 if places[0] > 0.9 else 0.9}
    passed = judged and max(used.values()) <= 1.0
    return Tried(places=places, duration_s=duration_s, used=used if judged else {}, passed=passed)


def test_a_search_by_what_was_tried_comes_close_to_what_can_be_had() -> None:
    """The reference is the best place of a fine grid, half of which is out of specification."""
    careful, bold = (0.0,) * 4, (0.9,) * 4
    tried = boldest(made_up, careful, bold, 6)
    assert [one.passed for one in tried] == [False] * (len(tried) - 1) + [True]
    first_s = best_of(tried).duration_s
    improved(made_up, tried, 80, TICK_S, careful)

    steps = np.linspace(0.0, 1.0, 13)
    every = [
        made_up(tuple(map(float, (a, b, c, d))), math.inf)
        for a in steps for b in steps for c in steps for d in steps
    ]  # fmt: skip
    reference_s = best_of(every).duration_s
    found = best_of(tried)
    assert found.duration_s < first_s - 4 * TICK_S
    assert found.duration_s <= reference_s + 2.5 * TICK_S
    assert made_up(found.places, math.inf).passed


def test_the_values_of_choices_are_typed_and_read_back() -> None:
    """The tried options can be typed, and a recording reads them back to the last bit."""
    machine = load_machine("lathe-winder")
    options = replace(
        options_of("optimal", None, "0.1 mm", feed_forward=True),
        feed=Feed(FeedMode.FASTEST_AXIS, 1.0),
    )
    spec, free = load_spec(None, machine), frozenset(CHOSEN)
    assert "limits" not in {knob.word for knob in knobs_of(machine, spec, options, free)}
    knobs = knobs_of(machine, spec, options, free, limits_too=True)
    job = open_job(EXAMPLES / "x-180.prg", machine, options)
    assert {knob.word for knob in knobs} == {
        "tolerance", "outside", "contour", "volts", "current", "smoothing", "limits",
    }  # fmt: skip
    random = np.random.default_rng(5)
    for _ in range(50):
        places = tuple(random.uniform(size=len(knobs)).tolist())
        one = chosen(options, knobs, places, {13: 0.9123})
        assert one.outside_m <= one.tolerance_m <= 5e-4
        assert options_from(describe(job, machine, one)) == one
        assert options_of("optimal", **optimal_words(one)) == one
        again = places_of(one, knobs, machine)
        assert np.allclose(places, again, atol=0.01)


LINES = [0, 5, 7, 13]


def missed(
    line: int | None, share: float, name: str = "contour_error", note: str = POINT_MISSED
) -> Verdict:
    result = Result(
        name=name, axis="", measured=5e-4 * share, limit=5e-4, unit="m",
        status=Status.FAILED if share > 1.0 else Status.PASSED,
        job_line=line, note=note, time_s=1.0,
    )  # fmt: skip
    return Verdict(results=(result,), simulated=True)


def test_a_corner_that_alone_is_missed_gets_a_smaller_tolerance() -> None:
    options = Options(interpolation="optimal", tolerance_m=4e-4)
    once = narrowed(options, missed(13, 1.02), LINES, 9.0)
    assert once is not None
    ((line, width_m),) = once.narrow
    assert line == 13
    assert width_m == pytest.approx(4e-4 - 0.03 * 5e-4)
    twice = narrowed(once, missed(7, 1.01), LINES, 9.0)
    assert twice is not None
    assert [line for line, _ in twice.narrow] == [7, 13]
    ended = narrowed(
        replace(options, feed_forward_s=0.01, contour_m=4e-4), missed(13, 1.02), LINES, 0.9
    )
    assert ended is not None
    assert not ended.narrow
    assert ended.contour_m == pytest.approx(4e-4 - 0.03 * 5e-4)
    beside = narrowed(options, missed(13, 1.02, note=""), LINES, 9.0)
    assert beside is not None
    assert [line for line, _ in beside.narrow] == [7, 13]
    assert narrowed(options, missed(13, 1.3), LINES, 9.0) is None
    assert narrowed(options, missed(None, 1.02), LINES, 9.0) is None
    assert narrowed(options, missed(13, 1.02, "repeatability"), LINES, 9.0) is None


def test_an_axis_turns_back_where_it_may() -> None:
    """To 100 mm, back by a millimetre that may be left out, on to 120 mm, and back to 0 mm."""
    places = np.array([0.0, 100.0, 99.0, 120.0, 60.0, 0.0])
    way = shortened_way(places, np.zeros(6, dtype=np.int64), 1.0)
    assert way.tolist() == [0.0, 119.0, 1.0]
    rests = np.array([0, 1, 0, 0, 0, 0])
    assert shortened_way(places, rests, 1.0).tolist() == [0.0, 99.0, 119.0, 1.0]


def test_a_way_to_and_fro_is_bound_by_what_its_drive_gives() -> None:
    """180 mm there and back: within the current alone, half of it takes 1.1 times as long.

    With 10.5 m/s2 the way takes 2 * 2 * (0.18 / 10.5) ** 0.5 s; the motor gives 9.4 m/s2 at rest.
    """
    machine = load_machine("lathe-winder")
    options = replace(options_of("optimal", None, "0.1 mm"), feed=Feed(FeedMode.FASTEST_AXIS, 4.9))
    job = open_job(EXAMPLES / "x-180.prg", machine, options)
    (bound,) = least_on_any_path(job, machine, options, 5e-4)
    shorter = 4.0 * ((0.18 - 5e-4) / 10.5) ** 0.5
    assert shorter < bound.duration_s < 0.71


@pytest.fixture
def few() -> Iterator[None]:
    """Let the search try four plans."""
    with searching_with(Effort(steps=3, least_plans=3, most_plans=3)):
        yield


@pytest.mark.usefixtures("few")
def test_a_few_plans_are_faster_than_any_with_the_options_by_default() -> None:
    """With default options a plan takes 0.805 s without feed-forward and 0.78 s with it.

    Given options stay: only the reserve is searched, and the tolerance stays as given.
    """
    words = {"interpolation": "optimal", "tolerance": "0.1 mm", "outside": "0 mm"}
    given = Words.of("fastest", Door.PYTHON, words)
    found = answered(question_of(given, EXAMPLES / "x-180.prg", "lathe-winder"))
    assert found.duration_s is not None
    assert found.duration_s < 0.75
    assert found.again is not None
    assert found.again["feed_forward"] is True
    assert {candidate.options.tolerance_m for candidate in found.of.candidates} == {1e-4}
    durations = [candidate.duration_s for candidate in found.of.candidates if candidate.duration_s]
    assert durations == sorted(durations, reverse=True)
    assert found.plan().duration_s == found.duration_s


@pytest.mark.usefixtures("few")
def test_a_share_of_the_limits_is_tried_where_no_plan_of_them_all_passes() -> None:
    """X may reach 10.5 m/s2, and the specification limits 8 m/s2: at most 76 % of it passes."""
    words = {"interpolation": "optimal", "tolerance": "0.1 mm", "outside": "0 mm"}
    given = Words.of("fastest", Door.PYTHON, words)
    asked = question_of(given, EXAMPLES / "x-180.prg", "lathe-winder")
    criteria = tuple(
        replace(one, limit=8.0) if one.name == "acceleration" else one
        for one in asked.spec.criteria
    )
    spec, shares = replace(asked.spec, criteria=criteria), list[float]()
    reported = replace(asked, progress=lambda _, share: shares.append(share))
    found = answered(replace(reported, spec=spec, trials=NOMINAL))
    assert shares == sorted(shares)
    assert len(shares) > 4
    assert found.duration_s is not None and found.again is not None
    assert found.again["feed_forward"] is True
    passed = {
        candidate.share for candidate in found.of.candidates if candidate.duration_s is not None
    }
    assert 0.5 < max(passed) <= 8.0 / 10.5


@pytest.mark.usefixtures("few")
def test_share_of_the_limits_is_searched_if_no_plan_at_full_limits_passes(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Over the tolerances the loops may be too far off for every plan with the full limits.

    Stand-ins for the loops have an error that is three times too large at the full limits, and in
    proportion to the acceleration.
    """

    def judged(_: Question, plan: Plan) -> Verdict:
        share = options_from(dict(plan.options)).limit_share
        return missed(5, 3.0 * share, "progress_error")

    monkeypatch.setattr(Question, "judged", judged)
    words = {"interpolation": "optimal", "tolerance": "0.1 mm", "outside": "0 mm"}
    found = answered(
        question_of(Words.of("fastest", Door.PYTHON, words), EXAMPLES / "x-180.prg", "lathe-winder")
    )
    shares = [candidate.share for candidate in found.of.candidates]
    assert found.duration_s is not None
    assert found.again is not None
    assert shares[0] == 1.0
    assert 0.05 <= found.of.best.share <= 1.0 / 3.0
    assert found.again["limits"] == share_words(found.of.best.share)
    OptimalOutput(found, "x-180").show(None, None)
    said = capsys.readouterr().out
    assert "limits used" in " ".join(said.split())
    assert f" {found.again['limits']} " in said
    assert found.plan().duration_s == found.duration_s


def test_a_search_without_a_plan_in_spec_names_what_the_nearest_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    verdict = missed(None, 3.0)
    found = Fastest(intervals=(), limited_by="contour_error", verdict=verdict, tried=1)
    nearest = Candidate(share=1.0, found=found, duration_s=None)
    monkeypatch.setattr(
        by_pace, "fastest_job", lambda _: FastestJob(best=nearest, candidates=(nearest, nearest))
    )
    given = Words.of("fastest", Door.PYTHON, {"interpolation": "optimal"})
    answer = answered(question_of(given, EXAMPLES / "x-180.prg", "lathe-winder"))
    OptimalOutput(answer, "x-180").show(None, None)
    line = "no plan is in spec (2 proved): the nearest fails contour_error"
    assert line in capsys.readouterr().out.splitlines()


@pytest.mark.long(shown_by="test_a_search_by_what_was_tried_comes_close_to_what_can_be_had")
@pytest.mark.usefixtures("few")
def test_a_search_ends_in_a_reasonable_time_and_says_what_it_left(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With a deadline of its own it searches until then."""
    monkeypatch.setattr(chosen_plans, "PROCESSOR_S", 6e-5)
    words = {"interpolation": "optimal", "tolerance": "0.1 mm", "outside": "0 mm"}
    asked = question_of(
        Words.of("fastest", Door.PYTHON, words), EXAMPLES / "x-180.prg", "lathe-winder"
    )
    shares: list[float] = []
    until = Deadline()
    found = answered(replace(asked, until=until, progress=lambda _, share: shares.append(share)))
    assert found.duration_s is not None
    assert found.of.left == 3
    assert until.ended == "after 1e-06 min of processor time"
    assert shares == sorted(shares)

    whole = answered(replace(asked, until=Deadline.within(600.0)))
    assert whole.of.left == 0
    assert len(whole.of.candidates) > len(found.of.candidates)
