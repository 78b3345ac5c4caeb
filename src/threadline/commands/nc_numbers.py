"""Decimal numbers of part programs: the shortest decimal that reads back as the same float."""

from __future__ import annotations

import math
from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache

from threadline.errors import PlanError
from threadline.jobs.gcode.words import MAX_DECIMALS, ONE, exact

_SCALES = tuple(10.0**decimals for decimals in range(MAX_DECIMALS))
# Conversion and reader each round to within two units in the last place, 4.5e-16 of the number:
# no decimal further away than this share reads back as it.
_UNREADABLE = 2e-15


def shortest(target: float, factor: Fraction | None, read: Callable[[int], float]) -> int:
    """Return the exact number with the fewest decimals that ``read`` turns into ``target``.

    Parameters
    ----------
    target
        Value in SI units.
    factor
        Program units per SI unit; None converts radians to degrees.
    read
        Function of the reader that turns an exact number into a float.

    Returns
    -------
    int
        Number in units of 10**-18. If no decimal reads back as ``target`` (an angle that no
        program can give, or a value with digits beyond the 17th decimal), the nearest decimal. Its
        error is below two units in the last place, or 1e-17 of the unit.
    """
    approximate = math.degrees(target) if factor is None else target * float(factor)
    # If a decimal of at most 15 digits reads back as ``target``, it has these digits.
    near = f"{approximate:.15g}"
    known = None if "e" in near else exact(near)
    if known is not None and read(known) == target:
        return known
    for decimals, scale in enumerate(_SCALES):
        scaled = approximate * scale
        if abs(scaled - round(scaled)) > _UNREADABLE * abs(scaled):
            continue
        value = exact(f"{approximate:.{decimals}f}")
        if value is None:
            raise PlanError(
                f"{target:g} is too large a number for a part program", remedy="Shorten the job."
            )
        if read(value) == target:
            return value
    if factor is not None:
        return 10 * round(Fraction(target) * factor * (ONE // 10))
    candidates = [approximate]
    for direction in (math.inf, -math.inf):
        beside = math.nextafter(approximate, direction)
        candidates += [beside, math.nextafter(beside, direction)]
    values = [exact(f"{one:.{MAX_DECIMALS}f}") or 0 for one in candidates]
    return min(values, key=lambda value: abs(read(value) - target))


_REMEMBERED = 1 << 15  # numbers kept: the circuits of a winding repeat them
_MM = Fraction(1000)
_COUNTING = 9  # significant digits: the time of a one-minute move is off by 60 ns
_MM_PER_MIN = Fraction(60_000)


@lru_cache(maxsize=_REMEMBERED)
def millimetres(position_m: float) -> int:
    """Return the position of a linear axis as an exact number of mm."""
    return shortest(position_m, _MM, lambda value: value / (1000 * ONE))


@lru_cache(maxsize=_REMEMBERED)
def degrees(position_rad: float) -> int:
    """Return the position of a rotary axis as an exact number of degrees."""
    return shortest(position_rad, None, lambda value: math.radians(value / ONE))


@lru_cache(maxsize=_REMEMBERED)
def per_minute(speed_m_s: float) -> int:
    """Return a speed as an exact number of mm/min."""
    return shortest(speed_m_s, _MM_PER_MIN, lambda value: value / (60_000 * ONE))


@lru_cache(maxsize=_REMEMBERED)
def inverse_minutes(rate_hz: float) -> int:
    """Return an inverse time as an exact number per minute."""
    return shortest(rate_hz, Fraction(60), lambda value: value / (60 * ONE))


@lru_cache(maxsize=_REMEMBERED)
def inverse_minutes_of(duration_s: float) -> int:
    """Return the inverse of a time as an exact number per minute with nine significant digits."""
    digits = _COUNTING - 1 - math.floor(math.log10(60.0 / duration_s))
    value = exact(f"{60.0 / duration_s:.{max(min(digits, MAX_DECIMALS), 0)}f}")
    if value is None:
        raise PlanError(f"a move takes {duration_s:g} s, too short for a part program")
    return value


@lru_cache(maxsize=_REMEMBERED)
def seconds(duration_s: float) -> int:
    """Return a time as an exact number of s."""
    return shortest(duration_s, Fraction(1), lambda value: value / ONE)


@lru_cache(maxsize=_REMEMBERED)
def text(value: int) -> str:
    """Return an exact number as the digits of a word.

    >>> text(10130000000000000000), text(-5 * 10**17), text(3 * 10**18)
    ('10.13', '-0.5', '3')
    """
    whole, fraction = divmod(abs(value), ONE)
    digits = f"{fraction:018d}".rstrip("0")
    sign = "-" if value < 0 else ""
    return f"{sign}{whole}.{digits}" if digits else f"{sign}{whole}"
