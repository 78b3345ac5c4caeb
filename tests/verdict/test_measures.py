"""Tracking, settling, residual vibration, electrical measures, ripple and repeatability."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from threadline.errors import RecordingError
from threadline.files import Channel, ChannelKind, Clock, Recording, RecordingBlock, Stream
from threadline.verdict import Criterion, Judge, Status, blocks, judge, motion_run

from .builders import SERVO, TICK_S, follow, plan_through, record, spec_of

K = ChannelKind
POINTS = [[0.0, 0.0], [0.1, 0.0]]


def judged(channels, operation, *criteria, points=POINTS, axes=("X", "Y"), per_block=17, **more):
    recording = record(axes, channels, operation, per_block=per_block, **more)
    return judge([recording], plan_through(points, axes), spec_of(*criteria))


def test_tracking_counts_lag_and_says_when_the_encoder_had_to_do() -> None:
    """6 samples late at 5 mm per sample are 30 mm."""
    commanded, operation = follow(POINTS, 20)
    late = np.vstack([np.repeat(commanded[:1], 6, axis=0), commanded[:-6]])
    criterion = Criterion(name="tracking_error")
    verdict = judged(
        {K.COMMANDED: commanded, K.LOAD: late, K.MEASURED: commanded}, operation, criterion
    )
    assert verdict.result("tracking_error", "X").measured == pytest.approx(0.03, abs=1e-12)
    assert verdict.result("tracking_error", "X").note == ""
    assert verdict.result("tracking_error", "X").job_line == 10
    live = judged({K.COMMANDED: commanded, K.MEASURED: late}, operation, criterion, simulated=False)
    assert live.result("tracking_error", "X").measured == pytest.approx(0.03, abs=1e-12)
    assert "encoder" in live.result("tracking_error", "X").note
    assert not live.simulated


def test_a_live_machine_has_no_placement_verdict() -> None:
    commanded, operation = follow(POINTS, 20)
    names = ("contour_error", "turning_point_error", "residual_vibration", "settling_time")
    for required in (False, True):
        criteria = [Criterion(name=name, limit=1.0, required=required) for name in names]
        verdict = judged({K.COMMANDED: commanded, K.MEASURED: commanded}, operation, *criteria)
        assert {r.status for r in verdict.results} == {Status.NOT_MEASURED}
        assert all("load" in r.note for r in verdict.results)
        assert verdict.passed is not required


def test_the_tool_channel_goes_before_the_load() -> None:
    commanded, operation = follow(POINTS, 20)
    tool = commanded + np.array([0.0, 2e-4])
    verdict = judged(
        {K.COMMANDED: commanded, K.LOAD: commanded, K.TOOL: tool},
        operation,
        Criterion(name="contour_error"),
    )
    assert verdict.result("contour_error").measured == pytest.approx(2e-4, abs=1e-12)


def ringing(amplitude=2e-4, decay_s=0.1, period_s=0.07, standstill=300):
    commanded, operation = follow(POINTS, 20, standstill)
    time_s = TICK_S * np.arange(len(commanded))
    since = time_s - 20 * TICK_S
    swing = amplitude * np.exp(-since / decay_s) * np.cos(2 * np.pi * since / period_s)
    load = commanded.copy()
    load[20:, 0] += swing[20:]
    return commanded, load, operation, since, swing


def test_residual_vibration_is_half_the_peak_to_peak() -> None:
    commanded, load, operation, since, swing = ringing(decay_s=1e9, period_s=16 * TICK_S)
    channels = {K.COMMANDED: commanded, K.LOAD: load}
    plain = judged(channels, operation, Criterion(name="residual_vibration", limit=1e-3))
    assert plain.result("residual_vibration", "X").measured == pytest.approx(2e-4, abs=1e-9)
    assert plain.result("residual_vibration", "Y").measured == pytest.approx(0.0, abs=1e-12)

    commanded, load, operation, since, swing = ringing()
    window = (since > 0.1 - 1e-9) & (since < 0.25 + 1e-9)
    expected = (swing[window].max() - swing[window].min()) / 2
    windowed = Criterion(name="residual_vibration", options={"after": 0.1, "window": 0.15})
    verdict = judged({K.COMMANDED: commanded, K.LOAD: load}, operation, windowed)
    assert verdict.result("residual_vibration", "X").measured == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("name", ["residual_vibration", "settling_time"])
def test_a_recording_that_ends_soon_after_the_command_can_only_fail(name: str) -> None:
    """The load still swings at the end of the recorded 20 ms: the rest is unknown."""
    statuses = {}
    for standstill in (4, 39, 41, 300):  # samples of 5 ms
        commanded, load, operation, _, _ = ringing(decay_s=0.05, standstill=standstill)
        channels = {K.COMMANDED: commanded, K.LOAD: load}
        for limit in (1e-9, 1.0):
            verdict = judged(channels, operation, Criterion(name=name, limit=limit))
            result = verdict.result(name, "X" if name == "residual_vibration" else "")
            statuses[standstill, limit] = result.status
            if result.status is Status.NOT_MEASURED:
                assert f"goes on for {5 * standstill} ms after the command" in result.note
                assert "it needs 200 ms" in result.note
    assert {statuses[n, 1e-9] for n in (4, 39, 41, 300)} == {Status.FAILED}
    assert [statuses[n, 1.0] for n in (4, 39, 41, 300)] == [
        Status.NOT_MEASURED, Status.NOT_MEASURED, Status.PASSED, Status.PASSED,
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["residual_vibration", "settling_time"])
@pytest.mark.parametrize("standstill", [4, 39, 41, 300])
def test_runs_side_by_side_pass_by_what_was_seen_as_one_run_does(name, standstill) -> None:
    """A yield counts no machine as good whose load was recorded for too short a time."""
    commanded, load, operation, _, _ = ringing(decay_s=0.05, standstill=standstill)
    recording = record(("X", "Y"), {K.COMMANDED: commanded, K.LOAD: load}, operation)
    plan = plan_through(POINTS, ("X", "Y"))
    for limit in (1e-9, 1.0):
        spec = spec_of(Criterion(name=name, limit=limit, required=True))
        one_by_one, (beside,) = (
            judge([recording], plan, spec),
            Judge(plan, spec).each(recording).passed,
        )
        assert beside == one_by_one.passed == (limit == 1.0 and standstill > 40)


def test_a_band_beyond_all_motion_is_settled_in_at_once() -> None:
    commanded, load, operation, _, _ = ringing()
    criterion = Criterion(name="settling_time", options={"band": 1e9})
    verdict = judged({K.COMMANDED: commanded, K.LOAD: load}, operation, criterion)
    assert verdict.result("settling_time").measured == 0.0


@pytest.mark.parametrize("per_block", [1, 7, 1000])
def test_residual_vibration_is_told_at_the_instant_that_completes_the_swing(per_block: int) -> None:
    """It is the later of highest and lowest sample, wherever blocks begin."""
    commanded, load, operation, since, swing = ringing(decay_s=0.5)
    channels = {K.COMMANDED: commanded, K.LOAD: load}
    for sign in (1.0, -1.0):
        channels[K.LOAD] = np.where(since[:, None] < 0, load, commanded + sign * (load - commanded))
        verdict = judged(
            channels, operation, Criterion(name="residual_vibration"), per_block=per_block
        )
        after = np.flatnonzero((since >= 0) & (since <= 1.0))
        last = max(after[swing[after].argmax()], after[swing[after].argmin()])
        result = verdict.result("residual_vibration", "X").time_s
        assert result == pytest.approx(TICK_S * last, abs=1e-9)


@pytest.mark.long(only="1")
@pytest.mark.parametrize("per_block", [1, 17, 90, 1000])
def test_short_blocks_are_joined_and_measure_the_same(
    per_block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    commanded, load, operation, _, _ = ringing(standstill=3000)
    names = ("contour_error", "turning_point_error", "tracking_error", "residual_vibration",
             "settling_time")  # fmt: skip
    criteria = [Criterion(name=name) for name in names]
    fed: list[int] = []
    judged_blocks = motion_run.judged_blocks

    def counted(*recording):
        for block in judged_blocks(*recording):
            fed.append(len(block.time_s))
            yield block

    monkeypatch.setattr(motion_run, "judged_blocks", counted)
    found = []
    for few, copied in ((0, 0), (1024, 60_000)):
        monkeypatch.setattr(blocks, "FEW", few)
        monkeypatch.setattr(blocks, "COPIED", copied)
        fed.clear()
        channels = {K.COMMANDED: commanded, K.LOAD: load}
        found.append(judged(channels, operation, *criteria, per_block=per_block).results)
    assert found[0] == found[1]
    assert sum(fed) == len(commanded) and min(fed[:-1]) >= 1024


@pytest.mark.parametrize("per_block", [1, 7, 1000])
def test_settling_time_is_when_the_load_last_comes_into_the_band(per_block: int) -> None:
    commanded, load, operation, since, swing = ringing()
    band = 3e-5
    last = np.flatnonzero((np.abs(swing) > band) & (since > 0))[-1]
    criterion = Criterion(name="settling_time", options={"band": band})
    verdict = judged(
        {K.COMMANDED: commanded, K.LOAD: load}, operation, criterion, per_block=per_block
    )
    # The load moves in a straight line from the last sample outside the band to the next one.
    out, inside = np.abs(swing[last]), np.abs(swing[last + 1])
    assert swing[last] * swing[last + 1] > 0.0
    entered = since[last] + TICK_S * (out - band) / (out - inside)
    assert verdict.result("settling_time").measured == pytest.approx(entered, abs=1e-9)

    never = Criterion(name="settling_time", limit=10.0, options={"band": 1e-12})
    verdict = judged({K.COMMANDED: commanded, K.LOAD: load}, operation, never, per_block=per_block)
    assert verdict.result("settling_time").status is Status.FAILED

    short = 21
    cut = judged(
        {K.COMMANDED: commanded[:short], K.LOAD: load[:short]}, operation[:short], criterion
    )
    assert cut.result("settling_time").status is Status.NOT_MEASURED


def test_settling_is_by_the_distance_at_the_tool() -> None:
    """Off by 0.8 of the band in both axes for 30 samples: by 1.13 of it at the tool."""
    commanded, operation = follow(POINTS, 20)
    load = commanded.copy()
    load[20:51] += 0.8e-4
    criterion = Criterion(name="settling_time", options={"band": 1e-4})
    verdict = judged({K.COMMANDED: commanded, K.LOAD: load}, operation, criterion)
    # From 1.13 of the band to 0 within a sample interval.
    inside = 30 + 1 - 1 / (0.8 * np.sqrt(2))
    assert verdict.result("settling_time").measured == pytest.approx(inside * TICK_S, abs=1e-9)
    # A acts at a radius of 0.1 m: a tenth of the angle in rad counts.
    turned = commanded.copy()
    turned[20:51, 1] += 0.8e-3
    channels = {K.COMMANDED: commanded, K.LOAD: turned}
    found = judged(channels, operation, criterion, axes=("X", "A")).result("settling_time")
    assert found.measured == pytest.approx(0.0, abs=1e-9)


def test_a_pause_within_the_job_is_not_the_end() -> None:
    """The load is off during the pause and calm after the end: no vibration is left."""
    points = [[0.0, 0.0], [0.05, 0.0], [0.05, 0.0], [0.1, 0.0]]
    commanded, operation = follow(points, 20)
    load = commanded.copy()
    load[25:35, 0] += 1e-3
    channels = {K.COMMANDED: commanded, K.LOAD: load}
    criteria = (Criterion(name="residual_vibration"), Criterion(name="settling_time"))
    verdict = judged(channels, operation, *criteria, points=points)
    assert verdict.result("residual_vibration", "X").measured == pytest.approx(0.0, abs=1e-12)
    assert verdict.result("settling_time").measured == pytest.approx(0.0, abs=1e-12)


def test_currents() -> None:
    commanded, operation = follow(POINTS, 20)
    time_s = TICK_S * np.arange(len(commanded))
    current = np.column_stack([-3.0 * np.sin(2 * np.pi * time_s / 0.1), np.zeros(len(time_s))])
    current = current[:41]  # two whole periods of 20 intervals
    channels = {K.COMMANDED: commanded[: len(current)], K.CURRENT: current}
    criteria = (Criterion(name="current_peak", limit=2.9), Criterion(name="current_rms"))
    verdict = judged(channels, operation[: len(current)], *criteria)
    assert verdict.result("current_peak", "X").measured == pytest.approx(3.0, rel=1e-12)
    assert verdict.result("current_peak", "X").status is Status.FAILED
    assert verdict.result("current_peak", "X").time_s == pytest.approx(0.025)
    # Straight from sample to sample, the mean square of a sine is this share of a half: summed over
    # a period, a^2 + a b + b^2 is the amplitude squared times (2 + cos of the angle) / 2.
    share = (2 + np.cos(2 * np.pi * TICK_S / 0.1)) / 3
    rms = 3 * np.sqrt(share / 2)
    assert verdict.result("current_rms", "X").measured == pytest.approx(rms, rel=1e-12)
    assert verdict.result("current_rms", "X").position is None  # it covers the whole run


def test_dac_saturation_counts_samples_at_either_clamp() -> None:
    """12 bit over +-10 V: 2047 levels up, 2048 down; one level below the clamp is free."""
    commanded, operation = follow(POINTS, 20)
    level = 20 / 4096
    voltage = np.zeros_like(commanded)
    voltage[5:9, 0] = 2047 * level
    voltage[12, 0] = -2048 * level
    voltage[13, 0] = 2046 * level
    criterion = Criterion(name="dac_saturation", limit=0.0)
    verdict = judged({K.COMMANDED: commanded, K.VOLTAGE: voltage}, operation, criterion)
    result = verdict.result("dac_saturation", "X")
    assert result.measured == pytest.approx(5 / len(commanded), rel=1e-12)
    assert result.status is Status.FAILED
    assert result.time_s == pytest.approx(5 * TICK_S)
    assert verdict.result("dac_saturation", "Y").status is Status.PASSED


def test_velocity_ripple_away_from_corners() -> None:
    """v (1 + e cos wt) over a difference of one sample: e sin(x)/x, x = w T / 2."""
    points = [[0.0, 0.0], [1.0, 0.0]]
    samples = 400
    time_s = TICK_S * np.arange(samples + 1)
    plan = plan_through(points, move_s=samples * TICK_S)
    speed, e, w = 1.0 / (samples * TICK_S), 0.05, 2 * np.pi / 0.1
    x = speed * (time_s + e / w * np.sin(w * time_s))
    load = np.column_stack([x, np.zeros_like(x)])
    recording = record(("X", "Y"), {K.LOAD: load}, np.zeros(samples + 1))
    criterion = Criterion(name="velocity_ripple", options={"over": TICK_S})
    found = judge([recording], plan, spec_of(criterion)).result("velocity_ripple")
    half = w * TICK_S / 2
    # No sample falls exactly on the crest: off by at most half a sample, cos(w T / 2).
    assert found.measured == pytest.approx(e * np.sin(half) / half, rel=1 - np.cos(half))
    assert found.unit == ""


@pytest.mark.parametrize("factor", [1.03, 0.97])
def test_velocity_ripple_on_chords_that_go_straight_on(factor: float) -> None:
    """3 % too fast or slow on 200 short chords: the lag is 20 of them; the end is exempt."""
    points = [[k * 5e-3, 0.0] for k in range(201)]
    commanded, operation = follow(points, 1)
    load = commanded * factor
    plan = plan_through(points, move_s=TICK_S, vertices_per_block=17)
    recording = record(("X", "Y"), {K.COMMANDED: commanded, K.LOAD: load}, operation)
    found = judge([recording], plan, spec_of(Criterion(name="velocity_ripple")))
    assert found.result("velocity_ripple").measured == pytest.approx(0.03, abs=1e-9)


@pytest.mark.parametrize(
    ("third", "lost"),
    [
        # 4 samples are 2 and 2 of two legs at a right angle: sqrt(1/2) of the way.
        ([0.5, 0.5], 1.0 - np.sqrt(0.5)),
        # Straight on at a fifth of the speed; the way to the first sample there had 5 times that.
        ([0.6, 0.0], 4.0),
    ],
)
def test_velocity_ripple_is_exempt_beside_a_corner_and_a_new_speed(third, lost) -> None:
    """The load is on its command: only samples that span two chords differ."""
    points = [[0.0, 0.0], [0.5, 0.0], third]
    commanded, operation = follow(points, 100)
    plan = plan_through(points, move_s=100 * TICK_S)
    recording = record(("X", "Y"), {K.COMMANDED: commanded, K.LOAD: commanded}, operation)
    criterion = Criterion(name="velocity_ripple", options={"over": 4 * TICK_S})
    for lag, expected in ((4, 0.0), (0, lost)):
        found = judge([recording], plan, spec_of(criterion, lag_s=lag * TICK_S))
        assert found.result("velocity_ripple").measured == pytest.approx(expected, abs=1e-9)


def runs(count: int, scale: float = 5e-5):
    commanded, operation = follow(POINTS, 20)
    rng = np.random.default_rng(3)
    loads = [commanded + rng.normal(scale=scale, size=commanded.shape) for _ in range(count)]
    return loads, [
        record(("X", "Y"), {K.COMMANDED: commanded, K.LOAD: load}, operation, per_block=13)
        for load in loads
    ]


def test_repeatability_is_the_farthest_run_from_the_mean() -> None:
    loads, recordings = runs(20)
    plan = plan_through(POINTS)
    spec = spec_of(Criterion(name="repeatability", limit=1e-4))
    stacked = np.stack(loads)
    away = np.linalg.norm(stacked - stacked.mean(axis=0), axis=2)
    result = judge(recordings, plan, spec).result("repeatability")
    run, sample = np.unravel_index(away.argmax(), away.shape)
    assert result.measured == pytest.approx(away.max(), abs=1e-15)
    assert result.time_s == pytest.approx(sample * TICK_S)
    assert result.note == f"recording {run + 1}"
    for few in (1, 19):
        one_by_one = judge(recordings[:few], plan, spec).result("repeatability")
        assert one_by_one.status is Status.NOT_MEASURED
        assert str(few) in one_by_one.note


def test_worst_of_several_recordings_counts() -> None:
    commanded, operation = follow(POINTS, 20)
    recordings = [
        record(("X", "Y"), {K.LOAD: commanded + np.array([0.0, off])}, operation)
        for off in (1e-4, 4e-4, 2e-4)
    ]
    spec = spec_of(Criterion(name="contour_error", limit=3e-4))
    verdict = judge(recordings, plan_through(POINTS), spec)
    assert verdict.result("contour_error").measured == pytest.approx(4e-4, abs=1e-12)
    assert not verdict.passed


def test_channels_of_another_clock_are_held_until_their_next_sample() -> None:
    """Load at 1 ms, command at 5 ms: the command is held for five samples of the load."""
    fast = Clock("fast", Fraction(1, 1000))
    command = np.arange(10.0) * 1e-3
    load = np.repeat(command, 5)
    load[23] += 7e-4

    def channel(name, kind, clock):
        return Channel(name=name, kind=kind, unit="m", clock=clock, axis="X")

    blocks = [
        RecordingBlock(
            first_tick={"servo": first, "fast": 5 * first},
            samples={
                "c": command[first : first + 4],
                "l": load[5 * first : 5 * (first + 4)],
            },
        )
        for first in (0, 4, 8)
    ]
    recording = Recording(
        channels=(channel("c", K.COMMANDED, SERVO), channel("l", K.LOAD, fast)),
        blocks=Stream.of(blocks),
        job_sha256="job",
        machine_sha256="",
        simulated=True,
    )
    spec = spec_of(Criterion(name="tracking_error"))
    found = judge([recording], plan_through([[0.0], [0.009]], ("X",)), spec)
    assert found.result("tracking_error").measured == pytest.approx(7e-4, abs=1e-12)
    assert found.result("tracking_error").time_s == pytest.approx(0.023)


def test_damaged_and_foreign_recordings_are_refused() -> None:
    commanded, operation = follow(POINTS, 20)
    plan, spec = plan_through(POINTS), spec_of(Criterion(name="contour_error"))
    broken = commanded.copy()
    broken[30, 0] = np.inf
    with pytest.raises(RecordingError, match=r"not finite.*Repair"):
        judge([record(("X", "Y"), {K.LOAD: broken}, operation)], plan, spec)
    with pytest.raises(RecordingError, match="another job"):
        judge([record(("X", "Y"), {K.LOAD: commanded}, operation, job_sha256="other")], plan, spec)
    with pytest.raises(RecordingError, match="no recording"):
        judge([], plan, spec)
    with pytest.raises(RecordingError, match="no position"):
        judge([record(("Z",), {K.LOAD: commanded[:, :1]}, operation)], plan, spec)


def test_an_angle_is_no_length() -> None:
    """Half a degree of a linear axis would be 8.7 mm."""
    commanded, operation = follow(POINTS, 20)
    plan, spec = plan_through(POINTS), spec_of(Criterion(name="contour_error"))
    recording = record(("X", "Y"), {K.LOAD: commanded}, operation)
    turned = replace(
        recording,
        channels=tuple(
            replace(c, unit="rad") if c.name == "Y.load" else c for c in recording.channels
        ),
    )
    with pytest.raises(RecordingError, match=r"'Y.load' is in rad.*Y of .* is linear.*mm"):
        judge([turned], plan, spec)


def test_the_window_of_residual_vibration_has_both_its_ends() -> None:
    """On a clock of 1/8 s instants are exact: from 0.5 to 1.0 s after the end at 2.5 s.

    A place that counts differs from the rest by its own amount; the measure is half of the largest.
    """
    eighth = Clock("eighth", Fraction(1, 8))
    commanded, operation = follow(POINTS, 20, standstill=20)
    plan = plan_through(POINTS, move_s=2.5)
    options = {"after": 0.5, "window": 0.5}
    spec = spec_of(Criterion(name="residual_vibration", options=options), lag_s=1.0)

    def half_swing(sample: int, options_of=spec) -> float | None:
        load = commanded.copy()
        load[sample, 0] += 1e-3
        made = record(("X", "Y"), {K.COMMANDED: commanded, K.LOAD: load}, operation, clock=eighth)
        return judge([made], plan, options_of).result("residual_vibration", "X").measured

    inside = [sample for sample in range(15, 40) if half_swing(sample) == pytest.approx(5e-4)]
    assert inside == [24, 25, 26, 27, 28]
    # From the end on: from the sample at which the command arrives to the next one the load moves
    # in a straight line, so the first of the two counts.
    whole = spec_of(
        Criterion(name="residual_vibration", options={"after": 0.0, "window": 0.5}), lag_s=1.0
    )
    inside = [s for s in range(15, 40) if half_swing(s, whole) == pytest.approx(5e-4)]
    assert inside == [20, 21, 22, 23, 24]


def test_values_between_samples_do_not_depend_on_their_number() -> None:
    """The same straight lines with 1, 2 and 5 samples each: closed forms, equal up to rounding.

    The window of the residual vibration begins and ends between two samples of the first.
    """
    commanded, load, operation, _, _ = ringing()
    time_s = TICK_S * np.arange(len(commanded))
    current = 2.0 * np.sin(37.0 * time_s)[:, None] * [1.0, 0.3]
    options = {"after": 0.0123, "window": 0.0777}
    criteria = (
        Criterion(name="residual_vibration", options=options),
        Criterion(name="settling_time", options={"band": 3e-5}),
        Criterion(name="current_rms"),
    )
    found = []
    for parts in (1, 2, 5):
        at = np.arange(parts * (len(commanded) - 1) + 1)
        finely = {
            kind: np.column_stack([np.interp(at / parts, time_s / TICK_S, v) for v in values.T])
            for kind, values in {K.COMMANDED: commanded, K.LOAD: load, K.CURRENT: current}.items()
        }
        clock = Clock("finer", Fraction(5, 1000 * parts))
        recording = record(("X", "Y"), finely, operation[at // parts], per_block=13, clock=clock)
        verdict = judge([recording], plan_through(POINTS), spec_of(*criteria))
        found.append([r.measured for r in verdict.results])
    assert found[0][0] > 1e-4
    assert None not in found[0]
    for finer in found[1:]:
        assert finer == pytest.approx(found[0], rel=1e-9, abs=1e-15)
