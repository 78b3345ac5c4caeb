"""The figures of a proof: path, unrolled path, profiles, errors along the job, binding limits."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.commands.plan import Following, Plan
from threadline.files import ChannelKind, Recording
from threadline.machine.vary import derate, with_reserve
from threadline.motion.path.types import Timing
from threadline.motion.timing.optimal.binding import BINDS, KINDS, Binding, binding
from threadline.proof.options import options_from
from threadline.proof.pipeline import Proof
from threadline.report.style import ACTUAL, AXES, LIMIT, PLANNED, PROGRAMMED, WORST, new_figure
from threadline.report.traces import Traces, envelope, run_words, worst_result
from threadline.verdict import Result, Status, Verdict, of_moving_axes, percent_used

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DEGREES = 180.0 / np.pi

PROFILE_IN = (7.2, 4.6)
"""Size of the profile of an axis, inches: two of them fit a page."""
_BELOW = 0.04  # share of the height of a panel that is below 0
_BAR_IN = 0.19  # height of a bar with its label, inches
_STRIP = 0.38  # height of a strip, inches


def display(proof: Proof, axis: str) -> tuple[float, str]:
    """Return the factor and unit in which positions of ``axis`` are shown."""
    rotary = proof.plan.machine.axes[axis].kind == "rotary"
    return (DEGREES, "deg") if rotary else (1e3, "mm")


def all_figures(proof: Proof, traces: Traces) -> dict[str, Figure]:
    """Return all figures of a proof by file name; they depend on the axes that move."""
    axes = [axis for axis in proof.plan.motion.trajectory.axes if axis in traces.drawn_axes]
    linear = [a for a in axes if proof.plan.machine.axes[a].kind == "linear" and moves(traces, a)]
    rotary = [a for a in axes if proof.plan.machine.axes[a].kind == "rotary" and moves(traces, a)]
    figures: dict[str, Figure] = {}
    for first, second in pairwise(linear):
        figures[f"path-{first}{second}"] = path_figure(proof, traces, first, second)
    for turning in rotary[:1]:
        for along in linear[:1]:
            figures[f"path-{turning}{along}"] = path_figure(proof, traces, turning, along)
    for axis in [*linear, *rotary]:
        figures[f"profile-{axis}"] = profile_figure(proof, traces, axis)
    if traces.actual:
        figures["errors"] = error_figure(proof, traces)
    else:
        figures["criteria"] = criteria_figure(proof)
    tension = tension_figure(proof.verdict, traces.run.recording)
    if tension is not None:
        figures["tension"] = tension
    return figures


def moves(traces: Traces, axis: str) -> bool:
    """Return whether the axis has commands that move it."""
    commanded = traces.commanded.get(axis, np.zeros(1))
    return bool(len(commanded) and np.ptp(commanded) > 0)


def path_figure(proof: Proof, traces: Traces, first: str, second: str) -> Figure:
    """Draw two axes against each other: programmed points, planned and actual path.

    Two linear axes get a second panel, to scale, around the largest contour error, because an
    over-travel of half a millimetre is invisible in a figure of half a metre.
    """
    same_unit = display(proof, first)[1] == display(proof, second)[1]
    worst = worst_result(proof.verdict, "contour_error")
    zoomed = same_unit and worst is not None and worst.time_s is not None
    figure, panels = new_figure((7.2, 6.8 if zoomed else 3.8), 2 if zoomed else 1)
    for number, panel in enumerate(panels):
        _draw_path(proof, traces, panel, (first, second), near=number > 0)
        if worst is not None and worst.time_s is not None:
            _mark_worst_on_path(proof, traces, panel, (first, second), worst)
        panel.margins(0.06)
        if same_unit:
            panel.set_aspect("equal", adjustable="datalim")
    panels[0].set_title(f"Path {first}-{second}")
    panels[0].legend(loc="lower left", bbox_to_anchor=(0.18, 1.0), ncols=4, borderaxespad=0.0)
    if zoomed and worst is not None and worst.time_s is not None:
        x, y = _place_at(proof, traces, (first, second), worst.time_s)
        half_height = max(6.0 * abs(worst.measured or 0.0) * 1e3, 0.5)
        panels[1].set_xlim(x - 1.6 * half_height, x + 1.6 * half_height)
        panels[1].set_ylim(y - half_height, y + half_height)
        panels[1].set_aspect("equal", adjustable="box")
        panels[1].set_title("Around the largest contour error")
    return figure


def _draw_path(
    proof: Proof, traces: Traces, panel: Axes, pair: tuple[str, str], *, near: bool
) -> None:
    """Draw the path of two axes: programmed points, planned and actual path.

    A thinned trace is drawn as points, because the path between its samples is not straight. With
    ``near``, only the parts with all samples are drawn, as lines.
    """
    first, second = pair
    columns = [proof.plan.motion.programmed.axes.index(axis) for axis in pair]
    (fx, ux), (fy, uy) = display(proof, first), display(proof, second)
    as_dots = traces.stride > 1 and not near
    hidden = np.where(traces.whole | (not near), 0.0, np.nan)
    planned = {axis: traces.planned[axis][:, 0] for axis in pair}
    lines = [("planned", PLANNED, 2.6, planned)]
    if traces.actual:
        lines.append(("actual", ACTUAL, 1.0, traces.actual))
    for label, line_style, size, positions in lines:
        dot_style = (
            {"linestyle": "none", "marker": ".", "markersize": size, "rasterized": True}
            if as_dots
            else {}
        )
        panel.plot(
            (positions[first] + hidden) * fx,
            positions[second] * fy,
            label=label,
            **line_style | dot_style,
        )
    panel.plot(
        traces.vertices[:, columns[0]] * fx,
        traces.vertices[:, columns[1]] * fy,
        label="programmed",
        **PROGRAMMED,
    )
    panel.set_xlabel(f"{first} [{ux}]")
    panel.set_ylabel(f"{second} [{uy}]")


def _place_at(
    proof: Proof, traces: Traces, pair: tuple[str, str], time_s: float
) -> tuple[float, float]:
    """Return the position of two axes at an instant, in the units of the figure.

    It is interpolated linearly between samples, as for the verdict, because a worst place may lie
    there.
    """
    x, y = (
        float(np.interp(time_s, traces.time_s, traces.actual[axis])) * display(proof, axis)[0]
        for axis in pair
    )
    return x, y


def _mark_worst_on_path(
    proof: Proof, traces: Traces, panel: Axes, pair: tuple[str, str], worst: Result
) -> None:
    assert worst.time_s is not None
    x, y = _place_at(proof, traces, pair, worst.time_s)
    line = "" if worst.job_line is None else f", line {worst.job_line}"
    panel.plot([x], [y], label=f"largest contour error{line}", **WORST)


def profile_figure(proof: Proof, traces: Traces, axis: str) -> Figure:
    """Draw displacement, velocity and acceleration of one axis, planned and, if known, actual."""
    figure, rows = new_figure(PROFILE_IN, 3, sharex=True)
    factor, unit = display(proof, axis)
    limits = proof.plan.machine.axes[axis]
    derivatives = (traces.actual, traces.velocity, traces.acceleration)
    actual = [by_axis.get(axis) for by_axis in derivatives]
    bounds = (None, limits.velocity.si, limits.acceleration.si)
    quantities = ("displacement", "velocity", "acceleration")
    units = (unit, f"{unit}/s", f"{unit}/s²")
    planned = traces.planned[axis]
    for row, (name, shown_unit, bound) in enumerate(zip(quantities, units, bounds, strict=True)):
        panel: Axes = rows[row]
        actual_values = actual[row]
        _profile(
            panel,
            traces,
            planned[:, row] * factor,
            None if actual_values is None else actual_values * factor,
        )
        panel.set_ylabel(f"{name} [{shown_unit}]", fontsize=7.5)
        if bound is not None and _limit_is_near(planned[:, row], actual_values, bound):
            for sign in (-1.0, 1.0):
                label = "limit" if sign > 0 else None
                panel.axhline(sign * bound * factor, label=label, **LIMIT)
    rows[0].set_title(f"Axis {axis}: displacement, velocity, acceleration")
    handles = {
        label: line
        for row in rows
        for line, label in zip(*row.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=len(handles))
    rows[2].set_xlabel("time [s]")
    return figure


def _profile(panel: Axes, traces: Traces, planned: FloatArray, actual: FloatArray | None) -> None:
    """Draw planned and, if known, actual values over time; for a long job bands of their extremes.

    A line through the kept samples of a long job would hide the others.
    """
    if traces.stride == 1:
        panel.plot(traces.time_s, planned, label="planned", **PLANNED)
        if actual is not None:
            panel.plot(traces.time_s, actual, label="actual", **ACTUAL)
        return
    time_s, low, high = envelope(traces.time_s, planned)
    panel.fill_between(
        time_s, low, high, step="post", facecolor="0.8", edgecolor="0.45", lw=1.0, label="planned"
    )
    if actual is None:
        return
    time_s, low, high = envelope(traces.time_s, actual)
    for edge, label in ((low, "actual"), (high, None)):
        panel.plot(time_s, edge, drawstyle="steps-post", label=label, **ACTUAL)


def _limit_is_near(planned: FloatArray, actual: FloatArray | None, bound: float) -> bool:
    """Return whether a limit is so near the curves that drawing it does not flatten them."""
    peak = max(float(np.abs(values).max()) for values in (planned, actual) if values is not None)
    return bool(np.isfinite(bound)) and 0.35 * bound < peak


def error_figure(proof: Proof, traces: Traces) -> Figure:
    """Draw contour and tracking error along the job, and each measured error with its limit."""
    height = max(2.0, _BAR_IN * len(_limited(proof)))
    figure, (contour, tracking, bars) = new_figure(
        (7.2, 6.2 + height), 3, height_ratios=[2.0, 2.0, height]
    )
    _contour_along(proof, traces, contour)
    radius = proof.plan.machine.radius_m
    for index, axis in enumerate(proof.plan.motion.trajectory.axes):
        if axis not in traces.commanded or not moves(traces, axis):
            continue
        row = proof.plan.machine.axis_names.index(axis)
        error = (traces.actual[axis] - traces.commanded[axis]) * radius[row] * 1e3
        style = AXES[index % len(AXES)]
        tracking.plot(traces.time_s, error, label=axis, **style)
    worst = worst_result(proof.verdict, "tracking_error")
    if worst is not None and worst.time_s is not None:
        other_run = worst.run is not None and worst.run != traces.run.number
        note = f", in {run_words(proof.verdict, worst.run)}" if worst.run and other_run else ""
        if worst.run is None and proof.verdict.tolerances is not None and worst.note:
            note = f", {worst.note}"  # the worst run belongs to a machine whose runs are not drawn
        tracking.axvline(worst.time_s, label=_worst_label(worst, note), **LIMIT)
    tracking.set_xlabel("time [s]")
    tracking.set_ylabel("actual - commanded [mm]")
    tracking.margins(y=0.12)
    tracking.set_title("Tracking error along the job, at the tool (lag counts)")
    _legend_beside(tracking)
    _bars(proof, bars)
    return figure


def tension_figure(verdict: Verdict, recording: Recording) -> Figure | None:
    """Draw the tension of the fibre over time, with its worst place; None without a tension."""
    names = [one.name for one in recording.channels if one.kind is ChannelKind.TENSION]
    if not names:
        return None
    figure, panel = new_figure((7.2, 3.0))
    times_s, lowest, highest = envelope(*recording.samples_of(names)[names[0]])
    panel.fill_between(times_s, lowest, highest, step="post", color=ACTUAL["color"], linewidth=1.1)
    worst = worst_result(verdict, "tension_variation")
    if worst is not None and worst.time_s is not None:
        percent, line = 100.0 * (worst.measured or 0.0), worst.job_line
        label = f"worst {percent:.3g} % off the mean" + (f" at line {line}" if line else "")
        limit = "" if worst.limit is None else f", limit {100.0 * worst.limit:g} %"
        panel.axvline(worst.time_s, label=label + limit, **LIMIT)
    panel.set_ylim(0.0, 1.15 * float(np.nanmax(highest)))
    panel.set_xlabel("time [s]")
    panel.set_ylabel("tension [N]")
    panel.set_title("Tension of the fibre at the eye")
    _legend_beside(panel)
    return figure


def criteria_figure(proof: Proof) -> Figure:
    """Draw only the bars of the criteria, for a machine whose load is unknown."""
    figure, panel = new_figure((7.2, max(2.0, _BAR_IN * len(_limited(proof)))))
    _bars(proof, panel)
    return figure


def _contour_along(proof: Proof, traces: Traces, panel: Axes) -> None:
    """Draw the contour error over time, its limit, and the worst place with its program line."""
    if traces.contour is not None:
        time_s, error_m = traces.contour
        panel.plot(time_s, error_m * 1e3, label="tool off the path", **ACTUAL)
    worst = worst_result(proof.verdict, "contour_error")
    if worst is not None and worst.time_s is not None and worst.measured is not None:
        if worst.limit is not None:
            panel.axhline(worst.limit * 1e3, label=f"limit {worst.limit * 1e3:g} mm", **LIMIT)
        note = f", {worst.note}" if worst.note else ""
        panel.plot([worst.time_s], [worst.measured * 1e3], label=_worst_label(worst, note), **WORST)
    else:
        panel.text(0.5, 0.5, "not measured", transform=panel.transAxes, ha="center")
    panel.margins(y=0.15)
    top_mm = panel.get_ylim()[1]
    panel.set_ylim(-_BELOW * top_mm, top_mm)  # an error of 0 is drawn above the frame
    panel.set_xlabel("time [s]")
    panel.set_ylabel("contour error [mm]")
    panel.set_title("Contour error along the job, at the tool (lag along the path does not count)")
    _legend_beside(panel)


def _worst_label(worst: Result, note: str) -> str:
    line = "" if worst.job_line is None else f" at line {worst.job_line}"
    scale, unit = {"m": (1e3, "mm"), "rad": (DEGREES, "deg")}.get(worst.unit, (1.0, worst.unit))
    axis = f" {worst.axis}" if worst.axis else ""
    return f"worst{axis} {abs(worst.measured or 0.0) * scale:.3f} {unit}{line}{note}"


def _legend_beside(panel: Axes) -> None:
    """Put the legend below the panel's time axis, where it covers no curve; none without curves."""
    if not panel.get_legend_handles_labels()[0]:
        return
    panel.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=4, borderaxespad=0.0)


def _limited(proof: Proof) -> list[Result]:
    """Return the results drawn as bars: results of moving axes with a limit above 0."""
    moving = of_moving_axes(proof.verdict.results)
    return [r for r in moving if r.limit and r.measured is not None]


def _bars(proof: Proof, panel: Axes) -> None:
    limited = _limited(proof)
    names = [f"{r.name} {r.axis}".strip() for r in limited]
    used_percent = [abs(r.measured or 0.0) / (r.limit or 1.0) * 100.0 for r in limited]
    colours = ["#D55E00" if r.status is Status.FAILED else "0.7" for r in limited]
    hatches = ["////" if r.status is Status.FAILED else "" for r in limited]
    shown = np.minimum(used_percent, 200.0) if used_percent else np.empty(0)
    bars = panel.barh(names, shown, color=colours, edgecolor="black", linewidth=0.6)
    for bar, hatch, percent, result in zip(bars, hatches, used_percent, limited, strict=True):
        bar.set_hatch(hatch)
        # Between samples a plan may exceed a limit that it keeps at each sample.
        shown_percent = min(percent, 100.0) if result.status is Status.PASSED else percent
        panel.text(
            max(bar.get_width() + 2, 102.0 if 88.0 < percent < 100.0 else 0.0),
            bar.get_y() + bar.get_height() / 2,
            percent_used(shown_percent / 100.0),
            va="center",
            fontsize=7,
        )
    panel.axvline(100.0, **LIMIT)
    panel.set_xlim(0, max([120.0, *(shown + 20.0)]))
    panel.invert_yaxis()
    panel.tick_params(axis="y", labelsize=7)
    panel.grid(axis="y", visible=False)
    panel.set_xlabel("share of the limit [%]; hatched: failed")
    panel.set_title("Criteria with a limit")


def binding_of(plan: Plan) -> Binding | None:
    """Return the limits that bind a plan over time; None unless it is the fastest motion."""
    motion = plan.motion
    if motion.path.timing is not Timing.FASTEST:
        return None
    options = options_from(dict(plan.options))
    return binding(
        motion.timed or motion.trajectory,
        motion.path,
        derate(with_reserve(plan.machine, options.reserve), options.limit_share),
        options.timing.contour_m,
        of_loads=motion.following is Following.LOAD,
    )


def binding_lines(found: Binding) -> list[str]:
    """Return a line with the share of the time in which each limit binds, the largest first."""
    ordered = sorted(found.binds.items(), key=lambda item: -item[1])
    share_text = ", ".join(f"{kind} {share:.0%}" for kind, share in ordered if share > 0.0)
    return [f"Binding limits:       {share_text or 'none'} (of the time)"]


def strips_figure(plan: Plan, found: Binding) -> Figure:
    """Draw the speed of the tool, and below it a strip for each kind of limit.

    The height of a strip is the used share of the limit; it is black where the limit binds.
    """
    kinds = [kind for kind in KINDS if kind in found.shares]
    figure, rows = new_figure(
        (7.2, 2.4 + _STRIP * len(kinds)),
        1 + len(kinds),
        sharex=True,
        height_ratios=[1.8 / _STRIP, *[1.0] * len(kinds)],
    )
    trajectory = plan.motion.timed or plan.motion.trajectory
    speed = np.linalg.norm(trajectory(found.time_s, 1) * plan.motion.path.radius_m, axis=1)
    rows[0].plot(found.time_s, speed * 1e3, **{**PLANNED, "linestyle": "-", "linewidth": 1.0})
    rows[0].set_ylabel("tool speed [mm/s]")
    rows[0].set_title("Speed along the path, and the limits that it uses")
    for panel, kind in zip(rows[1:], kinds, strict=True):
        # Paper can show eight hundred stretches of the ten thousand instants or more.
        time_s, _, share = envelope(found.time_s, np.minimum(found.shares[kind], 1.05))
        binding_share = np.where(share >= BINDS, share, 0.0)
        for height, color in ((share, "0.78"), (binding_share, "black")):
            panel.fill_between(time_s, height, color=color, linewidth=0.0, step="post")
        panel.axhline(1.0, **{**LIMIT, "linewidth": 0.7})
        panel.set_ylim(0.0, 1.08)
        panel.set_yticks([])
        panel.grid(visible=False)
        panel.set_ylabel(kind, rotation=0, ha="right", va="center", fontsize=8)
        binding_time_share = found.binds[kind]
        panel.text(
            1.01,
            0.5,
            f"{binding_time_share:.0%}",
            transform=panel.transAxes,
            va="center",
            fontsize=8,
        )
    rows[-1].set_xlabel("time [s]; right: share of the time in which the limit binds")
    return figure
