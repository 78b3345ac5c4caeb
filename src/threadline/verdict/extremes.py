"""Exact extremes of many polynomial pieces, of which only the promising are solved."""

from __future__ import annotations

from math import comb

import numpy as np

from threadline.arrays import FloatArray


def time_derivative(coefficients: FloatArray, duration_s: FloatArray, times: int) -> FloatArray:
    """Return the coefficients of the ``times``-th time derivative of (n, order, axes) pieces."""
    for _ in range(times):
        order = coefficients.shape[1]
        if order == 1:
            return np.zeros_like(coefficients)
        scale = np.arange(1, order) / duration_s[:, None]
        coefficients = coefficients[:, 1:] * scale[:, :, None]
    return coefficients


def upper_bounds(coefficients: FloatArray) -> FloatArray:
    """Return (n,) upper bounds of (n, order) polynomials on [0, 1].

    The largest coefficient in Bernstein's basis: the polynomial lies in their convex hull.
    """
    order = coefficients.shape[1]
    basis = np.array(
        [[comb(i, k) / comb(order - 1, k) for k in range(order)] for i in range(order)]
    )
    return np.asarray((coefficients @ basis.T).max(axis=1))


def highest(coefficients: FloatArray, above: float) -> tuple[float, int, float] | None:
    """Return the highest value of (n, order) polynomials on [0, 1], its piece and its place.

    None where no piece rises above ``above``. Pieces are solved in the order of their bounds,
    until no bound is above the highest value found.
    """
    bounds = upper_bounds(coefficients)
    best: tuple[float, int, float] | None = None
    candidates = np.flatnonzero(bounds > above)
    for piece in candidates[np.argsort(-bounds[candidates])]:
        if bounds[piece] <= above:
            break
        value, where = _highest_of(coefficients[piece])
        if value > above:
            above, best = value, (value, int(piece), where)
    return best


def _highest_of(coefficients: FloatArray) -> tuple[float, float]:
    slope = np.trim_zeros(coefficients[1:] * np.arange(1, len(coefficients)), "b")
    roots = np.polynomial.polynomial.polyroots(slope) if len(slope) > 1 else np.empty(0)
    # A double root of the slope comes out as a close pair with small imaginary parts.
    inside = roots.real[(np.abs(roots.imag) < 1e-6) & (roots.real > 0.0) & (roots.real < 1.0)]
    places = np.concatenate([[0.0, 1.0], inside])
    values = np.polynomial.polynomial.polyval(places, coefficients)
    at = int(np.argmax(values))
    return float(values[at]), float(places[at])
