"""Which numbers a result depends on: Sobol indices over the tolerances of a machine."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

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
    from scipy.stats import DegenerateDataWarning, bootstrap, sobol_indices, truncnorm, uniform

    cut = truncnorm(-FARTHEST, FARTHEST, scale=1.0 / _PER_PART)
    alike = uniform(-1.0, 2.0)
    dists: list[Any] = [cut if one else alike for one in normal]
    random = np.random.default_rng(seed)
    values: list[FloatArray] = []

    def shares(f_A: FloatArray, f_B: FloatArray, f_AB: FloatArray) -> FloatArray:
        if not values:
            values.extend((f_A.copy(), f_B.copy(), f_AB.copy()))
        return _shares(f_A, f_B, f_AB)

    sobol_indices(
        func=lambda x: result(np.ascontiguousarray(x.T))[None],
        n=samples,
        dists=dists,
        rng=random,
        method=cast(Any, shares),
    )
    with warnings.catch_warnings(), np.errstate(divide="ignore", invalid="ignore"):
        # A number that does nothing has the same share in every sample, and no spread.
        warnings.simplefilter("ignore", DegenerateDataWarning)
        found = np.nan_to_num(_shares(*values)[:, 0], nan=0.0, posinf=0.0, neginf=0.0)
        # That of scipy's own result takes no generator: its ends differ from call to call.
        spread = bootstrap(
            [np.arange(samples)],
            lambda of: _shares(*(value[..., of] for value in values))[:, 0],
            n_resamples=_RESAMPLES,
            method="BCa",
            rng=random,
        ).confidence_interval
    ends = np.stack([spread.low, spread.high], axis=1)
    ends = np.where(np.isnan(ends), found[:, None], ends)
    return Influence(first=found[0], total=found[1], first_interval=ends[0], total_interval=ends[1])


def _shares(a: FloatArray, b: FloatArray, exchanged: FloatArray) -> FloatArray:
    """Return (2, s, n) first-order and total indices of s results.

    Of values at (s, k) samples A and B, less their mean, and at (n, s, k) samples A with one of n
    numbers from B: lines (b) and (f) of table 2 in Saltelli and others, "Variance based sensitivity
    analysis of model output", Computer Physics Communications 181, 2010, 259-270.
    """
    variance = np.var([a, b], axis=(0, -1))
    first = np.mean(b * (exchanged - a), axis=-1) / variance
    total = 0.5 * np.mean((a - exchanged) ** 2, axis=-1) / variance
    return np.stack([first.T, total.T])
