"""How a job is to be planned, as it is written on a command line and in a recording."""

from __future__ import annotations

from threadline.errors import OptionError, UnitError
from threadline.jobs.operations import Feed, FeedMode
from threadline.units import parse_quantity, same_dimension, split_quantity


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
        raise OptionError(
            f"feed {text!r}: {error.message}",
            remedy='Write it like "10 count/tick", "36 mm/s" or "500 mm/min".',
        ) from error
    if feed.value <= 0:
        raise OptionError(f"feed {text!r} must be greater than zero")
    return feed


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
        If it is not above 0 % and at most 100 %.
    """
    value = parse_number("limits", text, "", "25 %")
    if not 0.0 < value <= 1.0:
        raise OptionError(f"limits {text!r} must be above 0 % and at most 100 %")
    return value


def parse_margin(text: str) -> float:
    """Return a margin such as ``"20 %"`` as a number.

    Raises
    ------
    OptionError
        If it is not at least 0 % and below 100 %.
    """
    try:
        value = parse_quantity(text, "")
    except UnitError as error:
        raise OptionError(
            f"margin {text!r}: {error.message}", remedy='Write it like "20 %".'
        ) from error
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
