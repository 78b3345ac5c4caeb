"""The figure of a yield: the distribution of every criterion over the machines, and its limit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from threadline.arrays import FloatArray
from threadline.report.style import ACTUAL, LIMIT, PLANNED, figure_style
from threadline.search.machine_yield import Yield
from threadline.search.yield_rows import limited_rows
from threadline.writing import staging_folder

_MOST = 8
_POINTS = 400


def draw_yield(found: Yield, title: str) -> Figure:
    """Return a figure with the cumulative distribution of each criterion that has a limit."""
    rows = limited_rows(found)[:_MOST]
    with figure_style():
        figure = Figure(figsize=(7.2, 1.2 + 1.5 * max((len(rows) + 1) // 2, 1)))
        panels = figure.subplots((len(rows) + 1) // 2 or 1, 2, squeeze=False).ravel()
        for panel, row in zip(panels, rows, strict=False):
            values, share = _up_to(row.values)
            assert row.limit is not None
            scale = row.limit or 1.0
            panel.step(100.0 * values / scale, 100.0 * share, where="post", **ACTUAL)
            panel.axvline(100.0 if row.limit else 0.0, **LIMIT)
            panel.axhline(100.0 * (1.0 - (row.failed | row.missed).mean()), **PLANNED)
            panel.set_title(row.text)
            panel.set_xlabel("share of the limit [%]")
            panel.set_ylabel("machines up to [%]")
            panel.set_ylim(0.0, 102.0)
        for panel in panels[len(rows) :]:
            panel.set_axis_off()
        figure.suptitle(title, x=0.02, ha="left", fontsize=10)
    return figure


def _up_to(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return at most ``_POINTS`` values, and the share of machines up to each."""
    known = np.sort(values[np.isfinite(values)])
    if not len(known):
        return known, known
    at = np.unique(np.linspace(0, len(known) - 1, _POINTS).astype(np.int64))
    return known[at], (at + 1.0) / len(values)


def write_yield(found: Yield, title: str, folder: Path) -> Path:
    """Write the figure into ``folder`` as PNG and SVG; return the path of the PNG."""
    figure = draw_yield(found, title)
    with staging_folder(folder) as temporary:
        figure.savefig(temporary / "yield.png")
        figure.savefig(temporary / "yield.svg", metadata={"Date": None})
    return folder / "yield.png"
