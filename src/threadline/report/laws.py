"""The report of motion laws: rise, derivatives, and the vibration left on a mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from threadline.laws import Law
from threadline.report.document import Document, Table, origin_facts
from threadline.report.publish import write_document
from threadline.report.style import AXES, LIMIT, figure_style
from threadline.shaping import FlexibleMode, residual_m

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_POINTS = 1201
_SPAN = (0.4, 2.2)
_FREQUENCIES = 361
_NAMES = ("rise", "velocity", "acceleration", "jerk")
_MARKS = ("o", "s", "^", "D", "v", "x")


@dataclass(frozen=True, slots=True)
class Curve:
    """A law and the duration of the move for which its residual is drawn."""

    law: Law
    window_s: float


def write_laws(
    laws: Sequence[Law],
    tables: Sequence[Table],
    warnings: Sequence[str],
    folder: Path,
    *,
    curves: Sequence[Curve] = (),
    mode: FlexibleMode | None = None,
    move_m: float = 0.0,
    residual_m: float | None = None,
    band: float | None = None,
) -> Path:
    """Write the report of ``laws`` into ``folder``; return the path of the HTML page.

    Parameters
    ----------
    curves
        Laws whose residual after a move of ``move_m`` is drawn over the frequency of ``mode``.
    residual_m, band
        Residual and half width of the band that a law was made for; None if none was made.

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
        if mode is not None:
            figures["residual"] = _residual(curves, mode, move_m, residual_m, band)
            captions["residual"] = (
                "Amplitude of a mode of each frequency when the move ends; the damping ratio is "
                "held. Upright: the mode; grey: the band."
            )
        characteristics = Table(
            title="Characteristics",
            header=("law", "Cv", "Ca", "Cj", "efficiency"),
            rows=[
                [
                    each.name,
                    f"{each.velocity:.4f}",
                    f"{each.acceleration:.4f}",
                    "infinite" if each.jerk is None else f"{each.jerk:.4f}",
                    f"{each.efficiency:.4f}",
                ]
                for each in laws
            ],
        )
        names = ", ".join(each.name for each in laws)
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
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 8.4))
    rows = figure.subplots(4, 1, sharex=True)
    t = np.linspace(0.0, 1.0, _POINTS)
    for derivative, (row, name) in enumerate(zip(rows, _NAMES, strict=True)):
        for index, each in enumerate(laws):
            # Marks of the curves stand at different places.
            every = (30 + 23 * index, 150)
            row.plot(t, each(t, derivative), label=each.name, markevery=every, **_style(index))
        row.set_ylabel(name)
    rows[0].set_title("Rise and derivatives")
    rows[-1].set_xlabel("time, of the window")
    handles, labels = rows[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 4))
    return figure


def _residual(
    curves: Sequence[Curve], mode: FlexibleMode, move_m: float, limit_m: float | None,
    band: float | None,
) -> Figure:  # fmt: skip
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.6))
    axes = figure.subplots()
    f = np.geomspace(_SPAN[0] * mode.frequency_hz, _SPAN[1] * mode.frequency_hz, _FREQUENCIES)
    for index, curve in enumerate(curves):
        at = np.array([curve.window_s])
        left = [
            residual_m(curve.law, FlexibleMode(x, mode.damping_ratio), move_m, at)[0] for x in f
        ]
        label = f"{curve.law.name}, {curve.window_s * 1e3:.4g} ms"
        axes.plot(
            f, 1e3 * np.array(left), label=label, markevery=(10 + 9 * index, 45), **_style(index)
        )
    if limit_m is not None:
        axes.axhline(1e3 * limit_m, label=f"asked for: {1e3 * limit_m:g} mm", **LIMIT)
    if band:
        low, high = (mode.frequency_hz * (1.0 + sign * band) for sign in (-1.0, 1.0))
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
