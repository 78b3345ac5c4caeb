"""The keys of a product file: their lines, numbers and refusals."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

from threadline.base.wording import nearest
from threadline.errors import JobError, Place, UnitError
from threadline.units import parse_quantity

_FARTHEST = 1e4  # m, and tex
_LIKE = {"tex": "2400", "fibre_volume": "60 %"}
_NOT_NEGATIVE = ("thickness", "tex", "take_up", "clearance", "gap")
TABLES: Mapping[str, tuple[str, ...]] = {
    "": (
        "name",
        "mandrel",
        "part",
        "boss",
        "pin",
        "band",
        "friction",
        "fibre",
        "coverage",
        "material",
        "cost",
    ),
    "mandrel": ("at", "radius_error", "edge", "shaft", "slip"),
    "boss": ("at", "length", "radius"),
    "pin": ("at", "radius", "diameter"),
    "band": ("width", "thickness", "tex", "material", "fibre_volume"),
    "friction": ("value",),
    "fibre": ("tied", "take_up", "clearance", "envelope", "speed", "tolerance", "tension", "taper"),
    "coverage": ("begin", "end", "gap"),
    "cost": ("hour",),
}
_LISTS = ("part", "boss", "pin", "layer", "material")
_NUMBER = re.compile(r"(?P<value>.+?)(?:\s*(?:\+-|\+/-|±)\s*(?P<tolerance>.+))?")


@dataclass(frozen=True, slots=True)
class Toleranced:
    """A number in SI with the half width of its tolerance."""

    si: float
    tolerance: float = 0.0


@dataclass(slots=True)
class KeyReader:
    """Reads keys of a product file; knows the line of each key while the file is there."""

    file: str
    written: str
    text: str = ""
    table: str = ""
    index: int = -1

    def refuse(self, key: str, message: str, remedy: str) -> NoReturn:
        """Raise a ``JobError`` at the line of a key."""
        raise JobError(message, place=Place(self.file, self.line_of(key)), remedy=remedy)

    def line_of(self, key: str) -> int:
        """Return the line of a key in the present table, of the table without it, or 0."""
        table, header, count = "", 0, dict.fromkeys(_LISTS, -1)
        for number, row in enumerate(self.written.splitlines(), start=1):
            opened = re.match(r"\s*\[\[?\s*([A-Za-z_]+)\s*\]", row)
            if opened:
                table = opened[1]
                if table in count:
                    count[table] += 1
            here = table == self.table and (table not in _LISTS or count[table] == self.index)
            if here and opened:
                header = number
            if here and re.match(rf"\s*{re.escape(key)}\s*=", row):
                return number
        return header

    def known(self, content: Mapping[str, Any], keys: Sequence[str]) -> None:
        """Refuse a table with another key than ``keys``."""
        for key in content:
            if key not in keys:
                self.refuse(key, f"unknown key {key[:60]!r}", nearest(key, keys))

    def table_of(self, content: Mapping[str, Any], name: str) -> Mapping[str, Any]:
        """Return a table of the file, empty without it; its keys are read from now on."""
        self.table = name
        found = content.get(name, {})
        if not isinstance(found, dict):
            self.table = ""
            self.refuse(name, f"{name} must be a table", f"Write [{name}].")
        self.known(found, TABLES[name])
        return found

    def number(
        self, content: Mapping[str, Any], key: str, unit: str, default: str | None
    ) -> Toleranced:
        """Return the number of a key of the present table, in SI; None as default: it must be."""
        text = content.get(key, default)
        usual = _LIKE.get(key, "0.25 +- 0.05" if not unit else "5 mm +- 0.3 mm")
        like = f'Write {key} = "{usual}".'
        if text is None:
            self.refuse(key, f"{self.table}.{key} is missing", like)
        if not unit and isinstance(text, int | float) and not isinstance(text, bool):
            text = repr(text)
        if not isinstance(text, str):
            self.refuse(key, f"{key} = {str(text)[:60]!r} is not a quantity", like)
        match = _NUMBER.fullmatch(text.strip())
        try:
            if match is None:
                raise UnitError("there is not a number")
            value = parse_quantity(match["value"].strip(), unit)
            spread = (match["tolerance"] or "").strip()
            if spread.endswith("%"):
                around = abs(value) * parse_quantity(spread, "")
            else:
                around = parse_quantity(spread, unit) if spread else 0.0
        except UnitError as error:
            self.refuse(key, f"{key}: {error.message}", like)
        if abs(value) > _FARTHEST or not 0.0 <= around <= _FARTHEST:
            self.refuse(key, f"{key} = {text[:60]!r} is out of reach", like)
        if value < 0.0 and key in _NOT_NEGATIVE:
            self.refuse(key, f"{key} = {text[:60]!r} is below 0", like)
        return Toleranced(value, around)
