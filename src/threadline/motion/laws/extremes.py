"""Exact peaks of a law and of its derivatives, and a check that the law is monotone."""

from __future__ import annotations

from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.polynomial import chebyshev

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError

_DEGREE = 18
_LOOKS = 33
_MISSED = 0.02  # share of a stretch's range by which an extreme may exceed all samples
_FLAT = 1e-9
"""Share of the peak velocity; a negative velocity below it is rounding, not a reversal."""
_STEP = 1e-7
"""Share of the peak acceleration; a step below it between two stretches is rounding."""


class Rise(Protocol):
    """The members of a motion law that are needed to find its extremes."""

    @property
    def name(self) -> str:
        """Name of the law."""

    @property
    def edges(self) -> FloatArray:
        """(n,) ends of the stretches on which the law is smooth, from 0 to 1."""

    def __call__(self, t: FloatArray | float, derivative: int = 0) -> FloatArray:
        """Return the ``derivative``-th derivative at (n,) times ``t``."""


def extremes(law: Rise, derivative: int) -> tuple[float, float, float, float]:
    """Return the least value of a derivative and its time, and the largest value and its time.

    On each smooth stretch of the law the derivative is interpolated at Chebyshev points. The
    extremes are sought at the ends of the stretches and at the roots of the interpolants' slopes.
    """
    edges, fitted = _fitted(law, derivative)
    samples = chebyshev.chebval(np.linspace(-1.0, 1.0, _LOOKS), fitted)
    # Between samples the law may exceed them by a small share of the stretch's range.
    overshoot = _MISSED * np.ptp(samples, axis=1)
    peaks_of_signs = []
    for sign in (-1.0, 1.0):
        peaks = (sign * samples).max(axis=1)
        best = (-np.inf, 0.0)
        for k in np.flatnonzero(peaks + overshoot >= peaks.max()).tolist():
            candidates = _stationary(fitted[:, k])
            values = sign * chebyshev.chebval(candidates, fitted[:, k])
            top_index = int(np.argmax(values))
            middle, half_width = 0.5 * (edges[k] + edges[k + 1]), 0.5 * (edges[k + 1] - edges[k])
            best = max(
                best, (float(values[top_index]), float(middle + half_width * candidates[top_index]))
            )
        peaks_of_signs.append((sign * best[0], best[1]))
    return *peaks_of_signs[0], *peaks_of_signs[1]


def _fitted(law: Rise, derivative: int) -> tuple[FloatArray, FloatArray]:
    """Return the edges (n + 1,) and the Chebyshev coefficients (degree + 1, n) between them."""
    x = chebyshev.chebpts1(_DEGREE + 1)
    edges = law.edges
    middles, half_widths = 0.5 * (edges[1:] + edges[:-1]), 0.5 * np.diff(edges)
    values = law((middles + np.outer(x, half_widths)).ravel(), derivative).reshape(
        len(x), len(half_widths)
    )
    return edges, np.asarray(chebyshev.chebfit(x, values, _DEGREE), dtype=np.float64)


def _stationary(coefficients: FloatArray) -> FloatArray:
    """Return the ends of [-1, 1] and the roots of the slope between them."""
    # High coefficients that consist of rounding are dropped, because they would add false roots.
    noise = 1e-13 * max(float(np.abs(coefficients).max()), 1e-300)
    kept = chebyshev.chebtrim(coefficients, noise)
    if len(kept) < 3:
        return np.array([-1.0, 1.0])
    roots = chebyshev.chebroots(chebyshev.chebder(kept))
    real = roots[np.abs(roots.imag) < 1e-6].real
    return np.concatenate(([-1.0, 1.0], real[np.abs(real) < 1.0]))


def steps(law: Rise) -> bool:
    """Return whether the acceleration jumps anywhere, including the ends of the motion."""
    _, fitted = _fitted(law, 2)
    end_values = chebyshev.chebval(np.array([-1.0, 1.0]), fitted)  # (stretches, 2)
    # Outside [0, 1] the law is at rest.
    after, before = np.append(end_values[:, 0], 0.0), np.append(0.0, end_values[:, 1])
    peak = np.abs(chebyshev.chebval(np.linspace(-1.0, 1.0, _LOOKS), fitted)).max()
    return bool(np.abs(after - before).max() > _STEP * peak)


@lru_cache(maxsize=64)
def refuse_descent(law: Rise) -> None:
    """Refuse a law whose velocity is negative anywhere: it has no inverse.

    Raises
    ------
    OptionError
        If the velocity is negative; the error names the least velocity and its time.
    """
    low, at, high, _ = extremes(law, 1)
    if low < -_FLAT * high:
        raise OptionError(
            f"motion law {law.name!r} goes back: its velocity is {low:.4g} at {at:.4g} of "
            "its time, so that it has no inverse",
            remedy="Take a monotone law.",
        )
