"""Figures of a winding: the unrolled mandrel with its bands, and slip and layers along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.proof.pipeline import Proof
from threadline.report.document import Table
from threadline.report.solid import wound_glb
from threadline.report.style import ACTUAL, LIMIT, PLANNED, WORST, new_figure
from threadline.verdict.causes import Causes, causes_of
from threadline.verdict.pattern import middle_of
from threadline.verdict.replayed import (
    WoundJob,
    least_friction,
    planned_fibre,
    recorded_fibre,
    wound_job,
)
from threadline.verdict.types import Status
from threadline.winding.raster import Raster

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure

_BINS = 200  # number of intervals along the mandrel
_MOST_COLUMNS = 700  # largest number of columns of the map
_SHOWN = (1, 5)  # circuits after which the pattern is drawn, besides the whole winding
_MOST_OF_IT = 0.85  # share of the mandrel over which the numbers of bands get different shades
_MOST_DRAWN = 4000  # largest number of points drawn of the last fibre's centre line
_OF_FIBRE = ("slip_tendency", "bridging", "lifting", "laid_error", "coverage_gap")


@dataclass(frozen=True, slots=True, eq=False)
class _Laid:
    """The fibre of one run, (n,) each: place, winding angle, steering and operation.

    ``u`` is the arc length along the meridian in m, ``angle`` the angle about the axis and
    ``winding`` the angle to the meridian, both in rad. ``known`` is 0 where the place is unknown.
    ``of_run`` is False for the fibre of the plan.
    """

    u: FloatArray
    angle: FloatArray
    winding: FloatArray
    known: FloatArray
    steer: FloatArray
    operation: IntArray
    of_run: bool


def winding_figures(proof: Proof) -> tuple[dict[str, Figure], dict[str, bytes], list[Table]]:
    """Return figures, other files and tables of a winding; all are empty without a product."""
    job = wound_job(proof.plan)
    if job is None:
        return {}, {}, []
    laid = _laid(proof, job)
    if not (laid.known > 0.0).any():
        return {}, {}, []
    surface = job.surface
    end_x_m = surface.at(np.array([0.0, surface.length_m]))[0][:, 0]
    raster = Raster(surface, job.width_m, float(end_x_m[0]), float(end_x_m[1]))
    maps, circuits, last_row = [], _circuits(job, laid), 0
    for end_row in [*(circuits[n] for n in _SHOWN if n < len(circuits)), len(laid.u)]:
        rows = slice(last_row, end_row)
        raster.lay(
            laid.u[rows], laid.angle[rows], laid.winding[rows], laid.known[rows] > 0.0,
            laid.operation[rows],
        )  # fmt: skip
        maps.append(_thinned(raster))
        last_row = end_row
    figures = {
        "winding-map": _map(proof, job, laid, raster),
        "winding-along": _along(job, laid, raster),
    }
    if len(circuits) > 1:
        numbers = [n for n in _SHOWN if n < len(circuits)]
        figures["winding-pattern"] = _pattern(job, raster, maps, [*numbers, len(circuits)])
    causes = causes_of(proof.plan)
    tables = []
    if causes is not None:
        figures["winding-causes"] = _causes(causes)
        header = ("factor", "change", "mean gap", "largest gap", "ends", "explains the largest gap")
        title = "What a gap between bands points to"
        tables = [Table(title=title, header=header, rows=causes.rows(), note=causes.words())]
    fibre = np.column_stack([laid.u, laid.angle, laid.winding])
    fibre[laid.known == 0.0] = np.nan
    # The value of the steering of a block is at the last row of the block.
    is_block_end = np.isfinite(laid.steer)
    steer = np.append(np.abs(laid.steer[is_block_end]), 0.0)
    block_of_row = np.concatenate([[0], np.cumsum(is_block_end)[:-1]])
    slips = steer[block_of_row] > least_friction(job.product)
    name = f"{proof.plan.job.name} on {job.product.name}"
    return figures, {"winding-map.glb": wound_glb(surface, job.width_m, fibre, slips, name)}, tables


def winding_caption(name: str) -> str:
    """Return the caption of a figure of ``winding_figures``."""
    if name == "winding-pattern":
        return (
            "The pattern as it grows: the unrolled mandrel after the first circuits and after all. "
            "A circuit begins where the fibre crosses the middle of the widest place from left to "
            "right."
        )
    if name == "winding-causes":
        return (
            "Above: the gaps between neighbouring bands at the widest place, in their order round "
            "the mandrel; negative is overlap. Below: the effect of one factor at a time on the "
            "winding. The same change of all gaps points to the band, the radius or the number of "
            "circuits; one gap that grows from circuit to circuit to the steps per degree or to "
            "slip; ends that move to one side to the zero."
        )
    if name == "winding-map":
        return (
            "The unrolled mandrel: the darker, the more bands lie on each other; white is bare. "
            "The line is the middle of the last fibre, the marks are the worst places with their "
            "program lines. Fibre whose place is not known is not drawn. report-winding-map.glb "
            "shows the same in space: each node is a twentieth of the winding."
        )
    return (
        "Along the mandrel: the largest steering of the fibre, mean of a block, against the lower "
        "end of the friction; and the mean number of bands on each other."
    )


def _laid(proof: Proof, job: WoundJob) -> _Laid:
    """Return the fibre of the recorded run, or of the plan if the recording does not give it."""
    recorded = recorded_fibre(proof.recording, job)
    parts = list(planned_fibre(proof.plan, job)) if recorded is None else [recorded]

    def joined(columns: Sequence[FloatArray]) -> FloatArray:
        return np.concatenate(columns) if columns else np.empty(0)

    fibres = [part.fibre for part in parts]
    operations = [part.operation for part in parts if part.operation is not None]
    return _Laid(
        u=joined([fibre.u for fibre in fibres]),
        angle=joined([fibre.angle for fibre in fibres]),
        winding=joined([fibre.winding for fibre in fibres]),
        known=joined([fibre.known.astype(np.float64) for fibre in fibres]),
        steer=joined([fibre.steer for fibre in fibres]),
        operation=np.concatenate(operations) if operations else np.empty(0, dtype=np.int64),
        of_run=recorded is not None,
    )


def _circuits(job: WoundJob, laid: _Laid) -> list[int]:
    """Return the rows at which circuits begin: the fibre crosses the middle from left to right."""
    middle = middle_of(job.surface)
    from_middle_m = np.where(laid.known > 0.0, laid.u - middle, np.nan)
    return [
        int(row) + 1
        for row in np.flatnonzero((from_middle_m[:-1] < 0.0) & (from_middle_m[1:] >= 0.0))
    ]


def _thinned(raster: Raster) -> NDArray[np.uint16]:
    """Return the number of bands, (around, along), with no more cells than a figure shows."""
    steps = [max(size // _MOST_COLUMNS, 1) for size in raster.count.shape]
    return raster.count[:: steps[0], :: steps[1]].T.copy()


def _shade(panel: Axes, job: WoundJob, raster: Raster, count: NDArray[np.uint16]) -> QuadMesh:
    """Draw a map; its scale of shades fits most of the mandrel, not the many bands at the poles."""
    x = 1e3 * job.surface.at(raster.places)[0][:, 0]
    largest_shade = max(2.0 * float(np.quantile(count, _MOST_OF_IT)), 4.0)
    panel.set_ylim(0.0, 360.0)
    panel.set_yticks(range(0, 361, 60))
    panel.set_xlabel("along the mandrel, mm")
    return panel.pcolormesh(
        x[:: max(len(x) // _MOST_COLUMNS, 1)],
        np.linspace(0.0, 360.0, len(count)),
        count,
        cmap="Greys",
        vmin=0,
        vmax=largest_shade,
        shading="nearest",
        rasterized=True,
    )


def _pattern(
    job: WoundJob, raster: Raster, shown: Sequence[NDArray[np.uint16]], circuits: Sequence[int]
) -> Figure:
    figure, panels = new_figure((7.2, 3.2), 1, len(shown), sharey=True)
    for panel, count, number in zip(panels, shown, circuits, strict=True):
        _shade(panel, job, raster, count)
        panel.set_title("After 1 circuit" if number == 1 else f"After {number} circuits")
    panels[0].set_ylabel("round the mandrel, deg")
    return figure


def _map(proof: Proof, job: WoundJob, laid: _Laid, raster: Raster) -> Figure:
    from matplotlib.ticker import MaxNLocator

    figure, panel = new_figure((7.2, 4.6))
    x = 1e3 * job.surface.at(raster.places)[0][:, 0]
    mesh = _shade(panel, job, raster, _thinned(raster))
    bar = figure.colorbar(mesh, ax=panel, label="bands on each other", extend="max")
    bar.locator = MaxNLocator(integer=True)
    bar.update_ticks()
    known_rows = np.flatnonzero(laid.known > 0.0)[-_MOST_DRAWN:]
    line_x = 1e3 * job.surface.at(laid.u[known_rows])[0][:, 0]
    line_deg = np.degrees(laid.angle[known_rows]) % 360.0
    # The line has gaps where the angle wraps around, and where the fibre is unknown.
    line_deg[1:][(np.abs(np.diff(line_deg)) > 180.0) | (np.diff(known_rows) > 1)] = np.nan
    panel.plot(line_x, line_deg, **ACTUAL)
    _mark(proof, job, laid, panel)
    panel.set_xlim(float(x[0]), float(x[-1]))
    panel.set_ylabel("round the mandrel, deg")
    panel.set_title(f"The unrolled mandrel, {'as wound' if laid.of_run else 'as planned'}")
    return figure


def _mark(proof: Proof, job: WoundJob, laid: _Laid, panel: Axes) -> None:
    """Mark the worst places of the measures of the fibre."""
    marked = False
    for result in proof.verdict.results:
        is_worst = result.status is Status.FAILED or result.name == "slip_tendency"
        if result.name not in _OF_FIBRE or result.operation is None or not is_worst:
            continue
        rows = np.flatnonzero((laid.operation == result.operation) & np.isfinite(laid.u))
        if not len(rows):
            continue
        middle_row = rows[len(rows) // 2 : len(rows) // 2 + 1]
        x, angle = (
            1e3 * job.surface.at(laid.u[middle_row])[0][0, 0],
            np.degrees(laid.angle[middle_row[0]]) % 360.0,
        )
        panel.plot([x], [angle], label=None if marked else "worst", **WORST)
        line_text = "" if result.job_line is None else f", line {result.job_line}"
        panel.annotate(
            f"{result.name}{line_text}",
            (x, angle),
            textcoords="offset points",
            xytext=(6, 6),
            fontsize=7,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0},
        )
        marked = True


def _causes(causes: Causes) -> Figure:
    figure, (upper, lower) = new_figure((7.2, 5.2), 2, height_ratios=(1.0, 1.6))
    gaps = 1e3 * causes.laid.gaps_m
    upper.step(np.arange(len(gaps)), gaps, where="mid", **ACTUAL)
    upper.axhline(0.0, color="0.5", linewidth=0.8)
    upper.set_xlabel("number of the gap round the mandrel")
    upper.set_ylabel("gap, mm")
    upper.set_title("Gaps between neighbouring bands, as programmed")
    rows = np.arange(len(causes.causes))[::-1]
    columns = (
        ("all gaps", [one.mean_m for one in causes.causes], "0.15"),
        ("the largest gap", [one.largest_m for one in causes.causes], "0.5"),
        ("the left end", [one.left_m for one in causes.causes], "0.75"),
        ("the right end", [one.right_m for one in causes.causes], "0.9"),
    )
    for number, (label, values, shade) in enumerate(columns):
        lower.barh(
            rows + 0.3 - 0.2 * number, 1e3 * np.array(values), height=0.18, label=label,
            color=shade, edgecolor="0.2", linewidth=0.5,
        )  # fmt: skip
    lower.set_yticks(rows, [f"{one.name}\n{one.shown()}" for one in causes.causes])
    lower.axvline(0.0, color="0.5", linewidth=0.8)
    lower.set_xlabel("change, mm")
    lower.set_title("What one factor at a time changes")
    lower.legend(loc="best")
    return figure


def _along(job: WoundJob, laid: _Laid, raster: Raster) -> Figure:
    figure, (upper, lower) = new_figure((7.2, 4.6), 2, sharex=True)
    judged = np.flatnonzero((laid.known > 0.0) & np.isfinite(laid.steer))
    x = 1e3 * job.surface.at(laid.u[judged])[0][:, 0]
    places = 1e3 * job.surface.at(raster.places)[0][:, 0]
    edges = np.linspace(places[0], places[-1], _BINS + 1)
    bin_numbers = np.clip(np.searchsorted(edges, x) - 1, 0, _BINS - 1)
    largest_steering = np.full(_BINS, np.nan)
    np.fmax.at(largest_steering, bin_numbers, np.abs(laid.steer[judged]))
    upper.plot(0.5 * (edges[1:] + edges[:-1]), 1e2 * largest_steering, label="largest", **ACTUAL)
    upper.axhline(1e2 * least_friction(job.product), label="friction, lower end", **LIMIT)
    upper.set_ylabel("steering, %")
    upper.set_title("Slip along the mandrel")
    upper.legend()
    mean = raster.count.mean(axis=1)
    thickness_m = job.product.thickness
    lower.plot(places, mean if thickness_m is None else 1e3 * thickness_m * mean, **PLANNED)
    lower.set_ylabel("bands" if thickness_m is None else "thickness, mm")
    lower.set_xlabel("along the mandrel, mm")
    lower.set_title("Mean thickness of the bands round the mandrel")
    return figure
