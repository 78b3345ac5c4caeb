"""Drawings of the panel: files read into shapes, shapes written as DXF, text as outlines.

A separate process reads a drawing. It imports the geometry modules, but neither the panel nor the
planner.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from threadline.base.arrays import FloatArray
from threadline.errors import InputError, JobError, Place
from threadline.geometry.contours import drop_zero_lengths
from threadline.geometry.curves import Pieces
from threadline.geometry.dxf_annotations import filled_by, measured_rings, read_remarks
from threadline.geometry.read_dxf import read_dxf
from threadline.geometry.strokes import Drawing, LineStyle, Stroke
from threadline.geometry.svg.read_svg import read_svg
from threadline.geometry.write_dxf import DrawnShape, Fill, ShapeKind, dxf_of, ring_of

MOST_SHAPES = 5000
MOST_POINTS = 400_000
"""Most points of all shapes of a drawing together."""
_MOST_WARNINGS = 20
WRONG = 2  # exit status of the process for a drawing with an error
_CHORDS = 64  # chords for a piece of curve that is neither a line nor an arc
_CLOSED_M = 1e-6
_LEAST = {"line": 2, "polygon": 3, "arc": 3, "circle": 2, "spline": 3, "leader": 2}
_READERS = {".dxf": read_dxf, ".svg": read_svg}

Millimetre = Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]


class Shape(BaseModel):
    """A shape of the page, mm; see ``DrawnShape``."""

    model_config = ConfigDict(extra="forbid")

    kind: ShapeKind
    points: Annotated[list[tuple[Millimetre, Millimetre]], Field(min_length=2, max_length=20000)]
    style: LineStyle = "solid"
    fill: Fill = "none"
    label: Annotated[str, Field(max_length=100)] = ""
    group: Annotated[int, Field(ge=0, le=10**9)] = 0


class Lettering(BaseModel):
    """A text to be outlined."""

    model_config = ConfigDict(extra="forbid")

    text: Annotated[str, Field(min_length=1, max_length=100)]
    height_mm: Annotated[float, Field(gt=0.1, le=1000.0)]
    """Height of its capital letters."""
    font: Literal["DejaVu Sans", "DejaVu Serif", "DejaVu Sans Mono"] = "DejaVu Sans"


SHAPES: TypeAdapter[list[Shape]] = TypeAdapter(
    Annotated[list[Shape], Field(min_length=1, max_length=MOST_SHAPES)]
)


def dxf(shapes: Sequence[Shape]) -> bytes:
    """Return shapes as a DXF.

    Raises
    ------
    JobError
        If a shape has too few points.
    """
    for number, shape in enumerate(shapes, 1):
        if len(shape.points) < _LEAST[shape.kind]:
            raise JobError(
                f"shape {number}: a {shape.kind} needs {_LEAST[shape.kind]} points or more, this "
                f"one has {len(shape.points)}",
                remedy="Draw the missing points.",
            )
    return dxf_of(
        DrawnShape(
            kind=one.kind,
            points=1e-3 * np.array(one.points),
            style=one.style,
            fill=one.fill,
            label=one.label,
            group=one.group,
        )
        for one in shapes
    )


def opened(name: str, content: bytes) -> dict[str, list[Any]]:
    """Return the shapes of a DXF or SVG, and the entities left out, line by line.

    Points are in mm; shapes of one entity have one group. Lines, circles and their arcs stay as
    they are; other curves become 64 chords a piece. Leaders of a DXF with their texts, and fills of
    drawn shapes, are kept; other texts, fills and entities without lines are left out.

    Raises
    ------
    JobError
        If the file cannot be read, or has more shapes than the page can edit.
    """
    drawing = _read(name, content)
    _refuse_points(drawing.strokes, name)
    strokes, _ = drop_zero_lengths(drawing.strokes, name)
    shapes = [
        {
            "kind": kind,
            "points": np.round(1e3 * points, 6).tolist(),
            "group": group,
            "style": stroke.style,
        }
        for group, stroke in enumerate(strokes, 1)
        for kind, points in _parts(stroke.pieces)
    ]
    if not shapes or len(shapes) > MOST_SHAPES:
        raise JobError(
            f"the drawing has {len(shapes)} lines, the page can edit 1 to {MOST_SHAPES}",
            place=Place(name),
            remedy="Sew it unedited: name it in a seam file.",
        )
    remark_lines = _add_remarks(shapes, name, content) if name.lower().endswith(".dxf") else set()
    refusals = [refusal for refusal in drawing.refusals if refusal.line not in remark_lines]
    left_out = [f"{name}:{refusal.line}: {refusal.message}" for refusal in refusals]
    return {"shapes": shapes, "left_out": left_out[:_MOST_WARNINGS]}


def _refuse_points(strokes: Sequence[Stroke], name: str) -> None:
    """Refuse strokes whose chords would make more points than the page can edit."""
    points = 0
    for stroke in strokes:
        straight = int(np.count_nonzero(stroke.pieces.is_line | stroke.pieces.is_circle))
        points += 2 * straight + _CHORDS * (len(stroke.pieces) - straight)
        if points > MOST_POINTS:
            raise JobError(
                f"the drawing becomes more than {MOST_POINTS} points for editing",
                place=Place(name, stroke.line),
                remedy="Simplify its curves, or sew it unedited: name it in a seam file.",
            )


def _add_remarks(shapes: list[dict[str, Any]], name: str, content: bytes) -> set[int]:
    """Add leaders to the shapes of a DXF, and fills to their shapes.

    Returns
    -------
    set
        First lines of the entities in the file that were added.
    """
    with _as_file(name, content) as file:
        leaders, fills = read_remarks(content, str(file), MOST_SHAPES - len(shapes))
    remark_lines: set[int] = set()
    rings = measured_rings(
        [
            1e-3 * ring_of(DrawnShape(kind=one["kind"], points=1e-3 * np.array(one["points"])))
            for one in shapes
        ]
    )
    for filling in fills:
        filled_index = filled_by(filling.ring, rings)
        if filled_index is not None and filling.line:
            shapes[filled_index]["fill"] = filling.fill
            remark_lines.add(filling.line)
    group = max((one["group"] for one in shapes), default=0)
    for number, leader in enumerate(leaders, group + 1):
        points = np.round(1e3 * leader.points, 6).tolist()
        shapes.append(
            {
                "kind": "leader",
                "points": points,
                "group": number,
                "label": leader.label,
                "style": leader.style,
            }
        )
        remark_lines.update(leader.lines)
    return remark_lines - {0}


@contextmanager
def _as_file(name: str, content: bytes) -> Iterator[Path]:
    """Provide a drawing as a file, for readers that need one."""
    with tempfile.TemporaryDirectory(prefix="threadline-drawing-") as folder:
        file = Path(folder) / f"drawing{name.lower()[-4:]}"
        file.write_bytes(content)
        yield file


def _read(name: str, content: bytes) -> Drawing:
    reader = _READERS.get(name.lower()[-4:])
    if reader is None:
        raise JobError(
            f"{name[:60]!r} is not a known kind of drawing", remedy="Open a .dxf or a .svg."
        )
    with _as_file(name, content) as file:
        try:
            return reader(content, str(file), most_lines=MOST_SHAPES)
        except JobError as error:  # name the client's file, not the temporary one
            line = 0 if error.place is None else error.place.line
            raise JobError(error.message, place=Place(name, line), remedy=error.remedy) from error


def _parts(pieces: Pieces) -> list[tuple[ShapeKind, FloatArray]]:
    """Return the shapes of one stroke: runs of chords, arcs and circles, each (n, 2) m."""
    shapes: list[tuple[ShapeKind, FloatArray]] = []
    chords: list[FloatArray] = []

    def end_chords() -> None:
        if not chords:
            return
        points = np.vstack([chords[0][:1], *(part[1:] for part in chords)])
        closed = len(points) > 3 and bool(np.hypot(*(points[-1] - points[0])) <= _CLOSED_M)
        shapes.append(("polygon", points[:-1]) if closed else ("line", points))
        chords.clear()

    for k in range(len(pieces)):
        if not pieces.is_circle[k]:
            u = np.linspace(0.0, 1.0, 2 if pieces.is_line[k] else _CHORDS + 1)
            chords.append(pieces.evaluate(np.full(len(u), k), u)[0])
            continue
        end_chords()
        points = pieces.evaluate(np.full(3, k), np.array([0.0, 0.5, 1.0]))[0]
        if abs(abs(pieces.sweep_rad[k]) - 2.0 * np.pi) < 1e-9:
            shapes.append(("circle", np.vstack([pieces.top[k, :1], points[:1]])))
        else:
            shapes.append(("arc", points))
    end_chords()
    return shapes


def outlines(lettering: Lettering) -> list[dict[str, Any]]:
    """Return the outlines of a text as polygons, mm, its baseline beginning at 0, 0."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    font = FontProperties(family=lettering.font)
    capital = TextPath((0.0, 0.0), "H", size=100.0, prop=font).get_extents().height
    size = 100.0 * lettering.height_mm / capital
    path = TextPath((0.0, 0.0), lettering.text, size=size, prop=font)
    rings = [np.asarray(ring, dtype=np.float64) for ring in path.to_polygons(closed_only=True)]
    return [
        {"kind": "polygon", "points": np.round(ring[:-1], 4).tolist(), "group": 1}
        for ring in rings
        if len(ring) > 3
    ]


def why_invalid(error: ValidationError) -> str:
    """Return the first fault in a message, and its place."""
    first = error.errors(include_url=False, include_input=False)[0]
    return f"{'.'.join(map(str, first['loc'])) or 'it'}: {first['msg']}"


def answered(what: str, name: str, content: bytes) -> tuple[int, bytes]:
    """Read the shapes of a drawing (``what`` is ``shapes``), or write shapes as a DXF.

    Returns
    -------
    int, bytes
        0 and the result, or 2 and a line that says why there is none.
    """
    try:
        if what == "shapes":
            return 0, json.dumps(opened(name, content), allow_nan=False).encode()
        return 0, dxf(SHAPES.validate_json(content))
    except (InputError, ValidationError) as error:
        why = why_invalid(error) if isinstance(error, ValidationError) else str(error)
        return WRONG, f"{why}\n".encode("utf-8", "replace")


def main() -> None:
    """Answer the request on standard input."""
    what, name = sys.argv[1:]
    status, output = answered(what, name, sys.stdin.buffer.read())
    (sys.stderr if status else sys.stdout).buffer.write(output)
    sys.exit(status)
