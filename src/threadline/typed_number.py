"""A number with a unit as an option says it, with an error that shows how it is written."""

from __future__ import annotations

from threadline.errors import OptionError, UnitError
from threadline.units import parse_quantity


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
