"""Zeros of a plant from one input to one output, and its relative degree."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import ComplexArray, FloatArray
from threadline.errors import MachineError
from threadline.plant.linear import StateSpace

_ZERO = 1e-11


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Chain:
    """The integrations between an input u and an output y: ``y^(degree) = rows[-1] . x + gain u``.

    Parameters
    ----------
    degree
        Relative degree: the order of the lowest derivative of y that u enters.
    rows
        (degree + 1, n): row k is ``C A^k``, which gives the k-th derivative of y without u.
    gain
        ``C A^(degree - 1) B``.
    """

    degree: int
    rows: FloatArray
    gain: float


def chain_of(plant: StateSpace) -> Chain:
    """Return the chain of a plant with one input and one output.

    Raises
    ------
    MachineError
        If the input never reaches the output.
    """
    A, b, row = plant.A, plant.B[:, 0], plant.C[0]
    rows = [row]
    size = np.abs(row)
    for degree in range(1, len(A) + 1):
        through = float(row @ b)
        if abs(through) > _ZERO * float(size @ np.abs(b)):
            rows.append(row @ A)
            return Chain(degree=degree, rows=np.array(rows), gain=through)
        row, size = row @ A, size @ np.abs(A)
        rows.append(row)
    raise MachineError(f"{plant.inputs[0]} does not move {plant.outputs[0]}")


def zeros_of(plant: StateSpace) -> ComplexArray:
    """Return the zeros of a plant with one input and one output, in rad/s.

    The input that holds the output constant makes the states move by the matrix
    ``A - B C A^r / (C A^(r-1) B)``. Its eigenvalues are the zeros of the plant, and r times 0.
    """
    chain = chain_of(plant)
    inner = plant.A - np.outer(plant.B[:, 0], chain.rows[chain.degree]) / chain.gain
    # On the null space of the chain the matrix has the zeros alone: rounding would smear an r-fold
    # eigenvalue 0.
    scaled = chain.rows[: chain.degree]
    scaled = scaled / np.linalg.norm(scaled, axis=1)[:, None]
    units = np.maximum(np.abs(scaled).max(axis=0), _ZERO)
    _, values, vectors = np.linalg.svd(scaled / units)
    basis = vectors[len(values) :].T / units[:, None]
    if not basis.shape[1]:
        return np.empty(0, dtype=np.complex128)
    left = np.linalg.pinv(basis)
    return np.asarray(np.linalg.eigvals(left @ inner @ basis), dtype=np.complex128)
