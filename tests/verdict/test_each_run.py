"""Results of runs that are sent between processes."""

from __future__ import annotations

import pickle

import numpy as np

from threadline.verdict import CriterionRow, EachRun
from threadline.verdict.finding import Finding


def _row(number: int, runs: int) -> CriterionRow:
    values = np.linspace(0.0, number, runs)
    values[0] = np.nan if number % 2 else -0.0
    return CriterionRow(
        name="contour_error", axis="X", step=f"step {number}", limit=None if number % 3 else 0.5,
        unit="m", required=bool(number % 2), hard=True, values=values, failed=values > 0.5,
        of_plan=number == 4, places={0: Finding(value=1.0, axis="X", time_s=float(number))},
    )  # fmt: skip


def test_a_result_is_the_same_after_its_way_to_another_process() -> None:
    for runs, rows in (1, 35), (4, 6), (3, 0):
        sent = EachRun(rows=tuple(_row(k, runs) for k in range(rows)), runs=runs, incomplete="no")
        came = pickle.loads(pickle.dumps(sent))
        assert (came.runs, came.incomplete, len(came.rows)) == (runs, "no", rows)
        for own, other in zip(sent.rows, came.rows, strict=True):
            assert own.values.tobytes() == other.values.tobytes()
            assert own.failed.tolist() == other.failed.tolist()
            assert other.failed.dtype == np.bool_ and other.values.dtype == np.float64
            for name in "name", "axis", "step", "limit", "unit", "required", "hard", "of_plan":
                assert getattr(own, name) == getattr(other, name)
            assert own.places == other.places


def test_a_result_of_one_run_is_short() -> None:
    """A command reads thousands of them a second if many workers judge machines one by one."""
    one, other = (EachRun(rows=tuple(_row(k, 1) for k in range(35)), runs=1) for _ in range(2))
    assert len(pickle.dumps([one, other])) - len(pickle.dumps([one])) < 110 * 35
