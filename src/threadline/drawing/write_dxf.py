"""Writer of drawings as DXF, millimetres."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from threadline.arrays import FloatArray

ShapeKind = Literal["line", "polygon", "arc", "circle", "spline"]
_LINETYPES = {"solid": "CONTINUOUS", "dashed": "DASHED", "dotted": "DOTTED"}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnShape:
    """A shape that is what its points say.

    Parameters
    ----------
    kind
        ``line`` and ``polygon`` join their points; an ``arc`` has its begin, a point on it and its
        end; a ``circle`` its centre and a point on it; a ``spline`` passes through its points, as
        Catmull and Rom have it.
    points
        (n, 2) m.
    style
        ``solid``, ``dashed`` or ``dotted``.
    """

    kind: ShapeKind
    points: FloatArray
    style: str = "solid"


def centre_of(points: FloatArray) -> FloatArray | None:
    """Return the (2,) centre of the circle through (3, 2) points; None where they are in line."""
    first, second, third = points
    sides = 2.0 * np.array([second - first, third - first])
    if abs(np.linalg.det(sides)) <= 1e-12 * float((sides**2).sum()):
        return None
    away = np.array([second @ second - first @ first, third @ third - first @ first])
    return np.asarray(np.linalg.solve(sides, away))


def spline_controls(points: FloatArray) -> FloatArray:
    """Return (3 n + 1, 2) control points of the cubic pieces of a spline through n + 1 points.

    The tangent at a point is half the way from the one before it to the one behind it (Catmull and
    Rom 1974); the first and the last point stand for their own neighbours.
    """
    padded = np.vstack([points[:1], points, points[-1:]])
    tangent = (padded[2:] - padded[:-2]) / 2.0
    inner = np.stack([points[:-1] + tangent[:-1] / 3.0, points[1:] - tangent[1:] / 3.0], axis=1)
    return np.vstack([points[:1], np.concatenate([inner, points[1:, None]], axis=1).reshape(-1, 2)])


def dxf_of(shapes: Iterable[DrawnShape]) -> bytes:
    """Return a DXF (R2010) with an entity for each shape: LWPOLYLINE, ARC, CIRCLE or SPLINE."""
    from ezdxf import units
    from ezdxf.filemanagement import new

    document = new(setup=["linetypes"], units=units.MM)
    space = document.modelspace()
    for shape in shapes:
        points, look = 1e3 * shape.points, {"linetype": _LINETYPES[shape.style]}
        if shape.kind == "circle":
            radius = float(np.hypot(*(points[1] - points[0])))
            space.add_circle(points[0].tolist(), radius, dxfattribs=look)
        elif shape.kind == "arc" and (centre := centre_of(points)) is not None:
            begin, via, end = np.degrees(np.arctan2(*(points - centre).T[::-1])).tolist()
            if (via - begin) % 360.0 > (end - begin) % 360.0:  # it was drawn clockwise
                begin, end = end, begin
            radius = float(np.hypot(*(points[0] - centre)))
            space.add_arc(centre.tolist(), radius, begin, end, dxfattribs=look)
        elif shape.kind == "spline":
            controls = spline_controls(points)
            pieces = (len(controls) - 1) // 3
            knots = np.repeat(np.arange(pieces + 1.0), 3)
            spline = space.add_spline(degree=3, dxfattribs=look)
            spline.control_points = [(x, y, 0.0) for x, y in controls.tolist()]
            spline.knots = [0.0, *knots.tolist(), float(pieces)]
        else:
            closed = shape.kind == "polygon"
            space.add_lwpolyline(points.tolist(), close=closed, dxfattribs=look)
    text = io.StringIO()
    document.write(text)
    return text.getvalue().encode("utf-8")
