"""If a sample of the motion is missing, the criterion is not measured; times only increase.

The motion runs from 0 to 0.8 s, X forth and back, with a sample every 5 ms, and stands still for
0.2 s after it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from threadline.errors import RecordingError
from threadline.files import Channel, ChannelKind, Clock, Recording, RecordingBlock, Stream
from threadline.verdict import Criterion, Status, closing, judge

from .builders import SERVO, TICK_S, follow, plan_through, record, spec_of

K = ChannelKind
XY = ("X", "Y")
POINTS = [[0.0, 0.0], [0.2, 0.0], [0.0, 0.0]]
PER_MOVE = 80
OF_POSITION = ("contour_error", "turning_point_error", "tracking_error", "velocity_ripple")
NAMES = (*OF_POSITION, "dac_saturation", "current_peak", "current_rms", "settling_time")
SPEC = spec_of(*(Criterion(name=name, limit=1.0, required=True) for name in NAMES))
Change = Callable[[int, int, Mapping[str, np.ndarray]], tuple[int, Mapping[str, np.ndarray]] | None]


def run(error_m: float = 0.0) -> Recording:
    """Return a run with all channels; Y is off by ``error_m`` from 0.3 to 0.35 s."""
    commanded, operation = follow(POINTS, PER_MOVE)
    load = commanded.copy()
    load[60:71, 1] += error_m
    nothing = np.zeros_like(commanded)
    channels = {K.COMMANDED: commanded, K.LOAD: load, K.VOLTAGE: nothing, K.CURRENT: nothing}
    return record(XY, channels, operation, per_block=10)


def changed(recording: Recording, change: Change) -> Recording:
    """Return the recording with its blocks changed by number, first tick and samples."""
    blocks = []
    for number, block in enumerate(recording):
        made = change(number, block.first_tick["servo"], block.samples)
        if made is not None:
            blocks.append(RecordingBlock(first_tick={"servo": made[0]}, samples=made[1]))
    return replace(recording, blocks=Stream.of(blocks))


def plan():
    return plan_through(POINTS, XY, move_s=PER_MOVE * TICK_S)


def statuses(recording: Recording, spec=SPEC) -> dict[str, Status]:
    verdict = judge([recording], plan(), spec)
    return {f"{r.name} {r.axis}".strip(): r.status for r in verdict.results}


def test_a_whole_run_is_measured() -> None:
    verdict = judge([run()], plan(), SPEC)
    assert {r.status for r in verdict.results} == {Status.PASSED}
    assert closing(verdict).startswith("IN SPEC (nominal: 1 run; ")


@pytest.mark.parametrize("cut", [slice(6, 8), slice(3, 12)])
def test_blocks_that_are_missing_hide_no_error(cut: slice) -> None:
    """5 mm off for 50 ms, with these blocks cut out: the remaining samples are on the path."""
    off = run(5e-3)
    strict = spec_of(*(Criterion(name=n, limit=5e-4, required=True) for n in OF_POSITION[:3]))
    assert not judge([off], plan(), strict).passed
    gone = set(range(100)[cut])
    holed = changed(off, lambda n, first, samples: None if n in gone else (first, samples))
    verdict = judge([holed], plan(), strict)
    assert {r.status for r in verdict.results} == {Status.NOT_MEASURED}
    begin, end = cut.start * 10 * TICK_S, cut.stop * 10 * TICK_S
    message = f"no samples from {begin:g} s to {end:g} s"
    assert all(message in r.note for r in verdict.results)
    assert closing(verdict).startswith("NOT PROVEN")


def test_a_gap_of_one_channel_is_one_of_what_needs_it() -> None:
    def shorter(number, first, samples):
        part = samples["X.voltage"][:4] if number == 5 else samples["X.voltage"]
        return first, {**samples, "X.voltage": part}

    found = statuses(changed(run(), shorter))
    assert found.pop("dac_saturation X") is Status.NOT_MEASURED
    assert set(found.values()) == {Status.PASSED}

    def ends(number, first, samples):
        part = samples["X.voltage"][:0] if number >= 5 else samples["X.voltage"]
        return first, {**samples, "X.voltage": part}

    verdict = judge([changed(run(), ends)], plan(), SPEC)
    assert verdict.result("dac_saturation", "X").status is Status.NOT_MEASURED
    assert "X.voltage ends at 0.245 s, the motion" in verdict.result("dac_saturation", "X").note
    assert verdict.result("dac_saturation", "Y").status is Status.PASSED


def test_operations_with_a_gap_are_no_operations_there() -> None:
    def shorter(number, first, samples):
        part = samples["operation"][: 4 if number == 5 else None]
        return first, {**samples, "operation": part}

    found = statuses(changed(run(), shorter))
    assert found["contour_error"] is found["turning_point_error X"] is Status.NOT_MEASURED
    assert found["dac_saturation X"] is found["tracking_error X"] is Status.PASSED


def test_a_gap_where_all_others_are_taken_is_one_of_all() -> None:
    """The load of X is the first channel: without it nothing is judged in that block."""

    def without(number, first, samples):
        return first, {**samples, "X.load": samples["X.load"][: 0 if number == 5 else None]}

    assert set(statuses(changed(run(), without)).values()) == {Status.NOT_MEASURED}


@pytest.mark.parametrize(
    ("first", "words"),
    [
        (lambda n, first: first - 1 if n == 5 else first, r"begins at 0\.245 s.*until 0\.245 s"),
        (lambda n, first: 0 if n == 5 else first, r"begins at 0 s.*until 0\.245 s"),
        (lambda n, first: first - 3, r"begins at -0\.015 s, before the commands"),
        (lambda n, first: 200 - first, "go on until"),
    ],
)
def test_blocks_that_overlap_or_go_back_are_refused(first, words: str) -> None:
    moved = changed(run(), lambda n, at, samples: (first(n, at), samples))
    for operations in (True, False):
        if not operations:
            channels = tuple(c for c in moved.channels if c.kind is not K.OPERATION)
            moved = replace(moved, channels=channels, simulated=False)
        with pytest.raises(RecordingError, match=words) as caught:
            judge([moved], plan(), SPEC)
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("ticks", "seen"), [(0, True), (1, True), (2, False), (100, False)])
def test_a_recording_that_begins_late(ticks: int, seen: bool) -> None:
    """One sample may be missing at either end, because a logger starts at its own time."""

    def later(number, first, samples):
        if first + 10 <= ticks:
            return None
        skip = max(ticks - first, 0)
        return first + skip, {name: values[skip:] for name, values in samples.items()}

    late = changed(run(), later)
    rows = {**statuses(late)}
    assert (Status.NOT_MEASURED in rows.values()) is not seen
    if not seen:
        assert set(rows.values()) == {Status.NOT_MEASURED}
        note = judge([late], plan(), SPEC).result("current_rms", "X").note
        assert f"begins at {ticks * TICK_S:g} s" in note


@pytest.mark.parametrize(("last", "seen"), [(170, True), (160, True), (158, False), (60, False)])
def test_a_recording_that_ends_early(last: int, seen: bool) -> None:
    """The motion ends with sample 160; later samples may be missing, if none is needed."""

    def shorter(number, first, samples):
        left = max(last + 1 - first, 0)
        return (first, {n: v[:left] for n, v in samples.items()}) if left else None

    found = judge([changed(run(), shorter)], plan(), SPEC)
    for name in ("contour_error", "tracking_error", "dac_saturation", "current_rms"):
        result = found.result(name)
        assert (result.status is Status.PASSED) is seen, name
        assert seen or f"ends at {last * TICK_S:g} s, the motion at 0.8 s" in result.note


def test_a_run_that_is_faster_than_its_plan_is_whole() -> None:
    """At twice the feed it ends in 0.4 s; its operations and its command say so."""
    commanded, operation = follow(POINTS, PER_MOVE // 2, standstill=2)
    fast = record(XY, {K.COMMANDED: commanded, K.LOAD: commanded}, operation)
    spec = spec_of(*(Criterion(name=n, limit=1e-6) for n in OF_POSITION[:3]))
    assert set(statuses(fast, spec).values()) == {Status.PASSED}
    # Half of it is incomplete, although it stands at the start, where the job ends.
    back = [POINTS[0], POINTS[0], POINTS[2]]
    stands, operation = follow(back, PER_MOVE // 2, standstill=2)
    half = record(XY, {K.COMMANDED: stands, K.LOAD: stands}, 0.0 * operation)
    assert set(statuses(half, spec).values()) == {Status.NOT_MEASURED}


def test_failure_in_one_recording_is_not_hidden_by_an_incomplete_one() -> None:
    """One run is 5 mm off; the other lacks the channel, or ends early."""
    spec = spec_of(Criterion(name="contour_error", limit=5e-4))
    off, bare = run(5e-3), run()
    bare = replace(bare, channels=tuple(c for c in bare.channels if c.name != "X.load"))
    for both in ([off, bare], [bare, off]):
        result = judge(both, plan(), spec).result("contour_error")
        assert result.status is Status.FAILED
        assert result.measured == pytest.approx(5e-3)
        assert "no tool or load channel of X" in result.note
    for both in ([run(), bare], [bare, run()]):
        assert judge(both, plan(), spec).result("contour_error").status is Status.NOT_MEASURED


def test_runs_that_all_have_the_same_gap_do_not_repeat_themselves() -> None:
    spec = spec_of(Criterion(name="repeatability", limit=1e-4, options={"recordings": 2.0}))
    whole = [run(), run(1e-5)]
    assert judge(whole, plan(), spec).passed
    assert judge(whole, plan(), spec).result("repeatability").status is Status.PASSED
    holed = [
        changed(r, lambda n, first, samples: None if n == 6 else (first, samples)) for r in whole
    ]
    result = judge(holed, plan(), spec).result("repeatability")
    assert result.status is Status.NOT_MEASURED
    assert "no samples from 0.3 s to 0.35 s" in result.note


def test_nothing_of_a_finer_voltage_is_lost_between_the_samples_of_the_load() -> None:
    """Voltage every 1 ms, load every 5 ms: one clamped sample lies between two of the load."""
    commanded, operation = follow(POINTS, PER_MOVE)
    fine = Clock("fine", Fraction(1, 1000))
    bare = record(XY, {K.COMMANDED: commanded, K.LOAD: commanded}, operation, per_block=7)
    for clamped in (0, 123, 124, 125, 126, 1000):
        volts = np.zeros(5 * len(commanded))
        volts[clamped] = -10.0

        blocks = []
        for block in bare:
            first = block.first_tick["servo"]
            count = len(block.samples["X.load"])
            part = volts[5 * first : 5 * (first + count)]
            blocks.append(
                RecordingBlock(
                    first_tick={"servo": first, "fine": 5 * first},
                    samples={**block.samples, "X.voltage": part},
                )
            )

        channel = Channel(name="X.voltage", kind=K.VOLTAGE, unit="V", clock=fine, axis="X")
        made = replace(bare, channels=(*bare.channels, channel), blocks=Stream.of(blocks))
        spec = spec_of(Criterion(name="dac_saturation", limit=0.0))
        result = judge([made], plan(), spec).result("dac_saturation", "X")
        # Samples after the last sample of the load come after the end.
        last = 5 * (len(commanded) - 1)
        assert (result.status is Status.FAILED) is (clamped <= last), clamped
        if clamped <= last:
            assert result.measured == pytest.approx(1 / len(commanded))
            assert result.time_s == pytest.approx(-(-clamped // 5) * 5e-3)
    assert SERVO.period_s == 5 * fine.period_s


def test_a_channel_that_goes_on_alone_is_not_judged_in_part() -> None:
    """100 A after the last position: the current was not judged to its end."""

    def alone(number: int, first: int, samples: Mapping[str, np.ndarray]):
        if number < 17:  # the motion ends with block 16
            return first, samples
        ended = {name: values[:0] for name, values in samples.items() if ".load" in name}
        return first, {**samples, **ended, "X.current": samples["X.current"] + 100.0}

    recording = changed(run(), alone)
    verdict = judge([recording], plan(), SPEC)
    results = {f"{r.name} {r.axis}".strip(): r for r in verdict.results}
    assert not verdict.passed
    assert results["current_peak X"].status is Status.NOT_MEASURED
    assert "X.current goes on until" in results["current_peak X"].note
