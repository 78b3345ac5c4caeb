"""The search for the contour allowance of ``optimal``: few proofs, and its distance from bounds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from threadline.commands.plan import Plan
from threadline.jobs import Job, read_job
from threadline.machine import Machine, load_machine
from threadline.proof.options import Options, options_of
from threadline.proof.pipeline import REPEATED, Trials, plan_job, prove_plan
from threadline.search import FastestJob, allowance, fastest_job, paced
from threadline.search.allowance import ALLOWED, options_at
from threadline.search.paced import Question
from threadline.verdict import Result, Spec, Status, Verdict, load_spec

EXAMPLES = Path(__file__).parents[2] / "examples"
OPTIMAL = options_of("optimal", None, "0.1 mm")


@pytest.fixture(scope="module")
def found() -> FastestJob:
    machine = load_machine("lathe-winder")
    job = read_job(EXAMPLES / "x-180.prg", machine)
    return fastest_job(
        Question(
            job=job,
            machine=machine,
            spec=load_spec(None, machine),
            options=OPTIMAL,
            trials=REPEATED,
        )
    )


@pytest.mark.long(shown_by="test_a_plan_whose_neighbour_fails_is_not_the_answer")
def test_few_proofs_find_where_more_would_fail(found: FastestJob) -> None:
    """Passing and failing allowance are within 3 %, and the default of 0.3 mm is not the answer."""
    best = found.best
    failed = [
        r.contour_m for r in found.candidates if r.duration_s is None and r.contour_m is not None
    ]

    assert len(found.candidates) <= 8
    assert best.contour_m is not None
    assert best.contour_m > 3e-4
    assert min(failed) <= 1.031 * best.contour_m
    assert best.found.limited_by == "contour_error"
    # With ``auto``, a search over feeds and shares of the limits finds 0.855 s.
    assert best.duration_s is not None
    assert best.duration_s < 0.81


@pytest.mark.long(shown_by="test_an_allowance_that_is_given_is_the_only_one_that_is_proved")
def test_the_answer_is_a_plan_that_can_be_made_again(found: FastestJob, examples: Path) -> None:
    machine = load_machine("lathe-winder")
    job = read_job(examples / "x-180.prg", machine)
    spec = load_spec(None, machine)
    asked = Question(job=job, machine=machine, spec=spec, options=OPTIMAL)
    plan = plan_job(job, machine, options_at(asked, found.best))

    assert plan.duration_s == found.best.duration_s
    assert prove_plan(plan, spec, trials=REPEATED).verdict.passed


@pytest.mark.long(shown_by="test_an_allowance_that_is_given_is_the_only_one_that_is_proved")
def test_bounds_are_below_and_in_order(found: FastestJob) -> None:
    """180 mm from rest to rest at 10.5 m/s^2 take twice the root of 0.18 / 10.5 s, and as long
    back.

    This time has no jerk limit. The least time within the limits alone must lie above it, and every
    further limit makes it longer.
    """
    own, driven = found.bounds
    assert (own.within, driven.within) == ("the axes", "axes and drives")
    assert 2.0 * 2.0 * (0.18 / 10.5) ** 0.5 < own.duration_s < driven.duration_s
    assert found.best.duration_s is not None
    assert driven.duration_s < found.best.duration_s


def test_a_plan_whose_neighbour_fails_is_not_the_answer(
    monkeypatch: pytest.MonkeyPatch, examples: Path
) -> None:
    """If the plan half a percent below 0.41 mm fails, a slower plan is the answer.

    Near a limit this happens by chance. The twin passes both plans here, so a stand-in for the
    judge fails every allowance between 0.402 and 0.409 mm.
    """
    machine = load_machine("lathe-winder")
    job = read_job(examples / "x-180.prg", machine)
    tried: list[float] = []

    def chancy(
        plan: Plan, spec: Spec, trials: Trials, actual: Machine | None, *_: object, **__: object
    ) -> SimpleNamespace:
        allowed = tried[-1]
        good = allowed <= 0.402e-3 or 0.409e-3 <= allowed <= 0.411e-3
        status = Status.PASSED if good else Status.FAILED
        result = Result(
            name="contour_error",
            axis="",
            # From 0.3 mm the search goes on at 0.41 mm, because it aims at 97 % of the limit.
            measured=(0.45e-3 if allowed > 0.3e-3 else 0.97 * 0.5e-3 * 0.3 / 0.41)
            if good
            else 0.51e-3,
            limit=0.5e-3,
            unit="m",
            status=status,
        )
        return SimpleNamespace(verdict=Verdict(results=(result,), simulated=True))

    def planned(job: Job, machine: Machine, options: Options) -> SimpleNamespace:
        tried.append(options.contour_m or 0.3e-3)
        return SimpleNamespace(duration_s=1e-3 / tried[-1])

    monkeypatch.setattr(allowance, "plan_job", planned)
    monkeypatch.setattr(paced, "try_plan", chancy)
    monkeypatch.setattr(allowance, "bounds_of", lambda *_: ())
    result = allowance.fastest_allowed(
        Question(job=job, machine=machine, spec=load_spec(None, machine), options=OPTIMAL)
    )

    assert [r.contour_m for r in result.candidates if r.isolated] == [0.41e-3]
    assert result.best.contour_m == 0.3e-3
    assert tried[-2:] == [pytest.approx(0.40795e-3), pytest.approx(0.2985e-3)]
    assert all(allowed == float(f"{allowed:.5g}") for allowed in tried)


def test_an_allowance_that_is_given_is_the_only_one_that_is_proved(examples: Path) -> None:
    machine = load_machine("lathe-winder")
    job = read_job(examples / "x-180.prg", machine)
    given = replace(OPTIMAL, contour_m=2e-4)
    result = fastest_job(
        Question(job=job, machine=machine, spec=load_spec(None, machine), options=given)
    )

    assert [candidate.contour_m for candidate in result.candidates] == [2e-4]
    assert result.best.found.limited_by == ALLOWED


@pytest.mark.long(shown_by="test_an_allowance_that_is_given_is_the_only_one_that_is_proved")
def test_loads_that_follow_use_a_share_of_the_limits(examples: Path) -> None:
    """The answer lies near the least time within axes and drives plus the smoothing of 10 ms."""
    machine = load_machine("lathe-winder")
    job = read_job(examples / "cone-dome-cylinder.prg", machine)
    options = options_of("optimal", None, "0.1 mm", feed_forward=True)
    result = fastest_job(
        Question(
            job=job,
            machine=machine,
            spec=load_spec(None, machine),
            options=options,
            trials=REPEATED,
        )
    )

    assert result.best.duration_s is not None
    assert result.best.duration_s < 8.5
    assert all(
        candidate.share > result.best.share
        for candidate in result.candidates
        if candidate.duration_s is None
    )
