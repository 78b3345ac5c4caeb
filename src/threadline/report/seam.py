"""The picture of a seam: every stitch by its margin, told by shape and size as by colour."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from threadline.arrays import FloatArray
from threadline.pipeline import Proof
from threadline.report.style import WORST
from threadline.verdict import Criterion, SewnStitches, sewn_stitches

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LENGTH, _PLACE = 0.05, 5e-4  # limits where the specification has none: the stitcher thesis's
_MAX_DRAWN = 20_000

# Share of the limit that is used, up to which value; marker, area, colour, filled.
_BANDS: tuple[tuple[str, float, str, float, str, bool], ...] = (
    ("uses half of the limit or less", 0.5, "o", 7.0, "#0072B2", False),
    ("within 20 % margin", 0.8, "o", 16.0, "#0072B2", True),
    ("less than 20 % margin", 1.0, "s", 26.0, "#E69F00", True),
    ("out of spec", np.inf, "X", 58.0, "#D55E00", True),
)


def seam_figure(proof: Proof) -> Figure | None:
    """Draw the stitches of a job where the needle went down; None where it has none.

    The share of its limit that a stitch uses is the larger of two: of its length, unless it is
    exempt, and of its distance from the seam.
    """
    from matplotlib.figure import Figure

    length, place = _criterion(proof, "stitch_length_error"), _criterion(proof, "contour_error")
    delay_s = 0.0 if length is None else length.options.get("delay", 0.0)
    runs: list[SewnStitches] = []
    count = 0
    for run in sewn_stitches(proof.plan, proof.recording, delay_s):
        runs.append(run)
        count += len(run.stitches)
        if count >= _MAX_DRAWN:
            break
    if not count:
        return None
    length_limit = (length.limit if length else None) or _LENGTH
    place_limit = (place.limit if place else None) or _PLACE
    points = np.concatenate([r.actual for r in runs]) * 1e3
    seam = np.concatenate([r.stitches.point for r in runs]) * 1e3
    exempt = np.concatenate([r.stitches.exempt for r in runs])
    contour = np.concatenate([r.stitches.contour for r in runs])
    off = np.abs(np.concatenate([r.length_error for r in runs]))
    by_length = np.where(exempt, 0.0, off / length_limit)
    by_place = np.concatenate([r.placement_m for r in runs]) / place_limit
    share = np.maximum(by_length, by_place)

    figure = Figure(figsize=(7.2, 7.4))
    drawn, graph = figure.subplots(2, 1, height_ratios=[3, 2])
    _draw(drawn, points, seam, contour, share)
    names = proof.plan.job.axes
    drawn.set_xlabel(f"{names[0]} [mm]")
    drawn.set_ylabel(f"{names[1]} [mm]")
    drawn.set_title("The seam: where the needle went down")
    figure.legend(*drawn.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    number = np.arange(count)
    graph.plot(
        number, 100.0 * by_place, color="black", lw=1.0, linestyle=(0, (4, 1.5)),
        label=f"distance from the seam, of {place_limit * 1e3:g} mm",
    )  # fmt: skip
    graph.plot(
        number[~exempt], 100.0 * by_length[~exempt], linestyle="none", marker="|", markersize=7,
        color="#0072B2", label=f"length off by, of {length_limit * 100:.3g} % (exempt left out)",
    )  # fmt: skip
    graph.axhline(100.0, color="#D55E00", linestyle=(0, (1, 1.5)), lw=1.4)
    graph.set_ylim(0.0, max(120.0, 110.0 * float(share.max())))
    graph.set_xlabel("stitch")
    graph.set_ylabel("share of the limit [%]")
    graph.set_title("Every stitch", pad=16)
    graph.legend(loc="lower left", bbox_to_anchor=(0.0, 0.99), ncols=2, borderaxespad=0.0)
    return figure


def _draw(
    panel: Axes, points: FloatArray, seam: FloatArray, contour: FloatArray, share: FloatArray
) -> None:
    for k in np.unique(contour):
        line = seam[contour == k]
        label = "seam" if k == contour[0] else None
        panel.plot(line[:, 0], line[:, 1], color="0.55", lw=0.7, zorder=1, label=label)
    low = -1.0
    for label, high, marker, area, colour, filled in _BANDS:
        chosen = (share > low) & (share <= high)
        low = high
        if not chosen.any():
            continue
        panel.scatter(
            points[chosen, 0],
            points[chosen, 1],
            s=area,
            marker=marker,
            facecolors=colour if filled else "white",
            edgecolors=colour if not filled else "black",
            linewidths=0.9 if not filled else 0.4,
            zorder=2 + high if np.isfinite(high) else 4,
            label=f"{label}: {int(chosen.sum())}",
        )
    worst = int(np.argmax(share))
    panel.plot(
        points[worst : worst + 1, 0], points[worst : worst + 1, 1],
        label=f"worst: stitch {worst}, {share[worst]:.0%} of its limit",
        **{**WORST, "markerfacecolor": "none", "marker": "o", "markersize": 13},
    )  # fmt: skip
    panel.set_aspect("equal", adjustable="datalim")
    panel.margins(0.06)


def _criterion(proof: Proof, name: str) -> Criterion | None:
    return next((c for c in proof.spec.criteria if c.name == name), None)
