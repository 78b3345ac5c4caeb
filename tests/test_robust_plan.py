"""``--robust``: one plan for all ends of the tolerances of masses and stiffnesses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.commands.plan import Plan
from threadline.errors import OptionError, PlanError
from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.machine.vary import corners, off_tolerance, vary
from threadline.motion.timing.types import TrajectoryReader
from threadline.proof.options import Options, describe, options_from, options_of
from threadline.proof.pipeline import NOMINAL, plan_job, try_plan
from threadline.verdict import load_spec

EXAMPLES = Path(__file__).parents[1] / "examples"
MACHINE = load_machine("stitcher")
ROBUST = options_of("auto", None, "0.1 mm", feed_forward=True, robust="100 %")


@pytest.mark.long(
    shown_by="test_the_machine_as_built_sews_67_stitches_a_second_by_all_that_is_asked"
)
def test_a_seam_is_in_spec_on_machines_that_fail_the_plain_plan() -> None:
    """42 stitches a second by all criteria, where plain feed-forward is worst."""
    spec = load_spec(None, MACHINE)
    job = read_job(EXAMPLES / "stitcher-robust.seam.toml", MACHINE)
    robust = plan_job(job, MACHINE, ROBUST)
    plain = plan_job(job, MACHINE, Options(feed_forward_s=0.04))
    assert robust.intent.warnings == ()
    for mass, stiffness in ((-1.0, 1.0), (1.0, -1.0)):
        actual = off_tolerance(MACHINE, mass=mass, stiffness=stiffness)
        assert try_plan(robust, spec, NOMINAL, actual).verdict.passed, (mass, stiffness)
        assert not try_plan(plain, spec, NOMINAL, actual).verdict.passed, (mass, stiffness)
    # The needle turns evenly, and the whole way is the way of the seam.
    assert robust.motion.trajectory(robust.motion.trajectory.duration_s) == pytest.approx(
        plain.motion.trajectory(plain.motion.trajectory.duration_s), abs=1e-9
    )


@pytest.mark.long(
    shown_by="test_the_machine_as_built_sews_67_stitches_a_second_by_all_that_is_asked"
)
def test_a_slower_needle_is_in_spec_on_all_nine_machines_too() -> None:
    """At some speeds a machine took 2.19 stitches to its speed, and 2 are allowed.

    The plan reached the speed only at the very end of the two stitches; now it does a little
    sooner.
    """
    spec = load_spec(None, MACHINE)
    file = EXAMPLES / "stitcher-robust.seam.toml"
    job = read_job(file, MACHINE, needle_speed="36 stitch/s")
    plan = plan_job(job, MACHINE, ROBUST)
    for actual in corners(MACHINE):
        assert try_plan(plan, spec, NOMINAL, actual).verdict.passed


def test_the_machine_as_built_sews_67_stitches_a_second_by_all_that_is_asked() -> None:
    """Also on days with the least supply, where plain feed-forward is out of spec anyway."""
    spec = load_spec(None, MACHINE)
    job = read_job(EXAMPLES / "stitcher-even.seam.toml", MACHINE)
    plan = plan_job(
        job, MACHINE, options_of("auto", None, "0.1 mm", feed_forward=True, robust="0 %")
    )
    plain = plan_job(job, MACHINE, Options(feed_forward_s=0.04))
    for supply in (1.0, 0.95):
        day = vary(MACHINE, supply=supply)
        verdict = try_plan(plan, spec, NOMINAL, day).verdict
        assert verdict.passed, supply
        assert not try_plan(plain, spec, NOMINAL, day).verdict.passed, supply


SWINGING = """
[stitching]
stitch_length = "0.1 in"
needle_speed = "{speed} stitch/s"
motion = "discrete"
acceleration = "380 in/s^2"
{swing}

[[contour]]
unit = "in"
points = [[0, 0], [2.5, 0], [2.5, 2.5], [5, 2.5]]
"""
ALONE = options_of("auto", None, "0.1 mm", feed_forward=True, robust="0 %")


def swung(folder: Path, speed: int, swing: str = "") -> tuple[Plan, float]:
    """Return a plan for the machine of the file, and the largest speed of Y before its leg.

    The speed counts against the direction of the leg, as a share of the speed of the head.
    """
    file = folder / "swing.seam.toml"
    file.write_text(SWINGING.format(speed=speed, swing=swing and f'swing = "{swing}"'))
    plan = plan_job(read_job(file, MACHINE), MACHINE, ALONE)
    loads = plan.motion.of_loads
    assert loads is not None
    time_s = np.arange(0.0, loads.duration_s, 2.5e-4)
    velocity = TrajectoryReader(loads).derivatives(time_s, 2)[:, 1]
    return plan, float(-velocity[:, 1].min() / (speed * 2.54e-3))


@pytest.mark.long(shown_by="test_a_swing_that_cannot_be_kept_is_refused_with_its_cost")
def test_a_seam_limits_the_swing_of_its_plan(tmp_path: Path) -> None:
    """Y goes back before the corner, by a fifth of the speed unless the seam says less.

    Less swing means fewer stitches from the first movement to the speed: two are allowed.
    """
    spec = load_spec(None, MACHINE)
    for speed, limit, least, most, stitches in (
        (66, "", 0.15, 0.35, 3.0),
        (66, "10 %", 0.05, 0.1, 3.0),
        (66, "0.5 %", 0.0, 0.005, None),
    ):
        plan, swing = swung(tmp_path, speed, limit)
        assert least <= swing <= most, limit
        verdict = try_plan(plan, spec, NOMINAL, MACHINE).verdict
        result = verdict.result("stitches_to_speed")
        assert result.measured is not None
        if stitches is None:
            assert verdict.passed
        else:
            assert result.measured > stitches
            assert not verdict.passed
        needle = verdict.result("stitches_from_needle")
        assert needle.measured is not None
        assert needle.measured < 2.0
        assert needle.limit is None


def test_a_swing_that_cannot_be_kept_is_refused_with_its_cost(tmp_path: Path) -> None:
    with pytest.raises(PlanError, match=r"at most 0\.50% of it; without .*swings by 2.%"):
        swung(tmp_path, 70, "0.5 %")


def test_robust_option_is_recorded_as_typed() -> None:
    job = read_job(EXAMPLES / "stitcher-robust.seam.toml", MACHINE)
    for smoothing in (None, "90 ms"):
        options = options_of(
            "auto", None, "0.1 mm", feed_forward=True, smoothing=smoothing, robust="50 %"
        )
        assert options_from(describe(job, MACHINE, options)) == options
    assert "robust" not in describe(job, MACHINE, Options(feed_forward_s=0.04))


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ({"robust": "-1 %", "feed_forward": True}, "robust '-1 %' must be at least 0 %"),
        ({"robust": "3 mm", "feed_forward": True}, "robust '3 mm'"),
        ({"robust": "300 %", "feed_forward": True}, "at most 200 %"),
    ],
)
def test_bad_shares_are_refused(words, text) -> None:
    with pytest.raises(OptionError, match=text):
        options_of("auto", None, "0.1 mm", **words)


def test_impossible_robust_plan_is_refused() -> None:
    seam = EXAMPLES / "stitcher-robust.seam.toml"
    with pytest.raises(OptionError, match="--robust '100 %' needs feed-forward"):
        plan_job(
            read_job(seam, MACHINE), MACHINE, options_of("auto", None, "0.1 mm", robust="100 %")
        )
    bare = replace(MACHINE, bodies=_exact(MACHINE.bodies), links=_exact(MACHINE.links))
    with pytest.raises(OptionError, match="have no tolerances"):
        corners(bare)
    job = read_job(seam, MACHINE)
    with pytest.raises(PlanError, match="at least 10 ms are needed"):
        plan_job(job, MACHINE, replace(ROBUST, change_s=0.005))
    winder = load_machine("lathe-winder")
    program = read_job(EXAMPLES / "x-180.prg", winder)
    with pytest.raises(PlanError, match="no needle that says in which time"):
        plan_job(program, winder, ROBUST)
    follows = read_job(EXAMPLES / "stitcher-follow.seam.toml", MACHINE)
    with pytest.raises(PlanError, match="its needle follows the head"):
        plan_job(follows, MACHINE, ROBUST)


def _exact(parts):
    def exact(part):
        numbers = {
            name: replace(number, tolerance_si=0.0)
            for name in ("inertia", "stiffness")
            if (number := getattr(part, name, None)) is not None
        }
        return replace(part, **numbers)

    return {name: exact(part) for name, part in parts.items()}
