"""Leaders and fills of a DXF drawing, which are not sewn but are kept when it is edited."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError, Place
from threadline.geometry.read_dxf import DxfMessages, entity_lines, load_dxf, metres_per_unit
from threadline.geometry.strokes import LineStyle, one_line, style_of_linetype
from threadline.geometry.write_dxf import PATTERNS, Fill

_LABEL_REACH = 2.0  # largest distance of a label from the end of its leader, in letter heights
_MAX_POINTS, _MAX_LABEL = 20_000, 100  # points of a leader, characters of its text
_MAX_DIFFERENCE = 0.02  # largest difference between a fill and its boundary, as a share of the size


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leader:
    """A leader line, (n, 2) m: its first point is the arrow head, its text is at the last point.

    ``lines`` has the lines of the file at which the entities of the leader and its text begin.
    """

    points: FloatArray
    label: str
    lines: tuple[int, ...]
    style: LineStyle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Filling:
    """A fill with its boundary, (n, 2) m; its entity begins at ``line`` of the file."""

    ring: FloatArray
    fill: Fill
    line: int


def read_remarks(content: bytes, file: str, most: int) -> tuple[list[Leader], list[Filling]]:
    """Return the leaders and fills of the model space, except in blocks.

    Parameters
    ----------
    content, file
        As for ``read_dxf``.
    most
        Largest number of leaders, and of fills; further ones are omitted.

    Raises
    ------
    JobError
        If the drawing is damaged.
    """
    with DxfMessages().listening():  # ``read_dxf`` has reported its messages already
        document, lines = load_dxf(file), entity_lines(content)
    metres = metres_per_unit(document, None, Place(file))
    space = document.modelspace()
    try:
        texts = _Texts(space.query("MTEXT"), lines)
        leaders = [_leader(remark, texts, lines, metres) for remark in space.query("LEADER")[:most]]
        hatches = space.query("HATCH")[:most]
        fills = [remark for hatch in hatches for remark in _fillings(hatch, lines, metres)]
    except Exception as error:  # damaged entities raise only when they are used
        raise JobError(
            f"not a sound DXF drawing: {one_line(error)}",
            place=Place(file),
            remedy="Save it again as DXF, R2000 or later.",
        ) from error
    return [remark for remark in leaders if remark is not None], fills[:most]


class _Texts:
    """The texts of a drawing, which may be labels of leaders."""

    def __init__(self, texts: Iterable[Any], lines: dict[str, int]) -> None:
        self._texts, self._lines = list(texts), lines
        self._of_handle = {str(text.dxf.handle): text for text in self._texts}
        places = [tuple(text.dxf.insert)[:2] for text in self._texts]
        self._places = np.array(places, dtype=np.float64).reshape(-1, 2)
        self._reach = np.array([_LABEL_REACH * float(text.dxf.char_height) for text in self._texts])

    def label(self, leader: Any, end: FloatArray) -> tuple[str, int]:
        """Return the text of a leader and its line in the file.

        It is the text that the leader names, else the nearest text on the layer of the leader, else
        "" with line 0. ``end``, shape (2,), is the last point of the leader.
        """
        text = self._of_handle.get(str(leader.dxf.get("annotation_handle", "")))
        if text is None and self._texts:
            distance = np.hypot(*(self._places - end).T)
            nearest = int(np.argmin(np.where(distance <= self._reach, distance, np.inf)))
            candidate = self._texts[nearest]
            if (
                distance[nearest] <= self._reach[nearest]
                and candidate.dxf.layer == leader.dxf.layer
            ):
                text = candidate
        if text is None:
            return "", 0
        return text.plain_text().replace("\n", " ")[:_MAX_LABEL], _line(text, self._lines)


def _line(entity: Any, lines: dict[str, int]) -> int:
    return lines.get(str(entity.dxf.handle), 0)


def _leader(entity: Any, texts: _Texts, lines: dict[str, int], metres: float) -> Leader | None:
    points = np.array([tuple(vertex)[:2] for vertex in entity.vertices], dtype=np.float64)
    if not 2 <= len(points) <= _MAX_POINTS or not np.isfinite(points).all():
        return None
    label, line = texts.label(entity, points[-1])
    layers, name = entity.doc.layers, entity.dxf.layer
    layer = layers.get(name) if name in layers else None
    style = style_of_linetype(entity.doc, entity, layer, "solid")
    where = (_line(entity, lines), line)
    return Leader(points=metres * points, label=label, style=style, lines=where)


def _fillings(hatch: Any, lines: dict[str, int], metres: float) -> list[Filling]:
    """Return a fill for each boundary ring of a hatch that consists of chords."""
    found = []
    for path in hatch.paths:
        vertices = getattr(path, "vertices", [])
        if len(vertices) < 3 or any(vertex[2] for vertex in vertices):
            continue
        ring = metres * np.array([vertex[:2] for vertex in vertices], dtype=np.float64)
        if np.isfinite(ring).all():
            found.append(Filling(ring=ring, fill=_fill(hatch), line=_line(hatch, lines)))
    return found


def _fill(hatch: Any) -> Fill:
    """Return the kind of fill most similar to a hatch; an unknown pattern counts as hatched."""
    if hatch.dxf.solid_fill:
        return "solid"
    return "crossed" if hatch.dxf.pattern_name == PATTERNS["crossed"] else "hatched"


def filled_by(ring: FloatArray, measured: FloatArray) -> int | None:
    """Return the index of the ring that is filled by a fill; None if there is none.

    Parameters
    ----------
    ring
        (n, 2) boundary of the fill.
    measured
        (m, 5) result of ``measured_rings`` for the candidates. Only extents and area are compared,
        because curves may be divided into different chords.
    """
    (measures,) = measured_rings([ring])
    size = float(np.hypot(*(measures[2:4] - measures[:2])))
    if size == 0.0 or not len(measured):
        return None
    difference = np.abs(
        (measured - measures) / np.array([size, size, size, size, size * size])
    ).max(axis=1)
    best = int(np.argmin(difference))
    return best if difference[best] <= _MAX_DIFFERENCE else None


def measured_rings(rings: Sequence[FloatArray]) -> FloatArray:
    """Return (m, 5): lowest x and y, highest x and y, and area of each (n, 2) ring."""
    found = np.empty((len(rings), 5))
    for k, ring in enumerate(rings):
        x, y = ring.T
        area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
        found[k] = *ring.min(axis=0), *ring.max(axis=0), area
    return found
