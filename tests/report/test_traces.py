"""Pictures of a long job: thinned, but with the worst place where it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, Trials, plan_job, prove_plan
from threadline.report.figures import all_figures
from threadline.report.style import figure_style
from threadline.report.traces import (
    AROUND_SAMPLES,
    MAX_SAMPLES,
    collect,
    envelope,
    scale_to_run_rate,
)
from threadline.verdict import judge, load_spec

AT = 12_345  # of 30 000 samples, alone
OFF_M = 0.02


@pytest.fixture(scope="module")
def proof(tmp_path_factory: pytest.TempPathFactory) -> Proof:
    """150 s forth and back between two points; then one sample of Y is moved 20 mm aside."""
    job = tmp_path_factory.mktemp("long") / "long.prg"
    job.write_text("G91 G1 X 100 Y 50 F 2160\nX -100 Y -50\n" * 24 + "M30\n")
    machine, spec = load_machine("lathe-winder"), None
    options = Options(interpolation="linear", feed=parse_feed("10 count/tick"))
    plan = plan_job(read_job(job, machine), machine, options)
    spec = load_spec(None, machine)
    clean = prove_plan(plan, spec)
    blocks, done = [], 0
    for block in clean.recording:
        samples = dict(block.samples)
        load = samples["Y.load"].copy()
        if done <= AT < done + len(load):
            load[AT - done] += OFF_M
        done += len(load)
        blocks.append(replace(block, samples=samples | {"Y.load": load}))
    assert done > 1.2 * MAX_SAMPLES
    recording = replace(clean.recording, blocks=blocks)
    return replace(
        clean,
        recording=recording,
        judged=(recording,),
        verdict=judge([recording], plan, spec),
    )


def whole(proof: Proof, axis: str) -> np.ndarray:
    channel = f"{axis}.load"
    return np.concatenate([block.samples[channel] for block in proof.recording])


def test_a_single_sample_is_marked_where_and_when_it_was(proof: Proof) -> None:
    """Its place is that of the recording, to the rounding of a division by the tick.

    About every tenth sample is drawn: without its own place the mark stood as far away as the
    machine goes in some ticks, and the peak was not in the picture.
    """
    worst = proof.verdict.result("contour_error")
    tick_s = 0.005
    assert worst.time_s == pytest.approx(AT * tick_s, abs=1e-9)
    there_mm = [1e3 * whole(proof, axis)[AT] for axis in ("X", "Y")]
    traces = collect(proof)
    assert traces.stride > 1
    with figure_style():
        figures = all_figures(proof, traces)
    for panel in figures["path-XY"].axes:
        (mark,) = [line for line in panel.lines if line.get_marker() == "v"]
        assert mark.get_xydata()[0] == pytest.approx(there_mm, abs=1e-6)
    (mark,) = [line for line in figures["errors"].axes[0].lines if line.get_marker() == "v"]
    assert mark.get_xydata()[0] == pytest.approx([AT * tick_s, 1e3 * worst.measured], abs=1e-6)


def test_trace_near_the_worst_place_keeps_every_sample(proof: Proof) -> None:
    """Every sample near the place is in the lower panel, joined; the upper one draws points."""
    traces = collect(proof)
    with figure_style():
        above, below = all_figures(proof, traces)["path-XY"].axes
    recorded = np.stack([whole(proof, axis) for axis in ("X", "Y")], axis=1) * 1e3
    near = recorded[AT - 500 : AT + 501]
    line = next(line for line in below.lines if line.get_label() == "actual")
    drawn = line.get_xydata()
    (at,) = np.flatnonzero(np.isclose(drawn, recorded[AT], atol=1e-9).all(axis=1))
    np.testing.assert_allclose(drawn[at - 500 : at + 501], near, atol=1e-9)
    assert line.get_linestyle() == "-"
    dots = next(line for line in above.lines if line.get_label() == "actual")
    assert (dots.get_linestyle(), dots.get_marker()) == ("None", ".")
    assert len(traces.time_s) < 2 * MAX_SAMPLES
    assert traces.whole.sum() >= 2 * AROUND_SAMPLES


def test_peaks_of_a_single_sample_stay_in_every_profile(proof: Proof) -> None:
    """The extremes of the whole recording and of the drawn curve are the same, to the bit."""
    traces = collect(proof)
    for axis in ("X", "Y"):
        position = whole(proof, axis)
        speed = np.diff(position) / 0.005
        assert traces.actual[axis].max() == position.max()
        assert traces.actual[axis].min() == position.min()
        assert traces.velocity[axis].max() == pytest.approx(speed.max(), rel=1e-12)
        assert traces.velocity[axis].min() == pytest.approx(speed.min(), rel=1e-12)
        bend = np.diff(position, 2) / 0.005**2
        assert traces.acceleration[axis].max() == pytest.approx(bend.max(), rel=1e-12)
    assert (np.diff(traces.time_s) > 0).all()


def test_peaks_of_the_plan_stay_in_every_profile(proof: Proof) -> None:
    """The extremes of the trajectory at all ticks of the recording are in the drawn curve."""
    traces = collect(proof)
    motion = proof.plan.motion.trajectory
    at_s = 0.005 * np.arange(len(whole(proof, "X")))
    for derivative in range(3):
        expected = motion(at_s, derivative)
        for axis in ("X", "Y"):
            drawn, every = traces.planned[axis][:, derivative], expected[:, motion.axes.index(axis)]
            assert drawn.max() == pytest.approx(every.max(), rel=1e-9, abs=1e-12)
            assert drawn.min() == pytest.approx(every.min(), rel=1e-9, abs=1e-12)


def test_profiles_of_a_long_job_are_bands(proof: Proof) -> None:
    """The single sample that is 20 mm aside is inside the band of its time, and so is the plan."""
    traces = collect(proof)
    with figure_style():
        top = all_figures(proof, traces)["profile-Y"].axes[0]
    low, high = (line.get_xydata() for line in top.lines[:2])
    at = np.searchsorted(low[:, 0], AT * 0.005, side="right") - 1
    assert low[at, 1] <= 1e3 * whole(proof, "Y")[AT] <= high[at, 1]
    assert len(low) < 1000
    (band,) = top.collections
    assert band.get_label() == "planned"


def test_a_band_holds_every_sample_and_no_more() -> None:
    """Compared with a search through all samples, of random values with gaps."""
    random = np.random.default_rng(7)
    time_s = np.cumsum(random.uniform(0.1, 1.0, 5000))
    values = random.normal(size=5000)
    values[100:105] = np.nan
    begin_s, low, high = envelope(time_s, values, 90)
    for k in range(len(begin_s) - 1):
        last = k + 2 == len(begin_s)
        inside = (time_s >= begin_s[k]) & ((time_s <= begin_s[k + 1]) | last)
        assert (low[k], high[k]) == (np.nanmin(values[inside]), np.nanmax(values[inside]))


def test_the_run_with_the_worst_place_is_drawn(examples: Path) -> None:
    """If runs are judged one by one, the worst place is the same as in all together."""
    machine = load_machine("lathe-winder")
    options = Options(interpolation="linear", feed=parse_feed("80 mm/s"))
    plan = plan_job(read_job(examples / "x-180.prg", machine), machine, options)
    spec = load_spec(None, machine)
    proof = prove_plan(plan, spec, None, Trials(repeats=6))
    one_by_one = [judge([proof.run(k)], plan, spec).result("contour_error") for k in range(1, 7)]
    worst = proof.verdict.result("contour_error")
    errors_m = [result.measured for result in one_by_one]
    assert worst.run == int(np.argmax(errors_m)) + 1 != 1
    assert (worst.measured, worst.time_s) == (max(errors_m), one_by_one[worst.run - 1].time_s)
    traces = collect(proof)
    assert traces.run.number == worst.run
    assert traces.run.words(proof) == (
        f" Drawn is run {worst.run} of 6, in which contour_error is worst."
    )
    load = next(iter(proof.run(worst.run))).samples["X.load"]
    np.testing.assert_array_equal(traces.actual["X"][: len(load)], load)
    with figure_style():
        errors = all_figures(proof, traces)["errors"].axes[1]
    (label,) = [t.get_text() for t in errors.get_legend().get_texts() if "worst" in t.get_text()]
    tracking = proof.verdict.result("tracking_error", "X")
    assert (f"in run {tracking.run} of 6" in label) is (tracking.run != worst.run)


def test_a_plan_that_is_passed_slowly_has_the_speed_that_is_passed_at() -> None:
    """For x = sin p at p = t - 0.3 sin t, whose derivatives by t are known."""
    every_s = 1e-3
    time_s = np.arange(0.0, 4.0, every_s)
    due_s = time_s - 0.3 * np.sin(time_s)
    planned = np.stack([np.sin(due_s), np.cos(due_s), -np.sin(due_s)], axis=1)[:, :, None]
    scale_to_run_rate(planned, due_s - time_s, every_s)
    rate, change = 1.0 - 0.3 * np.cos(time_s), 0.3 * np.sin(time_s)
    velocity = np.cos(due_s) * rate
    acceleration = -np.sin(due_s) * rate**2 + np.cos(due_s) * change
    inner = slice(2, -2)
    assert np.abs(planned[inner, 1, 0] - velocity[inner]).max() < 1e-6
    assert np.abs(planned[inner, 2, 0] - acceleration[inner]).max() < 1e-5
