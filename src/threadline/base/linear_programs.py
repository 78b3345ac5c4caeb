"""Solver for small, dense linear programs, which tries the simplex method first."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from threadline.base.arrays import FloatArray

Bounds = tuple[float | None, float | None]
Rows = tuple[FloatArray, ArrayLike]
"""A matrix of rows, and the value or bound of each row."""

QUICK: Any = {"presolve": False, "simplex_dual_edge_weight_strategy": "devex"}
"""Options of the simplex method. Presolve finds nothing to remove in a dense program and takes
longer than the solution; exact edge weights cost more time than they save."""

_OUT_OF_TIME = 1
_ANSWERED = (0, _OUT_OF_TIME, 2)  # 0: optimal, 2: infeasible


def solved(
    cost: FloatArray,
    *,
    equal: Rows | None = None,
    below: Rows | None = None,
    bounds: Bounds | Sequence[Bounds],
    seconds: float | None = None,
) -> Any:
    """Minimise ``cost`` @ x subject to rows @ x = values (equal) and rows @ x <= values (below).

    If the simplex method with the options ``QUICK`` fails, HiGHS is called with default options.

    Parameters
    ----------
    seconds
        Time limit of each attempt. A degenerate program can keep the simplex method busy for
        minutes; then the interior-point method gets the same time.

    Returns
    -------
    scipy.optimize.OptimizeResult
        Result of scipy's ``linprog``; its status is 0 for an optimum, 2 for an infeasible program.

    Examples
    --------
    >>> import numpy as np
    >>> found = solved(np.array([1.0, 2.0]), below=(-np.ones((1, 2)), [-3.0]), bounds=(0.0, None))
    >>> found.status, found.x.tolist()
    (0, [3.0, 0.0])
    """
    from scipy.optimize import linprog

    problem: dict[str, Any] = {"bounds": bounds}
    if equal is not None:
        problem["A_eq"], problem["b_eq"] = equal
    if below is not None:
        problem["A_ub"], problem["b_ub"] = below
    time_limit: Any = {} if seconds is None else {"time_limit": seconds}
    result = linprog(cost, **problem, method="highs-ds", options=QUICK | time_limit)
    if result.status not in _ANSWERED:
        result = linprog(cost, **problem, method="highs", options=time_limit)
    if result.status == _OUT_OF_TIME and seconds is not None:
        result = linprog(cost, **problem, method="highs-ipm", options=time_limit)
    return result
