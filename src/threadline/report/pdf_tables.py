"""Fonts, paragraph styles and tables of the PDF; the fonts are the same as in the figures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import matplotlib as mpl
from reportlab.lib.colors import Color
from reportlab.lib.enums import TA_LEFT, TA_RIGHT
from reportlab.lib.styles import ParagraphStyle
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.platypus import CondPageBreak, Flowable, LongTable, Paragraph

from threadline.report.document import Table, failing

FONT, BOLD = "DejaVuSans", "DejaVuSans-Bold"
"""Folder of the fonts of matplotlib, which it uses in figures."""


@cache
def _load_fonts() -> None:
    folder = Path(mpl.get_data_path()) / "fonts" / "ttf"
    for name in (FONT, BOLD):
        pdfmetrics.registerFont(TTFont(name, str(folder / f"{name}.ttf")))


def width_pt(text: str, font: str, size_pt: float) -> float:
    """Return the width of a line of text, points; ``font`` is ``FONT`` or ``BOLD``."""
    _load_fonts()
    return float(pdfmetrics.stringWidth(text, font, size_pt))


@cache
def text_style(
    size_pt: float, *, bold: bool = False, right: bool = False, space_before_pt: float = 0.0
) -> ParagraphStyle:
    """Return a paragraph style with a font size in points, bold or not, aligned left or right."""
    _load_fonts()
    return ParagraphStyle(
        f"{size_pt}{bold}{right}{space_before_pt}",
        fontName=BOLD if bold else FONT,
        fontSize=size_pt,
        leading=1.25 * size_pt,
        alignment=TA_RIGHT if right else TA_LEFT,
        spaceBefore=space_before_pt,
    )


@cache
def heading_style() -> ParagraphStyle:
    """Return the paragraph style of a section heading."""
    return ParagraphStyle(
        "heading", parent=text_style(11.0, bold=True), spaceBefore=12.0, spaceAfter=4.0
    )


def shortened(text: str, font: str, size_pt: float, room_pt: float) -> str:
    """Return ``text``, without its middle if it is wider than ``room_pt``.

    >>> shortened("a-very-long-name-of-a-job.prg on winder", FONT, 8.0, 100.0)
    'a-very-long… on winder'
    """
    if width_pt(text, font, size_pt) <= room_pt:
        return text
    kept_letters = len(text)
    while kept_letters > 1:
        kept_letters -= 1
        begin = (kept_letters + 1) // 2
        short_text = f"{text[:begin]}…{text[len(text) - kept_letters + begin :]}"
        if width_pt(short_text, font, size_pt) <= room_pt:
            return short_text
    return "…"


_SIZES_PT = (8.0, 7.5, 7.0, 6.5)
_PADDING_PT = 5.0  # horizontal padding of a cell, left and right together
_NOTE_PT = 120.0  # a narrower column breaks a note too often
_SHORT_TEXT_PT = 105.0  # a narrower column is not broken if possible
_LEFT_PT = 6.0  # space between text and the numbers on its left
_WITH_HEADING = 5  # smallest number of rows to begin a table at the foot of a page
_ANY_PT = 1e6  # an unlimited height
_MOST_PT = 600.0  # height that every page has
_SHORT_PT = 260.0  # a table up to this height, a third of a page, is not split


def table_parts(table: Table, room_pt: float) -> Iterator[Flowable]:
    """Yield the flowables of a table: its heading, the table, its note.

    Parameters
    ----------
    table
        Its texts must have control characters escaped.
    room_pt
        Width of the page between its margins, points.
    """
    for number, (columns, size_pt, widths_pt) in enumerate(columns_of(table, room_pt)):
        title = table.title + (", continued" if number else "")
        heading = Paragraph(escape(title), heading_style())
        lines = ([table.header] if table.headed else []) + list(table.rows)
        whole_table = _drawn_table(table, lines, columns, size_pt, widths_pt)
        beginning = _drawn_table(table, lines[: _WITH_HEADING + 1], columns, size_pt, widths_pt)
        height_pt = 0.0 if whole_table is None else whole_table.wrap(room_pt, _ANY_PT)[1]
        if beginning is not None and height_pt > _SHORT_PT:
            height_pt = beginning.wrap(room_pt, _ANY_PT)[1]
        height_pt += heading.wrap(room_pt, _ANY_PT)[1]
        height_pt += heading.getSpaceBefore() + heading.getSpaceAfter()
        yield CondPageBreak(min(height_pt + 1.0, _MOST_PT))
        yield heading
        if whole_table is not None:
            yield whole_table
    if table.note:
        yield Paragraph(escape(table.note), text_style(8.0, space_before_pt=3.0))


def columns_of(
    table: Table, room_pt: float
) -> list[tuple[tuple[int, ...], float, tuple[float, ...]]]:
    """Return, for each table to draw, its columns, its font size and their widths, points.

    The font size is the largest that keeps every short text in one line, or else every word whole.
    If no size does, the table is split into several that all begin with the first column.
    """
    all_columns = tuple(range(len(table.header)))
    for short_pt, size_pt in product((_SHORT_TEXT_PT, 0.0), _SIZES_PT):
        natural, least = _extents(table, size_pt)
        least = [n if n <= short_pt else m for n, m in zip(natural, least, strict=True)]
        if sum(least) <= room_pt:
            if not table.headed:
                natural[-1] = max(natural[-1], room_pt - sum(natural[:-1]))
            return [(all_columns, size_pt, shared_widths(natural, least, room_pt))]
    groups: list[list[int]] = []
    for column in all_columns[1:]:
        taken_pt = sum(least[c] for c in groups[-1]) + least[column] if groups else room_pt + 1.0
        if taken_pt > room_pt:
            groups.append([0])
        groups[-1].append(column)
    parts = []
    for group in groups or [[0]]:
        natural_pt = [natural[c] for c in group]
        least_pt = [least[c] for c in group]
        if sum(least_pt) > room_pt:  # one column beside the first: a word is broken
            least_pt = [min(c, room_pt / len(group)) for c in least_pt]
        parts.append((tuple(group), size_pt, shared_widths(natural_pt, least_pt, room_pt)))
    return parts


def shared_widths(
    natural: Sequence[float], least: Sequence[float], room: float
) -> tuple[float, ...]:
    """Return a width for each column; the sum of all is ``room``.

    Excess room is shared evenly. If there is too little room, the widest columns are reduced to
    one common width, but none below its ``least`` width.

    >>> shared_widths([10.0, 30.0, 90.0], [10.0, 20.0, 20.0], 100.0)
    (10.0, 30.0, 60.0)
    >>> shared_widths([10.0, 20.0], [10.0, 20.0], 50.0)
    (20.0, 30.0)
    """
    spare = room - sum(natural)
    if spare >= 0.0:
        return tuple(width + spare / len(natural) for width in natural)
    narrow, wide = 0.0, max(natural)
    for _ in range(60):
        level = 0.5 * (narrow + wide)
        taken = sum(min(n, max(m, level)) for n, m in zip(natural, least, strict=True))
        narrow, wide = (level, wide) if taken <= room else (narrow, level)
    return tuple(round(min(n, max(m, narrow)), 6) for n, m in zip(natural, least, strict=True))


def _extents(table: Table, size_pt: float) -> tuple[list[float], list[float]]:
    """Return, column by column, the width of the longest text and of the longest word."""
    natural, least = [], []
    for column, name in enumerate(table.header):
        rows = ((row[column], BOLD if failing(row)[column] else FONT) for row in table.rows)
        cells = [(name, BOLD), *rows]
        text_pt = max(width_pt(text, font, size_pt) for text, font in cells)
        word_pt = max(
            width_pt(w, font, size_pt) for text, font in cells for w in text.split() or [""]
        )
        if name == "note":
            word_pt = max(word_pt, min(text_pt, _NOTE_PT))
        beside_pt = 0.5 + _PADDING_PT + (_LEFT_PT if column and table.left_aligned[column] else 0.0)
        natural.append(text_pt + beside_pt)
        least.append(word_pt + beside_pt)
    return natural, least


def _drawn_table(
    table: Table,
    lines: Sequence[Sequence[str]],
    columns: Sequence[int],
    size_pt: float,
    widths_pt: Sequence[float],
) -> Flowable | None:
    if not lines:
        return None
    rule, shade = Color(0.75, 0.75, 0.75), Color(0.93, 0.93, 0.93)
    left = table.left_aligned
    cell_styles: list[tuple[str, tuple[int, int], tuple[int, int], *tuple[Any, ...]]] = [
        ("VALIGN", (0, 0), (-1, -1), "TOP"),
        ("LINEBELOW", (0, 0), (-1, -1), 0.4, rule),
        ("LEFTPADDING", (0, 0), (-1, -1), _PADDING_PT / 2),
        ("RIGHTPADDING", (0, 0), (-1, -1), _PADDING_PT / 2),
        ("TOPPADDING", (0, 0), (-1, -1), 1.8),
        ("BOTTOMPADDING", (0, 0), (-1, -1), 2.2),
    ]
    cell_styles += [
        ("LEFTPADDING", (position, 0), (position, -1), _LEFT_PT + _PADDING_PT / 2)
        for position, c in enumerate(columns)
        if position and left[c]
    ]
    cells = []
    for number, line in enumerate(lines):
        head = table.headed and number == 0
        bold = (True,) * len(line) if head else failing(line)
        cell_styles += [
            ("BACKGROUND", (position, number), (position, number), shade)
            for position, c in enumerate(columns)
            if bold[c] and not head
        ]
        cells.append(
            [
                Paragraph(escape(line[c]), text_style(size_pt, bold=bold[c], right=not left[c]))
                for c in columns
            ]
        )
    return LongTable(
        cells,
        colWidths=list(widths_pt),
        repeatRows=1 if table.headed and len(lines) > 1 else 0,
        splitInRow=1,
        style=cell_styles,
    )
