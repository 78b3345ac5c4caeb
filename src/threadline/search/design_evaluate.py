"""Candidates of a redesign and what became of them in the batch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import MachineError, PlanError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.numbers import with_numbers
from threadline.options import Options
from threadline.pipeline import plan_job
from threadline.search.design_gains import design_gains
from threadline.search.design_judge import HOPELESS, DesignJudge, Ratios, design_judge
from threadline.search.design_space import Space
from threadline.verdict import Spec


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """How long to search.

    Parameters
    ----------
    sample_log2, settings_log2
        Candidates of the first sample at each level, and of settings alone, as powers of 2.
    proposals, rounds
        Of the search for the least change.
    trade_rounds
        Of the search for the least change with more margin.
    side
        Of the grid on which the region is drawn; 0 for none.
    """

    sample_log2: int = 8
    settings_log2: int = 5
    proposals: int = 192
    rounds: int = 24
    trade_rounds: int = 5
    side: int = 13


THOROUGH = Effort()
FEW = Effort(sample_log2=4, proposals=10, rounds=8, trade_rounds=0, side=0)
"""For feed-forward: every candidate has commands of its own, and takes a second or two."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tried:
    """Candidates that were simulated, n of them.

    Parameters
    ----------
    points
        (n, dims) as in the space.
    level
        (n,) which share of the acceleration.
    ratio
        (n,) worst measured over limit, at the best needle delay; over the tolerances where they
        are asked for and it is in spec without them. At most 1 is in spec.
    nominal
        (n,) the same without tolerances.
    delay
        (n,) which needle delay is the best.
    binding
        (n,) criterion that uses most of its limit.
    """

    points: FloatArray
    level: IntArray
    ratio: FloatArray
    nominal: FloatArray
    delay: IntArray
    binding: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.ratio)

    def taken(self, index: IntArray) -> Tried:
        """Return some of them."""
        return Tried(
            points=self.points[index],
            level=self.level[index],
            ratio=self.ratio[index],
            nominal=self.nominal[index],
            delay=self.delay[index],
            binding=tuple(self.binding[i] for i in index.tolist()),
        )

    def join(self, other: Tried) -> Tried:
        """Return both."""
        return Tried(
            points=np.concatenate([self.points, other.points]),
            level=np.concatenate([self.level, other.level]),
            ratio=np.concatenate([self.ratio, other.ratio]),
            nominal=np.concatenate([self.nominal, other.nominal]),
            delay=np.concatenate([self.delay, other.delay]),
            binding=(*self.binding, *other.binding),
        )


class Evaluator:
    """Plans a job once for each share of the acceleration, then judges candidates in batches.

    Parameters
    ----------
    space
        What may be changed.
    read
        Reads the job for a machine.
    spec, options
        How well the machine shall do it, and how it is planned.
    tolerances
        Whether a candidate counts over the corners of the tolerances.
    """

    def __init__(
        self,
        space: Space,
        read: Callable[[Machine], Job],
        spec: Spec,
        options: Options,
        tolerances: bool,
        effort: Effort = THOROUGH,
    ) -> None:
        self.space, self.effort = space, effort
        self.tolerances = tolerances and space.corner_count > 1
        self.read, self._spec, self._options = read, spec, options
        self.simulated = 0
        self.judges: tuple[DesignJudge, ...] = ()
        if space.ahead:
            return
        judges = []
        for share in space.levels:
            # The reader of a seam asks the machine for its acceleration: it is read anew.
            machine = with_numbers(space.machine, space.slower(share))
            plan = plan_job(read(machine), machine, options)
            judges.append(design_judge(plan, machine, spec, space.delays_s))
        self.judges = tuple(judges)

    def delay_s(self, level: int, delay: int) -> float | None:
        """Return a needle delay; None where the job has no stitches."""
        if self.space.ahead:
            return float(self.space.delays_s[delay])
        delays = self.judges[level].delays_s
        return float(delays[delay]) if len(delays) else None

    def tried(self, points: FloatArray, level: IntArray, *, beyond: float = 1.0) -> Tried:
        """Simulate and judge candidates.

        Parameters
        ----------
        points, level
            (n, dims) and (n,).
        beyond
            Tolerances are tried of those whose nominal ratio is at most this.
        """
        if self.space.ahead:
            return self._ahead(points, level, beyond)
        order = np.argsort(level, kind="stable")
        parts = [
            self._at_level(points[order][level[order] == k], k, beyond)
            for k in np.unique(level).tolist()
        ]
        joined = parts[0]
        for part in parts[1:]:
            joined = joined.join(part)
        back = np.argsort(order, kind="stable")
        return joined.taken(back)

    def gains(self, points: FloatArray) -> tuple[dict[str, FloatArray], np.ndarray]:
        """Return the filters of candidates and which of them have one."""
        if not self.space.designs_gains:
            return {}, np.ones(len(points), dtype=np.bool_)
        return design_gains(self.space, points)

    def options_at(self, level: int) -> Options:
        """Return how candidates of a level are planned, once their numbers are the machine's."""
        if not self.space.ahead:
            return self._options
        return replace(self._options, feed_forward_s=self.space.levels[level])

    def _ahead(self, points: FloatArray, level: IntArray, beyond: float) -> Tried:
        """Plan every candidate through its own inverse, then judge it and its corners."""
        count = len(points)
        ratio = np.full(count, HOPELESS)
        nominal = ratio.copy()
        binding = ["no commands"] * count
        for index, (point, width) in enumerate(zip(points, level.tolist(), strict=True)):
            numbers = {k: float(v[0]) for k, v in self.space.numbers(point[None]).items()}
            machine = with_numbers(self.space.machine, numbers)
            try:
                plan = plan_job(self.read(machine), machine, self.options_at(width))
                judge = design_judge(plan, machine, self._spec, self.space.delays_s)
            except (PlanError, MachineError):
                continue
            found = judge.ratios({k: np.array([v]) for k, v in numbers.items()})
            self.simulated += 1
            nominal[index] = ratio[index] = found.best()[0][0]
            if self.tolerances and nominal[index] <= beyond:
                corners = self.space.corners(point[None])
                worst = judge.ratios(self.space.numbers(corners))
                self.simulated += len(corners)
                found = worst.worst_of(len(corners)).worse(found)
                ratio[index] = found.best()[0][0]
            binding[index] = found.binding(0)
        return Tried(
            points=points,
            level=np.asarray(level, dtype=np.int64),
            ratio=ratio,
            nominal=nominal,
            delay=np.zeros(count, dtype=np.int64),
            binding=tuple(binding),
        )

    def _at_level(self, points: FloatArray, level: int, beyond: float) -> Tried:
        judge, count = self.judges[level], len(points)
        gains, possible = self.gains(points)
        ratio = np.full(count, HOPELESS)
        nominal = ratio.copy()
        delay = np.zeros(count, dtype=np.int64)
        binding = ["phase margin"] * count
        at = np.flatnonzero(possible)
        if len(at):
            own = {k: v[at] for k, v in gains.items()}
            found = judge.ratios(self.space.numbers(points[at]) | own)
            self.simulated += len(at)
            nominal[at], delay[at] = found.best()
            ratio[at] = nominal[at]
            for i, k in enumerate(at.tolist()):
                binding[k] = found.binding(i)
            if self.tolerances:
                self._corners(points, at, own, found, judge, beyond, ratio, delay, binding)
        return Tried(
            points=points,
            level=np.full(count, level, dtype=np.int64),
            ratio=ratio,
            nominal=nominal,
            delay=delay,
            binding=tuple(binding),
        )

    def _corners(
        self,
        points: FloatArray,
        at: IntArray,
        gains: dict[str, FloatArray],
        found: Ratios,
        judge: DesignJudge,
        beyond: float,
        ratio: FloatArray,
        delay: IntArray,
        binding: list[str],
    ) -> None:
        """Fill in what the tolerances make of the candidates that are nominally good enough."""
        near = np.flatnonzero(ratio[at] <= beyond)
        if not len(near):
            return
        count = self.space.corner_count
        corners = self.space.corners(points[at[near]])
        # All corners get the filters of the machine as drawn: nobody knows at which corner it is.
        numbers = self.space.numbers(corners) | {
            k: np.repeat(v[near], count) for k, v in gains.items()
        }
        worst = judge.ratios(numbers).worst_of(count)
        self.simulated += len(corners)
        own = Ratios(
            names=found.names,
            others=found.others[near],
            length=None if found.length is None else found.length[near],
        )
        both = worst.worse(own)
        ratio[at[near]], delay[at[near]] = both.best()
        for i, k in enumerate(at[near].tolist()):
            binding[k] = both.binding(i)
