"""Other runs and other machines in which a candidate of a redesign must hold, too."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.machine import Machine
from threadline.machine.numbers import number_at
from threadline.machine.vary import Days, drawn_days, varied_numbers
from threadline.pipeline import REPEAT_SEED, Trials
from threadline.search.design_judge import DesignJudge, Ratios
from threadline.search.design_space import Space

_Numbers = Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtherRuns:
    """The runs of a candidate beyond its first.

    Parameters
    ----------
    space
        What may be changed.
    repeats
        Runs of each candidate in all, those that ``prove`` draws.
    corners
        Whether every corner of the tolerances of the space counts, too; one run of each.
    """

    space: Space
    repeats: int
    corners: bool

    @classmethod
    def of(cls, space: Space, trials: Trials, *, corners: bool = False) -> OtherRuns:
        """Return the runs with which candidates are screened for a proof by ``trials``.

        Machines within the tolerances of the whole file are left to the proof: the corners of what
        may be changed stand for them here.
        """
        every = trials.machines > 0 and trials.wished is None
        return cls(
            space=space,
            repeats=trials.repeats,
            # One by one they would take hours: they are left to the proof, too.
            corners=(corners or every) and space.corner_count > 1 and not space.alone,
        )

    @property
    def asked(self) -> bool:
        """Whether there are any."""
        return self.repeats > 1 or self.corners

    @property
    def words(self) -> str:
        """What a ratio is the worst of."""
        runs = "1 run" if self.repeats == 1 else f"{self.repeats} runs"
        if not self.corners:
            return runs
        return f"{runs} and {self.space.corner_count} corners of the tolerances"

    def worst(
        self, judge: DesignJudge, points: FloatArray, numbers: _Numbers, own: Ratios, beyond: float
    ) -> tuple[Ratios, int]:
        """Return the worst ratios of (n, dims) candidates, and how many machines were simulated.

        Those with the extremes of friction and supply come first: a candidate that is out of
        specification there, by more than ``beyond``, is not tried any further.

        Parameters
        ----------
        numbers
            Path to (n,) values, those of the candidates' filters among them.
        own
            Of the first runs.
        beyond
            Candidates with a larger ratio are left alone.
        """
        simulated, found = 0, own
        for days in self._turns(len(judge.axes)):
            near = np.flatnonzero(found.best()[0] <= beyond)
            if not len(near):
                break
            some = {k: v[near] for k, v in numbers.items()}
            phases: FloatArray | None = None
            if days is None:
                count, variants = self.space.corner_count, self._off(points[near], some)
            else:
                count, variants = len(days), _on_days(self.space.machine, some, days)
                phases = np.tile(days.phases, (len(near), 1))
            simulated += len(near) * count
            found = found.worse_at(near, judge.ratios(variants, phases).worst_of(count))
        return found, simulated

    def _turns(self, axes: int) -> Iterator[Days | None]:
        """Yield runs that are tried together; None for the corners."""
        if self.repeats > 1:
            days = drawn_days(self.repeats, axes, np.random.default_rng(REPEAT_SEED))
            yield from _hardest_first(days)
        if self.corners:
            yield None

    def _off(self, points: FloatArray, numbers: _Numbers) -> dict[str, FloatArray]:
        """Return the numbers of every corner of candidates, candidate by candidate."""
        # All corners get the filters of the machine as drawn: nobody knows at which it is.
        same = {k: np.repeat(v, self.space.corner_count) for k, v in numbers.items()}
        return same | self.space.numbers(self.space.corners(points))


def _hardest_first(days: Days) -> Iterator[Days]:
    """Yield the runs beyond the first: those of extreme friction and supply, then the others."""
    others: IntArray = np.arange(1, len(days))
    friction, supply = days.friction[others], days.supply[others]
    ends = [friction.argmin(), friction.argmax(), supply.argmin(), supply.argmax()]
    first = np.unique(others[ends])
    yield days.taken(first)
    rest = np.setdiff1d(others, first)
    if len(rest):
        yield days.taken(rest)


def _on_days(machine: Machine, numbers: _Numbers, days: Days) -> dict[str, FloatArray]:
    """Return the numbers of candidates on each of some days, candidate by candidate."""
    count = len(next(iter(numbers.values())))
    found = {k: np.repeat(v, len(days)) for k, v in numbers.items()}
    for path, values in varied_numbers(machine, days.friction, days.supply).items():
        own = number_at(machine, path).si
        if path in found:
            found[path] = found[path] * np.tile(values / own, count)
        else:
            found[path] = np.tile(values, count)
    return found
