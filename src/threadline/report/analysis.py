"""The report of an analysis: Bode, Nyquist, Nichols, root locus and steps of every axis."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from threadline.dynamics.analysis import HERTZ, AxisAnalysis, LoopFigures
from threadline.dynamics.poles import root_locus
from threadline.dynamics.responses import speed_response
from threadline.dynamics.without_loop import Analysis, CylinderAnalysis, PositionDriveAnalysis
from threadline.identify.measured_response import MeasuredResponse
from threadline.machine import Machine
from threadline.report.document import Document, Table, origin_facts
from threadline.report.publish import write_document
from threadline.report.searches import NOTHING_TRIED, experiment_figure, experiment_table
from threadline.report.style import (
    ACTUAL,
    LIMIT,
    PLANNED,
    PROGRAMMED,
    WORST,
    figure_style,
    new_figure,
)
from threadline.search.experiments import Campaign

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DB_FLOOR = 1e-6
_SHOWN_RADIUS = 3.0


def write_analysis(
    machine: Machine,
    analyses: Mapping[str, Analysis],
    warnings: list[str],
    folder: Path,
    measured: MeasuredResponse | None = None,
    tried: Mapping[str, Campaign] = NOTHING_TRIED,
) -> Path:
    """Write the report of ``analyses`` into ``folder``; return the path of the HTML page.

    Parameters
    ----------
    measured
        Measured frequency response, drawn with the model's.
    tried
        Experiments on the simulated machine, by axis.

    Raises
    ------
    OSError
        If the folder cannot be written.
    """
    with figure_style():
        figures: dict[str, Figure] = {}
        captions: dict[str, str] = {}
        for axis, analysis in analyses.items():
            if not isinstance(analysis, AxisAnalysis):
                continue  # an axis without a control loop has no figures
            for name, (figure, caption) in axis_figures(analysis, measured).items():
                figures[f"{name}-{axis}"] = figure
                captions[f"{name}-{axis}"] = f"Axis {axis}. {caption}"
            if axis in tried:
                figure, caption = experiment_figure(tried[axis])
                figures[f"experiments-{axis}"] = figure
                captions[f"experiments-{axis}"] = f"Axis {axis}. {caption}"
        document = Document(
            title=f"Analysis of {machine.name}",
            subtitle=machine.title,
            verdicts=[(a.verdict(), a.stable) for a in analyses.values()],
            warnings=tuple(warnings),
            tables=[*analysis_tables(analyses), *map(experiment_table, tried.values())],
            figures=figures,
            captions=captions,
            facts=origin_facts(machine),
        )
        return write_document(document, folder, "analysis")


def analysis_tables(analyses: Mapping[str, Analysis]) -> list[Table]:
    """Return the tables of an analysis: control loops, network, steps, modes of other axes."""
    axes = {name: a for name, a in analyses.items() if isinstance(a, AxisAnalysis)}
    others = {name: a for name, a in analyses.items() if isinstance(a, CylinderAnalysis)}
    position_drives = {
        name: a for name, a in analyses.items() if isinstance(a, PositionDriveAnalysis)
    }
    return [
        *(_axis_tables(axes) if axes else ()),
        *(_position_drive_tables(position_drives) if position_drives else ()),
        *(_cylinder_tables(others) if others else ()),
    ]


def _position_drive_tables(analyses: Mapping[str, PositionDriveAnalysis]) -> list[Table]:
    rows = [
        [
            axis,
            a.drive,
            " ".join(f"{m.frequency_hz:.4g} ({m.damping:.4f})" for m in a.locked) or "-",
            _text(a.resonance_hz, ".4g"),
            f"{a.torque:.4g} {a.unit}",
            f"{a.torque_at_speed:.4g} {a.unit}",
            f"{a.needed:.4g} {a.unit}",
        ]
        for axis, a in analyses.items()
    ]
    return [
        Table(
            title="Drives that take positions",
            header=("axis", "drive", "load Hz", "step Hz", "at rest", "at speed", "asked"),
            rows=rows,
            note="Modes (damping ratio) of the load with the motor held; the frequency at which "
            "a stepper without load oscillates about its step, which full steps at that rate "
            "excite; torque or force at standstill and at the speed limit of the axis, and the "
            "torque or force needed at the limits of speed and acceleration, links rigid.",
        )
    ]


def _cylinder_tables(analyses: Mapping[str, CylinderAnalysis]) -> list[Table]:
    rows = [
        [
            axis,
            " ".join(f"{m.frequency_hz:.4g} ({m.damping:.4f})" for m in a.standing) or "-",
            " ".join(f"{m.frequency_hz:.4g} ({m.damping:.4f})" for m in a.sliding) or "-",
            f"{a.shaped.frequency_hz:.4g} ({a.shaped.damping:.4f})",
            f"{a.speed_m_s:.4g}",
        ]
        for axis, a in analyses.items()
    ]
    return [
        Table(
            title="Cylinders",
            header=("axis", "standing Hz", "sliding Hz", "shaped Hz", "m/s at level 1"),
            rows=rows,
            note="Modes (damping ratio) while the piston stands in its housing and while it slides "
            "on its air; the mode that its valves excite, for which shapers are made.",
        )
    ]


def _axis_tables(analyses: Mapping[str, AxisAnalysis]) -> list[Table]:
    loops, network, steps = [], [], []
    for axis, a in analyses.items():
        for figures in _models(a):
            worst = figures.margins.worst_phase
            loops.append(
                [
                    f"{axis} {figures.model}",
                    "stable" if figures.stable else f"UNSTABLE ({figures.unstable})",
                    _text(figures.bandwidth_hz, ".2f"),
                    _text(figures.gain_margin, ".3f"),
                    _text(None if worst is None else worst.phase_margin_deg, ".2f"),
                    _text(None if worst is None else worst.omega_rad_s * HERTZ, ".2f"),
                    f"{figures.margins.modulus_margin:.3f}",
                ]
            )
        motor = a.actuator
        network.append(
            [
                axis,
                " ".join(f"{m.frequency_hz:.2f} ({m.damping:.3f})" for m in a.locked) or "-",
                " ".join(f"{m.frequency_hz:.2f} ({m.damping:.3f})" for m in a.free) or "-",
                _text(motor.dc_gain, ".2f"),
                _text(motor.loaded_dc_gain, ".2f"),
                _text(motor.natural_rad_s, ".1f"),
                _text(motor.damping, ".3f"),
            ]
        )
        for name, step in a.steps.items():
            steps.append(
                [
                    f"{axis} {name}",
                    f"{step.rise_s * 1e3:.1f}",
                    f"{step.settling_s * 1e3:.1f}",
                    f"{step.overshoot * 100:.1f}",
                    f"{step.steady_state_error * 100:.3f}",
                ]
            )
    return [
        Table(
            title="Loops",
            header=(
                "axis, model", "stability", "bandwidth Hz", "gain margin", "phase margin deg",
                "crossover Hz", "least |1+L|",
            ),
            rows=loops,
            note="Sampled: tick by tick, with the fraction of a tick in the dead time. Continuous: "
            "the filter by Tustin's rule, dead time exact, plus half a tick for the held output.",
        ),
        Table(
            title="Network and actuators",
            header=("axis", "locked Hz", "free Hz", "rad/s/V", "loaded", "wn rad/s", "zeta"),
            rows=network,
            note="Undamped modes (damping ratio) with the motor locked and turning freely; speed "
            "per volt, wn and zeta of the actuator alone, and speed per volt with its load.",
        ),
        Table(
            title="Steps of the sampled loop",
            header=("output", "rise 10-90 % ms", "settling 2 % ms", "overshoot %", "error %"),
            rows=steps,
        ),
    ]  # fmt: skip


def _models(a: AxisAnalysis) -> tuple[LoopFigures, ...]:
    return (a.sampled,) if a.continuous is None else (a.sampled, a.continuous)


def _text(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


def axis_figures(
    a: AxisAnalysis, measured: MeasuredResponse | None
) -> dict[str, tuple[Figure, str]]:
    """Return the figures of an axis with a loop, each with its caption, by its name."""
    figures = {
        "bode": (_bode(a), "Open loop, sampled and continuous; crossovers marked."),
        "plant": (
            _plant(a, measured),
            "Speed at the sensor per volt relative to zero frequency, with its dead time"
            + (", and the measured response." if measured is not None else "."),
        ),
        "nyquist": (_nyquist(a), "Open loop, sampled, near the critical point."),
        "nichols": (_nichols(a), "Open loop, sampled; crosses are the critical points."),
    }
    if a.continuous is not None:
        figures["locus"] = (
            _locus(a),
            "Closed-loop poles of the continuous model over the gain, dead time exact.",
        )
    if a.steps:
        figures["steps"] = (_steps(a), "Unit steps of the sampled loop.")
    return figures


def _bode(a: AxisAnalysis) -> Figure:
    figure, (magnitude_panel, phase_panel) = new_figure((7.2, 5.4), 2, sharex=True)
    for loop in reversed(_models(a)):
        style = PLANNED if loop is a.continuous else ACTUAL
        hertz = loop.grid_rad_s * HERTZ
        magnitude_panel.semilogx(hertz, _db(loop.response), label=loop.model, **style)
        phase_panel.semilogx(hertz, np.degrees(np.unwrap(np.angle(loop.response))), **style)
    for number, crossover in enumerate(a.sampled.margins.gain_crossovers):
        label = "" if number else "gain crossover: phase margin"
        phase_panel.axvline(crossover.omega_rad_s * HERTZ, label=label, **LIMIT)
    for crossing in a.sampled.margins.phase_crossovers[:1]:
        label = "phase crossover: gain margin"
        magnitude_panel.axvline(crossing.omega_rad_s * HERTZ, label=label, **LIMIT)
    magnitude_panel.axhline(0.0, color="black", lw=0.6)
    phase_panel.axhline(-180.0, color="black", lw=0.6)
    magnitude_panel.set_ylim(-80, None)
    phase_panel.set_ylim(-720, None)
    magnitude_panel.set_xlim(0.1, a.sampled.grid_rad_s[-1] * HERTZ)
    magnitude_panel.set_ylabel("|L| [dB]")
    phase_panel.set_ylabel("phase [deg]")
    phase_panel.set_xlabel("frequency [Hz]")
    magnitude_panel.set_title(f"Axis {a.axis}: Bode plot of the open loop")
    magnitude_panel.legend(loc="lower left")
    if a.sampled.margins.gain_crossovers:
        phase_panel.legend(loc="lower left")
    return figure


def _plant(a: AxisAnalysis, measured: MeasuredResponse | None) -> Figure:
    figure, (magnitude_panel, phase_panel) = new_figure((7.2, 5.4), 2, sharex=True)
    hertz = np.geomspace(1.0, 200.0, 800)
    magnitude, phase = speed_response(a.loop, 2 * np.pi * hertz)
    magnitude_panel.semilogx(hertz, magnitude, label="model", **ACTUAL)
    phase_panel.semilogx(hertz, phase, **ACTUAL)
    if measured is not None:
        shown = {**PROGRAMMED, "markersize": 2.4}
        magnitude_panel.semilogx(
            measured.frequency_hz, measured.magnitude_db, label="measured", **shown
        )
        phase_panel.semilogx(measured.frequency_hz, measured.phase_deg, **shown)
    magnitude_panel.set_ylabel("speed per volt [dB]")
    phase_panel.set_ylabel("phase [deg]")
    phase_panel.set_xlabel("frequency [Hz]")
    magnitude_panel.set_title(f"Axis {a.axis}: from the controller's volts to speed at the sensor")
    magnitude_panel.legend(loc="lower left")
    return figure


def _nyquist(a: AxisAnalysis) -> Figure:
    figure, axes = new_figure((5.6, 5.4))
    response = a.sampled.response
    axes.plot(response.real, response.imag, label="frequency rising from 0", **ACTUAL)
    axes.plot(response.real, -response.imag, label="mirrored", **PLANNED)
    circle = np.exp(1j * np.linspace(0, 2 * np.pi, 300))
    axes.plot(circle.real, circle.imag, color="0.6", lw=0.7)
    free_circle = -1 + a.sampled.margins.modulus_margin * circle
    axes.plot(free_circle.real, free_circle.imag, label="largest free circle about -1", **LIMIT)
    axes.plot([-1], [0], **WORST)
    axes.set_xlim(-_SHOWN_RADIUS, _SHOWN_RADIUS)
    axes.set_ylim(-_SHOWN_RADIUS, _SHOWN_RADIUS)
    axes.set_aspect("equal")
    axes.set_xlabel("real part")
    axes.set_ylabel("imaginary part")
    axes.set_title(f"Axis {a.axis}: Nyquist plot")
    axes.legend(loc="upper right")
    return figure


def _nichols(a: AxisAnalysis) -> Figure:
    figure, axes = new_figure((6.4, 5.0))
    phase = np.degrees(np.unwrap(np.angle(a.sampled.response)))
    for level in (-6.0, -3.0, 0.0, 3.0, 6.0):
        _level_of_closed_loop(axes, level)
    axes.plot(phase, _db(a.sampled.response), label="open loop, sampled", **ACTUAL)
    axes.plot([-180, -540], [0, 0], **{**WORST, "marker": "x"})
    axes.set_xlim(-560, 0)
    axes.set_ylim(-40, 25)
    axes.set_xlabel("phase [deg]")
    axes.set_ylabel("|L| [dB]")
    axes.set_title(f"Axis {a.axis}: Nichols plot, with contours of the closed loop in dB")
    axes.legend(loc="lower right")
    return figure


def _level_of_closed_loop(axes: Axes, level_db: float) -> None:
    """Draw the contour of ``|L / (1 + L)|`` at a level: L = T / (1 - T) for T on a circle."""
    angles = np.linspace(0.02, 2 * np.pi - 0.02, 721)
    T = 10 ** (level_db / 20) * np.exp(-1j * angles)
    L = T / (1 - T)
    phase = np.degrees(np.unwrap(np.angle(L)))
    phase -= 360.0 * np.ceil(phase[0] / 360.0)
    for shift in (0.0, -360.0):
        axes.plot(phase + shift, _db(L), color="0.75", lw=0.6, zorder=1)
    label_index = int(np.argmax(phase))
    axes.annotate(
        f"{level_db:g}", (phase[label_index], _db(L)[label_index]), fontsize=6, color="0.4"
    )


def _locus(a: AxisAnalysis) -> Figure:
    locus = root_locus(a.loop)
    figure, axes = new_figure((6.4, 5.0))
    all_poles = np.concatenate(locus.poles)
    axes.plot(
        all_poles.real, all_poles.imag, ".", color="0.55", ms=2.0, label="poles as the gain rises"
    )
    axes.plot(locus.now.real, locus.now.imag, "s", color="#0072B2", ms=4.5, label="now")
    axes.plot(locus.open_poles.real, locus.open_poles.imag, "x", color="black", label="open poles")
    axes.plot(locus.open_zeros.real, locus.open_zeros.imag, "o", **_HOLLOW, label="open zeros")
    for gain, omega in locus.critical[:1]:
        label = f"on its limit at {gain:.3g} x the gain, {omega * HERTZ:.3g} Hz"
        axes.plot([0, 0], [omega, -omega], label=label, **WORST)
    axes.axvline(0.0, color="black", lw=0.6)
    # The figure shows the poles of the load; the faster poles of the dead time lie outside it.
    half_width = 1.25 * max(float(np.abs(a.loop.plant.poles()).max()), 50.0)
    axes.set_xlim(-half_width, 0.4 * half_width)
    axes.set_ylim(-half_width, half_width)
    axes.set_xlabel("real part [1/s]")
    axes.set_ylabel("imaginary part [rad/s]")
    axes.set_title(f"Axis {a.axis}: root locus")
    figure.legend(loc="outside lower center", ncols=3, fontsize=7)
    return figure


_HOLLOW: dict[str, Any] = {"color": "black", "markerfacecolor": "none"}


def _steps(a: AxisAnalysis) -> Figure:
    figure, axes = new_figure((7.2, 3.4))
    shown_s = 0.0
    for (name, step), style in zip(a.steps.items(), (PLANNED, ACTUAL), strict=False):
        shown_s = max(shown_s, 1.6 * step.settling_s, 4.0 * step.rise_s)
        axes.plot(step.time_s * 1e3, step.value, label=name, **style)
    axes.axhline(1.02, **LIMIT, label="2 %")
    axes.axhline(0.98, **LIMIT)
    axes.set_xlim(0, shown_s * 1e3)
    axes.set_xlabel("time [ms]")
    axes.set_ylabel("position per unit step")
    axes.set_title(f"Axis {a.axis}: step response")
    axes.legend(loc="lower right")
    return figure


def _db(response: np.ndarray) -> np.ndarray:
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(response), _DB_FLOOR)))
