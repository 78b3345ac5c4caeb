"""Without its channel a measure is not measured, axis by axis, and nothing passes for it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.made import Made
from threadline.files import Channel, ChannelKind, RecordingBlock, Stream
from threadline.verdict import Criterion, Result, Status, closing, judge, verdict_json
from threadline.verdict.measure import Finding
from threadline.verdict.registry import MEASURES
from threadline.verdict.samples import Setting

from .builders import follow, plan_through, record, spec_of

K = ChannelKind
XY = ("X", "Y")
POINTS = [[0.0, 0.0], [0.1, 0.05], [0.0, 0.0]]
NEEDS = {
    "turning_point_error": (K.LOAD,),
    "tracking_error": (K.COMMANDED, K.LOAD),
    "residual_vibration": (K.COMMANDED, K.LOAD),
    "dac_saturation": (K.VOLTAGE,),
    "current_peak": (K.CURRENT,),
    "current_rms": (K.CURRENT,),
    "step_loss": (K.TORQUE_SHARE,),
}


def columns(without: ChannelKind | None, axis: int) -> dict[ChannelKind, np.ndarray]:
    """Return every kind of channel of both axes except one, without any error."""
    commanded, _ = follow(POINTS, 20)
    found = {
        K.COMMANDED: commanded.copy(),
        K.LOAD: commanded.copy(),
        K.VOLTAGE: np.zeros_like(commanded),
        K.CURRENT: np.zeros_like(commanded),
        K.TORQUE_SHARE: np.zeros_like(commanded),
    }
    if without is not None:
        found[without][:, axis] = np.nan
    return found


def test_every_measure_of_single_axes_of_a_recording_is_in_this_table() -> None:
    """This is about machines with a path; stitches and cycles have tests of their own."""
    of_axes = {
        name
        for name, kind in MEASURES.items()
        for reading in kind.reads
        if kind.per_axis and getattr(reading, "run", None) is Setting and reading.needs
    }
    assert set(NEEDS) == of_axes


@pytest.mark.parametrize("lacking", [0, 1])
@pytest.mark.parametrize(("name", "kind"), [(n, k) for n, kinds in NEEDS.items() for k in kinds])
def test_an_axis_without_the_channel_is_not_measured_and_the_other_is(name, kind, lacking) -> None:
    _, operation = follow(POINTS, 20)
    plan = plan_through(POINTS, XY)
    spec = spec_of(Criterion(name=name, limit=1.0, required=True))
    verdict = judge([record(XY, columns(kind, lacking), operation)], plan, spec)
    hidden, seen = verdict.result(name, XY[lacking]), verdict.result(name, XY[1 - lacking])

    assert hidden.status is Status.NOT_MEASURED and hidden.measured is None
    assert f"channel of {XY[lacking]}" in hidden.note
    # The command has ended once the command of every axis has.
    ends = name == "residual_vibration" and kind is K.COMMANDED
    assert seen.status is (Status.NOT_MEASURED if ends else Status.PASSED)
    assert not verdict.passed
    assert "NOT PROVEN" in closing(verdict)
    # With the channel there is no failure.
    assert judge([record(XY, columns(None, 0), operation)], plan, spec).passed
    answer = json.loads(json.dumps(verdict_json(verdict, plan), allow_nan=False))
    assert answer["passed"] is False


def test_a_clamped_axis_cannot_be_hidden() -> None:
    """One sample in twenty of X is at the clamp; without X.voltage that is unknown."""
    found = columns(None, 0)
    found[K.VOLTAGE][::20, 0] = 10.0
    _, operation = follow(POINTS, 20)
    plan = plan_through(POINTS, XY)
    spec = spec_of(Criterion(name="dac_saturation", limit=0.0, required=True))
    assert (
        closing(judge([record(XY, found, operation)], plan, spec)) == "OUT OF SPEC (nominal: 1 run)"
    )
    found[K.VOLTAGE][:, 0] = np.nan
    hidden = judge([record(XY, found, operation)], plan, spec)
    assert closing(hidden) == "NOT PROVEN (nominal: 1 run): dac saturation was not measured"


@pytest.mark.parametrize("order", [1, -1])
def test_criterion_is_not_measured_if_one_recording_lacks_its_channel(order: int) -> None:
    _, operation = follow(POINTS, 20)
    whole = record(XY, columns(None, 0), operation)
    bare = record(XY, {K.LOAD: columns(None, 0)[K.LOAD]}, operation)
    verdict = judge(
        [whole, bare][::order],
        plan_through(POINTS, XY),
        spec_of(Criterion(name="dac_saturation", limit=0.0)),
    )
    assert {r.status for r in verdict.results} == {Status.NOT_MEASURED}


def test_the_peak_between_samples_of_one_axis_leaves_the_samples_of_the_other() -> None:
    """X has a peak of 3 A between samples of 1 A; Y has samples of 2 A and no such channel."""
    found = columns(None, 0)
    found[K.CURRENT][:, 0], found[K.CURRENT][:, 1] = 1.0, 2.0
    bare = record(XY, found, None)
    clock = bare.channels[0].clock
    peak = Channel(name="X.current_peak", kind=K.CURRENT, unit="A", clock=clock, axis="X")

    def blocks():
        for block in bare:
            count = len(block.samples["X.current"])
            yield RecordingBlock(
                first_tick=block.first_tick,
                samples={**block.samples, "X.current_peak": np.full(count, -3.0)},
            )

    made = replace(bare, channels=(*bare.channels, peak), blocks=Made(blocks))
    verdict = judge([made], plan_through(POINTS, XY), spec_of(Criterion(name="current_peak")))
    assert verdict.result("current_peak", "X").measured == 3.0
    assert verdict.result("current_peak", "Y").measured == 2.0


@pytest.mark.parametrize("value", [float("nan"), float("inf"), float("-inf")])
@pytest.mark.parametrize("unit", ["m", "s", ""])
def test_no_result_is_anything_but_a_number_or_never(value: float, unit: str) -> None:
    def result(measured: float | None) -> Result:
        return Result(
            name="settling_time",
            axis="",
            measured=measured,
            limit=1.0,
            unit=unit,
            status=Status.FAILED,
        )

    finding = Finding(value=value, axis="X", note="of a test")
    if unit == "s" and value == float("inf"):
        assert result(value).severity[1] == value
        assert finding.in_unit(unit) is finding
        return
    with pytest.raises(ValueError, match=r"settling_time .* is no result"):
        result(value)
    assert finding.in_unit(unit).value is None
    assert finding.in_unit(unit).note == "of a test; no number came of these samples"
    assert result(None).measured is None and result(0.5).measured == 0.5


def test_tracking_error_needs_the_command_of_every_axis() -> None:
    """X.commanded is absent: Y's command alone is not a place."""
    _, operation = follow(POINTS, 20)
    found = columns(K.COMMANDED, 0)
    found[K.LOAD][30, 1] += 1e-3
    plan = plan_through(POINTS, XY)
    verdict = judge([record(XY, found, operation)], plan, spec_of(Criterion(name="tracking_error")))
    off = verdict.result("tracking_error", "Y")
    assert off.measured == pytest.approx(1e-3)
    assert off.time_s is not None and off.position is None
    json.dumps(verdict_json(verdict, plan), allow_nan=False)


@pytest.mark.parametrize(("peak", "expected"), [(3.0, 5.0), (7.0, 7.0)])
def test_a_peak_that_is_less_than_a_sample_hides_nothing(peak: float, expected: float) -> None:
    """A sample of 5 A beside a channel of peaks of 3 A: one of them is wrong, and 5 A count."""
    found = columns(None, 0)
    found[K.CURRENT][30, 0] = -5.0
    bare = record(XY, found, None, per_block=1000)
    (block,) = bare
    channel = Channel(
        name="X.current_peak", kind=K.CURRENT, unit="A", clock=bare.channels[0].clock, axis="X"
    )
    samples = {**block.samples, "X.current_peak": np.full(len(block.samples["X.current"]), peak)}
    made = replace(
        bare,
        channels=(*bare.channels, channel),
        blocks=Stream.of([RecordingBlock(first_tick=block.first_tick, samples=samples)]),
    )
    verdict = judge([made], plan_through(POINTS, XY), spec_of(Criterion(name="current_peak")))
    assert verdict.result("current_peak", "X").measured == expected


@pytest.mark.parametrize(("x", "y", "binds"), [(1.0, 2.0, "Y"), (3.0, 2.0, "X")])
def test_the_peak_of_current_names_the_axis_that_binds(x: float, y: float, binds: str) -> None:
    """Each drive of the winder gives 4 A."""
    found = columns(None, 0)
    found[K.CURRENT][10], found[K.CURRENT][20] = (x, 0.0), (0.0, -y)
    plan = plan_through(POINTS, XY)
    limits = {a: plan.machine.drive_of(a).amplifier.current_limit for a in XY}
    assert {a: limit.si for a, limit in limits.items() if limit is not None} == {"X": 4, "Y": 4}
    verdict = judge([record(XY, found, None)], plan, spec_of(Criterion(name="current_peak")))
    notes = {a: verdict.result("current_peak", a).note for a in XY}
    drives = {a: plan.machine.controller_of(a).drive for a in XY}
    assert notes["X"].startswith(f"{25 * x:g} % of the 4 A of drives.{drives['X']}")
    assert notes["Y"].startswith(f"{25 * y:g} % of the 4 A of drives.{drives['Y']}")
    other = "X" if binds == "Y" else "Y"
    assert notes[binds].endswith(", the axis that binds")
    assert notes[other].endswith(f"; {binds} binds")
