"""A law from the B-spline of its velocity, as a linear program or a fit gives it."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.laws.forms import Pieces
from threadline.laws.law import Law, measured_law


def law_of_velocity(name: str, knots: FloatArray, coefficients: FloatArray, degree: int) -> Law:
    """Return the law whose velocity is a B-spline on [0, 1], scaled to a rise of 1.

    Parameters
    ----------
    name
        Name of the law.
    knots
        (n + degree + 1,) knots, 0 and 1 ``degree + 1`` times each.
    coefficients
        (n,) not below 0, so that the law is monotone; the first and the last are 0.
    degree
        Degree of the velocity's pieces.
    """
    from scipy.interpolate import BSpline, PPoly

    forms = []
    for x, kept in ((knots, coefficients), (1.0 - knots[::-1], coefficients[::-1])):
        rise = BSpline(x, kept, degree).antiderivative()
        pieces = PPoly.from_spline(rise.tck)
        filled = np.flatnonzero(np.diff(pieces.x) > 0.0)
        powers = pieces.c[::-1, filled].T / float(rise(1.0))
        powers[0, :2] = 0.0
        forms.append(Pieces(pieces.x[filled], powers))
    inner = np.unique(knots)[1:-1]
    middle = float(inner[int(np.argmin(np.abs(inner - 0.5)))]) if len(inner) else 0.5
    return measured_law(name, forms[0], forms[1], middle)
