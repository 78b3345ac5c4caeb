"""The fastest plan of a job over all choices of a plan of ``optimal``.

``choices`` proposes the next plan to try; this module makes, judges and keeps each plan. A plan
that is no shorter than the best one is not simulated. If a plan is out of specification only at
single corners, these corners get a smaller tolerance, one after the other, and the other corners
keep their full tolerance.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from threadline.base.option_defaults import OPTIMAL_FEED_FORWARD
from threadline.base.progress import never_back
from threadline.commands.plan import Plan
from threadline.errors import LimitError
from threadline.jobs.operations import Feed, FeedMode
from threadline.motion.path import programmed_path
from threadline.proof.option_words import Reserve, parse_width_s
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job, try_plan
from threadline.search.allowance import LIMITS, Candidate, FastestJob, candidate_of
from threadline.search.choices import (
    BUDGET,
    LIMIT_SHARE,
    Knob,
    Tried,
    best_of,
    boldest,
    budget_m,
    chosen,
    improved,
    knobs_of,
    narrowed,
    places_of,
    used_of,
)
from threadline.search.deadline import HaltError, until_deadline
from threadline.search.feed import feed_range_m_s
from threadline.search.feed_ranges import closeness
from threadline.search.least_times import Bound, bounds_of, least_on_any_path
from threadline.search.paced import Question, beyond
from threadline.verdict import Verdict

_CONFIRMED = 200  # number of runs that a plan must pass to become the best plan so far
_MOST_NARROWED = 6
_ALL_TICKS = 150_000  # largest sum of the ticks of all further plans of a search
PROCESSOR_S = 600.0
"""Processor time in s after which a search without ``--within`` ends, if it has an answer."""
BOLD: Mapping[str, float] = {
    "tolerance": 0.8, "outside": 1.0, "volts": 0.9, "current": 0.7, "contour": 0.6,
    "smoothing": 0.57, LIMIT_SHARE: 0.8,
}  # fmt: skip
"""Places of the knobs in the first plan, which is the boldest one."""


@dataclass
class Choosing:
    """A search over all choices of a job's plans.

    Parameters
    ----------
    question
        The question.
    knobs
        The choices.
    options
        Options of the plans without the choices.
    most, tried
        Largest number of places that the search tries, and number that it has tried.
    candidates
        Every judged plan, and every plan beyond a limit of the machine, in order.
    begun_s, started_s
        Processor time and clock at the beginning.
    narrower
        Shares of the tolerance at single corners of the best plan, by line.
    """

    question: Question
    knobs: tuple[Knob, ...]
    options: Options
    most: int
    candidates: list[Candidate] = field(default_factory=list)
    narrower: dict[int, float] = field(default_factory=dict)
    tried: int = 0
    begun_s: float = field(default_factory=time.process_time)
    started_s: float = field(default_factory=time.monotonic)

    @property
    def best_s(self) -> float:
        """Duration of the shortest plan in specification."""
        return min((one.duration_s for one in self.candidates if one.duration_s), default=math.inf)

    def attempt(self, places: tuple[float, ...], below_s: float) -> Tried:
        """Plan and judge; lower the tolerance at single corners whose error is above its limit.

        ``below_s`` is a duration, s; a plan that takes longer is not judged.

        Raises
        ------
        LimitError
            If the plan leaves the travel of an axis.
        HaltError
            If the time of the search is over.
        """
        options = chosen(self.options, self.knobs, places, self.narrower)
        self.tried += 1
        used: dict[str, float] = {}
        first_duration_s: float | None = None
        previous_budget_used = math.inf
        for mend_count in range(_MOST_NARROWED):
            try:
                plan = self._planned(options)
            except LimitError as error:
                if error.quantity == "travel":
                    raise
                self._tried(options, beyond(error, self.question.machine), None)
                return Tried(places=places, duration_s=first_duration_s, used=used, passed=False)
            first_duration_s = plan.duration_s if first_duration_s is None else first_duration_s
            if plan.duration_s >= below_s:
                break
            verdict = self._judged(plan)
            plan_used = used_of(verdict)
            used = used if mend_count else plan_used
            self._tried(options, verdict, plan.duration_s)
            if verdict.passed:
                self.narrower = {
                    line: width / options.tolerance_m for line, width in options.narrow
                }
                places = places_of(options, self.knobs, self.question.machine)
                return Tried(places=places, duration_s=plan.duration_s, used=plan_used, passed=True)
            mended = None
            if "narrow" in self.question.free and plan_used.get(BUDGET, 0.0) < previous_budget_used:
                mended = narrowed(options, verdict, self._lines, plan.duration_s)
            previous_budget_used = plan_used.get(BUDGET, 0.0)
            if mended is None:
                break
            options = mended
        return Tried(places=places, duration_s=first_duration_s, used=used, passed=False)

    @cached_property
    def _lines(self) -> list[int]:
        """Lines of the job's moves, in increasing order."""
        programmed = programmed_path(self.question.job, self.question.machine, at_limits=True)
        return sorted({line for block in programmed for line in block.line.tolist()})

    def _planned(self, options: Options) -> Plan:
        question = self.question
        if question.until is not None:
            question.until.check()
        end_s = math.inf if question.until is None else question.until.end_s
        if math.isinf(end_s):
            spent_share = (time.process_time() - self.begun_s) / PROCESSOR_S
        else:
            spent_share = (time.monotonic() - self.started_s) / max(end_s - self.started_s, 1e-3)
        if math.isinf(end_s) and spent_share >= 1.0 and math.isfinite(self.best_s):
            if question.until is not None:
                question.until.ended = f"after {PROCESSOR_S / 60.0:g} min of processor time"
            raise HaltError
        if question.progress is not None:
            question.progress("proving", min(max(self.tried / self.most, spent_share), 1.0))
        return plan_job(question.job, question.machine, options)

    def _judged(self, plan: Plan) -> Verdict:
        """Judge a plan; one that passes the requested runs must also pass more runs, and a search.

        A plan that passes is judged by ``_CONFIRMED`` runs, and then by a search for a failing
        run.
        """
        question = self.question
        verdict = question.judged(plan)
        if not verdict.passed or not 1 < question.trials.repeats < _CONFIRMED:
            return verdict
        more_trials = replace(question.trials.without_others, repeats=_CONFIRMED)
        confirmed = try_plan(plan, question.spec, more_trials, question.actual).verdict
        return question.searched(plan, verdict) if confirmed.passed else confirmed

    def _tried(self, options: Options, verdict: Verdict, duration_s: float | None) -> None:
        feed = options.feed
        assert feed is not None
        contour = options.follows_contour and not self.question.machine.takes_positions
        candidate = candidate_of(options, feed.value, verdict, duration_s, contour)
        self.candidates.append(replace(candidate, options=options))


def fastest_chosen(question: Question) -> FastestJob:
    """Return the fastest plan in spec over all options of ``optimal`` that were not given.

    Plans use the full limits of acceleration and jerk. Only if no such plan is in specification,
    the search also chooses the share of these limits.
    """
    question = replace(question, progress=never_back(question.progress))
    machine, until = question.machine, question.until
    top_feed_m_s = feed_range_m_s(machine)[1] if question.high is None else question.high
    options = replace(question.options, feed=Feed(FeedMode.FASTEST_AXIS, top_feed_m_s))
    tick_s = float(machine.tick_clock.period_s)
    searches: list[Choosing] = []
    with until_deadline(until, lambda: any(one.candidates for one in searches)):
        for one, limits_too in _with_limits(options, question):
            knobs = knobs_of(machine, question.spec, one, question.free, limits_too=limits_too)
            effort = question.effort
            search = Choosing(question, knobs, one, effort.steps + effort.most_plans)
            searches.append(search)
            careful = places_of(one, knobs, machine)
            if limits_too:
                careful = tuple(
                    0.0 if knob.word == LIMIT_SHARE else place
                    for knob, place in zip(knobs, careful, strict=True)
                )
            bold = tuple(BOLD[knob.word] for knob in knobs)
            tried = boldest(search.attempt, careful, bold, effort.steps)
            if best_of(tried) is None:
                continue
            ticks = max(search.best_s / tick_s, 1.0)
            more_plans = int(min(max(_ALL_TICKS / ticks, effort.least_plans), effort.most_plans))
            search.most = search.tried + more_plans
            improved(search.attempt, tried, more_plans, tick_s, careful)
            break
    candidates = [candidate for search in searches for candidate in search.candidates]
    passed = [candidate for candidate in candidates if candidate.duration_s is not None]
    if passed:
        best = min(passed, key=lambda candidate: candidate.duration_s or math.inf)
        best = replace(best, found=replace(best.found, limited_by=_limited_by(candidates)))
    else:
        best = min(candidates, key=lambda candidate: closeness(candidate.found.verdict))
    return FastestJob(
        best=best,
        candidates=tuple(candidates),
        bounds=_bounds(question, best.options or options),
        left=_left(searches[-1]) if until is not None and until.ended else 0,
        ended="" if until is None else until.ended,
    )


def _left(search: Choosing) -> int:
    """Return the number of untried places, with the place at which the search was interrupted."""
    return max(search.most - search.tried + 1, 0)


def _with_limits(options: Options, question: Question) -> Iterator[tuple[Options, bool]]:
    """Yield the options of each search, and whether it also varies the share of the limits."""
    for limits_too in (False, True):
        for one in _followings(options, question):
            yield one, limits_too


def _followings(options: Options, question: Question) -> Iterator[Options]:
    """Yield the options with feed-forward, if possible, and then the options as given.

    Feed-forward comes first, because it makes the loads follow the motion more closely.
    """
    able = not question.machine.takes_positions and options.timing.shaper is None
    if options.feed_forward_s is None and "feed_forward" in question.free and able:
        yield replace(options, feed_forward_s=parse_width_s(OPTIMAL_FEED_FORWARD))
    yield options


def _limited_by(candidates: Sequence[Candidate]) -> str:
    """Return the criterion that failed most often in plans shorter than the best."""
    failed = [
        candidate.found.limited_by for candidate in candidates if candidate.duration_s is None
    ]
    return max(sorted(set(failed)), key=failed.count, default=LIMITS) if failed else LIMITS


def _bounds(question: Question, options: Options) -> tuple[Bound, ...]:
    """Return the least times along the path of a plan, and along any path in specification."""
    without_reserve = replace(options, reserve=Reserve(0.0, 0.0))
    bounds = bounds_of(question.job, question.machine, without_reserve)
    within_m = budget_m(question.spec)
    if within_m is None:
        return bounds
    return (*bounds, *least_on_any_path(question.job, question.machine, options, within_m))
