"""The exponential of many generators over a step that is short for all of them, by its series."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from threadline.arrays import FloatArray

_TERMS, _ROUNDING = 24, 1e-17
_FAR = 1e3  # a series of so few terms has no chance to converge beyond


def exponential_of_short_step(turned: FloatArray) -> FloatArray:
    """Return the exponential of (V, K, n, n) generators by their series.

    In the shortest part of a step even the stiffest beam turns by a thousandth of a radian, so that
    a few terms are enough, much faster than a general exponential. Where the series has not
    converged after ``_TERMS`` terms a mode is fast against the step, and the general one is used.
    Where a generator is beyond ``_FAR`` its powers could overflow, and that one is used at once.
    """
    if float(np.abs(turned).max()) > _FAR:
        return np.asarray(expm(turned))
    total = np.broadcast_to(np.eye(turned.shape[-1]), turned.shape).copy()
    term = total
    for order in range(1, _TERMS):
        term = term @ turned / order
        total = total + term
        if (np.abs(term) <= _ROUNDING * np.abs(total)).all():
            return total
    whole: FloatArray = expm(turned)
    return whole
