"""DXF drawings: the model space, with blocks, layers, colours and units."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import JobError, Place
from threadline.geometry.dxf_entities import NotFlatError, entity_pieces
from threadline.geometry.strokes import (
    MAX_LINES,
    Drawing,
    LineStyle,
    Refusal,
    Stroke,
    one_line,
    style_of_linetype,
)
from threadline.units import unit_factor

_TEXTS = ("TEXT", "MTEXT", "ATTRIB", "ATTDEF", "ARCTEXT", "ACAD_PROXY_TEXT")
_SILENT = ("VIEWPORT", "SEQEND")  # entities of the sheet, not of the drawing
_MAX_DEPTH = 32
_TEXT_READ = 200
_MAX_MESSAGES, _MAX_MESSAGE_LENGTH = (
    5,
    200,
)  # most messages of ezdxf's log, and most characters of each
_BYLAYER, _BYBLOCK = 256, 0
_SURVEY = 1200.0 / 3937.0  # US survey foot in m
_METRES = {
    1: 0.0254, 2: 0.3048, 3: 1609.344, 4: 1e-3, 5: 1e-2, 6: 1.0, 7: 1e3, 8: 2.54e-8, 9: 2.54e-5,
    10: 0.9144, 11: 1e-10, 12: 1e-9, 13: 1e-6, 14: 0.1, 15: 10.0, 16: 100.0, 17: 1e9,
    18: 149597870700.0, 19: 9.4607304725808e15, 20: 3.085677581491367e16,
    21: _SURVEY, 22: _SURVEY / 12.0, 23: 3.0 * _SURVEY, 24: 5280.0 * _SURVEY,
}  # fmt: skip
"""$INSUNITS -> metres, from the DXF reference."""


def read_dxf(
    content: bytes, file: str, unit: str | None = None, *, most_lines: int | None = None
) -> Drawing:
    """Return the strokes of a DXF drawing, text or binary, of any version that ezdxf reads.

    Parameters
    ----------
    content, file
        The bytes of the file, and its path.
    unit
        Unit of a drawing without unit ($INSUNITS).
    most_lines
        Largest number of lines, including the lines of inserted blocks; None for ``MAX_LINES``.

    Raises
    ------
    JobError
        If it is not a DXF drawing, has no unit, or contradicts ``unit``.
    """
    place = Place(file)
    if re.match(rb"AC10\d\d", content):
        raise JobError("this is a DWG file", place=place, remedy="Save the drawing as DXF.")
    messages = DxfMessages()
    with messages.listening():
        document = load_dxf(file)
    factor = metres_per_unit(document, unit, place)
    walk = _Walk(file, document, entity_lines(content), most_lines or MAX_LINES)
    root = _Inherited("0", "#ffffff", factor * np.eye(2), np.zeros(2))
    try:
        with messages.listening():
            _refuse_explosion(document, walk)
            walk.entities(document.modelspace(), root, 0)
    except JobError:
        raise
    except Exception as error:  # damaged entities raise only when they are used
        raise JobError(
            f"not a sound DXF drawing: {one_line(error)}",
            place=place,
            remedy="Save it again as DXF, R2000 or later.",
        ) from error
    return Drawing(
        file=file,
        strokes=tuple(walk.strokes),
        refusals=tuple(walk.refusals),
        warnings=(*walk.warnings, *(f"{place}: {text}" for text in messages.texts)),
    )


def _text_beginning(entity: Any) -> str:
    """Return the beginning of a text; ezdxf needs quadratic time for the whole text."""
    from ezdxf.tools.text import fast_plain_mtext, plain_text

    if entity.dxftype() == "MTEXT":
        return str(fast_plain_mtext(str(entity.text)[:_TEXT_READ]))
    return str(plain_text(str(entity.dxf.get("text", ""))[:_TEXT_READ]))


def _refuse_explosion(document: Any, walk: _Walk) -> None:
    """Refuse a drawing whose nested blocks expand to too many entities.

    The entities are counted by multiplication, because nine levels of ten insertions each make 1e9
    entities.
    """
    counts: dict[str, int] = {}

    def count(entities: Iterable[Any], open_blocks: tuple[str, ...]) -> int:
        total = 0
        for entity in entities:
            total += 1
            if entity.dxftype() == "INSERT":
                total += max(entity.mcount, 1) * (1 + count_block(entity, open_blocks))
            if total > MAX_LINES and not open_blocks:
                raise JobError(
                    f"the drawing and its blocks make more than {MAX_LINES} entities",
                    place=walk.place(entity),
                    remedy="Join lines to polylines, or split the drawing.",
                )
        return total

    def count_block(insert: Any, open_blocks: tuple[str, ...]) -> int:
        name = str(insert.dxf.name).lower()
        # A block that contains itself is refused later, in ``_insert``.
        if name in open_blocks or len(open_blocks) > _MAX_DEPTH:
            return 0
        if name not in counts:
            block = insert.block()
            counts[name] = 0 if block is None else count(block, (*open_blocks, name))
        return counts[name]

    count(document.modelspace(), ())


class DxfMessages(logging.Handler):
    """Collects ezdxf's log, its only report of omissions and repairs."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a message; drop repeated messages and all after the first few."""
        text = " ".join(record.getMessage().split())[:_MAX_MESSAGE_LENGTH]
        if len(self.texts) < _MAX_MESSAGES and text not in self.texts:
            self.texts.append(text)

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Collect the messages within the block, and keep them from the terminal."""
        logger = logging.getLogger("ezdxf")
        propagated, logger.propagate = logger.propagate, False
        logger.addHandler(self)
        try:
            yield
        finally:
            logger.removeHandler(self)
            logger.propagate = propagated


def load_dxf(file: str) -> Any:
    """Return the ezdxf document; raise JobError if the file is not a DXF drawing."""
    from ezdxf.filemanagement import readfile

    try:
        return readfile(Path(file))
    except Exception as error:  # ezdxf raises many types for a damaged file
        line_match = re.search(r"line[: ]+(\d+)", str(error), re.IGNORECASE)
        raise JobError(
            f"not a DXF drawing: {one_line(error)}",
            place=Place(file, int(line_match[1]) if line_match else 0),
            remedy="Save it again as DXF, R2000 or later.",
        ) from error


def metres_per_unit(document: Any, unit: str | None, place: Place) -> float:
    """Return the metres per unit of $INSUNITS, else of ``unit``; raise JobError without either."""
    stored = document.header.get("$INSUNITS", 0)
    try:
        code = int(stored)
    except (TypeError, ValueError, OverflowError):
        raise JobError(
            f"the drawing's unit is unknown ($INSUNITS is {str(stored)[:40]!r}, not a number)",
            place=place,
            remedy="Save it again as DXF, R2000 or later.",
        ) from None
    given_m = None if unit is None else unit_factor(unit, "m")
    stated_m = _METRES.get(code)
    if stated_m is None:
        if given_m is None:
            raise JobError(
                "the drawing does not say its unit ($INSUNITS is 0)"
                if code == 0
                else f"the drawing's unit is unknown ($INSUNITS is {code}, known are 1 to 24)",
                place=place,
                remedy='Set the unit in the drawing, or write [drawing] unit = "mm".',
            )
        return given_m
    if given_m is not None and abs(given_m / stated_m - 1.0) > 1e-6:
        raise JobError(
            f"the drawing says that its unit is {stated_m:g} m ($INSUNITS is {code}), "
            f"the seam file says {unit}",
            place=place,
            remedy="Remove the unit from the seam file, or correct the drawing.",
        )
    return stated_m


def entity_lines(content: bytes) -> dict[str, int]:
    """Return handle -> first line of each entity of a text DXF."""
    if content.startswith(b"AutoCAD Binary DXF"):
        return {}
    lines = content.split(b"\n")
    found: dict[str, int] = {}
    begin = 0
    for k in range(0, len(lines) - 1, 2):
        code = lines[k].strip()
        if code == b"0":
            begin = k + 1
        elif code == b"5" and begin:
            found[lines[k + 1].strip().decode("ascii", "replace").upper()] = begin
            begin = 0
    return found


@dataclass(frozen=True, slots=True)
class _Inherited:
    """Properties that an entity inherits from the insertion of its block.

    An entity on layer 0 inherits the layer. An entity with BYBLOCK colour or line style inherits
    these. A point p of the block lies at ``matrix @ p + offset``, in m.
    """

    layer: str
    colour: str
    matrix: FloatArray
    offset: FloatArray
    style: LineStyle = "solid"


@dataclass(slots=True)
class _Walk:
    file: str
    document: Any
    lines: dict[str, int]
    most_lines: int
    strokes: list[Stroke] = field(default_factory=list)
    refusals: list[Refusal] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    hidden: set[str] = field(default_factory=set)
    invisible: set[str] = field(default_factory=set)  # layers with a warning of hidden entities

    def place(self, entity: Any) -> Place:
        """Return file and line of an entity."""
        return Place(self.file, self._line(entity))

    def entities(self, entities: Iterable[Any], inherited: _Inherited, depth: int) -> None:
        """Add the strokes of entities, including inserted blocks."""
        for entity in entities:
            kind = entity.dxftype()
            if kind in _SILENT:
                continue
            layer = str(entity.dxf.layer)
            layer = inherited.layer if layer == "0" else layer
            if self._is_hidden(layer) or self._is_invisible(entity, layer):
                continue
            properties = replace(
                inherited,
                layer=layer,
                colour=self._colour(entity, layer, inherited),
                style=style_of_linetype(self.document, entity, self._layer(layer), inherited.style),
            )
            if kind == "INSERT":
                self._insert(entity, properties, depth)
            else:
                self._entity(entity, kind, properties)

    def _entity(self, entity: Any, kind: str, properties: _Inherited) -> None:
        line = self._line(entity)
        if kind in _TEXTS:
            self._refuse_text(entity, properties)
            return
        if kind == "POINT":
            self.warnings.append(f"{Place(self.file, line)}: a POINT was left out")
            return
        try:
            pieces = entity_pieces(entity, line)
        except NotFlatError:
            self._refuse(f"a {kind} is not drawn in the XY plane", properties, line, "Flatten it.")
            return
        except (ValueError, ArithmeticError) as error:
            raise JobError(f"a {kind} is wrong: {error}", place=Place(self.file, line)) from error
        if pieces is None:
            self._refuse(
                f"a {kind} cannot be sewn", properties, line, "Explode it, or choose other layers."
            )
            return
        if kind == "SPLINE" and len(entity.control_points) == 0:
            self.warnings.append(
                f"{Place(self.file, line)}: a SPLINE has fit points only; its control points "
                "were computed, other programs may draw it a little differently"
            )
        if len(self.strokes) >= self.most_lines:
            raise JobError(
                f"the drawing and its blocks have more than {self.most_lines} lines",
                place=Place(self.file, line),
                remedy="Join lines to polylines, or split the drawing.",
            )
        placed = pieces.transform(properties.matrix, properties.offset)
        self.strokes.append(
            Stroke(
                pieces=placed,
                layer=properties.layer,
                colour=properties.colour,
                style=properties.style,
            )
        )

    def _insert(self, insert: Any, properties: _Inherited, depth: int) -> None:
        line = self._line(insert)
        place = Place(self.file, line)
        name = str(insert.dxf.name)
        block = insert.block()
        if block is None or block.block.is_xref:
            reason = "is not in the file" if block is None else "lies in another file"
            self._refuse(
                f"the block {name[:60]!r} {reason}", properties, line, "Bind it to the drawing."
            )
            return
        if depth >= _MAX_DEPTH:
            raise JobError(
                f"blocks are nested more than {_MAX_DEPTH} deep at {name[:60]!r}; "
                "does a block hold itself?",
                place=place,
            )
        for attribute in insert.attribs:
            # An attribute can be invisible as an entity or by an additional flag.
            if not (attribute.is_invisible or self._is_invisible(attribute, properties.layer)):
                self._refuse_text(attribute, properties)
        for one_insert in insert.multi_insert() if insert.mcount > 1 else [insert]:
            map3d = np.array(list(one_insert.matrix44())).reshape(4, 4)
            if np.abs(map3d[:2, 2]).max() > 1e-9 * np.abs(map3d[:2, :2]).max():
                self._refuse(
                    f"the block {name[:60]!r} is not inserted in the XY plane",
                    properties,
                    line,
                    "Flatten it.",
                )
                return
            placed = replace(
                properties,
                matrix=properties.matrix @ map3d[:2, :2].T,
                offset=properties.matrix @ map3d[3, :2] + properties.offset,
            )
            self.entities(block, placed, depth + 1)

    def _colour(self, entity: Any, layer: str, inherited: _Inherited) -> str:
        from ezdxf.colors import aci2rgb

        rgb = entity.rgb
        if rgb is None:
            index = abs(int(entity.dxf.get("color", _BYLAYER)))
            if index == _BYBLOCK:
                return inherited.colour
            if index == _BYLAYER:
                layer_entry = self._layer(layer)
                rgb = None if layer_entry is None else layer_entry.rgb
                index = 7 if layer_entry is None else abs(int(layer_entry.dxf.get("color", 7)))
            if rgb is None:
                rgb = aci2rgb(index if 1 <= index <= 255 else 7)
        return "#{:02x}{:02x}{:02x}".format(*rgb)

    def _layer(self, name: str) -> Any:
        return self.document.layers.get(name) if name in self.document.layers else None

    def _is_hidden(self, name: str) -> bool:
        layer = self._layer(name)
        hidden = name.lower() == "defpoints" or (
            layer is not None and (layer.is_off() or layer.is_frozen())
        )
        if hidden and name not in self.hidden:
            self.hidden.add(name)
            self.warnings.append(f"{self.file}: layer {name!r} is hidden and was left out")
        return hidden

    def _is_invisible(self, entity: Any, layer: str) -> bool:
        """Return whether group code 60 hides an entity; on an insert it hides the whole block."""
        if not int(entity.dxf.get("invisible", 0)):
            return False
        if layer not in self.invisible:
            self.invisible.add(layer)
            self.warnings.append(
                f"{Place(self.file, self._line(entity))}: a {entity.dxftype()} on layer {layer!r} "
                "is invisible; such entities were left out"
            )
        return True

    def _line(self, entity: Any) -> int:
        return self.lines.get(str(entity.dxf.handle), 0)

    def _refuse_text(self, entity: Any, properties: _Inherited) -> None:
        text = _text_beginning(entity)
        self._refuse(
            f"the text {text[:40]!r} cannot be sewn",
            properties,
            self._line(entity),
            "Explode it to lines, or put it on a layer that is not chosen.",
        )

    def _refuse(self, message: str, properties: _Inherited, line: int, remedy: str) -> None:
        self.refusals.append(
            Refusal(
                message=message,
                layer=properties.layer,
                colour=properties.colour,
                line=line,
                remedy=remedy,
            )
        )
