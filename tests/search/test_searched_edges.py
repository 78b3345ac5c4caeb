"""The ends of intervals that a search by pace prints: they pass a search for a bad run, too."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from threadline.commands.plan import Plan
from threadline.proof.option_form import Door
from threadline.proof.pipeline import NOMINAL, REPEATED, TOLERANCES, plan_job
from threadline.proof.request import Words
from threadline.search import paced, shaft
from threadline.search.by_pace import answered
from threadline.search.fastest import Fastest, Grid, find_fastest
from threadline.search.paced import Question
from threadline.search.question import question_of
from threadline.search.searched_edges import with_searched_edges
from threadline.verdict import Result, Spec, Status, Verdict
from threadline.verdict.types import OverTolerances, SearchedDays

EXAMPLES = Path(__file__).parents[2] / "examples"
TESTED = OverTolerances(
    searched=9, criterion="contour_error", share=0.99, drawn=2, passed=2, least=0.2
)
DAYS = SearchedDays(searched=3, criterion="contour_error", share=0.5, machines=False)


def verdict(
    measured: float, name: str = "contour_error", days: SearchedDays | None = None
) -> Verdict:
    """Return a verdict on one criterion with a limit of 1, which is near its limit from 0.95 on."""
    failed = measured > 1.0
    result = Result(
        name=name, axis="", measured=measured, limit=1.0, unit="m", typical=measured - 0.02,
        status=Status.FAILED if failed else Status.PASSED, required=True, note="",
    )  # fmt: skip
    return Verdict(results=(result,), simulated=True, runs=20, days=days)


def search(drawn: Callable[[float], float], worst: Callable[[float], float]) -> Fastest:
    found = find_fastest(lambda pace: verdict(drawn(pace)), 1.0, 100.0, Grid(points=24))
    return with_searched_edges(
        found,
        lambda pace: verdict(drawn(pace)),
        lambda pace, _: verdict(worst(pace), "repeatability", DAYS),
    )


def test_an_edge_moves_inwards_to_the_next_pace_that_passes_the_search() -> None:
    """Drawn days allow a pace of 50, the worst day only 40."""
    found = search(lambda pace: pace / 50.0, lambda pace: pace / 40.0)
    assert found.best == pytest.approx(40.0, rel=4e-3)
    assert found.best <= 40.0
    assert found.verdict.passed
    assert found.verdict.days == DAYS
    assert found.limited_by == "repeatability"
    assert found.intervals[0].low == 1.0


def test_an_edge_that_passes_the_search_stays() -> None:
    found = search(lambda pace: pace / 50.0, lambda pace: pace / 60.0)
    assert found.best == pytest.approx(50.0, rel=4e-3)
    assert found.limited_by == "contour_error"
    assert found.verdict.days == DAYS


def test_the_lower_end_moves_upwards_and_an_interval_without_a_pace_is_left_out() -> None:
    """Drawn days allow 10 to 20 and 40 to 60; the worst day allows only 12 to 20."""

    def drawn(pace: float) -> float:
        return 0.9 if 10.0 <= pace <= 20.0 or 40.0 <= pace <= 60.0 else 2.0

    found = search(drawn, lambda pace: 0.9 if 12.0 <= pace <= 30.0 else 1.5)
    (only,) = found.intervals
    assert only.low == pytest.approx(12.0, rel=4e-3)
    assert only.low >= 12.0
    assert only.high == pytest.approx(20.0, rel=4e-3)


def test_a_search_that_no_pace_passes_has_no_answer_and_names_its_criterion() -> None:
    found = search(lambda pace: pace / 50.0, lambda _: 1.5)
    assert found.best is None
    assert not found.verdict.passed
    assert found.limited_by == "repeatability"
    assert found.forbidden[0].name == "repeatability"


@pytest.mark.parametrize(("share", "asked"), [(0.5, 0), (0.9, 1), (None, 1)])
def test_a_bad_machine_is_looked_for_where_the_worst_one_known_is_close_to_a_limit(
    monkeypatch: pytest.MonkeyPatch, share: float | None, asked: int
) -> None:
    """A slow pace takes longest to simulate, and is far from every limit."""
    calls: list[Verdict] = []

    def worst(_plan: Plan, _spec: Spec, before: Verdict, _known: object) -> Verdict:
        calls.append(before)
        return replace(before, days=DAYS)

    monkeypatch.setattr(paced, "with_worst_machine", worst)
    given = Words.of("fastest", Door.PYTHON, LINEAR)
    question = replace(
        question_of(given, EXAMPLES / "x-180.prg", "lathe-winder"), trials=TOLERANCES
    )
    plan = plan_job(question.job, question.machine, question.options)
    far = replace(verdict(0.5), tolerances=replace(TESTED, share=share))
    assert question.searched(plan, far).days == (DAYS if asked else None)
    assert len(calls) == asked


def test_a_job_judged_by_parts_has_its_best_pace_searched_alone() -> None:
    asked: list[float] = []

    def searched(pace: float, _: Verdict) -> Verdict:
        asked.append(pace)
        return verdict(0.5, days=DAYS)

    found = find_fastest(lambda pace: verdict(pace / 50.0), 1.0, 100.0, Grid(points=24))
    once = with_searched_edges(found, lambda pace: verdict(pace / 50.0), searched, best_only=True)
    assert asked == [found.best]
    assert once.tried == found.tried
    assert once.intervals == found.intervals


JOBS = [
    ("x-180.prg", "lathe-winder", "30 mm/s", "60 mm/s"),
    ("stitcher-test-path.seam.toml", "stitcher", "10 stitch/s", "20 stitch/s"),
    ("rosette.dst", "schiffli-frame", "50 stitch/min", "90 stitch/min"),
]
LINEAR = {"interpolation": "linear"}
"""A job by feed, one by needle speed, and one by the speed of a shaft; slowest and fastest pace."""


@pytest.mark.parametrize(("job", "machine", "low", "high"), JOBS)
@pytest.mark.parametrize("level", ["repeated", "over tolerances", "nominal"])
def test_every_search_by_pace_names_only_ends_that_pass_the_search_for_a_bad_run(
    monkeypatch: pytest.MonkeyPatch, job: str, machine: str, low: str, high: str, level: str,
) -> None:  # fmt: skip
    """Stand-ins for the simulations: drawn runs allow every pace, and the worst run only some.

    The stand-ins recognise a plan by its duration, because plans of all kinds have one.
    """
    words = {"low": low, "high": high} | ({} if machine != "lathe-winder" else LINEAR)
    given = Words.of("fastest", Door.PYTHON, words)
    trials = {"repeated": REPEATED, "nominal": NOMINAL, "over tolerances": TOLERANCES}[level]
    question = replace(question_of(given, EXAMPLES / job, machine), trials=trials)
    runs = trials.repeats
    over = TESTED if level == "over tolerances" else None
    durations: list[float] = []

    def judged(_question: Question, plan: Plan, _progress: object = None) -> Verdict:
        durations.append(plan.duration_s)
        return replace(verdict(0.99), runs=runs, tolerances=over)

    def worst(plan: Plan, _spec: Spec, before: Verdict, *_known: object) -> Verdict:
        short = plan.duration_s < 1.2 * min(durations)
        return replace(verdict(1.01 if short else 0.995, "repeatability", DAYS), runs=before.runs)

    def none(_plan: Plan, _spec: Spec, before: Verdict, *_known: object) -> Verdict:
        raise AssertionError("the other search")

    monkeypatch.setattr(Question, "judged", judged)
    monkeypatch.setattr(paced, "with_worst_machine", worst if over else none)
    monkeypatch.setattr(paced, "with_worst_day", none if over else worst)
    monkeypatch.setattr(shaft, "fastest_schedule", lambda _: None)
    found = answered(question)
    best, fastest = found.intervals[0].high, question.high
    assert found.passed and fastest is not None
    if level == "nominal":
        assert best == pytest.approx(fastest)
        assert found.verdict.days is None
    else:
        assert question.low < best < 0.9 * fastest
        assert found.limited_by == "repeatability"
        assert found.verdict.days == DAYS
        assert found.verdict.result("contour_error").measured == 0.99
