"""Figures on the pages of a PDF, each as one object that is drawn there.

To merge pages, pypdf takes their contents apart, number by number: 50 s of processor for the motion
of the smallest example. Nothing has to be known of what a figure consists of.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

from pypdf import PageObject, PdfReader, PdfWriter
from pypdf.generic import (
    ArrayObject,
    DecodedStreamObject,
    DictionaryObject,
    FloatObject,
    NameObject,
    PdfObject,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class Place:
    """Place of a figure: its name, page from 0, lower left corner in points, and scale."""

    name: str
    page: int
    x_pt: float
    y_pt: float
    scale: float


def figure_page(figure: Figure) -> bytes:
    """Return a PDF with ``figure`` on its one page; the same figure gives the same bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="pdf", metadata={"CreationDate": None})
    return buffer.getvalue()


def draw_figure(writer: PdfWriter, place: Place, figure: bytes) -> None:
    """Draw the page that ``figure_page`` made at its place, over what stands there."""
    page = writer.pages[place.page]
    objects = _member(cast(DictionaryObject, page["/Resources"].get_object()), "/XObject")
    name = f"/Figure{len(objects)}"
    drawn = PdfReader(io.BytesIO(figure)).pages[0]
    objects[NameObject(name)] = writer._add_object(_form(writer, drawn))
    cm = f"{place.scale:.6f} 0 0 {place.scale:.6f} {place.x_pt:.4f} {place.y_pt:.4f} cm"
    found = page.raw_get("/Contents")
    before = list(found) if isinstance(found, ArrayObject) else [found]
    # What stands there is kept apart, or its last colour and place would be those of the figure.
    page[NameObject("/Contents")] = ArrayObject(
        [_stream(writer, "q"), *before, _stream(writer, f"Q q {cm} {name} Do Q")]
    )


def _form(writer: PdfWriter, drawn: PageObject) -> PdfObject:
    contents = drawn.get_contents()
    plain = DecodedStreamObject()
    plain.set_data(b"" if contents is None else contents.get_data())
    form = plain.flate_encode()
    form[NameObject("/Type")] = NameObject("/XObject")
    form[NameObject("/Subtype")] = NameObject("/Form")
    form[NameObject("/BBox")] = ArrayObject(FloatObject(side) for side in drawn.mediabox)
    for key in ("/Resources", "/Group"):
        if key in drawn:
            form[NameObject(key)] = cast(PdfObject, drawn[key].get_object()).clone(writer)
    return form


def _member(of: DictionaryObject, key: str) -> DictionaryObject:
    if key not in of:
        of[NameObject(key)] = DictionaryObject()
    return cast(DictionaryObject, of[key].get_object())


def _stream(writer: PdfWriter, text: str) -> PdfObject:
    stream = DecodedStreamObject()
    stream.set_data(f"{text}\n".encode())
    return writer._add_object(stream)
