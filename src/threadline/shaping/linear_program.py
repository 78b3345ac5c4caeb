"""Linear programs, with failure as an error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from threadline.arrays import FloatArray
from threadline.shaping.types import ShaperError
from threadline.simplex import Bounds, solved


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
        How long the solver may take, each time that it is asked.

    Raises
    ------
    InfeasibleError
        If no x meets the constraints.
    ShaperError
        If the solver fails otherwise.
    """
    found = solved(cost, equal=equal, below=below, bounds=bounds, seconds=seconds)
    if found.status == 2:
        raise InfeasibleError(f"{what}: no command meets the constraints")
    if found.status != 0 or found.x is None or found.fun is None:
        raise ShaperError(f"{what}: the linear program failed: {found.message}")
    return Solution(
        np.asarray(found.x, dtype=np.float64),
        float(found.fun),
        np.asarray(found.eqlin.marginals, dtype=np.float64),
    )
