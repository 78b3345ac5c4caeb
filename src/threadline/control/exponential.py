"""Exact steps of linear states under a force that is known at some instants of each step.

The solution of ``x' = Q x + f(t)`` after a step T is
``x(T) = e^(QT) x(0) + int e^(Q(T-s)) f(s) ds``. The force is replaced by the polynomial through its
known values, and the integral of that is exact, by the phi functions of Q T (Hochbruck and
Ostermann, Exponential integrators, Acta Numerica 2010). Quadrature of the whole integrand would be
far off wherever ``|Q| T`` is not small, as for the zero k/c of a damped belt.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from threadline.arrays import FloatArray


def decay_and_moments(Q: FloatArray, step_s: float, count: int) -> tuple[FloatArray, FloatArray]:
    """Return ``e^(Q T)`` and ``T int_0^1 e^(Q T (1-z)) z^k dz`` for k from 0 to ``count`` - 1.

    Parameters
    ----------
    Q
        (n, n) matrix of the states, in 1/s.
    step_s
        Length T of the step, in s.
    count
        Number of powers z^k: one more than the degree of the force's polynomial.

    Returns
    -------
    The (n, n) decay, and the (count, n, n) moments in s.
    """
    n = len(Q)
    whole = np.zeros((n * (count + 1), n * (count + 1)))
    whole[:n, :n] = Q * step_s
    for k in range(count):
        whole[n * k : n * (k + 1), n * (k + 1) : n * (k + 2)] = np.eye(n)
    row = expm(whole)[:n]
    factorials = np.cumprod([1.0, *range(1, count)])
    moments = [step_s * factorials[k] * row[:, n * (k + 1) : n * (k + 2)] for k in range(count)]
    return row[:, :n], np.stack(moments)
