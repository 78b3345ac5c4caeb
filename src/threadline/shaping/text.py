"""Shapers written in a line: ``zv:12Hz:0.02``, ``ei:12Hz:0.02:0.05``, ``X=zvd:9Hz, Y=ei:20Hz``."""

from __future__ import annotations

import re

from threadline.errors import OptionError, UnitError
from threadline.shaping.combine import convolve
from threadline.shaping.designs import DEFAULT_TOLERANCE, design
from threadline.shaping.types import FlexibleMode, Shaper
from threadline.units import parse_quantity

_REMEDY = 'Write it like "zv:12Hz:0.02" or "X=ei:12Hz:0.02:0.05, Y=zv:20Hz*zv:31Hz".'


def parse_shaper(text: str, tick_s: float | None = None) -> Shaper | dict[str, Shaper]:
    """Return the shaper that ``text`` describes, or one per axis where it names axes.

    A shaper is ``kind:frequency``, then, where wanted, ``:damping ratio`` (0 if it is left out)
    and ``:tolerance``. ``*`` convolves shapers for several modes; ``AXIS=`` gives an axis its
    own, separated by commas.

    Parameters
    ----------
    tick_s
        Tick of the references that are to be shaped; None where there is none.

    Raises
    ------
    OptionError
        If the text cannot be read, no such shaper can be designed, or a mode lies above half the
        rate of the ticks, where no reference can excite it or leave it out.
    """
    parts = [part.strip() for part in text.split(",")]
    named = [re.fullmatch(r"([A-Z])\s*=\s*(.+)", part) for part in parts]
    if not any(named) and len(parts) == 1:
        return _convolution(parts[0], tick_s)
    found: dict[str, Shaper] = {}
    for part, match in zip(parts, named, strict=True):
        if match is None:
            raise OptionError(f"shaper {text!r}: {part!r} has no axis before it", remedy=_REMEDY)
        if match[1] in found:
            raise OptionError(f"shaper {text!r}: axis {match[1]} has two", remedy=_REMEDY)
        found[match[1]] = _convolution(match[2], tick_s)
    return found


def parse_mode_hz(text: str) -> float:
    """Return an undamped frequency such as ``"3.04 Hz"``.

    Raises
    ------
    OptionError
        If it is not a frequency.
    """
    try:
        return parse_quantity(text, "Hz")
    except UnitError as error:
        raise OptionError(f"mode {text!r}: {error.message}", remedy='Write "3.04 Hz".') from error


def _convolution(text: str, tick_s: float | None) -> Shaper:
    return convolve(*(_one(part.strip(), text, tick_s) for part in text.split("*")))


def _one(text: str, whole: str, tick_s: float | None) -> Shaper:
    words = [word.strip() for word in text.split(":")]
    if not 2 <= len(words) <= 4 or not all(words):
        raise OptionError(f"shaper {whole!r}: {text!r} is not kind:frequency", remedy=_REMEDY)
    damping = _number(words[2], "damping ratio", whole) if len(words) > 2 else 0.0
    tolerance = _number(words[3], "tolerance", whole) if len(words) > 3 else DEFAULT_TOLERANCE
    mode = FlexibleMode(parse_mode_hz(words[1]), damping)
    if tick_s is not None and mode.frequency_hz > 0.5 / tick_s:
        raise OptionError(
            f"shaper {whole!r}: its mode of {mode.frequency_hz:g} Hz is above "
            f"{0.5 / tick_s:g} Hz, half the rate of the machine's tick of {1e3 * tick_s:g} ms",
            remedy="References on that tick cannot excite it: leave it out.",
        )
    return design(words[0], mode, tolerance=tolerance)


def _number(text: str, what: str, whole: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise OptionError(
            f"shaper {whole!r}: {what} {text!r} is no number", remedy=_REMEDY
        ) from None
