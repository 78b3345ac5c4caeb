"""The needle speeds at which a seam is sewn in specification."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from threadline.errors import LimitError, OptionError
from threadline.jobs.operations import Job, Move
from threadline.machine import Machine
from threadline.options import Options
from threadline.pipeline import NOMINAL, Trials, open_job, plan_job, try_plan
from threadline.progress_call import Progress
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
