"""Where rounding ends: margins for what hangs on an eigenvalue that lies on a boundary.

An eigenvalue is known to a small multiple of the machine's rounding times the norm of its matrix;
one of a pair that coincides, to the square root of that rounding. Which digits come out depends on
the processor, so that no decision may hang on them: what is nearer to its boundary than the
margins here counts as lying on it. Norms are of the balanced matrix, in which states of different
units weigh alike.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import matrix_balance

from threadline.arrays import FloatArray

ComplexArray: TypeAlias = NDArray[np.complex128]

SIMPLE = 1e-11
"""Share of the norm to which a simple eigenvalue is known: 5e4 roundings."""
DOUBLE = 1e-7
"""Share of the norm to which one of a coinciding pair is known: 7 square roots of a rounding."""

_CIRCLE = 1e-9


def size_of(matrix: FloatArray) -> float:
    """Return the 1-norm of an (n, n) matrix after balancing, in the unit of its eigenvalues."""
    if not matrix.size:
        return 0.0
    balanced = matrix_balance(matrix, permute=False)[0]
    return float(np.abs(balanced).sum(axis=0).max())


def not_decaying(matrix: FloatArray) -> ComplexArray:
    """Return the eigenvalues of ``matrix`` that do not decay: those on the axis are among them.

    Parameters
    ----------
    matrix
        (n, n) of ``x' = matrix x``, 1/s.

    Returns
    -------
    ComplexArray
        (k,) rad/s, the rightmost first: real parts above ``-SIMPLE`` times the norm.
    """
    if not matrix.size:
        return np.empty(0, dtype=np.complex128)
    found = np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    left = found[found.real > -SIMPLE * size_of(matrix)]
    return left[np.argsort(-left.real, kind="stable")]


def swinging(matrix: FloatArray) -> ComplexArray:
    """Return the eigenvalues of ``matrix`` that swing, one of each pair, imaginary part positive.

    A critically damped pair comes out of rounding with an imaginary part of either kind; up to
    ``DOUBLE`` times the norm it counts as real.
    """
    if not matrix.size:
        return np.empty(0, dtype=np.complex128)
    found = np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    return found[found.imag > DOUBLE * size_of(matrix)]


def off_the_circle(matrix: FloatArray) -> ComplexArray:
    """Return the eigenvalues of ``x[k+1] = matrix x[k]`` that grow, by more than rounding.

    Under a velocity loop nothing feeds the position back: its eigenvalue is 1, and no instability.
    Such a one counts as on the circle up to 1e-9, and up to ``SIMPLE`` times the norm.
    """
    found = np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    return found[np.abs(found) > 1.0 + max(_CIRCLE, SIMPLE * size_of(matrix))]
