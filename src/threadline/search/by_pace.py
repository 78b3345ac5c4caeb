"""How the fastest way to do a job is searched, by what paces the job."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from threadline.errors import OptionError
from threadline.jobs.operations import FeedMode, Job, Pace
from threadline.machine import Machine
from threadline.options import Options
from threadline.pipeline import Trials
from threadline.search.cycle import fastest_cycle
from threadline.search.gentle import fastest_job
from threadline.search.needle import fastest_needle
from threadline.search.shaft import fastest_shaft
from threadline.verdict import Spec


@dataclass(frozen=True, slots=True, kw_only=True)
class Question:
    """What is asked of a search for the fastest.

    Parameters
    ----------
    file, job
        The job and its file; a seam is read again for every needle speed.
    machine, spec, options
        The machine that it is planned for, what is asked, and how to plan.
    actual
        The machine that runs it, where it is another one.
    trials
        Which runs every verdict is made of.
    """

    file: Path
    job: Job
    machine: Machine
    spec: Spec
    options: Options
    actual: Machine | None
    trials: Trials


Answer: TypeAlias = tuple[float | None, str, str, Any]
"""The best, or None; its unit; the criterion that forbids more; the result with every try."""


def _feed(asked: Question) -> Answer:
    result = fastest_job(
        asked.job, asked.machine, asked.spec, asked.options,
        actual=asked.actual, trials=asked.trials,
    )  # fmt: skip
    found = result.best.found
    unit = "" if result.by is FeedMode.OVERRIDE else "m/s"
    return found.best, unit, found.limited_by, result


def _needle(asked: Question) -> Answer:
    seam = fastest_needle(
        asked.file, asked.machine, asked.spec, asked.options,
        actual=asked.actual, trials=asked.trials,
    )  # fmt: skip
    return seam.best, "stitch/s", seam.limited_by, seam


def _shaft(asked: Question) -> Answer:
    sewn = fastest_shaft(
        asked.job, asked.machine, asked.spec, asked.options,
        actual=asked.actual, trials=asked.trials,
    )  # fmt: skip
    return sewn.duration_s, "s", sewn.limited_by, sewn


def _switchings(asked: Question) -> Answer:
    if asked.trials.ends is not None:
        raise OptionError(
            f"robust {100.0 * asked.trials.ends:.12g} % does not apply to {asked.job.name}, of "
            "which commands and waits are searched",
            remedy="Leave it out; threadline fastest --band searches over a band of modes.",
        )
    cycle = fastest_cycle(
        asked.job, asked.machine, asked.spec, actual=asked.actual, trials=asked.trials
    )
    return cycle.cycle_s, "s", cycle.limited_by, cycle


SEARCHES: Mapping[Pace, Callable[[Question], Answer]] = {
    "feed": _feed,
    "needle": _needle,
    "shaft": _shaft,
    "switchings": _switchings,
}
"""By pace: the search for the fastest way to do a job in spec."""
