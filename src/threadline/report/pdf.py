"""Writes a document as a PDF; each figure is one object on its page.

pypdf merges pages by parsing their contents, which takes 50 s for the smallest example. A figure
as one object needs no parsing.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast
from xml.sax.saxutils import escape

from pypdf import PageObject, PdfReader, PdfWriter
from pypdf.generic import (
    ArrayObject,
    DecodedStreamObject,
    DictionaryObject,
    FloatObject,
    NameObject,
    PdfObject,
)
from reportlab.lib.colors import black
from reportlab.lib.utils import simpleSplit
from reportlab.pdfgen.canvas import Canvas
from reportlab.platypus import (
    BaseDocTemplate,
    Flowable,
    Frame,
    KeepTogether,
    PageTemplate,
    Paragraph,
    Spacer,
)
from reportlab.platypus import Table as Cells

from threadline.report.document import Document, Table
from threadline.report.pdf_tables import (
    BOLD,
    FONT,
    heading_style,
    shortened,
    table_parts,
    text_style,
    width_pt,
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
    """Draw the page made by ``figure_page`` at its place, over the contents of the page."""
    page = writer.pages[place.page]
    objects = _member(cast(DictionaryObject, page["/Resources"].get_object()), "/XObject")
    name = f"/Figure{len(objects)}"
    figure_page_read = PdfReader(io.BytesIO(figure)).pages[0]
    objects[NameObject(name)] = writer._add_object(_form(writer, figure_page_read))
    cm = f"{place.scale:.6f} 0 0 {place.scale:.6f} {place.x_pt:.4f} {place.y_pt:.4f} cm"
    contents = page.raw_get("/Contents")
    earlier_streams = list(contents) if isinstance(contents, ArrayObject) else [contents]
    # q and Q keep colour and position of the page's contents from changing the figure's.
    page[NameObject("/Contents")] = ArrayObject(
        [_stream(writer, "q"), *earlier_streams, _stream(writer, f"Q q {cm} {name} Do Q")]
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


WIDTH_PT, HEIGHT_PT = 595.2756, 841.8898
"""Size of an upright A4 page, points: 210 by 297 mm."""
_SIDE_PT, _TOP_PT, _BOTTOM_PT = 37.0, 48.0, 46.0
_ROOM_PT = WIDTH_PT - 2 * _SIDE_PT  # 7.24 inches: a figure of 7.2 keeps its size
_TALL_PT = HEIGHT_PT - _TOP_PT - _BOTTOM_PT - 12.0  # height of a page below its verdict
_GAP_PT = 10.0  # space below a caption
_LEAST_SHARE = 0.85  # smallest scale of a figure that is shrunk to half a page
_HEAD_PT = 8.0
_HEAD_LINES = 2  # lines of the verdict above a page; the first page has all


class _Picture(Flowable):
    """Empty space for a figure; it records its place, and the figure is drawn later."""

    def __init__(
        self, name: str, size_pt: tuple[float, float], scale: float, places: list[Place]
    ) -> None:
        super().__init__()
        self.width, self.height = size_pt
        self._name, self._scale, self._places = name, scale, places

    def draw(self) -> None:
        x_pt, y_pt = self.canv.absolutePosition(0.0, 0.0)
        page = self.canv.getPageNumber() - 1
        self._places.append(Place(self._name, page, x_pt, y_pt, self._scale))


def write_pdf(document: Document, file: Path) -> None:
    """Write ``document`` into ``file``; its texts must have control characters escaped.

    The same document gives the same bytes.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    figures = {name: figure_page(figure) for name, figure in document.figures.items()}
    # Each page shows the number of pages, which is known after a first pass.
    text, _ = _text_pages(document, 0)
    text, places = _text_pages(document, len(PdfReader(io.BytesIO(text)).pages))
    writer = PdfWriter(clone_from=io.BytesIO(text))
    for place in places:
        draw_figure(writer, place, figures[place.name])
    with file.open("wb") as stream:
        writer.write(stream)


def _text_pages(document: Document, pages: int) -> tuple[bytes, list[Place]]:
    """Return a PDF without figures, ``pages`` as its number of pages, and the places of figures."""
    places: list[Place] = []
    buffer = io.BytesIO()
    template_document = BaseDocTemplate(
        buffer,
        pagesize=(WIDTH_PT, HEIGHT_PT),
        title=document.title,
        creator="Threadline",
        invariant=1,
    )
    frame = Frame(
        _SIDE_PT,
        _BOTTOM_PT,
        _ROOM_PT,
        HEIGHT_PT - _TOP_PT - _BOTTOM_PT,
        leftPadding=0,
        rightPadding=0,
        topPadding=0,
        bottomPadding=0,
    )

    def head_and_foot(canvas: Canvas, template: BaseDocTemplate) -> None:
        _head_and_foot(canvas, document, template.page, pages)

    template_document.addPageTemplates([PageTemplate(frames=[frame], onPage=head_and_foot)])
    template_document.build(_story(document, places))
    return buffer.getvalue(), places


def _head_and_foot(canvas: Canvas, document: Document, page: int, pages: int) -> None:
    verdict = "; ".join(text for text, _ in document.verdicts)
    if page > 1 and verdict:
        canvas.setFont(BOLD, _HEAD_PT)
        lines = simpleSplit(verdict, BOLD, _HEAD_PT, _ROOM_PT)
        if len(lines) > _HEAD_LINES:
            remaining_text = " ".join(lines[_HEAD_LINES - 1 :])
            lines = [*lines[: _HEAD_LINES - 1], shortened(remaining_text, BOLD, _HEAD_PT, _ROOM_PT)]
        y_pt = HEIGHT_PT - _TOP_PT + 8.0 + 1.25 * _HEAD_PT * (len(lines) - 1)
        for number, line in enumerate(lines):
            canvas.drawString(_SIDE_PT, y_pt - 1.25 * _HEAD_PT * number, line)
    page_text = f"page {page} of {pages}"
    room_pt = _ROOM_PT - width_pt(page_text, FONT, _HEAD_PT) - 12.0
    canvas.setFont(FONT, _HEAD_PT)
    title = shortened(document.title, FONT, _HEAD_PT, room_pt)
    canvas.drawString(_SIDE_PT, _BOTTOM_PT - 20.0, title)
    canvas.drawRightString(WIDTH_PT - _SIDE_PT, _BOTTOM_PT - 20.0, page_text)


def _story(document: Document, places: list[Place]) -> list[Flowable]:
    small = text_style(9.0, space_before_pt=3.0)
    story: list[Flowable] = [
        Paragraph(escape(document.title), text_style(15.0, bold=True)),
        Paragraph(escape(document.subtitle), small),
        *(_verdict_box(text, good=good) for text, good in document.verdicts),
    ]
    warning_parts = [Paragraph(f"• {escape(text)}", small) for text in document.warnings]
    if warning_parts:
        story += [
            KeepTogether([Paragraph("Warnings", heading_style()), warning_parts[0]]),
            *warning_parts[1:],
        ]
    for table in document.tables:
        story += table_parts(table, _ROOM_PT)
    for number, (name, figure) in enumerate(document.figures.items()):
        caption = Paragraph(escape(document.captions.get(name, "")), text_style(8.0))
        heading = Paragraph("Figures", heading_style())
        above = [] if number else [heading]
        story.append(_with_caption(name, figure, caption, above, places))
    facts = Table(title="What this was made from", header=("", ""), rows=document.facts)
    story += table_parts(facts, _ROOM_PT)
    return story


def _verdict_box(text: str, *, good: bool) -> Flowable:
    """Return a verdict in a frame; the frame is dashed unless ``good``."""
    text_look = text_style(10.0, bold=True)
    wide_pt = min(width_pt(text, BOLD, 10.0) + 18.0, _ROOM_PT)
    box_style: list[tuple[str, tuple[int, int], tuple[int, int], *tuple[Any, ...]]] = [
        ("BOX", (0, 0), (-1, -1), 1.4, black, None, None if good else (4, 2)),
        ("BOTTOMPADDING", (0, 0), (-1, -1), 5.0),
    ]
    return Cells(
        [[Paragraph(escape(text), text_look)]],
        colWidths=[wide_pt],
        style=box_style,
        hAlign="LEFT",
        spaceBefore=8.0,
    )


def _with_caption(
    name: str, figure: Figure, caption: Flowable, above: Sequence[Flowable], places: list[Place]
) -> Flowable:
    """Return a figure with ``above`` over it and its caption below, as large as a page allows."""
    taken_pt = sum(part.wrap(_ROOM_PT, 1e6)[1] + part.getSpaceAfter() for part in (*above, caption))
    inches = figure.get_size_inches()
    wide_pt, tall_pt = 72.0 * float(inches[0]), 72.0 * float(inches[1])
    scale = min(1.0, _ROOM_PT / wide_pt, (_TALL_PT - taken_pt - 2.0 * _GAP_PT) / tall_pt)
    half_page_scale = (_TALL_PT / 2.0 - taken_pt - _GAP_PT - 1.0) / tall_pt
    if _LEAST_SHARE * scale <= half_page_scale < scale:
        scale = half_page_scale  # two figures fit one page
    picture = _Picture(name, (scale * wide_pt, scale * tall_pt), scale, places)
    return KeepTogether([*above, picture, caption, Spacer(1.0, _GAP_PT)])
