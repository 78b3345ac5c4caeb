"""The influence of a machine's numbers on a result: Sobol indices over its tolerances."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.workers import Done
from threadline.machine.variants import FARTHEST, drawn
from threadline.proof.worst_machine import shares_of
from threadline.search.machine_yield import MachineYield
from threadline.verdict.each_run import clopper_pearson

_PER_PART = 2.0  # number of standard deviations in one tolerance
_RESAMPLES = 200


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Influence:
    """Shares of the variance of a result; n numbers.

    Parameters
    ----------
    first, total
        (n,) first-order index of each number, and total index with all interactions.
    first_interval, total_interval
        (2, n) ends of their 95 % confidence intervals, by bootstrap. For a number without influence
        both ends are the index itself.
    """

    first: FloatArray
    total: FloatArray
    first_interval: FloatArray
    total_interval: FloatArray


def judgements(numbers: int, samples: int) -> int:
    """Return the number of machines that ``influence`` judges."""
    return (numbers + 2) * samples


def influence(
    result: Callable[[FloatArray], FloatArray], normal: list[bool], samples: int, seed: int
) -> Influence:
    """Return the Sobol indices of a result by Saltelli's method (``scipy.stats.sobol_indices``).

    Parameters
    ----------
    result
        Takes (k, n) parts of the tolerances; returns (k,) values.
    normal
        (n,) whether a number is distributed normally, cut off at 3 standard deviations; otherwise
        it is distributed uniformly over its tolerance.
    samples
        A power of 2; ``judgements`` returns the number of results that it needs.
    """
    from scipy.stats import DegenerateDataWarning, bootstrap, sobol_indices, truncnorm, uniform

    truncated = truncnorm(-FARTHEST, FARTHEST, scale=1.0 / _PER_PART)
    uniform_law = uniform(-1.0, 2.0)
    distributions: list[Any] = [truncated if one else uniform_law for one in normal]
    random = np.random.default_rng(seed)
    values: list[FloatArray] = []

    def shares(f_A: FloatArray, f_B: FloatArray, f_AB: FloatArray) -> FloatArray:
        if not values:
            values.extend((f_A.copy(), f_B.copy(), f_AB.copy()))
        return _shares(f_A, f_B, f_AB)

    sobol_indices(
        func=lambda x: result(np.ascontiguousarray(x.T))[None],
        n=samples,
        dists=distributions,
        rng=random,
        method=cast(Any, shares),
    )
    with warnings.catch_warnings(), np.errstate(divide="ignore", invalid="ignore"):
        # A number without influence has the same index in every sample, so its interval has no
        # width.
        warnings.simplefilter("ignore", DegenerateDataWarning)
        indices = np.nan_to_num(_shares(*values)[:, 0], nan=0.0, posinf=0.0, neginf=0.0)
        # The bootstrap of scipy's result takes no generator: its ends differ between calls.
        interval = bootstrap(
            [np.arange(samples)],
            lambda of: _shares(*(value[..., of] for value in values))[:, 0],
            n_resamples=_RESAMPLES,
            method="BCa",
            rng=random,
        ).confidence_interval
    interval_ends = np.stack([interval.low, interval.high], axis=1)
    interval_ends = np.where(np.isnan(interval_ends), indices[:, None], interval_ends)
    return Influence(
        first=indices[0],
        total=indices[1],
        first_interval=interval_ends[0],
        total_interval=interval_ends[1],
    )


def _shares(a: FloatArray, b: FloatArray, exchanged: FloatArray) -> FloatArray:
    """Return (2, s, n) first-order and total indices of s results.

    The arguments are values, less their mean: at (s, k) samples A and B, and at (n, s, k) samples A
    with one of n numbers from B. Lines (b) and (f) of table 2 in Saltelli and others, "Variance
    based sensitivity analysis of model output", Computer Physics Communications 181, 2010, 259-270.
    """
    variance = np.var([a, b], axis=(0, -1))
    first = np.mean(b * (exchanged - a), axis=-1) / variance
    total = 0.5 * np.mean((a - exchanged) ** 2, axis=-1) / variance
    return np.stack([first.T, total.T])


MACHINES = 2000
"""Number of machines drawn for a yield; a yield of 99 % needs 1990 of them in specification."""
_STEP = 0.5
_LEAST = 1.0 / 16.0
_MOST_SHARE = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheapestSet:
    """Tolerances that reach a wanted yield.

    Parameters
    ----------
    factors
        (n,) factor on the tolerance of each number: 1, or a power of a half.
    passed, tried
        Number of machines in specification with these tolerances, and number of drawn machines.
    reached
        Whether the yield is reached; if not, no further halving improved it.
    """

    factors: FloatArray
    passed: int
    tried: int
    reached: bool

    @property
    def interval(self) -> tuple[float, float]:
        """Confidence interval (95 %) of the yield of all machines."""
        return clopper_pearson(self.passed, self.tried)

    @property
    def halvings(self) -> int:
        """Cost: the number of halvings, summed over all tolerances."""
        return round(float(-np.log2(self.factors).sum()))


def cheapest_set(
    judged: MachineYield,
    wanted_yield: float,
    seed: int,
    *,
    machines: int = MACHINES,
    done: Done | None = None,
) -> CheapestSet:
    """Return halved tolerances that reach a yield, with few halvings.

    Halving a tolerance costs the same for every number. The same machines are drawn throughout, and
    the deviation of each number is scaled with its tolerance. The search repeatedly halves the
    tolerance whose halving brings most machines into specification, until the lower end of the
    exact confidence interval reaches ``wanted_yield``. Then it takes back every halving that is no
    longer needed. So no halving of the set can be left out; another, smaller set may exist.

    Parameters
    ----------
    wanted_yield
        The yield, a share in (0, 1).
    done
        Called with the number of judged machines.
    """
    parts = drawn(judged.plan.machine, seed, np.arange(machines))

    def tried(factors: FloatArray) -> tuple[int, float, FloatArray]:
        """Return the number that pass, minus the sum of the shares above 1, and all used shares."""
        results = judged.judged(parts * factors, done)
        shares = np.minimum(shares_of(results)[0], _MOST_SHARE)
        return int(results.passed.sum()), -float(shares[shares > 1.0].sum()), shares

    def enough(passed: int) -> bool:
        return clopper_pearson(passed, machines)[0] >= wanted_yield

    factors = np.ones(parts.shape[1])
    passed, best_negative_excess, shares = tried(factors)
    candidates_left = list(range(len(factors)))
    while not enough(passed):
        steps = []
        for k in list(candidates_left):
            candidate_factors = factors.copy()
            candidate_factors[k] *= _STEP
            passed_count, negative_excess, candidate_shares = tried(candidate_factors)
            if np.array_equal(candidate_shares, shares) or candidate_factors[k] <= _LEAST:
                candidates_left.remove(
                    k
                )  # the number has no influence, or its tolerance is almost 0
            steps.append((passed_count, negative_excess, k, candidate_shares))
        best = max(steps, key=lambda step: step[:2], default=None)
        if best is None or best[:2] <= (passed, best_negative_excess):
            return CheapestSet(factors=factors, passed=passed, tried=machines, reached=False)
        passed, best_negative_excess, halved_index, shares = best
        factors[halved_index] *= _STEP
    for k in np.argsort(factors, kind="stable")[::-1].tolist():
        while factors[k] < 1.0:
            candidate_factors = factors.copy()
            candidate_factors[k] /= _STEP
            passed_count_wider = tried(candidate_factors)[0]
            if not enough(passed_count_wider):
                break
            factors, passed = candidate_factors, passed_count_wider
    return CheapestSet(factors=factors, passed=passed, tried=machines, reached=True)
