"""Errors of loads as rows of the timing: their slopes, and the time that they save."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tools.x_180_bound import STEPS, comes

from threadline.jobs import read_job
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import load_machine
from threadline.motion.timing.optimal import following_error
from threadline.motion.timing.optimal import following_error as polished
from threadline.motion.timing.optimal.fastest_motion import fastest_blocks
from threadline.motion.timing.optimal.followers import Past
from threadline.motion.timing.optimal.following_error import stray_rows
from threadline.motion.timing.optimal.in_time import in_time
from threadline.motion.timing.optimal.solve import Problem
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, prove_plan
from threadline.verdict import load_spec

WINDER = load_machine("lathe-winder")
JOB = "examples/x-180.prg"
FEED = Feed(FeedMode.FASTEST_AXIS, 5.0)


def planned(contour_m):
    options = Options(interpolation="optimal", feed=FEED, contour_m=contour_m)
    return plan_job(read_job(JOB, WINDER), WINDER, options)


def test_rows_are_the_slopes_of_what_the_loads_stray(monkeypatch):
    """Each coefficient of a motion in turn is raised by a ten-thousandth.

    The error of the loads about the place of the row is then computed anew. A fifth of a slope is
    allowed for the times of elements, which a row takes from three values of each, and for the
    steps of place and tick.
    """
    caught = {}

    def kept(problem, block, limits, follower, past):
        caught.update(problem=problem, limits=limits, follower=follower)
        return block

    monkeypatch.setattr(following_error, "polished", kept)
    plan = planned(3e-4)
    list(fastest_blocks(plan.intent.path, WINDER, 3e-4))
    problem, limits, follower = caught["problem"], caught["limits"], caught["follower"]
    assert isinstance(problem, Problem)
    past = Past(follower.memory_s)

    def strays_of(b):
        solution = replace(problem.solution(), b=b)
        block = in_time(solution, replace(limits, velocity=limits.velocity * 9.0), 0.0)
        return solution, block, follower.strays(past, block)

    b = problem.b.copy()
    solution, block, strays = strays_of(b)
    chosen = np.flatnonzero(strays.share > 0.9)[:1]
    rows = stray_rows(solution, block, strays, chosen)
    largest = np.abs(rows.weights * b).max()
    assert largest > 0.01
    for k in np.argsort(-np.abs(rows.weights[0] * b))[:5]:
        more = b.copy()
        more[k] *= 1.0 + 1e-4
        _, _, moved = strays_of(more)
        about = slice(chosen[0] - 3, chosen[0] + 4)  # the place may shift by some steps
        change = (moved.share[about].max() - strays.share[about].max()) / 1e-4
        assert change == pytest.approx(rows.weights[0, k] * b[k], rel=0.2)


@pytest.mark.long(shown_by="test_a_motion_that_strays_a_little_is_slowed_for_it")
def test_the_motion_is_near_the_least_that_any_plan_can_take(monkeypatch):
    """A linear program over X's commands, tick by tick, gives the least; it shares no code.

    The path comes within 0.1 mm of the programmed point, so the loads are within 0.4 mm. Guards
    alone are 5 % slower than with rows (0.845 s); the rest above the program comes from the
    acceleration of a rigid drive with a tenth of reserve, and from the ticks.
    """
    count = 315  # as the tool finds it; that one more would do is not needed here
    assert not comes(WINDER, count, 0.1, "loop", 4e-4)
    bound_s = count * 0.005 / STEPS
    plan = planned(3e-4)
    assert bound_s <= plan.duration_s < 1.035 * bound_s
    found = {(r.name, r.axis): r for r in prove_plan(plan, load_spec(None, WINDER)).verdict.results}
    assert found["contour_error", ""].measured < 4.2e-4
    monkeypatch.setattr(polished, "MOST_ROUNDS_OF_ROWS", 0)
    assert planned(3e-4).duration_s > 1.03 * plan.duration_s


def test_a_motion_that_strays_a_little_is_slowed_for_it(monkeypatch):
    """Most rounds end with a hundredth too much; it takes no more than it could spare."""
    caught = {}

    def kept(problem, block, limits, follower, past):
        caught.update(block=block, follower=follower)
        return block

    monkeypatch.setattr(following_error, "polished", kept)
    list(fastest_blocks(planned(3e-4).intent.path, WINDER, 3e-4))
    block, follower = caught["block"], caught["follower"]
    past = Past(follower.memory_s)
    begin = float(block.start_s[0])

    def quicker(by):
        start = begin + (block.start_s - begin) / by
        return replace(block, start_s=start, duration_s=block.duration_s / by)

    def share(of):
        return float(follower.strays(past, of).share.max())

    just = next(by for by in np.arange(1.0, 1.3, 1e-3) if share(quicker(by)) > 1.0)
    within = quicker(just - 2e-3)
    assert polished._within_tolerance(within, share(within), follower, past) is within
    over = quicker(just + 0.01)
    assert 1.005 < share(over) < polished._LITTLE
    found = polished._within_tolerance(over, share(over), follower, past)
    assert share(found) <= 1.0
    assert found.end_s - begin == pytest.approx((block.end_s - begin) / just, rel=2e-3)
    far = quicker(1.3 * just)
    assert polished._within_tolerance(far, share(far), follower, past) is None


@pytest.mark.parametrize("many", [0, 7, 40])
def test_the_step_is_that_of_the_whole_matrix(monkeypatch, many):
    """With few rows and with many, against the matrix written out."""
    rng = np.random.default_rng(many)
    band = np.column_stack([rng.uniform(4.0, 5.0, 12), rng.normal(0.0, 0.5, (12, 2))])
    g, weights, slack = rng.normal(size=12), rng.normal(size=(many, 12)), rng.uniform(0.1, 1, many)
    monkeypatch.setattr(polished.barrier, "derivatives", lambda *_: (band, g))
    problem = SimpleNamespace(b=None, elements=SimpleNamespace(length=None), rows=0, tangent=0)
    step, decrement = polished._newton(problem, weights, slack, 1e-2)
    whole = np.diag(band[:, 0]) + weights.T @ np.diag(1e-2 / slack**2) @ weights
    for k in (1, 2):
        whole += np.diag(band[:-k, k], k) + np.diag(band[:-k, k], -k)
    slope = g + weights.T @ (1e-2 / slack)
    full = -np.linalg.solve(whole, slope)
    near = 0.9 / max([0.9, *(weights @ full / slack)])
    assert step == pytest.approx(near * full, rel=1e-9)
    assert decrement == pytest.approx(-near * (slope @ full), rel=1e-9)


def test_rows_are_of_peaks_and_of_some_places_between_them():
    """A step costs the square of their number, so there are fewer of them with many elements."""
    share = 0.8 + 0.15 * np.sin(np.arange(3000) / 7.0)
    share[1000:2000] = 0.5
    peaks = [k for k in range(1, 2999) if share[k - 1] < share[k] > share[k + 1] and share[k] > 0.6]
    few, many = polished._chosen(share, 10), polished._chosen(share, 5000)
    assert few.tolist() == np.flatnonzero(share > 0.6).tolist()
    assert set(peaks) <= set(many.tolist()) < set(few.tolist())
    assert len(many) < 0.4 * len(few)
    assert np.diff(many).max(initial=0, where=np.diff(many) < 900) <= 5
