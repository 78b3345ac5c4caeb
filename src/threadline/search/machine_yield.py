"""The yield: the share of machines within the tolerances in specification; the worst machine."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.wording import toml_string
from threadline.commands.plan import Plan
from threadline.dynamics.values import Values
from threadline.errors import OptionError
from threadline.files import tick_table
from threadline.machine import Machine
from threadline.machine.model import check_dynamics
from threadline.machine.numbers import number_at, number_tables, with_numbers
from threadline.machine.variants import (
    MOST_CORNERS,
    Uncertain,
    check_uncertain,
    drawn,
    load_by_counts,
    numbers_at,
    one_at_a_time,
    uncertain,
)
from threadline.proof.kinds import kind_of
from threadline.search.judge_runs import AloneJudge, RunsJudge
from threadline.search.yield_state import YieldState
from threadline.twin import fastest_rates
from threadline.verdict import CriterionRow, EachRun, Spec, percent_used
from threadline.verdict.each_run import clopper_pearson
from threadline.verdict.registry import MEASURES
from threadline.verdict.rendering import shown

AT_ONCE = 4096
"""Machines that are judged, and kept in a state, as one part; results do not depend on it."""
_AT_ONCE_ALONE = 32
_STARTS = 4  # samples from which the search for the worst case starts
_STARTS_ALONE = 1  # where machines are simulated one by one, a second each
_ROUNDS = 8
_COUNTS = "axes.*.counts"

Done = Callable[[int], None]
"""Called with the number of judged machines."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Worst:
    """The worst machine found.

    Parameters
    ----------
    parts
        (n,) place of each number in its tolerance, -1 to 1.
    numbers
        Names and SI values of the numbers that differ from the machine file.
    share
        The largest used share of a limit; infinite where the machine exceeds a limit of 0.
    binding
        The criterion with this limit.
    row
        Values of this criterion in this machine alone; None where the machine cannot be simulated,
        or never ends a wait.
    of_corners
        Whether every corner of the tolerances was tried.
    """

    parts: FloatArray
    numbers: dict[str, float]
    share: float
    binding: str
    row: CriterionRow | None
    of_corners: bool

    @property
    def used(self) -> str:
        """The used share of the limit, as text."""
        if self.row is None:
            return "it cannot be simulated, or never ends what it waits for"
        if self.row.missed.any():
            return f"{self.binding} is required, and was not measured"
        if np.isfinite(self.share):
            return f"{percent_used(self.share, 1)} of {self.binding}"
        limit = shown(self.row.limit or 0.0, self.row.unit)
        return f"{shown(float(self.row.values[0]), self.row.unit)} of {self.binding}, limit {limit}"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Yield:
    """Results of machines drawn over the tolerances.

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


class MachineYield:
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
        asked = [c for c in spec.criteria if MEASURES[c.name].compares_runs]
        for criterion in asked:
            if criterion.required:
                raise OptionError(
                    f"{criterion.name} is required, and is of many runs of one machine: a yield is "
                    "of one run of each",
                    remedy="Let it not be required; prove --yield measures it in 20 runs.",
                )
        self.plan = plan
        self.left_out = tuple(dict.fromkeys(c.name for c in asked if c.limit is not None))
        self.numbers = check_uncertain(plan.machine)
        self._many: RunsJudge | None = None
        self._alone = AloneJudge(plan, spec)
        if kind_of(plan.machine).together(plan.machine):
            extremes = numbers_at(plan.machine, self._fastest_corner())
            self._many = RunsJudge(plan, spec, threads=threads, extremes=extremes)

    def _fastest_corner(self) -> FloatArray:
        """Return (k, n) parts of machines whose rates bound the rates of all drawn machines.

        For each connected piece of the machine, one of them has every number at its faster end.
        Each of the others has a single number at one of its ends.
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
        return np.asarray(np.concatenate([ends, np.stack(corners)]) * self._ends)

    @property
    def together(self) -> bool:
        """Whether machines are simulated in batches; otherwise one by one, a second each."""
        return self._many is not None

    @property
    def _ends(self) -> FloatArray:
        """(n,) largest deviation of each number, in parts of its tolerance."""
        return np.array([number.farthest for number in self.numbers])

    def judged(self, parts: FloatArray, done: Done | None = None) -> EachRun:
        """Return the results of machines at (k, n) parts of their tolerances."""
        if self._many is None:
            return self._alone.judged(parts, done)
        return self._many.judged(numbers_at(self.plan.machine, parts), done=done)

    def drawn(
        self,
        variants: int,
        seed: int,
        done: Done | None = None,
        state: YieldState | None = None,
    ) -> Yield:
        """Return the results of the first machines in the sequence of a seed.

        Parameters
        ----------
        state
            Known results for the same plan, specification and seed; new results are added to it.

        Raises
        ------
        OptionError
            If no machine is asked for, or the seed is out of range.
        RecordingError
            If the first machine's result differs from the state's.
        """
        if variants < 1:
            raise OptionError(f"variants must be at least 1, got {variants}")
        found: list[EachRun] = []
        through = 0
        if state is not None and state.known is not None:
            through = min(state.known.runs, variants)
            state.check_first(self.judged(drawn(self.plan.machine, seed, np.arange(1))))
            found.append(state.known.taken(np.arange(through)))
            if done is not None:
                done(through)
        at_once = AT_ONCE if self._many is not None else _AT_ONCE_ALONE
        for at in range(through, variants, at_once):
            index: IntArray = np.arange(at, min(at + at_once, variants))
            found.append(self.judged(drawn(self.plan.machine, seed, index), done))
            if state is not None:
                state.add(found[-1])
        return Yield(numbers=self.numbers, found=EachRun.joined(found), seed=seed)

    def worst(self, known: Yield | None = None, done: Done | None = None) -> Worst:
        """Return the worst machine that is found within the tolerances.

        With up to 12 numbers every corner is tried. With more numbers a search starts from the
        worst machines in ``known``. Each step tries every number at its other end, then all the
        worse ends together, and takes the worst of these machines. The search stops when no machine
        is worse.

        In both cases one search starts from the worst drawn machine itself, because the worst
        machine may lie inside the tolerances, for example where a mode passes a zero of a law. With
        more than 12 numbers the other searches start from the corners next to the worst drawn
        machines.

        Parameters
        ----------
        done
            Called with the number of tried machines.
        """
        count = len(self.numbers)
        if count <= MOST_CORNERS:
            ends = np.array(np.meshgrid(*[[-1.0, 1.0]] * count, indexing="ij"))
            parts = ends.reshape(count, -1).T * self._ends
            shares, binding = shares_of(self.judged(parts, done))
            at = int(np.argmax(shares))
            corner = parts[at], float(shares[at]), binding[at]
            inner = [self._climbed(one, done) for one in _worst_drawn(self.plan, known, 1)]
            if all(one[1] <= corner[1] for one in inner):
                return self._worst(*corner, of_corners=True)
            return self._worst(*inner[0], of_corners=False)
        starts = np.zeros((1, len(self.numbers)))
        if known is not None:
            most = _STARTS if self._many is not None else _STARTS_ALONE
            near = _worst_drawn(self.plan, known, most)
            corners = np.where(near < 0.0, -1.0, 1.0) * self._ends
            starts = np.concatenate([near[:1], corners])
        climbed = [self._climbed(start, done) for start in np.unique(starts, axis=0)]
        return self._worst(*max(climbed, key=lambda one: one[1]), of_corners=False)

    def _climbed(self, start: FloatArray, done: Done | None) -> tuple[FloatArray, float, str]:
        """Step from a machine to worse machines; return the last, its share and its criterion."""
        shares, binding = shares_of(self.judged(start[None], done))
        best, share, bound = start, float(shares[0]), binding[0]
        for _ in range(_ROUNDS if np.isfinite(share) else 0):
            ends = [(k, end) for k, far in enumerate(self._ends.tolist()) for end in (-far, far)]
            moves = [(k, end) for k, end in ends if best[k] != end]
            tried = np.repeat(best[None], len(moves), axis=0)
            for row, (k, end) in zip(tried, moves, strict=True):
                row[k] = end
            shares, binding = shares_of(self.judged(tried, done))
            worse = [at for at in np.argsort(shares, kind="stable").tolist() if shares[at] > share]
            if not worse:
                break
            best, share, bound = tried[worse[-1]], float(shares[worse[-1]]), binding[worse[-1]]
            together = best.copy()
            for at in worse:  # the worse of a number's two ends comes last
                k, end = moves[at]
                together[k] = end
            if len(worse) > 1 and np.isfinite(share):
                shares, binding = shares_of(self.judged(together[None], done))
                if shares[0] > share:
                    best, share, bound = together, float(shares[0]), binding[0]
        return best, share, bound

    def _worst(self, parts: FloatArray, share: float, binding: str, *, of_corners: bool) -> Worst:
        alone = self._alone.judged(parts[None])
        shares, names = shares_of(alone)
        if np.isfinite(shares[0]):
            share, binding = float(shares[0]), names[0]
        of_runs = [row for row in alone.rows if not row.of_plan]
        answers = any(np.isfinite(row.values[0]) for row in of_runs)
        row = next((row for row in of_runs if row.text == binding), None)
        moved = numbers_at(self.plan.machine, parts)
        own = numbers_at(self.plan.machine, np.zeros(len(self.numbers)))
        numbers = {k: float(v[0]) for k, v in moved.items() if v[0] != own[k][0]}
        return Worst(
            parts=parts,
            numbers=numbers,
            share=share,
            binding=binding,
            row=row if answers else None,
            of_corners=of_corners,
        )

    def halved(self, variants: int, seed: int, done: Done | None = None) -> FloatArray:
        """Return (n,) the yield with the tolerance of one number halved, for each number.

        The same machines are drawn except for the halved number, so that differences come from it
        alone.
        """
        parts = drawn(self.plan.machine, seed, np.arange(variants))
        found = np.empty(len(self.numbers))
        for k in range(len(self.numbers)):
            fewer = parts.copy()
            fewer[:, k] *= 0.5
            found[k] = self.judged(fewer, done).passed.mean()
        return found


def _worst_drawn(plan: Plan, known: Yield | None, most: int) -> FloatArray:
    """Return (k, n) parts of the worst drawn machines."""
    if known is None:
        return np.empty((0, len(uncertain(plan.machine))))
    order = np.argsort(-shares_of(known.found)[0], kind="stable")[:most]
    return drawn(plan.machine, known.seed, order)


def shares_of(found: EachRun) -> tuple[FloatArray, list[str]]:
    """Return (runs,) the largest used share of a limit in each run, and the criterion.

    The machine's own limits and criteria of the plan alone do not count: they are the same for
    every machine.
    """
    rows = [row for row in found.rows if row.limit is not None and not row.hard and not row.of_plan]
    if not rows:
        return np.zeros(found.runs), [""] * found.runs
    table = np.stack([_share(row) for row in rows])
    at = np.argmax(table, axis=0)
    return table[at, np.arange(found.runs)], [rows[k].text for k in at.tolist()]


def _share(row: CriterionRow) -> FloatArray:
    assert row.limit is not None
    known = np.nan_to_num(row.values, nan=np.inf if row.required else 0.0, posinf=np.inf)
    if row.limit <= 0.0:
        return np.where(known > row.limit, np.inf, 0.0)
    return np.asarray(known / row.limit)


def worst_toml(machine: Machine, worst: Worst, base: str) -> str:
    """Return the machine file of the worst machine: the numbers that differ, over its base.

    Command counts stay as in the base. Deviating counts per unit of an axis are written as weights
    of the axis's load.
    """
    made = with_numbers(machine, worst.numbers)
    told: dict[str, tuple[float, str]] = {}
    for path, value in worst.numbers.items():
        if fnmatchcase(path, _COUNTS):
            axis = path.split(".")[1]
            weights = load_by_counts(made, axis)
            told |= {f"axes.{axis}.load.{body}": (q.si, q.unit) for body, q in weights.items()}
        else:
            told[path] = value, number_at(machine, path).unit
    texts = {
        path: f"{value!r} {unit}".strip() + " exact, assumed: worst of the tolerances"
        for path, (value, unit) in told.items()
    }
    lines = [
        f"# The worst machine found within the tolerances: {worst.used},",
        "# by threadline yield.",
        f"base = {toml_string(base)}",
        f"name = {toml_string(machine.name.split('+')[0] + '-worst')}",
        f"title = {toml_string(machine.title + ', worst of its tolerances')}",
        *number_tables(texts),
    ]
    return "\n".join(lines) + "\n"


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


def quantile(row: CriterionRow, share: float) -> float:
    """Return the value that ``share`` of the measured machines do not exceed; NaN without any.

    A machine whose motion grows without bound counts as infinity.
    """
    known = row.values[~np.isnan(row.values)]
    if not len(known):
        return float("nan")
    if np.isfinite(known).all():
        return float(np.quantile(known, share))
    # No interpolation exists between a number and infinity.
    return float(np.quantile(known, share, method="inverted_cdf"))
