"""The worst machine within the tolerances that a search finds, and the file of that machine.

A machine is given by the *parts* of its numbers, as in ``machine/variants.py``. Every machine plays
the commands that were planned for the machine of the file.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.wording import toml_string
from threadline.base.workers import Done
from threadline.base.writing import staged_file
from threadline.commands.plan import Plan
from threadline.dynamics.values import Values
from threadline.files import tick_table
from threadline.machine import Machine
from threadline.machine.load import split_reference
from threadline.machine.numbers import number_at, number_tables, with_numbers
from threadline.machine.variants import check_uncertain, load_by_counts, numbers_at, one_at_a_time
from threadline.machine.vary import Days
from threadline.proof.judge_runs import RunsJudge, SerialJudge, Variants
from threadline.proof.kinds import kind_of
from threadline.twin import fastest_rates
from threadline.verdict import CriterionRow, EachRun, Spec, percent_used
from threadline.verdict.rendering import shown
from threadline.verdict.replayed import NUMBERS, product_at_random, product_of, toleranced
from threadline.verdict.types import EQUAL_SHARES

_COUNTS = "axes.*.counts"


class WithinTolerances:
    """Judges machines within the tolerances of a plan's machine, all under the plan's commands.

    Encoder phases are the phases of a nominal run, so that ``prove --nominal`` of such a machine
    gives the same result.

    Parameters
    ----------
    plan
        The plan; the numbers of ``plan.machine`` vary.
    spec
        The specification.
    threads
        Number of batches that are simulated at once; None: the number of cores.
    with_product
        Whether the numbers of the plan's product vary as well; their parts follow the parts of the
        machine.

    Attributes
    ----------
    replayed
        Whether the fibre of each run is replayed.

    Raises
    ------
    OptionError
        If no number of the machine varies.
    """

    def __init__(
        self, plan: Plan, spec: Spec, *, threads: int | None = None, with_product: bool = False
    ) -> None:
        self.plan = plan
        self.numbers = check_uncertain(plan.machine)
        product = product_of(plan) if with_product else None
        self.replayed = product_of(plan) is not None
        self._wound = toleranced(product) if product is not None else np.zeros(0, dtype=np.int64)
        self._batch: RunsJudge | None = None
        if kind_of(plan.machine).together(plan.machine):
            extremes = numbers_at(plan.machine, self._fastest_corner())
            self._batch = RunsJudge(plan, spec, threads=threads, extremes=extremes)
        runs_judge = self._batch
        if runs_judge is None:
            self._serial = SerialJudge(plan, spec)
        else:
            self._serial = SerialJudge(runs_judge.plan, spec, runs_judge.judge)

    def _fastest_corner(self) -> FloatArray:
        """Return (k, n) parts of k machines whose rates bound the rates of all drawn machines.

        For each connected piece of the machine, one of the k machines has every number at the end
        that makes the piece faster. Each other machine has a single number at one of its ends.
        """
        machine = self.plan.machine
        ends = one_at_a_time(machine)
        numbers = {
            path: values
            for path, values in numbers_at(machine, ends).items()
            if not path.endswith(".delay")
        }
        rates = fastest_rates(tick_table(self.plan.commands), Values.of(machine, numbers))
        corners = [np.where(rate[0::2] > rate[1::2], -1.0, 1.0) for rate in rates]
        return np.asarray(np.concatenate([ends, np.stack(corners)]) * self.ends[: ends.shape[1]])

    @property
    def together(self) -> bool:
        """Whether machines are simulated in batches; otherwise each takes about a second."""
        return self._batch is not None

    @property
    def ticks(self) -> int:
        """Number of ticks of a run; 0 for commands without rows for every tick."""
        return self.plan.commands.tick_count() or 0

    @property
    def ends(self) -> FloatArray:
        """(n,) largest deviation of each number, in parts of its tolerance."""
        of_machine = [number.farthest for number in self.numbers]
        return np.array([*of_machine, *np.ones(len(self._wound))])

    @property
    def singles(self) -> FloatArray:
        """(2 n, n) parts: in each row one number is at its lower or upper end, the rest nominal."""
        count = len(self.ends)
        parts = np.zeros((2 * count, count))
        parts[np.arange(0, 2 * count, 2), np.arange(count)] = -self.ends
        parts[np.arange(1, 2 * count, 2), np.arange(count)] = self.ends
        return parts

    def with_products(self, parts: FloatArray, index: IntArray) -> FloatArray:
        """Return (k, n) parts of drawn machines, with the parts of drawn products beside them.

        ``index`` has the (k,) numbers of the machines in the random sequence, which also select the
        products.
        """
        return np.concatenate([parts, product_at_random(index)[:, self._wound]], axis=1)

    def product(self, parts: FloatArray) -> FloatArray:
        """Return (k, 5) parts of the products of machines at (k, n) ``parts``."""
        product_parts = np.zeros((len(parts), len(NUMBERS)))
        product_parts[:, self._wound] = parts[:, len(self.numbers) :]
        return product_parts

    def machine_parts(self, parts: FloatArray) -> FloatArray:
        """Return the (k, n) parts of the machine's numbers, without the parts of the product."""
        return parts[..., : len(self.numbers)]

    def judged(self, parts: FloatArray, done: Done | None = None) -> EachRun:
        """Return the results of machines at (k, n) parts of their tolerances."""
        machine_parts, products = self.machine_parts(parts), self._products(parts)
        if self._batch is None:
            return self._serial.judged(machine_parts, done, products)
        return self._batch.judged(
            numbers_at(self.plan.machine, machine_parts), done=done, products=products
        )

    def judged_each(
        self, batches: Iterable[FloatArray], done: Done | None = None
    ) -> Iterator[EachRun]:
        """Yield the results of each batch of machines, at (k, n) parts of their tolerances.

        The machines of the next batches are begun before the first batch has ended.
        """
        split_batches = ((self.machine_parts(parts), self._products(parts)) for parts in batches)
        if self._batch is None:
            return self._serial.judged_each(split_batches, done)
        machine = self.plan.machine
        variants = (
            Variants(numbers=numbers_at(machine, machine_parts), products=p)
            for machine_parts, p in split_batches
        )
        return self._batch.judged_each(variants, done)

    def _products(self, parts: FloatArray) -> FloatArray | None:
        """Return the parts of the products of machines; None if no product varies."""
        return self.product(parts) if len(self._wound) else None

    def in_days(self, parts: FloatArray, days: Days) -> EachRun:
        """Return the results of machines at (k, n) parts, each on every day, machine by machine.

        Machines must be simulated in batches (``together``).
        """
        from threadline.machine.days import on_days  # only searches need it

        assert self._batch is not None
        machine_numbers = numbers_at(self.plan.machine, self.machine_parts(parts))
        numbers = on_days(self.plan.machine, machine_numbers, days)
        products = self._products(parts)
        if products is not None:
            products = np.repeat(products, len(days), axis=0)
        return self._batch.judged(numbers, np.tile(days.phases, (len(parts), 1)), products=products)

    def why_not(self, parts: FloatArray) -> str:
        """Return why a machine at (n,) parts has no result; empty if it has one."""
        return self._serial.why_not(self.machine_parts(parts))

    def worst_at(
        self, parts: FloatArray, share: float, binding: str, *, of_corners: bool = False
    ) -> Worst:
        """Return the machine at (n,) ``parts`` with its result, simulated alone.

        Parameters
        ----------
        share, binding
            Used share and criterion to return if the machine cannot be simulated alone.
        """
        products = self.product(parts[None])
        machine_parts = self.machine_parts(parts)
        result = self._serial.judged(
            machine_parts[None], products=products if len(self._wound) else None
        )
        shares, names = shares_of(result)
        if np.isfinite(shares[0]):
            share, binding = float(shares[0]), names[0]
        run_rows = [row for row in result.rows if not row.of_plan]
        is_measured = any(np.isfinite(row.values[0]) for row in run_rows)
        row = next((row for row in run_rows if row.text == binding), None)
        moved_numbers = numbers_at(self.plan.machine, machine_parts)
        nominal = numbers_at(self.plan.machine, np.zeros(len(self.numbers)))
        return Worst(
            parts=parts,
            numbers={k: float(v[0]) for k, v in moved_numbers.items() if v[0] != nominal[k][0]},
            product={NUMBERS[k]: float(products[0, k]) for k in self._wound if products[0, k]},
            share=share,
            binding=binding,
            row=row if is_measured else None,
            of_corners=of_corners,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Worst:
    """The worst machine found.

    Parameters
    ----------
    parts
        (n,) part of each number: -1 to 1 within its tolerance, and further for a number with a
        normal distribution.
    numbers
        Names and SI values of the numbers that differ from the machine file.
    share
        The largest used share of a limit. It is above 1 if the machine exceeds a limit of 0, and
        infinite if the machine cannot be simulated.
    binding
        The criterion with this limit.
    row
        Values of this criterion for this machine alone; None if the machine cannot be simulated, or
        waits forever for an input.
    of_corners
        Whether every corner of the tolerances was tried.
    product
        Places of the numbers of its product within their tolerances, -1 to 1, by name.
    """

    parts: FloatArray
    numbers: dict[str, float]
    share: float
    binding: str
    row: CriterionRow | None
    of_corners: bool
    product: dict[str, float] = field(default_factory=dict)

    @property
    def beyond_zero(self) -> bool:
        """Whether the limit is 0, so that there is no used share of it."""
        return self.row is not None and not (self.row.limit or 0.0) > 0.0

    @property
    def used(self) -> str:
        """The used share of the limit, as text."""
        if self.row is None:
            return "it cannot be simulated, or waits without end"
        if self.row.missed.any():
            return f"{self.binding} is required, and was not measured"
        if np.isfinite(self.share) and not self.beyond_zero:
            return f"{percent_used(self.share, 1)} of {self.binding}"
        limit = shown(self.row.limit or 0.0, self.row.unit)
        return f"{shown(float(self.row.values[0]), self.row.unit)} of {self.binding}, limit {limit}"


def row_shares(found: EachRun) -> FloatArray:
    """Return the (rows, runs) used share of every limit whose criterion depends on the machine.

    Limits of the machine file are included; criteria of the plan alone are not.
    """
    rows = [row for row in found.rows if row.limit is not None and not row.of_plan]
    if not rows:
        return np.zeros((1, found.runs))
    return np.asarray(np.stack([_share(row) for row in rows]))


def shares_of(found: EachRun) -> tuple[FloatArray, list[str]]:
    """Return the (runs,) largest used share of a limit in each run, and its criterion.

    Criteria of the plan alone do not count: they are the same for every machine. Limits of the
    machine file count only if they are exceeded, because a plan is made to use them fully. If
    several shares are equal, the first criterion is returned.
    """
    rows = [row for row in found.rows if row.limit is not None and not row.of_plan]
    if not rows:
        return np.zeros(found.runs), [""] * found.runs
    shares = np.stack([np.where(row.failed, _share(row), 0.0) if row.hard else _share(row)
                      for row in rows])  # fmt: skip
    largest = shares.max(axis=0)
    binding_rows = np.argmax(shares >= largest * (1.0 - EQUAL_SHARES), axis=0)
    return largest, [rows[k].text for k in binding_rows.tolist()]


def _share(row: CriterionRow) -> FloatArray:
    assert row.limit is not None
    measured = np.nan_to_num(row.values, nan=np.inf if row.required else 0.0, posinf=np.inf)
    if row.limit <= 0.0:
        # A limit of 0 has no shares: every value beyond it counts as a share above 1.
        return np.where(row.failed | row.missed, 1.0 + measured, 0.0)
    return np.asarray(measured / row.limit)


def unanswered_in(found: EachRun) -> NDArray[np.bool_]:
    """Return (runs,) whether a machine could not be simulated, or waited forever for an input."""
    rows = [row for row in found.rows if not row.of_plan]
    if not rows:
        return np.zeros(found.runs, dtype=np.bool_)
    return np.asarray(np.all([np.isposinf(row.values) for row in rows], axis=0))


def write_worst(machine: Machine, worst: Worst, file: Path, by: str) -> None:
    """Write the text of ``worst_toml`` as a machine file, completely or not at all.

    Raises
    ------
    OptionError, OSError
        If the file cannot be written.
    """
    text = worst_toml(machine, worst, file.parent, by)
    with staged_file(file) as stream:
        stream.write(text.encode())


def worst_toml(machine: Machine, worst: Worst, folder: Path, by: str) -> str:
    """Return the machine file of the worst machine: its base, and the numbers that differ from it.

    The counts per unit in which commands are given stay as in the base. An axis whose counts per
    unit deviate is written with other weights of its load instead.

    Parameters
    ----------
    folder
        Folder of the file to write; the path of a base file is given relative to it.
    by
        The verb that found the machine.
    """
    worst_machine = with_numbers(machine, worst.numbers)
    numbers: dict[str, tuple[float, str]] = {}
    for path, value in worst.numbers.items():
        if fnmatchcase(path, _COUNTS):
            axis = path.split(".")[1]
            weights = load_by_counts(worst_machine, axis)
            numbers |= {f"axes.{axis}.load.{body}": (q.si, q.unit) for body, q in weights.items()}
        else:
            numbers[path] = value, number_at(machine, path).unit
    texts = {
        path: f"{value!r} {unit}".strip() + " exact, assumed: worst of the tolerances"
        for path, (value, unit) in numbers.items()
    }
    lines = [
        f"# The worst machine found within the tolerances: {worst.used},",
        f"# by threadline {by}.",
        f"base = {toml_string(_reference_from(machine, folder))}",
        f"name = {toml_string(machine.name.split('+')[0] + '-worst')}",
        f"title = {toml_string(machine.title + ', worst of its tolerances')}",
        *number_tables(texts),
    ]
    return "\n".join(lines) + "\n"


def _reference_from(machine: Machine, folder: Path) -> str:
    """Return the reference of a machine, as a file in ``folder`` must write it."""
    name, overlays = split_reference(machine.reference)
    if name.endswith(".toml"):
        try:
            name = Path(os.path.relpath(name, folder)).as_posix()
        except ValueError:  # on another drive
            name = Path(name).absolute().as_posix()
    return "+".join([name, *overlays])
