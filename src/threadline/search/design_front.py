"""The front of cost against yield: the cost of more machines in specification in a redesign."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import PlanError
from threadline.machine import Machine
from threadline.machine.numbers import number_at, with_numbers
from threadline.proof.kinds import kind_of
from threadline.proof.pipeline import plan_job
from threadline.search.design_evaluate import Evaluator
from threadline.search.design_space import Space
from threadline.search.machine_yield import MachineYield
from threadline.verdict import Spec
from threadline.verdict.each_run import clopper_pearson

MOST_TRIED = 12
"""Largest number of candidates whose yield is drawn."""
SEED = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class CandidateYield:
    """Machines drawn within the tolerances of a candidate's own numbers.

    Parameters
    ----------
    cost
        Weighted sum of |ln factor|.
    factors
        Factor of each parameter, by name.
    passed, machines
        Number of drawn machines in specification, and of all.
    on_front
        Whether every candidate that costs no more has fewer machines in specification.
    """

    cost: float
    factors: Mapping[str, float]
    passed: int
    machines: int
    on_front: bool = False

    @property
    def share(self) -> float:
        """Share of the drawn machines that are in specification."""
        return self.passed / self.machines

    @property
    def interval(self) -> tuple[float, float]:
        """Confidence interval (95 %) of the yield."""
        return clopper_pearson(self.passed, self.machines)


def redesigned(
    space: Space, evaluator: Evaluator, point: FloatArray, acceleration: float
) -> tuple[Machine, dict[str, float]]:
    """Return the machine at a (dims,) point, and the changed numbers, by path.

    Parameters
    ----------
    acceleration
        Share of the machine's acceleration that is used.
    """
    machine = space.machine
    gains = {k: float(v[0]) for k, v in evaluator.gains(point[None])[0].items()}
    numbers = {k: float(v[0]) for k, v in space.numbers(point[None]).items()}
    numbers = {k: v for k, v in numbers.items() if v != number_at(machine, k).si} | gains
    numbers |= space.slower(acceleration)
    return with_numbers(machine, numbers), numbers


def spread(count: int, most: int = MOST_TRIED) -> IntArray:
    """Return the indices of at most ``most`` of ``count`` candidates, the first and last included.

    >>> spread(30, 4)
    array([ 0, 10, 19, 29])
    """
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def yield_of(
    space: Space,
    evaluator: Evaluator,
    point: FloatArray,
    acceleration: float,
    spec: Spec,
    machines: int,
) -> CandidateYield | None:
    """Return the yield of a candidate; None where no commands can be made for it.

    All candidates get the same random deviations, as parts of their tolerances.

    Parameters
    ----------
    spec
        Specification, with the candidate's needle delay.
    machines
        How many machines are drawn.
    """
    machine, _ = redesigned(space, evaluator, point, acceleration)
    try:
        kind_of(machine).check(machine)
        plan = plan_job(evaluator.read(machine), machine, evaluator.options_at(point))
    except PlanError:
        return None
    found = MachineYield(plan, spec).drawn(machines, SEED)
    factors = np.exp(point[: space.parameters]).tolist()
    return CandidateYield(
        cost=float(space.cost(point[None])[0]),
        factors=dict(zip(space.names, factors, strict=True)),
        passed=found.passed,
        machines=machines,
    )


def marked(found: Sequence[CandidateYield]) -> tuple[CandidateYield, ...]:
    """Return the candidates, the cheapest first, each with whether it is on the front.

    Candidates may differ in their settings alone: if their factors agree within a thousandth, and
    they have equally many machines in specification, only the cheapest is kept.

    >>> def of(cost, passed):
    ...     factors = {"mass": cost}
    ...     return CandidateYield(cost=cost, factors=factors, passed=passed, machines=9)
    >>> some = [of(2, 7), of(0, 3), of(1, 3)]
    >>> [(one.cost, one.on_front) for one in marked(some)]
    [(0, True), (1, False), (2, True)]
    """
    rows: list[CandidateYield] = []
    most_passed = -1
    for one in sorted(found, key=lambda one: (one.cost, -one.passed)):
        if any(known.passed == one.passed and _alike(known, one) for known in rows):
            continue
        rows.append(replace(one, on_front=one.passed > most_passed))
        most_passed = max(most_passed, one.passed)
    return tuple(rows)


def _alike(one: CandidateYield, other: CandidateYield) -> bool:
    return all(math.isclose(v, other.factors[k], rel_tol=1e-3) for k, v in one.factors.items())
