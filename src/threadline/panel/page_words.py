"""What is told to people at the page, in the words of the page and not of a command line.

Errors and warnings are shared with the command line, and name its options. The page has fields for
some of them, by other names; what it has none for is said to be of the command line.
"""

from __future__ import annotations

import re

from pydantic import BaseModel

from threadline.panel import protocol as say

FIELDS = {
    "at": "from",
    "contour": "Contour",
    "feed": "Feed",
    "feed-forward": "Loads follow",
    "interpolation": "Interpolation",
    "law": "Law",
    "offset": "Mandrel offset",
    "override": "Reason to run out of specification",
    "radius": "Radius",
    "robust": "Robust",
    "shaper": "Shaper",
    "smoothing": "Smoothing",
    "tolerance": "Tolerance",
}
"""Labels of the page by the options that they stand for."""
_OPTION = re.compile(r"(?<![\w-])--([a-z][a-z-]*[a-z])(?![\w-])")


def in_page_words(text: str) -> str:
    """Return a text with the labels of the page in place of options of the command line.

    >>> in_page_words("Choose another feed with --feed, or another dialect (--dialect).")
    "Choose another feed with 'Feed', or another dialect (--dialect of the command line)."
    """
    return _OPTION.sub(_label, text)


def _label(found: re.Match[str]) -> str:
    label = FIELDS.get(found[1])
    return f"{found[0]} of the command line" if label is None else f"'{label}'"


def told_on_page(message: BaseModel) -> BaseModel:
    """Return a message with what people read of it in the words of the page."""
    if isinstance(message, say.Said | say.Answer):
        return message.model_copy(update={"text": in_page_words(message.text)})
    if isinstance(message, say.Figures):
        warnings = [in_page_words(one) for one in message.warnings]
        return message.model_copy(update={"warnings": warnings})
    return message
