"""Root locus of a loop with its exact dead time, and the gains at which poles cross over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.plant.delayed import closed_poles
from threadline.plant.loop import ComplexArray, Loop
from threadline.plant.margins import loop_margins
from threadline.plant.nyquist import open_loop_poles
from threadline.plant.zeros import zeros_of

_GAINS = 160


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RootLocus:
    """Closed-loop poles over the gain of the continuous model.

    Parameters
    ----------
    gains
        (k,) factors on the controller as it is.
    poles
        For each gain its poles within ``within_rad_s``; a dead time has infinitely many.
    now
        At gain 1.
    open_poles, open_zeros
        Where the branches begin and end; the zeros include the controller's.
    critical
        Gain and frequency in rad/s of every crossing of the imaginary axis, rising in gain.
    """

    gains: FloatArray
    poles: tuple[ComplexArray, ...]
    now: ComplexArray
    open_poles: ComplexArray
    open_zeros: ComplexArray
    critical: tuple[tuple[float, float], ...]
    within_rad_s: float


def root_locus(
    loop: Loop, gains: FloatArray | None = None, within_rad_s: float | None = None
) -> RootLocus:
    """Return the root locus of an axis, the other loops of its piece closed.

    Parameters
    ----------
    gains
        (k,) factors on the controller; by default from 1/1000 to 100 and somewhat beyond the
        first critical one.
    within_rad_s
        What is of interest; by default twice the plant's largest pole or five crossovers.
    """
    margins = loop_margins(loop, "continuous")
    critical = sorted((c.gain_factor, c.omega_rad_s) for c in margins.phase_crossovers)
    if gains is None:
        highest = max(3.0 * critical[0][0] if critical else 10.0, 3.0)
        gains = np.geomspace(1e-3, highest, _GAINS)
    own = open_loop_poles(loop)
    plant_zeros = zeros_of(loop.own())
    filter_zeros = np.roots(loop.filters[loop.index].continuous_numerator)
    if within_rad_s is None:
        crossing = margins.worst_phase
        fastest = 0.0 if crossing is None else 5.0 * crossing.omega_rad_s
        within_rad_s = 2.0 * max(float(np.abs(loop.plant.poles()).max()), fastest, 1.0)
    return RootLocus(
        gains=np.asarray(gains),
        poles=tuple(closed_poles(loop, float(g), within_rad_s) for g in gains),
        now=closed_poles(loop, 1.0, within_rad_s),
        open_poles=own,
        open_zeros=np.concatenate([plant_zeros, filter_zeros]),
        critical=tuple(critical),
        within_rad_s=within_rad_s,
    )
