"""Routh's array: unstable roots of a polynomial, and the gains that keep a loop stable.

It applies to loops without dead time, or with Pade's approximation of it, as textbooks and the
stitcher thesis use it. ``margins`` has the exact limits of a loop with dead time.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from threadline.arrays import FloatArray

_TINY = 1e-12


def routh_array(coefficients: Sequence[float]) -> FloatArray:
    """Return the (n + 1, n // 2 + 1) Routh array of a polynomial, highest power first.

    A row of zeros is replaced by the derivative of the auxiliary polynomial of the row above. A
    zero at the head of a row is replaced by a small number with the sign of the one above it.

    Raises
    ------
    ValueError
        If the leading coefficient is zero.
    """
    a = np.asarray(coefficients, dtype=np.float64)
    if a.ndim != 1 or not len(a) or a[0] == 0:
        raise ValueError("the leading coefficient of a polynomial must not be zero")
    n = len(a) - 1
    width = n // 2 + 1
    table = np.zeros((n + 1, width))
    table[0, : len(a[0::2])] = a[0::2]
    if n:
        table[1, : len(a[1::2])] = a[1::2]
    size = np.abs(a).max()
    for row in range(1, n + 1):
        if row > 1:
            above, top = table[row - 1], table[row - 2]
            table[row, :-1] = top[1:] - top[0] * above[1:] / above[0]
        scale = _TINY * max(size if row == 1 else np.abs(table[row - 2]).max(), 1e-300)
        if np.all(np.abs(table[row]) <= scale):
            power = n - row + 1
            powers = power - 2 * np.arange(width)
            table[row] = table[row - 1] * np.maximum(powers, 0)
        elif abs(table[row, 0]) <= scale:
            table[row, 0] = np.copysign(scale, table[row - 1, 0])
    return table


def unstable_roots(coefficients: Sequence[float]) -> int:
    """Return the number of roots with positive real part: sign changes of the first column."""
    first = routh_array(coefficients)[:, 0]
    return int(np.count_nonzero(first[1:] * first[:-1] < 0))


def stable_gains(numerator: FloatArray, denominator: FloatArray) -> tuple[tuple[float, float], ...]:
    """Return the intervals of K > 0 for which ``denominator + K numerator`` is stable.

    Parameters
    ----------
    numerator, denominator
        Polynomials, highest power first.
    """
    top, bottom = np.asarray(numerator), np.asarray(denominator)
    even_top, odd_top = _on_axis(top)
    even_bottom, odd_bottom = _on_axis(bottom)
    # A root crosses the axis where bottom(jw) / top(jw) is real: w from a polynomial in w^2.
    crossing = np.polysub(np.polymul(odd_bottom, even_top), np.polymul(even_bottom, odd_top))
    squares = np.roots(np.trim_zeros(crossing, "f")) if np.any(crossing) else np.empty(0)
    limits = [0.0]
    real = [s.real for s in squares if s.real > 0 and abs(s.imag) < 1e-6 * abs(s)]
    for omega in [0.0, *np.sqrt(real)]:
        below = np.polyval(top, 1j * omega)
        if below != 0:
            gain = -(np.polyval(bottom, 1j * omega) / below).real
            if gain > 0:
                limits.append(float(gain))
    edges = [*sorted(limits), np.inf]
    found: list[tuple[float, float]] = []
    for low, high in pairwise(edges):
        if high <= low:
            continue
        if not np.isfinite(high):
            inside = 2.0 * max(low, 0.5)
        else:
            inside = float(np.sqrt(low * high)) if low > 0 else 0.5 * high
        if unstable_roots(np.polyadd(bottom, inside * top).tolist()) == 0:
            if found and found[-1][1] == low:
                found[-1] = (found[-1][0], high)
            else:
                found.append((low, high))
    return tuple(found)


def _on_axis(polynomial: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return P, Q in x = w^2 with ``polynomial(jw) = P(x) + jw Q(x)``, highest power first."""
    ascending = polynomial[::-1]
    even = ascending[0::2] * (-1.0) ** np.arange(len(ascending[0::2]))
    odd = ascending[1::2] * (-1.0) ** np.arange(len(ascending[1::2]))
    return even[::-1], odd[::-1] if len(odd) else np.zeros(1)
