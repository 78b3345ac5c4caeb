"""The fastest way to do a job: how much of the limits to use, and at which feed.

A loop that lags turns acceleration into error. A planner that uses all of the machine's limits
then has to creep to stay in spec; one that uses a tenth of them may run at full feed. So feed and
share of the limits are searched together, and the shortest job wins.
"""

from __future__ import annotations

from dataclasses import replace

from threadline.jobs.operations import Feed, FeedMode, Job
from threadline.machine import Machine
from threadline.options import Options
from threadline.path.interpolations import OPTIMAL
from threadline.pipeline import NOMINAL, Progress, Trials, check_loops, plan_job
from threadline.search.allowance import fastest_allowed
from threadline.search.fastest import NEAR_POINTS, Fastest
from threadline.search.feed import fastest_feed
from threadline.search.rungs import FastestJob, Rung
from threadline.trajectory import Pace
from threadline.verdict import Spec

_LADDER = (1.0, 0.5, 0.25, 0.125, 0.0625, 0.03125)
_STEP = 2.0**0.25  # from rung to rung once the best of the ladder is known
_SCAN_POINTS = 20


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
) -> FastestJob:
    """Search feed and share of the limits together; the shortest job in spec wins.

    Paths and timings that ignore the limits (the 1994 controller's, programmed times) are searched
    by feed alone. ``optimal`` needs no feed: see ``fastest_allowed``.

    Parameters
    ----------
    low, high
        Feeds to search between, m/s of the fastest axis.
    actual
        The machine that does the job, where it isn't the one that plans are made for.
    trials
        Which runs a feed is judged by.
    """
    check_loops(machine)
    if options.interpolation == OPTIMAL:
        return fastest_allowed(
            job, machine, spec, options, high=high, progress=progress, actual=actual, trials=trials
        )
    by_feed = ignores_limits(job, machine, options)
    rungs: dict[float, Rung] = {}
    expected = 1 if by_feed else len(_LADDER) + 4

    def tried(share: float, points: int, near: int = 0) -> Rung:
        if share not in rungs or near:
            if progress is not None:
                progress(f"limits {share:.0%}", min(len(rungs) / expected, 1.0))
            chosen = replace(options, limit_share=share)
            found = fastest_feed(
                job,
                machine,
                spec,
                chosen,
                low=low,
                high=high,
                points=points,
                near=near,
                actual=actual,
                trials=trials,
            )
            rungs[share] = Rung(
                share=share, found=found, duration_s=_duration_s(job, machine, chosen, found)
            )
        return rungs[share]

    if by_feed:
        best = tried(1.0, 48, NEAR_POINTS)
        return FastestJob(best=best, rungs=(best,))
    best = min((tried(share, _SCAN_POINTS) for share in _LADDER), key=_order)
    if best.duration_s is not None:
        for factor in (_STEP, 1.0 / _STEP):
            share = round(best.share * factor, 6)
            while share <= 1.0 and _order(tried(share, _SCAN_POINTS)) < _order(best):
                best = tried(share, _SCAN_POINTS)
                share = round(share * factor, 6)
    finer: set[float] = set()
    while best.duration_s is not None and best.share not in finer:
        finer.add(best.share)
        tried(best.share, _SCAN_POINTS, NEAR_POINTS)
        best = min(rungs.values(), key=_order)
    ordered = tuple(sorted(rungs.values(), key=lambda rung: -rung.share))
    return FastestJob(best=min(ordered, key=_order), rungs=ordered)


def ignores_limits(job: Job, machine: Machine, options: Options) -> bool:
    """Say whether a share of the limits makes no difference to a plan."""
    if options.timing.pace is Pace.PROGRAMMED:
        return True
    # Planned without feed-forward, whose smoothing would hide how the path was timed.
    return plan_job(job, machine, replace(options, feed_forward_s=None)).intent.historical


def _order(rung: Rung) -> float:
    return float("inf") if rung.duration_s is None else rung.duration_s


def _duration_s(job: Job, machine: Machine, options: Options, found: Fastest) -> float | None:
    if found.best is None:
        return None
    feed = Feed(FeedMode.FASTEST_AXIS, found.best)
    return plan_job(job, machine, replace(options, feed=feed)).duration_s
