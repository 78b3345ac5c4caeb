"""Trains on whole ticks whose amplitudes can be set: flow valves, and axes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.shaping.response import pole
from threadline.shaping.rounding import TickGrid, cost, seconds
from threadline.shaping.types import FlexibleMode

_ROUNDS = 40
_SILENCE_WEIGHT, _SUM_WEIGHT = 1e4, 1e7


def with_amplitudes(
    starts: Sequence[IntArray],
    gap: int,
    grid: TickGrid,
    silent: Sequence[FlexibleMode],
    tick_s: float,
    *,
    positive: bool,
) -> tuple[FloatArray, IntArray]:
    """Return amplitudes and ticks, the amplitudes solved anew.

    Parameters
    ----------
    starts
        Ticks (n,) to begin with; the best of them is followed.
    gap
        Fewest ticks between two impulses.
    silent
        Modes that the design silences: they stay silent where the impulses are enough for it.
    positive
        No amplitude may be negative.
    """

    def fit(ticks: IntArray) -> FloatArray:
        return _amplitudes(seconds(ticks, tick_s), grid, silent, positive=positive)

    def value(ticks: IntArray) -> float:
        response = fit(ticks) @ grid.impulses(ticks)
        return float(cost(grid.vibration(response, ticks[-1])))

    ticks = _descend(min(starts, key=value), gap, value)
    return fit(ticks), ticks


def _descend(ticks: IntArray, gap: int, value: Callable[[IntArray], float]) -> IntArray:
    best, least = ticks, value(ticks)
    singles = [(i,) for i in range(1, len(ticks))]
    pairs = list(itertools.pairwise(range(1, len(ticks))))
    for _ in range(_ROUNDS):
        found = None
        for moved in [*singles, *pairs]:
            for shift in itertools.product((-2, -1, 1, 2), repeat=len(moved)):
                trial = best.copy()
                trial[list(moved)] += shift
                if np.diff(trial).min() < gap:
                    continue
                tried = value(trial)
                if tried < least * (1.0 - 1e-12):
                    found, least = trial, tried
        if found is None:
            break
        best = found
    return best


def _amplitudes(
    times_s: FloatArray, grid: TickGrid, silent: Sequence[FlexibleMode], *, positive: bool
) -> FloatArray:
    """Amplitudes of sum 1 with the least sum of V squared over the bands for given times."""
    from scipy.optimize import lsq_linear

    delay = times_s - times_s[-1]
    f = np.append(grid.frequency_hz, [m.frequency_hz for m in silent])
    z = np.append(grid.damping_ratio, [m.damping_ratio for m in silent])
    rows = np.array([np.exp(pole(b) * a * delay) for a, b in zip(f, z, strict=True)])
    rows[len(grid.frequency_hz) :] *= _SILENCE_WEIGHT
    matrix = np.vstack((rows.real, rows.imag, _SUM_WEIGHT * np.ones((1, len(times_s)))))
    target = np.append(np.zeros(2 * len(rows)), _SUM_WEIGHT)
    if positive:
        found = lsq_linear(matrix, target, bounds=(0.0, np.inf), method="bvls").x
    else:
        found = np.linalg.lstsq(matrix, target, rcond=None)[0]
    solved: FloatArray = found / found.sum()
    return solved
