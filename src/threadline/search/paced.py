"""What every search for the fastest is asked, and the one search over a pace.

A feed, a needle speed and the speed of a shaft differ in how a pace makes a plan, and in nothing
else: ``Paced`` says that, and ``fastest_paced`` searches.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from threadline.base.progress import Progress
from threadline.commands.plan import Plan
from threadline.errors import LimitError
from threadline.jobs.operations import FeedMode, Job
from threadline.machine import Machine
from threadline.proof.option_form import Word
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, Trials, try_plan
from threadline.search.fastest import FINE, Fastest, Grid, check_range, find_fastest
from threadline.search.forbidden import used
from threadline.search.until import Until
from threadline.verdict import Result, Spec, Status, Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Question:
    """What is asked of a search for the fastest.

    Parameters
    ----------
    job, machine, spec, options
        The job, the machine that it is planned for, what is asked, and how to plan.
    actual
        The machine that runs it, where it is another one.
    trials
        Which runs every verdict is made of.
    low, high
        Paces to search between, as the search counts them; None for its own ends.
    by
        What a feed is of; None where the job decides it.
    until, progress
        When the search has to come to an answer, and whom it tells how far it is.
    margin
        Share of every limit of ``spec`` that is kept free already.
    band
        Half width of a band of modes, as a share of their frequency, all over which a cycle is to
        be in spec, too; None for none.
    mismatch
        Whether to search on machines at the ends of the tolerances as well.
    words
        The options that plan the same, by word, without those that the search finds.
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
    until: Until | None = None
    progress: Progress | None = None
    margin: float = 0.0
    band: float | None = None
    mismatch: bool = False
    words: Mapping[str, Word] = field(default_factory=dict)

    @property
    def file(self) -> Path:
        """The file of the job."""
        return Path(self.job.file)

    def judged(self, plan: Plan) -> Verdict:
        """Return the verdict on a plan."""
        return try_plan(plan, self.spec, self.trials, self.actual).verdict


_PER = {"travel": "", "velocity": "/s", "acceleration": "/s^2", "jerk": "/s^3"}


def beyond(error: LimitError, machine: Machine) -> Verdict:
    """Return the verdict on a plan that breaks a limit: the criterion of that limit failed."""
    over = error.quantity == "travel"
    base = "rad" if machine.axes[error.axis].kind == "rotary" else "m"
    failed = Result(
        name=error.quantity,
        axis=error.axis,
        measured=abs(error.value_si - error.limit_si) if over else abs(error.value_si),
        limit=0.0 if over else error.limit_si,
        unit=f"{base}{_PER[error.quantity]}",
        status=Status.FAILED,
        note="the plan is refused",
    )
    return Verdict(results=(failed,), simulated=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Paced:
    """How a job is done at a pace.

    Parameters
    ----------
    low, high, unit
        Paces between which a search makes sense where no others are asked for, and their unit.
    planned_at
        Plan the job at a pace: one function, or one for each stretch that stands for the job.
    is_verdict
        Says of a plan that breaks a limit whether the pace is out of spec; else it is an error.
    judged
        Judges the plan at a pace where that takes more than ``Question.judged``.
    """

    low: float
    high: float
    unit: str
    planned_at: Sequence[Callable[[float], Plan]]
    is_verdict: Callable[[LimitError], bool] = lambda _: False
    judged: Callable[[float, Plan], Verdict] | None = None


def fastest_paced(
    asked: Question, paced: Paced, grid: Grid = FINE, seen: dict[float, Verdict] | None = None
) -> Fastest:
    """Return every interval of a pace at which a job stays in spec.

    Parameters
    ----------
    grid
        How closely to look; its steps are the resolution.
    seen
        As ``find_fastest`` takes it.

    Raises
    ------
    OptionError
        If the range is empty.
    HaltError
        If the time is over before a pace was judged.
    """
    stretches = list(paced.planned_at)

    def judged_at(planned_at: Callable[[float], Plan], pace: float) -> Verdict:
        try:
            plan = planned_at(pace)
        except LimitError as error:
            if not paced.is_verdict(error):
                raise
            return beyond(error, asked.machine)
        return asked.judged(plan) if paced.judged is None else paced.judged(pace, plan)

    def judged(pace: float) -> Verdict:
        passed = []
        for at, planned_at in enumerate(stretches):
            verdict = judged_at(planned_at, pace)
            if not verdict.passed:
                # What fails at one pace most likely fails at the next: it is judged first.
                stretches.insert(0, stretches.pop(at))
                return verdict
            passed.append(verdict)
        return _of_all(passed)

    low = paced.low if asked.low is None else asked.low
    high = paced.high if asked.high is None else asked.high
    check_range(low, high, paced.unit)
    return find_fastest(
        judged, low, high, grid, progress=asked.progress, until=asked.until, seen=seen
    )


def _of_all(passed: Sequence[Verdict]) -> Verdict:
    """Return one verdict over all stretches of a job, each of which passes: the worst of each row.

    Stretches have the same criteria and axes, hence the same rows; where one has others, since it
    is judged without ends of travel, the verdict is that of the stretch closest to a limit.
    """
    if len(passed) == 1:
        return passed[0]
    closest = max(passed, key=used)
    if len({tuple(row.name for row in verdict.results) for verdict in passed}) > 1:
        return closest
    rows = zip(*(verdict.results for verdict in passed), strict=True)
    worst = (max(row, key=lambda one: (one.measured is not None, one.severity)) for row in rows)
    return replace(closest, results=tuple(worst))
