"""The picture of the region in spec around a design: its marks, and its axes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from threadline.machine import load_machine
from threadline.report.design import region_figure
from threadline.report.style import figure_style
from threadline.search.design_proof import Candidate
from threadline.search.design_search import Region


def candidate(belt: float, load: float) -> Candidate:
    return Candidate(
        factors={"belt": belt, "load": load}, cost=0.0, ratio=0.9, nominal=0.9, binding="x",
        crossover_hz=None, phase_margin_deg=None, acceleration=1.0, smoothing_s=None, delay_s=None,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("span", "expected"),
    [
        ((1.0, 100.0), [1.0, 3.0, 10.0, 30.0, 100.0]),
        ((0.9, 1.3), [0.9, 1.0, 1.1, 1.2, 1.3]),
    ],
)
def test_marks_stand_clear_and_axes_have_figures(
    span: tuple[float, float], expected: list[float]
) -> None:
    """The design stands where the machine does, in the corner: a star in a ring, off the title."""
    factors = (np.geomspace(*span, 9), np.geomspace(0.5, 1.0, 9))
    across, up = np.meshgrid(*factors)
    ratio = 1.3 * up / across**0.3
    region = Region(
        names=("belt", "load"), factors=factors, found=ratio, unchanged=ratio, others={}
    )
    corner = candidate(span[0], 1.0)
    result = SimpleNamespace(
        machine=load_machine("stitcher"),
        job=SimpleNamespace(name="a seam"),
        region=region,
        screened="1 run",
        as_built=corner,
        found=SimpleNamespace(candidate=corner),
        known={},
    )
    with figure_style():
        figure = region_figure(result)  # type: ignore[arg-type]
        figure.canvas.draw()
    (panel,) = figure.axes
    star, ring = panel.lines[-2:]
    assert (star.get_marker(), ring.get_marker()) == ("*", "o")
    assert ring.get_markersize() > star.get_markersize()
    assert ring.get_markerfacecolor() == "none"
    x, y = panel.transData.transform((span[0], 1.0))
    half = ring.get_markersize() / 2 * figure.dpi / 72
    box = panel.get_window_extent()
    assert box.x0 < x - half and y + half < box.y1
    assert panel.get_xticks().tolist() == pytest.approx(expected)
    assert panel.get_yticks().tolist() == pytest.approx([0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    messages = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "in spec; lines: worst of its limit" in messages
