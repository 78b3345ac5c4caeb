"""The report of a measured cam: its rows, differences and law, as measured and as faired."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from threadline.arrays import FloatArray
from threadline.laws.cam_study import CamStudy, Faired, Fairing, second_differences
from threadline.report.document import Document, Table, origin_facts
from threadline.report.publish import write_document
from threadline.report.style import ACTUAL, LIMIT, PLANNED, PROGRAMMED, WORST, figure_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_POINTS = 1201
_PEAKS = ("Cv", "Ca", "Cj")


def write_cam(study: CamStudy, tables: Sequence[Table], folder: Path) -> Path:
    """Write the report of ``study`` into ``folder``; return the path of the HTML page.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    with figure_style():
        document = Document(
            title=f"Cam {study.cam.file}",
            subtitle="; ".join(study.rise.said),
            verdicts=(),
            warnings=study.warnings,
            tables=tables,
            figures={"rows": rows_figure(study), "law": law_figure(study)},
            captions={
                "rows": "Distances as measured and faired, what fairing moved, and second "
                "differences before and after. Triangles: outliers, kept. Upright: the rise.",
                "law": "The law of the chosen fairing, light the clamped cubic spline through the "
                "rows as they were measured, which may leave the picture.",
            },
            facts=[
                *origin_facts(),
                ("noise", f"{1e3 * study.noise_m:.4g} mm"),
                ("fairing", str(study.chosen)),
            ],
        )
        return write_document(document, folder, "cam")


def rows_figure(study: CamStudy) -> Figure:
    """Draw the rows, their change by fairing, and second differences before and after."""
    from matplotlib.figure import Figure

    cam = study.cam
    faired = study.faired(study.chosen)
    assert faired is not None
    angle = np.degrees(cam.alpha_rad)
    figure = Figure(figsize=(7.2, 8.0))
    top, middle, bottom = figure.subplots(3, 1, sharex=True)
    dense, between = _between(study, faired.distances_m)
    top.plot(np.degrees(dense), 1e3 * between, label=f"faired: {study.chosen}", **ACTUAL)
    top.plot(angle, 1e3 * cam.h_m, label="measured", **PROGRAMMED)
    top.set_ylabel("distance [mm]")
    top.set_title("Distances")
    middle.plot(angle, 1e3 * (cam.h_m - faired.distances_m), label="measured", **PROGRAMMED)
    for sign in (-2.0, 2.0):
        label = "twice the noise" if sign > 0 else None
        middle.axhline(sign * 1e3 * study.noise_m, label=label, **LIMIT)
    middle.axhline(0.0, color="0.4", linewidth=0.8)
    middle.set_ylabel("off the faired [mm]")
    if study.outliers:
        rows = list(study.outliers)
        off = 1e3 * (cam.h_m - faired.distances_m)[rows]
        middle.plot(angle[rows], off, label="outlier, kept", **WORST)
    for values, label, style in (
        (cam.h_m, "measured", PLANNED),
        (faired.distances_m, f"faired: {study.chosen}", ACTUAL),
    ):
        seconds = 1e3 * second_differences(cam.alpha_rad, values)
        bottom.plot(angle[1:-1], seconds, label=label, **style)
    bottom.set_ylabel("2nd difference [mm]")
    bottom.set_xlabel("cam [deg]")
    for panel in (top, middle, bottom):
        for end in (study.rise.start_rad, study.rise.end_rad):
            panel.axvline(np.degrees(end), color="0.3", linewidth=0.9)
        panel.legend(loc="best")
    return figure


def _between(study: CamStudy, at_rows_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (m,) angles and the faired distances there, the law between its rows."""
    cam, rise = study.cam, study.rise
    span = rise.end_rad - rise.start_rad
    dense = np.union1d(np.linspace(cam.alpha_rad[0], cam.alpha_rad[-1], _POINTS), cam.alpha_rad)
    risen, at = (study.law(np.clip((x - rise.start_rad) / span, 0.0, 1.0))
                 for x in (cam.alpha_rad, dense))  # fmt: skip
    base = np.polynomial.polynomial.polyfit(risen, cam.follower_of(at_rows_m), 1)
    return dense, cam.distance_of(base[0] + base[1] * at)


def law_figure(study: CamStudy) -> Figure:
    """Draw the law of the chosen fairing, and that of the rows as they were measured."""
    from matplotlib.figure import Figure
    from scipy.interpolate import CubicSpline

    figure = Figure(figsize=(7.2, 8.0))
    panels = figure.subplots(4, 1, sharex=True)
    t = np.linspace(0.0, 1.0, _POINTS)
    cam = study.cam
    at = (cam.alpha_rad - study.rise.start_rad) / (study.rise.end_rad - study.rise.start_rad)
    inside = (at > 0.0) & (at < 1.0)
    low, high = (float(cam.follower[k]) for k in (0, -1))
    u = np.concatenate(([0.0], at[inside], [1.0]))
    s = np.concatenate(([0.0], (cam.follower[inside] - low) / (high - low), [1.0]))
    raw = CubicSpline(u, s, bc_type="clamped")
    chosen = study.faired(study.chosen)
    assert chosen is not None
    names = ("rise", "velocity", "acceleration", "jerk")
    for derivative, (panel, name) in enumerate(zip(panels, names, strict=True)):
        if study.chosen is not Fairing.NONE:
            panel.plot(t, raw(t, derivative), label="as measured", color="0.72", linewidth=0.7)
        panel.plot(t, study.law(t, derivative), label=f"faired: {study.chosen}", **ACTUAL)
        peak = float(np.abs(study.law(t, derivative)).max())
        if derivative:
            # The unfaired curve may be many times as high: it is cut off at the picture's edge.
            panel.set_ylim((-0.3 if derivative == 1 else -1.6) * peak, 1.6 * peak)
            panel.set_title(_peak_words(chosen, derivative), fontsize=8.0)
        panel.set_ylabel(name)
    panels[0].set_title("Law: rise 1 in time 1, and its derivatives")
    panels[-1].set_xlabel("time, of the rise")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure


def _peak_words(faired: Faired, derivative: int) -> str:
    """Return the peak of a derivative of the law and its spread."""
    peak, spread = faired.peaks[derivative - 1], faired.spread[derivative - 1]
    if not np.isfinite(peak):
        return f"{_PEAKS[derivative - 1]} infinite"
    return f"{_PEAKS[derivative - 1]} = {peak:.4g}, spread over draws of the noise {spread:.2g}"
