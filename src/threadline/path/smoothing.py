"""How much smoothing in time the jerk limits ask for, and its share of the tolerance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from threadline.machine import Machine

STEPS_PER_WIDTH = 8  # finer steps cut a curve less
LEAST_STEP = 8  # parts of a tick
LEAST_SHARE, MOST_SHARE = 0.15, 0.5


@dataclass(frozen=True, slots=True)
class Smoothing:
    """Step of the samples, and how many are averaged."""

    step_s: float
    count: int

    @property
    def width_s(self) -> float:
        """Width of the average."""
        return self.step_s * self.count

    @property
    def variance_s2(self) -> float:
        """Variance of the weights of average and spline: a curve is cut by half of it times a."""
        return self.step_s**2 * ((self.count**2 - 1) / 12.0 + 1.0 / 3.0)

    @property
    def reach_s(self) -> float:
        """How far before and after an instant the motion counts."""
        return self.step_s * ((self.count - 1) / 2.0 + 2.0)

    @property
    def tail_s2(self) -> float:
        """Half the mean square of the time by which the weights reach beyond the average.

        Times an acceleration that sets in at the ends of the average: what that adds to a cut.
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
    """Return the part of the tolerance at the tool that smoothing in time may take.

    A corner that turns by ``t``, rounded over the length l on either side, is cut by t l / 6,
    and at the speed v by s^2 v^2 t / (2 l) more, s^2 being the variance of the smoothing. The
    acceleration limit alone would give the smoothing the share a s^2 / (2 tolerance); without it
    equal parts allow the highest speed. Taken for the axis of middling acceleration.
    """
    column = [machine.axis_names.index(axis) for axis in axes]
    at_tool = float(np.median(machine.acceleration_limit[column] * machine.radius_m[column]))
    wanted = at_tool * smoothing.variance_s2 / (2.0 * tolerance_m)
    return min(max(wanted, LEAST_SHARE), MOST_SHARE)
