"""A searched day is worse than drawn days, and counts in the verdict."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from threadline.base.arrays import FloatArray
from threadline.base.option_defaults import MOST_RUNS
from threadline.commands.plan import Plan
from threadline.machine import load_machine
from threadline.proof.option_form import Door, Word
from threadline.proof.pipeline import (
    REPEATED,
    TOLERANCES,
    Trials,
    open_job,
    plan_job,
    prove_plan,
)
from threadline.proof.request import Words
from threadline.proof.worst_day import LEFT_FREE, with_worst_day, with_worst_machine
from threadline.verdict import Spec, Status, closing

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
JOB = EXAMPLES / "x-180.prg"
SHORT = {"interpolation": "optimal", "feed": "1000 count/tick", "limits": "13.3 %"}
FAST = {
    "interpolation": "optimal", "feed": "4.96022 m/s", "feed_forward": True,
    "tolerance": "0.412 mm", "outside": "0.412 mm", "reserve": "volts 0.56 %, current 2.62 %",
    "smoothing": "4.65 ms", "contour": "0.5 mm",
}  # fmt: skip


def planned(machine: str, job: Path, given: dict[str, Word]) -> tuple[Plan, Spec]:
    """Return the plan of a job with the options of ``prove``, and its specification."""
    known, words = load_machine(machine), Words.of("prove", Door.PYTHON, given)
    options = words.options(job)
    return plan_job(open_job(job, known, options), known, options), words.spec(known)


def test_a_limit_that_all_drawn_days_keep_is_broken_by_one_that_is_looked_for() -> None:
    """The limit lies half-way between the worst of 1200 drawn days and the worst searched day."""
    plan, spec = planned("lathe-winder", JOB, FAST)
    only = tuple(one for one in spec.criteria if one.name == "contour_error")
    spec = replace(spec, criteria=only)
    drawn = prove_plan(plan, spec, None, Trials(repeats=MOST_RUNS)).verdict.result("contour_error")
    first = with_worst_day(plan, spec, prove_plan(plan, spec).verdict).result("contour_error")
    assert drawn.measured is not None and first.measured is not None
    assert first.measured > drawn.measured
    between = 0.5 * (drawn.measured + first.measured)
    narrow = replace(spec, criteria=(replace(only[0], limit=between),))
    verdict = prove_plan(plan, narrow, None, Trials(repeats=MOST_RUNS)).verdict
    assert verdict.passed
    searched = with_worst_day(plan, narrow, verdict)
    broken = searched.result("contour_error")
    assert broken.status is Status.FAILED
    assert broken.measured == pytest.approx(first.measured, rel=1e-9)
    assert "the worst day of a search" in broken.note
    assert broken.job_line is not None


@pytest.mark.parametrize(
    ("machine", "job", "given", "criterion"),
    [
        ("stepper-winder", "x-180.prg", {}, "contour_error"),
        ("schiffli-frame", "rosette.dst", {"feed": "60 stitch/min"}, "stitch_residual"),
    ],
)
def test_a_machine_whose_days_are_run_one_by_one_has_few_of_them_searched(
    machine: str, job: str, given: dict[str, Word], criterion: str
) -> None:
    """Friction, supply, damping and encoders go to the ends of their ranges; drawn ones do not.

    The limit lies half-way between the worst of 20 drawn days and the worst searched day.
    """
    plan, spec = planned(machine, EXAMPLES / job, given)
    spec = replace(spec, criteria=tuple(one for one in spec.criteria if one.name == criterion))
    verdict = prove_plan(plan, spec, trials=REPEATED).verdict
    searched = with_worst_day(plan, spec, verdict)
    drawn, worst = verdict.result(criterion), searched.result(criterion)
    assert searched.days is not None and searched.days.searched < 50
    assert drawn.measured is not None and worst.measured is not None
    assert worst.measured > drawn.measured
    assert searched.days.share == pytest.approx(worst.measured / (worst.limit or 0.0))
    between = 0.5 * (drawn.measured + worst.measured)
    narrow = replace(spec, criteria=tuple(replace(one, limit=between) for one in spec.criteria))
    verdict = prove_plan(plan, narrow, trials=REPEATED).verdict
    assert verdict.passed
    assert not with_worst_day(plan, narrow, verdict).passed


def test_scans_and_cylinders_of_an_on_off_machine_are_searched_one_by_one() -> None:
    plan, spec = planned("letter-placer", EXAMPLES / "letter-cycle.toml", {"shaper": "um-zvd"})
    verdict = prove_plan(plan, spec, trials=REPEATED).verdict
    days = with_worst_day(plan, spec, verdict).days
    assert days is not None
    assert days.criterion.startswith("residual_vibration")
    assert days.searched < 50
    tightest = verdict.tightest
    assert tightest is not None and tightest.measured is not None
    assert days.share == pytest.approx(tightest.measured / (tightest.limit or 0.0), rel=0.05)


def test_a_machine_and_its_day_are_searched_together() -> None:
    """The search over the tolerances passes this plan; machines near its worst one fail.

    A worst machine that leaves less than half a percent free does not pass, either: for that the
    limit is set just above the worst.
    """
    plan, spec = planned("lathe-winder", JOB, SHORT)
    known: list[FloatArray] = []
    verdict = prove_plan(plan, spec, trials=TOLERANCES, suspects=known).verdict
    assert verdict.passed and verdict.tolerances is not None
    found = with_worst_machine(plan, spec, verdict, known)
    assert found.days is not None and found.days.machines
    assert found.days.share is not None and verdict.tolerances.share is not None
    assert found.days.share > verdict.tolerances.share
    assert not found.passed
    broken = found.result("contour_error")
    assert broken.status is Status.FAILED
    assert "the worst machine and day of a search" in broken.note
    assert "machines and days of a search uses" in closing(found)
    worst = found.days.share
    for room, passes in ((0.5 * LEFT_FREE, False), (2.0 * LEFT_FREE, True)):
        wide = replace(
            spec,
            criteria=tuple(
                replace(one, limit=one.limit * worst / (1.0 - room))
                if one.name == "contour_error" and one.limit
                else one
                for one in spec.criteria
                if one.name == "contour_error"
            ),
        )
        drawn = prove_plan(plan, wide, trials=REPEATED).verdict
        assert drawn.passed
        assert with_worst_machine(plan, wide, drawn, known).passed is passes, room


def test_windings_and_machines_run_one_by_one_have_no_search_of_machine_and_day() -> None:
    plan, spec = planned("stepper-winder", JOB, {})
    verdict = prove_plan(plan, spec).verdict
    assert with_worst_machine(plan, spec, verdict, []) is verdict
