"""Figure of an on/off machine: vibration of the frame after a light barrier was interrupted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from threadline.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from threadline.search.broken_beam import BreakSweep

MICRO = 1e6


def break_figure(
    sweeps: Sequence[BreakSweep], twin: tuple[FloatArray, FloatArray] | None = None
) -> Figure:
    """Draw the vibration after a break over the instant of the break, a panel per shaper.

    Simulated points ``twin``, times in s and amplitudes in m, go into the first panel.
    """
    from matplotlib.figure import Figure

    columns = 3
    rows = -(-len(sweeps) // columns)
    figure = Figure(figsize=(7.2, 2.0 * rows))
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    worst = next(float(s.ringing_m.max()) for s in sweeps if s.name == "none") * MICRO
    for panel, sweep in zip(panels, sweeps, strict=False):
        panel.plot(sweep.times_s * 1e3, sweep.ringing_m * MICRO, color="#0072B2", linewidth=1.2)
        panel.axhline(worst, color="#D55E00", linestyle=(0, (1, 1.5)), linewidth=1.2)
        over = f", {sweep.over_level:.0%} over the level" if sweep.over_level > 1e-9 else ""
        panel.set_title(f"{sweep.name}{over}")
    if twin is not None:
        panels[0].plot(twin[0] * 1e3, twin[1] * MICRO, "o", color="black", mfc="none")
    for panel in panels[len(sweeps) :]:
        panel.set_visible(False)
    figure.supxlabel("beam broken, ms after the move began (dotted: worst unshaped)")
    figure.supylabel("frame rings then, um")
    return figure
