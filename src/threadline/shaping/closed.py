"""Zero-vibration shapers: positive ones in closed form, switched ones solved exactly."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from threadline.arrays import FloatArray
from threadline.shaping.humps import alternating
from threadline.shaping.newton import System, follow
from threadline.shaping.response import Rows, pole

Train = tuple[FloatArray, FloatArray]
"""Amplitudes and times, (n,) each; times in undamped periods."""


def _damped_period(zeta: float) -> float:
    return 1.0 / math.sqrt(1.0 - zeta**2)


def _decay(zeta: float, damped_periods: float) -> float:
    return math.exp(-2.0 * math.pi * zeta * damped_periods / math.sqrt(1.0 - zeta**2))


def binomial(order: int, zeta: float) -> Train:
    """ZV (order 0), ZVD (1), ZVDD (2): the ZV pair convolved with itself ``order`` times.

    Singer and Seering (1990). V and its first ``order`` derivatives vanish at the mode.
    """
    n = order + 2
    k = _decay(zeta, 0.5)
    weights: FloatArray = np.array([math.comb(n - 1, i) * k**i for i in range(n)], dtype=np.float64)
    return weights / float(weights.sum()), np.arange(n, dtype=np.float64) * (
        0.5 * _damped_period(zeta)
    )


def modified_zv(zeta: float) -> Train:
    """MZV: three impulses, 3/8 of a damped period apart, so that V is 0 at the mode.

    1 + sqrt(2) z + z^2 vanishes at z = exp(j 3 pi / 4), which fixes the amplitudes.
    """
    k = _decay(zeta, 0.375)
    weights: FloatArray = np.array([1.0, math.sqrt(2.0) * k, k**2], dtype=np.float64)
    return weights / float(weights.sum()), np.arange(3, dtype=np.float64) * (
        0.375 * _damped_period(zeta)
    )


def _zero_system(order: int, zeta: float, amplitudes: FloatArray) -> System:
    def evaluate(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        times = np.concatenate(([0.0], x))
        rows = Rows(amplitudes, times, pole(zeta), free_amplitudes=False, unknown_frequencies=0)
        for derivative in range(order + 1):
            rows.zero(1.0, order=derivative)
        return rows.system()

    return evaluate


# Undamped unit-magnitude trains: a sixth and a third of a period for ZV (exact); for ZVD, to
# five digits, the root that the one-hump train tends to as its tolerance goes to 0.
_UM_SEEDS = {0: (1.0 / 6.0, 1.0 / 3.0), 1: (0.08951, 0.36623, 0.64296, 0.73247)}


def switched_zero(order: int, zeta: float, amplitudes: FloatArray) -> Train:
    """ZV (order 0, 3 impulses) or ZVD (order 1, 5) with given alternating amplitudes, sum 1.

    The undamped unit-magnitude train is led to the amplitudes, then to the damping.

    Raises
    ------
    ShaperError
        If a continuation loses the solution.
    """
    unit = alternating(len(amplitudes))
    what = f"zero-vibration shaper with given amplitudes, order {order}, damping {zeta:g}"
    stages: list[tuple[Callable[[float], System], float]] = [
        (
            lambda c: _zero_system(order, 0.0, unit + c * (amplitudes - unit)),
            1.0 if bool(np.any(amplitudes != unit)) else 0.0,
        ),
        (lambda z: _zero_system(order, z, amplitudes), zeta),
    ]
    x = np.array(_UM_SEEDS[order])
    for system_at, end in stages:
        x = follow(system_at, x, start=0.0, end=end, step=0.1, what=what)
    return amplitudes, np.concatenate(([0.0], x))
