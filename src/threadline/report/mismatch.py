"""The figure of the fastest feed in spec over the tolerances of a machine's masses and links."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from threadline.report.style import AXES, figure_style
from threadline.search.mismatch import Mismatch, Searched
from threadline.writing import staging_folder

_NAMES = {-1.0: "lower end", 0.0: "as in the file", 1.0: "upper end"}


def draw_mismatch(cells: Sequence[Mismatch], title: str, searched: Searched) -> Figure:
    """Return a figure: the fastest in spec over stiffness, a line for each mass."""
    with figure_style():
        figure = Figure(figsize=(5.6, 3.4))
        axes, gaps = figure.add_subplot(), False
        for style, mass in zip(AXES, sorted({cell.mass for cell in cells}), strict=False):
            row = sorted((c for c in cells if c.mass == mass), key=lambda cell: cell.stiffness)
            axes.plot(
                [cell.stiffness for cell in row],
                [_drawn(cell, searched) for cell in row],
                marker="o",
                label=f"loads: {_NAMES[mass]}",
                **style,
            )
            below = [
                (cell.stiffness, searched.per_unit * one.high)
                for cell in row
                for one in sorted(cell.intervals, key=lambda one: -one.high)[1:]
            ]
            if below:
                axes.plot(*zip(*below, strict=True), "o", mfc="white", mec=style["color"])
                gaps = True
        if gaps:
            axes.plot([], [], "o", mfc="white", mec="0.3", label="end of a slower range in spec")
        axes.set_xticks(list(_NAMES), [f"springs: {name}" for name in _NAMES.values()])
        axes.set_ylim(bottom=0.0)
        axes.set_ylabel(f"{searched.best} in spec, {searched.unit}")
        axes.set_title(title)
        if any(cell.best for cell in cells):
            axes.legend(loc="lower center")
        else:
            axes.set_ylim(0.0, 1.0)
            axes.set_yticks([0.0])
            said = _nothing(cells, searched.name)
            axes.text(0.5, 0.5, said, transform=axes.transAxes, ha="center", va="center")
    return figure


def _drawn(cell: Mismatch, searched: Searched) -> float:
    return searched.nothing if cell.best is None else searched.per_unit * cell.best


def _nothing(cells: Sequence[Mismatch], what: str) -> str:
    """Return the text for a figure without points: no machine is in spec, and which limit fails."""
    limits = dict.fromkeys(cell.limited_by.replace("_", " ") for cell in cells)
    failing = " and ".join(limits)
    return f"no {what} is in spec on any of the {len(cells)} machines:\n{failing} fails at all"


def write_mismatch(cells: Sequence[Mismatch], title: str, searched: Searched, folder: Path) -> Path:
    """Write the figure into ``folder`` as PNG and SVG; return the path of the PNG."""
    figure = draw_mismatch(cells, title, searched)
    with staging_folder(folder) as temporary:
        figure.savefig(temporary / "tolerances.png")
        figure.savefig(temporary / "tolerances.svg", metadata={"Date": None})
    return folder / "tolerances.png"
