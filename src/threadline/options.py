"""How a job is to be planned, and how that is written on a command line and in a recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from threadline.errors import OptionError, UnitError
from threadline.jobs.operations import Feed, FeedMode, Job
from threadline.machine import Machine
from threadline.path.plan import DEFAULT_TOLERANCE_M
from threadline.units import parse_quantity, same_dimension, split_quantity

DEFAULT_INTERPOLATION = "auto"
OF_AXES = ("interpolation", "feed", "feed-mode", "tolerance", "limits")
"""What ``describe`` says of machines with axes, and means nothing on one that switches."""
LEAST_SHARE = 1e-3
"""Of the limits: no job is meant to speed up a thousand times more gently than its machine can, and
the search for its trajectory takes the longer the longer that trajectory is."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """How a job is to be planned.

    Parameters
    ----------
    interpolation
        Name of the interpolation.
    feed
        Replaces every programmed feed; None keeps the job's.
    feed_mode
        Text of what F of a part program means where axes of several kinds move together; None is
        the reader's default.
    tolerance_m
        Largest deviation of the planned from the programmed path, at the tool.
    limit_share
        Share of the machine's acceleration and jerk limits that the planner uses, in (0, 1].
    shaper
        Text of the shaper, or of one per axis, that the trajectory is convolved with; None
        leaves it as it was planned.
    feed_forward_s
        Command the exact inverses of the axes, so that the loads and not the motors follow the
        motion, smoothed over this time; ``auto`` then keeps every programmed time exactly. None
        commands the motion itself.
    """

    interpolation: str = DEFAULT_INTERPOLATION
    feed: Feed | None = None
    feed_mode: str | None = None
    tolerance_m: float = DEFAULT_TOLERANCE_M
    limit_share: float = 1.0
    shaper: str | None = None
    feed_forward_s: float | None = None


def parse_number(subject: str, text: str, unit: str, example: str) -> float:
    """Return what an option says, in ``unit``.

    Parameters
    ----------
    subject
        The option, as an error names it.
    text
        A number with a unit, as it was written.
    unit
        The SI unit wanted; ``""`` for a plain number.
    example
        How such an option is written.

    Raises
    ------
    OptionError
        If it is not a quantity of that kind.
    """
    try:
        return parse_quantity(text, unit)
    except UnitError as error:
        raise OptionError(
            f"{subject} {text!r}: {error.message}", remedy=f'Write it like "{example}".'
        ) from error


def parse_feed(text: str) -> Feed:
    """Return the feed written in ``text``: ``"10 count/tick"``, ``"36 mm/s"``, ``"500 mm/min"``.

    Raises
    ------
    OptionError
        If it is not a positive feed of a known kind.
    """
    try:
        _, unit = split_quantity(text)
        if same_dimension(unit, "count/tick") if unit else False:
            feed = Feed(FeedMode.COUNT_PER_TICK, parse_quantity(text, "count/tick"))
        else:
            feed = Feed(FeedMode.FASTEST_AXIS, parse_quantity(text, "m/s"))
    except UnitError as error:
        remedy = 'Write it like "10 count/tick", "36 mm/s" or "500 mm/min".'
        if "stitch" in text:
            remedy = f'The needle speed of a seam stands in its file: needle_speed = "{text}".'
        raise OptionError(f"feed {text!r}: {error.message}", remedy=remedy) from error
    if feed.value <= 0:
        raise OptionError(f"feed {text!r} must be greater than zero")
    return feed


def parse_feed_mode(text: str) -> dict[str, Any]:
    """Return the reader's options for what F means: ``"path"``, ``"base-axes:A,X"``.

    The reader knows the modes and the machine's axes, and refuses others.
    """
    mode, _, axes = text.partition(":")
    base = tuple(name.strip().upper() for name in axes.split(",")) if axes.strip() else ()
    return {"feed_mode": mode.strip(), "base_axes": base}


def parse_tolerance_m(text: str) -> float:
    """Return a tolerance such as ``"0.1 mm"`` in m.

    Raises
    ------
    OptionError
        If it is not a positive length.
    """
    value = parse_number("tolerance", text, "m", "0.1 mm")
    if value <= 0:
        raise OptionError(f"tolerance {text!r} must be greater than zero")
    return value


def parse_share(text: str) -> float:
    """Return a share such as ``"25 %"`` as a number.

    Raises
    ------
    OptionError
        If it is not at least ``LEAST_SHARE`` and at most 100 %.
    """
    value = parse_number("limits", text, "", "25 %")
    if not LEAST_SHARE <= value <= 1.0:
        raise OptionError(
            f"limits {text!r} must be at least {100.0 * LEAST_SHARE:g} % and at most 100 %",
            remedy='A quarter of the limits is "25 %".',
        )
    return value


def parse_margin(text: str) -> float:
    """Return a margin such as ``"20 %"`` as a number.

    Raises
    ------
    OptionError
        If it is not at least 0 % and below 100 %.
    """
    value = parse_number("margin", text, "", "20 %")
    if not 0.0 <= value < 1.0:
        raise OptionError(
            f"margin {text!r} must be at least 0 % and below 100 %",
            remedy='20 % of every limit kept free is "20 %".',
        )
    return value


def parse_width_s(text: str) -> float:
    """Return the width of a smoothing in time such as ``"36 ms"`` in s.

    Raises
    ------
    OptionError
        If it is not a time of at least 0.1 ms and at most 10 s.
    """
    value = parse_number("smoothing", text, "s", "36 ms")
    if not 1e-4 <= value <= 10.0:
        raise OptionError(f"smoothing {text!r} must be at least 0.1 ms and at most 10 s")
    return value


def refuse_axis_options(machine: Machine, options: Options) -> None:
    """Refuse options that a schedule does not have; all but the shaper are such.

    Raises
    ------
    OptionError
        If one is given.
    """
    if replace(options, shaper=None) != Options():
        raise OptionError(
            f"{machine.name} switches on and off: it has no interpolation, feed, tolerance or "
            "share of limits to choose",
            remedy="Leave these options out; a shaper may be given.",
        )


def describe(job: Job, machine: Machine, options: Options) -> dict[str, str]:
    """Return the options as text: enough to make the same plan again."""
    feed = "programmed"
    if options.feed is not None:
        unit = "count/tick" if options.feed.mode is FeedMode.COUNT_PER_TICK else "m/s"
        feed = f"{options.feed.value!r} {unit}"
    return {
        "job": job.file,
        "machine": machine.reference,
        **({"par": machine.parameters} if machine.parameters else {}),
        "interpolation": options.interpolation,
        "feed": feed,
        **({} if options.feed_mode is None else {"feed-mode": options.feed_mode}),
        "tolerance": f"{options.tolerance_m!r} m",
        "limits": f"{options.limit_share * 100.0!r} %",
        **({} if options.shaper is None else {"shaper": options.shaper}),
        **(
            {}
            if options.feed_forward_s is None
            else {"feed-forward": f"{options.feed_forward_s!r} s"}
        ),
    }


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
            feed=None if feed_text == "programmed" else parse_feed(feed_text),
            feed_mode=description.get("feed-mode"),
            tolerance_m=parse_tolerance_m(description["tolerance"]),
            limit_share=parse_share(description.get("limits", "100 %")),
            shaper=description.get("shaper"),
            feed_forward_s=None
            if "feed-forward" not in description
            else parse_width_s(description["feed-forward"]),
        )
    except KeyError as error:
        raise OptionError(
            f"the recording does not say with which {error.args[0]} its plan was made",
            remedy="Give the job, the machine and the options.",
        ) from error
