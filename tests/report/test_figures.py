"""The figures of a proof and of a comparison."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from threadline.jobs import read_job
from threadline.machine import load_machine
from threadline.proof.option_words import parse_feed
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, plan_job, prove_plan
from threadline.report.comparison import overlays
from threadline.report.figures import all_figures
from threadline.report.style import figure_style
from threadline.report.traces import collect, contour_along
from threadline.verdict import load_spec

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


def proof_of(name: str, interpolation: str, feed: str | None = None) -> Proof:
    machine = load_machine("lathe-winder")
    options = Options(interpolation=interpolation, feed=None if feed is None else parse_feed(feed))
    job = read_job(EXAMPLES / name, machine)
    return prove_plan(plan_job(job, machine, options), load_spec(None, machine))


@pytest.fixture(scope="module")
def winding() -> Proof:
    return proof_of("cone-dome-cylinder.prg", "linear")


def test_the_error_along_the_job_peaks_where_the_judge_says(winding: Proof) -> None:
    """The maximum of the curve is the measured contour error, at its time.

    On a straight path at a corner the tool leaves the chord, and no point is missed by more. The
    curve takes the samples; the judge also measures between them, where the way deviates by less
    than 1 nm at this peak.
    """
    along = contour_along(winding.recording, winding.plan, winding.spec.lag_s)
    assert along is not None
    time_s, error_m = along
    worst = winding.verdict.result("contour_error")
    assert worst.note == ""
    assert worst.measured - 1e-9 < error_m.max() <= worst.measured
    assert 0.0 <= time_s[error_m.argmax()] - worst.time_s < 5e-3  # a tick
    assert (np.diff(time_s) > 0).all()
    assert 1000 < len(time_s) <= 2001


def test_a_recording_without_load_has_no_curve(winding: Proof) -> None:
    channels = tuple(c for c in winding.recording.channels if c.kind not in {"load", "tool"})
    bare = replace(winding.recording, channels=channels)
    assert contour_along(bare, winding.plan, winding.spec.lag_s) is None


def test_the_figure_marks_the_worst_place_with_its_line(winding: Proof) -> None:
    worst = winding.verdict.result("contour_error")
    with figure_style():
        figures = all_figures(winding, collect(winding))
    panel = figures["errors"].axes[0]
    labels = panel.get_legend_handles_labels()[1]
    assert any(f"at line {worst.job_line}" in label for label in labels)
    (marker,) = [line for line in panel.lines if line.get_marker() == "v"]
    assert marker.get_xydata()[0] == pytest.approx([worst.time_s, worst.measured * 1e3])
    for figure in figures.values():
        for axes in figure.axes:
            assert axes.get_ylabel() or axes.get_title(loc="left") == "Criteria with a limit"
        assert "[" in figure.axes[-1].get_xlabel()


def test_a_comparison_shows_over_travel_at_the_turn() -> None:
    """At 180 mm: linear 0.46 mm short, the plain spline 8.6, pulled in none; all in one picture."""
    cases = []
    for name in ("linear", "b-spline", "b-spline-pulled"):
        proof = proof_of("x-180.prg", name, "10 count/tick")
        cases.append((name, proof, collect(proof)))
    with figure_style():
        figures, captions = overlays(cases)
    assert list(figures) == list(captions) == ["turning-X"]
    (panel,) = figures["turning-X"].axes
    assert panel.get_title(loc="left").endswith("X turning at 180 mm")
    highest = [line.get_ydata().max() for line in panel.lines[:3]]
    assert highest == pytest.approx([-0.463, -8.573, 0.001], abs=2e-3)


def test_traces_are_differences_over_the_ticks_of_the_recording() -> None:
    """Their sums are the positions and speeds again; 10 counts a tick are 36.13 mm/s."""
    traces = collect(proof_of("x-180.prg", "linear", "10 count/tick"))
    assert traces.stride == 1
    tick_s = 0.005
    assert np.diff(traces.time_s) == pytest.approx(tick_s, rel=1e-9)
    position, speed = traces.actual["X"], traces.velocity["X"]
    assert np.cumsum(speed) * tick_s == pytest.approx(position - position[0], abs=1e-9)
    assert np.cumsum(traces.acceleration["X"]) * tick_s == pytest.approx(speed, abs=1e-9)
    assert np.median(np.abs(speed)) == pytest.approx(10 / 55.358e3 / tick_s, rel=0.01)


def test_the_turn_that_is_missed_by_most_is_shown_also_at_the_low_end(tmp_path: Path) -> None:
    """100 mm to the left and back: as short of it as on the right, and the start is met."""
    job = tmp_path / "left.prg"
    job.write_text("G91 G1 X -100 F 2160\nX 100\nM30\n")
    machine = load_machine("lathe-winder")
    options = Options(interpolation="linear", feed=parse_feed("10 count/tick"))
    proof = prove_plan(plan_job(read_job(job, machine), machine, options), load_spec(None, machine))
    with figure_style():
        figures, _ = overlays([("linear", proof, collect(proof))])
    (panel,) = figures["turning-X"].axes
    assert panel.get_title(loc="left").endswith("X turning at -100 mm")
    # A count is 0.018 mm.
    assert panel.lines[0].get_ydata().max() == pytest.approx(-0.463, abs=0.04)


def test_a_comparison_shows_the_path_of_the_eye(winding: Proof) -> None:
    with figure_style():
        figures, _ = overlays([("linear", winding, collect(winding))])
    assert list(figures) == ["turning-X", "turning-Y", "paths-XY"]
    programmed = figures["paths-XY"].axes[0].lines[-1].get_xydata()
    assert programmed.min(axis=0) == pytest.approx([-101.4, 0.0], abs=0.1)
    assert programmed.max(axis=0) == pytest.approx([331.4, 75.4], abs=0.1)


def test_a_name_in_a_script_that_the_font_lacks_is_drawn_without_a_warning(tmp_path: Path) -> None:
    """The suite turns warnings into errors; from Python a user would see a line for each."""
    with figure_style():
        from matplotlib.figure import Figure

        figure = Figure()
        figure.suptitle("K\u00e4fig \u7e54")
        figure.savefig(tmp_path / "title.svg")
    assert (tmp_path / "title.svg").stat().st_size > 1000
