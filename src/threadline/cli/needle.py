"""Warnings of a seam whose stitches do not keep the time of a needle that turns evenly."""

from __future__ import annotations

from itertools import islice

from threadline.jobs.operations import FeedMode, Job, MoveRun
from threadline.pipeline import Proof

LIMIT = 0.05
"""Share of a turn by which a stitch may be off where no limit of its length is given."""
_RUNS = 16


def needle_warnings(proof: Proof) -> list[str]:
    """Return a line if a stitch takes much more or less than a turn of an even needle.

    The limit is that of a stitch's length: a needle that kept its speed would make the stitch as
    much too long or too short.
    """
    found = {result.name: result for result in proof.verdict.results}
    time, length = found.get("needle_time_error"), found.get("stitch_length_error")
    limit = LIMIT if length is None or length.limit is None else length.limit
    if time is None or time.measured is None or time.measured <= limit:
        return []
    if not _even(proof.plan.job):
        return []
    way = "more" if time.note == "too long" else "less"
    at = f" at line {time.job_line}" if time.job_line else ""
    return [
        f"the needle is to turn evenly, but {proof.plan.motion.path.interpolation} gives a "
        f"stitch{at} "
        f"{100.0 * time.measured:.2g} % {way} than a turn, limit {100.0 * limit:g} %: stitches are "
        f"judged as if it waited for the head; --feed-forward and --interpolation linear keep "
        f"its time"
    ]


def _even(job: Job) -> bool:
    """Say whether the stitches at the beginning of a job all take one time."""
    times = {
        feed.value
        for run in islice(job.runs(), _RUNS)
        if isinstance(run, MoveRun)
        for _, feed in run.feeds
        if feed is not None and feed.mode is FeedMode.INVERSE_TIME
    }
    return len(times) == 1
