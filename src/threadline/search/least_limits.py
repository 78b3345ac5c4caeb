"""Search of feed and share of the limits together, and its state.

A loop that lags turns acceleration into error. A plan that uses the machine's full limits may have
to creep to stay in spec; a plan with a tenth of the limits may run at full feed. So feed and share
of the limits are searched together, and the shortest job wins.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace

from threadline.base.progress import Progress, TrialShares, never_back, part_of
from threadline.errors import LimitError
from threadline.jobs.operations import Feed, FeedMode, Job
from threadline.machine import Machine
from threadline.motion.path.interpolations import OPTIMAL
from threadline.motion.timing import Pace
from threadline.proof.option_words import LEAST_SHARE
from threadline.proof.options import Options
from threadline.proof.pipeline import check_loops, plan_job
from threadline.search.allowance import Candidate, FastestJob, fastest_allowed
from threadline.search.chosen_plans import fastest_chosen
from threadline.search.deadline import Deadline, HaltError, no_answer, until_deadline
from threadline.search.fastest import FINE, RANGE, Fastest, Grid, check_range
from threadline.search.feed import fastest_feed, feed_unit, search_range, searched_by
from threadline.search.paced import Question
from threadline.search.shortened_jobs import LongMoves, distinct_parts, moves_in
from threadline.search.whole_jobs import (
    in_one_run,
    in_order,
    judged_whole,
    planned_at,
    with_searched_best,
)
from threadline.verdict import Verdict
from threadline.winding.product import product_text

LONG_S = 300.0
"""Duration above which a job is long; for a long job, slow shares of the limits are skipped."""


@dataclass(slots=True, kw_only=True)
class Shares:
    """State of the search for each share of the limits.

    Parameters
    ----------
    searched
        Returns the feeds in spec with a share; takes the share, the grid of feeds, and the progress
        to report to.
    duration_s
        Returns the job's duration with a share at its best feed.
    at_top_s
        Returns the job's duration with a share at the highest feed of the range.
    expected
        Expected number of searches of one share.
    progress, until
        As in ``Question``.
    candidates, left_out
        Results by share; and skipped shares, with which the job takes at least as long as the best
        result so far, even at the highest feed.
    top_s
        The job's duration with the full limits at the highest feed; None until it is calculated.
    steps, progress_share
        Number of started searches, and last reported progress.
    """

    searched: Callable[[float, Grid, Progress | None], Fastest]
    duration_s: Callable[[float, Fastest], float | None]
    at_top_s: Callable[[float], float]
    expected: int
    progress: Progress | None
    until: Deadline | None
    candidates: dict[float, Candidate] = field(default_factory=dict)
    left_out: set[float] = field(default_factory=set)
    top_s: float | None = None
    steps: int = 0
    progress_share: float = 0.0

    def tried(self, share: float, grid: Grid) -> Candidate | None:
        """Return the result of a share, which is searched if unknown; None if the share is skipped.

        Raises
        ------
        HaltError
            If the time ends, or a user asks for the answer, after the result of this share is
            known.
        """
        if share in self.candidates and not grid.near:
            return self.candidates[share]
        report = self._telling(share)
        self.steps += 1
        if share in self.left_out or (share not in self.candidates and self._hopeless(share)):
            return None
        found = self.searched(share, grid, report)
        try:
            duration_s = self.duration_s(share, found)
        except KeyboardInterrupt as signal:
            # The answer needs the duration at the found feed, so one more plan is made after the
            # interrupt.
            if self.until is None or not self.until.interrupted(signal):
                raise
            duration_s = self.duration_s(share, found)
        self.candidates[share] = Candidate(share=share, found=found, duration_s=duration_s)
        if not found.complete or (self.until is not None and self.until.ended):
            raise HaltError
        return self.candidates[share]

    @property
    def long(self) -> bool:
        """Whether the job is long with the best result so far, or else at the highest feed."""
        if not self.candidates:
            if self.top_s is None:
                try:
                    self.top_s = self.at_top_s(1.0)
                except LimitError:  # the plan breaks a limit: its duration is unknown
                    self.top_s = 0.0
            return self.top_s > LONG_S
        return LONG_S < self._best_s < math.inf

    @property
    def _best_s(self) -> float:
        durations = (candidate.duration_s for candidate in self.candidates.values())
        return min((value for value in durations if value is not None), default=math.inf)

    def _telling(self, share: float) -> Progress | None:
        """Return the callback for the progress of one share's search."""
        if self.progress is None:
            return None
        progress, share_per_step = self.progress, 1.0 / max(self.expected, self.steps + 1)
        progress_before = self.steps * share_per_step

        def report(_: str, fraction: float) -> None:
            # If there are more searches than expected, each has a smaller share of the progress.
            self.progress_share = max(
                self.progress_share, progress_before + fraction * share_per_step
            )
            progress(f"limits {share:.0%}", self.progress_share)

        report("", 0.0)
        return report

    def _hopeless(self, share: float) -> bool:
        """Return whether a share is too slow to be the answer, even at the highest feed."""
        if not self.candidates or not self.long:
            return False
        try:
            with nullcontext() if self.until is None else self.until.interrupting():
                if self.at_top_s(share) < self._best_s:
                    return False
        except LimitError:  # at the highest feed the plan breaks a limit, so it has no duration
            return False
        self.left_out.add(share)
        return True


_STEP = 2.0**0.25  # factor between tried shares around the best of ``Effort.shares``
_SCAN = Grid(points=20)
_CLOSELY = Grid(points=20, near=FINE.near)
_AROUND = 5
"""Expected number of searches after the first shares: two on either side of the best, and the best
again."""


def fastest_job(question: Question) -> FastestJob:
    """Search feed and share of the limits together; the shortest job in spec wins.

    Paths and timings that ignore the limits (the 1994 controller's, programmed times) are searched
    by feed alone. ``optimal`` needs no feed: see ``fastest_allowed``. ``Question.low`` and ``high``
    are m/s of the fastest axis or of F words, or shares of an override. Without ``Question.by``,
    ``searched_by`` chooses the feed mode.

    Notes
    -----
    Where most of a job repeats earlier stretches, trials are judged by its distinct stretches.
    Where moves run long at a constant speed, trials leave out their middles. In both cases the
    whole job is judged at the best plan; if it is out of spec, the feed is lowered until the whole
    job passes.

    In a job of more than five minutes a share of the limits is skipped if even its highest feed
    takes no less time than the best result so far: it cannot be the answer. There, and in every
    winding, feeds are tried from above until four in a row are in spec. At the end only the fastest
    interval and its upper edge are examined closely. A winding is searched with one run of each
    plan; only the answer is judged in all runs that are asked for, and over the tolerances if that
    is asked.
    """
    job, machine, options, until = question.job, question.machine, question.options, question.until
    check_loops(machine)
    if options.interpolation == OPTIMAL:
        return fastest_chosen(question) if question.free else fastest_allowed(question)
    by = searched_by(job, machine) if question.by is None else question.by
    low, high = _span(question, by)
    question = replace(question, by=by, low=low, high=high, progress=never_back(question.progress))
    check_range(low, high, feed_unit(by) or "times the feeds")
    if question.progress is not None:
        question.progress("looking for what repeats", 0.0)
    if until is not None:
        until.check()  # checked before any file is open
    with nullcontext() if until is None else until.interrupting():
        parts = distinct_parts(job, machine, joined=options.product is not None)
        by_feed = ignores_limits(parts[0], machine, options)
    seen: dict[float, dict[float, Verdict]] = {}
    scanned, limits_only = in_one_run(question), _only_limits(question)

    def searched(share: float, grid: Grid, report: Progress | None) -> Fastest:
        part_question = scanned if parts == (job,) else of_a_part(scanned)
        with_share = replace(part_question.options, limit_share=share)
        question_at_share = replace(part_question, options=with_share, progress=report)
        # The slow feeds of a winding take longest to judge, and are never the answer.
        every_interval = options.product is None and (by_feed or not shares.long)
        examined_grid = replace(grid, every=every_interval, between=limits_only)
        return fastest_feed(question_at_share, examined_grid, parts, seen.setdefault(share, {}))

    def planned_s(share: float, feed: float) -> float:
        return planned_at(question, share, feed).duration_s

    shares = Shares(
        searched=searched,
        duration_s=lambda share, found: (
            None if found.best is None else planned_s(share, found.best)
        ),
        at_top_s=lambda share: planned_s(share, high),
        expected=1 if by_feed or limits_only else len(question.effort.shares) + _AROUND,
        progress=part_of(question.progress, 0.0, _OF_SEARCH if limits_only else 1.0),
        until=until,
    )
    tried, candidates = shares.tried, shares.candidates
    try:
        if by_feed:
            tried(1.0, FINE)
        else:
            _climb(tried, candidates, question.effort.shares, first_alone=limits_only)
    except HaltError as halt:
        if not candidates:
            raise no_answer() from halt
    except KeyboardInterrupt as signal:
        if until is None or not candidates or not until.interrupted(signal):
            raise
    best, stopped = min(candidates.values(), key=in_order), until is not None and bool(until.ended)
    repeats, shortened = parts != (job,), _cut(parts, machine, best, by)
    partly = repeats or shortened or scanned is not question
    whole = not stopped or not partly
    if partly and not stopped and best.duration_s is not None:
        whole = False
        if question.progress is not None:
            question.progress("the whole job", shares.steps / (shares.steps + 1))
        with until_deadline(until, lambda: candidates):
            best = judged_whole(
                best, candidates, question, 1 if scanned is question else len(candidates)
            )
            whole = True
    best = (
        with_searched_best(best, candidates, question, None if partly else seen)
        if whole and not stopped
        else best
    )
    return FastestJob(
        best=best,
        candidates=tuple(sorted(candidates.values(), key=lambda candidate: -candidate.share)),
        left_out=tuple(sorted(shares.left_out, reverse=True)),
        moves=moves_in(job) if repeats or shortened else 0,
        judged_moves=sum(map(moves_in, parts)) if repeats or shortened else 0,
        parts=len(parts) if repeats else 0,
        cut=shortened,
        whole=whole,
        in_one_run=scanned is not question,
        ended="" if until is None else until.ended,
        by=by,
        enough=_enough(best, planned_s, question.progress) if limits_only and not stopped else None,
    )


def _span(question: Question, by: FeedMode) -> tuple[float, float]:
    """Return the ends of the search, in the unit of ``by``."""
    low, high = search_range(question.job, question.machine, by)
    return low if question.low is None else question.low, (
        high if question.high is None else question.high
    )


_OF_SEARCH = 0.7
"""Share of the progress for the search itself; the rest is for the search for ``enough``."""
_SAME_TIME = 1e-3
_LOWEST = "looking for the lowest feed as fast"
_ENOUGH_STEP = 1.02  # ratio of neighbouring feeds at which the search for ``enough`` ends


def _enough(
    best: Candidate, planned_s: Callable[[float, float], float], progress: Progress | None
) -> float | None:
    """Return the lowest feed of the best interval that takes as long as the interval's upper end.

    At higher feeds the duration depends only on acceleration, corners and the velocity limits of
    the axes, because no move reaches its feed.
    """
    interval = best.found.fastest
    if interval is None or best.duration_s is None or best.found.limited_by != RANGE:
        return None
    low, high = interval.low, interval.high
    halvings = math.log2(max(math.log(high / low) / math.log(_ENOUGH_STEP), 1.0))
    rest_progress = part_of(progress, _OF_SEARCH, 1.0 - _OF_SEARCH)
    trials = TrialShares(rest_progress, _LOWEST, halvings)
    while high > low * _ENOUGH_STEP:
        feed = math.sqrt(low * high)
        if planned_s(best.share, feed) <= best.duration_s * (1.0 + _SAME_TIME):
            high = feed
        else:
            low = feed
        trials.done()
    return high


_OF_WHOLE = ("planned_coverage_gap", "coverage_gap")
"""Criteria that only the whole job can meet, because a part leaves the mandrel partly bare."""


def of_a_part(question: Question) -> Question:
    """Return the question for parts of a winding, without tied fibre and coverage criteria.

    The fibre is not tied at the begin of a part. The whole job is judged by its coverage at the end
    of the search.
    """
    if question.options.product is None:
        return question
    content = json.loads(question.options.product)
    content["fibre"] = {k: v for k, v in content.get("fibre", {}).items() if k != "tied"}
    text = product_text(json.dumps(content, ensure_ascii=True, sort_keys=True))
    criteria = tuple(one for one in question.spec.criteria if one.name not in _OF_WHOLE)
    return replace(
        question,
        options=replace(question.options, product=text),
        spec=replace(question.spec, criteria=criteria),
    )


def _only_limits(question: Question) -> bool:
    """Return whether only the machine's own limits are judged, so that full acceleration is best.

    A machine without dynamics does not ring, so only a criterion of the specification could need
    less acceleration.
    """
    limits_only = all(one.hard or one.limit is None for one in question.spec.criteria)
    return question.machine.without_dynamics and limits_only


def _climb(
    tried: Callable[..., Candidate | None],
    candidates: Mapping[float, Candidate],
    ladder: Sequence[float],
    *,
    first_alone: bool,
) -> None:
    """Try shares of the limits until both neighbours of the best share are slower.

    With ``first_alone`` the other shares are tried only if no feed is in spec at the first. A
    single share has no neighbours.
    """
    first_shares = ladder[:1] if first_alone else ladder
    for share in first_shares:
        tried(share, _SCAN)
    best = min(candidates.values(), key=in_order)
    if best.duration_s is None and first_alone:
        _climb(tried, candidates, ladder, first_alone=False)
        return
    if best.duration_s is not None and len(first_shares) > 1:
        for factor in (_STEP, 1.0 / _STEP):
            share = round(best.share * factor, 6)
            while LEAST_SHARE <= share <= 1.0:
                candidate = tried(share, _SCAN)
                if candidate is None or not in_order(candidate) < in_order(best):
                    break
                best = candidate
                share = round(share * factor, 6)
    finer: set[float] = set()
    while best.duration_s is not None and best.share not in finer:
        finer.add(best.share)
        tried(best.share, _CLOSELY)
        best = min(candidates.values(), key=in_order)


def _cut(parts: Sequence[Job], machine: Machine, best: Candidate, by: FeedMode) -> bool:
    """Return whether the best plan was judged without the middles of long moves."""
    feed_m_s = best.found.best
    if feed_m_s is None:
        return False
    feed = Feed(by, feed_m_s)
    return any(
        LongMoves.of(part, machine).without_middles(feed, best.share)[0] is not part
        for part in parts
    )


def ignores_limits(job: Job, machine: Machine, options: Options) -> bool:
    """Return whether a share of the limits makes no difference to a plan."""
    if options.timing.pace is Pace.PROGRAMMED:
        return True
    # The plan is made without feed-forward, whose smoothing would hide the timing of the path.
    return plan_job(job, machine, replace(options, feed_forward_s=None)).intent.historical
