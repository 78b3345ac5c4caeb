"""The limits on one element as rows that are linear in y = u'^2.

On an element y is a quadratic with Bernstein coefficients y0, y1, y2. The acceleration of an axis,
``q_uu y + q_u y' / 2``, is a polynomial whose Bernstein coefficients are linear in them, and so is
``l = q_uuu y + 3/2 q_uu y' + q_u y'' / 2``; the jerk is ``sqrt(y) l``. Bernstein coefficients bound
a polynomial everywhere on the element: no sampling enters these bounds.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np
from numba import njit

ORDER = 6  # coefficients of a piece
WEIGHTS = np.array(
    [
        [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0],
        [1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [1 / 6, 2 / 3, 1 / 6], [0.0, 0.5, 0.5], [0.0, 0.0, 1.0],
    ]
)  # fmt: skip
"""Bernstein coefficients of a quadratic from those of degree 2: of degree 2, then of degree 4."""
BASE = np.array([[1.0, -2.0, 1.0], [0.0, 2.0, -2.0], [0.0, 0.0, 1.0]])
"""The Bernstein polynomials of degree 2 in powers of u."""


@njit(cache=True)
def _bernstein(power, degree, out):
    """Write the Bernstein coefficients of a polynomial in powers into ``out[: degree + 1]``."""
    for i in range(degree + 1):
        total = 0.0
        ratio = 1.0  # binomial(i, k) / binomial(degree, k)
        for k in range(i + 1):
            total += ratio * power[k]
            ratio *= (i - k) / (degree - k) if degree > k else 0.0
        out[i] = total


@njit(cache=True)
def _degree(c, j):
    for k in range(ORDER - 1, 0, -1):
        if c[k, j] != 0.0:
            return k
    return 0


@njit(cache=True)
def _fastest(c, j, degree):
    """Return a bound of |q_u| of one axis."""
    slope, one = np.zeros(ORDER), np.zeros(ORDER)
    for k in range(degree):
        slope[k] = (k + 1) * c[k + 1, j]
    _bernstein(slope, degree - 1, one)
    return np.abs(one).max()


@njit(cache=True)
def _acceleration_rows(c, j, degree, limit, out):
    """Write the rows of one curved axis; return how many: its degree and one more, made odd."""
    odd = 3 if degree <= 3 else 5
    power, one = np.zeros(ORDER + 2), np.zeros(ORDER + 2)
    for m in range(3):
        power[:] = 0.0
        for k in range(1, degree + 1):
            first = k * c[k, j]
            second = k * (k - 1) * c[k, j]
            for s in range(3):
                if k >= 2:
                    power[k - 2 + s] += second * BASE[m, s]
                if s >= 1:
                    power[k - 1 + s - 1] += 0.5 * first * s * BASE[m, s]
        _bernstein(power, odd, one)
        for i in range(odd + 1):
            out[i, m] = one[i] / limit
    return odd + 1


@njit(cache=True)
def _jerk_rows(c, j, degree, limit, out, points):
    """Write the rows of one curved axis and the weights that they stand against."""
    even = 2 if degree <= 3 else 4
    power, one = np.zeros(ORDER + 2), np.zeros(ORDER + 2)
    for m in range(3):
        power[:] = 0.0
        for k in range(1, degree + 1):
            first = k * c[k, j]
            second = k * (k - 1) * c[k, j]
            third = k * (k - 1) * (k - 2) * c[k, j]
            for s in range(3):
                if k >= 3:
                    power[k - 3 + s] += third * BASE[m, s]
                if k >= 2 and s >= 1:
                    power[k - 2 + s - 1] += 1.5 * second * s * BASE[m, s]
                if s == 2:
                    power[k - 1] += first * BASE[m, s]
        _bernstein(power, even, one)
        for i in range(even + 1):
            out[i, m] = one[i] / limit
    for i in range(even + 1):
        points[i] = i if even == 2 else 3 + i
    return even + 1


@njit(cache=True)
def rows_of(c, limit_v, limit_a, limit_j, acc, jerk, points):
    """Write the rows of one element; return their numbers and the largest y.

    ``acc[i] . y`` and ``jerk[i] . y`` are shares of the limits; ``points[i]`` names the row of
    ``WEIGHTS`` that gives the Bernstein coefficient of y that stands against row i of the jerk.
    """
    top = np.inf
    n_acc, n_jerk = 0, 0
    line_a, line_j = 0.0, 0.0  # of straight axes, which all share one shape
    for j in range(c.shape[1]):
        degree = _degree(c, j)
        if degree == 0:
            continue
        top = min(top, (limit_v[j] / _fastest(c, j, degree)) ** 2)
        if degree == 1:
            line_a = max(line_a, abs(c[1, j]) / limit_a[j])
            line_j = max(line_j, abs(c[1, j]) / limit_j[j])
            continue
        n_acc += _acceleration_rows(c, j, degree, limit_a[j], acc[n_acc:])
        if limit_j[j] < np.inf:
            n_jerk += _jerk_rows(c, j, degree, limit_j[j], jerk[n_jerk:], points[n_jerk:])
    if line_a > 0.0:
        acc[n_acc, 0], acc[n_acc, 1], acc[n_acc, 2] = -line_a, line_a, 0.0
        acc[n_acc + 1, 0], acc[n_acc + 1, 1], acc[n_acc + 1, 2] = 0.0, -line_a, line_a
        n_acc += 2
    if line_j > 0.0:
        for i in range(3):
            jerk[n_jerk, 0], jerk[n_jerk, 1], jerk[n_jerk, 2] = line_j, -2.0 * line_j, line_j
            points[n_jerk] = i
            n_jerk += 1
    return n_acc, n_jerk, top


@njit(cache=True)
def assemble(c, limit_v, limit_a, limit_j, cap):
    """Return the rows of all elements, their numbers, and the largest y of each."""
    n, axes = len(c), c.shape[2]
    most = ORDER * axes + 2
    acc = np.zeros((n, most, 3))
    jerk = np.zeros((n, most + 1, 3))
    points = np.zeros((n, most + 1), dtype=np.int64)
    count = np.zeros((n, 2), dtype=np.int64)
    top = np.empty(n)
    for i in range(n):
        a, b, highest = rows_of(c[i], limit_v, limit_a, limit_j, acc[i], jerk[i], points[i])
        count[i, 0], count[i, 1] = a, b
        top[i] = min(highest, cap[i])
    return acc, jerk, points, count, top
