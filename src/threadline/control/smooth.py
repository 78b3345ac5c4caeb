"""Exact moving averages of a piecewise polynomial: motions smooth enough for an inverse.

A moving average over ``w`` makes a motion once more differentiable. The average of averages of a
piecewise polynomial is a divided difference of its repeated integral,
``y_n(t) = prod(delta_i / w_i) I^n y(t)``, so every derivative is exact and none is taken by
differences of samples. The averages are centred, so the motion is not delayed. Axes with the same
widths round a corner alike, and a straight path stays straight.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from threadline.arrays import FloatArray, Locked, read_only
from threadline.errors import OptionError

if TYPE_CHECKING:
    from scipy.interpolate import PPoly


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothMotion(Locked):
    """Moving averages of a motion, with exact derivatives.

    Parameters
    ----------
    source
        The motion before averaging, a piecewise polynomial with a piece of rest at either end.
    widths_s
        (n,) widths of the moving averages, in s.
    start_s, end_s
        The averaged motion rests before the one and after the other.
    """

    source: PPoly
    widths_s: FloatArray
    start_s: float
    end_s: float

    def __call__(self, time_s: FloatArray, order: int = 0) -> FloatArray:
        """Return the (k,) derivative of an order at (k,) times."""
        t = np.asarray(time_s, dtype=np.float64)
        n = len(self.widths_s)
        whole = (
            self.source.antiderivative(n - order)
            if order < n
            else self.source.derivative(order - n)
        )
        if order == n:
            whole = self.source
        low, high = self.source.x[0], self.source.x[-1]
        total = np.zeros_like(t)
        for signs in product((-1.0, 1.0), repeat=n):
            at = t + 0.5 * float(np.dot(signs, self.widths_s))
            # Beyond its ends the source rests; its integrals go on as it does there.
            total += np.prod(signs) * _beyond(whole, self.source, at, low, high, n - order)
        scale = float(np.prod(self.widths_s)) if n else 1.0
        return np.asarray(total / scale)


def smooth_motion(
    break_s: FloatArray, coefficients: FloatArray, widths_s: FloatArray
) -> SmoothMotion:
    """Return the moving averages of a piecewise polynomial, at rest before and after.

    Parameters
    ----------
    break_s
        (m + 1,) rising times.
    coefficients
        (degree + 1, m) of the position on each interval, highest power first, in the time since
        its beginning (scipy's ``PPoly``).
    widths_s
        (n,) widths of the moving averages, in s.

    Raises
    ------
    OptionError
        If a width is not above zero.
    """
    from scipy.interpolate import PPoly

    widths = read_only(widths_s, "widths_s", ndim=1)
    if (widths <= 0).any():
        raise OptionError(f"widths of moving averages must be above 0 s, got {widths.tolist()}")
    times = read_only(break_s, "break_s", ndim=1)
    powers = read_only(coefficients, "coefficients", ndim=2)
    source = PPoly(powers, times)
    rest = float(widths.sum()) + 1e-9
    first, last = float(source(times[0])), float(source(times[-1]))
    padded = np.zeros((len(powers), powers.shape[1] + 2))
    padded[:, 1:-1] = powers
    padded[-1, 0], padded[-1, -1] = first, last
    whole = PPoly(padded, np.concatenate([[times[0] - rest], times, [times[-1] + rest]]))
    half = 0.5 * float(widths.sum())
    return SmoothMotion(
        source=whole,
        widths_s=widths,
        start_s=float(times[0]) - half,
        end_s=float(times[-1]) + half,
    )


def _beyond(
    whole: PPoly, source: PPoly, at: FloatArray, low: float, high: float, integrals: int
) -> FloatArray:
    """Return ``whole``, an integral or derivative of ``source``, which rests beyond its ends.

    ``integrals`` is the number of integrations; below 0 it is that of derivatives.
    """
    inside = np.asarray(whole(np.clip(at, low, high)), dtype=np.float64)
    if integrals <= 0:
        if integrals < 0:
            inside = np.where((at < low) | (at > high), 0.0, inside)
        return inside
    # Taylor's series about the end: the source is constant there, its integrals are polynomials.
    for end, out in ((low, at < low), (high, at > high)):
        if not out.any():
            continue
        past = at[out] - end
        value = np.zeros_like(past)
        factor = np.ones_like(past)
        for k in range(integrals + 1):
            left = integrals - k
            level = source.antiderivative(left)(end) if left else source(end)
            value += float(level) * factor
            factor = factor * past / (k + 1)
        inside[out] = value
    return inside
