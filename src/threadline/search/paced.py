"""The question of every search for the fastest, and the search over a pace.

Searches over a feed, a needle speed and a shaft speed differ only in the plan at a pace: ``Paced``
describes it, and ``fastest_paced`` searches.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from pathlib import Path

from threadline.base.progress import Progress, TrialShares
from threadline.commands.plan import Plan
from threadline.errors import LimitError
from threadline.jobs.operations import FeedMode, Job
from threadline.machine import Machine
from threadline.proof.option_form import Word
from threadline.proof.options import Options
from threadline.proof.over_tolerances import Suspects
from threadline.proof.pipeline import NOMINAL, Trials, try_plan
from threadline.proof.worst_day import with_worst_day, with_worst_machine
from threadline.search.deadline import Deadline, until_deadline
from threadline.search.fastest import FINE, Fastest, Grid, check_range, find_fastest
from threadline.search.feed_ranges import used
from threadline.search.learn import learned_verdict
from threadline.search.searched_edges import with_searched_edges
from threadline.verdict import Result, Spec, Status, Verdict
from threadline.verdict.types import REPEATED_RUNS


@dataclass(frozen=True, slots=True, kw_only=True)
class Effort:
    """The effort of a search for the fastest. Less effort takes less time, and may miss the answer.

    Parameters
    ----------
    shares
        Shares of the limits that are tried first, the largest first. Shares around the best of
        several follow.
    finest
        No grid of a search by pace has more feeds than this one; None: no grid is limited.
    command_shares
        With a band of modes: shares of the limit of the ringing that a single command may use; the
        rest is for the ringing of earlier moves.
    steps
        Number of plans of ``optimal`` between the careful and the bold end of its choices.
    least_plans, most_plans
        Least and largest number of further plans of ``optimal``.
    """

    shares: tuple[float, ...] = (1.0, 0.5, 0.25, 0.125, 0.0625, 0.03125)
    finest: Grid | None = None
    command_shares: tuple[float, ...] = (1.0, 0.9, 0.8, 0.65, 0.5)
    steps: int = 6
    least_plans: int = 12
    most_plans: int = 240


FULL = Effort()
"""Effort of a search whose answer is printed."""
_EFFORT: ContextVar[Effort] = ContextVar("effort", default=FULL)


@contextmanager
def searching_with(effort: Effort) -> Iterator[None]:
    """Give this effort to every question that is asked inside the block and names none."""
    token = _EFFORT.set(effort)
    try:
        yield
    finally:
        _EFFORT.reset(token)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Question:
    """The question of a search for the fastest.

    Parameters
    ----------
    job, machine, spec, options
        The job, the machine that it is planned for, the specification, and the planning options.
    actual
        The machine that runs the plan, where it differs from ``machine``.
    trials
        Runs on which every verdict is based.
    low, high
        Ends of the search, in the unit of the search; None for its own ends.
    by
        Feed mode of a feed search; None where the job decides it.
    until, progress
        Deadline of the search, and the callback for its progress.
    margin
        Share of every limit that ``spec`` already keeps free.
    band
        Half width of a band of modes, as a share of their frequency; a cycle must be in spec all
        over it. None for no band.
    mismatch
        Whether to repeat the search on machines at the ends of the tolerances.
    words
        Planning options of the same plan, by word, without the options that the search finds.
    free
        Options of ``optimal`` that were not given, so that the search may choose them.
    learned
        Number of repeats after which the learned table of a plan is judged; None: the plan itself
        is judged.
    suspects
        Machines within the tolerances that were out of specification at another pace: they are
        tried first. The search adds to them.
    effort
        Number of feeds, shares of the limits and plans that the search tries.
    """

    job: Job
    machine: Machine
    spec: Spec
    options: Options = field(default_factory=Options)
    actual: Machine | None = None
    trials: Trials = NOMINAL
    low: float | None = None
    high: float | None = None
    by: FeedMode | None = None
    until: Deadline | None = None
    progress: Progress | None = None
    margin: float = 0.0
    band: float | None = None
    mismatch: bool = False
    words: Mapping[str, Word] = field(default_factory=dict)
    free: frozenset[str] = frozenset()
    learned: int | None = None
    suspects: Suspects = field(default_factory=list)
    effort: Effort = field(default_factory=_EFFORT.get)

    @property
    def file(self) -> Path:
        """The file of the job."""
        return Path(self.job.file)

    def judged(self, plan: Plan, progress: Progress | None = None) -> Verdict:
        """Return the verdict on a plan, or on the tables learned from it.

        ``progress`` receives the share of the runs that are read.
        """
        if self.learned is not None:
            return learned_verdict(plan, self.spec, self.learned, self.trials, self.actual)
        return try_plan(
            plan, self.spec, self.trials, self.actual, self.suspects, progress=progress
        ).verdict

    @property
    def searches(self) -> bool:
        """Whether ``searched`` looks for a failing run, so that it may change a verdict."""
        alone = self.actual is None and self.learned is None
        return alone and self.trials.repeats >= REPEATED_RUNS

    def searched(self, plan: Plan, verdict: Verdict) -> Verdict:
        """Return the verdict on a plan that may be the answer, after a search for a failing run.

        A *day* is one choice of encoder phases, friction and supply. For a verdict over the
        tolerances, machine and day are searched together if the worst known machine is close to a
        limit. Otherwise only the day is searched, if the verdict is near a limit. If a run of the
        search is out of specification, the verdict on that run is returned. If none is, the given
        verdict is returned with the worst run of the search; its results are still those of
        ``prove``. Verdicts below the level *repeated*, on another machine, or on learned tables are
        returned unchanged.
        """
        if not (verdict.passed and self.searches):
            return verdict
        tried_verdict, tolerances = verdict, verdict.tolerances
        if tolerances is not None and (tolerances.share is None or tolerances.share >= _CLOSE):
            tried_verdict = with_worst_machine(plan, self.spec, verdict, self.suspects)
        if tried_verdict.days is None and verdict.near:
            tried_verdict = with_worst_day(plan, self.spec, verdict)
        return replace(verdict, days=tried_verdict.days) if tried_verdict.passed else tried_verdict


_CLOSE = 0.85
"""Used share of a limit from which on an untried machine may exceed it, because searches with
different seeds differ by up to 6 %."""
_UNITS = {"current_peak": "A", "swing": ""}
_PER = {"travel": "", "velocity": "/s", "acceleration": "/s^2", "jerk": "/s^3"}


def beyond(error: LimitError, machine: Machine) -> Verdict:
    """Return the verdict on a plan that breaks a limit: the limit's criterion is failed."""
    is_travel = error.quantity == "travel"
    length_unit = "rad" if machine.axes[error.axis].kind == "rotary" else "m"
    if error.quantity in _PER:
        unit = f"{length_unit}{_PER[error.quantity]}"
    else:
        unit = _UNITS[error.quantity]
    result = Result(
        name=error.quantity,
        axis=error.axis,
        measured=abs(error.value_si - error.limit_si) if is_travel else _known(error.value_si),
        limit=0.0 if is_travel else error.limit_si,
        unit=unit,
        status=Status.FAILED,
        note="the plan is refused",
    )
    return Verdict(results=(result,), simulated=False)


def _known(value_si: float) -> float | None:
    """Return the size of a value; None where no finite value is enough."""
    return abs(value_si) if math.isfinite(value_si) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Paced:
    """The work of a job at a pace.

    Parameters
    ----------
    low, high, unit
        Default ends of the search, and their unit.
    planned_at
        Plans the job at a pace: one function, or one for each stretch that stands for the job.
    is_verdict
        Takes the error of a plan that breaks a limit; returns whether the pace is out of spec. If
        not, the error is raised.
    judged
        Judges the plan at a pace; None: ``Question.judged`` judges it.
    searched
        Takes a pace and its verdict, and returns the verdict after a search for a bad run. Every
        end of an interval must pass it. None: no search.
    """

    low: float
    high: float
    unit: str
    planned_at: Sequence[Callable[[float], Plan]]
    is_verdict: Callable[[LimitError], bool] = lambda _: False
    judged: Callable[[float, Plan], Verdict] | None = None
    searched: Callable[[float, Verdict], Verdict] | None = None


def fastest_paced(
    question: Question, paced: Paced, grid: Grid = FINE, seen: dict[float, Verdict] | None = None
) -> Fastest:
    """Return every interval of a pace at which a job stays in spec.

    Parameters
    ----------
    grid
        Resolution of the search, at most the finest of ``Question.effort``.
    seen
        As in ``find_fastest``.

    Raises
    ------
    OptionError
        If the range is empty.
    HaltError
        If the time is over before a pace was judged.
    """
    stretches = list(paced.planned_at)
    trials = TrialShares(question.progress, "searching", 0.0)

    def judged_at(planned_at: Callable[[float], Plan], pace: float, stretches_read: int) -> Verdict:
        try:
            plan = planned_at(pace)
        except LimitError as error:
            if not paced.is_verdict(error):
                raise
            return beyond(error, question.machine)
        if paced.judged is not None:
            return paced.judged(pace, plan)
        if question.progress is None:
            return question.judged(plan)
        return question.judged(
            plan, lambda _, read: trials.within((stretches_read + read) / len(stretches))
        )

    def judged(pace: float) -> Verdict:
        verdicts = []
        for stretch_index, planned_at in enumerate(stretches):
            verdict = judged_at(planned_at, pace, stretch_index)
            if not verdict.passed:
                # A stretch that fails at one pace most likely fails at the next, so it goes first.
                stretches.insert(0, stretches.pop(stretch_index))
                return verdict
            verdicts.append(verdict)
        return _worst_of_stretches(verdicts)

    low = paced.low if question.low is None else question.low
    high = paced.high if question.high is None else question.high
    check_range(low, high, paced.unit)
    seen = {} if seen is None else seen
    grid = grid.at_most(question.effort.finest)
    found_range = find_fastest(
        judged, low, high, grid, trials=trials, until=question.until, seen=seen
    )
    if paced.searched is None or not (found_range.complete and question.searches):
        return found_range
    answer = [found_range]
    with until_deadline(question.until, lambda: answer):
        answer[0] = with_searched_edges(
            found_range,
            lambda pace: seen[pace] if pace in seen else judged(pace),
            paced.searched,
            until=question.until,
        )
    return answer[0]


def _worst_of_stretches(passed: Sequence[Verdict]) -> Verdict:
    """Return one verdict over all stretches of a job that passes: the worst result of each row.

    Stretches with the same criteria and axes have the same rows. A stretch that is judged without
    ends of travel has other rows; then the verdict of the stretch closest to a limit is returned.
    """
    if len(passed) == 1:
        return passed[0]
    closest = max(passed, key=used)
    if len({tuple(row.name for row in verdict.results) for verdict in passed}) > 1:
        return closest
    rows = zip(*(verdict.results for verdict in passed), strict=True)
    worst = (
        max(row, key=lambda result: (result.measured is not None, result.severity)) for row in rows
    )
    return replace(closest, results=tuple(worst))
