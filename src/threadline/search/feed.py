"""The fastest feed of a job: the search run over the whole pipeline."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from threadline.errors import LimitError
from threadline.jobs.operations import Feed, FeedMode, Job
from threadline.machine import Machine
from threadline.options import Options
from threadline.pipeline import NOMINAL, Progress, Trials, plan_job, try_plan
from threadline.plan import Following
from threadline.search.fastest import (
    EDGE_RELATIVE,
    NEAR_POINTS,
    SCAN_POINTS,
    Fastest,
    find_fastest,
)
from threadline.search.refused import beyond
from threadline.search.until import Until
from threadline.verdict import Spec, Verdict


def feed_range_m_s(machine: Machine) -> tuple[float, float]:
    """Return the feeds between which a search makes sense, m/s of the fastest axis.

    From one count per tick of the coarsest axis, below which a reference stands still between
    ticks, to the highest velocity limit at the tool.
    """
    tick_s = float(machine.tick_clock.period_s)
    low = float((machine.radius_m / machine.counts_per_unit).max()) / tick_s
    high = float((machine.velocity_limit * machine.radius_m).max())
    return _typed(low, math.ceil), _typed(high, math.floor)


def _typed(feed: float, towards: Callable[[float], int]) -> float:
    """Return a feed of six digits within the range: what a search ends with can be typed."""
    digits = 5 - math.floor(math.log10(feed))
    return float(f"{towards(feed * 10.0**digits)}e{-digits}")


def fastest_feed(
    job: Job,
    machine: Machine,
    spec: Spec,
    options: Options,
    *,
    low: float | None = None,
    high: float | None = None,
    points: int = SCAN_POINTS,
    near: int = NEAR_POINTS,
    progress: Progress | None = None,
    actual: Machine | None = None,
    edge_relative: float = EDGE_RELATIVE,
    trials: Trials = NOMINAL,
    parts: Sequence[Job] = (),
    until: Until | None = None,
) -> Fastest:
    """Return every interval of feed (m/s of the fastest axis) at which ``job`` stays in spec.

    Where loads follow, a feed at which the smoothed motion breaks a limit of the machine is out of
    spec.

    Parameters
    ----------
    points, near, edge_relative
        As ``find_fastest`` takes them; their steps are the resolution.
    actual
        The machine that does the job, where it isn't the one that plans are made for.
    trials
        Which runs a feed is judged by.
    parts
        Jobs that are judged in the place of this one: its distinct stretches.
    until
        When the search has to come to an answer.
    """
    judged_jobs = list(parts or (job,))
    lowest, highest = feed_range_m_s(machine)

    def judged(feed_m_s: float) -> Verdict:
        for at, part in enumerate(judged_jobs):
            verdict = judged_part(part, feed_m_s)
            if not verdict.passed:
                # What fails at one feed most likely fails at the next: it is judged first.
                judged_jobs.insert(0, judged_jobs.pop(at))
                return verdict
        return verdict

    def judged_part(part: Job, feed_m_s: float) -> Verdict:
        feed = Feed(FeedMode.FASTEST_AXIS, feed_m_s)
        try:
            plan = plan_job(part, machine, replace(options, feed=feed))
        except LimitError as error:
            # What is programmed outside the travel is so at every feed.
            if options.following is Following.MOTOR or error.quantity == "travel":
                raise
            return beyond(error, machine)
        return try_plan(plan, spec, trials, actual).verdict

    return find_fastest(
        judged,
        lowest if low is None else low,
        highest if high is None else high,
        points=points,
        near=near,
        edge_relative=edge_relative,
        progress=progress,
        until=until,
    )
