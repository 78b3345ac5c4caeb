"""What is drawn of a long job: thinned, and yet with its worst place where it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.options import Options, parse_feed
from threadline.pipeline import Proof, plan_job, prove_plan
from threadline.report.figures import all_figures
from threadline.report.style import figure_style
from threadline.report.traces import AROUND_SAMPLES, MAX_SAMPLES, collect
from threadline.verdict import judge, load_spec

AT = 12_345  # of 30 000 samples, alone
OFF_M = 0.02


@pytest.fixture(scope="module")
def proof(tmp_path_factory: pytest.TempPathFactory) -> Proof:
    """150 s to and fro between two points; then one sample of Y is put 20 mm aside."""
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
    return replace(clean, recording=recording, verdict=judge([recording], plan, spec))


def whole(proof: Proof, axis: str) -> np.ndarray:
    channel = f"{axis}.load"
    return np.concatenate([block.samples[channel] for block in proof.recording])


def test_a_single_sample_is_marked_where_and_when_it_was(proof: Proof) -> None:
    """Its place is that of the recording, to the rounding of a division by the tick.

    Every tenth sample or so is drawn: without its own place it stood as far away as the machine
    goes in some ticks, and the peak was not in the picture.
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


def test_the_trace_about_it_is_whole(proof: Proof) -> None:
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
    """The extremes of the whole recording and of what is drawn are the same, to the bit."""
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
