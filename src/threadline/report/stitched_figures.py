"""The figures of an embroidery design: margins of stitches, lengths of moves, speed."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING

import numpy as np

from threadline.arrays import FloatArray
from threadline.pipeline import Proof
from threadline.plan import Plan
from threadline.report.style import ACTUAL, AXES, PLANNED
from threadline.signals import Recording
from threadline.verdict.stitch_run import StitchRun

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_THIN, _THICK = 0.35, 2.4
_LEVELS = 5
_OUT = "#D55E00"
_MINUTE = 60.0
_SLOWEST = "all as slow as the slowest stitch alone"


def design_figure(proof: Proof, recording: Recording) -> Figure:
    """Draw the design as a run sewed it; each stitch is shaded by its share of the limit."""
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    plan = proof.plan
    run = StitchRun(recording, plan)
    use, said = _use(proof, run)
    figure = Figure(figsize=(7.2, 7.0))
    panel = figure.subplots()
    places = np.vstack((np.array(plan.job.start), plan.stitched.places_m)) * 1e3
    pieces = np.stack((places[:-1], places[1:]), axis=1)
    travel = plan.stitched.turns.moves.needle == 0
    panel.add_collection(
        LineCollection(list(pieces[travel]), colors="0.5", linestyles=":", linewidths=0.9)
    )
    ends = pieces[run.turns]
    edges = np.linspace(0.0, 1.0, _LEVELS + 1)
    for level in range(_LEVELS):
        low, high = edges[level], edges[level + 1]
        last = level == _LEVELS - 1
        chosen = (use >= low) & ((use < high) | (last & (use <= 1.0)))
        share = level / (_LEVELS - 1)
        panel.add_collection(
            LineCollection(
                list(ends[chosen]),
                colors=[_shade(share)],
                linewidths=_THIN + share * (_THICK - _THIN),
                label=f"{100 * low:.0f} to {100 * high:.0f} % {said}: {int(chosen.sum())}",
                zorder=2 + level,
            )
        )
    over = use > 1.0
    panel.add_collection(LineCollection(list(ends[over]), colors=_OUT, linewidths=_THICK, zorder=8))
    middle = ends[over].mean(axis=1)
    panel.plot(
        middle[:, 0], middle[:, 1], linestyle="none", marker="x", color="black",
        markersize=4, markeredgewidth=0.8, zorder=9,
    )  # fmt: skip
    panel.plot(
        [], [], color=_OUT, linewidth=_THICK, marker="x", markersize=4, markeredgecolor="black",
        markeredgewidth=0.8, label=f"over it: {int(over.sum())}",
    )  # fmt: skip
    panel.set_aspect("equal", adjustable="datalim")
    panel.autoscale_view()
    panel.set_xlabel("X mm")
    panel.set_ylabel("Y mm")
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def _shade(share: float) -> tuple[float, float, float]:
    """Return a colour from light blue at 0 to black at 1, which is darker in grey print, too."""
    light, dark = np.array([0.60, 0.78, 0.92]), np.array([0.0, 0.05, 0.15])
    red, green, blue = (light + share * (dark - light)).tolist()
    return red, green, blue


def _use(proof: Proof, run: StitchRun) -> tuple[FloatArray, str]:
    """Return (s,) share of the limit that each stitch uses, and the name of that limit."""
    limits = [
        result.limit
        for axis in proof.plan.axes
        for result in proof.verdict.results
        if result.name == "stitch_residual" and result.axis == axis
    ]
    residual = run.sewn.residual_m
    if len(limits) == len(proof.plan.axes) and all(limits):
        share = np.nanmax(residual / np.array(limits, dtype=np.float64), axis=1)
        return share, "of the limit"
    return np.nanmax(residual, axis=1) / float(np.nanmax(residual)), "of the largest residual"


def moves_figure(plan: Plan) -> Figure:
    """Draw the histogram of the lengths of the moves."""
    from matplotlib.figure import Figure

    stitched = plan.stitched
    unit_mm = stitched.pace.tables.unit.si * 1e3
    units = np.abs(stitched.turns.moves.units).max(axis=1)[stitched.frame_moves == 1]
    figure = Figure(figsize=(7.2, 3.0))
    panel = figure.subplots()
    counts = np.bincount(units)
    panel.bar(
        unit_mm * np.arange(len(counts)), counts, width=0.9 * unit_mm, color="#0072B2",
        edgecolor="black", linewidth=0.3,
    )  # fmt: skip
    panel.set_yscale("symlog", linthresh=1.0)
    panel.set_ylim(bottom=0.0)
    panel.set_xlabel("move, longer axis, mm")
    panel.set_ylabel("stitches")
    return figure


def pace_figure(plan: Plan) -> Figure:
    """Draw speed and time along the design."""
    from matplotlib.figure import Figure

    stitched = plan.stitched
    figure = Figure(figsize=(7.2, 4.6))
    speed, time = figure.subplots(2, 1, sharex=True)
    number = np.arange(1, len(stitched.turns) + 1)
    speed.plot(number, _MINUTE / stitched.turns.turn_s, drawstyle="steps-mid", **ACTUAL)
    slowest_s = stitched.slowest_s / len(number)
    speed.axhline(_MINUTE / slowest_s, label=_SLOWEST, **PLANNED)
    speed.set_ylabel("stitches a minute")
    speed.set_ylim(bottom=0.0)
    time.plot(number, np.cumsum(stitched.turns.turn_s), label="as planned", **ACTUAL)
    time.plot(number, slowest_s * number, label=_SLOWEST, **PLANNED)
    time.set_ylabel("s")
    time.set_xlabel("turn of the shaft")
    figure.legend(*time.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def speeds_figure(plans: Sequence[Plan]) -> Figure:
    """Draw the speed along the design, plan by plan."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 3.6))
    panel = figure.subplots()
    for plan, style in zip(plans, cycle(AXES), strict=False):
        turns = plan.stitched.turns
        number = np.arange(1, len(turns) + 1)
        label = f"{plan.planned_with}: {plan.duration_s:.4g} s"
        panel.plot(number, _MINUTE / turns.turn_s, drawstyle="steps-mid", label=label, **style)
    panel.set_xlabel("turn of the shaft")
    panel.set_ylabel("stitches a minute")
    panel.set_ylim(bottom=0.0)
    figure.legend(loc="outside lower center", ncols=1)
    return figure
