"""The worst day of a machine that a search finds within what runs are drawn from.

``repeated`` draws days and says for what share of all days their worst holds. A search of plans
keeps the plan that passes by the least, so its answer needs more: a day that is looked for. The
days begin as drawn ones. Then the worst of all so far are changed a little, by steps that shrink
from round to round.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.option_defaults import MOST_RUNS
from threadline.commands.plan import Plan
from threadline.machine.vary import (
    FRICTION_OF_DAYS,
    REPEAT_SEED,
    SUPPLY_OF_DAYS,
    TENSION_OF_DAYS,
    Days,
    drawn_days,
    varied_numbers,
)
from threadline.proof.judge_runs import RunsJudge
from threadline.proof.kinds import kind_of
from threadline.proof.worst_machine import shares_of
from threadline.verdict import EachRun, Spec, Verdict, with_lines
from threadline.verdict.each_run import with_other_machines

ROUNDS, CHANGED, KEPT = 8, 256, 32
"""Rounds of changes, changed days of a round, and the worst days that they begin at."""
_FIRST, _SHRINK = 0.2, 0.6  # of each range: the first step, and the next of each
_MOST_SAMPLES = 5e7  # ticks times days: half a minute
_BY_SEARCH = "the worst day of a search"
_RANGES = np.array([FRICTION_OF_DAYS, SUPPLY_OF_DAYS, TENSION_OF_DAYS])


def with_worst_day(plan: Plan, spec: Spec, verdict: Verdict) -> Verdict:
    """Return a verdict with every result replaced by the worst of searched days, if it is worse.

    The verdict itself where days cannot be searched: machines that are simulated one by one, and
    long jobs.
    """
    machine = plan.machine
    days = MOST_RUNS + ROUNDS * CHANGED
    long = (plan.commands.tick_count() or 0) * days > _MOST_SAMPLES
    if long or not machine.motors or not kind_of(machine).together(machine):
        return verdict
    drawn = drawn_days(MOST_RUNS, len(plan.axes), np.random.default_rng(REPEAT_SEED))
    if not varied_numbers(machine, drawn):
        return verdict
    judge, random = RunsJudge(plan, spec), np.random.default_rng(REPEAT_SEED)
    places, step = _places(drawn), _FIRST
    found = _judged(judge, places)
    for _ in range(ROUNDS):
        worst = _worst(found, KEPT)
        places, found = places[worst], found.taken(worst)
        begun = random.integers(0, len(places), CHANGED)
        moved = places[begun] + step * random.standard_normal((CHANGED, places.shape[1]))
        moved = 1.0 - np.abs(1.0 - np.mod(moved, 2.0))  # folded back into 0 to 1
        found = EachRun.joined([found, _judged(judge, moved)])
        places = np.concatenate([places, moved])
        step *= _SHRINK
    with_day = with_other_machines(verdict, found, _BY_SEARCH)
    return replace(with_day, results=with_lines(with_day.results, plan))


def _worst(found: EachRun, count: int) -> IntArray:
    """Return the numbers of the ``count`` worst runs, the worst first."""
    shares, _ = shares_of(found)
    return np.asarray(np.argsort(-shares, kind="stable")[:count])


def _places(days: Days) -> FloatArray:
    """Return (days, 3 + axes) places of days between the ends of their ranges, 0 to 1."""
    factors = np.stack([days.friction, days.supply, days.tension], axis=1)
    within = (factors - _RANGES[:, 0]) / (_RANGES[:, 1] - _RANGES[:, 0])
    return np.concatenate([within, days.phases], axis=1)


def _judged(judge: RunsJudge, places: FloatArray) -> EachRun:
    factors = _RANGES[:, 0] + places[:, :3] * (_RANGES[:, 1] - _RANGES[:, 0])
    friction, supply, tension = factors.T
    days = Days(friction=friction, supply=supply, tension=tension, phases=places[:, 3:])
    return judge.judged(varied_numbers(judge.plan.machine, days), days.phases)
