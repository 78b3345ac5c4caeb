"""The picture of a seam: its counts, and its legibility without colour."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from threadline.machine import load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, prove
from threadline.report import seam
from threadline.report.proof import write_report
from threadline.report.seam import seam_figure
from threadline.report.style import figure_style
from threadline.search.report_data import report_data
from threadline.verdict import load_spec, sewn_stitches

SEAM = """
[stitching]
stitch_length = "2.5 mm"
needle_speed = "60 stitch/s"
motion = "discrete"

[[contour]]
unit = "mm"
points = [[0, 0], [40, 0], [40, 20]]
"""


@pytest.fixture(scope="module")
def proof(tmp_path_factory: pytest.TempPathFactory) -> Proof:
    file = tmp_path_factory.mktemp("seam") / "corner.seam.toml"
    file.write_text(SEAM)
    machine = load_machine("stitcher")
    return prove(file, machine, load_spec(None, machine), Options())


def test_marks_are_the_stitches_and_differ_in_shape_or_size(proof: Proof) -> None:
    with figure_style():
        figure = seam_figure(proof, proof.recording)
        assert figure is not None
        panel = figure.axes[0]
    counts = [int(str(c.get_label()).rsplit(":", 1)[1]) for c in panel.collections]
    sewn = list(sewn_stitches(proof.plan, proof.recording, 0.018))
    assert sum(counts) == sum(len(run.stitches) for run in sewn)
    assert counts[-1] > 0  # at 60 a second the stitcher as built misses its corner
    looks = {(c.get_paths()[0].vertices.tobytes(), c.get_sizes()[0]) for c in panel.collections}
    assert len(looks) == len(panel.collections)
    # Areas grow with a stitch's used share of its limit.
    assert sorted(c.get_sizes()[0] for c in panel.collections) == [
        c.get_sizes()[0] for c in panel.collections
    ]


def test_thinned_seam_figure_draws_the_worst_stitch_and_counts_all(
    proof: Proof, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With room for five of them: each number beside the marks, and the place of the worst."""

    def drawn() -> tuple[list[str], list[float], int]:
        with figure_style():
            figure = seam_figure(proof, proof.recording)
        assert figure is not None
        plan, graph = figure.axes
        labels = [str(c.get_label()) for c in plan.collections]
        (worst,) = [line for line in plan.lines if str(line.get_label()).startswith("worst")]
        labels.append(str(worst.get_label()))
        return labels, worst.get_xydata()[0].tolist(), len(graph.lines[0].get_xdata())

    every, place, count = drawn()
    monkeypatch.setattr(seam, "MAX_DRAWN", 5)
    monkeypatch.setattr(seam, "ABOUT", 1)
    few, same_place, fewer = drawn()
    assert same_place == place
    assert set(few) <= set(every)
    assert few[-1] == every[-1]
    assert fewer <= 8 < count


def test_the_worst_stitch_is_that_of_the_verdict(proof: Proof) -> None:
    sewn = list(sewn_stitches(proof.plan, proof.recording, 0.018))
    exempt = np.concatenate([run.stitches.exempt for run in sewn])
    off = np.abs(np.concatenate([run.length_error[:, 0] for run in sewn]))
    found = proof.verdict.result("stitch_length_error")
    assert found.measured == pytest.approx(off[~exempt].max(), abs=1e-12)
    placement = np.concatenate([run.placement_m for run in sewn])
    assert placement.max() <= (proof.verdict.result("contour_error").measured or 0.0) + 1e-9


@pytest.mark.long(shown_by="test_the_worst_stitch_is_that_of_the_verdict")
def test_the_report_has_the_picture(proof: Proof, tmp_path: Path) -> None:
    page = write_report(report_data(proof), tmp_path / "report")
    assert (tmp_path / "report" / "report-seam.png").stat().st_size > 10_000
    assert "needle-down" in page.read_text(encoding="utf-8")
    assert mpl.get_backend().lower() == "agg"
