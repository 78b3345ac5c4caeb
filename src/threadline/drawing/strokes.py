"""Drawings as strokes with layer, colour and line, and the reading of their files within limits."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from threadline.drawing.curves import Pieces
from threadline.drawing.line_styles import LineStyle
from threadline.errors import JobError, Place
from threadline.input_files import open_binary

MAX_BYTES = 256 * 1024 * 1024
MAX_STROKES = 1_000_000
"""Most elements of a drawing, with copies."""
MAX_LINES = 200_000
"""Most lines of a drawing, with copies; each needs 4 kB of memory."""


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
        Style of its line, for who edits the drawing.
    """

    pieces: Pieces
    layer: str
    colour: str
    style: LineStyle = "solid"

    @property
    def line(self) -> int:
        """Line of the file, 0 where it is unknown."""
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
    """A drawing as it was read, with all its layers and colours.

    Parameters
    ----------
    file
        Name of the file, for messages.
    strokes
        Strokes in the order of the file.
    refusals
        Entities without a line to sew: text, images, hatches.
    warnings
        Suspicious things found while reading.
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
        If there is no such file, or it has more than ``limit`` bytes, or is an empty drawing.
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
        # For an empty seam file, its own reader names the missing table.
        raise JobError("the file is empty", place=place, remedy="Save the drawing again.")
    return content


def decode_text(content: bytes, file: str, what: str) -> str:
    """Return UTF-8 text, with or without a byte order mark.

    Raises
    ------
    JobError
        If it is binary or in another encoding; with the line.
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
