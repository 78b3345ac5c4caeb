"""Reader of the keys of a product file, with the lines for errors, and of its mandrel's parts."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.wording import nearest
from threadline.errors import JobError, Place, UnitError, placed
from threadline.units import parse_quantity
from threadline.winding.meridians import shifted, stretches_of
from threadline.winding.shapes import ellipse, isotensoid, nose, table
from threadline.winding.surface import Stretch, Surface, line, surface_of

_LARGEST = 1e4  # m, and tex
_EXAMPLES = {"tex": "2400", "fibre_volume": "60 %"}
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
_LEAST_M = 1e-6  # least size of a part
_PARTS: Mapping[str, tuple[str, ...]] = {
    "cylinder": ("radius", "length"),
    "cone": ("radius", "end_radius", "length"),
    "hemisphere": ("radius", "opening", "pole"),
    "ellipsoid": ("radius", "height", "opening", "pole"),
    "isotensoid": ("radius", "opening", "pole"),
    "nose": ("radius", "height", "opening", "pole"),
    "table": ("file", "layer"),
}


@dataclass(frozen=True, slots=True)
class Toleranced:
    """A number in SI with the half width of its tolerance."""

    si: float
    tolerance: float = 0.0


@dataclass(slots=True)
class KeyReader:
    """Reads keys of a product file; errors name the line of a key if the text is given."""

    file: str
    written: str
    text: str = ""
    table: str = ""
    index: int = -1

    def refuse(self, key: str, message: str, remedy: str) -> NoReturn:
        """Raise a ``JobError`` at the line of a key."""
        raise JobError(message, place=Place(self.file, self.line_of(key)), remedy=remedy)

    def line_of(self, key: str) -> int:
        """Return the line of a key in the present table; else the line of the table; else 0."""
        table, header, count = "", 0, dict.fromkeys(_LISTS, -1)
        for number, row in enumerate(self.written.splitlines(), start=1):
            table_header = re.match(r"\s*\[\[?\s*([A-Za-z_]+)\s*\]", row)
            if table_header:
                table = table_header[1]
                if table in count:
                    count[table] += 1
            in_table = table == self.table and (table not in _LISTS or count[table] == self.index)
            if in_table and table_header:
                header = number
            if in_table and re.match(rf"\s*{re.escape(key)}\s*=", row):
                return number
        return header

    def known(self, content: Mapping[str, Any], keys: Sequence[str]) -> None:
        """Refuse a table with another key than ``keys``."""
        for key in content:
            if key not in keys:
                self.refuse(key, f"unknown key {key[:60]!r}", nearest(key, keys))

    def table_of(self, content: Mapping[str, Any], name: str) -> Mapping[str, Any]:
        """Return a table of the file, empty if it is missing; it becomes the present table."""
        self.table = name
        member = content.get(name, {})
        if not isinstance(member, dict):
            self.table = ""
            self.refuse(name, f"{name} must be a table", f"Write [{name}].")
        self.known(member, TABLES[name])
        return member

    def number(
        self, content: Mapping[str, Any], key: str, unit: str, default: str | None
    ) -> Toleranced:
        """Return a number of the present table, in SI; with the default None it is required."""
        text = content.get(key, default)
        usual = _EXAMPLES.get(key, "0.25 +- 0.05" if not unit else "5 mm +- 0.3 mm")
        example = f'Write {key} = "{usual}".'
        if text is None:
            self.refuse(key, f"{self.table}.{key} is missing", example)
        if not unit and isinstance(text, int | float) and not isinstance(text, bool):
            text = repr(text)
        if not isinstance(text, str):
            self.refuse(key, f"{key} = {str(text)[:60]!r} is not a quantity", example)
        match = _NUMBER.fullmatch(text.strip())
        try:
            if match is None:
                raise UnitError("there is not a number")
            value = parse_quantity(match["value"].strip(), unit)
            written_tolerance = (match["tolerance"] or "").strip()
            if written_tolerance.endswith("%"):
                tolerance = abs(value) * parse_quantity(written_tolerance, "")
            else:
                tolerance = parse_quantity(written_tolerance, unit) if written_tolerance else 0.0
        except UnitError as error:
            self.refuse(key, f"{key}: {error.message}", example)
        if abs(value) > _LARGEST or not 0.0 <= tolerance <= _LARGEST:
            self.refuse(key, f"{key} = {text[:60]!r} is out of reach", example)
        if value < 0.0 and key in _NOT_NEGATIVE:
            self.refuse(key, f"{key} = {text[:60]!r} is below 0", example)
        return Toleranced(value, tolerance)


class MandrelReader(KeyReader):
    """Reads the mandrel of a product file."""

    def surface(self, parts: Sequence[Mapping[str, Any]], edge: float) -> Surface:
        """Return the surface of parts that follow each other; ``edge`` rounds its corners, m."""
        chain: list[Stretch] = []
        for index, part in enumerate(parts):
            self.index = index
            embedded = next((key for key in ("points", "section") if key in part), None)
            kind = part.get("kind", "table" if embedded else None)
            if not isinstance(kind, str) or kind not in _PARTS:
                self.refuse("kind", f"a part of the kind {kind!r}"[:80], nearest(str(kind), _PARTS))
            keys = (embedded,) if kind == "table" and embedded else _PARTS[kind]
            self.known(part, ("kind", *keys))
            x = 0.0 if not chain else float(chain[-1].x[-1, 0])
            stretches = self._part(kind, part, x)
            if chain:
                end_radius, begin_radius = float(chain[-1].r[-1, 0]), float(stretches[0].r[0, 0])
                if abs(end_radius - begin_radius) > 1e-6:
                    self.refuse(
                        "radius",
                        f"the mandrel is open at x = {1e3 * x:.6g} mm: a part ends with radius "
                        f"{1e3 * end_radius:.6g} mm, and the next begins with "
                        f"{1e3 * begin_radius:.6g} mm",
                        "Let each part begin with the radius at which the one before it ends.",
                    )
            chain += stretches
        self.index = len(parts) - 1
        with placed(Place(self.file, self.line_of(""))):
            return surface_of(chain, edge)

    def _part(self, kind: str, part: Mapping[str, Any], x: float) -> list[Stretch]:
        if kind == "table" and "section" in part:
            stretches = stretches_of(part["section"])
            if stretches is None:
                self.refuse(
                    "section",
                    "the section of this product is damaged",
                    "Give the product file again with --product.",
                )
            return shifted(stretches, x)
        if kind == "table":
            points = self._table_points(part.get("points"))
            points[:, 0] += x - points[0, 0]
            return table(points)
        sizes = {}
        for key in _PARTS[kind]:
            if key == "pole":
                continue
            sizes[key] = self.number(part, key, "m", None).si
            if sizes[key] < _LEAST_M:
                self.refuse(
                    key,
                    f"{key} = {1e3 * sizes[key]:g} mm: the mandrel would reach its axis"
                    if "radius" in key or key == "opening"
                    else f"{key} = {1e3 * sizes[key]:g} mm, the least is {1e3 * _LEAST_M:g} mm",
                    f'Write {key} = "50 mm".',
                )
        radius = sizes["radius"]
        if kind == "cylinder":
            return [line(x, radius, x + sizes["length"], radius)]
        if kind == "cone":
            return [line(x, radius, x + sizes["length"], sizes["end_radius"])]
        pole = part.get("pole")
        if pole not in ("left", "right"):
            self.refuse("pole", f"pole = {pole!r}", 'Write pole = "left" or pole = "right".')
        left, opening = pole == "left", sizes["opening"]
        largest_opening = radius / math.sqrt(1.5) if kind == "isotensoid" else radius
        if opening >= 0.999 * largest_opening:
            self.refuse(
                "opening",
                f"the opening of {1e3 * opening:g} mm is too large for a radius of "
                f"{1e3 * radius:g} mm",
                f"It must be below {1e3 * largest_opening:.4g} mm.",
            )
        height = sizes.get("height", radius)
        # With the pole on the left the equator comes last: shift the part to begin at x.
        shift = 0.0
        for _ in range(2):
            if kind == "isotensoid":
                made = isotensoid(x - shift, radius, opening, left=left)
            elif kind == "nose":
                made = nose(x - shift, radius, height, opening, left=left)
            else:
                made = [ellipse(x - shift, radius, height, opening, left=left)]
            shift = float(made[0].x[0, 0]) - x
        return made

    def _table_points(self, points: Any) -> FloatArray:
        try:
            array = np.array(points, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.ndim != 2 or array.shape[1:] != (2,) or len(array) < 2:
            self.refuse("file", "a table needs a file", 'Write file = "meridian.csv".')
        if not (np.isfinite(array).all() and (np.diff(array[:, 0]) > 0.0).all()):
            self.refuse(
                "file",
                "the points of a meridian must go from left to right",
                "Sort the rows of the table by x_mm.",
            )
        return array
