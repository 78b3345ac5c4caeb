"""Candidates of a redesign and what became of them in the batch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.errors import MachineError, PlanError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.machine.numbers import with_numbers
from threadline.options import Options
from threadline.pipeline import NOMINAL, plan_job
from threadline.search.design_alone import NO_COMMANDS, AloneProofs
from threadline.search.design_gains import design_gains
from threadline.search.design_judge import HOPELESS, DesignJudge, Ratios, design_judge
from threadline.search.design_runs import OtherRuns
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
"""For candidates with commands of their own, each of which takes a second or two."""


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
        (n,) worst measured over limit, at the best needle delay; over other runs and machines
        where they are asked for and it is in spec without them. At most 1 is in spec.
    nominal
        (n,) the same of one run.
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

    Machines that are not simulated side by side are planned for and proved one by one.

    Parameters
    ----------
    space
        What may be changed.
    read
        Reads the job for a machine.
    spec, options
        How well the machine shall do it, and how it is planned.
    others
        In which other runs and machines a candidate must hold; in none when None.
    """

    def __init__(
        self,
        space: Space,
        read: Callable[[Machine], Job],
        spec: Spec,
        options: Options,
        others: OtherRuns | None = None,
        effort: Effort = THOROUGH,
    ) -> None:
        self.space, self.effort = space, effort
        self.others = others or OtherRuns.of(space, NOMINAL)
        self.read, self._spec, self._options = read, spec, options
        self.simulated = 0
        self.judges: tuple[DesignJudge, ...] = ()
        self._alone: AloneProofs | None = None
        if space.ahead:
            return
        if space.alone:
            plan_job(read(space.machine), space.machine, options)  # which may refuse it
            self._alone = AloneProofs(read, spec, options, self.others.repeats)
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
        if self._alone is not None:
            return None
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
            Other runs and machines are tried of those whose nominal ratio is at most this.
        """
        if self.space.ahead:
            return self._ahead(points, level, beyond)
        if self._alone is not None:
            return self._one_by_one(self._alone, points, level, beyond)
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

    def _one_by_one(
        self, proofs: AloneProofs, points: FloatArray, level: IntArray, beyond: float
    ) -> Tried:
        """Prove every candidate by itself."""
        found = []
        for point, share in zip(points, level.tolist(), strict=True):
            numbers = {k: float(v[0]) for k, v in self.space.numbers(point[None]).items()}
            numbers |= self.space.slower(self.space.levels[share])
            found.append(proofs.used(with_numbers(self.space.machine, numbers), beyond))
        self.simulated = proofs.simulated
        return Tried(
            points=points,
            level=np.asarray(level, dtype=np.int64),
            ratio=np.array([worst for _, worst, _ in found]),
            nominal=np.array([first for first, _, _ in found]),
            delay=np.zeros(len(points), dtype=np.int64),
            binding=tuple(binding for _, _, binding in found),
        )

    def _ahead(self, points: FloatArray, level: IntArray, beyond: float) -> Tried:
        """Plan every candidate through its own inverse, then judge it."""
        count = len(points)
        ratio = np.full(count, HOPELESS)
        nominal = ratio.copy()
        binding = [NO_COMMANDS] * count
        for index, (point, width) in enumerate(zip(points, level.tolist(), strict=True)):
            numbers = {k: float(v[0]) for k, v in self.space.numbers(point[None]).items()}
            machine = with_numbers(self.space.machine, numbers)
            try:
                plan = plan_job(self.read(machine), machine, self.options_at(width))
                judge = design_judge(plan, machine, self._spec, self.space.delays_s)
            except (PlanError, MachineError):
                continue
            own = {k: np.array([v]) for k, v in numbers.items()}
            found, ratios = self._judged(judge, point[None], own, beyond)
            nominal[index], ratio[index] = found.best()[0][0], ratios.best()[0][0]
            binding[index] = ratios.binding(0)
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
            own = self.space.numbers(points[at]) | {k: v[at] for k, v in gains.items()}
            found, ratios = self._judged(judge, points[at], own, beyond)
            nominal[at] = found.best()[0]
            ratio[at], delay[at] = ratios.best()
            for i, k in enumerate(at.tolist()):
                binding[k] = ratios.binding(i)
        return Tried(
            points=points,
            level=np.full(count, level, dtype=np.int64),
            ratio=ratio,
            nominal=nominal,
            delay=delay,
            binding=tuple(binding),
        )

    def _judged(
        self,
        judge: DesignJudge,
        points: FloatArray,
        numbers: Mapping[str, FloatArray],
        beyond: float,
    ) -> tuple[Ratios, Ratios]:
        """Return what (n, dims) candidates use of the limits in the first run, and at worst."""
        first = judge.ratios(numbers)
        worst, simulated = self.others.worst(judge, points, numbers, first, beyond)
        self.simulated += len(points) + simulated
        return first, worst
