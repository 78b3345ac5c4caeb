"""Entities of a DXF drawing as exact pieces, in drawing units."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.geometry.curves import Pieces, bulges, chords, ellipse_arc, join_pieces, spline

_FLAT = 1e-6
_SPLINE_FRAME = 16  # vertex flag: a control point, not a point of the curve


class NotFlatError(ValueError):
    """An entity that does not lie parallel to the XY plane."""


def entity_pieces(entity: Any, line: int) -> Pieces | None:
    """Return the pieces of an entity, or None for a kind of entity without lines.

    Raises
    ------
    NotFlatError
        If it is not parallel to the XY plane.
    ValueError
        If its data contradict each other.
    """
    makers: dict[str, Callable[[Any, int], Pieces | None]] = {
        "LINE": _line,
        "ARC": _arc,
        "CIRCLE": _arc,
        "ELLIPSE": _ellipse,
        "LWPOLYLINE": _light_polyline,
        "POLYLINE": _polyline,
        "SPLINE": _spline,
    }
    maker = makers.get(entity.dxftype())
    return None if maker is None else maker(entity, line)


def _plane(points: Any) -> FloatArray:
    """Return the (n, 2) x and y of points, which must all have the same z."""
    array = np.array([tuple(point) for point in points], dtype=np.float64)
    if not np.isfinite(array).all():
        raise ValueError("a coordinate is not a finite number")
    size = max(1.0, float(np.abs(array).max()))
    if array.shape[1] > 2 and np.ptp(array[:, 2]) > _FLAT * size:
        raise NotFlatError
    return array[:, :2]


def _line(entity: Any, line: int) -> Pieces:
    return chords(_plane([entity.dxf.start, entity.dxf.end]), line)


def _arc(entity: Any, line: int) -> Pieces:
    """Return a circle or arc; its coordinate system may be mirrored (extrusion 0, 0, -1)."""
    dxf = entity.dxf
    ocs = entity.ocs()
    radius = float(dxf.radius)
    centre = ocs.to_wcs(dxf.center)
    a = ocs.to_wcs((radius, 0.0, 0.0))
    b = ocs.to_wcs((0.0, radius, 0.0))
    _plane([centre, centre + a, centre + b])
    begin, sweep = 0.0, 2.0 * math.pi
    if entity.dxftype() == "ARC":
        begin = math.radians(dxf.start_angle)
        sweep = math.radians((dxf.end_angle - dxf.start_angle) % 360.0) or sweep
    return ellipse_arc(
        np.array(centre.vec2), np.array(a.vec2), np.array(b.vec2), begin, sweep, line
    )


def _ellipse(entity: Any, line: int) -> Pieces:
    dxf = entity.dxf
    a, b = dxf.major_axis, entity.minor_axis
    _plane([dxf.center, dxf.center + a, dxf.center + b])
    sweep = (dxf.end_param - dxf.start_param) % (2.0 * math.pi)
    if sweep < 1e-12:
        sweep = 2.0 * math.pi
    return ellipse_arc(
        np.array(dxf.center.vec2),
        np.array(a.vec2),
        np.array(b.vec2),
        float(dxf.start_param),
        sweep,
        line,
    )


def _bulged(entity: Any, points: list[Any], bulge: list[float], line: int) -> Pieces:
    """Return a polyline with bulges, from the entity's coordinate system."""
    ocs = entity.ocs()
    flat = _plane([ocs.to_wcs(point) for point in points])
    # In a mirrored coordinate system counter-clockwise arcs become clockwise.
    if entity.dxf.get("extrusion", (0, 0, 1))[2] < 0:
        bulge = [-value for value in bulge]
    if entity.is_closed:
        flat = np.concatenate([flat, flat[:1]])
        if np.hypot(*(flat[-1] - flat[-2])) == 0.0:
            flat = flat[:-1]  # closed, with the first point repeated at the end
    if len(flat) < 2:
        raise ValueError("a polyline has fewer than two points")
    return bulges(flat, np.array(bulge[: len(flat) - 1]), line)


def _light_polyline(entity: Any, line: int) -> Pieces:
    rows = list(entity.get_points("xyb"))
    height = float(entity.dxf.elevation)
    points = [(x, y, height) for x, y, _ in rows]
    return _bulged(entity, points, [float(row[2]) for row in rows], line)


def _polyline(entity: Any, line: int) -> Pieces | None:
    if not (entity.is_2d_polyline or entity.is_3d_polyline):
        return None
    vertices = [v for v in entity.vertices if not int(v.dxf.flags) & _SPLINE_FRAME]
    points = [v.dxf.location for v in vertices]
    if entity.is_2d_polyline:
        return _bulged(entity, points, [float(v.dxf.get("bulge", 0.0)) for v in vertices], line)
    if entity.is_closed:
        points.append(points[0])
    return chords(_plane(points), line)


def _spline(entity: Any, line: int) -> Pieces:
    curve = entity.construction_tool()
    control = _plane(curve.control_points)
    weights = curve.weights()
    return join_pieces(
        spline(
            control,
            np.array(curve.knots(), dtype=np.float64),
            int(curve.degree),
            np.array(weights, dtype=np.float64) if len(weights) else None,
            line,
        )
    )
