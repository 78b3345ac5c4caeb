"""The fastest feed of a job, and the fastest needle speed of a seam, over the whole pipeline."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from threadline.commands.plan import Following, Plan
from threadline.errors import OptionError
from threadline.jobs.feed_times import feed_time_s
from threadline.jobs.gcode.feeds import RULES, as_f_words
from threadline.jobs.operations import Feed, FeedMode, Job, Move, MoveRun, move_runs
from threadline.machine import Machine
from threadline.motion.path import programmed_path
from threadline.proof.judge_runs import cached_in_memory
from threadline.proof.pipeline import open_job, plan_job
from threadline.search.fastest import FINE, Fastest, Grid
from threadline.search.paced import Paced, Question, fastest_paced
from threadline.search.shortened_jobs import LongMoves, moves_in
from threadline.verdict import Verdict


def searched_by(job: Job, machine: Machine) -> FeedMode:
    """Return the feed mode that a search varies.

    A search varies the override of a program with several feeds, so that their ratios are kept. For
    other programs it varies the job's F word, or the speed of the fastest axis. On a machine with a
    normal feed the operator sets one feed for all moves, so no override is searched. A winding from
    its product has a planned time for each move. One feed for all moves would lose the even speed
    of the fibre and the soft stop of the mandrel, so the search varies the override on every
    machine.
    """
    rule_name = job.feed_rule.partition(":")[0]
    if rule_name not in RULES:
        return FeedMode.OVERRIDE if _timed(job) else FeedMode.FASTEST_AXIS
    if machine.operator is None and _feeds_differ(job):
        return FeedMode.OVERRIDE
    return (
        FeedMode.FASTEST_AXIS if RULES[rule_name][0] is FeedMode.FASTEST_AXIS else FeedMode.F_WORD
    )


def _timed(job: Job) -> bool:
    """Return whether the moves of a job have their own times."""
    for item in move_runs(job):
        for _, feed in item.feeds if isinstance(item, MoveRun) else ():
            if feed is not None:
                return feed.mode is FeedMode.INVERSE_TIME
    return False


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
    """Return the useful feed range of a search, in the unit of ``by``.

    The range is the result of ``feed_range_m_s``, except for an override. A move is free if no axis
    is at its limit at the programmed feed; a lift with a slow Z, for example, is not free. The
    highest override brings the fastest free moves to the limit of an axis, and is at least 1. With
    a higher one only slower moves would get faster, and the ratios of the feeds would be lost. If
    no free move then reaches the speed of the fastest move, the highest override is 1. At the
    lowest override the fastest move makes one count per tick.
    """
    if by is not FeedMode.OVERRIDE:
        return feed_range_m_s(machine, by, job.feed_rule)
    columns = [machine.axis_names.index(axis) for axis in job.axes]
    radius, velocity = machine.radius_m[columns], machine.velocity_limit[columns]
    fastest_m_s, free_m_s, largest_factor = 0.0, 0.0, 1.0
    last_position = np.array(job.start)
    for block in programmed_path(job, machine):
        distances = np.abs(np.diff(block.positions, axis=0, prepend=last_position[None]))
        last_position = block.positions[-1]
        is_fed = (block.nominal_s > 0.0) & distances.any(axis=1)
        if not is_fed.any():
            continue
        nominal_s = block.nominal_s[is_fed]
        speeds = (distances[is_fed] * radius).max(axis=1) / nominal_s
        shares = nominal_s / (distances[is_fed] / velocity).max(axis=1)
        fastest_m_s = max(fastest_m_s, float(speeds.max()))
        below_limits = shares > 1.0 + _SAME
        speeds, shares = speeds[below_limits], shares[below_limits]
        fastest_free_m_s = float(speeds.max(initial=0.0))
        if fastest_free_m_s > free_m_s * (1.0 + _SAME):
            free_m_s, largest_factor = fastest_free_m_s, 1.0
        as_fast = speeds >= free_m_s * (1.0 - _SAME)
        largest_factor = max(largest_factor, float(shares[as_fast].max(initial=1.0)))
    if free_m_s * largest_factor < fastest_m_s * (1.0 - _SAME):
        largest_factor = 1.0
    least_m_s = feed_range_m_s(machine)[0]
    if not fastest_m_s:
        return 0.01, 1.0
    return _typed(min(least_m_s / fastest_m_s, 0.5), math.ceil), _typed(largest_factor, math.floor)


def feed_range_m_s(
    machine: Machine, by: FeedMode = FeedMode.FASTEST_AXIS, rule: str = ""
) -> tuple[float, float]:
    """Return the useful feed range of a search, m/s of the fastest axis.

    The lowest feed moves the coarsest axis by one count per tick; below it a reference stands still
    between ticks. The highest feed is the highest velocity limit at the tool. For ``by`` F words,
    the range is in F by ``rule``, ``Job.feed_rule``: from the F at which the coarsest axis alone
    moves by a count per tick, to the F at which all axes reach their velocity limits.
    """
    tick_s = float(machine.tick_clock.period_s)
    speeds = np.stack([1.0 / machine.counts_per_unit / tick_s, machine.velocity_limit])
    if by is FeedMode.F_WORD:
        axes = machine.axis_names
        unit = as_f_words(1.0, rule)
        # F at which an axis alone has a speed: the time at F 1 for its distance in one second.
        single_axis_s = feed_time_s(np.diag(speeds[0]), unit, axes, machine)
        together_s = feed_time_s(speeds[1:], unit, axes, machine)
        each_at_limit_s = feed_time_s(np.diag(speeds[1]), unit, axes, machine)
        low, high = float(single_axis_s.max()), float(max(together_s.max(), each_at_limit_s.max()))
    else:
        low, high = (float((axis_speeds * machine.radius_m).max()) for axis_speeds in speeds)
    return _typed(low, math.ceil), _typed(high, math.floor)


_SAME = 1e-3
"""Speeds that differ by a smaller share count as equal."""


def _typed(feed: float, rounding: Callable[[float], int]) -> float:
    """Return a feed of six digits within the range, so that a user can type the search's ends."""
    digits = 5 - math.floor(math.log10(feed))
    return float(f"{rounding(feed * 10.0**digits)}e{-digits}")


def fastest_feed(
    question: Question,
    grid: Grid = FINE,
    parts: Sequence[Job] = (),
    seen: dict[float, Verdict] | None = None,
) -> Fastest:
    """Return every interval of feed (m/s of the fastest axis) at which a job stays in spec.

    With feed-forward, a feed whose smoothed motion breaks a limit of the machine is out of spec.
    ``Question.by`` is the feed mode: the fastest axis by default; F words, by the job's feed rule;
    or an override, a share of the programmed feeds.

    Parameters
    ----------
    grid, seen
        As in ``fastest_paced``.
    parts
        Jobs that are judged in place of this job: its distinct stretches.
    """
    machine, options = question.machine, question.options
    by = FeedMode.FASTEST_AXIS if question.by is None else question.by

    def planner(part: LongMoves) -> Callable[[float], Plan]:
        def planned_at(pace: float) -> Plan:
            feed = Feed(by, pace)
            shortened_job, limited_machine = part.without_middles(feed, options.limit_share)
            return cached_in_memory(
                plan_job(shortened_job, limited_machine, replace(options, feed=feed))
            )

        return planned_at

    # If one of the shortest stretches fails at a feed, the others need no simulation.
    shortest_first = sorted(parts, key=moves_in) if len(parts) > 1 else parts or (question.job,)
    low, high = question.low, question.high
    if low is None or high is None:
        low, high = search_range(question.job, machine, by)
    paced = Paced(
        low=low,
        high=high,
        unit=feed_unit(by) or "times the feeds",
        planned_at=[planner(LongMoves.of(part, machine)) for part in shortest_first],
        # A move that is programmed outside the travel fails at every feed.
        is_verdict=lambda e: options.following is Following.LOAD and e.quantity != "travel",
    )
    return fastest_paced(question, paced, grid, seen)


def feed_unit(by: FeedMode) -> str:
    """Return the unit of a feed in the feed mode ``by``; "" for a share of the programmed feeds."""
    return "" if by is FeedMode.OVERRIDE else "m/s"


_SLOWEST = 0.025  # lowest speed of a search, as a share of the highest needle speed


def needle_range_hz(job: Job, machine: Machine) -> tuple[float, float]:
    """Return the useful range of needle speeds of a search, stitches a second.

    At the highest speed the slower axis makes its shortest wanted stitch at its velocity limit. The
    lowest speed is the lowest of a needle that follows the head.

    Raises
    ------
    OptionError
        If the job has no stitches.
    """
    stitch_tags = [o.tags for o in job if isinstance(o, Move) and "target_m" in o.tags]
    lengths = {float(tags["target_m"]) for tags in stitch_tags}
    if not lengths:
        raise OptionError(f"{job.name} has no stitches", remedy="Search the feed instead.")
    high = min(machine.axes[axis].velocity.si for axis in job.axes) / min(lengths)
    slowest = max(float(tags.get("slowest_hz", 0.0)) for tags in stitch_tags)
    return max(_SLOWEST * high, slowest), high


def fastest_needle(question: Question, grid: Grid = FINE) -> Fastest:
    """Return every interval of needle speed (stitches a second) at which a seam is in spec.

    The seam is read again at each speed, so that its stitches are placed for this speed. Every
    contour is sewn at the same speed. A speed at which the plan breaks a machine limit is out of
    spec.

    Raises
    ------
    JobError, OptionError
        If the seam cannot be read, or the range is empty.
    HaltError
        If the time is over before a speed was judged.
    """
    low, high = needle_range_hz(question.job, question.machine)

    def searched(speed_hz: float, verdict: Verdict) -> Verdict:
        return question.searched(sewn_at(question, speed_hz), verdict)

    paced = Paced(
        low=low,
        high=high,
        unit="stitch/s",
        planned_at=[partial(sewn_at, question)],
        is_verdict=lambda _: True,
        searched=searched,
    )
    return fastest_paced(question, paced, grid)


def sewn_at(question: Question, speed_hz: float) -> Plan:
    """Return the plan of a seam at a needle speed, stitches a second."""
    options = replace(question.options, needle=f"{speed_hz!r} stitch/s")
    return plan_job(open_job(question.file, question.machine, options), question.machine, options)
