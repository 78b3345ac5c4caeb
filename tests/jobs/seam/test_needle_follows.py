"""A needle that turns with the way of the head: its bounds, its drive, its needle-downs."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from threadline.commands.plan import Plan
from threadline.errors import JobError
from threadline.files import tick_table
from threadline.jobs.operations import Move
from threadline.jobs.seam import read_seam
from threadline.machine import Machine, load_machine
from threadline.proof.kinds.ticks import NeedleColumns
from threadline.proof.options import options_of
from threadline.proof.pipeline import NOMINAL, plan_job, try_plan
from threadline.search.feed import needle_range_hz
from threadline.verdict import Criterion, Spec, Verdict, load_spec
from threadline.verdict.demands import measure_needle_use
from threadline.verdict.needle import Stitches, planned_stitches
from threadline.verdict.stitch_run import turn_error

EXAMPLES = Path(__file__).parents[3] / "examples"
FOLLOW = EXAMPLES / "stitcher-follow.seam.toml"
STITCH_M = 2.54e-3
STRAIGHT = '[[contour]]\nunit = "mm"\npoints = [[0, 0], [60, 0]]\n'


@pytest.fixture(scope="module")
def stitcher() -> Machine:
    return load_machine("stitcher")


def planned(
    stitcher: Machine, seam: Path = FOLLOW, *, interpolation: str = "optimal", **settings: str
) -> Plan:
    job = read_seam(seam, stitcher, **settings)
    contour = "none" if interpolation == "optimal" else None
    options = options_of(interpolation, None, "0.1 mm", contour=contour)
    return plan_job(job, stitcher, options)


def sewn(plan: Plan) -> Stitches:
    runs = list(planned_stitches(plan))
    names = [field.name for field in fields(Stitches)]
    return Stitches(**{n: np.concatenate([getattr(run, n) for run in runs]) for n in names})


def way_m(plan: Plan, begin_s: float, end_s: float) -> float:
    """Return the length of the planned motion between two instants, from many short chords."""
    at = plan.motion.trajectory(np.linspace(begin_s, end_s, 4001))
    return float(np.linalg.norm(np.diff(at, axis=0), axis=1).sum())


def test_needle_follows_the_head_and_slows_at_corners(stitcher: Machine) -> None:
    """Each straight stitch is as long as the motion during its turn, at any speed.

    A corner is rounded within the tolerance of the path, so that the way is shorter there, by no
    more than (2 - sqrt(2)) of the legs of a rounding of 0.1 mm: 0.3 mm at most.
    """
    plan = planned(stitcher)
    run = sewn(plan)
    hz = 1.0 / run.period_s
    assert len(run) == 75 and run.follows.all()
    gone = [way_m(plan, a, b) for a, b in zip(run.from_s, run.down_s, strict=True)]
    corner = np.isin(np.arange(75), [24, 25, 49, 50])
    np.testing.assert_allclose(np.array(gone)[~corner], STITCH_M, atol=1e-6)
    assert (np.abs(np.array(gone)[corner] - STITCH_M) < 3e-4).all()
    assert hz.max() <= 67.0 * 1.001
    # The head is fast in the middle of a leg and slow in its corners; the needle still turns there.
    assert hz[10:15].min() > 65.0
    assert 10.0 < hz[corner].max() < 50.0
    assert turn_error(run).tolist() == [0.0] * 75


@pytest.mark.parametrize("interpolation", ["optimal", "auto"])
def test_no_turn_is_too_fast_where_corners_between_unlike_stitches_are_rounded(
    stitcher: Machine, interpolation: str
) -> None:
    """The legs of the strap have stitches of 2.94 to 3.02 mm, and one piece rounds their corner.

    It has one speed; with the mean of both, the longer stitch took 0.12 % less than a turn. A
    needle may be 0.1 % too fast; 0.009 % remain by ``auto``, 0.013 % by ``optimal``.
    """
    strap = EXAMPLES / "strap.seam.toml"
    words = {"needle": "follow", "needle_speed": "5 stitch/s"}
    plan = planned(stitcher, strap, interpolation=interpolation, **words)
    run = sewn(plan)
    lengths = np.linalg.norm(run.point - run.from_point, axis=1)
    assert lengths.max() / lengths.min() > 1.01
    assert turn_error(run).min() > -3e-4
    # It costs almost nothing: 76 turns, and the loss beside the rests.
    assert run.down_s[-1] - run.from_s[0] < 76 / 5 * 1.003


def test_a_needle_of_constant_speed_is_refused_the_same_motion(stitcher: Machine) -> None:
    run = sewn(planned(stitcher, needle="constant", needle_slowest="0 stitch/s"))
    assert not run.follows.any()
    assert np.abs(turn_error(run)[~run.exempt]).max() > 0.05


def test_a_corner_slower_than_the_needle_may_turn_is_told(stitcher: Machine) -> None:
    """Its bounds hold at corners, and not beside the rests at the two ends."""
    run = sewn(planned(stitcher, needle_slowest="60 stitch/s"))
    slow = 60.0 * run.period_s - 1.0
    beyond = turn_error(run)
    inner = slice(1, -1)
    np.testing.assert_allclose(beyond[inner], np.maximum(slow[inner], 0.0), atol=1e-12)
    assert beyond[24] > 0.1
    assert slow[0] > 0.1 and beyond[0] == 0.0 and beyond[-1] == 0.0


def test_the_drive_of_the_needle_limits_the_timing(stitcher: Machine) -> None:
    """The speed along the planned path, by differences, stays within the needle's limit.

    From rest at a limit of a l the n-th turn of 1000 stitch/s^2 ends at sqrt(2 n / a); the jerk of
    the axes takes 0.3 ms of that.
    """
    plan = planned(stitcher, needle_acceleration="1000 stitch/s^2")
    trajectory, run = plan.motion.trajectory, sewn(plan)
    time_s = np.linspace(0.0, trajectory.duration_s, 40_001)
    speed = np.linalg.norm(trajectory(time_s, 1), axis=1)
    change = np.abs(np.diff(speed)) / np.diff(time_s) / STITCH_M
    assert change.max() < 1000.0 * 1.001
    assert change.max() > 990.0
    np.testing.assert_allclose(
        run.down_s[:2] - run.from_s[0], np.sqrt(2.0 * np.arange(1, 3) / 1000.0), atol=6e-4
    )
    (use,) = measure_needle_use(plan)["needle_use"]
    assert use.value is not None and 0.95 < use.value < 1.001
    free = planned(stitcher, needle_acceleration="1e9 stitch/s^2")
    assert free.motion.trajectory.duration_s < 0.95 * trajectory.duration_s


def test_a_timing_that_asks_more_of_the_drive_is_out(stitcher: Machine) -> None:
    """``auto`` does not know the drive; the judge does, whatever the specification asks."""
    plan = planned_auto(stitcher, needle_acceleration="200 stitch/s^2")
    assert load_spec(None, stitcher).criteria[-1].name != "needle_use"
    result = judged(plan).result("needle_use")
    assert result.status == "failed" and result.measured is not None and result.measured > 2.0


@pytest.mark.parametrize(("limit", "held"), [(0.5, 0.5), (2.0, 1.0), (None, 1.0)])
def test_a_specification_may_ask_for_more_of_the_needle_and_not_for_less(
    stitcher: Machine, limit: float | None, held: float
) -> None:
    plan = planned(stitcher, needle_acceleration="1000 stitch/s^2")
    asked = Criterion(name="needle_use", limit=limit)
    result = try_plan(plan, Spec(name="own", criteria=(asked,)), NOMINAL, None).verdict.result(
        "needle_use"
    )
    assert result.limit == held and result.measured is not None and 0.95 < result.measured < 1.001
    assert (result.status == "failed") == (held < 1.0)


def planned_auto(stitcher: Machine, **settings: str) -> Plan:
    job = read_seam(FOLLOW, stitcher, **settings)
    return plan_job(job, stitcher, options_of("auto", None, "0.1 mm"))


def judged(plan: Plan) -> Verdict:
    return try_plan(plan, load_spec(None, plan.machine), NOMINAL, None).verdict


def test_the_machine_as_built_sews_corners_with_it(stitcher: Machine) -> None:
    """The loads follow; the needle is geared with them, smoothing included."""
    job = read_seam(FOLLOW, stitcher)
    led = options_of("optimal", None, "0.1 mm", feed_forward=True, smoothing="50 ms")
    plan = plan_job(job, stitcher, led)
    verdict = judged(plan)
    assert verdict.passed
    run = sewn(plan)
    hz = 1.0 / run.period_s
    assert hz.max() > 66.5 and hz.min() > 10.0
    steady = read_seam(FOLLOW, stitcher, needle="constant", needle_slowest="0 stitch/s")
    even = judged(plan_job(steady, stitcher, led))
    assert even.result("needle_time_error").status == "failed"


def test_needle_entries_are_written_beside_the_rows(stitcher: Machine) -> None:
    """Once at the start, and at the end of every stitch; then the head is at the needle's point."""
    plan = planned(stitcher)
    run = sewn(plan)
    table = tick_table(plan.commands)
    columns = NeedleColumns(plan, table.clock)
    down_s, tick_s = [], float(table.clock.period_s)
    for block in table:
        rows = columns.rows(block)
        down_s += ((block.first_tick + rows.row) * tick_s + rows.after_s).tolist()
    assert len(down_s) == 76
    np.testing.assert_allclose(down_s[1:], run.down_s, atol=1e-9)
    at = plan.motion.trajectory(np.array(down_s[1:]))
    assert np.abs(at - run.point).max() < 1e-4  # the tolerance of the path
    assert down_s[0] == pytest.approx(run.from_s[0], abs=1e-9)


def test_a_rest_before_a_seam_is_no_turn_of_the_needle(stitcher: Machine, tmp_path: Path) -> None:
    """Two contours: the head travels, rests for 0.3 s, and departs; then the needle turns."""
    seam = tmp_path / "two.seam.toml"
    seam.write_text(STRAIGHT + '[[contour]]\nunit = "mm"\npoints = [[0, 20], [60, 20]]\n')
    words = {"stitch_length": "3 mm", "needle_speed": "40 stitch/s", "needle": "follow"}
    plan = planned(stitcher, seam, **words, travel_speed="100 mm/s", settle="0.3 s")
    run = sewn(plan)
    second = int(np.flatnonzero(run.first)[1])
    assert run.departs[[0, second]].all() and run.departs.sum() == 2
    assert run.down_s[second] - run.from_s[second] > 0.3
    assert run.period_s[second] == pytest.approx(run.period_s[0], rel=1e-6)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"needle": "constant", "needle_slowest": "5 stitch/s"}, 'of needle = "follow"'),
        ({"needle": "follow", "needle_slowest": "90 stitch/s"}, "90 stitch/s, above needle_speed"),
        ({"needle": "follow", "needle_slowest": "-1 stitch/s"}, "needle_slowest is '-1 stitch/s'"),
        ({"needle": "follows"}, "Use constant or slowed or follow"),
    ],
)
def test_bounds_that_cannot_be_are_refused(
    stitcher: Machine, tmp_path: Path, settings: dict[str, str], message: str
) -> None:
    seam = tmp_path / "s.seam.toml"
    lines = "".join(f'{key} = "{value}"\n' for key, value in settings.items())
    own = '[stitching]\nstitch_length = "3 mm"\nneedle_speed = "75 stitch/s"\n'
    seam.write_text(own + lines + STRAIGHT)
    with pytest.raises(JobError, match=r"s\.seam\.toml:") as raised:
        read_seam(seam, stitcher)
    assert message in str(raised.value)


def test_needle_times_ramp_within_the_drive_limit(stitcher: Machine) -> None:
    """On programmed chords (``--feed-forward`` alone) it has the times of a slowed needle."""
    both = [
        [
            1.0 / move.feed.value
            for move in read_seam(FOLLOW, stitcher, needle=needle, needle_slowest="0 stitch/s")
            if isinstance(move, Move) and "stitch" in move.tags and move.feed is not None
        ]
        for needle in ("follow", "slowed")
    ]
    assert both[0] == both[1]
    assert both[0][0] == pytest.approx(np.sqrt(2.0 / 2000.0), rel=1e-9)


def test_a_search_begins_at_its_lowest_speed(stitcher: Machine) -> None:
    job = read_seam(FOLLOW, stitcher, needle_slowest="30 stitch/s")
    low, high = needle_range_hz(job, stitcher)
    assert low == 30.0 and high == pytest.approx(78.0, rel=1e-3)
