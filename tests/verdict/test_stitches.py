"""Stitches, compared with closed forms: a known motion, and known needle-downs.

Stitches of 2 mm at 50 a second, on samples every 5 ms, so that every needle-down is on a sample:
positions below 0.1 m leave 1e-11 of a stitch to rounding.
"""

from __future__ import annotations

import tracemalloc
from dataclasses import fields, replace

import numpy as np
import pytest

from threadline.base.arrays import FloatArray
from threadline.files import ChannelKind, Stream
from threadline.jobs.operations import Feed, FeedMode, Move, Source, ToolEvent
from threadline.machine import load_machine
from threadline.verdict import Criterion, Status, judge
from threadline.verdict.blocks import setting_of
from threadline.verdict.samples import Block
from threadline.verdict.sewn import StitchFollower

from .builders import TICK_S, plan_through, record, spec_of

PERIOD_S, LENGTH_M, COUNT = 0.02, 2e-3, 40
SPEED_M_S = LENGTH_M / PERIOD_S
POINTS = [[k * LENGTH_M, 0.0] for k in range(COUNT + 1)]
TIME_S = TICK_S * np.arange(round(COUNT * PERIOD_S / TICK_S) + 41)
NAMES = ("stitch_length_error", "stitch_placement_error", "needle_time_error")


def seam(exempt=(), feed_hz=1 / PERIOD_S):
    plan = plan_through(POINTS, move_s=PERIOD_S, vertices_per_block=7)
    feed = Feed(FeedMode.INVERSE_TIME, feed_hz)
    moves = [
        Move(
            tuple(point),
            feed,
            Source("by-hand.toml", 10 * k + 10),
            {"kind": "sew", "contour": 0, "stitch": k, "exempt": int(k in exempt),
             "target_m": LENGTH_M},
        )
        for k, point in enumerate(POINTS[1:])
    ]  # fmt: skip
    end = ToolEvent("trim", 1.0, Source("by-hand.toml", 1))
    return replace(plan, job=replace(plan.job, operations=Stream.of([*moves, end])))


def sewn(
    x, y=None, *, plan=None, delay=0.0, per_block=13, names=NAMES, options=None, commanded=None
):
    tool = np.column_stack([x, np.zeros_like(x) if y is None else y])
    operation = np.minimum(np.floor(TIME_S / PERIOD_S + 1e-9), COUNT - 1)[: len(x)]
    channels = {ChannelKind.LOAD: tool}
    if commanded is not None:
        channels[ChannelKind.COMMANDED] = np.column_stack([commanded, np.zeros_like(x)])
    recording = record(("X", "Y"), channels, operation, per_block=per_block)
    options = {"delay": delay} if options is None else options
    criteria = [Criterion(name=name, limit=0.05, options=options) for name in names]
    return judge([recording], seam() if plan is None else plan, spec_of(*criteria))


def test_a_constant_lag_is_no_error() -> None:
    verdict = sewn(SPEED_M_S * (TIME_S - 0.013))
    for name in NAMES:
        assert verdict.result(name).measured == pytest.approx(0.0, abs=1e-10)
        assert verdict.result(name).status is Status.PASSED


@pytest.mark.parametrize("per_block", [3, 64, 1000])
def test_a_step_of_speed_is_that_error(per_block: int) -> None:
    """8 % faster from the needle-down at 0.4 s on: stitch 21 is the first, 8 % too long."""
    faster = SPEED_M_S * np.where(TIME_S > 0.4, TIME_S + 0.08 * (TIME_S - 0.4), TIME_S)
    result = sewn(np.where(TIME_S > 0.42, faster[84] + SPEED_M_S * (TIME_S - 0.42), faster),
                  per_block=per_block).result("stitch_length_error")  # fmt: skip
    assert result.measured == pytest.approx(0.08, abs=1e-10)
    assert (result.status, result.note) == (Status.FAILED, "too long")
    assert (result.operation, result.job_line) == (20, 210)
    assert result.time_s == pytest.approx(0.42, abs=1e-12)
    assert result.position == pytest.approx((0.042, 0.0), abs=1e-12)


def test_exempt_stitches_are_excepted() -> None:
    """The tool starts 0.03 s late: the first stitch and half of the second fail, then none."""
    late = SPEED_M_S * np.maximum(TIME_S - 0.03, 0.0)
    full = sewn(late).result("stitch_length_error")
    assert (full.measured, full.note) == (pytest.approx(1.0, abs=1e-10), "too short")
    free = sewn(late, plan=seam(exempt=(0,))).result("stitch_length_error")
    assert free.measured == pytest.approx(0.5, abs=1e-10)
    both = sewn(late, plan=seam(exempt=(0, 1))).result("stitch_length_error")
    assert both.measured == pytest.approx(0.0, abs=1e-10)
    every = sewn(late, plan=seam(exempt=range(COUNT))).result("stitch_length_error")
    assert (every.status, every.measured) == (Status.NOT_MEASURED, None)


def test_a_needle_set_to_the_lag_sees_the_whole_start() -> None:
    """With the needle as late as the tool, even the first stitch is right."""
    late = SPEED_M_S * np.maximum(TIME_S - 0.03, 0.0)
    result = sewn(late, delay=0.03).result("stitch_length_error")
    assert result.measured == pytest.approx(0.0, abs=1e-10)


def test_placement_is_across_the_seam_at_the_needle_only() -> None:
    """A swing within one stitch is 0 at every needle-down, except for its own sine."""
    swing = 3e-4 * np.sin(2 * np.pi * TIME_S / PERIOD_S + 0.5)
    result = sewn(SPEED_M_S * (TIME_S - 0.004), swing).result("stitch_placement_error")
    # Needle-downs are on samples, where the swing is 3e-4 sin(0.5).
    assert result.measured == pytest.approx(3e-4 * np.sin(0.5), abs=1e-12)


def test_needle_time_is_against_the_programmed_speed() -> None:
    """The plan sews 50 stitches a second, and the program has 55."""
    result = sewn(SPEED_M_S * TIME_S, plan=seam(feed_hz=55.0)).result("needle_time_error")
    assert result.measured == pytest.approx(0.1, abs=1e-9)
    assert result.note == "too long"


def test_stitches_that_were_not_sewn_are_not_measured() -> None:
    verdict = sewn(SPEED_M_S * TIME_S[:100])
    for name in NAMES:
        assert verdict.result(name).status is Status.NOT_MEASURED
        assert "ends before" in verdict.result(name).note
    winding = plan_through(POINTS, move_s=PERIOD_S)
    assert "no stitches" in sewn(SPEED_M_S * TIME_S, plan=winding).result(NAMES[0]).note


def test_a_swing_within_a_stitch_is_an_error_of_speed_and_none_of_length() -> None:
    """Along the seam b sin(2 pi t / period): the speed is off by b w / v, over 5 ms by a sinc less.

    Means over a quarter of the period: |error| is at most b w / v sin(pi / 4) / (pi / 4); samples
    every 5 ms contain the one that is centred half a sample from the top: cos(pi / 4) times that.
    """
    swing_m = 4e-5
    omega = 2 * np.pi / PERIOD_S
    x = SPEED_M_S * TIME_S + swing_m * np.sin(omega * TIME_S)
    verdict = sewn(x, names=("stitch_length_error",))
    assert verdict.result("stitch_length_error").measured == pytest.approx(0.0, abs=1e-10)
    found = sewn(x, names=("stitch_speed_error",), options={"over": TICK_S})
    result = found.result("stitch_speed_error")
    sinc = np.sin(np.pi / 4) / (np.pi / 4)
    expected = swing_m * omega / SPEED_M_S * sinc * np.cos(np.pi / 4)
    assert result.measured == pytest.approx(expected, rel=1e-9)
    assert result.note in {"too fast", "too slow"}
    assert result.status is Status.FAILED


@pytest.mark.parametrize("over", [PERIOD_S, 5 * PERIOD_S, 100 * PERIOD_S])
def test_a_mean_over_whole_stitches_does_not_hide_a_swing(over: float) -> None:
    """Over whole periods of the swing it would be 0: the longest mean is a quarter of a stitch.

    The closed form is the same as in the test before. A quarter of a period is one sample here.
    """
    swing_m, omega = 4e-5, 2 * np.pi / PERIOD_S
    x = SPEED_M_S * TIME_S + swing_m * np.sin(omega * TIME_S)
    name = "stitch_speed_error"
    result = sewn(x, names=(name,), options={"over": over}).result(name)
    sinc = np.sin(np.pi / 4) / (np.pi / 4)
    expected = swing_m * omega / SPEED_M_S * sinc * np.cos(np.pi / 4)
    assert result.measured == pytest.approx(expected, rel=1e-9)
    assert result.status is Status.FAILED


def test_a_mean_over_more_than_a_dip_of_the_command_does_not_hide_it() -> None:
    """The command dips to half its speed for 0.08 s, the head follows 0.01 s behind."""
    dip = 0.5 * np.maximum(1.0 - np.abs(TIME_S - 0.4) / 0.04, 0.0)
    speed = SPEED_M_S * (1.0 - dip)
    x = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * TICK_S)])
    head = np.interp(TIME_S - 0.01, TIME_S, x)
    name = "stitches_to_speed"
    fine, coarse = (
        sewn(head, names=(name,), options={"over": over}, commanded=x).result(name)
        for over in (TICK_S, 1.0)
    )
    assert fine.measured == pytest.approx(0.0475 / PERIOD_S, abs=TICK_S / PERIOD_S)
    assert (coarse.measured, coarse.time_s) == (fine.measured, fine.time_s)


def test_the_speed_of_exempt_stitches_is_not_asked() -> None:
    late = SPEED_M_S * np.maximum(TIME_S - 0.03, 0.0)
    names, options = ("stitch_speed_error",), {"over": TICK_S}
    full = sewn(late, names=names, options=options).result(names[0])
    assert (full.measured, full.note) == (pytest.approx(1.0, abs=1e-10), "too slow")
    free = sewn(late, plan=seam(exempt=(0, 1)), names=names, options=options).result(names[0])
    assert free.measured == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("per_block", [3, 64, 1000])
@pytest.mark.parametrize("lag", [0.0, 0.02])
def test_stitches_to_speed_are_those_from_the_command_to_95_per_cent(
    per_block: int, lag: float
) -> None:
    """Command and head accelerate equally for 0.06 s, the head ``lag`` behind: 95 % in 0.057 s.

    Speeds are means over one sample of 5 ms, dated at its end, so 2.5 ms late, and straight between
    samples. The command departs at 0; its start is found where it passes the levels from 0.5 to 1.5
    % of the speed, which one count cannot cause.
    """
    ramp_s = 0.06

    def at(time_s: FloatArray) -> FloatArray:
        rising = np.clip(time_s, 0.0, ramp_s)
        return SPEED_M_S * (rising**2 / (2 * ramp_s) + np.maximum(time_s - ramp_s, 0.0))

    commanded, actual = at(TIME_S), at(TIME_S - lag)
    names = ("stitches_to_speed", "stitches_from_needle")
    verdict = sewn(
        actual, names=names, options={"over": TICK_S}, per_block=per_block, commanded=commanded,
    )  # fmt: skip
    found, needle = (verdict.result(name) for name in names)
    there_s = 0.0595 + lag
    assert needle.measured == pytest.approx(there_s / PERIOD_S, abs=1e-9)
    assert needle.note == "from the first needle-down"
    assert found.measured == pytest.approx((there_s - moved_s(commanded)) / PERIOD_S, abs=1e-4)
    assert found.time_s == pytest.approx(0.06 + lag, abs=1e-12)
    assert found.note == "from the first movement"


def moved_s(commanded: FloatArray) -> float:
    """Return the mean instant at which means over a sample pass the levels of 0.5 to 1.5 %."""
    count_m = 1.0 / load_machine("lathe-winder").axes["X"].counts.si
    speed = np.abs(np.diff(commanded, prepend=commanded[0])) / TICK_S
    most = np.maximum.accumulate(speed - count_m / TICK_S) / SPEED_M_S
    levels = np.linspace(0.005, 0.015, 20001)[1:]
    after = np.searchsorted(most, levels, side="left")
    low, high = most[after - 1], most[after]
    return float((TIME_S[after - 1] + (levels - low) / (high - low) * TICK_S).mean())


def swung(share: float) -> FloatArray:
    """Return a command that swings back for a stitch and a half, stands, and then departs."""
    fine_s = np.arange(0.0, TIME_S[-1] + 1e-9, 1e-4)
    back = np.where((fine_s > 0.02) & (fine_s < 0.05), np.sin(np.pi * (fine_s - 0.02) / 0.03), 0.0)
    speed = np.clip((fine_s - 0.06) / 0.02, 0.0, 1.0) - share * back
    way = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 1e-4)])
    return SPEED_M_S * np.interp(TIME_S, fine_s, way)


def counted(command: FloatArray) -> float:
    found = sewn(
        command, names=("stitches_to_speed",), options={"over": TICK_S}, commanded=command
    ).result("stitches_to_speed")
    return float(found.measured)


def test_a_swing_before_the_start_does_not_reset_the_clock() -> None:
    """It stands from 0.05 s to 0.06 s; a count from there would give 1.1 stitches."""
    there_s = 0.083  # means of 87.5 % at 0.08 s, and of 100 % at 0.085 s
    plain, swinging = counted(swung(0.0)), counted(swung(0.25))
    assert plain == pytest.approx((there_s - moved_s(swung(0.0))) / PERIOD_S, abs=0.03)
    assert plain < 1.2
    assert swinging == pytest.approx((there_s - moved_s(swung(0.25))) / PERIOD_S, abs=0.03)
    assert swinging > 2.6


def test_the_count_grows_little_by_little_with_a_swing() -> None:
    """Two stitches lie between the swing and the departure: 0.1 % never changes half a stitch.

    The level rises by 1 % of the speed while the count rises by the time in between.
    """
    counts = [counted(swung(share)) for share in np.arange(0.0, 0.08, 1e-3)]
    assert counts[-1] - counts[0] > 1.5
    assert np.diff(counts).min() > -1e-9
    assert np.abs(np.diff(counts)).max() < 0.3


def test_a_corner_that_is_not_stopped_in_is_left_where_it_is_slowest() -> None:
    """The command dips to half its speed, lowest at 0.4 s, within 0.04 s on both sides."""
    dip = 0.5 * np.maximum(1.0 - np.abs(TIME_S - 0.4) / 0.04, 0.0)
    speed = SPEED_M_S * (1.0 - dip)
    x = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * TICK_S)])
    found = sewn(
        x, names=("stitches_to_speed",), options={"over": TICK_S}, commanded=x,
    ).result("stitches_to_speed")  # fmt: skip
    # The lowest mean ends at 0.4 s or 0.405 s, and the means of 95 % end at 0.44 s.
    assert found.measured == pytest.approx(0.0375 / PERIOD_S, abs=TICK_S / PERIOD_S)


def test_stitches_that_share_a_piece_of_the_motion_have_times_of_their_own() -> None:
    """Two moves of the job have one label, as if pieces were longer than stitches."""
    plan = seam()

    def merged(block):
        return replace(block, operation=np.where(block.operation == 5, 6, block.operation))

    motion = plan.motion
    blocks = Stream.of([merged(block) for block in motion.trajectory])
    given = replace(
        plan, intent=replace(motion, trajectory=replace(motion.trajectory, blocks=blocks))
    )
    verdict = sewn(SPEED_M_S * TIME_S, plan=given, names=("stitch_speed_error", *NAMES))
    for name in ("stitch_speed_error", *NAMES):
        assert verdict.result(name).measured == pytest.approx(0.0, abs=1e-9)


def test_a_stitch_that_the_motion_leaves_out_fails_in_numbers() -> None:
    """Its point lies beside the previous one, off the head's path: it has no time."""
    plan = seam()
    moves = list(plan.job)
    moves[5] = replace(moves[5], target=(5 * LENGTH_M, 1e-4))
    given = replace(plan, job=replace(plan.job, operations=Stream.of(moves)))
    verdict = sewn(SPEED_M_S * TIME_S, plan=given, names=("stitch_speed_error", *NAMES))
    speed = verdict.result("stitch_speed_error")
    assert speed.status is Status.FAILED
    assert speed.measured == pytest.approx(1.0)  # and the next at twice its speed


def block_of(time_s: FloatArray, actual: FloatArray) -> Block:
    """Return a block that has the place of the tool, and nothing else."""
    names = {field.name for field in fields(Block)} - {"first", "time_s", "actual"}
    return Block(first=0, time_s=time_s, actual=actual, **dict.fromkeys(names))


def test_figures_that_nobody_asks_for_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The wanted figures are the same to the bit, and the others are not computed."""
    plan, every_s = seam(), 1e-4
    still = np.zeros((2, 2))
    recording = record(("X", "Y"), {ChannelKind.LOAD: still}, np.zeros(2))
    time_s = every_s * np.arange(450)
    actual = np.stack([SPEED_M_S * time_s, 1e-5 * np.sin(900.0 * time_s)], axis=1)[:, None, :]
    setting, block = setting_of(plan, recording), block_of(time_s, actual)
    (whole,) = StitchFollower(setting, 0.0).feed(block)
    (placed,) = StitchFollower(setting, 0.0, figures=("placement",)).feed(block)
    (swift,) = StitchFollower(setting, 0.0, figures=("speed",)).feed(block)
    # Only a call that is not there shows that a figure is not computed: the result lacks it anyway.
    monkeypatch.setattr(StitchFollower, "_speeds", None)
    monkeypatch.setattr(StitchFollower, "_placed", None)
    (plain,) = StitchFollower(setting, 0.0, figures=("length",)).feed(block)
    np.testing.assert_array_equal(plain.length_error, whole.length_error)
    np.testing.assert_array_equal(placed.placement_m, whole.placement_m)
    np.testing.assert_array_equal(swift.speed_error, whole.speed_error)
    assert np.abs(whole.speed_error).max() > 0.0 < np.abs(whole.placement_m).max()
    assert len(plain.placement_m) == len(plain.speed_error) == 0


def test_stitches_of_a_million_ticks_are_followed_in_bounded_memory() -> None:
    """Samples every 20 ns, a million in a stitch: the kept ones give the same to 1e-9."""
    plan, every_s, count = seam(), 2e-8, 50_000
    still = np.zeros((2, 2))
    recording = record(("X", "Y"), {ChannelKind.LOAD: still}, np.zeros(2))
    follower = StitchFollower(setting_of(plan, recording), 0.0)
    most, errors = 0, []
    tracemalloc.start()
    try:
        for block in range(45):
            time_s = every_s * (block * count + np.arange(count))
            actual = np.stack([SPEED_M_S * time_s, 0.0 * time_s], axis=1)[:, None, :]
            for sewn_now in follower.feed(block_of(time_s, actual)):
                errors += [sewn_now.length_error, sewn_now.speed_error]
            del time_s, actual
            most = max(most, tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    assert len(np.concatenate(errors)) == 4  # two stitches of 20 ms in 45 ms
    assert np.abs(np.concatenate(errors)).max() < 1e-9
    assert most < 2_000_000  # bytes; all samples would be 36 million for their times and places
