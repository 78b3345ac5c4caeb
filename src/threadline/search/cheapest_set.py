"""The cheapest set of tolerances that reaches a wished yield."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.machine.variants import drawn
from threadline.search.machine_yield import MachineYield, shares_of
from threadline.verdict.binomial import clopper_pearson

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
