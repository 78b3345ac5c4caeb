"""The figure of the limits that bind a fastest motion over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from threadline.commands.plan import Following, Plan
from threadline.machine.vary import derate, with_reserve
from threadline.motion.path.types import Timing
from threadline.motion.timing.optimal.binding import BINDS, KINDS, Binding, binding
from threadline.proof.options import options_from
from threadline.report.style import LIMIT, PLANNED
from threadline.report.traces import envelope

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STRIP = 0.38  # height of a strip, inches


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
    said = ", ".join(f"{kind} {share:.0%}" for kind, share in ordered if share > 0.0)
    return [f"Binding limits:       {said or 'none'} (of the time)"]


def strips_figure(plan: Plan, found: Binding) -> Figure:
    """Draw the speed of the tool, and below it a strip for each kind of limit.

    The height of a strip is the used share of the limit; it is black where the limit binds.
    """
    from matplotlib.figure import Figure

    kinds = [kind for kind in KINDS if kind in found.shares]
    figure = Figure(figsize=(7.2, 2.4 + _STRIP * len(kinds)))
    rows = figure.subplots(
        1 + len(kinds), 1, sharex=True, height_ratios=[1.8 / _STRIP, *[1.0] * len(kinds)]
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
        binds = found.binds[kind]
        panel.text(1.01, 0.5, f"{binds:.0%}", transform=panel.transAxes, va="center", fontsize=8)
    rows[-1].set_xlabel("time [s]; right: share of the time in which the limit binds")
    return figure
