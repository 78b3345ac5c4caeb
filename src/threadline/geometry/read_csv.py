"""Reader of drawings in tables: a point per row, and arcs by bulge or centre.

The first row has the names of the columns with their units: ``x [mm], y [mm], bulge``. The columns
are ``x`` and ``y``; for the segment after the point ``bulge``, or ``cx``, ``cy`` and ``turn`` (ccw
or cw); and ``layer``. A blank row ends a contour. Separators are commas, semicolons or tabs; with
semicolons or tabs a decimal comma is allowed. A row that begins with # is a comment.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError, Place, UnitError
from threadline.geometry.contours import centre_segment
from threadline.geometry.curves import Pieces, bulges, chords, join_pieces
from threadline.geometry.strokes import Drawing, Stroke, decode_text
from threadline.units import unit_factor

_COLUMN = re.compile(r"([a-zA-Z]+)\s*(?:[\[(]\s*([a-zA-Z]+)\s*[\])])?")
_LENGTHS = ("x", "y", "cx", "cy")
COLUMNS = (*_LENGTHS, "bulge", "turn", "layer")
"""Columns that a table of points may have."""
_EXAMPLE = 'Begin the file with a row like "x [mm], y [mm], bulge".'


def read_csv(content: bytes, file: str, unit: str | None = None) -> Drawing:
    """Return the contours of a table of points.

    Parameters
    ----------
    content, file
        The bytes of the file, and its name for messages.
    unit
        Unit of columns without a unit.

    Raises
    ------
    JobError
        If it is not such a table; names the line.
    """
    text = decode_text(content, file, "table")
    rows = _rows(text, file)
    try:
        number, heading, separator = next(rows)
    except StopIteration:
        raise JobError("the table has no rows", place=Place(file), remedy=_EXAMPLE) from None
    columns = _columns(heading, unit, Place(file, number))
    strokes: list[Stroke] = []
    contour: list[tuple[int, list[str]]] = []
    for number, cells, _ in rows:
        if any(cells):
            contour.append((number, cells))
        elif contour:
            strokes.append(_stroke(contour, columns, separator, file))
            contour = []
    if contour:
        strokes.append(_stroke(contour, columns, separator, file))
    if not strokes:
        raise JobError("the table has no points", place=Place(file), remedy=_EXAMPLE)
    return Drawing(file=file, strokes=tuple(strokes))


def _rows(text: str, file: str) -> Iterator[tuple[int, list[str], str]]:
    """Yield line number, cells and separator of every row; blank rows have no cells."""
    heading_line = next(
        (line for line in text.splitlines() if line.strip() and line.strip()[0] != "#"), ""
    )
    separator = next((s for s in (";", "\t") if s in heading_line), ",")
    reader = csv.reader(text.splitlines(), delimiter=separator)
    started = False
    try:
        for cells in reader:
            stripped = [cell.strip() for cell in cells]
            started = started or any(stripped)
            if started and not (stripped and stripped[0].startswith("#")):
                yield reader.line_num, stripped, separator
    except csv.Error as error:
        raise JobError(f"not a table: {error}", place=Place(file, reader.line_num)) from error


def _columns(heading: list[str], unit: str | None, place: Place) -> list[tuple[str, float]]:
    """Return the name of every column and its factor to m (or 1)."""
    columns: list[tuple[str, float]] = []
    for cell in heading:
        match = _COLUMN.fullmatch(cell)
        name = match[1].lower() if match else ""
        if match is None or name not in COLUMNS:
            raise JobError(
                f"unknown column {cell[:40]!r}",
                place=place,
                remedy=f"Columns are {', '.join(COLUMNS)}. {_EXAMPLE}",
            )
        factor = 1.0
        if name in _LENGTHS:
            column_unit = match[2] or unit
            if column_unit is None:
                raise JobError(f"column {name!r} has no unit", place=place, remedy=_EXAMPLE)
            try:
                factor = unit_factor(column_unit, "m")
            except UnitError as error:
                raise JobError(f"column {name!r}: {error.message}", place=place) from error
        columns.append((name, factor))
    names = [name for name, _ in columns]
    if len(set(names)) < len(names):
        raise JobError("two columns have the same name", place=place, remedy=_EXAMPLE)
    for required in ("x", "y"):
        if required not in names:
            raise JobError(f"no column {required!r}", place=place, remedy=_EXAMPLE)
    if ("cx" in names) != ("cy" in names) or ("cx" in names) != ("turn" in names):
        raise JobError("an arc by its centre needs the columns cx, cy and turn", place=place)
    return columns


def _stroke(
    rows: list[tuple[int, list[str]]], columns: list[tuple[str, float]], separator: str, file: str
) -> Stroke:
    for number, cells in rows:
        if len(cells) != len(columns):
            raise JobError(
                f"the row has {len(cells)} cells, the heading {len(columns)}",
                place=Place(file, number),
            )
    line_numbers = [number for number, _ in rows]
    if len(rows) < 2:
        raise JobError(
            "a contour has one point only",
            place=Place(file, line_numbers[0]),
            remedy="Give it two or more points; a blank row ends a contour.",
        )
    text: dict[str, list[str]] = {}
    value: dict[str, FloatArray] = {}
    for k, (name, factor) in enumerate(columns):
        cells = [row[k] for _, row in rows]
        if name in ("turn", "layer"):
            text[name] = cells
        else:
            value[name] = factor * _numbers(name, cells, line_numbers, separator, file)
    layer = _layer(text.get("layer", [""]), line_numbers, file)
    points = np.column_stack([value["x"], value["y"]])
    _refuse_unfinished(points, line_numbers, file)
    if "cx" in value and np.isfinite(value["cx"]).any():
        pieces = _arcs(points, value["cx"], value["cy"], text["turn"], line_numbers, file)
    else:
        bulge = np.nan_to_num(value.get("bulge", np.zeros(len(points))), nan=0.0)
        pieces = bulges(points, bulge[:-1], np.array(line_numbers[:-1]))
    return Stroke(pieces=pieces, layer=layer, colour="none")


def _numbers(
    name: str, cells: list[str], line_numbers: list[int], separator: str, file: str
) -> FloatArray:
    """Return a column; blank cells are NaN."""
    if separator != ",":
        cells = [cell.replace(",", ".") for cell in cells]
    try:
        values = np.array([cell or "nan" for cell in cells]).astype(np.float64)
    except ValueError:
        values = np.array([_number(cell) for cell in cells])
    blank = np.array([not cell for cell in cells])
    invalid = np.flatnonzero(~np.isfinite(values) & ~blank)
    if len(invalid):
        k = int(invalid[0])
        raise JobError(
            f"{name} is {cells[k][:40]!r}, not a finite number",
            place=Place(file, line_numbers[k]),
            remedy="Correct the row.",
        )
    return values


def _number(cell: str) -> float:
    try:
        return float(cell or "nan")
    except ValueError:
        return math.inf


def _layer(layers: list[str], line_numbers: list[int], file: str) -> str:
    for number, layer in zip(line_numbers, layers, strict=False):
        if layer != layers[0]:
            raise JobError(
                f"the layer changes from {layers[0][:40]!r} within a contour",
                place=Place(file, number),
                remedy="Put a blank row between contours.",
            )
    return layers[0]


def _refuse_unfinished(points: FloatArray, line_numbers: list[int], file: str) -> None:
    blank = np.flatnonzero(np.isnan(points).any(axis=1))
    if len(blank):
        raise JobError(
            "a point lacks x or y",
            place=Place(file, line_numbers[int(blank[0])]),
            remedy="Fill it in.",
        )


def _arcs(
    points: FloatArray,
    cx: FloatArray,
    cy: FloatArray,
    turns: list[str],
    line_numbers: list[int],
    file: str,
) -> Pieces:
    parts: list[Pieces] = []
    for k, number in enumerate(line_numbers[:-1]):
        centre = np.array([cx[k], cy[k]])
        if np.isnan(centre).all():
            parts.append(chords(points[k : k + 2], number))
            continue
        if np.isnan(centre).any():
            raise JobError("an arc needs both cx and cy", place=Place(file, number))
        try:
            parts.append(centre_segment(points[k], points[k + 1], centre, turns[k], number))
        except ValueError as error:
            raise JobError(f"the arc is wrong: {error}", place=Place(file, number)) from error
    return join_pieces(parts)
