"""The report of an input shaper: its impulses, its shaped step and its sensitivity curve."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.motion.shaping import FlexibleMode, Shaper, residual_vibration
from threadline.report.document import Document, Table, origin_facts
from threadline.report.publish import write_document
from threadline.report.style import ACTUAL, LIMIT, PLANNED, PROGRAMMED, figure_style, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SPAN = (0.4, 1.6)  # frequencies drawn: shares of the lowest and of the highest mode
_POINTS = 601  # of a curve
_MOST_HZ = 200.0  # highest frequency in the figure of a measurement
_NAME_WIDE = 0.12  # width of the label of a mode, as a share of the figure
_READABLE: Any = {"facecolor": "white", "edgecolor": "none", "pad": 0.4}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredPower:
    """The power spectrum of a measured vibration, the mode fitted to it, and shapers to compare.

    Parameters
    ----------
    axis
        Name of the axis that was shaken.
    lines_hz, power, fitted
        (k,) frequencies around the mode, the power measured at each, and the power of the fitted
        mode.
    spectrum_hz, spectrum
        (m,) frequencies of the whole range, and the power of all axes at each, weighted as in
        Klipper.
    trains
        Shapers (impulse trains) whose residual vibration is drawn.
    damping_ratio
        Damping ratio of the fitted mode; the residual vibrations are drawn for it.
    """

    axis: str
    lines_hz: FloatArray
    power: FloatArray
    fitted: FloatArray
    spectrum_hz: FloatArray
    spectrum: FloatArray
    trains: tuple[Shaper, ...]
    damping_ratio: float


def write_shaper(
    shaper: Shaper,
    modes: Sequence[FlexibleMode],
    tolerances: Sequence[float],
    tables: Sequence[Table],
    warnings: Sequence[str],
    folder: Path,
    measured: MeasuredPower | None = None,
) -> Path:
    """Write the report of ``shaper`` into ``folder``; return the path of the HTML page.

    Parameters
    ----------
    modes
        Modes for which the shaper was designed.
    tolerances
        Residual vibrations allowed, drawn as limits.
    measured
        Measurement to which the modes were fitted; None if the user typed the modes.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    with figure_style():
        figures = {"sensitivity": _sensitivity(shaper, modes, tolerances), "step": _step(shaper)}
        if measured is not None:
            figures = {"measured": _measured(measured), **figures}
        mode_texts = ", ".join(f"{m.frequency_hz:g} Hz at {m.damping_ratio:g}" for m in modes)
        document = Document(
            title=f"Shaper {shaper.name}",
            subtitle=f"modes: {mode_texts} (undamped frequency at damping ratio)",
            verdicts=(),
            warnings=tuple(warnings),
            tables=tables,
            figures=figures,
            captions={
                "measured": "Above: the measured power around the mode, and the mode fitted to it. "
                "Below: the residual vibration with each shaper, and the power of all axes as a "
                "share of its peak, weighted as in Klipper.",
                "sensitivity": "Residual vibration over frequency at a constant damping ratio; 1 "
                "is the vibration after one unit impulse. Dashed vertical lines: the modes.",
                "step": "The impulses, and the unit step after shaping.",
            },
            facts=[
                *origin_facts(),
                ("times, s", ", ".join(f"{t:.9g}" for t in shaper.times_s)),
                ("amplitudes", ", ".join(f"{a:.9g}" for a in shaper.amplitudes)),
            ],
        )
        return write_document(document, folder, "shaper")


def _measured(measured: MeasuredPower) -> Figure:
    figure, (above, below) = new_figure((7.2, 6.0), 2)
    top = float(measured.fitted.max())
    above.plot(measured.lines_hz, measured.power / top, label="measured", **PROGRAMMED)
    above.plot(measured.lines_hz, measured.fitted / top, label="fitted mode", **ACTUAL)
    above.set(xlabel="frequency, Hz", ylabel="power, share of the peak", yscale="log")
    above.set_title(f"Power along {measured.axis}")
    above.legend()
    is_shown = measured.spectrum_hz <= _MOST_HZ
    f, power = measured.spectrum_hz[is_shown], measured.spectrum[is_shown]
    below.fill_between(f, power / power.max(), color="0.85", label="power, all axes")
    fine_hz = np.linspace(max(float(f[0]), 1.0), float(f[-1]), _POINTS)
    for train, style in zip(measured.trains, (ACTUAL, PLANNED), strict=False):
        residual = residual_vibration(train, fine_hz, measured.damping_ratio)
        below.plot(fine_hz, residual, label=train.name, **style)
    below.set(xlabel="frequency, Hz", ylabel="residual vibration V", ylim=(0.0, 1.05))
    below.set_title("Residual vibration with each shaper")
    below.legend()
    return figure


def _sensitivity(
    shaper: Shaper, modes: Sequence[FlexibleMode], tolerances: Sequence[float]
) -> Figure:
    figure, axes = new_figure((7.2, 4.0))
    lowest_hz = _SPAN[0] * min(m.frequency_hz for m in modes)
    highest_hz = _SPAN[1] * max(m.frequency_hz for m in modes)
    f = np.linspace(lowest_hz, highest_hz, _POINTS)
    # The curves differ in dash and marker, for readers without colour.
    dashes = ("-", (0, (6, 2)), (0, (1, 1.5)), (0, (4, 1, 1, 1)))
    for i, damping in enumerate(dict.fromkeys((*(m.damping_ratio for m in modes), 0.0))):
        curve = {**ACTUAL, "linestyle": dashes[i % len(dashes)], "color": str(0.18 * min(i, 3))}
        label = f"damping ratio {damping:g}"
        axes.plot(f, residual_vibration(shaper, f, damping), label=label, **curve)
    for tolerance in dict.fromkeys(tolerances):
        axes.axhline(tolerance, label=f"tolerance {tolerance:g}", **LIMIT)
    # Labels of modes with close frequencies are placed one below the other.
    row, previous_hz = 0, -highest_hz
    for m in sorted(modes, key=lambda one: one.frequency_hz):
        row = row + 1 if m.frequency_hz - previous_hz < _NAME_WIDE * (highest_hz - lowest_hz) else 0
        previous_hz = m.frequency_hz
        axes.axvline(m.frequency_hz, **{**PLANNED, "linewidth": 0.9})
        axes.annotate(
            f" {m.frequency_hz:g} Hz",
            (m.frequency_hz, 0.96 - 0.05 * (row % 6)),
            xycoords=axes.get_xaxis_transform(),
            bbox=_READABLE,
        )
    axes.set(
        xlabel="undamped frequency, Hz", ylabel="residual vibration V", xlim=(lowest_hz, highest_hz)
    )
    axes.set_ylim(0.0, None)
    figure.legend(loc="outside lower center", ncols=3)
    axes.set_title("Sensitivity")
    return figure


def _step(shaper: Shaper) -> Figure:
    figure, axes = new_figure((7.2, 3.2))
    margin = 0.15 * max(shaper.duration_s, 1e-9)
    edges = np.concatenate([[-margin], shaper.times_s, [shaper.duration_s + margin]])
    axes.stairs(np.concatenate([[0.0], shaper.levels]), edges, baseline=None, label="shaped step")
    axes.plot(shaper.times_s, shaper.amplitudes, label="impulses", **PROGRAMMED)
    axes.vlines(shaper.times_s, 0.0, shaper.amplitudes, colors="black", linewidth=0.8)
    axes.set(xlabel="time, s", ylabel="amplitude, level")
    figure.legend(loc="outside lower center", ncols=2)
    axes.set_title("Impulses and shaped step")
    return figure
