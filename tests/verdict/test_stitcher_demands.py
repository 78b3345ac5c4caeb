"""The stitcher's own specification has all limits of its thesis, and an even needle."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from threadline.files import ChannelKind, Clock
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.options import Options, options_of
from threadline.proof.pipeline import REPEATED, plan_job, prove_plan
from threadline.verdict import Status, Verdict, judge, load_spec

from .builders import record

EXAMPLES = Path(__file__).parents[2] / "examples"
STEEP, SLOW = "stitcher-steep.seam.toml", "stitcher-test-path.seam.toml"


def proved(seam: str, speed: str, options: Options) -> Verdict:
    machine = load_machine("stitcher")
    job = read_job(EXAMPLES / seam, machine, needle_speed=speed)
    plan = plan_job(job, machine, options)
    return prove_plan(plan, load_spec(None, machine), trials=REPEATED).verdict


def failed(verdict: Verdict) -> set[str]:
    return {result.name for result in verdict.results if result.status is Status.FAILED}


def test_default_limits_of_the_stitcher_are_those_of_the_thesis() -> None:
    """0.02 in, 5 % of a stitch's length and of the speed, and two stitches to the speed."""
    spec = load_spec(None, load_machine("stitcher"))
    limits = {c.name: c.limit for c in spec.criteria if c.required}
    assert limits == {
        "contour_error": 0.5e-3,
        "seam_error": 0.5e-3,
        "progress_error": 0.5e-3,
        "stitch_length_error": 0.05,
        "stitch_speed_error": 0.05,
        "stitches_to_speed": 2.0,
        "needle_time_error": 0.001,
    }
    # The other specification limits place and length, and reports the rest.
    place = load_spec(EXAMPLES / "stitcher-place.spec.toml", load_machine("stitcher"))
    assert [c.name for c in place.criteria] == [c.name for c in spec.criteria]
    fewer = {c.name: c.limit for c in place.criteria if c.required}
    assert limits.items() > fewer.items()
    assert limits.keys() - fewer.keys() == {
        "stitch_speed_error", "stitches_to_speed", "needle_time_error",
    }  # fmt: skip


def test_the_limits_of_a_frame_on_tables_are_those_of_its_machine() -> None:
    """The step rate of its controller's table, and 100 % of force, window and fetch."""
    machine = load_machine("schiffli-frame")
    assert machine.tables is not None
    always = {c.name: c.limit for c in load_spec(None, machine).criteria if c.hard}
    assert always["step_rate"] == machine.tables.step_rate.si
    assert {always[name] for name in ("servo_force", "window_use", "fetch_use")} == {1.0}


@pytest.mark.long(but="stitcher-steep.seam.toml-64 stitch/s-42 ms-which1")
@pytest.mark.parametrize(
    ("seam", "speed", "smoothing", "which"),
    [
        (STEEP, "60 stitch/s", "42 ms", set()),
        # Ramps and smoothing take two turns of a slower needle than this one.
        (STEEP, "64 stitch/s", "42 ms", {"stitches_to_speed"}),
        # With less smoothing the head reaches its speed in time, and rings.
        (STEEP, "62 stitch/s", "38 ms", {"stitch_speed_error", "stitch_length_error"}),
        # By place and length alone, this plan does 73 stitches a second.
        (SLOW, "73 stitch/s", "40 ms", {"stitches_to_speed", "stitch_speed_error"}),
    ],
)
def test_speed_counts_as_place_does(seam: str, speed: str, smoothing: str, which: set[str]) -> None:
    options = options_of("auto", None, "0.1 mm", feed_forward=True, smoothing=smoothing)
    found = failed(proved(seam, speed, options))
    assert found >= which if which else not found
    assert "needle_time_error" not in found


def test_a_needle_that_would_have_to_wait_fails() -> None:
    """A seam with a constant needle, by a plan whose times are a spline, not turns of it."""
    verdict = proved(SLOW, "20 stitch/s", Options())
    assert "needle_time_error" in failed(verdict)


def test_a_recording_of_few_samples_does_not_fail_a_run_that_keeps_its_demands() -> None:
    """Means over 5 ms and more see a start early and the speed late: 2.1 to 3 stitches, not 1.9."""
    machine = load_machine("stitcher")
    job = read_job(EXAMPLES / "stitcher-even.seam.toml", machine)
    options = options_of("auto", None, "0.1 mm", feed_forward=True, robust="0 %")
    plan, spec = plan_job(job, machine, options), load_spec(None, machine)
    proof = prove_plan(plan, spec)
    assert proof.verdict.passed
    kinds = (ChannelKind.COMMANDED, ChannelKind.LOAD)
    names = [f"{axis}.{kind}" for kind in kinds for axis in plan.axes]
    samples = proof.recording.samples_of([*names, "operation"])
    columns = [np.column_stack([samples[f"{axis}.{kind}"][1] for axis in plan.axes])
               for kind in kinds]  # fmt: skip
    late = []
    for every in (2, 3, 5, 8, 10, 13):
        thin = record(
            plan.axes, dict(zip(kinds, (one[::every] for one in columns), strict=True)),
            samples["operation"][1][::every], clock=Clock("logger", Fraction(every, 1000)),
            job_sha256=plan.job.sha256, simulated=False,
        )  # fmt: skip
        assert not failed(judge([thin], plan, spec)), every
        # A head that takes a stitch more than the limit and both ends still fails.
        strict = tuple(
            replace(one, limit=0.2) if one.name == "stitches_to_speed" else one
            for one in spec.criteria
        )
        late.append(
            "stitches_to_speed" in failed(judge([thin], plan, replace(spec, criteria=strict)))
        )
    assert all(late)
