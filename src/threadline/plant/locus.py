"""Root locus of a loop with its exact dead time, and the gains at which poles cross the axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import ComplexArray, FloatArray
from threadline.plant.delayed import closed_poles
from threadline.plant.loop import Loop
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
        (k,) factors on the gain that the controller has.
    poles
        For each gain, the poles of magnitude up to ``within_rad_s``; with dead time there are
        infinitely many beyond.
    now
        Poles at gain 1.
    open_poles, open_zeros
        Poles at which the branches begin and zeros at which they end, those of the controller
        included.
    critical
        Gain and frequency in rad/s of every crossing of the imaginary axis, rising in gain.
    within_rad_s
        Largest magnitude of the poles.
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
        (k,) factors on the controller's gain; by default from 1/1000 to three times the first
        critical one (10 where there is none), and at least to 3.
    within_rad_s
        Largest magnitude of the poles; by default twice the larger of the plant's largest pole and
        five times the crossover.
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
