"""Fonts and paragraph styles of the PDF; the fonts are those of the figures."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import matplotlib as mpl
from reportlab.lib.enums import TA_LEFT, TA_RIGHT
from reportlab.lib.styles import ParagraphStyle
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont

FONT, BOLD = "DejaVuSans", "DejaVuSans-Bold"
"""The fonts that matplotlib includes and draws figures with."""


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
    """Return the paragraph style of a size in points, bold or not, aligned left or right."""
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
    """Return the paragraph style of the heading of a part."""
    return ParagraphStyle(
        "heading", parent=text_style(11.0, bold=True), spaceBefore=12.0, spaceAfter=4.0
    )


def shortened(text: str, font: str, size_pt: float, room_pt: float) -> str:
    """Return ``text``, with its middle left out where it is wider than ``room_pt``.

    >>> shortened("a-very-long-name-of-a-job.prg on winder", FONT, 8.0, 100.0)
    'a-very-long… on winder'
    """
    if width_pt(text, font, size_pt) <= room_pt:
        return text
    kept = len(text)
    while kept > 1:
        kept -= 1
        begin = (kept + 1) // 2
        said = f"{text[:begin]}…{text[len(text) - kept + begin :]}"
        if width_pt(said, font, size_pt) <= room_pt:
            return said
    return "…"
