"""A motion law by name, made by a shaper for a window or of the catalogue."""

from __future__ import annotations

from dataclasses import replace

from threadline.errors import OptionError, UnitError
from threadline.laws import Law, law
from threadline.shaping.shaped_law import shaped_law
from threadline.shaping.text import parse_shaper
from threadline.shaping.types import Shaper
from threadline.units import parse_quantity

_EXAMPLE = 'Write it like "modified-sine*zv:12Hz:0.02 in 160 ms".'


def law_named(text: str) -> Law:
    """Return the law called ``text``: of the catalogue, or one that a shaper makes of it.

    ``"modified-sine"`` and what else ``threadline.laws.law`` knows;
    ``"modified-sine*zv:12Hz:0.02 in 160 ms"`` is a law convolved with a shaper so that both
    together take the window. Played in another window it keeps its shape, and silences
    the frequency scaled by the ratio of the windows.

    Raises
    ------
    OptionError
        If there is no such law, the shaper cannot be made, or it takes the whole window.

    >>> law_named("cycloidal*zv:12Hz in 160 ms").name
    'cycloidal*zv:12Hz in 160 ms'
    """
    base, star, rest = text.partition("*")
    if not star or text.lower().endswith(".csv"):
        return law(text)
    words, within, window = rest.rpartition(" in ")
    if not within:
        raise OptionError(f"motion law {text!r}: it does not say its window", remedy=_EXAMPLE)
    try:
        window_s = parse_quantity(window.strip(), "s")
    except UnitError as error:
        raise OptionError(f"motion law {text!r}: {error.message}", remedy=_EXAMPLE) from error
    shaper = parse_shaper(words.strip())
    if not isinstance(shaper, Shaper):
        raise OptionError(
            f"motion law {text!r}: a law has one shaper, not one for each axis", remedy=_EXAMPLE
        )
    if not 0.0 < window_s < float("inf"):
        raise OptionError(f"motion law {text!r}: the window must be longer than 0", remedy=_EXAMPLE)
    return replace(shaped_law(law(base.strip()), shaper, window_s), name=text)
