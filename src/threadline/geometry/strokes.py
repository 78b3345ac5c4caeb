"""Strokes of drawings, and the style of a line from its pattern of dashes and gaps."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from threadline.base.reading import open_binary
from threadline.errors import JobError, Place
from threadline.geometry.curves import Pieces

LineStyle = Literal["solid", "dashed", "dotted", "dashdot"]
_DOT_RATIO = 2.0  # if the longest dash exceeds the shortest by this factor, the shortest is a dot
_DOT_WIDTHS = 2.0  # a dash that is at most so many line widths long is a dot
_NUMBER = re.compile(r"([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)(?:px|mm|pt)?")
_BYLAYER, _BYBLOCK = "BYLAYER", "BYBLOCK"


def style_of(dashes: Sequence[float], dot: float = 0.0) -> LineStyle:
    """Return the style of a line with dashes of these lengths; a dash up to ``dot`` is a dot.

    >>> style_of([1.27]), style_of([0.0]), style_of([2.54, 0.0]), style_of([])
    ('dashed', 'dotted', 'dashdot', 'solid')
    """
    if not dashes:
        return "solid"
    if max(dashes) <= dot:
        return "dotted"
    return "dashdot" if min(dashes) <= dot or max(dashes) > _DOT_RATIO * min(dashes) else "dashed"


def style_of_dasharray(dasharray: str, width: str) -> LineStyle:
    """Return the style of a line of an SVG from its ``stroke-dasharray`` and ``stroke-width``.

    A text that is neither a number nor a length counts as no pattern. This is not an error, because
    the style does not affect what is sewn.

    >>> style_of_dasharray("4 2", "0.3"), style_of_dasharray("6 2 0.5 2", "0.3")
    ('dashed', 'dashdot')
    """
    lengths = [_length(length) for length in re.split(r"[\s,]+", dasharray.strip())]
    known = [length for length in lengths if length is not None]
    if len(known) != len(lengths) or not any(known):
        return "solid"
    pattern = known if len(known) % 2 == 0 else [*known, *known]  # as SVG defines an odd number
    if not any(pattern[1::2]):
        return "solid"  # dashes without gaps
    return style_of(pattern[::2], _DOT_WIDTHS * (_length(width) or 0.0))


def _length(text: str) -> float | None:
    match = _NUMBER.fullmatch(text)
    return None if match is None else float(match[1])


def style_of_linetype(document: Any, entity: Any, layer: Any, inherited: LineStyle) -> LineStyle:
    """Return the style of an entity of a DXF.

    Parameters
    ----------
    document, entity, layer
        Objects of ezdxf; the layer is None if the document does not have the entity's layer.
    inherited
        Style of the insertion of the block that contains the entity.
    """
    name = str(entity.dxf.get("linetype", _BYLAYER))
    if name.upper() == _BYBLOCK:
        return inherited
    if name.upper() == _BYLAYER:
        name = "CONTINUOUS" if layer is None else str(layer.dxf.get("linetype", "CONTINUOUS"))
    if name not in document.linetypes:
        return "solid"
    tags = document.linetypes.get(name).pattern_tags.tags
    return style_of([tag.value for tag in tags if tag.code == 49 and tag.value >= 0.0])


MAX_BYTES = 256 * 1024 * 1024
MAX_STROKES = 1_000_000
"""Largest number of elements of a drawing, copies included."""
MAX_LINES = 200_000
"""Largest number of lines of a drawing, copies included; a line needs 4 kB of memory."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stroke:
    """One entity of a drawing: connected pieces in the order in which they were drawn.

    Parameters
    ----------
    pieces
        Pieces in m, in the drawing's axes, Y up.
    layer, colour
        Name of its layer, and its colour as ``"#rrggbb"``, ``"none"`` without one.
    style
        Style of its line, which matters only when the drawing is edited.
    """

    pieces: Pieces
    layer: str
    colour: str
    style: LineStyle = "solid"

    @property
    def line(self) -> int:
        """Line of the file, 0 if it is unknown."""
        return int(self.pieces.line[0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Refusal:
    """An entity that cannot be sewn: an error if a seam includes its layer and colour."""

    message: str
    layer: str
    colour: str
    line: int
    remedy: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Drawing:
    """A drawing as read from its file, with all its layers and colours.

    Parameters
    ----------
    file
        Name of the file, for messages.
    strokes
        Strokes in the order of the file.
    refusals
        Entities without a line to sew: text, images, hatches.
    warnings
        Warnings about suspicious content.
    """

    file: str
    strokes: tuple[Stroke, ...]
    refusals: tuple[Refusal, ...] = ()
    warnings: tuple[str, ...] = ()


def read_limited(path: Path, limit: int = MAX_BYTES) -> bytes:
    """Return the bytes of a file.

    Raises
    ------
    JobError
        If there is no such file, if it has more than ``limit`` bytes, or if it is an empty drawing.
    """
    place = Place(str(path))
    with open_binary(path) as stream:
        if not path.is_file():
            raise JobError(f"{path} is not a file", remedy="Name a drawing or a seam file.")
        content = stream.read(limit + 1)
    if len(content) > limit:
        raise JobError(
            f"the file has more than {limit} bytes", place=place, remedy="Split the drawing."
        )
    if not content.strip() and path.suffix.lower() != ".toml":
        # The reader of seam files names the missing table of an empty seam file.
        raise JobError("the file is empty", place=place, remedy="Save the drawing again.")
    return content


def decode_text(content: bytes, file: str, what: str) -> str:
    """Return UTF-8 text, with or without a byte order mark.

    Raises
    ------
    JobError
        If the content is binary or has another encoding; names the line.
    """
    if content[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise JobError(f"the {what} is UTF-16 text", place=Place(file), remedy="Save it as UTF-8.")
    zero = content.find(b"\0")
    if zero >= 0:
        raise JobError(
            f"the file is binary, not a {what}", place=Place(file, content[:zero].count(b"\n") + 1)
        )
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise JobError(
            f"byte 0x{content[error.start]:02x} is not UTF-8 text",
            place=Place(file, content[: error.start].count(b"\n") + 1),
            remedy=f"Save the {what} as UTF-8.",
        ) from error


def one_line(error: Exception) -> str:
    """Return the message of a library's exception on one line, cut to 200 characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 200 else text[:200] + "..."
