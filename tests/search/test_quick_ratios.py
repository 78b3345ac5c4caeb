"""Ratios of many candidates side by side, and the specification of placement alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.machine.numbers import number_at
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.search.compare import PLACEMENT, placement_spec
from threadline.search.design_judge import Ratios, design_judge
from threadline.verdict import load_spec


def ratios(others, length=None) -> Ratios:
    names = tuple("abc"[: np.shape(others)[1]])
    return Ratios(
        names=names,
        others=np.array(others, dtype=float),
        length=None if length is None else np.array(length, dtype=float),
    )


def test_the_worst_corner_of_each_candidate_counts() -> None:
    """There are two candidates with three corners each, two criteria and two delays."""
    found = ratios(
        [[0.1, 0.9], [0.5, 0.2], [0.3, 0.3], [0.8, 0.1], [0.7, 0.4], [0.6, 0.2]],
        [[0.2, 0.4], [0.6, 0.1], [0.3, 0.3], [0.9, 0.5], [0.1, 0.7], [0.2, 0.2]],
    ).worst_of(3)
    assert found.others.tolist() == [[0.5, 0.9], [0.8, 0.4]]
    assert found.length is not None
    assert found.length.tolist() == [[0.6, 0.4], [0.9, 0.7]]


def test_the_worse_of_two_is_taken_criterion_by_criterion() -> None:
    found = ratios([[0.1, 0.9]], [[0.2, 0.4]]).worse(ratios([[0.3, 0.2]], [[0.1, 0.8]]))
    assert found.others.tolist() == [[0.3, 0.9]]
    assert found.length is not None and found.length.tolist() == [[0.2, 0.8]]


@pytest.mark.parametrize("name", ["lathe-winder", "stitcher"])
def test_placement_alone_limits_and_requires_nothing_else(name: str) -> None:
    spec = load_spec(None, load_machine(name))
    found = placement_spec(spec)
    assert [c.name for c in found.criteria] == [c.name for c in spec.criteria]
    for before, after in zip(spec.criteria, found.criteria, strict=True):
        if before.name in PLACEMENT:
            assert after == before
        else:
            assert (after.limit, after.required) == (None, False)
    assert any(c.required for c in spec.criteria if c.name not in PLACEMENT)


def test_an_axis_that_the_job_does_not_move_uses_nothing(tmp_path: Path) -> None:
    """A job of X alone moves neither A nor Y: their limits in the winder are not measured."""
    job = tmp_path / "x.nc"
    job.write_text("G91 G1 X20 F600\nX-20\nM30\n")
    winder = load_machine("lathe-winder")
    spec = load_spec(None, winder)
    plan = plan_job(read_job(job, winder), winder, Options())
    judge = design_judge(plan, winder, spec, np.empty(0))
    inertia = number_at(winder, "bodies.x.inertia").si

    found = judge.ratios({"bodies.x.inertia": np.array([1.0, 1.1]) * inertia})

    used = dict(zip(found.names, found.others.T, strict=True))
    np.testing.assert_array_equal(used["turning_point_error A"], [0.0, 0.0])
    assert (used["turning_point_error X"] > 0.0).all()
