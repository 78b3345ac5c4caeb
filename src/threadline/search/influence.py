"""Which numbers a result depends on: Sobol indices over the tolerances of a machine."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import DegenerateDataWarning, sobol_indices, truncnorm, uniform

from threadline.arrays import FloatArray
from threadline.machine.variants import FARTHEST

_PER_PART = 2.0  # standard deviations in a tolerance
_RESAMPLES = 200


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Influence:
    """Shares of the variance of a result; n numbers.

    Parameters
    ----------
    first, total
        (n,) first-order index of each number, and its total index with all interactions.
    first_interval, total_interval
        (2, n) ends of their 95 % confidence intervals, by bootstrap. Of a number without influence
        both ends are the index itself.
    """

    first: FloatArray
    total: FloatArray
    first_interval: FloatArray
    total_interval: FloatArray


def judgements(numbers: int, samples: int) -> int:
    """Return for how many machines ``influence`` asks."""
    return (numbers + 2) * samples


def influence(
    result: Callable[[FloatArray], FloatArray], normal: list[bool], samples: int, seed: int
) -> Influence:
    """Return the Sobol indices of a result, Saltelli's way (``scipy.stats.sobol_indices``).

    Parameters
    ----------
    result
        (k, n) parts of the tolerances to (k,) values.
    normal
        (n,) whether a number is distributed normally, cut off at 3 standard deviations; else
        uniformly over its tolerance.
    samples
        A power of 2; ``judgements`` tells how many results are asked for.
    """
    cut = truncnorm(-FARTHEST, FARTHEST, scale=1.0 / _PER_PART)
    alike = uniform(-1.0, 2.0)
    dists: list[Any] = [cut if one else alike for one in normal]
    found = sobol_indices(
        func=lambda x: result(np.ascontiguousarray(x.T))[None],
        n=samples,
        dists=dists,
        rng=np.random.default_rng(seed),
    )
    with warnings.catch_warnings(), np.errstate(invalid="ignore"):
        # A number that does nothing has the same share in every sample, and no spread.
        warnings.simplefilter("ignore", DegenerateDataWarning)
        spread = found.bootstrap(n_resamples=_RESAMPLES)
    first, total = np.atleast_2d(found.first_order)[0], np.atleast_2d(found.total_order)[0]
    return Influence(
        first=first,
        total=total,
        first_interval=_interval(spread.first_order, first),
        total_interval=_interval(spread.total_order, total),
    )


def _interval(spread: Any, share: FloatArray) -> FloatArray:
    ends = spread.confidence_interval
    found = np.stack([np.atleast_2d(ends.low)[0], np.atleast_2d(ends.high)[0]])
    return np.where(np.isnan(found), share, found)
