"""Leaders and fills of a DXF drawing: nobody sews them, and who edits the drawing keeps them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError, Place
from threadline.geometry.read_dxf import Said, entity_lines, load_dxf, metres_per_unit
from threadline.geometry.strokes import LineStyle, one_line, style_of_linetype
from threadline.geometry.write_dxf import PATTERNS, Fill

_NEAR = 2.0  # heights of its letters that a label may lie away from the end of its leader
_MOST_POINTS, _LONGEST = 20_000, 100  # of a leader, and of its text
_ALIKE = 0.02  # share of its size by which a fill may differ from what bounds it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leader:
    """A line that points at something with its first point, (n, 2) m, and the text at its last.

    ``lines`` are those of the file at which its entities begin.
    """

    points: FloatArray
    label: str
    lines: tuple[int, ...]
    style: LineStyle


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Filling:
    """A fill, and the (n, 2) m around it; ``line`` of the file is where its entity begins."""

    ring: FloatArray
    fill: Fill
    line: int


def read_remarks(content: bytes, file: str, most: int) -> tuple[list[Leader], list[Filling]]:
    """Return the leaders and the fills of the model space, without those of blocks.

    Parameters
    ----------
    content, file
        As for ``read_dxf``.
    most
        Leaders and fills behind this number are left out.

    Raises
    ------
    JobError
        If the drawing is damaged.
    """
    with Said().listening():  # what is to be told of it, ``read_dxf`` has told
        document, lines = load_dxf(file), entity_lines(content)
    metres = metres_per_unit(int(document.header.get("$INSUNITS", 0)), None, Place(file))
    space = document.modelspace()
    try:
        texts = _Texts(space.query("MTEXT"), lines)
        leaders = [_leader(one, texts, lines, metres) for one in space.query("LEADER")[:most]]
        hatches = space.query("HATCH")[:most]
        fills = [one for hatch in hatches for one in _fillings(hatch, lines, metres)]
    except Exception as error:  # damaged entities are met only when they are looked at
        raise JobError(
            f"not a sound DXF drawing: {one_line(error)}",
            place=Place(file),
            remedy="Save it again as DXF, R2000 or later.",
        ) from error
    return [one for one in leaders if one is not None], fills[:most]


class _Texts:
    """The texts of a drawing, which may be labels of leaders."""

    def __init__(self, texts: Iterable[Any], lines: dict[str, int]) -> None:
        self._texts, self._lines = list(texts), lines
        self._of_handle = {str(text.dxf.handle): text for text in self._texts}
        places = [tuple(text.dxf.insert)[:2] for text in self._texts]
        self._places = np.array(places, dtype=np.float64).reshape(-1, 2)
        self._reach = np.array([_NEAR * float(text.dxf.char_height) for text in self._texts])

    def label(self, leader: Any, end: FloatArray) -> tuple[str, int]:
        """Return the text of a leader that ends at (2,), and its line: the one that it names.

        Else it is the nearest on its layer; empty, and 0, where there is none.
        """
        text = self._of_handle.get(str(leader.dxf.get("annotation_handle", "")))
        if text is None and self._texts:
            away = np.hypot(*(self._places - end).T)
            nearest = int(np.argmin(np.where(away <= self._reach, away, np.inf)))
            near = self._texts[nearest]
            if away[nearest] <= self._reach[nearest] and near.dxf.layer == leader.dxf.layer:
                text = near
        if text is None:
            return "", 0
        return text.plain_text().replace("\n", " ")[:_LONGEST], _line(text, self._lines)


def _line(entity: Any, lines: dict[str, int]) -> int:
    return lines.get(str(entity.dxf.handle), 0)


def _leader(entity: Any, texts: _Texts, lines: dict[str, int], metres: float) -> Leader | None:
    points = np.array([tuple(vertex)[:2] for vertex in entity.vertices], dtype=np.float64)
    if not 2 <= len(points) <= _MOST_POINTS or not np.isfinite(points).all():
        return None
    label, line = texts.label(entity, points[-1])
    layers, name = entity.doc.layers, entity.dxf.layer
    layer = layers.get(name) if name in layers else None
    style = style_of_linetype(entity.doc, entity, layer, "solid")
    where = (_line(entity, lines), line)
    return Leader(points=metres * points, label=label, style=style, lines=where)


def _fillings(hatch: Any, lines: dict[str, int], metres: float) -> list[Filling]:
    """Return what a hatch fills: one for each of its rings that is made of chords."""
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
    """Return the fill that is nearest to a hatch: a pattern that is none of ours is hatched."""
    if hatch.dxf.solid_fill:
        return "solid"
    return "crossed" if hatch.dxf.pattern_name == PATTERNS["crossed"] else "hatched"


def filled_by(ring: FloatArray, measured: FloatArray) -> int | None:
    """Return which of several rings a fill is of; None where it is of none.

    Parameters
    ----------
    ring
        (n, 2) around the fill.
    measured
        (m, 5) of the rings. Curves are other chords here and there: ends and area are compared.
    """
    (ours,) = measured_rings([ring])
    size = float(np.hypot(*(ours[2:4] - ours[:2])))
    if size == 0.0 or not len(measured):
        return None
    off = np.abs((measured - ours) / np.array([size, size, size, size, size * size])).max(axis=1)
    best = int(np.argmin(off))
    return best if off[best] <= _ALIKE else None


def measured_rings(rings: Sequence[FloatArray]) -> FloatArray:
    """Return (m, 5): the lowest and the highest x and y of each (n, 2) ring, and its area."""
    found = np.empty((len(rings), 5))
    for k, ring in enumerate(rings):
        x, y = ring.T
        area = 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))
        found[k] = *ring.min(axis=0), *ring.max(axis=0), area
    return found
