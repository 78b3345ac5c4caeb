"""The worst day of a machine that a search finds, and the worst machine on its worst day.

A *day* is a set of values that vary from run to run, such as friction and supply. The level
``repeated`` draws days and states which share of all days is no worse than the worst of them. The
level ``over tolerances`` searches machines on a few days. A search for the fastest plan keeps the
plan that passes with the smallest margin, so its result needs a stricter test: a search for the
worst day, and for ``over tolerances`` a search for the worst machine together with its worst day.

The search begins with drawn days, or with the worst known machines on drawn days. Each round
changes the worst runs found so far a little, by steps that shrink from round to round.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.option_defaults import MOST_RUNS
from threadline.commands.plan import Plan
from threadline.errors import MachineError, RecordingError
from threadline.machine.days import days_at, on_own_days, places_of_days
from threadline.machine.variants import numbers_at, uncertain
from threadline.machine.vary import REPEAT_SEED, Days, drawn_days, varied_numbers
from threadline.proof.judge_runs import RunsJudge
from threadline.proof.kinds import kind_of
from threadline.proof.kinds.variants import unanswered
from threadline.proof.worst_machine import shares_of, unanswered_in
from threadline.verdict import EachRun, Judge, Spec, Verdict, with_lines
from threadline.verdict.each_run import with_other_machines
from threadline.verdict.replayed import product_of
from threadline.verdict.types import REPEATED_RUNS, SearchedDays

ROUNDS, CHANGED, WORST = 8, 256, 32
"""Number of rounds, number of changed runs per round, and number of worst runs that are changed."""
ROUNDS_SERIAL, CHANGED_SERIAL, WORST_SERIAL = 3, 8, 4
"""The same numbers for runs that are simulated one by one, a fifth of a second each."""
ROUNDS_OF_MACHINES, CLIMBS = 16, 2
"""Number of rounds of a search that changes machine and day together, and number of such searches,
each from its own seed."""
LEFT_FREE = 0.005
"""Share of every limit that the worst machine of this search must leave free. The worst values of
two seeds differed by up to 0.2 % of a limit, and an independent search found 0.2 % more."""
_FIRST, _SHRINK = 0.2, 0.6  # first step, as a share of each range; ratio of a step to the last one
_SHRINK_OF_MACHINES = 0.77
_MOST_SAMPLES, _MOST_OF_MACHINES = 5e7, 2e8  # ticks times runs: half a minute, and two minutes
_REPLAYED = 10  # a run takes so many times as long if its fibre is replayed
_MOVED = 3.0  # average number of a machine's numbers that one change moves
_TO_AN_END = 0.5  # share of the moved numbers that go to an end of their tolerance
_DEAD = (-1.0, 0.0, 1.0)  # parts of the dead times to begin with, besides those of the machines
_BY_SEARCH = "the worst day of a search"
_MACHINE_BY_SEARCH = (
    f"the worst machine and day of a search, which must leave {100.0 * LEFT_FREE:g} % free"
)
_NEVER_ENDS = "a day of the search has no end"

_Changed = Callable[[FloatArray, float, np.random.Generator], FloatArray]
"""Takes (k, n) places, a step as a share of each range, and a generator; returns changed places."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Search:
    """A search for a bad run.

    Parameters
    ----------
    first
        (k, n) places of the runs to begin with.
    judged
        Judges the runs at (k, n) places.
    changed
        Changes places a little.
    counts
        As ``ROUNDS``, ``CHANGED`` and ``WORST``.
    shrink
        Ratio of the step of a round to the step before.
    climbs
        Number of searches that begin at the same places, with different seeds.
    """

    first: FloatArray
    judged: Callable[[FloatArray], EachRun]
    changed: _Changed
    counts: tuple[int, int, int]
    shrink: float = _SHRINK
    climbs: int = 1

    def found(self) -> tuple[EachRun, int]:
        """Return the worst runs that were found, and the number of runs tried."""
        begun = self.judged(self.first)
        climbed = [self._climbed(begun, REPEAT_SEED + k) for k in range(self.climbs)]
        rounds, count, _ = self.counts
        return EachRun.joined(climbed), len(self.first) + self.climbs * rounds * count

    def _climbed(self, begun: EachRun, seed: int) -> EachRun:
        rounds, count, kept_count = self.counts
        random, step = np.random.default_rng(seed), _FIRST
        places, runs = self.first, begun
        for _ in range(rounds):
            worst_indices = _worst_indices(runs, kept_count)
            places, runs = places[worst_indices], runs.taken(worst_indices)
            changed_places = self.changed(
                places[random.integers(0, len(places), count)], step, random
            )
            runs = EachRun.joined([runs, self.judged(changed_places)])
            places = np.concatenate([places, changed_places])
            step *= self.shrink
        return runs


def with_worst_day(plan: Plan, spec: Spec, verdict: Verdict) -> Verdict:
    """Return a verdict in which the worst searched day replaces each result that it worsens.

    The verdict is returned unchanged if days cannot be searched because nothing varies from day to
    day or the job is too long.
    """
    machine = plan.machine
    if machine.without_dynamics:
        return verdict
    together = kind_of(machine).together(machine) and bool(machine.motors)
    search = _days_together(plan, spec) if together else _serial_days(plan, spec)
    return verdict if search is None else _with_found(plan, verdict, search, machines=False)


def with_worst_machine(
    plan: Plan, spec: Spec, verdict: Verdict, known: Sequence[FloatArray]
) -> Verdict:
    """Return a verdict in which the worst searched machine and day replaces each worsened result.

    The search changes the numbers of the machine within their tolerances and the numbers of the day
    together. It shares no step with the search of ``over_tolerances``, which goes from corner to
    corner. Machines are simulated side by side only if their dead times are equal, so the search
    begins with a few dead times and changes none. The worst machine must leave the share
    ``LEFT_FREE`` of every limit free.

    Parameters
    ----------
    known
        (n,) parts of the worst known machines, with which the search begins.

    Returns
    -------
    Verdict
        The verdict unchanged for machines that are simulated one by one, for windings and for long
        jobs.
    """
    machine = plan.machine
    count = CLIMBS * ROUNDS_OF_MACHINES * CHANGED + 4 * (1 + len(known)) * REPEATED_RUNS
    if (
        not machine.motors
        or product_of(plan) is not None
        or _too_long(plan, count, _MOST_OF_MACHINES)
    ):
        return verdict
    numbers = uncertain(machine)
    ends = np.array([number.farthest for number in numbers])
    delays = [any(path.endswith(".delay") for path in number.numbers) for number in numbers]
    dead_times, free_numbers = np.flatnonzero(delays), np.flatnonzero(np.logical_not(delays))
    number_count, judge = len(numbers), RunsJudge(plan, spec.with_margin(LEFT_FREE))

    def judged(places: FloatArray) -> EachRun:
        days = days_at(places[:, number_count:])
        machine_numbers = numbers_at(machine, places[:, :number_count] * ends)
        return judge.judged(on_own_days(machine, machine_numbers, days), days.phases)

    def changed(places: FloatArray, step: float, random: np.random.Generator) -> FloatArray:
        moved_places = _moved_day(places, step, random)
        parts = places[:, :number_count].copy()
        free_parts = parts[:, free_numbers]
        to_an_end = random.random(free_parts.shape) < _TO_AN_END
        stepped = np.clip(
            free_parts + 2.0 * step * random.standard_normal(free_parts.shape), -1.0, 1.0
        )
        is_changed = random.random(free_parts.shape) < _MOVED / max(len(free_numbers), 1)
        moved_parts = np.where(to_an_end, random.choice((-1.0, 1.0), free_parts.shape), stepped)
        parts[:, free_numbers] = np.where(is_changed, moved_parts, free_parts)
        return np.concatenate([parts, moved_places[:, number_count:]], axis=1)

    known_parts = np.stack(
        [np.zeros(number_count), *(parts[:number_count] / ends for parts in known)]
    )
    machines = np.unique(
        np.concatenate([known_parts, *(_held_at(known_parts, dead_times, at) for at in _DEAD)]),
        axis=0,
    )
    days = places_of_days(_drawn(plan, REPEATED_RUNS))
    first = np.concatenate(
        [np.repeat(machines, len(days), axis=0), np.tile(days, (len(machines), 1))], axis=1
    )
    search = _Search(
        first=first,
        judged=judged,
        changed=changed,
        counts=(ROUNDS_OF_MACHINES, CHANGED, WORST),
        shrink=_SHRINK_OF_MACHINES,
        climbs=CLIMBS,
    )
    return _with_found(plan, verdict, search, machines=True)


def _held_at(places: FloatArray, held: IntArray, at: float) -> FloatArray:
    """Return places of machines with all dead times at the part ``at`` of their tolerances."""
    held_places = places.copy()
    held_places[:, held] = at
    return held_places


def _days_together(plan: Plan, spec: Spec) -> _Search | None:
    machine = plan.machine
    if _too_long(plan, MOST_RUNS + ROUNDS * CHANGED):
        return None
    drawn = _drawn(plan, MOST_RUNS)
    if not varied_numbers(machine, drawn):
        return None
    judge = RunsJudge(plan, spec)

    def judged(places: FloatArray) -> EachRun:
        days = days_at(places)
        return judge.judged(varied_numbers(machine, days), days.phases)

    return _Search(
        first=places_of_days(drawn),
        judged=judged,
        changed=_moved_day,
        counts=(ROUNDS, CHANGED, WORST),
    )


def _serial_days(plan: Plan, spec: Spec) -> _Search | None:
    """Return the search for a machine whose days are simulated one by one, with few days."""
    if _too_long(plan, REPEATED_RUNS + ROUNDS_SERIAL * CHANGED_SERIAL):
        return None
    machine, commands, judge = plan.machine, plan.commands, Judge(plan, spec)
    kind = kind_of(machine)
    ranges = kind.ranges_of_days(commands)

    def judged(places: FloatArray) -> EachRun:
        results = []
        for place in places:
            try:
                results += [judge.each(run) for run in kind.on_days(commands, machine, place[None])]
            except (MachineError, RecordingError):
                results.append(judge.each(kind.simulate(commands, machine)).without_answer())
        return EachRun.joined(results)

    random = np.random.default_rng(REPEAT_SEED)
    corner_count = min(2**ranges, REPEATED_RUNS)
    corners = (np.arange(corner_count)[:, None] >> np.arange(ranges)) & 1
    if 2**ranges > corner_count:
        corners = random.integers(0, 2, (corner_count, ranges))
    return _Search(
        first=corners.astype(np.float64),
        judged=judged,
        changed=_moved_day,
        counts=(ROUNDS_SERIAL, CHANGED_SERIAL, WORST_SERIAL),
    )


def _with_found(plan: Plan, verdict: Verdict, search: _Search, *, machines: bool) -> Verdict:
    worst_runs, tried_count = search.found()
    text = _MACHINE_BY_SEARCH if machines else _BY_SEARCH
    with_day = with_other_machines(verdict, worst_runs, text)
    results = with_lines(with_day.results, plan)
    shares, names = shares_of(worst_runs)
    worst_run = int(np.argmax(np.minimum(shares, 1e9)))
    row = next((row for row in worst_runs.rows if row.text == names[worst_run]), None)
    has_limit = row is not None and bool(row.limit) and np.isfinite(shares[worst_run])
    free_share = LEFT_FREE if machines and row is not None and not row.hard else 0.0
    unanswered_count = int(unanswered_in(worst_runs).sum())
    if unanswered_count:
        results = (*results, unanswered(worst_runs.runs, [_NEVER_ENDS] * unanswered_count))
    days = SearchedDays(
        searched=tried_count,
        criterion=names[worst_run],
        share=float(shares[worst_run]) * (1.0 - free_share) if has_limit else None,
        machines=machines,
    )
    return replace(with_day, results=tuple(results), days=days)


def _moved_day(places: FloatArray, step: float, random: np.random.Generator) -> FloatArray:
    """Return the places moved at random by about ``step`` of each range, folded into 0 to 1."""
    moved = places + step * random.standard_normal(places.shape)
    return np.asarray(1.0 - np.abs(1.0 - np.mod(moved, 2.0)))


def _drawn(plan: Plan, count: int) -> Days:
    return drawn_days(count, len(plan.axes), np.random.default_rng(REPEAT_SEED))


def _too_long(plan: Plan, runs: int, most: float = _MOST_SAMPLES) -> bool:
    ticks = (plan.commands.tick_count() or 0) * runs
    return ticks * (1 if product_of(plan) is None else _REPLAYED) > most


def _worst_indices(found: EachRun, count: int) -> IntArray:
    """Return the numbers of the ``count`` worst runs, the worst first."""
    shares, _ = shares_of(found)
    return np.asarray(np.argsort(-shares, kind="stable")[:count])
