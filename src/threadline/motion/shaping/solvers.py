"""Newton's method for systems of equations, continuation, and linear programs that raise errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from threadline.base.arrays import FloatArray
from threadline.base.linear_programs import Bounds, solved
from threadline.motion.shaping.types import ShaperError

System: TypeAlias = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
"""Function of (n,) unknowns that returns (m,) residuals and the (m, n) Jacobian."""

RESIDUAL = 1e-11
"""Largest residual of a solved system, a tenth of the 1e-10 that designs promise."""


def newton(system: System, seed: FloatArray, what: str, *, iterations: int = 30) -> FloatArray:
    """Solve ``system`` from ``seed`` by Newton's method, with least-squares steps if not square.

    Parameters
    ----------
    system
        Function that returns residuals and Jacobian.
    seed
        Shape ``(n,)``.
    what
        Subject of the error.

    Raises
    ------
    ShaperError
        If the residual does not fall below 1e-11.
    """
    x = np.array(seed, dtype=np.float64)
    worst = np.inf
    for _ in range(iterations):
        try:
            # A diverging step may overflow; this is a failure to converge, and needs no warning.
            with np.errstate(over="ignore", invalid="ignore"):
                residual, jacobian = system(x)
        except OverflowError:
            break
        if not (np.isfinite(residual).all() and np.isfinite(jacobian).all()):
            break
        previous, worst = worst, float(np.abs(residual).max())
        # One more step after convergence costs little, and reduces the error to rounding.
        if worst < RESIDUAL and previous < 1e-6:
            return x
        # In a symmetric train with more constraints than unknowns, some constraints are dependent.
        # In a system that is not square, their directions are ignored.
        cutoff = 1e-14 if jacobian.shape[0] == jacobian.shape[1] else 1e-8
        x = x - np.linalg.lstsq(jacobian, residual, rcond=cutoff)[0]
    raise ShaperError(
        f"{what}: not found, the design did not converge (worst residual {worst:.1e}, wanted "
        f"{RESIDUAL:.0e})",
        remedy="Change the tolerance, the damping or the kind of shaper.",
    )


def follow(
    system_at: Callable[[float], System],
    seed: FloatArray,
    *,
    start: float,
    end: float,
    step: float,
    what: str,
) -> FloatArray:
    """Return the solution at ``end``, by continuation of a parameter from ``start``.

    Parameters
    ----------
    system_at
        Function of the parameter that returns the system.
    seed
        Approximate solution at ``start``.
    step
        Largest step of the parameter; it is halved if Newton's method fails.

    Raises
    ------
    ShaperError
        If the solution is lost even with 2**-12 of the step.
    """
    x = newton(system_at(start), seed, what)
    parameter, tangent = start, np.zeros_like(x)
    signed_step = float(np.copysign(step, end - start))
    least_step = step * 2.0**-12
    while parameter != end:
        signed_step = end - parameter if abs(end - parameter) <= abs(signed_step) else signed_step
        try:
            next_x = newton(
                system_at(parameter + signed_step), x + tangent * signed_step, what, iterations=12
            )
            # A large jump means that Newton's method found another branch.
            if np.abs(next_x - x - tangent * signed_step).max() > 0.1:
                raise ShaperError(f"{what}: the followed solution was lost")
        except ShaperError:
            signed_step *= 0.5
            if abs(signed_step) < least_step:
                raise
            continue
        parameter, tangent, x = parameter + signed_step, (next_x - x) / signed_step, next_x
        signed_step *= 1.5
        signed_step = float(np.copysign(min(abs(signed_step), step), end - start))
        if abs(end - parameter) < 1e-15 * max(1.0, abs(end)):
            break
    return x


@dataclass(frozen=True, slots=True)
class Solution:
    """Solution of a linear program: minimiser, minimum, and dual values of the equalities."""

    x: FloatArray
    value: float
    duals: FloatArray


class InfeasibleError(ShaperError):
    """No point on a grid meets the constraints of a linear program; between grid points one may."""


def minimise(
    cost: FloatArray,
    *,
    equal: tuple[FloatArray, ArrayLike],
    below: tuple[FloatArray, ArrayLike] | None = None,
    bounds: Bounds | Sequence[Bounds],
    what: str,
    seconds: float | None = None,
) -> Solution:
    """Minimise ``cost`` @ x with rows @ x = values (``equal``) and rows @ x <= values (``below``).

    Parameters
    ----------
    seconds
        Time limit of each call of the solver, s.

    Raises
    ------
    InfeasibleError
        If no x meets the constraints.
    ShaperError
        If the solver fails otherwise.
    """
    result = solved(cost, equal=equal, below=below, bounds=bounds, seconds=seconds)
    if result.status == 2:
        raise InfeasibleError(f"{what}: not found, no x on its grid meets the constraints")
    if result.status != 0 or result.x is None or result.fun is None:
        raise ShaperError(f"{what}: the linear program failed: {result.message}")
    return Solution(
        np.asarray(result.x, dtype=np.float64),
        float(result.fun),
        np.asarray(result.eqlin.marginals, dtype=np.float64),
    )
