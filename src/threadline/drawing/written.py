"""Contours written in a seam file: points, and arcs by bulge, centre or radius."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from threadline.arrays import FloatArray
from threadline.drawing.curves import Pieces, join_pieces
from threadline.drawing.segments import bulge_segment, centre_segment, radius_segment
from threadline.foreign_messages import nearest

CONTOUR_KEYS = ("layer", "unit", "closed", "points")
_POINT = ("to", "bulge", "centre", "radius", "turn", "large")


def written_contour(table: dict[str, Any], factor: float, line: int) -> Pieces:
    """Return the pieces of a ``[[contour]]`` table.

    Parameters
    ----------
    table
        Its content.
    factor
        Metres in its unit.
    line
        Line of the file, for the pieces.

    Raises
    ------
    ValueError
        If a point or an arc is wrong.
    """
    points = table.get("points", [])
    if not isinstance(points, list) or len(points) < 2:
        raise ValueError("points needs two or more points, like [[0, 0], [10, 0]]")
    here = first = _pair(points[0]) * factor
    parts = []
    for point in points[1:]:
        if not isinstance(point, dict):
            point = {"to": point}  # noqa: PLW2901 - the short form of the same thing
        there = _pair(point.get("to")) * factor
        parts.append(_segment(here, there, point, factor, line))
        here = there
    closed = table.get("closed", False)
    if not isinstance(closed, bool):
        raise ValueError(f"closed is {closed!r}, not true or false")
    if closed and np.hypot(*(here - first)) > 0.0:
        parts.append(bulge_segment(here, first, 0.0, line))
    return join_pieces(parts)


def _pair(value: Any) -> FloatArray:
    good = isinstance(value, list) and len(value) == 2 and all(_is_number(part) for part in value)
    if not good:
        raise ValueError(f"{value!r} is not a point like [10, 20]")
    return np.array(value, dtype=np.float64)


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and math.isfinite(value)


def _number(point: dict[str, Any], key: str) -> float:
    value = point.get(key, 0.0)
    if not _is_number(value):
        raise ValueError(f"{key} is {value!r}, not a number")
    return float(value)


def _segment(
    here: FloatArray, there: FloatArray, point: dict[str, Any], factor: float, line: int
) -> Pieces:
    unknown = set(point) - set(_POINT)
    if unknown:
        key = sorted(unknown)[0]
        raise ValueError(f"unknown key {key!r} of a point. {nearest(key, _POINT)}")
    if len({"bulge", "centre", "radius"} & set(point)) > 1:
        raise ValueError("an arc is given by its bulge, its centre or its radius, not by two")
    turn = point.get("turn", "ccw")
    if "centre" in point:
        return centre_segment(here, there, _pair(point["centre"]) * factor, turn, line)
    if "radius" in point:
        radius = _number(point, "radius") * factor
        return radius_segment(here, there, radius, turn, bool(point.get("large", False)), line)
    return bulge_segment(here, there, _number(point, "bulge"), line)
