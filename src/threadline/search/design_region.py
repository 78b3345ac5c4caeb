"""The region in spec around a design, in two of its parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np

from threadline.arrays import FloatArray
from threadline.search.design_evaluate import Evaluator
from threadline.search.design_space import Space

_CROSSOVERS = (0.7, 0.85, 1.0, 1.25, 1.6)
_MARGINS = (0.0, -15.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Region:
    """The least ratio of measured to limit on a grid of two parameters.

    Parameters
    ----------
    names
        Of the parameters on the abscissa and the ordinate.
    factors
        (m,) of each.
    found
        (m, m) ratio without tolerances, at the best of some settings, the other parameters those
        of the design; ordinate first.
    unchanged
        (m, m) the same with the other parameters as the machine is.
    others
        The other parameters of the design that differ from the machine's: name to factor.
    """

    names: tuple[str, str]
    factors: tuple[FloatArray, FloatArray]
    found: FloatArray
    unchanged: FloatArray
    others: dict[str, float]


def region_of(
    space: Space,
    evaluator: Evaluator,
    centre: FloatArray,
    level: int,
    usage: FloatArray,
    plotted: tuple[str, str] | None,
    report: Callable[[float], None],
) -> Region | None:
    """Return the region about ``centre``; None with fewer than two parameters, or no grid.

    Parameters
    ----------
    centre, level
        (dims,) the design, and its share of the acceleration.
    usage
        (P,) how much each parameter is changed elsewhere (along the Pareto set).
    plotted
        Two parameters; those that cost most at ``centre``, then those most used, when None.
    """
    names = plotted or _important(space, centre, usage)
    if names is None or not evaluator.effort.side:
        return None
    first, second = (space.names.index(name) for name in names)
    side = evaluator.effort.side
    lines = [
        _line(float(space.low[k]), float(space.high[k]), float(centre[k]), side)
        for k in (first, second)
    ]
    slices = {}
    for turn, base in enumerate((centre, _unchanged(space, centre))):
        slices[turn] = _slice(
            space, evaluator, base, level, (first, second), (lines[0], lines[1]),
            lambda f, t=turn: report((t + f) / 2.0),  # type: ignore[misc]
        )  # fmt: skip
        rest = np.delete(centre[: space.parameters], [first, second])
        if not rest.any():
            slices[1] = slices[0]
            break
    return Region(
        names=(names[0], names[1]),
        factors=(np.exp(lines[0]), np.exp(lines[1])),
        found=slices[0],
        unchanged=slices[1],
        others={
            name: float(np.exp(centre[k]))
            for k, name in enumerate(space.names)
            if k not in {first, second} and centre[k] != 0.0
        },
    )


def _line(low: float, high: float, centre: float, side: int) -> FloatArray:
    """Return about ``side`` values from low to high, with the centre and two between it and 0.

    What is in spec begins near the design: there the grid is finer.
    """
    near = [centre, 0.5 * centre, 1.5 * centre, 0.0]
    inside = [value for value in near if low <= value <= high]
    return np.unique(np.round([*np.linspace(low, high, side), *inside], 12))


def _important(space: Space, centre: FloatArray, usage: FloatArray) -> tuple[str, str] | None:
    free = np.flatnonzero((space.high > space.low)[: space.parameters])
    if len(free) < 2:
        return None
    cost = np.abs(centre[: space.parameters]) * space.weights
    rank = sorted(free.tolist(), key=lambda k: (-cost[k], -usage[k]))
    first, second = sorted(rank[:2])
    return space.names[first], space.names[second]


def _unchanged(space: Space, centre: FloatArray) -> FloatArray:
    base = centre.copy()
    base[: space.parameters] = 0.0
    return base


def _slice(
    space: Space,
    evaluator: Evaluator,
    base: FloatArray,
    level: int,
    pair: tuple[int, int],
    lines: tuple[FloatArray, FloatArray],
    report: Callable[[float], None],
) -> FloatArray:
    """Return (m, m) the least ratio on a grid, ordinate first."""
    across, up = np.meshgrid(*lines)
    grid = np.repeat(base[None], across.size, axis=0)
    grid[:, pair[0]], grid[:, pair[1]] = across.ravel(), up.ravel()
    tries = [grid]
    if space.designs_gains:
        tries = []
        for factor, turn in product(_CROSSOVERS, _MARGINS):
            other = grid.copy()
            other[:, -2] += np.log(factor)
            other[:, -1] += turn
            tries.append(np.clip(other, space.low, space.high))
    best = np.full(across.size, np.inf)
    for k, points in enumerate(tries):
        # Whether it is in spec as drawn: corners of tolerances would take too long.
        found = evaluator.tried(points, np.full(len(points), level), beyond=-1.0)
        best = np.minimum(best, found.nominal)
        report((k + 1) / len(tries))
    return best.reshape(across.shape)
