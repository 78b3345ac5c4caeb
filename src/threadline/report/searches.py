"""Figures of position steps, of a yield, and of the fastest settings of machines that differ."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from threadline.base.arrays import FloatArray
from threadline.base.writing import staging_folder
from threadline.report.document import Table
from threadline.report.style import ACTUAL, AXES, LIMIT, PLANNED, WORST, figure_style
from threadline.search.experiments import Campaign, StepRun
from threadline.search.machine_yield import Yield, limited_rows
from threadline.search.mismatch import Mismatch, Searched

if TYPE_CHECKING:
    from matplotlib.axes import Axes


NOTHING_TRIED: Mapping[str, Campaign] = MappingProxyType({})
"""No experiments: for a report without ``--experiments``."""
_LATEST_S = 3.0  # latest time that is drawn
_STILL = 0.02  # deviation from the end of a step, as a share of it, that counts as rest


def experiment_figure(campaign: Campaign) -> tuple[Figure, str]:
    """Return a figure of the position steps of an axis, and its caption.

    The upper panels show the positions of motor and load over time, divided by the step. The lower
    panels show the largest current and the overshoot of the load over the size of the step.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 6.4), layout="constrained")
    grid = figure.subplots(2, 2)
    forward_steps = sorted((s for s in campaign.steps if s[0] > 0), key=lambda step: step[0])
    shades = np.linspace(0.75, 0.0, len(forward_steps))
    shown_s = 0.0
    for (step_rad, run), shade in zip(forward_steps, shades, strict=True):
        label = f"{step_rad / np.pi:.4g} pi rad"
        for axes, share in ((grid[0, 0], run.share), (grid[0, 1], run.load_share)):
            axes.plot(run.time_s, share, color=str(shade), lw=0.9, label=label)
        outside = np.flatnonzero(np.abs(run.load_share - 1.0) > _STILL)
        shown_s = max(shown_s, float(run.time_s[outside[-1]]) if len(outside) else 0.0)
    for axes, output in ((grid[0, 0], "motor"), (grid[0, 1], "load")):
        axes.axhline(1.0, color="0.6", lw=0.6)
        axes.set_xlim(0.0, min(1.05 * shown_s, _LATEST_S))
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"{output}, share of the step")
    grid[0, 1].legend(fontsize=6, loc="lower right")
    _over_size(grid[1, 0], campaign, lambda run: run.peak_current_a)
    current_limit_a = max(
        (run.peak_current_a for _, run in campaign.steps if run.saturated), default=None
    )
    if current_limit_a is not None:
        grid[1, 0].axhline(current_limit_a, label="limit", **LIMIT)
        grid[1, 0].legend(fontsize=6, loc="lower right")
    grid[1, 0].set_ylabel("largest current [A]")
    _over_size(grid[1, 1], campaign, lambda run: 100.0 * run.load_overshoot)
    grid[1, 1].set_ylabel("overshoot of the load [%]")
    grid[1, 1].legend(fontsize=6, loc="upper right")
    figure.suptitle(f"Axis {campaign.axis}: steps of the simulated machine, quantised")
    onset = campaign.saturates_from_rad
    limited = "no step reaches the current limit" if onset is None else (
        f"the current is limited from {onset:.3f} rad on"
    )  # fmt: skip
    return figure, f"Forward steps of the motor; larger steps are darker; {limited}."


def _over_size(axes: Axes, campaign: Campaign, of: Callable[[StepRun], float]) -> None:
    """Draw ``of(run)`` over the size of the step: one curve for each direction."""
    back_style = {**WORST, "markersize": 6}
    for sign, label, style in (
        (1, "forth", {**ACTUAL, "marker": "o", "markersize": 3}),
        (-1, "back", back_style),
    ):
        points = [(abs(size), of(run)) for size, run in campaign.steps if sign * size > 0]
        if points:
            sizes, values = zip(*sorted(points), strict=True)
            axes.semilogx(np.array(sizes) / np.pi, values, label=label, **style)
    ticks = 2.0 ** np.arange(-3, 4)
    axes.set_xticks(ticks, ["1/8", "1/4", "1/2", "1", "2", "4", "8"])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("step of the motor [pi rad]")


def experiment_table(campaign: Campaign) -> Table:
    """Return the table of the position steps of an axis; its note has sweep and constant speed."""
    title, header, rows = campaign.table()
    return Table(title=title, header=tuple(header), rows=rows, note=campaign.summary())


_MOST = 8  # largest number of criteria drawn
_POINTS = 400  # largest number of points of a curve


def draw_yield(found: Yield, title: str) -> Figure:
    """Return a figure: for each criterion with a limit, its distribution over the machines."""
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
    """Return at most ``_POINTS`` sorted values, and for each the share of machines up to it."""
    measured = np.sort(values[np.isfinite(values)])
    if not len(measured):
        return measured, measured
    indices = np.unique(np.linspace(0, len(measured) - 1, _POINTS).astype(np.int64))
    return measured[indices], (indices + 1.0) / len(values)


def write_yield(found: Yield, title: str, folder: Path) -> Path:
    """Write the figure into ``folder`` as PNG and SVG; return the path of the PNG."""
    figure = draw_yield(found, title)
    with staging_folder(folder) as temporary:
        figure.savefig(temporary / "yield.png")
        figure.savefig(temporary / "yield.svg", metadata={"Date": None})
    return folder / "yield.png"


_NAMES = {-1.0: "lower end", 0.0: "as in the file", 1.0: "upper end"}
"""Names of the values of ``Mismatch.mass`` and ``Mismatch.stiffness``."""


def draw_mismatch(cells: Sequence[Mismatch], title: str, searched: Searched) -> Figure:
    """Return a figure of the best value in spec over the stiffness of the springs.

    There is a line for each mass of the loads. Mass and stiffness are at the lower end of their
    tolerances, as in the file, or at the upper end.
    """
    with figure_style():
        figure = Figure(figsize=(5.6, 3.4))
        axes, has_gaps = figure.add_subplot(), False
        for style, mass in zip(AXES, sorted({cell.mass for cell in cells}), strict=False):
            row = sorted((c for c in cells if c.mass == mass), key=lambda cell: cell.stiffness)
            axes.plot(
                [cell.stiffness for cell in row],
                [_drawn(cell, searched) for cell in row],
                marker="o",
                label=f"loads: {_NAMES[mass]}",
                **style,
            )
            slower_ends = [
                (cell.stiffness, searched.per_unit * interval.high)
                for cell in row
                for interval in sorted(cell.intervals, key=lambda interval: -interval.high)[1:]
            ]
            if slower_ends:
                axes.plot(*zip(*slower_ends, strict=True), "o", mfc="white", mec=style["color"])
                has_gaps = True
        if has_gaps:
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
            nothing_text = _nothing(cells, searched.name)
            axes.text(0.5, 0.5, nothing_text, transform=axes.transAxes, ha="center", va="center")
    return figure


def _drawn(cell: Mismatch, searched: Searched) -> float:
    return searched.nothing if cell.best is None else searched.per_unit * cell.best


def _nothing(cells: Sequence[Mismatch], what: str) -> str:
    """Return the text of a figure without points: no machine is in spec, and which limits fail."""
    limits = dict.fromkeys(cell.limited_by.replace("_", " ") for cell in cells)
    failing = " and ".join(limits)
    fail = "fails" if len(limits) == 1 else "fail"
    return f"no {what} is in spec on any of the {len(cells)} machines:\n{failing} {fail}"


def write_mismatch(cells: Sequence[Mismatch], title: str, searched: Searched, folder: Path) -> Path:
    """Write the figure into ``folder`` as PNG and SVG; return the path of the PNG."""
    figure = draw_mismatch(cells, title, searched)
    with staging_folder(folder) as temporary:
        figure.savefig(temporary / "tolerances.png")
        figure.savefig(temporary / "tolerances.svg", metadata={"Date": None})
    return folder / "tolerances.png"
