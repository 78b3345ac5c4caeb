"""Experiments on the simulated machine as a figure and a table."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from threadline.report.document import Table
from threadline.report.style import ACTUAL, LIMIT, WORST
from threadline.search.campaign import Campaign
from threadline.search.experiments import StepRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

NOTHING_TRIED: Mapping[str, Campaign] = MappingProxyType({})
_LATEST_S = 3.0
_STILL = 0.02


def experiment_figure(campaign: Campaign) -> tuple[Figure, str]:
    """Return a figure of the steps of an axis, and its caption.

    Above are motor and load over time, as shares of the step; below, over the size of the step, its
    largest current and the overshoot of the load.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 6.4), layout="constrained")
    grid = figure.subplots(2, 2)
    forth = sorted((s for s in campaign.steps if s[0] > 0), key=lambda step: step[0])
    shades = np.linspace(0.75, 0.0, len(forth))
    until = 0.0
    for (size, run), shade in zip(forth, shades, strict=True):
        label = f"{size / np.pi:.4g} pi rad"
        for axes, share in ((grid[0, 0], run.share), (grid[0, 1], run.load_share)):
            axes.plot(run.time_s, share, color=str(shade), lw=0.9, label=label)
        away = np.flatnonzero(np.abs(run.load_share - 1.0) > _STILL)
        until = max(until, float(run.time_s[away[-1]]) if len(away) else 0.0)
    for axes, what in ((grid[0, 0], "motor"), (grid[0, 1], "load")):
        axes.axhline(1.0, color="0.6", lw=0.6)
        axes.set_xlim(0.0, min(1.05 * until, _LATEST_S))
        axes.set_xlabel("time [s]")
        axes.set_ylabel(f"{what}, share of the step")
    grid[0, 1].legend(fontsize=6, loc="lower right")
    _over_size(grid[1, 0], campaign, lambda run: run.peak_current_a)
    top = max((run.peak_current_a for _, run in campaign.steps if run.saturated), default=None)
    if top is not None:
        grid[1, 0].axhline(top, label="limit", **LIMIT)
        grid[1, 0].legend(fontsize=6, loc="lower right")
    grid[1, 0].set_ylabel("largest current [A]")
    _over_size(grid[1, 1], campaign, lambda run: 100.0 * run.load_overshoot)
    grid[1, 1].set_ylabel("overshoot of the load [%]")
    grid[1, 1].legend(fontsize=6, loc="upper right")
    figure.suptitle(f"Axis {campaign.axis}: steps of the simulated machine, words quantised")
    onset = campaign.saturates_from_rad
    limited = "no step reaches the current limit" if onset is None else (
        f"the current is limited from {onset:.3f} rad on"
    )  # fmt: skip
    return figure, f"Steps of the motor forth, larger ones darker; {limited}."


def _over_size(axes: Axes, campaign: Campaign, of: Callable[[StepRun], float]) -> None:
    """Draw one number of every step over the size of the step, forward and back separately."""
    back = {**WORST, "markersize": 6}
    for sign, label, style in (
        (1, "forth", {**ACTUAL, "marker": "o", "markersize": 3}),
        (-1, "back", back),
    ):
        shown = [(abs(size), of(run)) for size, run in campaign.steps if sign * size > 0]
        if shown:
            sizes, values = zip(*sorted(shown), strict=True)
            axes.semilogx(np.array(sizes) / np.pi, values, label=label, **style)
    ticks = 2.0 ** np.arange(-3, 4)
    axes.set_xticks(ticks, ["1/8", "1/4", "1/2", "1", "2", "4", "8"])
    axes.set_xticks([], minor=True)
    axes.set_xlabel("step of the motor [pi rad]")


def experiment_table(campaign: Campaign) -> Table:
    """Return the table of the steps of an axis; sweep and constant speed stand in its note."""
    title, header, rows = campaign.table()
    return Table(title=title, header=tuple(header), rows=rows, note=campaign.summary())
