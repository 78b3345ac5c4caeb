"""The basic shapes of SVG as subpaths, with start and direction by SVG 1.1, chapter 9."""

from __future__ import annotations

import math
from collections.abc import Mapping
from itertools import pairwise

from threadline.drawing.svg.attribute_values import ValueRefused, numbers, pixels
from threadline.drawing.svg.path_data import Point, Subpath, path_subpaths

SHAPES = ("path", "rect", "circle", "ellipse", "line", "polyline", "polygon")


def shape_subpaths(
    name: str, attributes: Mapping[str, str], viewport: tuple[float, float]
) -> list[Subpath]:
    """Return the subpaths of a shape, in pixels of its own axes.

    Parameters
    ----------
    viewport
        Width and height that shares of lengths refer to; NaN where the drawing has none.

    Raises
    ------
    ValueRefused
        If a value is not understood.
    """
    if name == "path":
        return path_subpaths(attributes.get("d", ""))
    if name in ("polyline", "polygon"):
        return _polygon(numbers(attributes.get("points", "").strip()), name == "polygon")
    width, height = viewport
    whole = {
        **dict.fromkeys(("x", "cx", "rx", "x1", "x2", "width"), width),
        **dict.fromkeys(("y", "cy", "ry", "y1", "y2", "height"), height),
        "r": math.hypot(width, height) / math.sqrt(2.0),
    }

    def length(key: str, signed: bool = True) -> float:
        value = pixels(key, attributes.get(key, "0"), whole[key])
        if value < 0.0 and not signed:
            raise ValueRefused(f"{key} is {attributes[key]!r}, less than nothing")
        return value

    if name == "line":
        ends = ((length("x1"), length("y1")), (length("x2"), length("y2")))
        return [Subpath([ends])]
    if name == "circle":
        radius = length("r", signed=False)
        return _ellipse(length("cx"), length("cy"), radius, radius)
    radii: dict[str, float | None] = {
        key: None if attributes.get(key, "auto").strip() == "auto" else length(key, signed=False)
        for key in ("rx", "ry")
    }
    rx = radii["rx"] if radii["rx"] is not None else radii["ry"] or 0.0
    ry = radii["ry"] if radii["ry"] is not None else rx
    if name == "ellipse":
        return _ellipse(length("cx"), length("cy"), rx, ry)
    size = length("width", signed=False), length("height", signed=False)
    return _rectangle(length("x"), length("y"), size, rx, ry)


def _polygon(values: list[float], closed: bool) -> list[Subpath]:
    if len(values) % 2:
        raise ValueRefused("the points of a polyline are an odd count of numbers")
    points = list(zip(values[::2], values[1::2], strict=True))
    if closed and len(points) > 1 and points[-1] != points[0]:
        points.append(points[0])
    path = Subpath()
    path.segments.extend(pairwise(points))
    return [path] if path.segments else []


def _quarter(cx: float, cy: float, rx: float, ry: float, begin: int) -> tuple[object, ...]:
    return (cx, cy), (rx, 0.0), (0.0, ry), begin * math.pi / 2.0, math.pi / 2.0


def _ellipse(cx: float, cy: float, rx: float, ry: float) -> list[Subpath]:
    if rx == 0.0 or ry == 0.0:
        return []
    return [Subpath([_quarter(cx, cy, rx, ry, k) for k in range(4)])]  # type: ignore[misc]


def _rectangle(
    x: float, y: float, size: tuple[float, float], rx: float, ry: float
) -> list[Subpath]:
    width, height = size
    if width == 0.0 or height == 0.0:
        return []
    rx, ry = min(rx, width / 2.0), min(ry, height / 2.0)
    if rx == 0.0 or ry == 0.0:
        rx = ry = 0.0
    right, low = x + width, y + height
    corners: tuple[tuple[Point, Point, Point], ...] = (
        ((x + rx, y), (right - rx, y), (right - rx, y + ry)),
        ((right, y + ry), (right, low - ry), (right - rx, low - ry)),
        ((right - rx, low), (x + rx, low), (x + rx, low - ry)),
        ((x, low - ry), (x, y + ry), (x + rx, y + ry)),
    )
    path = Subpath()
    for k, (begin, end, centre) in enumerate(corners):
        if begin != end:
            path.segments.append((begin, end))
        if rx:
            path.segments.append(_quarter(*centre, rx, ry, (k + 3) % 4))  # type: ignore[arg-type]
    return [path]
