"""A day that is looked for is worse than days that are drawn, and counts in the verdict."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from threadline.base.option_defaults import MOST_RUNS
from threadline.machine import load_machine
from threadline.proof.option_form import Door
from threadline.proof.pipeline import Trials, open_job, plan_job, prove_plan
from threadline.proof.request import Words
from threadline.proof.worst_day import with_worst_day
from threadline.verdict import Status

JOB = Path(__file__).resolve().parent.parent / "examples" / "x-180.prg"
FAST = {
    "interpolation": "optimal", "feed": "4.96022 m/s", "feed_forward": True,
    "tolerance": "0.412 mm", "outside": "0.412 mm", "reserve": "volts 0.56 %, current 2.62 %",
    "smoothing": "4.65 ms", "contour": "0.5 mm",
}  # fmt: skip


def test_a_limit_that_all_drawn_days_keep_is_broken_by_one_that_is_looked_for() -> None:
    """The limit lies half-way between the worst of 1200 drawn days and that of the search."""
    machine = load_machine("lathe-winder")
    words = Words.of("prove", Door.PYTHON, FAST)
    options, spec = words.options(JOB), words.spec(machine)
    only = tuple(one for one in spec.criteria if one.name == "contour_error")
    spec = replace(spec, criteria=only)
    plan = plan_job(open_job(JOB, machine, options), machine, options)
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


def test_a_machine_whose_days_are_run_one_by_one_keeps_its_verdict() -> None:
    machine = load_machine("stepper-winder")
    words = Words.of("prove", Door.PYTHON, {})
    options, spec = words.options(JOB), words.spec(machine)
    plan = plan_job(open_job(JOB, machine, options), machine, options)
    verdict = prove_plan(plan, spec).verdict
    assert with_worst_day(plan, spec, verdict) is verdict
