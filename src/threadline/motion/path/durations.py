"""The least time of each piece of a motion, and the smoothing in time that jerk limits need.

The end velocities of such a piece are 0 to 1 times its mean velocity. The peaks of its derivatives
are convex functions of the end velocities, and so largest in one of the four extreme cases: the
k-th derivative of an axis that moves by d in a time T is at most ``peaks[k] * d / T**k``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray

if TYPE_CHECKING:
    from threadline.machine import Machine

STEPS_PER_WIDTH = 8  # samples in the width: more samples cut a curve less
LEAST_STEP = 8  # most samples in a tick
LEAST_SHARE, MOST_SHARE = 0.15, 0.5


@dataclass(frozen=True, slots=True)
class Smoothing:
    """A moving average of ``count`` samples ``step_s`` apart, joined by a cubic B-spline."""

    step_s: float
    count: int

    @property
    def width_s(self) -> float:
        """Width of the average, s."""
        return self.step_s * self.count

    @property
    def variance_s2(self) -> float:
        """Variance of the weights of average and spline together.

        Under an acceleration a the smoothing cuts a curve by a times half of this variance.
        """
        return self.step_s**2 * ((self.count**2 - 1) / 12.0 + 1.0 / 3.0)

    @property
    def reach_s(self) -> float:
        """Time before and after an instant that affects the smoothed motion at that instant."""
        return self.step_s * ((self.count - 1) / 2.0 + 2.0)

    @property
    def tail_s2(self) -> float:
        """Half the mean square time by which the spline's weights reach beyond the average.

        Multiplied by an acceleration that begins at an end of the average, it is the additional cut
        by that acceleration.
        """
        weights = np.convolve(np.full(self.count, 1.0 / self.count), [1 / 6, 4 / 6, 1 / 6])
        times = (np.arange(len(weights)) - (len(weights) - 1) / 2.0) * self.step_s
        beyond_s = np.maximum(np.abs(times) - self.width_s / 2.0, 0.0)
        return float(0.5 * (weights * beyond_s**2).sum())


def smoothing_for(machine: Machine, axes: tuple[str, ...]) -> Smoothing:
    """Return the narrowest smoothing that keeps every axis within its jerk limit.

    The step is a whole part or a whole multiple of the tick.
    """
    columns = [machine.axis_names.index(axis) for axis in axes]
    width_s = float((2.0 * machine.acceleration_limit[columns] / machine.jerk_limit[columns]).max())
    tick_s = float(machine.tick_clock.period_s)
    if width_s == 0.0:
        return Smoothing(tick_s / 2.0, 1)
    target_step_s = width_s / STEPS_PER_WIDTH
    if target_step_s >= tick_s:
        step_s = tick_s * math.floor(target_step_s / tick_s * (1 + 1e-12))
    else:
        step_s = tick_s / min(math.ceil(tick_s / target_step_s * (1 - 1e-12)), LEAST_STEP)
    return Smoothing(step_s, max(1, math.ceil(width_s / step_s * (1 - 1e-12))))


def smoothing_share(
    smoothing: Smoothing, machine: Machine, axes: tuple[str, ...], tolerance_m: float
) -> float:
    """Return the share of the tolerance at the tool that smoothing in time may use.

    A corner that turns by t and is rounded over the length l on either side is cut by t l / 6; the
    smoothing, with variance s^2, adds s^2 v^2 t / (2 l) at the speed v. If only the tolerance
    limits the speed, equal shares give the highest. If the acceleration limit a does, the smoothing
    needs the share a s^2 / (2 tolerance), with the median of the axes for a. The result is the
    latter, at least 0.15 and at most 0.5.
    """
    columns = [machine.axis_names.index(axis) for axis in axes]
    acceleration_m_s2 = float(
        np.median(machine.acceleration_limit[columns] * machine.radius_m[columns])
    )
    needed_share = acceleration_m_s2 * smoothing.variance_s2 / (2.0 * tolerance_m)
    return min(max(needed_share, LEAST_SHARE), MOST_SHARE)


CUBIC_PEAK_VELOCITY = 1.5  # Cv of the law 3u^2 - 2u^3


def chord_time_s(
    displacement: FloatArray, nominal_s: FloatArray, velocity_limit: FloatArray
) -> FloatArray:
    """Return the (n,) times of chords at their feeds, or at the velocity limits for rapid moves.

    Parameters
    ----------
    displacement
        (n, axes) m or rad.
    nominal_s
        (n,) times at the feeds; 0 for rapid moves.
    velocity_limit
        (axes,) m/s or rad/s.
    """
    rapid = ~(nominal_s > 0)
    if not rapid.any():
        return nominal_s
    time_s = nominal_s.copy()
    time_s[rapid] = (np.abs(displacement[rapid]) / velocity_limit).max(axis=1)
    return time_s


def whole_ticks_s(time_s: FloatArray, tick_s: float) -> FloatArray:
    """Return times rounded up to whole ticks, as the 1994 controller stored them.

    So no axis is faster than its feed (filament winding thesis, section 9.5).
    """
    # Rounding must not turn a whole number of ticks into one more.
    return np.asarray(np.ceil(time_s / tick_s * (1 - 1e-9)) * tick_s)


def rest_to_rest_s(chord_s: FloatArray) -> FloatArray:
    """Return the (n,) times of moves from rest to rest with the peak velocity of ``chord_s``.

    The velocity is a parabola over time, the profile with the least heat in the motor (filament
    winding thesis, sections 5 and 8.6).
    """
    return CUBIC_PEAK_VELOCITY * chord_s


def longest_demand_s(first: FloatArray, middle: FloatArray, last: FloatArray) -> float:
    """Return the time of a regular knot interval, s, that keeps every interval within its feed.

    Parameters
    ----------
    first, middle, last
        (n,) Bezier values of the time at the feed over each interval, s for a regular one.

    Notes
    -----
    The velocity in an interval is a weighted mean of three successive differences of control points
    (with even knots the weights are (1-u)^2/2, -u^2+u+1/2, u^2/2). The same mean of the times that
    these differences take at their feeds is an upper bound of the interval's time, for any kind of
    feed. The bound is exact if the three differences have one direction. Its largest value is at an
    end of the interval or where its derivative is 0.
    """
    bend = first - 2.0 * middle + last
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.where(bend < 0, np.clip((first - middle) / bend, 0.0, 1.0), 0.0)
    longest_s = 0.0
    for u_tested in (np.zeros_like(u), u, np.ones_like(u)):
        demand_s = (
            (1 - u_tested) ** 2 * first
            + 2.0 * u_tested * (1 - u_tested) * middle
            + u_tested * u_tested * last
        )
        longest_s = max(longest_s, float(demand_s.max(initial=0.0)))
    return longest_s


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
    its variance times the acceleration. The acceleration is limited so that this deviation, at the
    tool, is within the tolerance. The smoothing limits the jerk.
    """
    columns = [machine.axis_names.index(axis) for axis in axes]
    velocity, acceleration, jerk = (
        limit[columns]
        for limit in (machine.velocity_limit, machine.acceleration_limit, machine.jerk_limit)
    )
    if quintic:
        return velocity, acceleration, jerk
    smoothing_limit = 2.0 * tolerance_m / (smoothing_for(machine, axes).variance_s2 * radius_m)
    return velocity, np.minimum(acceleration, smoothing_limit)
