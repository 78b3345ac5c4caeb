"""Letters on paper: the fonts of the figures, in the sizes of titles, headings and text."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import matplotlib as mpl
from reportlab.lib.enums import TA_LEFT, TA_RIGHT
from reportlab.lib.styles import ParagraphStyle
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont

FONT, BOLD = "DejaVuSans", "DejaVuSans-Bold"
"""Those that matplotlib brings along and draws figures with."""


@cache
def _load_fonts() -> None:
    folder = Path(mpl.get_data_path()) / "fonts" / "ttf"
    for name in (FONT, BOLD):
        pdfmetrics.registerFont(TTFont(name, str(folder / f"{name}.ttf")))


def width_pt(text: str, font: str, size_pt: float) -> float:
    """Return how wide a line of text is, points; ``font`` is one of this module's."""
    _load_fonts()
    return float(pdfmetrics.stringWidth(text, font, size_pt))


@cache
def text_style(
    size_pt: float, *, bold: bool = False, right: bool = False, space_before_pt: float = 0.0
) -> ParagraphStyle:
    """Return how text is set: its size in points, its weight, its side."""
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
    """Return how the heading of a part is set."""
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
