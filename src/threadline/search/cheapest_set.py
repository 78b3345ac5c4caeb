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
"""Of which the yield is counted: of 99 %, 1990 must be in specification."""
_STEP = 0.5
_LEAST = 1.0 / 16.0
_MOST_SHARE = 10.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheapestSet:
    """Tolerances with which the yield is what was wished for.

    Parameters
    ----------
    factors
        (n,) what is left of the tolerance of each number.
    passed, tried
        Machines in specification with them, of how many.
    reached
        Whether that is enough; else no number could be made better to some use.
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
        """What they cost: how often any tolerance is halved."""
        return round(float(-np.log2(self.factors).sum()))


def cheapest_set(
    judged: MachineYield,
    wished: float,
    seed: int,
    *,
    machines: int = MACHINES,
    done: Callable[[int], None] | None = None,
) -> CheapestSet:
    """Return the fewest halvings of tolerances that are found with which a yield is reached.

    To halve a tolerance costs the same for every number. The same machines are drawn throughout,
    each number so far from its middle as its tolerance is left. Of all numbers that one is halved
    which brings most machines into specification, again and again until the lower end of the exact
    interval reaches the wish; then each halving that is not needed any more is taken back. So no
    halving can be left out of the set; that no other set is smaller is not proven.

    Parameters
    ----------
    wished
        A share.
    done
        Told how many machines are through.
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
