"""The options of a plan as text, in a recording or a proof, and read from there again."""

from __future__ import annotations

import math

from threadline.errors import OptionError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.option_table import (
    RECORDED,
)
from threadline.options import Options
from threadline.path.interpolations import OPTIMAL

_CONTOUR = "contour"


def describe(job: Job, machine: Machine, options: Options) -> dict[str, str]:
    """Return the options as text: enough to make the same plan again."""
    said = {"job": job.file, "machine": machine.reference}
    if machine.parameters:
        said["par"] = machine.parameters
    for one, recorded in RECORDED:
        value = getattr(options, one.attribute)
        if (
            recorded.key == _CONTOUR
        ):  # its default is said, too, and nothing where it bounds nothing
            value = options.allowance_m if options.interpolation == OPTIMAL else None
        if (text := recorded.write(value)) is not None:
            said[recorded.key] = text
    return said


def options_from(description: dict[str, str]) -> Options:
    """Return the options that ``describe`` wrote down.

    Raises
    ------
    OptionError
        If one of them is missing or unreadable.
    """
    read = {}
    for one, recorded in RECORDED:
        if recorded.key in description:
            read[one.attribute] = recorded.read(description[recorded.key])
        elif recorded.required:
            raise OptionError(
                f"the recording does not say with which {recorded.key} its plan was made",
                remedy="Give the job, the machine and the options.",
            )
    of_loads = "feed-forward" in description and description["interpolation"] == OPTIMAL
    if _CONTOUR not in description and of_loads:
        # A recording without a contour is of a plan that kept the rests of the inverses.
        read["contour_m"] = math.inf
    return Options(**read)
