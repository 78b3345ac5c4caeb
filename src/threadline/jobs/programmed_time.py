"""The time of a job at its programmed feeds, without the dynamics of a machine."""

from __future__ import annotations

import numpy as np

from threadline.errors import Place
from threadline.jobs.feed_times import feed_time_s, wanted_feed
from threadline.jobs.operations import Dwell, Feed, FeedMode, Job, Move, MoveRun, gathered
from threadline.machine import Machine


def programmed_time_s(job: Job, machine: Machine, feed: Feed | None = None) -> float:
    """Return the nominal time of a job, in s.

    Every move takes the time that its feed gives, as if the machine had no inertia, and every rapid
    move the time at the velocity limits of the axes. Dwells take their own time, stops none. The
    operator's normal feed is ignored. A CAM program that knows nothing but feeds reports this time.

    Parameters
    ----------
    feed
        Feed in place of the programmed ones; None for the programmed.

    Raises
    ------
    JobError
        If a block lacks a feed or a mode of motion.
    PlanError
        If a feed is missing or not above 0.
    """
    column = [machine.axis_names.index(axis) for axis in job.axes]
    velocity = machine.velocity_limit[column]
    position = np.array(job.start)
    total = 0.0
    for operation, times, _ in job.folded():
        if isinstance(operation, Dwell):
            total += times * operation.duration_s
            continue
        run = gathered([operation]) if isinstance(operation, Move) else operation
        if not isinstance(run, MoveRun):
            continue
        way = np.diff(run.targets, axis=0, prepend=position[None])
        position = run.targets[-1]
        ends = [begin for begin, _ in run.feeds[1:]] + [len(way)]
        for (begin, programmed), end in zip(run.feeds, ends, strict=True):
            place = Place(run.file, int(run.line[begin]))
            wanted = wanted_feed(programmed, feed, place, job, machine)
            if wanted.mode is FeedMode.RAPID:
                moves_s = (np.abs(way[begin:end]) / velocity).max(axis=1)
            else:
                moves_s = feed_time_s(way[begin:end], wanted, job.axes, machine)
            total += times * float(moves_s.sum())
    return total
