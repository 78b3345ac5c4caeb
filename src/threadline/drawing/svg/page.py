"""The page of an SVG: the size of a pixel of the drawing, and the page's lower edge."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.drawing.svg.attribute_values import ValueRefused, numbers, pixels, shown
from threadline.drawing.svg.tree import Tree
from threadline.errors import JobError, Place
from threadline.units import unit_factor

_PIXEL_M = 0.0254 / 96.0  # CSS: 96 pixels to the inch
_PHYSICAL = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*(mm|cm|in|pt|pc)\s*")
_UNIT_M = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72.0, "pc": 0.0254 / 6.0}
_NO_PAGE = 1000.0  # pixels: the height of a page that has none
_ALIGNED = re.compile(r"x(Min|Mid|Max)Y(Min|Mid|Max)(?:\s+(meet|slice))?")
_SHARE = {"Min": 0.0, "Mid": 0.5, "Max": 1.0}


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """The map from the drawing to metres, Y up from the lower edge of the page.

    Parameters
    ----------
    matrix, offset
        (2, 2) and (2,): a point p of the drawing lies at ``matrix @ p + offset``, m.
    viewport
        Width and height in the drawing's own units, NaN without one.
    warnings
        Warnings about a size that was assumed.
    """

    matrix: FloatArray
    offset: FloatArray
    viewport: tuple[float, float]
    warnings: tuple[str, ...]


def svg_page(tree: Tree, unit: str | None) -> Page:
    """Return the page of an SVG.

    Parameters
    ----------
    unit
        Unit that a pixel stands for in a drawing that states no physical size.

    Raises
    ------
    JobError
        If the drawing's size cannot be read, or contradicts the given unit.
    """
    attributes, place = tree.root.attributes, tree.place(tree.root)
    try:
        box = _view_box(attributes.get("viewBox"))
        physical = [_PHYSICAL.fullmatch(attributes.get(key, "")) for key in ("width", "height")]
        warnings: list[str] = []
        if physical[0] and physical[1]:
            width, height = (float(m[1]) * _UNIT_M[m[2]] for m in physical if m)
            if unit is not None:
                raise JobError(
                    f"the drawing states its size, the seam file a unit ({unit})",
                    place=Place(tree.file),
                    remedy="Remove the unit from the seam file.",
                )
        else:
            pixel_m = _PIXEL_M if unit is None else unit_factor(unit, "m")
            width, height, paged = _pixel_size(attributes, box)
            width, height = width * pixel_m, height * pixel_m
            if unit is None:
                warnings.append(
                    f"{Place(tree.file)}: the SVG states no physical size; 96 pixels are taken as "
                    "an inch"
                )
            if not paged:
                warnings.append(
                    f"{Place(tree.file)}: the SVG has no page; Y counts from "
                    f"{height * 1e3:.6g} mm below its origin"
                )
            if box is None:
                box = (0.0, 0.0, width / pixel_m, height / pixel_m)
        if not width or not height:
            raise JobError("the SVG has no size", place=place, remedy="Give it a page size.")
        if box is None:  # a physical size alone: its pixels are those of CSS
            box = (0.0, 0.0, width / _PIXEL_M, height / _PIXEL_M)
        scale_x, scale_y, left, top = _fitted(
            width, height, box, attributes.get("preserveAspectRatio", "xMidYMid").strip()
        )
    except ValueRefused as error:
        raise JobError(str(error), place=place, remedy=error.remedy) from error
    return Page(
        matrix=np.array([[scale_x, 0.0], [0.0, -scale_y]]),
        offset=np.array([left, height - top]),
        viewport=(box[2], box[3]),
        warnings=tuple(warnings),
    )


def _view_box(written: str | None) -> tuple[float, float, float, float] | None:
    if written is None:
        return None
    found = numbers(written.strip())
    if len(found) != 4 or found[2] <= 0.0 or found[3] <= 0.0:
        raise ValueRefused(f"viewBox is {shown(written)}, not four numbers of a box")
    return found[0], found[1], found[2], found[3]


def _pixel_size(
    attributes: Mapping[str, str], box: tuple[float, float, float, float] | None
) -> tuple[float, float, bool]:
    """Return width and height in pixels, and whether the height is that of a page."""
    sizes: list[float | None] = []
    for key in ("width", "height"):
        written = attributes.get(key, "auto").strip()
        if _PHYSICAL.fullmatch(written):
            written = "".join(written.split())
        value = None if written in ("auto", "100%") else pixels(key, written)
        if value is not None and value < 0.0:
            raise ValueRefused(f"{key} is {written!r}, less than nothing")
        sizes.append(value)
    width, height = sizes
    if box is None:
        paged = height is not None
        return (
            _NO_PAGE if width is None else width,
            _NO_PAGE if height is None else height,
            paged,
        )
    if height is None:
        height = box[3] if width is None else width * box[3] / box[2]
    return height * box[2] / box[3] if width is None else width, height, True


def _fitted(
    width: float, height: float, box: tuple[float, float, float, float], aspect: str
) -> tuple[float, float, float, float]:
    """Return the scales of X and Y, and where the drawing's origin lies from the upper left."""
    scale_x, scale_y = width / box[2], height / box[3]
    if aspect == "none":
        return scale_x, scale_y, -box[0] * scale_x, -box[1] * scale_y
    match = _ALIGNED.fullmatch(aspect)
    if match is None:
        raise ValueRefused(f"preserveAspectRatio is {shown(aspect)}, which is not understood")
    scale = max(scale_x, scale_y) if match[3] == "slice" else min(scale_x, scale_y)
    # A page drawn to scale has one scale; rounding must not make two of it.
    if math.isclose(scale_x, scale_y, rel_tol=1e-12):
        return scale_x, scale_y, -box[0] * scale_x, -box[1] * scale_y
    left = _SHARE[match[1]] * (width - scale * box[2]) - box[0] * scale
    top = _SHARE[match[2]] * (height - scale * box[3]) - box[1] * scale
    return scale, scale, left, top
