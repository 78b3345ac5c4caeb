"""The level *over tolerances*: the worst machine that a search finds, and drawn machines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.progress import Progress
from threadline.base.workers import Done
from threadline.commands.plan import Plan
from threadline.errors import MachineError, RecordingError
from threadline.files import Recording
from threadline.machine import Machine
from threadline.machine.variants import drawn, variant
from threadline.machine.vary import REPEAT_SEED, Days, drawn_days
from threadline.proof.kinds.variants import UNANSWERED, unanswered
from threadline.proof.worst_machine import WithinTolerances, Worst, shares_of, unanswered_in
from threadline.proof.worst_search import WorstSearch
from threadline.verdict import Result, Spec, Status, Verdict, with_lines
from threadline.verdict.each_run import at_least, with_other_machines, worst_of
from threadline.verdict.types import REPEATED_RUNS, OverTolerances

if TYPE_CHECKING:
    from threadline.proof.worst_search import WorstSearch

VARIANT_SEED = 1994
_AT_ONCE_SERIAL = 20
_DOING = "searching the worst machine"
_OF_WORST = "the worst machine searched"
_MOST_SUSPECTS = 8

Judged = tuple[Verdict, tuple[Recording, ...]]
"""A verdict, and the recordings that were judged."""
RunsOf = Callable[[Machine, tuple[float, ...]], Judged]
"""Judges a machine, with its product at the given parts of the product's tolerances."""
Suspects = list[FloatArray]
"""(n,) parts of machines that were the worst of earlier plans; the most recent one first."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WorstCase:
    """A verdict over the tolerances, and the worst machine.

    Parameters
    ----------
    verdict
        Verdict with the worst result of each criterion over all judged machines.
    worst
        The worst machine that was found within the tolerances.
    judged
        Recordings of the worst machine's runs. In the verdict the numbers of these runs follow the
        numbers of the nominal machine's runs.
    """

    verdict: Verdict
    worst: Worst
    judged: tuple[Recording, ...] = ()


def over_tolerances(
    plan: Plan,
    spec: Spec,
    verdict: Verdict,
    machines: int,
    runs_of: RunsOf,
    progress: Progress | None = None,
    suspects: Suspects | None = None,
) -> WorstCase:
    """Judge the worst machine within the tolerances that a search finds, and drawn machines.

    Each machine is judged in one run, in which every encoder stands in the middle of a count at the
    start. The worst machine is then judged in as many runs as the machine of the file.

    Parameters
    ----------
    plan
        The plan, with the machine whose numbers vary.
    verdict
        The verdict on the machine of the plan.
    machines
        Number of machines to draw.
    runs_of
        Returns the verdict on another machine with its product, and its recordings.
    suspects
        Machines to try first, on several days. This function adds the worst machine to the list,
        and ends at the first machine that is out of specification. With None every machine is
        judged. A plan that passes with suspects also passes without.
    """
    from threadline.proof.worst_search import WorstSearch  # only this level needs it

    within = WithinTolerances(plan, spec, with_product=True)
    hasty = suspects is not None
    if suspects:
        suspects_search = WorstSearch(within, hasty=True)
        suspects_search.tried(np.stack(suspects))
        if suspects_search.failed or (
            within.together
            and not within.in_days(suspects_search.parts, _days(within)).passed.all()
        ):
            return _worst_case(within, suspects_search, verdict, runs_of, 0, suspects)
    search = WorstSearch(within, hasty=hasty)
    search.done = _counting(progress, len(within.singles) + search.most + machines)
    search.begin()
    drawn_count = 0
    at_once = _AT_ONCE_SERIAL if hasty and not within.together else machines
    while drawn_count < machines and not search.is_over:
        indices = np.arange(drawn_count, min(drawn_count + at_once, machines))
        search.draw(within.with_products(drawn(plan.machine, VARIANT_SEED, indices), indices))
        drawn_count += len(indices)
    search.go_on()
    return _worst_case(within, search, verdict, runs_of, drawn_count, suspects)


def _counting(progress: Progress | None, total: int) -> Done | None:
    if progress is None:
        return None
    judged_count = 0.0

    progress(_DOING, 0.0)

    def done(count: float) -> None:
        nonlocal judged_count
        judged_count += count
        progress(_DOING, min(judged_count / total, 1.0))

    return done


def _days(within: WithinTolerances) -> Days:
    """Return the days of the first runs of a verdict of the level *repeated*."""
    return drawn_days(REPEATED_RUNS, len(within.plan.axes), np.random.default_rng(REPEAT_SEED))


def _worst_case(
    within: WithinTolerances,
    search: WorstSearch,
    verdict: Verdict,
    runs_of: RunsOf,
    count: int,
    suspects: Suspects | None,
) -> WorstCase:
    worst_index = search.worst_of_days(_days(within))
    parts, results = search.parts[worst_index], search.found
    shares, names = shares_of(results.taken(np.array([worst_index])))
    worst = within.worst_at(parts, float(shares[0]), names[0])
    if suspects is not None:
        suspects[:] = [parts, *(suspect for suspect in suspects if (suspect != parts).any())][
            :_MOST_SUSPECTS
        ]
    try:
        worst_machine = variant(within.plan.machine, within.machine_parts(parts))
        worst_verdict, worst_recordings = runs_of(
            worst_machine, tuple(within.product(parts[None])[0].tolist())
        )
    except (MachineError, RecordingError):
        worst_verdict, worst_recordings = None, ()
    others = results.taken(np.flatnonzero(np.arange(results.runs) != worst_index))
    rows = [*with_lines(with_other_machines(verdict, others).results, within.plan)]
    unanswered_indices = np.flatnonzero(unanswered_in(results))
    if len(unanswered_indices):
        reasons = [within.why_not(search.parts[unanswered_indices[0]])] * len(unanswered_indices)
        rows.append(unanswered(results.runs, reasons))
    passed = int(results.taken(search.drawn).passed.sum())
    criterion, share = _closest(worst_verdict)
    tolerances = OverTolerances(
        searched=results.runs - count,
        criterion=criterion,
        share=share,
        drawn=count,
        passed=passed,
        least=at_least(passed, count),
    )
    over_verdict = replace(verdict, results=tuple(rows), machines=count, tolerances=tolerances)
    if worst_verdict is not None:
        over_verdict = worst_of(
            over_verdict, [(_OF_WORST, _numbered(worst_verdict, verdict.runs))], None
        )
    return WorstCase(verdict=over_verdict, worst=worst, judged=worst_recordings)


def _closest(verdict: Verdict | None) -> tuple[str, float | None]:
    """Return the failed, else the tightest, criterion of a verdict, and its used share."""
    if verdict is None:
        return UNANSWERED, None
    failed = [r for r in verdict.results if r.status is Status.FAILED]
    tightest = verdict.tightest
    if failed and (tightest is None or tightest.status is not Status.FAILED):
        return _text(failed[0]), None
    if tightest is None or tightest.measured is None or not tightest.limit:
        return "", None
    return _text(tightest), tightest.measured / tightest.limit


def _text(result: Result) -> str:
    return " ".join(filter(None, (result.name, result.axis, result.step)))


def _numbered(verdict: Verdict, before: int) -> Verdict:
    """Return a verdict whose run numbers follow the runs of the machine of the file."""
    results = [
        replace(r, run=before + (r.run or 1)) if r.of == "run" and r.time_s is not None else r
        for r in verdict.results
    ]
    return replace(verdict, results=tuple(results))
