"""Seams from a table: a point a row, with a bulge or a centre for the way to the next point.

The first row names the columns, with their unit: ``x [mm], y [mm], bulge``. Columns are ``x`` and
``y``; then, for the segment that leaves the point, ``bulge`` or ``cx``, ``cy`` and ``turn`` (ccw
or cw); and ``layer``. A blank row ends a contour. Commas, semicolons and tabs separate; with
semicolons or tabs a decimal comma is understood. A row that begins with # is a comment.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator

import numpy as np

from threadline.errors import JobError, Place, UnitError
from threadline.jobs.seam.drawing import Drawing, Stroke, decode_text
from threadline.jobs.seam.pieces import Pieces, join_pieces
from threadline.jobs.seam.segments import centre_segment
from threadline.jobs.seam.shapes import bulges, chords
from threadline.units import unit_factor

_COLUMN = re.compile(r"([a-zA-Z]+)\s*(?:[\[(]\s*([a-zA-Z]+)\s*[\])])?")
_LENGTHS = ("x", "y", "cx", "cy")
_KNOWN = (*_LENGTHS, "bulge", "turn", "layer")
_EXAMPLE = 'Begin the file with a row like "x [mm], y [mm], bulge".'


def read_csv(content: bytes, file: str, unit: str | None = None) -> Drawing:
    """Return the contours of a table of points.

    Parameters
    ----------
    content, file
        The bytes of the file, and its name for messages.
    unit
        Unit of the columns whose heading names none.

    Raises
    ------
    JobError
        If it is not such a table; with the line.
    """
    text = decode_text(content, file, "table")
    rows = _rows(text, file)
    try:
        number, heading, separator = next(rows)
    except StopIteration:
        raise JobError("the table has no rows", place=Place(file), remedy=_EXAMPLE) from None
    columns = _columns(heading, unit, Place(file, number))
    strokes: list[Stroke] = []
    points: list[tuple[int, dict[str, float | str]]] = []
    for number, cells, _ in rows:
        if any(cells):
            points.append((number, _point(cells, columns, separator, Place(file, number))))
        elif points:
            strokes.append(_stroke(points, file))
            points = []
    if points:
        strokes.append(_stroke(points, file))
    if not strokes:
        raise JobError("the table has no points", place=Place(file), remedy=_EXAMPLE)
    return Drawing(file=file, strokes=tuple(strokes))


def _rows(text: str, file: str) -> Iterator[tuple[int, list[str], str]]:
    """Yield line number, cells and separator of every row; blank rows have no cells."""
    head = next((li for li in text.splitlines() if li.strip() and li.strip()[0] != "#"), "")
    separator = next((s for s in (";", "\t") if s in head), ",")
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
    """Return name and metres (or 1) per number of every column."""
    found: list[tuple[str, float]] = []
    for cell in heading:
        match = _COLUMN.fullmatch(cell)
        name = match[1].lower() if match else ""
        if match is None or name not in _KNOWN:
            raise JobError(
                f"unknown column {cell[:40]!r}",
                place=place,
                remedy=f"Columns are {', '.join(_KNOWN)}. {_EXAMPLE}",
            )
        factor = 1.0
        if name in _LENGTHS:
            written = match[2] or unit
            if written is None:
                raise JobError(f"column {name!r} has no unit", place=place, remedy=_EXAMPLE)
            try:
                factor = unit_factor(written, "m")
            except UnitError as error:
                raise JobError(f"column {name!r}: {error.message}", place=place) from error
        found.append((name, factor))
    names = [name for name, _ in found]
    if len(set(names)) < len(names):
        raise JobError("two columns have the same name", place=place, remedy=_EXAMPLE)
    for wanted in ("x", "y"):
        if wanted not in names:
            raise JobError(f"no column {wanted!r}", place=place, remedy=_EXAMPLE)
    if ("cx" in names) != ("cy" in names) or ("cx" in names) != ("turn" in names):
        raise JobError("an arc by its centre needs the columns cx, cy and turn", place=place)
    return found


def _point(
    cells: list[str], columns: list[tuple[str, float]], separator: str, place: Place
) -> dict[str, float | str]:
    if len(cells) != len(columns):
        raise JobError(f"the row has {len(cells)} cells, the heading {len(columns)}", place=place)
    point: dict[str, float | str] = {}
    for cell, (name, factor) in zip(cells, columns, strict=True):
        if name in ("turn", "layer"):
            point[name] = cell
            continue
        if not cell and name not in ("x", "y"):
            continue
        try:
            value = float(cell if separator == "," else cell.replace(",", ".")) * factor
        except ValueError as error:
            raise JobError(
                f"{name} is {cell[:40]!r}, not a number", place=place, remedy="Correct the row."
            ) from error
        if not math.isfinite(value):
            raise JobError(f"{name} is {cell[:40]!r}, not a finite number", place=place)
        point[name] = value
    return point


def _stroke(points: list[tuple[int, dict[str, float | str]]], file: str) -> Stroke:
    lines = np.array([number for number, _ in points])
    if len(points) < 2:
        raise JobError(
            "a contour has one point only",
            place=Place(file, points[0][0]),
            remedy="Give it two or more points; a blank row ends a contour.",
        )
    at = np.array([[point["x"], point["y"]] for _, point in points], dtype=np.float64)
    layer = str(points[0][1].get("layer", ""))
    for number, point in points:
        if point.get("layer", "") != layer:
            raise JobError(
                f"the layer changes from {layer[:40]!r} within a contour",
                place=Place(file, number),
                remedy="Put a blank row between contours.",
            )
    if not any("cx" in point for _, point in points):
        bulge = np.array([point.get("bulge", 0.0) for _, point in points], dtype=np.float64)
        pieces = bulges(at, bulge[:-1], lines[:-1])
        return Stroke(pieces=pieces, layer=layer, colour="none")
    parts: list[Pieces] = []
    for k, (number, point) in enumerate(points[:-1]):
        if "cx" not in point:
            parts.append(chords(at[k : k + 2], number))
            continue
        try:
            centre = np.array([point["cx"], point["cy"]], dtype=np.float64)
            parts.append(centre_segment(at[k], at[k + 1], centre, str(point["turn"]), number))
        except (ValueError, KeyError) as error:
            raise JobError(f"the arc is wrong: {error}", place=Place(file, number)) from error
    return Stroke(pieces=join_pieces(parts), layer=layer, colour="none")
