"""Style of every figure: readable in print, without colour and by the colour-blind."""

from __future__ import annotations

import textwrap
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

# Okabe and Ito's palette, in an order in which neighbours differ in grey value too. Every line also
# differs in dash, so that no information depends on colour.
PLANNED: dict[str, Any] = {"color": "0.45", "linestyle": (0, (6, 2)), "linewidth": 1.6}
ACTUAL: dict[str, Any] = {"color": "#0072B2", "linestyle": "-", "linewidth": 1.1}
PROGRAMMED: dict[str, Any] = {
    "color": "black",
    "linestyle": "none",
    "marker": "o",
    "markersize": 3.2,
    "markerfacecolor": "none",
    "markeredgewidth": 0.8,
}
LIMIT: dict[str, Any] = {"color": "#D55E00", "linestyle": (0, (1, 1.5)), "linewidth": 1.4}
WORST: dict[str, Any] = {
    "color": "#D55E00",
    "linestyle": "none",
    "marker": "v",
    "markersize": 8,
    "markeredgecolor": "black",
    "zorder": 5,
}
AXES: tuple[dict[str, Any], ...] = (
    {"color": "#0072B2", "linestyle": "-", "linewidth": 1.0},
    {"color": "black", "linestyle": (0, (5, 1.5)), "linewidth": 1.0},
    {"color": "0.6", "linestyle": "-", "linewidth": 2.2},
    {"color": "#009E73", "linestyle": (0, (4, 1, 1, 1)), "linewidth": 1.2},
    {"color": "#CC79A7", "linestyle": (0, (8, 2)), "linewidth": 1.2},
    {"color": "#56B4E9", "linestyle": (0, (3, 1, 1, 1, 1, 1)), "linewidth": 1.2},
)
"""Styles of several axes in one figure; none is dotted like LIMIT."""

_RC: dict[Any, Any] = {
    "figure.dpi": 110, "figure.constrained_layout.use": True, "font.family": "DejaVu Sans",
    "font.size": 9, "axes.titlesize": 10, "axes.titlelocation": "left", "axes.grid": True,
    "axes.axisbelow": True, "grid.color": "0.88", "grid.linewidth": 0.6, "axes.spines.top": False,
    "axes.spines.right": False, "legend.frameon": False, "legend.fontsize": 8,
    "svg.fonttype": "path", "svg.hashsalt": "threadline", "path.simplify": True,
    "agg.path.chunksize": 20000,
}  # fmt: skip


@contextmanager
def figure_style() -> Iterator[None]:
    """Apply the style, with a backend that needs no screen."""
    import matplotlib as mpl

    mpl.use("Agg")
    with mpl.rc_context(_RC), warnings.catch_warnings():
        # Letters missing in the font are drawn as boxes; the text of the report shows them.
        warnings.filterwarnings("ignore", message="Glyph", category=UserWarning)
        yield


def new_figure(
    size_in: tuple[float, float], rows: int = 0, columns: int = 1, **layout: Any
) -> tuple[Figure, Any]:
    """Return a figure, and its panel; with ``rows``, an array of its panels, row by row.

    Parameters
    ----------
    size_in
        Width and height, inches.
    layout
        Options of ``Figure.subplots``.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_in)
    panels = figure.subplots(rows or 1, columns, squeeze=False, **layout).ravel()
    return figure, panels if rows else panels[0]


HEAD = "head"
"""Identifier of the lines above a figure in its SVG."""
_HEAD_SIZE = 8.0  # points
_LINE_IN = 0.16
_LETTERS_PER_IN = 13.5  # letters that surely fit an inch


@contextmanager
def laid_out(figures: Iterable[Figure]) -> Iterator[None]:
    """Lay out figures once for all files that are written within the block.

    With a layout engine, matplotlib draws a figure once more for each file to lay it out. A figure
    without one would get the engine of the style again when it is saved.
    """
    import matplotlib as mpl

    figures = list(figures)
    for figure in figures:
        if figure.axes and (engine := figure.get_layout_engine()) is not None:
            engine.execute(figure)
    with mpl.rc_context({"figure.constrained_layout.use": False}):
        for figure in figures:
            figure.set_layout_engine(None)
        yield


@contextmanager
def headed(figure: Figure, lines: Sequence[str]) -> Iterator[Bbox]:
    """Write lines above a figure within the block, without a change of its size and layout.

    Parameters
    ----------
    lines
        Lines of text; they are broken at the width of the figure.

    Yields
    ------
    Bbox
        The figure and the lines above it, inches.
    """
    from matplotlib.transforms import Bbox

    width, height = figure.get_size_inches().tolist()
    letters_per_line = int(width * _LETTERS_PER_IN)
    wrapped = [part for line in lines for part in textwrap.wrap(line, letters_per_line) or [""]]
    strip_in = _LINE_IN * (len(wrapped) + 0.5)
    text = figure.text(
        0.08 / width, 1.0 + strip_in / height, "\n".join(wrapped), va="top", ha="left",
        fontsize=_HEAD_SIZE, linespacing=1.25, color="0.2", parse_math=False, gid=HEAD,
        zorder=1e3,  # drawn last: nothing else refers to its definitions
    )  # fmt: skip
    text.set_in_layout(False)
    try:
        yield Bbox.from_extents(0.0, 0.0, width, height + strip_in)
    finally:
        text.remove()
