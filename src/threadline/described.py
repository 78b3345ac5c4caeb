"""The options of a plan as text, in a recording or a proof, and read from there again."""

from __future__ import annotations

import math

from threadline.errors import OptionError
from threadline.jobs.operations import Job
from threadline.machine import Machine
from threadline.option_defaults import NO_CONTOUR
from threadline.option_words import (
    feed_words,
    parse_contour_m,
    parse_feed,
    parse_robust,
    parse_share,
    parse_tolerance_m,
    parse_width_s,
)
from threadline.options import Options
from threadline.path.interpolations import OPTIMAL
from threadline.typed_number import parse_number

PROGRAMMED = "programmed"
"""Feed of a plan that keeps the feeds of its job."""


def describe(job: Job, machine: Machine, options: Options) -> dict[str, str]:
    """Return the options as text: enough to make the same plan again."""
    feed = PROGRAMMED
    if options.feed is not None:
        feed = feed_words(options.feed)
    return {
        "job": job.file,
        "machine": machine.reference,
        **({"par": machine.parameters} if machine.parameters else {}),
        "interpolation": options.interpolation,
        "feed": feed,
        **({} if options.dialect is None else {"dialect": options.dialect}),
        **({} if options.feed_mode is None else {"feed-mode": options.feed_mode}),
        **({} if options.radius is None else {"radius": options.radius}),
        **({} if options.offset is None else {"offset": options.offset}),
        "tolerance": f"{options.tolerance_m!r} m",
        "limits": f"{options.limit_share * 100.0!r} %",
        **({} if options.shaper is None else {"shaper": options.shaper}),
        **({} if options.shaper_mode is None else {"mode": options.shaper_mode}),
        **({} if options.shaper_damping is None else {"damping": repr(options.shaper_damping)}),
        **(
            {}
            if options.feed_forward_s is None
            else {"feed-forward": f"{options.feed_forward_s!r} s"}
        ),
        **(
            {}
            if options.robust_share is None
            else {"robust": f"{options.robust_share * 100.0!r} %"}
        ),
        **({} if options.change_s is None else {"change": f"{options.change_s!r} s"}),
        **({"contour": _contour_text(options)} if options.interpolation == OPTIMAL else {}),
    }


def _contour_text(options: Options) -> str:
    contour_m = options.allowance_m
    return NO_CONTOUR if contour_m == math.inf else f"{contour_m!r} m"


def _contour_m(description: dict[str, str]) -> float | None:
    if "contour" in description:
        return parse_contour_m(description["contour"])
    # Recordings that say nothing of it are of plans that kept the rests of the inverses.
    of_loads = "feed-forward" in description and description["interpolation"] == OPTIMAL
    return math.inf if of_loads else None


def options_from(description: dict[str, str]) -> Options:
    """Return the options that ``describe`` wrote down.

    Raises
    ------
    OptionError
        If one of them is missing or unreadable.
    """
    try:
        feed_text = description["feed"]
        return Options(
            interpolation=description["interpolation"],
            feed=None if feed_text == PROGRAMMED else parse_feed(feed_text),
            dialect=description.get("dialect"),
            feed_mode=description.get("feed-mode"),
            radius=description.get("radius"),
            offset=description.get("offset"),
            tolerance_m=parse_tolerance_m(description["tolerance"]),
            limit_share=parse_share(description.get("limits", "100 %")),
            shaper=description.get("shaper"),
            shaper_mode=description.get("mode"),
            shaper_damping=None
            if "damping" not in description
            else parse_number("damping", description["damping"], "", "0.17"),
            feed_forward_s=None
            if "feed-forward" not in description
            else parse_width_s(description["feed-forward"]),
            robust_share=None
            if "robust" not in description
            else parse_robust(description["robust"]),
            change_s=None if "change" not in description else parse_width_s(description["change"]),
            contour_m=_contour_m(description),
        )
    except KeyError as error:
        raise OptionError(
            f"the recording does not say with which {error.args[0]} its plan was made",
            remedy="Give the job, the machine and the options.",
        ) from error
