"""A number in a machine file: value, unit, tolerance and provenance in one readable string.

``"4 kg +- 5 %, printed: section 6.2"`` or ``"5 ms exact, printed"``.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from typing import Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import core_schema

from threadline.errors import UnitError
from threadline.units import (
    parse_exact_time_s,
    parse_quantity,
    refuse_decimal_comma,
    respelt_unit,
    same_dimension,
    split_quantity,
)

LEAST_SI, MOST_SI = 1e-15, 1e15
"""Smallest and largest magnitude of a number that is not 0."""
_MOST_PARTS = 10**18
_SHOWN = 120
_FORM = re.compile(
    r"(?P<value>[^,]+?)\s+(?:exact|(?:\+-|\+/-|±)\s*(?P<tolerance>[^,]+?))\s*,\s*"
    r"(?P<provenance>printed|checked|assumed|measured)(?:\s*:\s*(?P<note>.+))?",
    re.DOTALL,
)
_EXAMPLE = 'Write it like "4 kg +- 5 %, printed: section 6.2" or "5 ms exact, assumed".'
_TOLERANCE = re.compile(r"(?:\s|^)exact\b|\+-|\+/-|±")


class Provenance(StrEnum):
    """Source of a number."""

    PRINTED = "printed"
    CHECKED = "checked"
    ASSUMED = "assumed"
    MEASURED = "measured"


_WORDS = f"{', '.join(list(Provenance)[:-1])} or {list(Provenance)[-1]}"


@dataclass(frozen=True, slots=True)
class Quantity:
    """A number of the machine, in SI.

    Parameters
    ----------
    si
        Value in ``unit``.
    unit
        SI unit; empty for a number without unit.
    tolerance_si
        Half width of the interval that contains the true value, in ``unit``.
    provenance, note
        Kind of source of the number, and the source.
    exact_s
        A time as an exact fraction of a second; None for every other number.
    """

    si: float
    unit: str
    tolerance_si: float
    provenance: Provenance
    note: str = ""
    exact_s: Fraction | None = None

    @property
    def least(self) -> float:
        """Lower end of the tolerance interval."""
        return self.si - self.tolerance_si

    @property
    def most(self) -> float:
        """Upper end of the tolerance interval."""
        return self.si + self.tolerance_si


def parse_machine_quantity(text: str, units: tuple[str, ...]) -> Quantity:
    """Return the quantity in ``text``; its dimension must match one of ``units``.

    >>> q = parse_machine_quantity("4 kg +- 5 %, printed: section 6.2", ("kg",))
    >>> q.si, round(q.tolerance_si, 12), q.provenance.value, q.note
    (4.0, 0.2, 'printed', 'section 6.2')

    Raises
    ------
    UnitError
        If the form, the unit or the tolerance is wrong.
    """
    match = _FORM.fullmatch(text.strip())
    if match is None:
        raise _faulty(text)
    written = match["value"]
    unit = _matching_unit(written, units)
    value = parse_quantity(written, unit)
    exact_s = parse_exact_time_s(written) if unit == "s" and value > 0 else None
    tolerance = match["tolerance"]
    if tolerance is None:
        tolerance_si = 0.0
    elif tolerance.rstrip().endswith("%"):
        tolerance_si = abs(value) * parse_quantity(tolerance, "")
    else:
        tolerance_si = parse_quantity(tolerance, unit)
    if tolerance_si < 0:
        raise UnitError(f"{text!r}: the tolerance is negative", remedy=_EXAMPLE)
    return Quantity(
        si=value,
        unit=unit,
        tolerance_si=tolerance_si,
        provenance=Provenance(match["provenance"]),
        note=(match["note"] or "").strip(),
        exact_s=exact_s,
    )


def _check_size(text: str, quantity: Quantity) -> None:
    """Refuse numbers so large or small that their squares and ratios would overflow.

    Raises
    ------
    ValueError
        If the number is too large or small, or a time has too many digits.
    """
    magnitude, tolerance_si = abs(quantity.si), quantity.tolerance_si
    if magnitude > MOST_SI or tolerance_si > MOST_SI or 0.0 < magnitude < LEAST_SI:
        raise ValueError(
            f"{text[:_SHOWN]!r} is {quantity.si:g} in SI units; a machine's numbers are 0 or from "
            f"{LEAST_SI:g} to {MOST_SI:g}."
        )
    exact_s = quantity.exact_s
    if exact_s is not None and exact_s.denominator > _MOST_PARTS:
        raise ValueError(
            f"{text[:_SHOWN]!r} has too many digits for a time: the finest part of a "
            f"second is 1/{_MOST_PARTS:.0e}. Give fewer digits."
        )


def _faulty(text: str) -> UnitError:
    """Return the error for a text that is not a quantity; it names the missing parts."""
    refuse_decimal_comma(text)
    head, _, tail = text.partition(",")
    tolerance = _TOLERANCE.search(head)
    if tolerance is not None:
        refuse_decimal_comma(text[tolerance.end() :])
    provenance = tail.partition(":")[0].strip()
    missing_parts = [] if tolerance else ["no tolerance"]
    if provenance not in list(Provenance):
        # The comma before it, or the colon after it, may be missing.
        missing_parts.append(
            "no provenance" if not provenance else f"no provenance but {provenance[:40]!r}"
        )
    return UnitError(
        f"{text!r} has {' and '.join(missing_parts) or 'another form'}",
        remedy=f"The provenance is {_WORDS}. {_EXAMPLE}",
    )


def _matching_unit(written: str, units: tuple[str, ...]) -> str:
    _, written_unit = split_quantity(written)
    for unit in units:
        if (not written_unit and not unit) or (written_unit and same_dimension(written_unit, unit)):
            return unit
    meant_unit = next(filter(None, (respelt_unit(written_unit, unit) for unit in units)), "")
    if meant_unit:
        raise UnitError(f"unknown unit {written_unit!r}", remedy=f"Did you mean {meant_unit!r}?")
    allowed_units = " or ".join(repr(unit) if unit else "a plain number" for unit in units)
    raise UnitError(f"{written!r} is not in {allowed_units}", remedy=f"Give it in {allowed_units}.")


@dataclass(frozen=True, slots=True)
class Units:
    """Annotation of a field of the machine model: its SI units and its allowed values.

    A ``positive`` number must be above 0 over its whole tolerance. A ``certain`` number must be
    either exactly 0 or above 0 over its whole tolerance. ``most`` is the largest value.
    """

    units: tuple[str, ...]
    positive: bool = False
    not_negative: bool = False
    certain: bool = False
    whole: bool = False
    most: float = math.inf

    def __get_pydantic_core_schema__(
        self, source: Any, handler: GetCoreSchemaHandler
    ) -> core_schema.CoreSchema:
        """Let pydantic parse a string of the machine file into a ``Quantity``."""
        return core_schema.no_info_plain_validator_function(
            self._read, json_schema_input_schema=core_schema.str_schema()
        )

    def __get_pydantic_json_schema__(
        self, _schema: core_schema.CoreSchema, _handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        """Add the units to the JSON schema, as ``x-units``."""
        return {"type": "string", "x-units": list(self.units)}

    def _read(self, value: Any) -> Quantity:
        if isinstance(value, Quantity):
            return value
        if not isinstance(value, str):
            raise ValueError(f"{value!r} has no unit, tolerance and provenance. {_EXAMPLE}")
        try:
            quantity = parse_machine_quantity(value, self.units)
        except UnitError as error:
            raise ValueError(f"{error.message}. {error.remedy}".strip()) from error
        _check_size(value, quantity)
        if self.positive and quantity.si <= 0:
            raise ValueError(f"{value!r} must be greater than zero.")
        if self.not_negative and quantity.si < 0:
            raise ValueError(f"{value!r} must not be negative.")
        if (self.positive or self.certain) and 0 < quantity.si <= quantity.tolerance_si:
            raise ValueError(
                f"{value!r} would not be above zero at the lower end of its tolerance. "
                "Give a tolerance below 100 %."
            )
        if self.whole and not quantity.si.is_integer():
            raise ValueError(f"{value!r} must be a whole number.")
        if quantity.si > self.most:
            raise ValueError(f"{value!r} must be at most {self.most:g}.")
        return quantity
