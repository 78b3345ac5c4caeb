"""Margins of rounding for decisions that depend on which side of a boundary an eigenvalue lies.

A simple eigenvalue is known to a small multiple of the machine's rounding times the norm of its
matrix; one of a coinciding pair is known to the square root of that rounding. The digits beyond
depend on the processor, so no decision may depend on them: an eigenvalue that is nearer to its
boundary than the margins here counts as lying on it. Norms are those of the balanced matrix, in
which states of different units have equal weight.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import matrix_balance

from threadline.arrays import ComplexArray, FloatArray

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
    """Return the eigenvalues of ``matrix`` that do not decay, those on the imaginary axis included.

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
    """Return the complex eigenvalues of ``matrix``, of each pair the one in the upper half plane.

    Rounding can give a critically damped pair a small imaginary part; up to ``DOUBLE`` times the
    norm the pair counts as real.
    """
    if not matrix.size:
        return np.empty(0, dtype=np.complex128)
    found = np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    return found[found.imag > DOUBLE * size_of(matrix)]


def off_the_circle(matrix: FloatArray) -> ComplexArray:
    """Return the eigenvalues of ``x[k+1] = matrix x[k]`` outside the unit circle, beyond rounding.

    The position under a velocity loop has the eigenvalue 1, which is no instability. An eigenvalue
    outside the circle by up to 1e-9, or by up to ``SIMPLE`` times the norm, counts as on it.
    """
    found = np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
    return found[np.abs(found) > 1.0 + max(_CIRCLE, SIMPLE * size_of(matrix))]
