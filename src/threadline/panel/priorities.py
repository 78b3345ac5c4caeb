"""What an operator's priority makes of the options of a plan: accuracy, optimum or speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from threadline.errors import OptionError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.options import Options
from threadline.pipeline import Trials
from threadline.search.gentle import fastest_job
from threadline.verdict import Spec

PROGRAMMED = "programmed"
"""Priority that changes nothing."""
_MARGINS = {"optimum": 0.2, "speed": 0.0}
"""Share of every limit that is kept free by the fastest plan of a priority."""


def by_priority(
    priority: str,
    job: Job,
    machine: Machine,
    spec: Spec,
    options: Options,
    trials: Trials,
    share: Callable[[str, float], None],
) -> Mapping[str, Any]:
    """Return the words that a priority puts in the place of those of the request.

    Parameters
    ----------
    priority
        ``accuracy`` is the operator's normal feed; ``speed`` the fastest feed, and share of the
        limits, in spec; ``optimum`` the fastest that keeps 20 % of every limit free.
    trials
        Which runs every feed of the search is judged by.
    share
        Told how much of the search is done.

    Raises
    ------
    OptionError
        If the machine has no normal feed, the job is not paced by a feed, or nothing is in spec.
    """
    if job.paced_by != "feed":
        raise OptionError(
            f"{job.name} is not paced by a feed, but by: {job.paced_by}",
            remedy="Calculate it as programmed; threadline fastest searches it.",
        )
    if priority == "accuracy":
        if machine.operator is None:
            raise OptionError(
                f"{machine.name} has no normal feed",
                remedy="Give operator.normal_feed in the machine file, or a feed.",
            )
        return {"feed": f"{machine.operator.normal_feed.si!r} count/tick"}
    found = fastest_job(
        job, machine, spec.with_margin(_MARGINS[priority]), options, progress=share, trials=trials
    ).best
    if found.found.best is None:
        raise OptionError(
            f"{job.name} is out of specification at every feed: {found.found.limited_by}",
            remedy="Calculate it as programmed, and look at what fails.",
        )
    return {"feed": f"{found.found.best!r} m/s", "limits": f"{found.share * 100.0!r} %"}
