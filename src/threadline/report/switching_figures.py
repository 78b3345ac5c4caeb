"""The figures of a proof on an on/off machine: cycle, frame, residual vibration of each step."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Plan
from threadline.files import Recording
from threadline.proof.pipeline import Proof
from threadline.report.style import ACTUAL, AXES, LIMIT, PLANNED, new_figure
from threadline.report.traces import extremes
from threadline.verdict.switch_run import SwitchRun

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MICRO = 1e6
_MOST_SAMPLES = 20_000
_PARTS: Any = {"color": "0.45", "linewidth": 0.6, "linestyle": (0, (1, 2)), "zorder": 0}
_READABLE: Any = {"facecolor": "white", "edgecolor": "none", "pad": 0.4}
"""White background for a number, so that a limit line does not cross it."""
_LEAST_UM = 1.0
"""Lower end of the logarithmic scale of residual vibration, micrometres."""


def shaper_words(plan: Plan) -> str:
    """Return the shaper of a plan in words; the job may have shapers or levels, too."""
    job_shapes = any(
        m.levels.realised is not None or len(m.levels.levels) > 2 for m in plan.scheduled.moves
    )
    return plan.options.get("shaper", "shapers of the move list" if job_shapes else "no shaper")


def _mark_steps(panel: Axes, run: SwitchRun, *, names: bool) -> None:
    """Separate the steps by thin lines, with their names above the panel."""
    for step in run.steps:
        panel.axvline(step.begin_s, **_PARTS)
        if names:
            panel.annotate(
                step.name,
                (0.5 * (step.begin_s + step.end_s), 1.02),
                xycoords=("data", "axes fraction"),
                ha="center",
                fontsize=7,
            )


def _thinned(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return times and values, (n,) each; for a long trace the extremes of every stretch."""
    if len(values) <= _MOST_SAMPLES:
        return time_s, values
    keep = extremes(values[:, None], np.arange(len(values)) * (_MOST_SAMPLES // 2) // len(values))
    return time_s[keep], values[keep]


def cycle_figure(proof: Proof, recording: Recording) -> Figure:
    """Draw the pistons and every output over the cycle of a run."""
    run = SwitchRun(recording, proof.plan)
    axes = proof.plan.job.axes
    outputs = proof.plan.scheduled.commands.outputs
    height = 1.3 * len(axes) + 0.19 * len(outputs) + 0.8
    figure, panels = new_figure(
        (7.2, height),
        len(axes) + 1,
        sharex=True,
        height_ratios=[*(1.3 for _ in axes), 0.19 * len(outputs)],
    )
    loads = recording.samples_of(f"{axis}.load" for axis in axes)
    for panel, axis in zip(panels, axes, strict=False):
        time_s, values = _thinned(*loads[f"{axis}.load"])
        factor, unit = proof.plan.machine.usual(axis)
        panel.plot(time_s, values * factor, **ACTUAL)
        panel.set_ylabel(f"{axis} {unit}")
        _mark_steps(panel, run, names=axis == axes[0])
    lanes = panels[-1]
    for row in range(len(outputs)):
        is_on = run.states[:, row] != 0
        edges = np.flatnonzero(np.diff(np.concatenate(([0], is_on.astype(np.int8), [0]))))
        end_s = np.append(run.time_s, run.time_s[-1])
        spans = [
            (float(end_s[a]), float(end_s[b] - end_s[a])) for a, b in edges.reshape(-1, 2).tolist()
        ]
        lanes.broken_barh(spans, (row - 0.35, 0.7), facecolors="#0072B2")
    lanes.set_yticks(range(len(outputs)), outputs, fontsize=6)
    lanes.set_ylim(len(outputs) - 0.5, -0.5)
    lanes.set_xlabel("s")
    _mark_steps(lanes, run, names=False)
    return figure


def frame_figure(proof: Proof, recording: Recording, unshaped: Proof | None) -> Figure:
    """Draw the motion of the frame over the cycle of a run, shaped and unshaped."""
    run = SwitchRun(recording, proof.plan)
    axes = proof.plan.job.axes
    figure, panels = new_figure((7.2, 1.9 * len(axes) + 0.6), len(axes), sharex=True)
    frames = [f"{axis}.frame" for axis in axes]
    curves = [(recording.samples_of(frames), ACTUAL, shaper_words(proof.plan))]
    if unshaped is not None:
        curves.insert(0, (unshaped.recording.samples_of(frames), PLANNED, "without a shaper"))
    for panel, axis in zip(panels, axes, strict=True):
        for samples, line_style, label in curves:
            time_s, values = _thinned(*samples[f"{axis}.frame"])
            panel.plot(time_s, values * MICRO, label=label, **line_style)
        panel.set_ylabel(f"frame along {axis}, um")
        _mark_steps(panel, run, names=axis == axes[0])
    panels[-1].set_xlabel("s")
    _legend_below(figure, panels[0])
    return figure


def residual_figure(proof: Proof, unshaped: Proof | None) -> Figure:
    """Draw the residual vibration after each step, with and without shaping, and its limit."""
    axes = proof.plan.job.axes
    figure, panels = new_figure((7.2, 2.1 * len(axes) + 0.4), len(axes), sharex=True)
    for panel, axis in zip(panels, axes, strict=True):
        cases = [(proof, "#0072B2", "", shaper_words(proof.plan))]
        if unshaped is not None:
            cases.append((unshaped, "0.75", "//", "without a shaper"))
        names: list[str] = []
        for index, (case_proof, colour, hatch, label) in enumerate(cases):
            rows = [
                r
                for r in case_proof.verdict.results
                if r.name == "residual_vibration" and r.axis == axis and r.step
            ]
            names = [r.step for r in rows]
            sizes = [(r.measured or 0.0) * MICRO for r in rows]
            bar_places = np.arange(len(rows)) + 0.4 * (index - 0.5 * (len(cases) - 1))
            bars = panel.bar(bar_places, sizes, 0.38, color=colour, hatch=hatch, label=label)
            labels = ["?" if r.measured is None else f"{r.measured * MICRO:.0f}" for r in rows]
            panel.bar_label(bars, labels, fontsize=6, padding=1, bbox=_READABLE, zorder=5)
            limits = [r.limit for r in rows]
            for step_index, limit in zip(range(len(rows)), limits, strict=True):
                if limit is not None and index == 0:
                    panel.plot([step_index - 0.45, step_index + 0.45], [limit * MICRO] * 2, **LIMIT)
        panel.set_yscale("symlog", linthresh=_LEAST_UM)
        panel.set_ylabel(f"frame along {axis}, um")
        panel.set_xticks(range(len(names)), names)
    _legend_below(figure, panels[0])
    return figure


def _legend_below(figure: Figure, panel: Axes) -> None:
    """Put the legend of a panel below the figure, where it covers no curve and no bar."""
    handles, labels = panel.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))


def residuals_figure(proofs: Sequence[Proof]) -> Figure:
    """Draw the residual vibration after each step under every shaper, and its limit."""
    axes = proofs[0].plan.job.axes
    figure, panels = new_figure((7.2, 2.1 * len(axes) + 0.6), len(axes), sharex=True)
    for panel, axis in zip(panels, axes, strict=True):
        for proof, line_style, marker in zip(proofs, cycle(AXES), cycle("osvDX^"), strict=False):
            rows = [
                r
                for r in proof.verdict.results
                if r.name == "residual_vibration" and r.axis == axis and r.step
            ]
            sizes = [(r.measured or 0.0) * MICRO for r in rows]
            label = shaper_words(proof.plan)
            panel.plot(range(len(rows)), sizes, marker=marker, label=label, **line_style)
            limits = [r.limit for r in rows]
        for step_index, limit in enumerate(limits):
            if limit is not None:
                panel.plot([step_index - 0.45, step_index + 0.45], [limit * MICRO] * 2, **LIMIT)
        panel.set_yscale("symlog", linthresh=_LEAST_UM)
        panel.set_ylabel(f"frame along {axis}, um")
        panel.set_xticks(range(len(rows)), [r.step for r in rows])
    _legend_below(figure, panels[0])
    return figure
