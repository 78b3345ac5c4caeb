"""The fastest feed of a job, and the needle speeds of a seam, searched over the whole pipeline."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from threadline.base.progress import Progress
from threadline.commands.plan import Following
from threadline.errors import LimitError, OptionError
from threadline.jobs.feed_times import feed_time_s
from threadline.jobs.gcode.feeds import RULES, as_f_words
from threadline.jobs.operations import Feed, FeedMode, Job, Move, MoveRun, move_runs
from threadline.machine import Machine
from threadline.motion.path import programmed_path
from threadline.proof.options import Options
from threadline.proof.pipeline import NOMINAL, Trials, open_job, plan_job, try_plan
from threadline.search.distinct import LongMoves, moves_in
from threadline.search.fastest import EDGE_RELATIVE, NEAR_POINTS, SCAN_POINTS, Fastest, find_fastest
from threadline.search.forbidden import used
from threadline.search.judge_runs import kept_in_memory
from threadline.search.until import Until
from threadline.verdict import Result, Spec, Status, Verdict

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


def searched_by(job: Job, machine: Machine) -> FeedMode:
    """Return what a search for a feed varies.

    Where a program has feeds that differ it is their override, which keeps their ratios; else F as
    the job has it, or the speed of the fastest axis. An operator whose machine has a normal feed
    sets one for all moves, and no override.
    """
    named = job.feed_rule.partition(":")[0]
    if named not in RULES:
        return FeedMode.FASTEST_AXIS
    if machine.operator is None and _feeds_differ(job):
        return FeedMode.OVERRIDE
    return FeedMode.FASTEST_AXIS if RULES[named][0] is FeedMode.FASTEST_AXIS else FeedMode.F_WORD


def _feeds_differ(job: Job) -> bool:
    first: tuple[FeedMode, float] | None = None
    for item in move_runs(job):
        for _, feed in item.feeds if isinstance(item, MoveRun) else ():
            if feed is None or feed.mode is FeedMode.RAPID:
                continue
            first = (feed.mode, feed.value) if first is None else first
            if (feed.mode, feed.value) != first:
                return True
    return False


def search_range(job: Job, machine: Machine, by: FeedMode) -> tuple[float, float]:
    """Return the feeds between which a search makes sense, of what ``by`` says.

    Those of ``feed_range_m_s``. Of an override: up to where the moves that the program wants the
    fastest are as fast as their axes can be, 1 at least, because beyond that slower ones alone
    become faster and ratios are lost; from where these moves make a count per tick.
    """
    if by is not FeedMode.OVERRIDE:
        return feed_range_m_s(machine, by, job.feed_rule)
    column = [machine.axis_names.index(axis) for axis in job.axes]
    radius, velocity = machine.radius_m[column], machine.velocity_limit[column]
    fastest_m_s, faster = 0.0, 1.0
    last = np.array(job.start)
    for block in programmed_path(job, machine):
        way = np.abs(np.diff(block.positions, axis=0, prepend=last[None]))
        last = block.positions[-1]
        fed = (block.nominal_s > 0.0) & way.any(axis=1)
        if not fed.any():
            continue
        nominal_s = block.nominal_s[fed]
        speeds = (way[fed] * radius).max(axis=1) / nominal_s
        shares = nominal_s / (way[fed] / velocity).max(axis=1)
        top = float(speeds.max())
        if top > fastest_m_s * (1.0 + _SAME):
            fastest_m_s, faster = top, 1.0
        same = speeds >= fastest_m_s * (1.0 - _SAME)
        faster = max(faster, float(shares[same].max(initial=1.0)))
    least_m_s = feed_range_m_s(machine)[0]
    if not fastest_m_s:
        return 0.01, 1.0
    return _typed(min(least_m_s / fastest_m_s, 0.5), math.ceil), _typed(faster, math.floor)


def feed_range_m_s(
    machine: Machine, by: FeedMode = FeedMode.FASTEST_AXIS, rule: str = ""
) -> tuple[float, float]:
    """Return the feeds between which a search makes sense, m/s of the fastest axis.

    From one count per tick of the coarsest axis, below which a reference stands still between
    ticks, to the highest velocity limit at the tool. With ``by`` of F words, of F by ``rule``,
    ``Job.feed_rule``: from the F at which the coarsest axis alone makes a count per tick, to that
    at which all axes are as fast as they can be.
    """
    tick_s = float(machine.tick_clock.period_s)
    speeds = np.stack([1.0 / machine.counts_per_unit / tick_s, machine.velocity_limit])
    if by is FeedMode.F_WORD:
        axes = machine.axis_names
        unit = as_f_words(1.0, rule)
        # How much F a speed of each axis alone is: what a way of a second takes at F 1.
        alone = feed_time_s(np.diag(speeds[0]), unit, axes, machine)
        together = feed_time_s(speeds[1:], unit, axes, machine)
        each = feed_time_s(np.diag(speeds[1]), unit, axes, machine)
        low, high = float(alone.max()), float(max(together.max(), each.max()))
    else:
        low, high = (float((of_axes * machine.radius_m).max()) for of_axes in speeds)
    return _typed(low, math.ceil), _typed(high, math.floor)


def _of_all(passed: Sequence[Verdict]) -> Verdict:
    """Return one verdict over all stretches of a job, each of which passes: the worst of each row.

    Stretches have the same criteria and axes, hence the same rows; where one has others, since it
    is judged without ends of travel, the verdict is that of the stretch closest to a limit.
    """
    closest = max(passed, key=used)
    if len({tuple(row.name for row in verdict.results) for verdict in passed}) > 1:
        return closest
    rows = zip(*(verdict.results for verdict in passed), strict=True)
    worst = (max(row, key=lambda one: (one.measured is not None, one.severity)) for row in rows)
    return replace(closest, results=tuple(worst))


_SAME = 1e-3
"""Speeds that differ by a smaller share are the same one."""


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
    by: FeedMode = FeedMode.FASTEST_AXIS,
    seen: dict[float, Verdict] | None = None,
    every: bool = True,
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
    by
        What the feed is of: the fastest axis, or F words, by the job's rule for them; or an
        override, a share of the programmed feeds.
    seen, every
        As ``find_fastest`` takes them.
    """
    # Where one of the shortest shows already that a feed fails, the others need no simulation.
    shortest_first = sorted(parts, key=moves_in) if len(parts) > 1 else parts or (job,)
    judged_jobs = [LongMoves.of(part, machine) for part in shortest_first]
    lowest, highest = search_range(job, machine, by)

    def judged(feed_m_s: float) -> Verdict:
        passed = []
        for at, part in enumerate(judged_jobs):
            verdict = judged_part(part, feed_m_s)
            if not verdict.passed:
                # What fails at one feed most likely fails at the next: it is judged first.
                judged_jobs.insert(0, judged_jobs.pop(at))
                return verdict
            passed.append(verdict)
        return _of_all(passed)

    def judged_part(part: LongMoves, feed_m_s: float) -> Verdict:
        feed = Feed(by, feed_m_s)
        watched, on = part.without_middles(feed, options.limit_share)
        try:
            plan = plan_job(watched, on, replace(options, feed=feed))
        except LimitError as error:
            # What is programmed outside the travel is so at every feed.
            if options.following is Following.MOTOR or error.quantity == "travel":
                raise
            return beyond(error, machine)
        return try_plan(kept_in_memory(plan), spec, trials, actual).verdict

    return find_fastest(
        judged,
        lowest if low is None else low,
        highest if high is None else high,
        points=points,
        near=near,
        edge_relative=edge_relative,
        progress=progress,
        until=until,
        seen=seen,
        every=every,
    )


_SLOWEST = 0.025  # of the highest needle speed: where a search begins


def needle_range_hz(job: Job, machine: Machine) -> tuple[float, float]:
    """Return the needle speeds between which a search makes sense, stitches a second.

    Up to where the slower axis moves its shortest wanted stitch at its velocity limit, and from the
    lowest speed on of a needle that follows the head.

    Raises
    ------
    OptionError
        If the job has no stitches.
    """
    sewn = [o.tags for o in job if isinstance(o, Move) and "target_m" in o.tags]
    lengths = {float(tags["target_m"]) for tags in sewn}
    if not lengths:
        raise OptionError(f"{job.name} has no stitches", remedy="Search the feed instead.")
    high = min(machine.axes[axis].velocity.si for axis in job.axes) / min(lengths)
    slowest = max(float(tags.get("slowest_hz", 0.0)) for tags in sewn)
    return max(_SLOWEST * high, slowest), high


def fastest_needle(
    seam: Path,
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
    until: Until | None = None,
) -> Fastest:
    """Return every interval of needle speed (stitches a second) at which ``seam`` is in spec.

    The seam is read anew at each speed, so that its stitches are placed for it; every contour is
    sewn at the same speed. A speed at which the plan breaks a limit of the machine is out of spec.

    Parameters
    ----------
    points, near
        As ``find_fastest`` takes them; their steps are the resolution.
    actual
        The machine that sews, where it isn't the one that plans are made for.
    trials
        Which runs a speed is judged by.
    until
        When the search has to come to an answer, as ``find_fastest`` takes it.

    Raises
    ------
    JobError, OptionError
        If the seam cannot be read, or the range is empty.
    HaltError
        If the time is over before a speed was judged.
    """
    lowest, highest = needle_range_hz(open_job(seam, machine, options), machine)
    begin, end = lowest if low is None else low, highest if high is None else high

    def judged(speed_hz: float) -> Verdict:
        at_speed = replace(options, needle=f"{speed_hz!r} stitch/s")
        job = open_job(seam, machine, at_speed)
        try:
            plan = plan_job(job, machine, at_speed)
        except LimitError as error:
            return beyond(error, machine)
        return try_plan(plan, spec, trials, actual).verdict

    return find_fastest(
        judged,
        begin,
        end,
        points=points,
        near=near,
        edge_relative=edge_relative,
        progress=progress,
        unit="stitch/s",
        until=until,
    )
