"""Quantities with units: parsed where text enters the program, and SI everywhere else.

Loading pint's registry and defining its units takes a quarter of a second, more than all other work
of a command with units. This module therefore keeps a table of the usual factors, equal to pint's
to the bit (a test compares them). Only an unusual unit loads the registry.

Every file and option writes a number with its unit (``"7.5 in/s"``, ``"55.358 count/mm"``,
``"10 count/tick"``); after parsing, every quantity is a float in SI. This module treats angle as a
dimension, so that millimetres, degrees and plain numbers cannot be mistaken for each other.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from functools import cache
from itertools import islice, product
from typing import TYPE_CHECKING, Any

from threadline.errors import OptionError, UnitError

if TYPE_CHECKING:
    import pint


_PER_REVOLUTION = 0.15915494309189535
_DEGREE = 0.017453292519943295

_FACTORS: dict[str, dict[str, float]] = {
    "": {"%": 0.01},
    "m": {"mm": 1e-3, "um": 1e-6, "in": 0.0254},
    "m/s": {"mm/s": 1e-3, "mm/min": 1.6666666666666667e-05, "in/s": 0.0254},
    "m/s^2": {"mm/s^2": 1e-3, "in/s^2": 0.0254},
    "m/s^3": {"mm/s^3": 1e-3, "in/s^3": 0.0254},
    "rad": {"deg": _DEGREE},
    "rad/s": {"deg/s": _DEGREE},
    "rad/s^2": {"deg/s^2": _DEGREE},
    "rad/s^3": {"deg/s^3": _DEGREE},
    "s": {"ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "Hz": {"kHz": 1e3},
    "kg": {"g": 1e-3},
    "kg*m^2": {"kg m^2": 1.0},
    "N": {"kN": 1e3},
    "N/m": {"kN/m": 1e3, "MN/m": 1e6},
    "N*s/m": {"N s/m": 1.0},
    "N*m": {"N m": 1.0},
    "N*m*s/rad": {"N m s/rad": 1.0},
    "N*m/A": {"N m/A": 1.0},
    "V": {"mV": 1e-3},
    "V/m": {},
    "V*s/rad": {"V/krpm": 0.00954929658551372},
    "A": {"mA": 1e-3},
    "A/V": {},
    "ohm": {},
    "H": {"mH": 1e-3},
    "m/rad": {"mm/rad": 1e-3},
    "bit": {},
    "tick": {},
    "count/m": {"count/mm": 1e3},
    "count/rad": {"count/rev": _PER_REVOLUTION, "count/deg": 57.29577951308232},
    "count/tick": {},
    "dac/count": {},
    "stitch/s": {"stitch/min": 0.016666666666666666},
    "Pa": {"kPa": 1e3, "MPa": 1e6, "GPa": 1e9, "bar": 1e5},
    "kg/m^3": {},
}
"""SI unit -> unit -> its value in that SI unit."""

_USUAL = {
    unit: (kind, factor)
    for kind, units in _FACTORS.items()
    for unit, factor in (units | ({kind: 1.0} if kind else {})).items()
}


def usual_factor(unit: str, target: str) -> float | None:
    """Return the factor from ``unit`` to ``target``: 0 if dimensions differ, None if unknown.

    >>> usual_factor("mm", "m"), usual_factor("mm", "rad"), usual_factor("furlong", "m")
    (0.001, 0.0, None)
    """
    known = _USUAL.get(unit)
    if known is None or target not in _FACTORS:
        return None
    kind, factor = known
    return factor if kind == target else 0.0


_DEFINITIONS = """
nano- = 1e-9 = n-
micro- = 1e-6 = µ- = μ- = u-
milli- = 1e-3 = m-
centi- = 1e-2 = c-
kilo- = 1e3 = k-
mega- = 1e6 = M-
giga- = 1e9 = G-
meter = [length] = m = metre
second = [time] = s
gram = [mass] = g
ampere = [current] = A
radian = [angle] = rad
count = [encoder] = counts
tick = [tick] = ticks
dac = [dac]
bit = [bit] = bits
stitch = [stitch] = stitches
block = [block] = blocks
inch = 0.0254 * meter = in
foot = 12 * inch = ft
minute = 60 * second = min
hour = 60 * minute = h
revolution = 6.283185307179586476925286766559 * radian = rev = turn
degree = revolution / 360 = deg
rpm = revolution / minute
hertz = 1 / second = Hz
newton = kilogram * meter / second ** 2 = N
pascal = newton / meter ** 2 = Pa
bar = 1e5 * pascal
joule = newton * meter = J
watt = joule / second = W
volt = watt / ampere = V
ohm = volt / ampere
henry = volt * second / ampere = H
tex = 1e-6 * kilogram / meter
percent = 0.01
"""

_QUANTITY = re.compile(
    r"\s*(?P<number>[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
    r"\s*(?P<unit>[^\d\s+\-].*?)?\s*"
)
_EXACT_TIME_S = {
    "ns": Fraction(1, 10**9),
    "us": Fraction(1, 10**6),
    "µs": Fraction(1, 10**6),
    "μs": Fraction(1, 10**6),
    "ms": Fraction(1, 1000),
    "s": Fraction(1),
    "min": Fraction(60),
}
_EXACT_RATE_HZ = {"Hz": Fraction(1), "kHz": Fraction(1000), "MHz": Fraction(10**6)}
_MAX_TEXT = 120
# The only numbers in a unit are exponents of one digit and the 1 of "1/s": anything else might be
# a tower like 9**9**9, and pint would compute all of its millions of digits.
_UNIT_NUMBERS = re.compile(r"(?:\*\*|\^)\s*[-+]?\d(?!\s*(?:[\d.^]|\*\*))|^\s*1\s*/")
# pint skips characters that it cannot read: "mm/s," would be mm/s.
_UNIT_TEXT = re.compile(r"[A-Za-z0-9µμ·²³%*/^()\s.+-]*")
_NUMBER_LEFT = re.compile(r"[\d^]|\*\*")
_DECIMAL_COMMA = re.compile(r"\s*([-+]?\d+),(\d+)\s*(?![\d,.])")
_RUN_TOGETHER = re.compile(r"[A-Za-z0-9 ·/]{2,16}")
_UNIT_NAMES = (
    "kg g km m cm mm um in ft s ms us min N kN mN A mA V kV mV ohm H mH uH W kW J Hz kHz rad deg "
    "rev count tick bit dac bar Pa"
)
USUAL = {"m": "mm", "m/s": "mm/s", "s": "ms", "rad": "deg", "rad/s": "deg/s"}
"""Units that errors propose for a number without a unit: machine parts are given in mm."""
_PIECES = tuple(_UNIT_NAMES.split())
_MOST_CUTS = 50
_SMALLEST_EXACT, _LARGEST_EXACT = 1e-30, 1e30
SMALLEST_MEANINGFUL = 1e-9
"""Smallest SI value with a physical meaning. 1 nm is a thousandth of the finest encoder count, 1 ns
is less than a tick of the fastest timer, and 1 nA is far below the resolution of a converter.
Rounding errors of doubles of a machine's size stay below 1e-12."""


@contextmanager
def _without_dask() -> Iterator[None]:
    """Hide dask while pint is imported: pint would import it to support its arrays.

    Threadline puts no units on dask arrays. A name that is None in ``sys.modules`` counts as
    missing. Dask comes with the extra ``cluster``.
    """
    if "dask" in sys.modules:
        yield
        return
    sys.modules["dask"] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules["dask"]


@cache
def _registry() -> pint.UnitRegistry[Any]:
    with _without_dask():
        import pint  # slow to import, and needed only for unusual units

    registry: pint.UnitRegistry[Any] = pint.UnitRegistry(None)
    registry.load_definitions(_DEFINITIONS.strip().splitlines())
    return registry


def split_quantity(text: str) -> tuple[str, str]:
    """Return the number and the unit of ``text`` as they are written.

    >>> split_quantity("-7.5 in/s")
    ('-7.5', 'in/s')

    Raises
    ------
    UnitError
        If ``text`` does not begin with one decimal number.
    """
    refuse_decimal_comma(text)
    match = _QUANTITY.fullmatch(text) if len(text) <= _MAX_TEXT else None
    if match is None:
        shown = text if len(text) <= _MAX_TEXT else text[:_MAX_TEXT] + "..."
        raise UnitError(
            f"{shown!r} is not a number with a unit", remedy='Write it like "7.5 mm/s".'
        )
    return match["number"], (match["unit"] or "").strip()


def refuse_decimal_comma(text: str) -> None:
    """Refuse a quantity with a decimal comma, such as ``"0,6 ohm"``.

    Raises
    ------
    UnitError
        If the text has a decimal comma; the remedy shows the number with a point.
    """
    match = _DECIMAL_COMMA.match(text[:_MAX_TEXT])
    if match is not None:
        raise UnitError(
            f"{text[:_MAX_TEXT]!r} has a decimal comma", remedy=f"Write {match[1]}.{match[2]}."
        )


def respelt_unit(unit: str, target: str) -> str:
    """Return ``unit`` with missing blanks and carets added; empty if the dimension is wrong.

    ``target`` is a unit of the right dimension.

    >>> respelt_unit("kgcm2", "kg*m^2"), respelt_unit("Nm/A", "N*m/A"), respelt_unit("zz", "m")
    ('kg cm^2', 'N m/A', '')
    >>> respelt_unit("Nms/rad", "N*m*s/rad")
    'N m s/rad'
    """
    if _RUN_TOGETHER.fullmatch(unit) is None:
        return ""
    parts = [_cuts(part.replace("·", " ").replace(" ", "")) for part in unit.split("/")]
    for cut in islice(product(*parts), _MOST_CUTS):
        found = "/".join(" ".join(part) for part in cut)
        if found != unit and same_dimension(found, target):
            return found
    return ""


def _cuts(text: str) -> Iterator[list[str]]:
    """Yield every way to cut ``text`` into known units with exponents."""
    for piece in _PIECES:
        if text.startswith(piece):
            rest = text.removeprefix(piece)
            power = rest[0] if rest[:1] in {"2", "3", "4"} else ""
            named = f"{piece}^{power}" if power else piece
            if rest == power:
                yield [named]
            else:
                yield from ([named, *after] for after in _cuts(rest.removeprefix(power)))


@cache
def unit_factor(unit: str, target: str) -> float:
    """Return the factor from ``unit`` to ``target``, two unit strings of one dimension.

    >>> round(unit_factor("in/s", "m/s"), 10)
    0.0254

    Raises
    ------
    UnitError
        If a unit is unknown or the dimensions differ.
    """
    usual = usual_factor(unit, target)
    if usual is not None:
        if not usual:
            raise _dimension_error(unit, target)
        return usual
    registry = _registry()
    try:
        normal = _normalise(unit)
        if _UNIT_TEXT.fullmatch(unit) is None:
            raise ValueError("a character that no unit contains")
        if _NUMBER_LEFT.search(_UNIT_NUMBERS.sub(" ", normal)):
            raise ValueError("a number that is not an exponent of one digit")
        source = registry.parse_units(normal)
    except Exception as error:  # pint raises a dozen unrelated types on malformed text
        meant = respelt_unit(unit, target)
        hint = f"Did you mean {meant!r}?" if meant else f"Use a unit like {target!r}."
        raise UnitError(f"unknown unit {unit!r}", remedy=hint) from error
    target_unit = registry.parse_units(_normalise(target))
    if source.dimensionality != target_unit.dimensionality:
        raise _dimension_error(unit, target)
    try:
        factor = float(registry.Quantity(1.0, source).to(target_unit).magnitude)
    except ArithmeticError as error:
        raise UnitError(f"the factor from {unit!r} to {target!r} is not a finite number") from error
    if not (math.isfinite(factor) and factor > 0):
        raise UnitError(f"the factor from {unit!r} to {target!r} is not a finite number")
    return factor


def _dimension_error(unit: str, target: str) -> UnitError:
    return UnitError(
        f"{unit!r} does not measure the same quantity as {target!r}"
        if target
        else f"{unit!r} is a unit, but this value is a plain number or a percentage",
        remedy=f"Use a unit like {target!r}." if target else 'Write it like "20 %".',
    )


def _normalise(unit: str) -> str:
    # Engineers write products with a blank or a middle dot; pint takes both once the dot is "*".
    return unit.replace("·", "*").replace("²", "**2").replace("³", "**3").replace("%", "percent")


def parse_quantity(text: str, target: str) -> float:
    """Return the quantity written in ``text`` as a number of ``target`` units.

    >>> round(parse_quantity("7.5 in/s", "m/s"), 6)
    0.1905
    >>> parse_quantity("10 count/tick", "count/tick")
    10.0

    Parameters
    ----------
    text
        A decimal number, a blank and a unit.
    target
        The SI unit that the caller computes in; ``""`` for a plain number.

    Raises
    ------
    UnitError
        If the number is malformed or not finite, or the unit has another dimension.
    """
    number, unit = split_quantity(text)
    value = float(number)
    if not math.isfinite(value):
        raise UnitError(f"{text!r} is not a finite number")
    if not unit and target:
        usual = USUAL.get(target, target)
        raise UnitError(f"{text!r} has no unit", remedy=f'Write it like "{number} {usual}".')
    if unit == target:
        return value
    scaled = value * unit_factor(unit, target)
    if not math.isfinite(scaled):
        raise UnitError(f"{text!r} is too large")
    return scaled


def without_noise(value: float, limit: float | None = None) -> float:
    """Return ``value`` for display: 0 if it is only a rounding error.

    A rounding error is a value below ``SMALLEST_MEANINGFUL``, times ``limit`` if ``limit`` is above
    1: a jerk in the thousands has a larger rounding error.

    >>> without_noise(4.3e-19), without_noise(2e-8), without_noise(-1e-7, 500.0)
    (0.0, 2e-08, 0.0)
    """
    largest = max(1.0, abs(limit or 0.0))
    scale = largest if math.isfinite(largest) else 1.0
    return 0.0 if abs(value) < SMALLEST_MEANINGFUL * scale else value


def same_dimension(unit: str, target: str) -> bool:
    """Return whether two unit strings have the same dimension."""
    try:
        unit_factor(unit, target)
    except UnitError:
        return False
    return True


def parse_exact_time_s(text: str) -> Fraction:
    """Return a time, or the period of a rate, as an exact fraction of a second.

    >>> parse_exact_time_s("136 us"), parse_exact_time_s("16 MHz")
    (Fraction(17, 125000), Fraction(1, 16000000))

    Raises
    ------
    UnitError
        If it is neither a time nor a rate, or not positive.
    """
    number, unit = split_quantity(text)
    if not _SMALLEST_EXACT <= float(number) <= _LARGEST_EXACT:
        # Checked before making the fraction: 1e999999999 would have a billion digits.
        limit = "greater than zero" if float(number) <= 0 else "from 1e-30 to 1e30"
        raise UnitError(f"{text!r} must be {limit}")
    exact = Fraction(number)
    if unit in _EXACT_TIME_S:
        return exact * _EXACT_TIME_S[unit]
    if unit in _EXACT_RATE_HZ:
        return 1 / (exact * _EXACT_RATE_HZ[unit])
    raise UnitError(f"{text!r} is neither a time nor a rate", remedy='Write it like "5 ms".')


def parse_number(subject: str, text: str, unit: str, example: str) -> float:
    """Return the value of an option as a number of ``unit``.

    Parameters
    ----------
    subject
        Name of the option in errors.
    text
        The number with its unit.
    unit
        The SI unit wanted; ``""`` for a plain number.
    example
        A valid value, shown in the remedy.

    Raises
    ------
    OptionError
        If it is not a quantity of that dimension.
    """
    try:
        return parse_quantity(text, unit)
    except UnitError as error:
        raise OptionError(
            f"{subject} {text!r}: {error.message}", remedy=f'Write it like "{example}".'
        ) from error
