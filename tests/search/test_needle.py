"""Needle speeds in specification: the verdict changes at the edge."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from threadline.errors import LimitError, OptionError
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.options import Options, options_of
from threadline.proof.pipeline import open_job, plan_job, prove_plan
from threadline.search import fastest_needle, needle_range_hz
from threadline.search.fastest import Grid, find_fastest
from threadline.search.paced import Question, beyond
from threadline.verdict import Status, load_spec

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"

SEAM = """
[stitching]
stitch_length = "0.1 in"
needle_speed = "75 stitch/s"
motion = "discrete"

[[contour]]
unit = "mm"
points = [[0, 0], [20, 0], [20, 10]]
"""


@pytest.mark.usefixtures("coarse_scan")
def test_the_edge_is_where_the_verdict_turns(tmp_path: Path) -> None:
    file = tmp_path / "corner.seam.toml"
    file.write_text(SEAM)
    machine = load_machine("stitcher")
    spec = load_spec(None, machine)
    length = next(c for c in spec.criteria if c.name == "stitch_length_error")
    spec = replace(spec, criteria=(length,))
    low, high = needle_range_hz(read_job(file, machine), machine)
    # The velocity limit of both axes is 7.8 in/s, the stitch 0.1 in.
    assert high == pytest.approx(78.0)
    assert low < 2.0
    slow = replace(machine.axes["Y"], velocity=replace(machine.axes["Y"].velocity, si=0.05))
    slower = replace(machine, axes={**machine.axes, "Y": slow})
    assert needle_range_hz(read_job(file, machine), slower)[1] == pytest.approx(0.05 / 2.54e-3)
    found = fastest_needle(
        Question(
            job=open_job(file, machine, Options()),
            machine=machine,
            spec=spec,
            options=Options(),
            low=10.0,
            high=high,
        ),
        Grid(near=16, points=6),
    )
    assert found.best is not None

    assert found.limited_by == "stitch_length_error"
    # Edges are refined to 0.2 %: the best speed passes, and 2 % above it the verdict fails.
    for speed, passes in ((found.best, True), (found.best * 1.02, False)):
        job = read_job(file, machine, needle_speed=f"{speed!r} stitch/s")
        assert prove_plan(plan_job(job, machine, Options()), spec).verdict.passed is passes
    with pytest.raises(OptionError, match=r"from 50 stitch/s to 40 stitch/s.*--low below"):
        fastest_needle(
            Question(
                job=open_job(file, machine, Options()),
                machine=machine,
                spec=spec,
                options=Options(),
                low=50.0,
                high=40.0,
            )
        )


def test_a_speed_that_is_refused_is_told_in_the_units_of_its_limit():
    """The deceleration is 4.26 m/s^2, and 4 m/s^2 are allowed: no percentages, no sign."""
    machine = load_machine("stitcher")
    error = LimitError("-", axis="X", quantity="acceleration", value_si=-4.26, limit_si=4.0)
    found = find_fastest(lambda _: beyond(error, machine), 1.0, 2.0, Grid(points=3))
    assert found.best is None and found.limited_by == "acceleration"
    (result,) = found.verdict.results
    assert (result.measured, result.limit, result.unit) == (4.26, 4.0, "m/s^2")
    far = LimitError("-", axis="Y", quantity="travel", value_si=-0.2, limit_si=-0.15)
    (result,) = beyond(far, machine).results
    assert (result.measured, result.limit, result.unit) == (pytest.approx(0.05), 0.0, "m")


def test_a_speed_that_no_robust_change_reaches_is_out_of_specification() -> None:
    """At 78 stitch/s the head cannot change its speed in time within 27 A; at 60 it can."""
    machine, seam = load_machine("stitcher"), EXAMPLES / "stitcher-test-path.seam.toml"
    options = options_of(feed_forward=True, robust="0 %")
    job = open_job(seam, machine, options)
    fast = replace(options, needle="78 stitch/s")
    with pytest.raises(LimitError, match="no average over time changes the speed") as refused:
        plan_job(open_job(seam, machine, fast), machine, fast)
    (result,) = beyond(refused.value, machine).results
    assert (result.name, result.measured, result.unit) == ("current_peak", None, "A")
    assert result.status is Status.FAILED
    question = Question(
        job=job, machine=machine, spec=load_spec(None, machine), options=options,
        low=60.0, high=78.0,
    )  # fmt: skip
    found = fastest_needle(question, Grid(near=1, points=2))
    assert 1 < found.tried < 20
