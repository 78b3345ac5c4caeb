"""The least number of ticks that a job takes, found before any of it is planned."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import BudgetError, Place
from threadline.jobs.feed_times import nominal_time_s, wanted_feed
from threadline.jobs.operations import Dwell, Feed, FeedMode, Job, Move, MoveRun, gathered
from threadline.machine import Machine

_MOST_WORK = 1_000_000
_WORK_PER_ITEM = 64  # an item of its own costs as much as so many moves of a run


def check_budget(job: Job, machine: Machine, feed: Feed | None = None) -> None:
    """Refuse a job that takes more ticks than the machine file allows, before work starts.

    The times of the moves at their feeds are summed with repeated passes multiplied out, so that
    ``M98 P1 L1000000000`` costs three passes. Rapid moves count with the velocity limits. Of a
    long job only the beginning is looked at, for a second or so: the trajectory counts the rest.

    Parameters
    ----------
    job, machine
        What is to be done, and on what.
    feed
        Replaces the programmed feeds.

    Raises
    ------
    BudgetError
        Naming the line of the call, or of the move, that asks for most.
    JobError
        Where a block does not say what it needs to.
    PlanError
        If a feed is missing or not above 0.
    """
    budget = machine.tick_budget.si
    period_s = float(machine.tick_clock.period_s)
    position = np.array(job.start)
    asked: defaultdict[int, float] = defaultdict(float)  # ticks by line
    total = work = 0.0
    for operation, times, call in job.folded():
        item = gathered([operation]) if isinstance(operation, Move) else operation
        if isinstance(item, MoveRun):
            moves_s = _times_s(item, position, feed, job, machine)
            position = item.targets[-1]
            line = int(item.line[int(np.argmax(moves_s))])
            ticks = times * float(moves_s.sum()) / period_s
        elif isinstance(item, Dwell):
            line, ticks = item.source.line, times * item.duration_s / period_s
        else:
            continue
        asked[call or line] += ticks
        total += ticks
        work += _WORK_PER_ITEM + (len(item) if isinstance(item, MoveRun) else 0)
        if total > budget:
            worst = max(asked, key=asked.__getitem__)
            raise BudgetError(
                f"the job takes more than {total:.3g} ticks of {period_s * 1e3:g} ms at its "
                f"feeds; the tick budget of {machine.name!r} is {budget:.3g}",
                place=Place(job.file, worst),
                remedy="Lower L or the dwell, raise the feed, or raise tick_budget in the "
                "machine file.",
            )
        if work > _MOST_WORK:
            return


def _times_s(
    run: MoveRun, position: FloatArray, feed: Feed | None, job: Job, machine: Machine
) -> FloatArray:
    """Return the (moves,) least time of each move of a run that begins at ``position``."""
    way = np.diff(run.targets, axis=0, prepend=position[None])
    column = [machine.axis_names.index(axis) for axis in job.axes]
    least_s: FloatArray = (np.abs(way) / machine.velocity_limit[column]).max(axis=1)
    ends = [begin for begin, _ in run.feeds[1:]] + [len(way)]
    for (begin, programmed), end in zip(run.feeds, ends, strict=True):
        if programmed is None or programmed.mode is not FeedMode.RAPID:
            wanted = wanted_feed(
                programmed, feed, Place(run.file, int(run.line[begin])), job, machine
            )
            least_s[begin:end], _ = nominal_time_s(way[begin:end], wanted, feed, job, machine)
    return least_s
