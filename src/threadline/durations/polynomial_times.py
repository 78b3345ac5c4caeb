"""Times of cubic and quintic polynomials that pass their points in motion.

The end velocities of such a piece are 0 to 1 times its mean velocity. The peaks of its derivatives
are convex functions of the end velocities, and so largest in one of the four extreme cases: the
k-th derivative of an axis that moves by d in a time T is at most ``peaks[k] * d / T**k``.
"""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.durations.smoothing import smoothing_for
from threadline.machine import Machine

# Largest |p'|, |p''|, |p'''| over the four pairs of end velocities 0 and 1.
CUBIC_PEAKS = (1.5, 6.0, 12.0)
QUINTIC_PEAKS = (1.875, 10.0 / 3.0**0.5, 60.0)


def polynomial_time_s(
    leg: FloatArray, nominal_s: FloatArray, limits: tuple[FloatArray, ...], *, quintic: bool
) -> FloatArray:
    """Return the (n,) shortest times that keep the bounds within the limits and the feed.

    Parameters
    ----------
    leg
        (n, axes) displacements, m or rad.
    nominal_s
        (n,) times at the feeds; 0 for rapid moves.
    limits
        (axes,) limits of velocity, acceleration and, for a quintic, jerk.
    quintic
        Whether the pieces have continuous acceleration.
    """
    peaks = QUINTIC_PEAKS if quintic else CUBIC_PEAKS
    time_s = peaks[0] * nominal_s
    for order, (limit, peak) in enumerate(zip(limits, peaks, strict=False), start=1):
        needed = (peak * np.abs(leg) / limit).max(axis=1) ** (1.0 / order)
        time_s = np.maximum(time_s, needed)
    return np.asarray(time_s)


def polynomial_limits(
    machine: Machine,
    axes: tuple[str, ...],
    radius_m: FloatArray,
    tolerance_m: float,
    *,
    quintic: bool,
) -> tuple[FloatArray, ...]:
    """Return the (axes,) limits of velocity, acceleration and, for a quintic, jerk for the pieces.

    The acceleration of a cubic jumps at the points. There the smoothing in time misses them by half
    its variance times the acceleration, which is therefore limited so that the miss, at the tool,
    is within the tolerance. Its jerk is limited by that smoothing.
    """
    column = [machine.axis_names.index(axis) for axis in axes]
    velocity, acceleration, jerk = (
        limit[column]
        for limit in (machine.velocity_limit, machine.acceleration_limit, machine.jerk_limit)
    )
    if quintic:
        return velocity, acceleration, jerk
    room = 2.0 * tolerance_m / (smoothing_for(machine, axes).variance_s2 * radius_m)
    return velocity, np.minimum(acceleration, room)
