"""Convert option texts into numbers, and numbers into option texts."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import NamedTuple

from threadline.base.option_defaults import NO_CONTOUR, UNSHAPED_WORD
from threadline.errors import OptionError, UnitError
from threadline.jobs.operations import Feed, FeedMode
from threadline.units import parse_number, parse_quantity, same_dimension, split_quantity

LEAST_CONTOUR_M = 1e-6
LONG_STITCHES = ("travel", "split", "refuse")
FEED_UNITS = {FeedMode.COUNT_PER_TICK: "count/tick", FeedMode.SHAFT: "stitch/s"}
"""Units of feeds that are not speeds of the fastest axis."""
F_UNIT = "mm/min"
"""The unit of a feed that is written as an F word without one."""
_F_WORD = re.compile(r"\s*[Ff](?=[\s+.\d-])")
MOST_RESERVE = 0.9
"""Largest share of voltage and current that a plan may reserve for the loops, as in a machine file.
"""
LEAST_SHARE = 1e-3
"""Smallest share of the limits: with less, the trajectory takes too long to compute."""


def parse_feed(text: str) -> Feed:
    """Return the feed written in ``text``: ``"10 count/tick"``, ``"36 mm/s"``, ``"2 stitch/s"``.

    ``"F 3000"`` is the speed, in mm/min, that the job's rule for F words gives to this F word.
    ``"120 %"`` is an override: it multiplies each programmed feed.

    Raises
    ------
    OptionError
        If it is not a positive feed of a known kind.
    """
    try:
        word = _F_WORD.match(text)
        if text.rstrip().endswith("%"):
            feed = Feed(FeedMode.OVERRIDE, parse_quantity(text, "%") / 100.0)
        elif word is not None:
            number, written = split_quantity(text[word.end() :])
            value = parse_quantity(f"{number} {written or F_UNIT}", "m/s")
            feed = Feed(FeedMode.F_WORD, value)
        else:
            _, written = split_quantity(text)
            modes = (
                m for m, unit in FEED_UNITS.items() if written and same_dimension(written, unit)
            )
            mode = next(modes, FeedMode.FASTEST_AXIS)
            feed = Feed(mode, parse_quantity(text, FEED_UNITS.get(mode, "m/s")))
    except UnitError as error:
        raise OptionError(
            f"feed {text!r}: {error.message}",
            remedy='Write it like "10 count/tick", "36 mm/s" or "500 mm/min"; for an embroidery '
            'machine like "120 stitch/min"; as an F word in mm/min like "F 3000"; as an override '
            'of all feeds like "120 %".',
        ) from error
    if feed.value <= 0:
        raise OptionError(f"feed {text!r} must be greater than zero")
    return feed


def feed_words(feed: Feed) -> str:
    """Return the text of a feed; ``parse_feed`` reads the same feed back, to the last bit.

    >>> feed_words(parse_feed("F 3000")), feed_words(parse_feed("10 count/tick"))
    ('F 3000', '10.0 count/tick')
    >>> feed_words(parse_feed("120%"))
    '120 %'
    """
    if feed.mode is FeedMode.OVERRIDE:
        word = f"{feed.value * 100.0:.12g} %"
        return word if parse_feed(word) == feed else f"{feed.value * 100.0!r} %"
    if feed.mode is FeedMode.F_WORD:
        word = f"F {feed.value * 60_000.0:.12g}"
        return word if parse_feed(word) == feed else f"F {feed.value!r} m/s"
    return f"{feed.value!r} {FEED_UNITS.get(feed.mode, 'm/s')}"


def _range(
    name: str,
    example: str,
    fits: Callable[[float], bool],
    range_words: str,
    remedy: str = "",
    unit: str = "",
) -> Callable[[str], float]:
    """Return a parser for a number in a range; it raises ``OptionError`` outside of the range."""

    def parse(text: str) -> float:
        value = parse_number(name, text, unit, example)
        if not fits(value):
            subject = "distance outside" if name == "outside" else name
            raise OptionError(f"{subject} {text!r} must be {range_words}", remedy=remedy)
        return value

    return parse


parse_tolerance_m = _range("tolerance", "0.1 mm", lambda m: m > 0, "greater than zero", unit="m")
parse_outside_m = _range(
    "outside", "0.3 mm", lambda m: 0.0 <= m < math.inf, "at least 0",
    'Write it like "0.3 mm", or leave it out.', "m",
)  # fmt: skip
"""Parse the largest deviation of the path on the outside of corners; returns m."""
parse_width_s = _range(
    "smoothing", "36 ms", lambda s: 1e-4 <= s <= 10.0, "at least 0.1 ms and at most 10 s", unit="s"
)
"""Parse a smoothing time; returns s."""
parse_share = _range(
    "limits", "25 %", lambda share: LEAST_SHARE <= share <= 1.0,
    f"at least {100.0 * LEAST_SHARE:g} % and at most 100 %", 'A quarter of the limits is "25 %".',
)  # fmt: skip
"""Parse a share of the acceleration and jerk limits."""
parse_margin = _range(
    "margin", "20 %", lambda share: 0.0 <= share < 1.0, "at least 0 % and below 100 %",
    'Write it like "20 %".',
)  # fmt: skip
parse_ends = _range(
    "ends", "100 %", lambda share: 0.0 < share <= 2.0,
    "above 0 % and at most 200 % of the tolerances",
    'Machines at the ends of all tolerances are "100 %".',
)  # fmt: skip
"""Parse the share of the tolerances at whose ends machines are judged."""
parse_band = _range(
    "band", "20 %", lambda share: 0.0 < share <= 0.6,
    "above 0 % and at most 60 % of the frequency",
    'Modes that may be a fifth off to either side are "20 %".',
)  # fmt: skip
"""Parse the half width of a frequency band, as a share of the frequency."""
parse_robust = _range(
    "robust", "100 %", lambda share: 0.0 <= share <= 2.0,
    "at least 0 % and at most 200 % of the tolerances",
    'All of them are "100 %", the nominal machine is "0 %".',
)  # fmt: skip
"""Parse the share of the tolerances that a robust plan covers."""
parse_yield = _range(
    "yield", "99 %", lambda share: 0.0 < share < 1.0, "above 0 % and below 100 %",
    '99 of 100 machines in spec is "99 %"; no number of machines proves 100 %.',
)  # fmt: skip
"""Parse a wanted yield, as a share."""


def tolerance_words(tolerance_m: float) -> str:
    """Return the text of a tolerance in mm, rounded to four digits.

    >>> tolerance_words(8.74999e-5)
    '0.0875 mm'
    """
    return f"{tolerance_m * 1e3:.4g} mm"


class Reserve(NamedTuple):
    """Shares of the voltage and of the current of a drive that a plan reserves for its loop."""

    volts: float
    current: float


_RESERVED = re.compile(r"\s*volts\s+([^,]+),\s*current\s+([^,]+)")


def parse_reserve(text: str) -> Reserve:
    """Return the shares reserved for the loops: ``"2 %"``, ``"volts 1 %, current 3 %"``.

    Raises
    ------
    OptionError
        If a share is below 0 % or above ``MOST_RESERVE``.
    """
    match = _RESERVED.fullmatch(text)
    parts = (text, text) if match is None else match.groups()
    shares = [parse_number("reserve", part.strip(), "", "2 %") for part in parts]
    if not all(0.0 <= share <= MOST_RESERVE for share in shares):
        raise OptionError(
            f"reserve {text!r} must be at least 0 % and at most {MOST_RESERVE:.0%}",
            remedy='A fiftieth of volts and current is "2 %"; each has its own in '
            '"volts 1 %, current 3 %".',
        )
    return Reserve(*shares)


def reserve_words(reserve: Reserve) -> str:
    """Return the text of reserves; ``parse_reserve`` reads the same reserves, to the last bit.

    >>> reserve_words(Reserve(0.02, 0.02)), reserve_words(Reserve(0.005, 0.03))
    ('2 %', 'volts 0.5 %, current 3 %')
    """
    volts, current = map(share_words, reserve)
    return volts if volts == current else f"volts {volts}, current {current}"


Narrow = tuple[tuple[int, float], ...]
"""Line numbers of a program, each with the tolerance at the end of the move of this line, m."""


def parse_narrow(text: str) -> Narrow:
    """Return the tolerances at lines of a program, such as ``"13: 0.38 mm, 22: 0.4 mm"``, in m.

    Raises
    ------
    OptionError
        If a line is not a whole number above 0 or occurs twice, or a tolerance is not positive.
    """
    widths_m: dict[int, float] = {}
    for part in text.split(","):
        line, colon, width = part.partition(":")
        if not colon or not line.strip().isdecimal() or int(line) in widths_m or int(line) < 1:
            raise OptionError(
                f"narrow {text!r}: {part.strip()!r} is not a line with its tolerance, or stands "
                "twice",
                remedy='Write lines of the program with their tolerances: "13: 0.38 mm, 22: 0.4 mm"'
                ".",
            )
        widths_m[int(line)] = parse_tolerance_m(width.strip())
    return tuple(sorted(widths_m.items()))


def narrow_words(narrow: Narrow) -> str | None:
    """Return the text of tolerances at lines, for ``parse_narrow``, exact to the last bit.

    The result is None if there are no such lines.

    >>> narrow_words(((13, 0.00038),))
    '13: 0.38 mm'
    """
    return ", ".join(f"{line}: {length_words(width)}" for line, width in narrow) or None


def time_words(time_s: float) -> str:
    """Return a time in ms if it reads back as the same number, else in s.

    >>> time_words(0.01025), time_words(1.0 / 3.0)
    ('10.25 ms', '0.3333333333333333 s')
    """
    text = f"{time_s * 1e3:.9g} ms"
    return text if parse_quantity(text, "s") == time_s else f"{time_s!r} s"


def length_words(length_m: float) -> str:
    """Return a length in mm if it reads back as the same number, else in m.

    >>> length_words(0.0004), length_words(1.0 / 3.0)
    ('0.4 mm', '0.3333333333333333 m')
    """
    text = f"{length_m * 1e3:.9g} mm"
    return text if parse_quantity(text, "m") == length_m else f"{length_m!r} m"


def parse_long_stitches(text: str) -> str:
    """Return the treatment of overlong stitches of a design: ``travel``, ``split`` or ``refuse``.

    Raises
    ------
    OptionError
        If the text is another word.
    """
    if text not in LONG_STITCHES:
        raise OptionError(
            f"--long-stitches {text!r} is not known", remedy=f"Known: {', '.join(LONG_STITCHES)}."
        )
    return text


def parse_contour_m(text: str) -> float:
    """Return the allowed path deviation, such as ``"0.3 mm"``, in m; infinite for ``none``.

    Raises
    ------
    OptionError
        If it is neither ``none`` nor a length of at least ``LEAST_CONTOUR_M``.
    """
    if text == NO_CONTOUR:
        return math.inf
    value = parse_number("contour", text, "m", "0.3 mm")
    if value < LEAST_CONTOUR_M:
        raise OptionError(
            f"contour {text!r} must be at least {LEAST_CONTOUR_M * 1e6:g} um",
            remedy=f'Write "{NO_CONTOUR}" to plan on the limits of axes and drives alone.',
        )
    return value


def share_words(share: float) -> str:
    """Return a share as a percentage of at most eight digits, else as a plain number.

    ``parse_share`` reads exactly the same value back.

    >>> share_words(0.25), share_words(0.176777)
    ('25 %', '0.176777')
    """
    for digits in range(1, 9):
        text = f"{share * 100.0:.{digits}g} %"
        if "e" not in text and parse_quantity(text, "") == share:
            return text
    return f"{share!r}"


def recorded_share(share: float | None) -> str | None:
    """Return the text of a share for a recording: in percent, or as a plain number.

    It is a plain number if the conversion to percent would change the last bit of the value.

    >>> recorded_share(0.25), recorded_share(0.0257)
    ('25.0 %', '0.0257')
    """
    if share is None:
        return None
    text = f"{share * 100.0!r} %"
    return text if parse_quantity(text, "") == share else f"{share!r}"


def parse_damping(given: str | float) -> float:
    """Return a damping ratio, a number or a text such as ``"0.17"`` or ``"17 %"``.

    Raises
    ------
    OptionError
        If the text is not a number without a unit.
    """
    return parse_number("--damping", given, "", "20 %") if isinstance(given, str) else float(given)


def parse_shaper_text(text: str) -> str | None:
    """Return a shaper's text unchanged; None for ``none``, which stands for no shaper."""
    return None if text == UNSHAPED_WORD else text
