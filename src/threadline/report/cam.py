"""The report of a measured cam: its rows, differences and law, as measured and as faired."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from threadline.laws.cam_study import CamStudy, Fairing, second_differences
from threadline.report.document import Document, Table, origin_facts
from threadline.report.publish import write_document
from threadline.report.style import ACTUAL, LIMIT, PLANNED, PROGRAMMED, WORST, figure_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_POINTS = 1201


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
            figures={"rows": _rows(study), "law": _law(study)},
            captions={
                "rows": "Distances as measured and faired, what fairing moved, and second "
                "differences before and after. Triangles: outliers, kept. Upright: the rise.",
                "law": "The law of the chosen fairing, dashed the clamped cubic spline through the "
                "rows as they were measured.",
            },
            facts=[
                *origin_facts(),
                ("noise", f"{1e3 * study.noise_m:.4g} mm"),
                ("fairing", str(study.chosen)),
            ],
        )
        return write_document(document, folder, "cam")


def _rows(study: CamStudy) -> Figure:
    from matplotlib.figure import Figure

    cam = study.cam
    faired = study.faired(study.chosen)
    assert faired is not None
    angle = np.degrees(cam.alpha_rad)
    figure = Figure(figsize=(7.2, 8.0))
    top, middle, bottom = figure.subplots(3, 1, sharex=True)
    top.plot(angle, 1e3 * faired.distances_m, label=f"faired: {study.chosen}", **ACTUAL)
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


def _law(study: CamStudy) -> Figure:
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
            panel.plot(t, raw(t, derivative), label="as measured", **PLANNED)
        panel.plot(t, study.law(t, derivative), label=f"faired: {study.chosen}", **ACTUAL)
        peak = float(np.abs(study.law(t, derivative)).max())
        if derivative:
            # The unfaired curve may be many times as high: it leaves the picture, not the law.
            panel.set_ylim((-0.3 if derivative == 1 else -2.6) * peak, 2.6 * peak)
            panel.set_ylabel(f"{name}\n+-{chosen.spread[derivative - 1]:.2g}")
        else:
            panel.set_ylabel(name)
    panels[0].set_title("Law, with the spread of its peaks over draws of the noise")
    panels[-1].set_xlabel("time, of the rise")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2)
    return figure
