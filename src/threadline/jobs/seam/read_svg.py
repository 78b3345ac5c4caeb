"""Seams from SVG drawings: paths and shapes with transforms, units, layers and stroke colours."""

from __future__ import annotations

import io
import re
from typing import Any
from xml.etree import ElementTree

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import JobError, Place
from threadline.jobs.seam.drawing import Drawing, Refusal, Stroke, one_line
from threadline.jobs.seam.pieces import Pieces, join_pieces
from threadline.jobs.seam.shapes import bezier, chords, ellipse_arc
from threadline.jobs.seam.svg_scan import CLONE, HIDDEN, LAYER, LINE, SvgScan, scan_svg
from threadline.units import unit_factor

_SHOWN = 60
_PIXEL_M = 0.0254 / 96.0  # CSS: 96 pixels to the inch


def read_svg(content: bytes, file: str, unit: str | None = None) -> Drawing:
    """Return the strokes of an SVG drawing, in m, Y up from the lower edge of the page.

    Parameters
    ----------
    content, file
        The bytes of the file, and its name for messages.
    unit
        What one pixel is, for a drawing that states no physical size.

    Raises
    ------
    JobError
        If it is no SVG, is unsafe to read, or contradicts the unit given; with the line.

    Notes
    -----
    SVG counts Y downwards from the upper edge; here the part lies as it looks on the screen.
    """
    scan = scan_svg(content, file)
    root = _load(scan, file)
    (x_m, y_m), warnings = _pixel(scan, root, unit, file)
    matrix = np.array([[x_m, 0.0], [0.0, -y_m]])
    offset = np.array([0.0, float(root.height) * y_m])
    strokes: list[Stroke] = []
    for shape in _shapes(root):
        values = shape.values
        line = int(values.get(LINE, 0))
        place = Place(file, line)
        if _is_hidden(values):
            continue
        colour, has_fill = _colour(shape.stroke), _colour(shape.fill) != "none"
        if colour == "none":
            if not has_fill:
                warnings.append(f"{place}: a shape with neither stroke nor fill was left out")
                continue
            warnings.append(f"{place}: a shape without a stroke; its outline is sewn")
        own = _matrix(shape.transform)
        try:
            paths = _paths(shape, line)
        except (ValueError, ArithmeticError) as error:
            raise JobError(f"a shape is wrong: {error}", place=place) from error
        for pieces in paths:
            mapped = pieces.transform(*own).transform(matrix, offset)
            strokes.append(Stroke(pieces=mapped, layer=values.get(LAYER, ""), colour=colour))
    return Drawing(
        file=file,
        strokes=tuple(strokes),
        refusals=tuple(_refusals(scan)),
        warnings=tuple(warnings),
    )


def _load(scan: SvgScan, file: str) -> Any:
    from svgelements import SVG

    try:
        root = SVG.parse(io.StringIO(scan.text), reify=False, ppi=96.0, on_error="raise")
    except Exception as error:  # svgelements raises a dozen unrelated types on malformed input
        _refuse_path_data(scan, file, error)
        raise JobError(
            f"the SVG cannot be read: {one_line(error)}",
            place=Place(file),
            remedy="Save it as plain SVG.",
        ) from error
    if not isinstance(root, SVG) or not root.height or not root.width:
        raise JobError("the SVG has no size", place=Place(file), remedy="Give it a page size.")
    return root


def _refuse_path_data(scan: SvgScan, file: str, error: Exception) -> None:
    """Refuse the first path whose data cannot be read: svgelements names none. Else return."""
    from svgelements import Path

    # The scan has refused entities, and nesting without end.
    for element in ElementTree.fromstring(scan.text).iter():  # noqa: S314
        data = element.get("d")
        if data is None:
            continue
        try:
            Path(data)
        except Exception:
            no_number = re.search(r"nan|inf(?:inity)?", data, re.IGNORECASE)
            shown = data if len(data) <= _SHOWN else data[:_SHOWN] + "..."
            raise JobError(
                f"{no_number[0]!r} in the data of a path is no number"
                if no_number
                else f"the data of a path is wrong: {shown!r}",
                place=Place(file, int(element.get(LINE, 0))),
                remedy="Correct it, or draw the path again and save as plain SVG.",
            ) from error


def _pixel(
    scan: SvgScan, root: Any, unit: str | None, file: str
) -> tuple[tuple[float, float], list[str]]:
    """Return the width and height of a pixel in m, and a warning where they are assumed."""
    if scan.size_m is not None:
        if unit is not None:
            raise JobError(
                f"the drawing states its size, the seam file a unit ({unit})",
                place=Place(file),
                remedy="Remove the unit from the seam file.",
            )
        # svgelements takes 0.0393701 in for a millimetre, half a micron off in a metre; what it
        # makes of the page's size tells how large its pixel is.
        return (scan.size_m[0] / float(root.width), scan.size_m[1] / float(root.height)), []
    if unit is not None:
        return (unit_factor(unit, "m"), unit_factor(unit, "m")), []
    return (_PIXEL_M, _PIXEL_M), [
        f"{Place(file)}: the SVG states no physical size; 96 pixels are taken as an inch"
    ]


def _shapes(root: Any) -> list[Any]:
    from svgelements import Image, Shape

    return [e for e in root.elements() if isinstance(e, Shape) and not isinstance(e, Image)]


def _is_hidden(values: dict[str, Any]) -> bool:
    hidden = values.get(HIDDEN)
    if hidden and not (hidden == "symbol" and values.get(CLONE)):
        return True
    return values.get("visibility") in ("hidden", "collapse")


def _colour(colour: Any) -> str:
    if colour is None or colour.value is None:
        return "none"
    return f"#{colour.red:02x}{colour.green:02x}{colour.blue:02x}"


def _matrix(transform: Any) -> tuple[FloatArray, FloatArray]:
    """Return the (2, 2) matrix and the (2,) offset of an SVG matrix."""
    t = transform
    return np.array([[t.a, t.c], [t.b, t.d]], dtype=np.float64), np.array([t.e, t.f])


def _paths(shape: Any, line: int) -> list[Pieces]:
    """Return the subpaths of a shape, before its transform, in pixels."""
    from svgelements import Arc, Close, CubicBezier, Line, Move, Path, QuadraticBezier

    found: list[Pieces] = []
    parts: list[Pieces] = []
    path = shape if isinstance(shape, Path) else Path(shape.segments(transformed=False))
    for segment in path:
        if isinstance(segment, Move):
            if parts:
                found.append(join_pieces(parts))
            parts = []
        elif isinstance(segment, CubicBezier):
            control = (segment.start, segment.control1, segment.control2, segment.end)
            parts.append(bezier(_points(*control), line=line))
        elif isinstance(segment, QuadraticBezier):
            parts.append(bezier(_points(segment.start, segment.control, segment.end), line=line))
        elif isinstance(segment, Arc):
            parts.append(_arc(segment, line))
        elif isinstance(segment, Line | Close):
            ends = _points(segment.start, segment.end)
            # Closing a path that has come back to its start is no segment of its own.
            if not (isinstance(segment, Close) and parts and (ends[0] == ends[1]).all()):
                parts.append(chords(ends, line))
        else:
            raise ValueError(f"unknown segment {type(segment).__name__}")
    return [*found, join_pieces(parts)] if parts else found


def _points(*points: Any) -> FloatArray:
    if any(point is None for point in points):
        raise ValueError("a path does not begin with a move")
    array = np.array([[point.x, point.y] for point in points], dtype=np.float64)
    if not np.isfinite(array).all():
        raise ValueError("a coordinate is not a finite number")
    return array


def _arc(arc: Any, line: int) -> Pieces:
    centre, prx, pry = _points(arc.center, arc.prx, arc.pry)
    begin = float(arc.get_start_t())
    return ellipse_arc(centre, prx - centre, pry - centre, begin, float(arc.sweep), line)


def _refusals(scan: SvgScan) -> list[Refusal]:
    texts = [
        Refusal(
            message="text cannot be sewn",
            layer=layer,
            colour="",
            line=line,
            remedy="Convert it to a path (in Inkscape: Path > Object to Path), "
            "or put it on a layer that is not chosen.",
        )
        for line, layer in scan.texts
    ]
    others = [
        Refusal(
            message=f"an {name} cannot be sewn" if name == "image" else f"a {name} cannot be sewn",
            layer=layer,
            colour="",
            line=line,
            remedy="Trace it, or put it on a layer that is not chosen.",
        )
        for name, line, layer in scan.others
    ]
    return texts + others
