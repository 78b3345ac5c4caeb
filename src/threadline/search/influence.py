"""Which numbers a result depends on: Sobol indices over the tolerances of a machine."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.machine.variants import FARTHEST, drawn
from threadline.search.machine_yield import MachineYield, shares_of
from threadline.verdict.each_run import clopper_pearson

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


MACHINES = 2000
"""Machines that are drawn to count a yield: for 99 %, 1990 of them must be in specification."""
_STEP = 0.5
_LEAST = 1.0 / 16.0
_MOST_SHARE = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheapestSet:
    """Tolerances with which the yield is what was wished for.

    Parameters
    ----------
    factors
        (n,) factor on the tolerance of each number: 1, or a power of a half.
    passed, tried
        Machines in specification with them, of how many.
    reached
        Whether the yield is reached; if not, no further halving brought it nearer.
    """

    factors: FloatArray
    passed: int
    tried: int
    reached: bool

    @property
    def interval(self) -> tuple[float, float]:
        """Between which shares the yield of all machines lies, at 95 % confidence."""
        return clopper_pearson(self.passed, self.tried)

    @property
    def halvings(self) -> int:
        """The cost: how often tolerances are halved, added up over all numbers."""
        return round(float(-np.log2(self.factors).sum()))


def cheapest_set(
    judged: MachineYield,
    wished: float,
    seed: int,
    *,
    machines: int = MACHINES,
    done: Callable[[int], None] | None = None,
) -> CheapestSet:
    """Return halved tolerances with which a yield is reached, as few halvings as are found.

    Halving a tolerance costs the same for every number. The same machines are drawn throughout, the
    deviation of each number scaled with its tolerance. The tolerance whose halving brings most
    machines into specification is halved, again and again, until the lower end of the exact
    confidence interval reaches ``wished``. Then every halving that is no longer needed is taken
    back. So no halving of the set can be left out; another, smaller set may exist.

    Parameters
    ----------
    wished
        The yield, a share in (0, 1).
    done
        Called with the number of machines that were judged.
    """
    parts = drawn(judged.plan.machine, seed, np.arange(machines))

    def tried(factors: FloatArray) -> tuple[int, float, FloatArray]:
        """Return how many pass, how much of the limits those use that do not, and all uses."""
        found = judged.judged(parts * factors, done)
        shares = np.minimum(shares_of(found)[0], _MOST_SHARE)
        return int(found.passed.sum()), -float(shares[shares > 1.0].sum()), shares

    def enough(passed: int) -> bool:
        return clopper_pearson(passed, machines)[0] >= wished

    factors = np.ones(parts.shape[1])
    passed, near, shares = tried(factors)
    free = list(range(len(factors)))
    while not enough(passed):
        steps = []
        for k in list(free):
            then = factors.copy()
            then[k] *= _STEP
            more, nearer, changed = tried(then)
            if np.array_equal(changed, shares) or then[k] <= _LEAST:
                free.remove(k)  # nothing hangs on it, or it is as good as exact
            steps.append((more, nearer, k, changed))
        best = max(steps, key=lambda step: step[:2], default=None)
        if best is None or best[:2] <= (passed, near):
            return CheapestSet(factors=factors, passed=passed, tried=machines, reached=False)
        passed, near, at, shares = best
        factors[at] *= _STEP
    for k in np.argsort(factors, kind="stable")[::-1].tolist():
        while factors[k] < 1.0:
            then = factors.copy()
            then[k] /= _STEP
            fewer = tried(then)[0]
            if not enough(fewer):
                break
            factors, passed = then, fewer
    return CheapestSet(factors=factors, passed=passed, tried=machines, reached=True)
