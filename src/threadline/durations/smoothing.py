"""The smoothing in time that jerk limits need, and its share of the path's tolerance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.machine import Machine

STEPS_PER_WIDTH = 8  # samples in the width: with more of them a curve is cut less
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
        """Time before and after an instant from which the motion has weight at that instant."""
        return self.step_s * ((self.count - 1) / 2.0 + 2.0)

    @property
    def tail_s2(self) -> float:
        """Half the mean square time by which the spline's weights reach beyond the average.

        Multiplied by an acceleration that begins at an end of the average, it is the additional cut
        by that acceleration.
        """
        weights = np.convolve(np.full(self.count, 1.0 / self.count), [1 / 6, 4 / 6, 1 / 6])
        times = (np.arange(len(weights)) - (len(weights) - 1) / 2.0) * self.step_s
        beyond = np.maximum(np.abs(times) - self.width_s / 2.0, 0.0)
        return float(0.5 * (weights * beyond**2).sum())


def smoothing_for(machine: Machine, axes: tuple[str, ...]) -> Smoothing:
    """Return the narrowest smoothing that keeps every axis within its jerk limit.

    The step is a whole part or a whole multiple of the tick.
    """
    column = [machine.axis_names.index(axis) for axis in axes]
    width = float((2.0 * machine.acceleration_limit[column] / machine.jerk_limit[column]).max())
    tick = float(machine.tick_clock.period_s)
    if width == 0.0:
        return Smoothing(tick / 2.0, 1)
    wanted = width / STEPS_PER_WIDTH
    if wanted >= tick:
        step = tick * math.floor(wanted / tick * (1 + 1e-12))
    else:
        step = tick / min(math.ceil(tick / wanted * (1 - 1e-12)), LEAST_STEP)
    return Smoothing(step, max(1, math.ceil(width / step * (1 - 1e-12))))


def smoothing_share(
    smoothing: Smoothing, machine: Machine, axes: tuple[str, ...], tolerance_m: float
) -> float:
    """Return the share of the tolerance at the tool that smoothing in time may use.

    A corner that turns by t and is rounded over the length l on either side is cut by t l / 6; the
    smoothing, with variance s^2, adds s^2 v^2 t / (2 l) at the speed v. The highest speed comes of
    equal shares where nothing but the tolerance limits it. Where the acceleration limit a does, the
    smoothing needs the share a s^2 / (2 tolerance), with the median of the axes for a. The result
    is the latter, but at least 0.15 and at most 0.5.
    """
    column = [machine.axis_names.index(axis) for axis in axes]
    at_tool = float(np.median(machine.acceleration_limit[column] * machine.radius_m[column]))
    wanted = at_tool * smoothing.variance_s2 / (2.0 * tolerance_m)
    return min(max(wanted, LEAST_SHARE), MOST_SHARE)
