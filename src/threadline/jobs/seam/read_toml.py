"""Seam files (``.seam.toml``): the drawing, its seams, and their settings."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from threadline.base.wording import nearest, toml_fault
from threadline.errors import JobError, Place, UnitError
from threadline.geometry.contours import CONTOUR_KEYS, written_contour
from threadline.geometry.strokes import Drawing, Stroke, decode_text
from threadline.jobs.seam.settings import STITCHING_KEYS
from threadline.units import parse_quantity, unit_factor

MAX_TOML_BYTES = 64 * 1024 * 1024
DRAWING_KEYS = ("file", "unit", "gap", "origin", "by")
SEAM_KEYS = ("name", "layer", "colour")
"""Keys of the drawing, and of a seam besides ``STITCHING_KEYS``."""
DEFAULT_GAP_M = 1e-5


@dataclass(frozen=True, slots=True, kw_only=True)
class SeamChoice:
    """The layer and colour of a seam's strokes (None: any), and the seam's own settings."""

    name: str
    layer: str | None = None
    colour: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    places: Mapping[str, Place] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeamFile:
    """The content of a seam file.

    ``drawing`` is the name of a drawing, or the contours in the seam file itself. Without
    ``choices``, ``by`` decides: each ``layer`` or ``colour`` is a seam, or ``all`` strokes form one
    seam.
    """

    drawing: str | Drawing
    drawing_line: int = 0
    unit: str | None = None
    gap_m: float = DEFAULT_GAP_M
    origin_m: tuple[float, float] = (0.0, 0.0)
    by: str = "layer"
    settings: Mapping[str, Any] = field(default_factory=dict)
    places: Mapping[str, Place] = field(default_factory=dict)
    choices: tuple[SeamChoice, ...] = ()


def read_seam_file(content: bytes, file: str) -> SeamFile:
    """Return the content of a seam file.

    Raises
    ------
    JobError
        If the file is not TOML or not a seam file; the error gives the line.
    """
    text = decode_text(content, file, "seam file")
    try:
        table = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        what, line = toml_fault(error, text)
        raise JobError(what, place=Place(file, line), remedy="Correct that line.") from error
    reader = _Reader(file, _lines(text))
    return reader.seam_file(table)


def _lines(text: str) -> dict[tuple[str | int, ...], int]:
    """Return the line of every table and key; ``("seam", 1, "layer")`` is in the second seam."""
    line_of: dict[tuple[str | int, ...], int] = {}
    counts: dict[str, int] = {}
    table: tuple[str | int, ...] = ()
    for number, line in enumerate(text.splitlines(), start=1):
        header = re.match(r"\s*(\[\[?)\s*([A-Za-z_]+)\s*\]\]?\s*(?:#.*)?$", line)
        key = re.match(r"\s*([A-Za-z_]+)\s*=", line)
        if header:
            table = (header[2],)
            if header[1] == "[[":
                counts[header[2]] = counts.get(header[2], -1) + 1
                table = (header[2], counts[header[2]])
            line_of[table] = number
        elif key:
            line_of.setdefault((*table, key[1]), number)
    return line_of


@dataclass(frozen=True, slots=True)
class _Reader:
    file: str
    lines: Mapping[tuple[str | int, ...], int]

    def place(self, *location: str | int) -> Place:
        while location and location not in self.lines:
            location = location[:-1]
        return Place(self.file, self.lines.get(location, 0))

    def seam_file(self, table: dict[str, Any]) -> SeamFile:
        for key in table:
            if key not in ("drawing", "stitching", "seam", "contour"):
                raise JobError(
                    f"unknown key {key!r}",
                    place=self.place(key),
                    remedy=nearest(key, ("drawing", "stitching", "seam", "contour")),
                )
        drawing = self._table(table.get("drawing", {}), DRAWING_KEYS, "drawing")
        contours = self._tables(table.get("contour", []), "contour")
        if "file" in drawing and contours:
            raise JobError(
                "a seam file has either [drawing] file or [[contour]] tables, this one has both",
                place=self.place("drawing"),
                remedy="Take one of them out.",
            )
        if "file" not in drawing and not contours:
            raise JobError(
                "the file has neither [drawing] file = ... nor [[contour]] tables, so it has no "
                "line to sew",
                place=self.place("drawing"),
                remedy='Name a drawing, like [drawing] file = "collar.dxf", or give '
                '[[contour]] unit = "mm" and points = [[0, 0], [30, 0]].',
            )
        settings = self._table(table.get("stitching", {}), STITCHING_KEYS, "stitching")
        unit = self._text(drawing, "unit", "drawing")
        by = self._text(drawing, "by", "drawing") or "layer"
        if by not in ("layer", "colour", "all"):
            raise JobError(
                f"by is {by!r}",
                place=self.place("drawing", "by"),
                remedy="Use layer, colour or all.",
            )
        return SeamFile(
            drawing=self._text(drawing, "file", "drawing") or self._drawing(contours, unit),
            drawing_line=self.place("drawing", "file").line,
            unit=unit,
            gap_m=self._gap(drawing),
            origin_m=self._origin(drawing.get("origin", ["0 mm", "0 mm"])),
            by=by,
            settings=settings,
            places={key: self.place("stitching", key) for key in settings},
            choices=tuple(
                self._choice(seam, k)
                for k, seam in enumerate(self._tables(table.get("seam", []), "seam"))
            ),
        )

    def _table(self, table: Any, known: tuple[str, ...], *location: str | int) -> dict[str, Any]:
        if not isinstance(table, dict):
            raise JobError(f"{location[0]} must be a table", place=self.place(*location))
        for key in table:
            if key not in known:
                raise JobError(
                    f"unknown key {key!r}",
                    place=self.place(*location, key),
                    remedy=nearest(key, known),
                )
        return table

    def _tables(self, tables: Any, name: str) -> list[Any]:
        if not isinstance(tables, list):
            raise JobError(f"write [[{name}]], not [{name}]", place=self.place(name))
        return tables

    def _text(self, table: dict[str, Any], key: str, *location: str | int) -> str | None:
        value = table.get(key)
        if value == "":
            raise JobError(
                f"the key {key!r} has an empty text",
                place=self.place(*location, key),
                remedy="Write a text between the quotes, or take the key out.",
            )
        if value is not None and not isinstance(value, str):
            raise JobError(f"{key} is {value!r}, not a text", place=self.place(*location, key))
        return value

    def _length(self, text: Any, what: str, place: Place) -> float:
        if not isinstance(text, str):
            raise JobError(f"{what} is {text!r}", place=place, remedy='Write it like "0.01 mm".')
        try:
            return parse_quantity(text, "m")
        except UnitError as error:
            raise JobError(f"{what}: {error.message}", place=place, remedy=error.remedy) from error

    def _gap(self, drawing: dict[str, Any]) -> float:
        place = self.place("drawing", "gap")
        gap_m = self._length(drawing.get("gap", "0.01 mm"), "gap", place)
        if not 1e-9 <= gap_m <= 0.01:
            raise JobError(
                f"gap is {drawing['gap']!r}; it lies between 1 nm and 10 mm", place=place
            )
        return gap_m

    def _origin(self, origin: Any) -> tuple[float, float]:
        place = self.place("drawing", "origin")
        if not isinstance(origin, list) or len(origin) != 2:
            raise JobError('origin is like ["10 mm", "20 mm"]', place=place)
        x, y = (self._length(part, "origin", place) for part in origin)
        return x, y

    def _choice(self, seam: Any, k: int) -> SeamChoice:
        table = self._table(seam, (*SEAM_KEYS, *STITCHING_KEYS), "seam", k)
        layer = self._text(table, "layer", "seam", k)
        colour = self._text(table, "colour", "seam", k)
        settings = {key: value for key, value in table.items() if key not in SEAM_KEYS}
        return SeamChoice(
            name=self._text(table, "name", "seam", k) or layer or colour or f"seam {k + 1}",
            layer=layer,
            colour=None if colour is None else colour.lower(),
            settings=settings,
            places={
                key: self.place("seam", k, key) for key in [*settings, "name", "layer", "colour"]
            },
        )

    def _drawing(self, contours: list[Any], unit: str | None) -> Drawing:
        strokes = []
        for k, contour in enumerate(contours):
            table = self._table(contour, CONTOUR_KEYS, "contour", k)
            place = self.place("contour", k, "points")
            contour_unit = self._text(table, "unit", "contour", k) or unit
            if contour_unit is None:
                raise JobError(
                    "the contour has no unit", place=place, remedy='Add unit = "mm" to it.'
                )
            try:
                pieces = written_contour(table, unit_factor(contour_unit, "m"), place.line)
            except (ValueError, TypeError) as error:
                message = getattr(error, "message", str(error))
                raise JobError(f"contour {k + 1}: {message}", place=place) from error
            layer = self._text(table, "layer", "contour", k) or ""
            strokes.append(Stroke(pieces=pieces, layer=layer, colour="none"))
        return Drawing(file=self.file, strokes=tuple(strokes))
