"""The shares of the limits that a search for the fastest has tried, and how far it is with them.

A loop that lags turns acceleration into error. A planner that uses all of the machine's limits
then has to creep to stay in spec; one that uses a tenth of them may run at full feed. So feed and
share of the limits are searched together, and the shortest job wins.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace

from threadline.base.progress import Progress
from threadline.errors import LimitError
from threadline.jobs.operations import Feed, FeedMode, Job
from threadline.machine import Machine
from threadline.motion.path.interpolations import OPTIMAL
from threadline.motion.timing import Pace
from threadline.proof.option_words import LEAST_SHARE
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, Trials, check_loops, plan_job, try_plan
from threadline.search.allowance import FastestJob, Rung, fastest_allowed
from threadline.search.distinct import LongMoves, distinct_parts, moves_in
from threadline.search.fastest import NEAR_POINTS, Fastest, check_range
from threadline.search.feed import fastest_feed, search_range, searched_by
from threadline.search.forbidden import Interval, closeness, worst_criterion
from threadline.search.until import HaltError, Until, as_far_as, no_answer
from threadline.verdict import Spec, Verdict

LONG_S = 300.0
"""A job that takes longer, however fast it was so far, is not searched with shares of the limits
with which it takes longer still."""


@dataclass(slots=True, kw_only=True)
class Shares:
    """What is known of each share of the limits.

    Parameters
    ----------
    searched
        Returns the feeds in spec with a share, from how many feeds are scanned, how many near each
        edge, and whom to tell how far that is.
    duration_s
        Returns how long the job takes with a share at the best of its feeds.
    at_top_s
        Returns how long it takes with a share at the highest feed of all.
    expected
        How many searches of one share there will be, most likely.
    progress, until
        As a search takes them.
    rungs, left_out
        What was found, by share; and shares with which even the highest feed takes no less time
        than the best so far.
    top_s
        How long the job takes with all of the limits at the highest feed; None until it is asked.
    steps, told
        How many searches were begun, and how much of all was told to be done.
    """

    searched: Callable[[float, int, int, Progress | None], Fastest]
    duration_s: Callable[[float, Fastest], float | None]
    at_top_s: Callable[[float], float]
    expected: int
    progress: Progress | None
    until: Until | None
    rungs: dict[float, Rung] = field(default_factory=dict)
    left_out: set[float] = field(default_factory=set)
    top_s: float | None = None
    steps: int = 0
    told: float = 0.0

    def tried(self, share: float, points: int, near: int = 0) -> Rung | None:
        """Return what was found with a share, searched unless that is known; None: left out.

        Raises
        ------
        HaltError
            If the time is over, or somebody asks for the answer, after this share was known.
        """
        if share in self.rungs and not near:
            return self.rungs[share]
        telling = self._telling(share)
        self.steps += 1
        if share in self.left_out or (share not in self.rungs and self._hopeless(share)):
            return None
        found = self.searched(share, points, near, telling)
        try:
            duration_s = self.duration_s(share, found)
        except KeyboardInterrupt as signal:
            # It takes one plan more to answer with what was found.
            if self.until is None or not self.until.interrupted(signal):
                raise
            duration_s = self.duration_s(share, found)
        self.rungs[share] = Rung(share=share, found=found, duration_s=duration_s)
        if not found.complete or (self.until is not None and self.until.ended):
            raise HaltError
        return self.rungs[share]

    @property
    def long(self) -> bool:
        """Whether the job takes long, however fast it was so far, or at the highest feed."""
        if not self.rungs:
            if self.top_s is None:
                try:
                    self.top_s = self.at_top_s(1.0)
                except LimitError:  # it breaks a limit: how long it would take says nothing
                    self.top_s = 0.0
            return self.top_s > LONG_S
        return LONG_S < self._best_s < math.inf

    @property
    def _best_s(self) -> float:
        durations = (rung.duration_s for rung in self.rungs.values())
        return min((value for value in durations if value is not None), default=math.inf)

    def _telling(self, share: float) -> Progress | None:
        """Return what is told how far the search of one share is."""
        if self.progress is None:
            return None
        progress, each = self.progress, 1.0 / max(self.expected, self.steps + 1)
        done = self.steps * each

        def telling(_: str, part: float) -> None:
            # Searches that nobody expected make the others a smaller part of all.
            self.told = max(self.told, done + part * each)
            progress(f"limits {share:.0%}", self.told)

        telling("", 0.0)
        return telling

    def _hopeless(self, share: float) -> bool:
        """Say whether nothing of a share can be the answer: even the highest feed is too slow."""
        if not self.rungs or not self.long:
            return False
        try:
            with nullcontext() if self.until is None else self.until.interrupting():
                if self.at_top_s(share) < self._best_s:
                    return False
        except LimitError:  # the highest feed breaks a limit: it is no plan to compare with
            return False
        self.left_out.add(share)
        return True


_LADDER = (1.0, 0.5, 0.25, 0.125, 0.0625, 0.03125)
_STEP = 2.0**0.25  # from rung to rung once the best of the ladder is known
_SCAN_POINTS = 20
_STEPS = len(_LADDER) + 5
"""Of a search: the ladder, most often two shares on either side of the best, and the best again,
near its edges."""
_LOWERED = 8  # feeds that the whole job is tried at
_LOWER = 0.98


def fastest_job(
    job: Job,
    machine: Machine,
    spec: Spec,
    options: Options,
    *,
    low: float | None = None,
    high: float | None = None,
    progress: Progress | None = None,
    actual: Machine | None = None,
    trials: Trials = NOMINAL,
    until: Until | None = None,
    by: FeedMode | None = None,
) -> FastestJob:
    """Search feed and share of the limits together; the shortest job in spec wins.

    Paths and timings that ignore the limits (the 1994 controller's, programmed times) are searched
    by feed alone. ``optimal`` needs no feed: see ``fastest_allowed``.

    Parameters
    ----------
    low, high
        Feeds to search between: m/s of the fastest axis or of F words, shares of an override.
    actual
        The machine that does the job, where it isn't the one that plans are made for.
    trials
        Which runs a feed is judged by.
    until
        When the search has to come to an answer.
    by
        What the feed is of; when None what ``searched_by`` says. ``optimal`` is always capped by
        the fastest axis.

    Notes
    -----
    Where most of a job repeats what was met before, tries are judged by its distinct stretches, and
    the best by the whole job; where that is out of spec, the feed is lowered until it is not. So
    are moves that go on at a constant speed for long: tries leave out the middle.

    Of a job of more than five minutes a share of the limits is left out where even the highest feed
    takes no less time with it than the best so far: nothing of it can be the answer. Feeds are
    tried from above until four in a row are in spec, and near the end the fastest interval alone is
    looked into closely, and its upper edge.
    """
    check_loops(machine)
    if options.interpolation == OPTIMAL:
        return fastest_allowed(
            job,
            machine,
            spec,
            options,
            high=high,
            progress=progress,
            actual=actual,
            trials=trials,
            until=until,
        )
    by = searched_by(job, machine) if by is None else by
    lowest, highest = search_range(job, machine, by)
    unit = "times the feeds" if by is FeedMode.OVERRIDE else "m/s"
    check_range(lowest if low is None else low, highest if high is None else high, unit)
    if progress is not None:
        progress("looking for what repeats", 0.0)
    if until is not None:
        until.check()  # before any file is open
    with nullcontext() if until is None else until.interrupting():
        parts = distinct_parts(job, machine)
        by_feed = ignores_limits(parts[0], machine, options)
    seen: dict[float, dict[float, Verdict]] = {}

    def searched(share: float, points: int, near: int, telling: Progress | None) -> Fastest:
        return fastest_feed(
            job,
            machine,
            spec,
            replace(options, limit_share=share),
            low=low,
            high=high,
            points=points,
            near=near,
            progress=telling,
            actual=actual,
            trials=trials,
            parts=parts,
            until=until,
            by=by,
            seen=seen.setdefault(share, {}),
            every=by_feed or not shares.long,
        )

    shares = Shares(
        searched=searched,
        duration_s=lambda share, found: _duration_s(
            job, machine, replace(options, limit_share=share), found, by
        ),
        at_top_s=lambda share: _planned_s(
            job, machine, replace(options, limit_share=share), highest if high is None else high, by
        ),
        expected=1 if by_feed else _STEPS,
        progress=progress,
        until=until,
    )
    tried, rungs = shares.tried, shares.rungs
    try:
        if by_feed:
            tried(1.0, 48, NEAR_POINTS)
        else:
            _climb(tried, rungs)
    except HaltError as halt:
        if not rungs:
            raise no_answer() from halt
    except KeyboardInterrupt as signal:
        if until is None or not rungs or not until.interrupted(signal):
            raise
    best = min(rungs.values(), key=_order)
    ended = "" if until is None else until.ended
    repeats = parts != (job,)
    cut = _cut(parts, machine, best, by)
    never = tuple(sorted(shares.left_out, reverse=True))
    if not (repeats or cut):
        return FastestJob(best=best, rungs=_ordered(rungs), left_out=never, ended=ended, by=by)
    whole = not ended
    if whole and best.duration_s is not None:
        whole = False
        if progress is not None:
            progress("the whole job", shares.steps / (shares.steps + 1))
        with as_far_as(until, lambda: rungs):
            best = _of_whole(best, job, machine, spec, options, actual, trials, by)
            rungs[best.share] = best
            whole = True
        ended = "" if until is None else until.ended
    return FastestJob(
        best=best,
        rungs=_ordered(rungs),
        left_out=never,
        moves=moves_in(job),
        judged_moves=sum(map(moves_in, parts)),
        parts=len(parts) if repeats else 0,
        cut=cut,
        whole=whole,
        ended=ended,
        by=by,
    )


def _climb(tried: Callable[..., Rung | None], rungs: Mapping[float, Rung]) -> None:
    """Try shares of the limits until none beside the best is better."""
    for share in _LADDER:
        tried(share, _SCAN_POINTS)
    best = min(rungs.values(), key=_order)
    if best.duration_s is not None:
        for factor in (_STEP, 1.0 / _STEP):
            share = round(best.share * factor, 6)
            while LEAST_SHARE <= share <= 1.0:
                rung = tried(share, _SCAN_POINTS)
                if rung is None or not _order(rung) < _order(best):
                    break
                best = rung
                share = round(share * factor, 6)
    finer: set[float] = set()
    while best.duration_s is not None and best.share not in finer:
        finer.add(best.share)
        tried(best.share, _SCAN_POINTS, NEAR_POINTS)
        best = min(rungs.values(), key=_order)


def _ordered(rungs: Mapping[float, Rung]) -> tuple[Rung, ...]:
    return tuple(sorted(rungs.values(), key=lambda rung: -rung.share))


def _cut(parts: Sequence[Job], machine: Machine, best: Rung, by: FeedMode) -> bool:
    """Say whether the best plan was judged without the middles of long moves."""
    feed_m_s = best.found.best
    if feed_m_s is None:
        return False
    feed = Feed(by, feed_m_s)
    return any(
        LongMoves.of(part, machine).without_middles(feed, best.share)[0] is not part
        for part in parts
    )


def _of_whole(
    best: Rung,
    job: Job,
    machine: Machine,
    spec: Spec,
    options: Options,
    actual: Machine | None,
    trials: Trials,
    by: FeedMode,
) -> Rung:
    """Return ``best`` as the whole job has it, with the highest feed at which that is in spec."""
    interval = best.found.fastest
    assert interval is not None
    feed_m_s = interval.high
    chosen = replace(options, limit_share=best.share)
    for _ in range(_LOWERED):
        feed = Feed(by, feed_m_s)
        plan = plan_job(job, machine, replace(chosen, feed=feed))
        verdict = try_plan(plan, spec, trials, actual).verdict
        if verdict.passed:
            kept = best.found.intervals
            if feed_m_s < interval.high:
                # What was found by parts alone, above this feed, does not hold for the whole.
                own = Interval(low=min(interval.low, feed_m_s), high=feed_m_s)
                kept = (own, *(i for i in kept if i.high < own.low))
            found = replace(best.found, intervals=kept, verdict=verdict)
            return replace(best, found=found, duration_s=plan.duration_s)
        feed_m_s = float(f"{feed_m_s * _LOWER:.6g}")
    limited_by = worst_criterion(verdict)[0]
    found = replace(best.found, intervals=(), verdict=verdict, limited_by=limited_by)
    return replace(best, found=found, duration_s=None)


def ignores_limits(job: Job, machine: Machine, options: Options) -> bool:
    """Say whether a share of the limits makes no difference to a plan."""
    if options.timing.pace is Pace.PROGRAMMED:
        return True
    # Planned without feed-forward, whose smoothing would hide how the path was timed.
    return plan_job(job, machine, replace(options, feed_forward_s=None)).intent.historical


def _order(rung: Rung) -> tuple[float, tuple[bool, float]]:
    """Return what the best has least of: its duration, or, without any in spec, its distance."""
    if rung.duration_s is None:
        return math.inf, closeness(rung.found.verdict)
    return rung.duration_s, (False, 0.0)


def _duration_s(
    job: Job, machine: Machine, options: Options, found: Fastest, by: FeedMode
) -> float | None:
    return None if found.best is None else _planned_s(job, machine, options, found.best, by)


def _planned_s(job: Job, machine: Machine, options: Options, feed: float, by: FeedMode) -> float:
    """Return how long the whole job takes at a feed."""
    return plan_job(job, machine, replace(options, feed=Feed(by, feed))).duration_s
