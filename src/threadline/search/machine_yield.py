"""The yield: the share of machines within the tolerances in specification; the worst machine."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, floor
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.summary import Summarised, Summary
from threadline.base.workers import Done, workers
from threadline.commands.plan import Plan
from threadline.errors import OptionError
from threadline.machine import Machine
from threadline.machine.model import check_dynamics
from threadline.machine.pneumatics import TIMES
from threadline.machine.variants import MOST_CORNERS, Uncertain, corners, drawn, not_drawn
from threadline.proof.pipeline import check_machine, open_job, plan_job, run_by, with_product
from threadline.proof.request import Words
from threadline.proof.worst_machine import WithinTolerances, Worst, shares_of
from threadline.proof.worst_search import WorstSearch
from threadline.search.yield_state import YieldState
from threadline.verdict import CriterionRow, EachRun, Spec
from threadline.verdict.each_run import CONFIDENCE, clopper_pearson
from threadline.verdict.registry import MEASURES
from threadline.verdict.rendering import shown
from threadline.verdict.replayed import NUMBERS, product_of, toleranced

AT_ONCE = 4096
"""Number of machines that are judged and stored as one part; results do not depend on it."""
_AT_ONCE_SERIAL = 32
_AT_ONCE_LATE = 16_384
"""Number of machines in a part if dead times vary: only equal dead times are simulated together."""
_AT_ONCE_AWAY, _TURNS = 256, 8
"""Most machines in a part for a remote worker, which may be lost; number of parts for each core."""
_SEARCHED = 2000
"""Most machines that a search for the worst machine tries, if they are simulated in batches."""
_OF_PRODUCT = "as in the product file: a yield counts machines, and prove varies the product too"


def planned_yield(words: Words, job: Path, machine: Machine) -> tuple[MachineYield, Spec]:
    """Plan a job for the machine of the file; return the judge of its machines, and the spec.

    With ``actual`` among the words the numbers of that machine vary, under the same commands.

    Raises
    ------
    MachineError, JobError, PlanError, OptionError
        If the input is wrong, or no number of the machine varies.
    """
    options = words.options(job)
    check_machine(machine)
    plan = plan_job(open_job(job, machine, options), machine, options)
    spec = with_product(words.spec(machine), machine, options)
    actual = words.actual()
    return MachineYield(plan if actual is None else run_by(plan, actual), spec), spec


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class Yield(Summarised):
    """Results of machines drawn over the tolerances; prints itself as a table.

    Parameters
    ----------
    numbers
        The numbers that vary.
    found
        Every criterion in every machine.
    seed
        Seed of the sequence of machines.
    """

    numbers: tuple[Uncertain, ...]
    found: EachRun
    seed: int

    @property
    def passed(self) -> int:
        """Number of machines in specification."""
        return int(self.found.passed.sum())

    @property
    def share(self) -> float:
        """Share of the drawn machines that are in specification."""
        return self.passed / self.found.runs

    @property
    def interval(self) -> tuple[float, float]:
        """Confidence interval (95 %) of the yield of all machines."""
        return clopper_pearson(self.passed, self.found.runs)

    def _summary(self) -> Summary:
        title = (
            f"{self.passed} of {self.found.runs} machines in spec; {yield_words(self.interval)} of "
            f"all machines, with {100.0 * CONFIDENCE:.0f} % confidence"
        )
        return Summary(title, CRITERION_HEADER, [*map(criterion_cells, limited_rows(self))])


class MachineYield(WithinTolerances):
    """Judges machines within the tolerances of a plan's machine, all under its commands.

    ``left_out`` holds the criteria with a limit that are not judged, because they compare runs of
    one machine.

    Encoders stand as in a nominal run, so that ``prove --nominal`` of a machine gives the same
    result.

    Raises
    ------
    OptionError
        If no number of the machine varies, its file has no dynamics, or a required criterion
        compares runs of one machine.
    """

    def __init__(self, plan: Plan, spec: Spec, *, threads: int | None = None) -> None:
        check_dynamics("what varies from machine to machine", plan.machine)
        compared = [c for c in spec.criteria if MEASURES[c.name].compares_runs]
        for criterion in compared:
            if criterion.required:
                raise OptionError(
                    f"{criterion.name} is required and compares runs of one machine, but a yield "
                    "has one run of each machine",
                    remedy="Remove required there; prove --yield measures it in 20 runs.",
                )
        self.left_out = tuple(dict.fromkeys(c.name for c in compared if c.limit is not None))
        super().__init__(plan, spec, threads=threads)

    @property
    def same(self) -> dict[str, str]:
        """Numbers with a tolerance that are equal in all machines, with the reason, by name."""
        product = product_of(self.plan)
        names = [] if product is None else [NUMBERS[k] for k in toleranced(product)]
        return {**not_drawn(self.plan.machine), **dict.fromkeys(names, _OF_PRODUCT)}

    def drawn(
        self,
        variants: int,
        seed: int,
        done: Done | None = None,
        state: YieldState | None = None,
        *,
        first: int = 0,
        at_once: int | None = None,
    ) -> Yield:
        """Return the results of consecutive machines in the sequence of a seed.

        Parameters
        ----------
        variants
            How many machines.
        state
            Known results for the same plan, specification, seed and ``first``; new results are
            added to it.
        first
            Number of the first machine in the sequence.
        at_once
            Number of machines that are judged and stored as one part; results do not depend on it.
            None: a number that suits the machine and the workers.

        Raises
        ------
        OptionError
            If the number of machines is less than 1, or the seed is out of range.
        RecordingError
            If the first machine's result differs from the state's.
        """
        if variants < 1:
            raise OptionError(f"variants must be at least 1, got {variants}")
        batches_judged: list[EachRun] = []
        known_count = 0
        if state is not None and state.known is not None:
            known_count = min(state.known.runs, variants)
            state.check_first(self.judged(drawn(self.plan.machine, seed, first + np.arange(1))))
            batches_judged.append(state.known.taken(np.arange(known_count)))
            if done is not None:
                done(known_count)
        at_once = self._at_once(variants) if at_once is None else at_once
        batches = (
            drawn(self.plan.machine, seed, first + np.arange(at, min(at + at_once, variants)))
            for at in range(known_count, variants, at_once)
        )
        for batch in self.judged_each(batches, done):
            batches_judged.append(batch)
            if state is not None:
                state.add(batch)
        return Yield(numbers=self.numbers, found=EachRun.joined(batches_judged), seed=seed)

    def _at_once(self, variants: int) -> int:
        """Return the number of machines that are judged and stored as one part."""
        if not self.together:
            return _AT_ONCE_SERIAL
        if any(path.endswith(TIMES) for number in self.numbers for path in number.numbers):
            return _AT_ONCE_LATE  # each task of a worker has one choice of dead times
        remote_workers = workers()
        if remote_workers is None:
            return AT_ONCE
        # Parts are small, so that all workers end at about the same time, and a lost part costs
        # little.
        return max(min(_AT_ONCE_AWAY, variants // (_TURNS * remote_workers.cores)), 1)

    def worst(self, known: Yield | None = None, done: Done | None = None) -> Worst:
        """Return the worst machine that is found within the tolerances.

        With up to 12 numbers every corner is tried first. Then a ``WorstSearch`` goes on from these
        and from the worst drawn machines, because the worst machine may lie inside the tolerances,
        for example where a mode passes a zero of a law.

        Parameters
        ----------
        known
            Drawn machines; the worst of them are starts of the search.
        done
            Called with the number of tried machines.
        """
        search = WorstSearch(self, _SEARCHED if self.together else None, done=done)
        search.begin()
        if known is not None:
            order = np.argsort(-shares_of(known.found)[0], kind="stable")
            parts = drawn(self.plan.machine, known.seed, order)
            search.add(parts, known.found.taken(order))
        corner_indices: IntArray = np.zeros(0, dtype=np.int64)
        if len(self.numbers) <= MOST_CORNERS:
            corner_indices = search.tried(corners(self.plan.machine) * self.ends)
        search.go_on()
        worst = search.worst()
        shares, names = shares_of(search.found)
        worst_corners = corner_indices[shares[corner_indices] >= shares[worst]]
        worst_index = int(worst_corners[0]) if len(worst_corners) else worst
        return self.worst_at(
            search.parts[worst_index],
            float(shares[worst_index]),
            names[worst_index],
            of_corners=len(worst_corners) > 0,
        )

    def halved(self, variants: int, seed: int, done: Done | None = None) -> FloatArray:
        """Return (n,) the yield with the tolerance of one number halved, for each number.

        The same machines are drawn except for the halved number, so that differences come from it
        alone.
        """
        parts = drawn(self.plan.machine, seed, np.arange(variants))
        yields = np.empty(len(self.numbers))
        for k in range(len(self.numbers)):
            halved_parts = parts.copy()
            halved_parts[:, k] *= 0.5
            yields[k] = self.judged(halved_parts, done).passed.mean()
        return yields


def limited_rows(found: Yield) -> list[CriterionRow]:
    """Return the criteria with a limit that depend on the machine, not on the plan alone.

    Required criteria that were not measured are included.
    """
    return [
        row
        for row in found.found.rows
        if row.limit is not None and not row.of_plan
        and ((row.values > 0.0).any() or row.missed.any())
    ]  # fmt: skip


def yield_words(interval: tuple[float, float]) -> str:
    """Return a confidence interval in words, rounded outwards: never better than it is.

    >>> yield_words((0.989979, 0.99742)), yield_words((0.025 ** (1 / 10_000), 1.0))
    ('98.99 to 99.75 %', 'at least 99.963 %')
    """
    low, high = interval
    if high == 1.0:
        return f"at least {floor(1e5 * low) / 1e3:.5g} %"
    return f"{floor(1e4 * low) / 1e2:.4g} to {ceil(1e4 * high) / 1e2:.4g} %"


CRITERION_HEADER = ("criterion", "half up to", "99 % up to", "most", "limit", "failed")


def criterion_cells(row: CriterionRow) -> list[str]:
    """Return the cells of a criterion with a limit, under ``CRITERION_HEADER``."""
    assert row.limit is not None
    values = [quantile(row, share) for share in (0.5, 0.99, 1.0)]
    measured = ["-" if np.isnan(value) else shown(value, row.unit) for value in values]
    failed_count = f"{int((row.failed | row.missed).sum())}"
    return [row.text, *measured, shown(row.limit, row.unit), failed_count]


def quantile(row: CriterionRow, share: float) -> float:
    """Return the value that ``share`` of the measured machines do not exceed; NaN without any.

    The value of a machine whose motion grows without bound is infinite.
    """
    measured = row.values[~np.isnan(row.values)]
    if not len(measured):
        return float("nan")
    if np.isfinite(measured).all():
        return float(np.quantile(measured, share))
    # A number and infinity cannot be interpolated.
    return float(np.quantile(measured, share, method="inverted_cdf"))
