"""Meridians from files: a table of points, or the half section of a drawing."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.reading import read_text
from threadline.errors import JobError, Place
from threadline.winding.surface import Stretch, line, stretch_of

if TYPE_CHECKING:
    from threadline.geometry.curves import Pieces

MAX_BYTES = 1_000_000
_MOST_ROWS = 20_000
_MOST_PIECES = 2000
_MEETS_M = 1e-6  # two lines of a drawing whose ends are as near belong together
_NODES = 33  # of a curve; the error of the pieces between them is below a nanometre
_LONGEST_M = 1e3


def read_points(path: Path) -> list[list[float]]:
    """Return the points, m, of a table with the columns x_mm and radius_mm.

    Raises
    ------
    JobError
        If it is no such table, or its meridian doubles back or reaches the axis.
    """
    text = read_text(path, MAX_BYTES, JobError, "table of a meridian", "utf-8-sig")
    try:
        rows = [(i, row) for i, row in enumerate(csv.reader(text.splitlines()), 1) if any(row)]
    except csv.Error as error:
        raise JobError(
            f"not a table: {error}", place=Place(str(path)), remedy="Save it as CSV."
        ) from error
    header = [cell.strip() for cell in rows[0][1]] if rows else []
    if sorted(header) != ["radius_mm", "x_mm"]:
        raise JobError(
            "a meridian has the columns x_mm and radius_mm",
            place=Place(str(path), 1),
            remedy="Begin it with the line x_mm,radius_mm.",
        )
    if not 3 <= len(rows) <= _MOST_ROWS:
        raise JobError(
            f"the number of points is {len(rows) - 1}, and a meridian needs 2 to {_MOST_ROWS - 1}",
            place=Place(str(path)),
            remedy="Give as many points as its shape needs.",
        )
    points: list[list[float]] = []
    for number, row in rows[1:]:
        try:
            cells = dict(zip(header, map(float, row), strict=True))
        except ValueError:
            cells = {"x_mm": math.nan, "radius_mm": math.nan}
        point = [1e-3 * cells["x_mm"], 1e-3 * cells["radius_mm"]]
        if not all(abs(value) <= _LONGEST_M for value in point):
            raise JobError(
                f"{','.join(row)[:60]!r} is no point of a meridian",
                place=Place(str(path), number),
                remedy="Write two numbers, like 12.5,40.",
            )
        if point[1] <= 0.0:
            raise _axis_crossed(Place(str(path), number), f"radius {1e3 * point[1]:g} mm")
        if points and point[0] <= points[-1][0]:
            raise JobError(
                f"the mandrel doubles back: x = {1e3 * point[0]:g} mm follows "
                f"{1e3 * points[-1][0]:g} mm",
                place=Place(str(path), number),
                remedy="Sort the points by x; each x once.",
            )
        points.append(point)
    return points


def _axis_crossed(place: Place, where: str) -> JobError:
    return JobError(
        f"the mandrel crosses its axis: {where}",
        place=place,
        remedy="End it at a polar opening with a radius above 0.",
    )


def read_section(path: Path, layer: str | None = None) -> list[list[list[float]]]:
    """Return the half section of a drawing in DXF as rows of its stretches.

    The axis of the mandrel is the drawing's X axis. Lines on the axis, and straight faces that end
    on it, are no part of the meridian.

    Parameters
    ----------
    layer
        Layer of the meridian; None for all layers.

    Returns
    -------
    list
        For each stretch the rows of its nodes: length, place with two derivatives, radius with two
        derivatives, m; ``stretches_of`` reads them.

    Raises
    ------
    JobError
        If the drawing cannot be read, or its lines are no open chain above the axis.
    """
    # Only a mandrel that is drawn needs the readers of drawings.
    from threadline.geometry.read_dxf import read_dxf
    from threadline.geometry.strokes import read_limited

    file = str(path)
    drawing = read_dxf(read_limited(path, MAX_BYTES), file)
    for refusal in drawing.refusals:
        if layer in (None, refusal.layer):
            raise JobError(refusal.message, place=Place(file, refusal.line), remedy=refusal.remedy)
    rows: list[tuple[int, Stretch]] = []
    for stroke in drawing.strokes:
        if layer not in (None, stroke.layer):
            continue
        for index in range(len(stroke.pieces)):
            stretch = _stretch(stroke.pieces, index, file)
            if stretch is not None:
                rows.append((int(stroke.pieces.line[index]), stretch))
        if len(rows) > _MOST_PIECES:
            raise JobError(
                f"the meridian has more than {_MOST_PIECES} lines and curves",
                place=Place(file, stroke.line),
                remedy="Give its points as CSV, with the columns x_mm and radius_mm.",
            )
    if not rows:
        raise JobError(
            "the drawing has no meridian" + ("" if layer is None else f" on the layer {layer!r}"),
            place=Place(file),
            remedy="Draw the half section above the X axis, from polar opening to polar opening.",
        )
    rows.sort(key=lambda row: float(row[1].x[0, 0]))
    for (_, left), (line_number, right) in itertools.pairwise(rows):
        gap = math.hypot(right.x[0, 0] - left.x[-1, 0], right.r[0, 0] - left.r[-1, 0])
        if gap > _MEETS_M:
            raise JobError(
                f"the mandrel is open or has two lines: one ends at x = "
                f"{1e3 * left.x[-1, 0]:.6g} mm, y = {1e3 * left.r[-1, 0]:.6g} mm, this one "
                f"begins at {1e3 * right.x[0, 0]:.6g} mm, {1e3 * right.r[0, 0]:.6g} mm",
                place=Place(file, line_number),
                remedy="Let each line begin where the one before it ends, or name its layer.",
            )
    return [np.column_stack([part.u, part.x, part.r]).tolist() for _, part in rows]


def _stretch(pieces: Pieces, index: int, file: str) -> Stretch | None:
    """Return a piece of a drawing from left to right; None if it is no part of the meridian."""
    place = Place(file, int(pieces.line[index]))
    is_straight = bool(pieces.is_line[index])
    count = 2 if is_straight else _NODES

    def drawn_at(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        found = np.array(pieces.evaluate(np.full(len(p), index), p, 2))
        return found[:, :, 0], found[:, :, 1]

    x, r = (values[0] for values in drawn_at(np.linspace(0.0, 1.0, count)))
    if not (np.abs(x) <= _LONGEST_M).all() or not (np.abs(r) <= _LONGEST_M).all():
        raise JobError(
            f"the meridian is longer than {_LONGEST_M:g} m",
            place=place,
            remedy="Correct the unit of the drawing.",
        )
    if math.hypot(x[-1] - x[0], r[-1] - r[0]) < _MEETS_M and is_straight:
        return None
    on_axis = np.abs(r) < _MEETS_M
    if on_axis.all() or (is_straight and on_axis.any() and abs(x[-1] - x[0]) < _MEETS_M):
        return None  # the axis, or a face that ends on it
    if (r <= 0.0).any():
        raise _axis_crossed(place, f"y = {1e3 * float(r.min()):.6g} mm")
    is_forward = bool(x[-1] > x[0])
    steps = np.diff(x) if is_forward else -np.diff(x)
    if (steps <= 0.0).any():
        index_back = int(np.argmax(steps <= 0.0))
        raise JobError(
            f"the mandrel doubles back at x = {1e3 * x[index_back]:.6g} mm, y = "
            f"{1e3 * r[index_back]:.6g} mm",
            place=place,
            remedy="Its meridian must go from left to right; end it at the polar opening.",
        )
    if is_straight:
        order = slice(None) if is_forward else slice(None, None, -1)
        (x0, x1), (r0, r1) = x[order].tolist(), r[order].tolist()
        return line(x0, r0, x1, r1)

    def rightwards(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        found_x, found_r = drawn_at(p if is_forward else 1.0 - p)
        if not is_forward:
            found_x[1] *= -1.0
            found_r[1] *= -1.0
        return found_x, found_r

    with np.errstate(invalid="ignore", divide="ignore"):
        stretch = stretch_of(rightwards, np.linspace(0.0, 1.0, count))
    if not all(np.isfinite(values).all() for values in (stretch.u, stretch.x, stretch.r)):
        raise JobError(
            "a curve of the meridian stands still at a point",
            place=place,
            remedy="Draw it as arcs and lines, or as a spline without doubled points.",
        )
    return stretch


def stretches_of(rows: Any) -> Sequence[Stretch] | None:
    """Return the stretches of the rows of ``read_section``; None if they are no such rows."""
    stretches = []
    for row in rows if isinstance(rows, list) and rows else [None]:
        try:
            table = np.array(row, dtype=np.float64)
        except (TypeError, ValueError):
            return None
        if table.ndim != 2 or table.shape[1] != 7 or len(table) < 2:
            return None
        if not (np.abs(table) < 1e9).all() or table[0, 0] != 0.0:
            return None
        if not (np.diff(table[:, 0]) > 0.0).all():
            return None
        stretches.append(Stretch(u=table[:, 0], x=table[:, 1:4], r=table[:, 4:7]))
    return stretches


def shifted(stretches: Sequence[Stretch], x_m: float) -> list[Stretch]:
    """Return stretches moved along the axis so that the first begins at ``x_m``."""
    shift = np.array([x_m - float(stretches[0].x[0, 0]), 0.0, 0.0])
    return [Stretch(u=stretch.u, x=stretch.x + shift, r=stretch.r) for stretch in stretches]
