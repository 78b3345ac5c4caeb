"""The search for the fastest way to do a job, chosen by the pace of the job.

The command line and ``import threadline as tl`` both ask a ``Question`` and get an ``Answer``; each
presents the answer in its own way.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from threadline.base.option_defaults import NO_CONTOUR, UNSHAPED_WORD
from threadline.commands.plan import Plan
from threadline.errors import PlanError
from threadline.jobs.operations import Feed, FeedMode
from threadline.motion.path.interpolations import OPTIMAL
from threadline.proof.option_form import Word
from threadline.proof.option_words import (
    feed_words,
    length_words,
    narrow_words,
    reserve_words,
    share_words,
    time_words,
    tolerance_words,
)
from threadline.proof.options import Options, options_of
from threadline.proof.pipeline import plan_job
from threadline.search.allowance import FastestJob, options_at
from threadline.search.cycle import FastestCycle, cycle_s, fastest_cycle
from threadline.search.cycle_robust import RobustCycle, robust_cycle
from threadline.search.deadline import with_answer
from threadline.search.fastest import COARSE, Fastest
from threadline.search.feed import fastest_feed, fastest_needle, feed_unit, search_range, sewn_at
from threadline.search.feed_ranges import Interval
from threadline.search.least_limits import fastest_job
from threadline.search.mismatch import (
    CYCLE,
    F_WORDS,
    FEED,
    NEEDLE,
    OVERRIDE,
    SHAFT,
    BestPace,
    Certainty,
    Mismatch,
    Searched,
    at_tolerance_ends,
    near_best,
)
from threadline.search.move_list import move_list
from threadline.search.paced import Question
from threadline.search.question import searched_as
from threadline.search.shaft import (
    FastestShaft,
    at_speed,
    constant_speeds,
    fastest_shaft,
    speed_range_hz,
)
from threadline.search.whole_jobs import planned_at
from threadline.verdict import Verdict


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Answer:
    """Result of a search of any kind.

    Parameters
    ----------
    question
        The question.
    best, unit
        The best pace or the shortest duration, and its unit; None where nothing is in spec.
    duration_s
        Duration of the job at the best pace; None where nothing is in spec, or it is not known.
    intervals
        All intervals in spec, the fastest first.
    limited_by
        Criterion that fails just beyond the best.
    verdict
        Verdict at the best pace, or at the trial that came closest.
    tried
        Number of plans that were tried.
    searched
        Name of the searched quantity.
    of
        The result of the search with every trial.
    words
        Planning options of the best plan; None where nothing is in spec, or where only a move list
        can state the plan.
    plan
        Function that makes the best plan; if nothing is in spec, the plan of the question's
        options.
    over_band
        The cycle for a band of modes; None without a band.
    certainty
        Speed lost by passing at the ends of the tolerances; None where this was not asked for.
    mismatch
        Results on machines at the ends of the tolerances; None where they were not asked for.
    """

    question: Question
    best: float | None
    unit: str
    duration_s: float | None
    intervals: tuple[Interval, ...]
    limited_by: str
    verdict: Verdict
    tried: int
    searched: Searched
    of: Any
    words: Mapping[str, Word] | None
    plan: Callable[[], Plan]
    over_band: RobustCycle | None = None
    certainty: Certainty | None = None
    mismatch: tuple[Mismatch, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether a plan is in spec and, with a band, on all machines of the band."""
        if self.over_band is not None:
            return self.over_band.job is not None
        return self.best is not None

    @property
    def ended(self) -> str:
        """Why the search stopped early; empty if it did not."""
        return "" if self.question.until is None else self.question.until.ended

    @property
    def again(self) -> dict[str, Any] | None:
        """Options with which ``prove`` makes the best plan, by word; None if there are none."""
        return (
            None
            if self.words is None or self.over_band is not None
            else {**self.question.words, **self.words}
        )


def job_words(found: FastestJob) -> dict[str, Word] | None:
    """Return the planning options of the best plan of a search by feed, or by allowance."""
    best = found.best
    if best.found.best is None:
        return None
    if best.options is not None:
        return optimal_words(best.options)
    words: dict[str, Word] = {"feed": feed_words(Feed(found.by, best.found.best))}
    if best.share != 1.0:
        words["limits"] = share_words(best.share)
    if best.contour_m is not None:
        endless = best.contour_m == float("inf")
        words["contour"] = NO_CONTOUR if endless else f"{best.contour_m!r} m"
    return words


def optimal_words(options: Options) -> dict[str, Word]:
    """Return the words with which ``options_of`` reads the options of a plan of ``optimal``."""
    assert options.feed is not None
    words: dict[str, Word] = {"feed": feed_words(options.feed)}
    words["tolerance"] = length_words(options.tolerance_m)
    if options.outside_m:
        words["outside"] = length_words(options.outside_m)
    if options.narrow:
        words["narrow"] = narrow_words(options.narrow)
    if options.reserve is not None:
        words["reserve"] = reserve_words(options.reserve)
    if options.feed_forward_s is not None:
        words["feed_forward"] = True
        words["smoothing"] = time_words(options.feed_forward_s)
    if options.contour_m is not None:
        endless = math.isinf(options.contour_m)
        words["contour"] = NO_CONTOUR if endless else length_words(options.contour_m)
    if options.limit_share != 1.0:
        words["limits"] = share_words(options.limit_share)
    return words


def shaft_words(found: FastestShaft) -> dict[str, Word] | None:
    """Return the option of a design's best plan: a tolerance of the swing, or a constant speed."""
    if found.duration_s is None:
        return None
    if found.by_schedule:
        return {"tolerance": tolerance_words(found.tolerance_m)}
    assert found.constant.best is not None
    return {"feed": feed_words(Feed(FeedMode.SHAFT, found.constant.best))}


def cycle_words(question: Question, found: FastestCycle) -> dict[str, Word] | None:
    """Return the planning option of the shortest cycle; None where it needs a move list.

    It needs one if the command of a move is not the command of its cylinder: moves of one cylinder
    have different shapers, levels or a wait of their own, or the list of the question has commands,
    which an option does not replace.
    """
    words = _shaper_of_each(found)
    if words is None:
        return None
    try:
        plan = plan_job(question.job, question.machine, options_of(**words))
    except PlanError:
        return None
    same = plan.commands.rows_sha256() == found.proof.plan.commands.rows_sha256()
    return words if same else None


def _shaper_of_each(found: FastestCycle) -> dict[str, Word] | None:
    if found.job is None:
        return None
    overlaps = cycle_s(found.base) < cycle_s(found.unshaped)
    by_axis: dict[str, set[str]] = {}
    for move in found.moves:
        by_axis.setdefault(move.axis, set()).add(move.how)
    one_each = all(len(how) == 1 for how in by_axis.values())
    if overlaps or not one_each or any(move.wait_s or " for " in move.how for move in found.moves):
        return None
    if all(how == {UNSHAPED_WORD} for how in by_axis.values()):
        return {}
    return {"shaper": ", ".join(f"{axis}={next(iter(how))}" for axis, how in by_axis.items())}


def best_move_list(found: Answer) -> str | None:
    """Return the move list of the shortest cycle, as text of a file for ``prove``.

    None if no cycle is in spec, or if the job is no move list.
    """
    question, cycle = found.question, found.of
    if not isinstance(cycle, FastestCycle):
        return None
    job = cycle.job if found.over_band is None else found.over_band.job
    if job is None:
        return None
    band_text = "" if question.band is None else f" for modes within {question.band * 100:g} %"
    return (
        f"# The shortest cycle of {question.file.name} in spec on {question.machine.name}"
        f"{band_text}, by threadline fastest.\n{move_list(job, question.machine)}"
    )


def _feed(question: Question) -> Answer:
    found = fastest_job(question)
    best, by = found.best, found.by

    def plan() -> Plan:
        if found.bounds:
            return plan_job(question.job, question.machine, options_at(question, best))
        if best.found.best is None:
            return plan_job(question.job, question.machine, question.options)
        return planned_at(replace(question, by=by), best.share, best.found.best)

    return Answer(
        question=question, best=best.found.best, unit=feed_unit(by), duration_s=best.duration_s,
        intervals=best.found.intervals, limited_by=best.found.limited_by,
        verdict=best.found.verdict, tried=sum(one.found.tried for one in found.candidates),
        searched={FeedMode.F_WORD: F_WORDS, FeedMode.OVERRIDE: OVERRIDE}.get(by, FEED),
        of=found, words=job_words(found), plan=plan,
    )  # fmt: skip


def _feed_again(question: Question, answer: Answer) -> Callable[[Question], BestPace]:
    found: FastestJob = answer.of
    nearby = near_best(
        question, answer.best, search_range(question.job, question.machine, found.by)[1]
    )
    options = replace(question.options, limit_share=found.best.share)
    return lambda other_question: speeds(
        fastest_feed(
            replace(other_question, by=found.by, options=options, low=nearby.low, high=nearby.high),
            COARSE,
        )
    )


def _needle(question: Question) -> Answer:
    found = fastest_needle(question)

    def plan() -> Plan:
        if found.best is None:
            return plan_job(question.job, question.machine, question.options)
        return sewn_at(question, found.best)

    return Answer(
        question=question, best=found.best, unit="stitch/s", duration_s=None,
        intervals=found.intervals,
        limited_by=found.limited_by, verdict=found.verdict, tried=found.tried, searched=NEEDLE,
        of=found, plan=plan,
        words=None if found.best is None else {"needle": f"{found.best!r} stitch/s"},
    )  # fmt: skip


_UNKNOWN_HZ = 100.0


def _needle_again(question: Question, answer: Answer) -> Callable[[Question], BestPace]:
    nearby = near_best(question, answer.best, _UNKNOWN_HZ)
    return lambda other_question: speeds(
        fastest_needle(replace(other_question, low=nearby.low, high=nearby.high), COARSE)
    )


def _shaft(question: Question) -> Answer:
    found = fastest_shaft(question)

    def plan() -> Plan:
        if found.schedule is not None and found.by_schedule:
            return found.schedule.plan
        if found.constant.best is None:
            return plan_job(question.job, question.machine, question.options)
        return at_speed(question, found.constant.best)

    return Answer(
        question=question, best=found.duration_s, unit="s", duration_s=found.duration_s,
        intervals=found.constant.intervals, limited_by=found.limited_by, verdict=found.verdict,
        tried=found.constant.tried, searched=SHAFT, of=found, words=shaft_words(found), plan=plan,
    )  # fmt: skip


def _shaft_again(question: Question, answer: Answer) -> Callable[[Question], BestPace]:
    nearby = near_best(question, answer.of.constant.best, speed_range_hz(question.machine)[1])
    return lambda other_question: speeds(
        constant_speeds(replace(other_question, low=nearby.low, high=nearby.high), COARSE)
    )


def _switchings(question: Question) -> Answer:
    found = fastest_cycle(question)
    robust = None if question.band is None else robust_cycle(question, question.band)
    best_s = found.cycle_s
    return Answer(
        question=question, best=best_s, unit="s", duration_s=best_s, intervals=_one_pace(best_s),
        limited_by=found.limited_by, verdict=found.proof.verdict, tried=found.tried,
        searched=CYCLE, of=found, words=cycle_words(question, found), over_band=robust,
        plan=lambda: found.proof.plan if robust is None else robust.proof.plan,
    )  # fmt: skip


def _switchings_again(_asked: Question, _answer: Answer) -> Callable[[Question], BestPace]:
    def again(other_question: Question) -> BestPace:
        found = fastest_cycle(other_question)
        return found.cycle_s, _one_pace(found.cycle_s), found.limited_by

    return again


def _one_pace(cycle_s: float | None) -> tuple[Interval, ...]:
    return () if cycle_s is None else (Interval(low=cycle_s, high=cycle_s),)


def speeds(found: Fastest) -> BestPace:
    """Return the result of a pace search in the form of a search on another machine."""
    return found.best, found.intervals, found.limited_by


@dataclass(frozen=True, slots=True, kw_only=True)
class Search:
    """The search for the fastest way to do jobs with one kind of pace.

    Parameters
    ----------
    find
        Answers a question.
    again
        Takes a question and its answer; returns the search on another machine that runs the plans.
    """

    find: Callable[[Question], Answer]
    again: Callable[[Question, Answer], Callable[[Question], BestPace]]


SEARCHES: Mapping[str, Search] = {
    "feed": Search(find=_feed, again=_feed_again),
    OPTIMAL: Search(find=_feed, again=_feed_again),
    "needle": Search(find=_needle, again=_needle_again),
    "shaft": Search(find=_shaft, again=_shaft_again),
    "switchings": Search(find=_switchings, again=_switchings_again),
}
"""Searches for the fastest way to do a job in spec, by the result of ``searched_as``."""


def answered(question: Question) -> Answer:
    """Answer a question, and run the searches on other machines that the question asks for.

    Raises
    ------
    OptionError
        If the question asks for the ends of the tolerances and no number has one, or if the time
        was over before a plan was judged.
    """
    search = SEARCHES[searched_as(question.job, question.options)]
    with with_answer():
        found = search.find(question)
        certainty = _certainty(found, search)
        mismatches: tuple[Mismatch, ...] = ()
        if question.mismatch:
            mismatches = at_tolerance_ends(question, search.again(question, found))
    return replace(found, certainty=certainty, mismatch=mismatches)


def _certainty(found: Answer, search: Search) -> Certainty | None:
    """Search again for the file's machine alone, and compare; None without tolerance ends."""
    question = found.question
    others = question.trials.others(question.actual or question.machine)
    if not others:
        return None
    options = question.options
    if options.robust_share is not None:
        options = replace(options, robust_share=0.0)
    file_answer = search.find(
        replace(question, options=options, trials=question.trials.without_others)
    )
    by_duration = found.duration_s is not None or file_answer.duration_s is not None
    sure_value, best_value = (
        one.duration_s if by_duration else one.best for one in (found, file_answer)
    )
    loss_share = None
    if sure_value is not None and best_value is not None:
        loss_share = sure_value / best_value - 1.0 if by_duration else 1.0 - sure_value / best_value
    return Certainty(
        machines=1 + sum(map(len, others.values())),
        sure=sure_value,
        alone=best_value,
        unit="s" if by_duration else found.unit,
        share=loss_share,
    )
