"""The independent search judges by every criterion of a claim."""

from __future__ import annotations

from collections.abc import Iterator
from unittest.mock import patch

import numpy as np
import pytest
from tools.break_claims import AWAY, BROKEN, MEAN_OF, ROOT, Claim, changing, covered, used

from threadline.errors import OptionError
from threadline.machine.vary import REPEAT_SEED, drawn_days, varied_numbers
from threadline.proof.pipeline import Trials, prove_plan
from threadline.verdict import EachRun
from threadline.verdict.each_run import CriterionRow
from threadline.verdict.registry import MEASURES

FAST = (
    "threadline prove examples/x-180.prg -m lathe-winder --interpolation b-spline-pulled "
    '--feed "80 count/tick"'
)


@pytest.fixture(autouse=True)
def _at_the_root(monkeypatch) -> Iterator[None]:
    monkeypatch.chdir(ROOT)
    with patch.dict(MEASURES):
        yield


def _row(name: str, limit: float, values: list[float], **more: bool) -> CriterionRow:
    measured = np.array(values)
    return CriterionRow(
        name=name, axis="", step="", limit=limit, unit="m", values=measured,
        failed=measured > limit, **{"required": False, "hard": False} | more,
    )  # fmt: skip


def test_a_limit_of_nothing_and_a_missing_value_break_a_claim() -> None:
    """A sample at the clamp has no share of a limit of 0; a required number must be there."""
    found = EachRun(
        rows=(
            _row("contour_error", 2.0, [1.0, 1.0, np.nan, 1.0], required=True),
            _row("dac_saturation", 0.0, [0.0, 0.01, 0.0, 0.0]),
            _row("velocity", 1.0, [0.9, 0.9, 0.9, 1.2], hard=True),
        ),
        runs=4,
    )
    shares, names = used(found)
    assert shares.tolist() == [0.5, BROKEN, BROKEN, 1.2]
    assert names == ["contour_error", "dac_saturation", "contour_error", "velocity"]


def test_the_distance_from_the_mean_of_days_is_the_repeatability_of_these_days() -> None:
    claim = Claim(FAST, machines=False)
    plan, judge = claim.plan, claim.runs.judge
    days = drawn_days(MEAN_OF, len(plan.axes), np.random.default_rng(REPEAT_SEED))
    found = judge.judged(varied_numbers(plan.machine, days), days.phases)
    verdict = prove_plan(plan, claim.spec, None, Trials(repeats=MEAN_OF)).verdict
    measured = verdict.result("repeatability").measured
    assert found.row(AWAY).values.max() == pytest.approx(measured, rel=1e-9)


PLACER = (
    "threadline prove examples/letter-cycle.toml -m letter-placer+whole-scans+own-damping "
    "--shaper zv"
)


def test_runs_that_are_simulated_one_by_one_are_searched() -> None:
    """The middle of the ranges of a day is the nominal run, for every criterion; an end is not."""
    claim = Claim(PLACER, machines=False)
    nominal = prove_plan(claim.plan, claim.spec, None, Trials(repeats=1)).verdict
    places = np.zeros((2, claim.box.size))
    places[1] = 1.0
    found = claim.runs.judged(places)
    assert len(found.rows) > 5
    for row, result in zip(found.rows, nominal.results, strict=True):
        assert row.values[0] == pytest.approx(result.measured, rel=1e-9), row.text
    assert any(row.values[0] != row.values[1] for row in found.rows)


def test_a_machine_of_its_own_for_each_run_is_searched() -> None:
    """A machine with all numbers at their ends uses more than twice as much of a limit."""
    claim = Claim(PLACER, machines=True)
    places = np.zeros((2, claim.box.size))
    places[1, : len(claim.box.ends)] = 1.0
    shares = claim.shares(places)
    assert shares[0] < 0.25 < 0.5 < shares[1]
    assert claim.answer()["share"] == shares[1]


LIMITED = (  # by the current of its drives
    "threadline prove examples/x-180.prg -m lathe-winder --interpolation optimal "
    '--feed "4.96022 m/s" --feed-forward --reserve "volts 0.56 %, current 2.62 %"'
)


@pytest.mark.parametrize(("claim", "supply_counts"), [(FAST, False), (LIMITED, True)])
def test_a_grid_covers_the_numbers_that_change_a_day(claim: str, supply_counts: bool) -> None:
    """Of a job that moves X alone without friction: the place of X between counts, and supply."""
    made = Claim(claim, machines=False)
    numbers = changing(made, np.random.default_rng(3))
    supply, phase_of_x = 1, 2 + made.plan.machine.axis_names.index("X")
    assert numbers == ([supply, phase_of_x] if supply_counts else [phase_of_x])
    found = covered(claim, 8)
    values = {supply: np.linspace(-1.0, 1.0, 8), phase_of_x: (np.arange(8) + 0.5) / 4 - 1.0}
    grid = np.meshgrid(*(values[k] for k in numbers))
    places = np.zeros((8 ** len(numbers), made.box.size))
    places[:, numbers] = np.stack([side.ravel() for side in grid], axis=1)
    shares, _ = used(made.runs.judged(places))
    assert (found["tried"], found["share"]) == (len(places), shares.max())


def test_a_grid_is_refused_where_more_numbers_change_a_day() -> None:
    claim = "threadline prove examples/stitcher-75.seam.toml -m examples/stitcher-75.toml"
    with pytest.raises(OptionError, match="numbers of a day change the results"):
        covered(f'{claim} --feed-forward --smoothing "24 ms"', 8)
