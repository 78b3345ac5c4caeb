"""Writer of drawings as DXF, in millimetres."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any, Literal

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.geometry.strokes import LineStyle

ShapeKind = Literal["line", "polygon", "arc", "circle", "spline", "leader"]
Fill = Literal["none", "solid", "hatched", "crossed"]
_LINETYPES = {
    "solid": "CONTINUOUS", "dashed": "DASHED", "dotted": "DOT", "dashdot": "DASHDOT",
}  # fmt: skip
PATTERNS = {"hatched": "ANSI31", "crossed": "ANSI37"}
"""Fill -> name of its pattern in AutoCAD."""
FILL_LAYER, LEADER_LAYER = "FILL", "LEADER"
"""Layers of shapes that are not sewn."""
_LABEL_MM = 4.0
_CHORDS = 32  # number of chords for a piece of a curve that bounds a fill
_GREY = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrawnShape:
    """A shape given by its points.

    Parameters
    ----------
    kind
        The points of a ``line`` or ``polygon`` are its corners. The points of an ``arc`` are its
        beginning, a point on it and its end. The points of a ``circle`` are its centre and a point
        on it. A ``spline`` is a Catmull-Rom spline through its points. The first point of a
        ``leader`` is the arrow head.
    points
        (n, 2) points, m.
    style
        ``solid``, ``dashed``, ``dotted`` or ``dashdot``.
    fill
        Fill of the area inside; a straight line closes an open shape for this purpose.
    label
        Text at the last point of a leader.
    group
        Number of the group of the shape, 0 for none. Consecutive shapes of a group with the same
        fill are filled together, and a shape inside another one of them is a hole.
    """

    kind: ShapeKind
    points: FloatArray
    style: LineStyle = "solid"
    fill: Fill = "none"
    label: str = ""
    group: int = 0


def centre_of(points: FloatArray) -> FloatArray | None:
    """Return the (2,) centre of the circle through (3, 2) points; None if they are on one line."""
    first, second, third = points
    sides = 2.0 * np.array([second - first, third - first])
    if abs(np.linalg.det(sides)) <= 1e-12 * float((sides**2).sum()):
        return None
    squares = np.array([second @ second - first @ first, third @ third - first @ first])
    return np.asarray(np.linalg.solve(sides, squares))


def spline_controls(points: FloatArray) -> FloatArray:
    """Return (3 n + 1, 2) control points of the cubic pieces of a spline through n + 1 points.

    The tangent at a point is half of the vector from the preceding to the following point (Catmull
    and Rom 1974). The first and the last point count as their own missing neighbours.
    """
    padded = np.vstack([points[:1], points, points[-1:]])
    tangent = (padded[2:] - padded[:-2]) / 2.0
    inner = np.stack([points[:-1] + tangent[:-1] / 3.0, points[1:] - tangent[1:] / 3.0], axis=1)
    return np.vstack([points[:1], np.concatenate([inner, points[1:, None]], axis=1).reshape(-1, 2)])


def dxf_of(shapes: Iterable[DrawnShape]) -> bytes:
    """Return a DXF (R2010) with an entity for each shape: LWPOLYLINE, ARC, CIRCLE or SPLINE.

    Fills (HATCH) and leaders (LEADER, MTEXT) are on layers of their own, ``FILL`` and ``LEADER``.
    """
    from ezdxf import units
    from ezdxf.filemanagement import new

    document = new(setup=["linetypes"], units=units.MM)
    space = document.modelspace()
    for _, same_fill in groupby(enumerate(shapes), _filled_as):
        _add_shapes(space, [shape for _, shape in same_fill])
    text = io.StringIO()
    document.write(text)
    return text.getvalue().encode("utf-8")


def _filled_as(numbered: tuple[int, DrawnShape]) -> tuple[int, int, str]:
    """Return the key that shapes have in common if they are filled together."""
    index, shape = numbered
    is_single = not shape.group or shape.fill == "none" or shape.kind == "leader"
    return (index if is_single else -1, shape.group, shape.fill)


def _add_shapes(space: Any, shapes: Sequence[DrawnShape]) -> None:
    """Add shapes that are filled together; their fill comes before them."""
    if shapes[0].fill != "none" and shapes[0].kind != "leader":
        _add_fill(space, shapes)
    for shape in shapes:
        if shape.kind == "leader":
            _add_leader(space, shape)
            continue
        points, attributes = 1e3 * shape.points, {"linetype": _LINETYPES[shape.style]}
        if shape.kind == "circle":
            radius = float(np.hypot(*(points[1] - points[0])))
            space.add_circle(points[0].tolist(), radius, dxfattribs=attributes)
        elif shape.kind == "arc" and (centre := centre_of(points)) is not None:
            begin, via, end = np.degrees(np.arctan2(*(points - centre).T[::-1])).tolist()
            if (via - begin) % 360.0 > (end - begin) % 360.0:  # the arc was drawn clockwise
                begin, end = end, begin
            radius = float(np.hypot(*(points[0] - centre)))
            space.add_arc(centre.tolist(), radius, begin, end, dxfattribs=attributes)
        elif shape.kind == "spline":
            controls = spline_controls(points)
            pieces = (len(controls) - 1) // 3
            knots = np.repeat(np.arange(pieces + 1.0), 3)
            spline = space.add_spline(degree=3, dxfattribs=attributes)
            spline.control_points = [(x, y, 0.0) for x, y in controls.tolist()]
            spline.knots = [0.0, *knots.tolist(), float(pieces)]
        else:
            closed = shape.kind == "polygon"
            space.add_lwpolyline(points.tolist(), close=closed, dxfattribs=attributes)


def _add_leader(space: Any, shape: DrawnShape) -> None:
    """Add a leader, and its label next to its last point."""
    points = (1e3 * shape.points).tolist()
    attributes = {"layer": LEADER_LAYER, "linetype": _LINETYPES[shape.style]}
    space.add_leader(points, dxfattribs=attributes)
    if shape.label:
        x, y = points[-1]
        label_attributes = {"layer": LEADER_LAYER, "char_height": _LABEL_MM, "insert": (x + 1.0, y)}
        plain = re.sub(r"[\\{}]", r"\\\g<0>", shape.label)  # these characters begin a format
        space.add_mtext(plain, dxfattribs=label_attributes)


def _add_fill(space: Any, shapes: Sequence[DrawnShape]) -> None:
    """Add the fill of shapes; a shape inside another one of them is a hole (style 0)."""
    fill = shapes[0].fill
    hatch = space.add_hatch(color=_GREY, dxfattribs={"layer": FILL_LAYER, "hatch_style": 0})
    if fill in PATTERNS:
        hatch.set_pattern_fill(PATTERNS[fill], color=_GREY, style=0)
    for shape in shapes:
        hatch.paths.add_polyline_path(ring_of(shape).tolist(), is_closed=True)


def ring_of(shape: DrawnShape) -> FloatArray:
    """Return (n, 2) points in mm around the area of a shape; curves are divided into chords."""
    points = 1e3 * shape.points
    if shape.kind == "circle":
        angle = np.linspace(0.0, 2.0 * np.pi, 4 * _CHORDS, endpoint=False)
        radius = np.hypot(*(points[1] - points[0]))
        return np.asarray(points[0] + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    if shape.kind == "arc" and (centre := centre_of(points)) is not None:
        begin, via, end = np.arctan2(*(points - centre).T[::-1])
        sweep = (end - begin) % (2.0 * np.pi)
        if (via - begin) % (2.0 * np.pi) > sweep:  # the arc was drawn clockwise
            sweep -= 2.0 * np.pi
        angle = begin + np.linspace(0.0, sweep, 2 * _CHORDS)
        radius = np.hypot(*(points[0] - centre))
        return np.asarray(centre + radius * np.column_stack([np.cos(angle), np.sin(angle)]))
    if shape.kind == "spline":
        a, b, c, d = (spline_controls(points)[k : len(points) * 3 - 2 : 3] for k in range(4))
        n = len(points) - 1
        u = np.linspace(0.0, 1.0, _CHORDS, endpoint=False)[:, None, None]
        curve_points = (
            (1 - u) ** 3 * a[:n] + 3 * u * (1 - u) ** 2 * b[:n]
            + 3 * u**2 * (1 - u) * c[:n] + u**3 * d[:n]
        )  # fmt: skip
        return np.vstack([curve_points.transpose(1, 0, 2).reshape(-1, 2), points[-1:]])
    return np.asarray(points)
