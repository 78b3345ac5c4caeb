"""Reader of SVG drawings: strokes in m, with Y up from the lower edge of the page."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError, Place
from threadline.geometry.strokes import MAX_LINES, Drawing, Refusal, Stroke, style_of_dasharray
from threadline.geometry.svg.document import (
    INKSCAPE,
    Element,
    Tree,
    ValueRefused,
    colour,
    numbers,
    pixels,
    shown,
    svg_tree,
    transform,
)
from threadline.geometry.svg.paths import SHAPES, shape_subpaths
from threadline.geometry.svg.styles import INHERITED, READ, Styles, resolved
from threadline.units import unit_factor

_PIXEL_M = 0.0254 / 96.0  # CSS: 96 pixels to the inch
_PHYSICAL = re.compile(r"\s*(\d+\.?\d*|\.\d+)\s*(mm|cm|in|pt|pc)\s*")
_UNIT_M = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72.0, "pc": 0.0254 / 6.0}
_DEFAULT_HEIGHT = 1000.0  # pixels: assumed height of a page without a height
_ALIGNED = re.compile(r"x(Min|Mid|Max)Y(Min|Mid|Max)(?:\s+(meet|slice))?")
_SHARE = {"Min": 0.0, "Mid": 0.5, "Max": 1.0}


@dataclass(frozen=True, slots=True, eq=False)
class Page:
    """The map from the drawing to metres, with Y up from the lower edge of the page.

    Parameters
    ----------
    matrix, offset
        (2, 2) and (2,): a point p of the drawing lies at ``matrix @ p + offset``, m.
    viewport
        Width and height in the drawing's own units; NaN if the drawing gives none.
    warnings
        Warnings about assumed sizes.
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
        Unit of a pixel, for a drawing that states no physical size.

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
        if box is None:  # a physical size without a view box: the units are CSS pixels
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
    values = numbers(written.strip())
    if len(values) != 4 or values[2] <= 0.0 or values[3] <= 0.0:
        raise ValueRefused(f"viewBox is {shown(written)}, not four numbers of a box")
    return values[0], values[1], values[2], values[3]


def _pixel_size(
    attributes: Mapping[str, str], box: tuple[float, float, float, float] | None
) -> tuple[float, float, bool]:
    """Return width and height in pixels, and whether the drawing states the height of a page."""
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
            _DEFAULT_HEIGHT if width is None else width,
            _DEFAULT_HEIGHT if height is None else height,
            paged,
        )
    if height is None:
        height = box[3] if width is None else width * box[3] / box[2]
    return height * box[2] / box[3] if width is None else width, height, True


def _fitted(
    width: float, height: float, box: tuple[float, float, float, float], aspect: str
) -> tuple[float, float, float, float]:
    """Return the scales of X and Y, and the drawing's origin relative to the upper left corner."""
    scale_x, scale_y = width / box[2], height / box[3]
    if aspect == "none":
        return scale_x, scale_y, -box[0] * scale_x, -box[1] * scale_y
    match = _ALIGNED.fullmatch(aspect)
    if match is None:
        raise ValueRefused(f"preserveAspectRatio is {shown(aspect)}, which is not understood")
    scale = max(scale_x, scale_y) if match[3] == "slice" else min(scale_x, scale_y)
    # A page drawn to scale has one scale for X and Y; rounding must not make them differ.
    if math.isclose(scale_x, scale_y, rel_tol=1e-12):
        return scale_x, scale_y, -box[0] * scale_x, -box[1] * scale_y
    left = _SHARE[match[1]] * (width - scale * box[2]) - box[0] * scale
    top = _SHARE[match[2]] * (height - scale * box[3]) - box[1] * scale
    return scale, scale, left, top


_GROUPS = ("svg", "g", "a")
_NEVER_DRAWN = (
    "defs", "symbol", "mask", "marker", "clipPath", "pattern", "linearGradient", "radialGradient",
    "filter", "style", "script", "title", "desc", "metadata", "view", "cursor", "font",
    "font-face", "color-profile", "animate", "animateTransform", "animateMotion", "animateColor",
    "set", "solidcolor", "hatch", "meshgradient", "meshGradient",
)  # fmt: skip
_DISPLAYS = (
    "none", "inline", "block", "list-item", "run-in", "compact", "table", "inline-block",
    "inline-table", "flex", "grid", "contents", "inline-flex", "inline-grid", "flow-root",
)  # fmt: skip
_PLAIN = "or put it on a layer that is not chosen."


def read_svg(
    content: bytes, file: str, unit: str | None = None, *, most_lines: int | None = None
) -> Drawing:
    """Return the strokes of an SVG drawing, in m, Y up from the lower edge of the page.

    Parameters
    ----------
    content, file
        The bytes of the file, and its name for messages.
    unit
        Unit of a pixel, for a drawing that states no physical size.
    most_lines
        Largest number of lines of the drawing, clones included; None for ``MAX_LINES``.

    Raises
    ------
    JobError
        If the file is not an SVG, is unsafe to read, has a construct that is not understood, or
        contradicts the given unit; names the line.

    Notes
    -----
    In SVG, Y points down from the upper edge. Here Y points up, and the strokes look like the
    drawing on the screen. The drawing is read according to SVG 1.1 and CSS 2.1, at time 0, without
    scripts.
    """
    tree = svg_tree(content, file)
    page = svg_page(tree, unit)
    walk = _Walk(tree, page, Styles(tree), list(page.warnings), most_lines or MAX_LINES)
    walk.element(tree.root, _Here(np.eye(3), dict(INHERITED)), 0)
    return Drawing(
        file=file,
        strokes=tuple(walk.strokes),
        refusals=tuple(walk.refusals.values()),
        warnings=tuple(walk.warnings),
    )


@dataclass(frozen=True, slots=True)
class _Here:
    """Inherited values of an element: coordinate system, property values, layer and clipping."""

    matrix: FloatArray
    inherited: Mapping[str, str]
    layer: str = ""
    cut: tuple[str, int] | None = None  # the property that clips the element, and its line
    clone: bool = False


@dataclass(slots=True)
class _Walk:
    """Visits the elements in the order in which they are drawn, with clones."""

    tree: Tree
    page: Page
    styles: Styles
    warnings: list[str]
    most_lines: int
    strokes: list[Stroke] = field(default_factory=list)
    refusals: dict[tuple[str, str, str, int], Refusal] = field(default_factory=dict)
    cached: dict[int, dict[str, tuple[str, bool]]] = field(default_factory=dict)

    def element(self, element: Element, outside: _Here, depth: int) -> None:
        """Add the strokes of an element and its children."""
        name = element.name
        if " " in name or (name in _NEVER_DRAWN and not (name == "symbol" and outside.clone)):
            return
        try:
            here = self._enter(element, outside, depth)
            if here is None:
                return
            if name in SHAPES:
                self._shape(element, here)
            elif name == "use":
                self._clone(element, here, depth)
            elif name in _GROUPS or name == "symbol":
                self._group(element, here, depth)
            else:
                self._refuse_kind(element, here)
        except ValueRefused as error:
            raise JobError(
                str(error), place=self.tree.place(element), remedy=error.remedy
            ) from error

    def _enter(self, element: Element, outside: _Here, depth: int) -> _Here | None:
        """Return the values that children of an element inherit; None if it is not drawn."""
        if id(element) not in self.cached:
            self.cached[id(element)] = self.styles.declared(element)
        declared = self.cached[id(element)]
        values = {
            key: resolved(key, declared.get(key, (None,))[0], outside.inherited.get(key, ""))
            for key in READ
        }
        display = values["display"].lower()
        if display == "none":
            return None
        if display not in _DISPLAYS:
            raise ValueRefused(f"display is {shown(display)}, which is not understood")
        cut = outside.cut
        for key in ("clip-path", "mask"):
            if values[key].lower() != "none":
                cut = (key, element.line)
        layer = outside.layer
        if element.name == "g":
            label = element.attributes.get(f"{INKSCAPE}label", element.identity)
            is_layer = element.attributes.get(f"{INKSCAPE}groupmode") == "layer"
            if is_layer or (depth == 1 and label and not outside.clone):
                layer = label
        in_style = "transform" in declared and declared["transform"][1]
        own_matrix = transform(values["transform"], in_style=in_style)
        origin = values["transform-origin"]
        if origin != "0 0" and not np.array_equal(own_matrix, np.eye(3)):
            own_matrix = _about(own_matrix, origin, self.page.viewport)
        return replace(
            outside,
            matrix=outside.matrix @ own_matrix,
            inherited={key: values[key] for key in INHERITED},
            layer=layer,
            cut=cut,
        )

    def _group(self, element: Element, here: _Here, depth: int) -> None:
        if element.name == "svg" and depth:
            self._refuse(element, here, "an svg within the svg cannot be sewn", "Ungroup it,")
            return
        for child in element.children:
            self.element(child, replace(here, clone=False) if here.clone else here, depth + 1)

    def _clone(self, use: Element, here: _Here, depth: int) -> None:
        width, height = self.page.viewport
        x = pixels("x", use.attributes.get("x", "0"), width)
        y = pixels("y", use.attributes.get("y", "0"), height)
        target = self.tree.by_id.get(use.target)
        if target is None:
            return
        moved = here.matrix @ np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
        self.element(target, replace(here, matrix=moved, clone=True), depth + 1)

    def _shape(self, element: Element, here: _Here) -> None:
        paths = shape_subpaths(element.name, element.attributes, self.page.viewport)
        if here.inherited["visibility"].lower() in ("hidden", "collapse"):
            return
        place = self.tree.place(element)
        stroke, filled = (self._paint(key, here) for key in ("stroke", "fill"))
        if here.cut is not None:
            clip, line = here.cut
            self._refuse(
                element, here, f"a shape is cut by a {clip} (line {line}), which is not applied",
                "Remove it or cut the shape itself,", stroke,
            )  # fmt: skip
            return
        if stroke == "none":
            if filled == "none":
                self.warnings.append(f"{place}: a shape with neither stroke nor fill was left out")
                return
            self.warnings.append(f"{place}: a shape without a stroke; its outline is sewn")
        if len(self.strokes) + len(paths) > self.most_lines:
            raise JobError(
                f"the drawing and its clones have more than {self.most_lines} lines",
                place=place,
                remedy="Join lines to paths, or split the drawing.",
            )
        style = style_of_dasharray(
            here.inherited["stroke-dasharray"], here.inherited["stroke-width"]
        )
        for path in paths:
            pieces = path.pieces(element.line).transform(here.matrix[:2, :2], here.matrix[:2, 2])
            mapped = pieces.transform(self.page.matrix, self.page.offset)
            self.strokes.append(Stroke(pieces=mapped, layer=here.layer, colour=stroke, style=style))

    def _paint(self, key: str, here: _Here) -> str:
        value = here.inherited[key]
        if value.lower() in ("currentcolor", "context-stroke", "context-fill"):
            value = here.inherited["color"]
        return colour(value)

    def _refuse_kind(self, element: Element, here: _Here) -> None:
        name = element.name
        if name in ("text", "flowRoot"):
            self._refuse(
                element, here, "text cannot be sewn",
                "Convert it to a path (in Inkscape: Path > Object to Path),",
            )  # fmt: skip
        elif name == "image":
            self._refuse(element, here, "an image cannot be sewn", "Trace it,")
        else:
            article = "an" if name[:1] in "aeiou" else "a"
            self._refuse(element, here, f"{article} {name[:40]} cannot be sewn", "Trace it,")

    def _refuse(
        self, element: Element, here: _Here, message: str, remedy: str, colour: str = ""
    ) -> None:
        key = (message, here.layer, colour, element.line)
        self.refusals[key] = Refusal(
            message=message,
            layer=here.layer,
            colour=colour,
            line=element.line,
            remedy=f"{remedy} {_PLAIN}",
        )


def _about(matrix: FloatArray, origin: str, viewport: tuple[float, float]) -> FloatArray:
    """Return ``matrix`` about an origin, which may be given relative to the view box."""
    parts = origin.split()
    percents = {"left": "0%", "top": "0%", "center": "50%", "right": "100%", "bottom": "100%"}
    if len(parts) == 3 and parts[2] in ("0", "0px"):
        parts = parts[:2]
    if len(parts) != 2 or parts[0] in ("top", "bottom") or parts[1] in ("left", "right"):
        raise ValueRefused(
            f"transform-origin is {shown(origin)}, which is not read",
            "Give it as two lengths, or save as plain SVG.",
        )
    x, y = (
        pixels("transform-origin", percents.get(part, part), full_length)
        for part, full_length in zip(parts, viewport, strict=True)
    )
    to_origin, from_origin = np.eye(3), np.eye(3)
    to_origin[:2, 2], from_origin[:2, 2] = (x, y), (-x, -y)
    return to_origin @ matrix @ from_origin
