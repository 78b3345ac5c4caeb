"""Reports of motion laws and of measured cams: rise, derivatives, residual vibration of a mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.motion.laws import Law
from threadline.motion.laws.cam_study import CamStudy, Faired, Fairing, second_differences
from threadline.motion.laws.measured_rise import CONFIDENCE
from threadline.motion.shaping import FlexibleMode, residual_m
from threadline.report.document import Document, Table, origin_facts
from threadline.report.publish import write_document
from threadline.report.style import (
    ACTUAL,
    AXES,
    LIMIT,
    PLANNED,
    PROGRAMMED,
    WORST,
    figure_style,
    new_figure,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_POINTS = 1201
_SPAN = (0.4, 2.2)
_FREQUENCIES = 361
_NAMES = ("rise", "velocity", "acceleration", "jerk")
_MARKS = ("o", "s", "^", "D", "v", "x")


@dataclass(frozen=True, slots=True)
class Curve:
    """A law and the duration of the move, for the figure of its residual."""

    law: Law
    window_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualPlot:
    """Contents of the figure of the residual vibration over the frequency of a mode.

    Parameters
    ----------
    curves
        Laws and durations.
    mode
        The mode whose frequency is varied.
    move_m
        Length of the move, m.
    limit_m, band
        Residual and half width of the band for which a law was made; None if none was made.
    """

    curves: Sequence[Curve]
    mode: FlexibleMode
    move_m: float
    limit_m: float | None
    band: float | None


def write_laws(
    laws: Sequence[Law],
    tables: Sequence[Table],
    warnings: Sequence[str],
    folder: Path,
    *,
    residual: ResidualPlot | None = None,
) -> Path:
    """Write the report of ``laws`` into ``folder``; return the path of the HTML page.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    with figure_style():
        figures = {"laws": _laws(laws)}
        captions = {
            "laws": "Rise 1 in time 1 and its derivatives; the peaks are Cv, Ca and Cj. Marks tell "
            "the curves apart without colour."
        }
        if residual is not None:
            figures["residual"] = _residual(residual)
            captions["residual"] = (
                "Amplitude of a mode of each frequency when the move ends; the damping ratio is "
                "held. Upright: the mode; grey: the band."
            )
        characteristics = Table(
            title="Characteristics",
            header=("law", "Cv", "Ca", "Cj", "efficiency"),
            rows=[
                [
                    law.name,
                    f"{law.velocity:.4f}",
                    f"{law.acceleration:.4f}",
                    "infinite" if law.jerk is None else f"{law.jerk:.4f}",
                    f"{law.efficiency:.4f}",
                ]
                for law in laws
            ],
        )
        names = ", ".join(law.name for law in laws)
        document = Document(
            title="Motion laws",
            subtitle=names,
            verdicts=(),
            warnings=tuple(warnings),
            tables=[*tables, characteristics],
            figures=figures,
            captions=captions,
            facts=origin_facts(),
        )
        return write_document(document, folder, "law")


def _style(index: int) -> dict[str, Any]:
    return {
        **AXES[index % len(AXES)],
        "marker": _MARKS[index % len(_MARKS)],
        "markersize": 3.5,
        "markerfacecolor": "white",
    }


def _laws(laws: Sequence[Law]) -> Figure:
    figure, rows = new_figure((7.2, 8.4), 4, sharex=True)
    t = np.linspace(0.0, 1.0, _POINTS)
    for derivative, (row, name) in enumerate(zip(rows, _NAMES, strict=True)):
        for index, law in enumerate(laws):
            # The markers of different curves are at different places.
            mark_spacing = (30 + 23 * index, 150)
            row.plot(t, law(t, derivative), label=law.name, markevery=mark_spacing, **_style(index))
        row.set_ylabel(name)
    rows[0].set_title("Rise and derivatives")
    rows[-1].set_xlabel("time, of the window")
    handles, labels = rows[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))
    return figure


def _residual(plot: ResidualPlot) -> Figure:
    mode = plot.mode
    figure, axes = new_figure((7.2, 4.6))
    f = np.geomspace(_SPAN[0] * mode.frequency_hz, _SPAN[1] * mode.frequency_hz, _FREQUENCIES)
    for index, curve in enumerate(plot.curves):
        window_s = np.array([curve.window_s])
        residuals_m = [
            residual_m(curve.law, FlexibleMode(x, mode.damping_ratio), plot.move_m, window_s)[0]
            for x in f
        ]
        label = f"{curve.law.name}, {curve.window_s * 1e3:.4g} ms"
        axes.plot(
            f,
            1e3 * np.array(residuals_m),
            label=label,
            markevery=(10 + 9 * index, 45),
            **_style(index),
        )
    if plot.limit_m is not None:
        axes.axhline(1e3 * plot.limit_m, label=f"asked for: {1e3 * plot.limit_m:g} mm", **LIMIT)
    if plot.band:
        low, high = (mode.frequency_hz * (1.0 + sign * plot.band) for sign in (-1.0, 1.0))
        axes.axvspan(low, high, color="0.9", zorder=0)
    axes.axvline(mode.frequency_hz, color="0.3", linewidth=0.9)
    axes.annotate(
        f" {mode.frequency_hz:g} Hz", (mode.frequency_hz, 0.95),
        xycoords=axes.get_xaxis_transform(),
    )  # fmt: skip
    axes.set_yscale("log")
    axes.set(xlabel="undamped frequency, Hz", ylabel="residual, mm", xlim=(f[0], f[-1]))
    axes.set_title("Residual against frequency")
    figure.legend(loc="outside lower center", ncols=2)
    return figure


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
            subtitle="; ".join(study.rise.sentences),
            verdicts=(),
            warnings=study.warnings,
            tables=tables,
            figures={"rows": rows_figure(study), "law": law_figure(study)},
            captions={
                "rows": "Distances as measured and faired, what fairing moved, and second "
                "differences before and after. Triangles: outliers, kept. Upright: the rise, "
                f"grey: the intervals of its ends at {100 * CONFIDENCE:g} %.",
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
    cam = study.cam
    faired = study.faired(study.chosen)
    assert faired is not None
    angle = np.degrees(cam.alpha_rad)
    figure, (top, middle, bottom) = new_figure((7.2, 8.0), 3, sharex=True)
    dense_rad, between_m = _between(study, faired.distances_m)
    top.plot(np.degrees(dense_rad), 1e3 * between_m, label=f"faired: {study.chosen}", **ACTUAL)
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
        off_mm = 1e3 * (cam.h_m - faired.distances_m)[rows]
        middle.plot(angle[rows], off_mm, label="outlier, kept", **WORST)
    for values, label, style in (
        (cam.h_m, "measured", PLANNED),
        (faired.distances_m, f"faired: {study.chosen}", ACTUAL),
    ):
        second_mm = 1e3 * second_differences(cam.alpha_rad, values)
        bottom.plot(angle[1:-1], second_mm, label=label, **style)
    bottom.set_ylabel("2nd difference [mm]")
    bottom.set_xlabel("cam [deg]")
    for panel in (top, middle, bottom):
        for end in (study.rise.start_rad, study.rise.end_rad):
            panel.axvline(np.degrees(end), color="0.3", linewidth=0.9)
        for end_interval in (study.rise.start_within_rad, study.rise.end_within_rad):
            if end_interval is not None:
                panel.axvspan(
                    *np.degrees(end_interval).tolist(), color="0.5", alpha=0.15, linewidth=0
                )
        panel.legend(loc="best")
    return figure


def _between(study: CamStudy, faired_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (m,) angles between the rows and the faired distances at them."""
    cam, rise = study.cam, study.rise
    span = rise.end_rad - rise.start_rad
    dense_rad = np.union1d(np.linspace(cam.alpha_rad[0], cam.alpha_rad[-1], _POINTS), cam.alpha_rad)
    rise_at_rows, rise_at_dense = (study.law(np.clip((x - rise.start_rad) / span, 0.0, 1.0))
                 for x in (cam.alpha_rad, dense_rad))  # fmt: skip
    base = np.polynomial.polynomial.polyfit(rise_at_rows, cam.follower_of(faired_m), 1)
    return dense_rad, cam.distance_of(base[0] + base[1] * rise_at_dense)


def law_figure(study: CamStudy) -> Figure:
    """Draw the law of the chosen fairing, and the law of the rows as measured."""
    from scipy.interpolate import CubicSpline

    figure, panels = new_figure((7.2, 8.0), 4, sharex=True)
    t = np.linspace(0.0, 1.0, _POINTS)
    cam = study.cam
    rise_time = (cam.alpha_rad - study.rise.start_rad) / (study.rise.end_rad - study.rise.start_rad)
    is_inside = (rise_time > 0.0) & (rise_time < 1.0)
    first_m, last_m = (float(cam.follower[k]) for k in (0, -1))
    u = np.concatenate(([0.0], rise_time[is_inside], [1.0]))
    s = np.concatenate(([0.0], (cam.follower[is_inside] - first_m) / (last_m - first_m), [1.0]))
    unfaired = CubicSpline(u, s, bc_type="clamped")
    faired = study.faired(study.chosen)
    assert faired is not None
    names = ("rise", "velocity", "acceleration", "jerk")
    for derivative, (panel, name) in enumerate(zip(panels, names, strict=True)):
        if study.chosen is not Fairing.NONE:
            panel.plot(t, unfaired(t, derivative), label="as measured", color="0.72", linewidth=0.7)
        panel.plot(t, study.law(t, derivative), label=f"faired: {study.chosen}", **ACTUAL)
        peak = float(np.abs(study.law(t, derivative)).max())
        if derivative:
            # The unfaired curve may be many times as high; it is cut off at the edge.
            panel.set_ylim((-0.3 if derivative == 1 else -1.6) * peak, 1.6 * peak)
            panel.set_title(_peak_words(faired, derivative), fontsize=8.0)
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
