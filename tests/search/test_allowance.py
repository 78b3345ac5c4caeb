"""``optimal`` is planned, not searched for: a few proofs, and how far it is from its bounds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.options import options_of
from threadline.pipeline import REPEATED, plan_job, prove_plan
from threadline.search import FastestJob, fastest_job
from threadline.search.allowance import ALLOWED, options_at
from threadline.verdict import load_spec

EXAMPLES = Path(__file__).parents[2] / "examples"
OPTIMAL = options_of("optimal", None, "0.1 mm")


@pytest.fixture(scope="module")
def found() -> FastestJob:
    machine = load_machine("lathe-winder")
    job = read_job(EXAMPLES / "x-180.prg", machine)
    return fastest_job(job, machine, load_spec(None, machine), OPTIMAL, trials=REPEATED)


def test_few_proofs_find_where_more_would_fail(found: FastestJob) -> None:
    """What passes and what fails are within 3 %, and the default of 0.3 mm is not the answer."""
    best = found.best
    failed = [r.contour_m for r in found.rungs if r.duration_s is None and r.contour_m is not None]

    assert len(found.rungs) <= 8
    assert best.contour_m is not None
    assert best.contour_m > 3e-4
    assert min(failed) <= 1.031 * best.contour_m
    assert best.found.limited_by == "contour_error"
    # 0.855 s is what a search over feeds and shares of the limits finds with ``auto``.
    assert best.duration_s is not None
    assert best.duration_s < 0.81


def test_the_answer_is_a_plan_that_can_be_made_again(found: FastestJob, examples: Path) -> None:
    machine = load_machine("lathe-winder")
    job = read_job(examples / "x-180.prg", machine)
    plan = plan_job(job, machine, options_at(machine, OPTIMAL, found.best))

    assert plan.duration_s == found.best.duration_s
    assert prove_plan(plan, load_spec(None, machine), trials=REPEATED).verdict.passed


def test_bounds_are_below_and_in_order(found: FastestJob) -> None:
    """180 mm from rest to rest at 10.5 m/s^2: twice the root of 0.18 / 10.5 s there, and back.

    That is without any jerk limit; the least time within limits alone must lie above it, and
    every further limit makes it longer.
    """
    own, driven = found.bounds
    assert (own.within, driven.within) == ("the axes", "axes and drives")
    assert 2.0 * 2.0 * (0.18 / 10.5) ** 0.5 < own.duration_s < driven.duration_s
    assert found.best.duration_s is not None
    assert driven.duration_s < found.best.duration_s


def test_an_allowance_that_is_given_is_the_only_one_that_is_proved(examples: Path) -> None:
    machine = load_machine("lathe-winder")
    job = read_job(examples / "x-180.prg", machine)
    given = replace(OPTIMAL, contour_m=2e-4)
    result = fastest_job(job, machine, load_spec(None, machine), given)

    assert [rung.contour_m for rung in result.rungs] == [2e-4]
    assert result.best.found.limited_by == ALLOWED


def test_loads_that_follow_use_a_share_of_the_limits(examples: Path) -> None:
    """The least time within axes and drives, and what smoothing over 10 ms adds to it."""
    machine = load_machine("lathe-winder")
    job = read_job(examples / "cone-dome-cylinder.prg", machine)
    options = options_of("optimal", None, "0.1 mm", feed_forward=True)
    result = fastest_job(job, machine, load_spec(None, machine), options, trials=REPEATED)

    assert result.best.duration_s is not None
    assert result.best.duration_s < 8.5
    assert all(rung.share > result.best.share for rung in result.rungs if rung.duration_s is None)
