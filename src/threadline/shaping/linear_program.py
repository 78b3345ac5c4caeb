"""Linear programs, with failure as an error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from threadline.arrays import FloatArray
from threadline.shaping.types import ShaperError

Bounds = tuple[float | None, float | None]


@dataclass(frozen=True, slots=True)
class Solution:
    """Minimiser, minimum and the duals of the equalities."""

    x: FloatArray
    value: float
    duals: FloatArray


class InfeasibleError(ShaperError):
    """No point meets the constraints."""


def minimise(
    cost: FloatArray,
    *,
    equal: tuple[FloatArray, ArrayLike],
    below: tuple[FloatArray, ArrayLike] | None = None,
    bounds: Bounds | Sequence[Bounds],
    what: str,
    seconds: float | None = None,
) -> Solution:
    """Minimise ``cost`` @ x under rows @ x = values and rows @ x <= values.

    Parameters
    ----------
    seconds
        How long the solver may take. A degenerate program can keep the simplex method for minutes;
        then the interior-point method gets as long.

    Raises
    ------
    InfeasibleError
        If no x meets the constraints.
    ShaperError
        If the solver fails otherwise.
    """
    from scipy.optimize import linprog

    problem: dict[str, Any] = {"A_eq": equal[0], "b_eq": equal[1], "bounds": bounds}
    if below is not None:
        problem["A_ub"], problem["b_ub"] = below
    if seconds is not None:
        problem["options"] = {"time_limit": seconds}
    solved = linprog(cost, **problem, method="highs")
    if solved.status == 1 and seconds is not None:
        solved = linprog(cost, **problem, method="highs-ipm")
    if solved.status == 2:
        raise InfeasibleError(f"{what}: no command meets the constraints")
    if solved.status != 0 or solved.x is None or solved.fun is None:
        raise ShaperError(f"{what}: the linear program failed: {solved.message}")
    return Solution(
        np.asarray(solved.x, dtype=np.float64),
        float(solved.fun),
        np.asarray(solved.eqlin.marginals, dtype=np.float64),
    )
