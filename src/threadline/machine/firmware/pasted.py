"""Settings as they are pasted from web pages, tables and mails, as lines of a terminal again.

HTML tags and entities, Markdown, quotes and bullets are removed. Rows of a table, like
``| $100 | 250 |`` or ``$100<tab>250.000<tab>X steps``, become ``$100=250``. A dump without decimal
points may have decimal commas.
"""

from __future__ import annotations

import html
import re
import textwrap
from collections.abc import Sequence
from typing import NamedTuple

_NEW_LINE = re.compile(r"</?(?:br|p|div|li|ul|ol|tr|pre|blockquote|h\d)\b[^<>]*>", re.IGNORECASE)
_CELL = re.compile(r"</(?:td|th)\s*>", re.IGNORECASE)
_TAG = re.compile(
    r"</?(?:a|b|i|u|em|strong|code|span|font|td|th|table|thead|tbody|body|html|article|section)"
    r"\b[^<>]*>",
    re.IGNORECASE,
)
_ENTITY = re.compile(r"&(?:gt|lt|amp|quot|nbsp|#\d{1,5});")
_FLAT = re.compile(r"\s+(?=echo:)", re.IGNORECASE)
_MARKS = re.compile(r"`+|\*\*|__")
_BULLET = re.compile(r"\s*[*+•·‣-]\s+(?=\$\s?\d|M\d|echo:|[\"'])", re.IGNORECASE)
_QUOTED = re.compile(r"\s*([\"'])(?P<text>\$\s?\d[^\"']*|M\d[^\"']*|echo:[^\"']*)\1\s*,?\s*$")
_SPACED = re.compile(r"(\s*[>\s]*)\$\s(\d{1,3}\s*=)")
_ROW = re.compile(
    r"[\s>|\"']*\$(?P<key>\d{1,3})[\"']?"
    r"(?:\s*,\s*[\"']?(?P<listed>-?\d+(?:\.\d+)?)"
    r"|(?:\s*[|;:]\s*|\s+)[\"']?(?P<value>-?\d+(?:[.,]\d+)?))"
    r"(?![\d.])[\"']?(?P<rest>[\s|;,].*)?$"
)
_ENOUGH = 3  # rows that make a table
_SETTING = re.compile(r"(?<![\w$])\$\d{1,3}\s*=\s*-?[\d.,]+|\bM(?:92|20[1345]|350)\s.*", re.I)
_POINT = re.compile(r"\d\.\d|[=\sA-Z]\.\d")
_COMMA = re.compile(r"(?<![\d,.])(-?\d+),(\d+)(?![\d,.])")
_PREFIXES = (
    re.compile(r" *(?:> ?)+"),
    re.compile(r"\[?\d{1,2}:\d{2}(?::\d{2})?(?:[.,]\d+)?\]?(?: ->| [-:]|:)? ?"),
    re.compile(r" *\d{1,5}[:.|\t ] ?"),
)
_NEARLY_ALL = 0.8  # share of the lines that have a prefix
_FENCE = re.compile(r"\s*(?:```|~~~)")
_PRE = re.compile(r"<(/?)pre\b[^<>]*>", re.IGNORECASE)
_PAGE = re.compile(r"</?(?:pre|code|br|p|div|span)\b[^<>]*>", re.IGNORECASE)
_BOARD = re.compile(
    r"\s*(?:\[/?(?:code|quote|spoiler|size|b|url|list)\b[^\]]*\]\s*)+$", re.IGNORECASE
)
_COMMAS = "its numbers have decimal commas, which are read as decimal points"


class Pasted(NamedTuple):
    """Lines of a terminal.

    Parameters
    ----------
    lines
        Number of the line in the file, from 1, and text; a line of the file may hold several.
    note
        An assumption made, or "".
    """

    lines: list[tuple[int, str]]
    note: str


def pasted(lines: Sequence[str]) -> Pasted:
    """Return the lines of a terminal in the lines of a file."""
    found = [
        (number, _unmarked(part))
        for number, line in enumerate(lines, start=1)
        for part in _parts(line)
    ]
    rows = [_ROW.match(text) for _, text in found]
    if sum(row is not None for row in rows) >= _ENOUGH:
        found = [
            (number, text if row is None else _setting(row))
            for (number, text), row in zip(found, rows, strict=True)
        ]
    settings = [match[0] for _, text in found if (match := _SETTING.search(text)) is not None]
    commas = any(_COMMA.search(text) for text in settings)
    if not commas or any(_POINT.search(text) for text in settings):
        return Pasted(found, "")
    return Pasted([(number, _SETTING.sub(_pointed, text)) for number, text in found], _COMMAS)


def file_lines(lines: Sequence[str]) -> list[str]:
    """Return as many lines: a pasted file, without the marks that a page or a mail adds.

    A quote, line numbers or time stamps before nearly every line, the fences of Markdown, tags of
    HTML and of forums, and an indentation of the whole file are removed. Text outside of the fences
    or of ``<pre>`` becomes empty lines.
    """
    shown = list(lines)
    filled = sum(bool(line.strip()) for line in shown)
    for prefix in _PREFIXES:
        matches = [prefix.match(line) for line in shown]
        if filled and sum(match is not None for match in matches) >= _NEARLY_ALL * filled:
            shown = [
                "" if match is None else line[match.end() :]
                for line, match in zip(shown, matches, strict=True)
            ]
    shown = _within(shown, _FENCE) if any(map(_FENCE.match, shown)) else shown
    if any(map(_PAGE.search, shown)):
        shown = [html.unescape(_PAGE.sub("", line)) for line in _preformatted(shown)]
    shown = ["" if _BOARD.match(line) else line for line in shown]
    return textwrap.dedent("\n".join(shown)).split("\n") if shown else shown


def _within(lines: Sequence[str], fence: re.Pattern[str]) -> list[str]:
    """Return the lines between fences; all others are empty."""
    found, inside = [], False
    for line in lines:
        if fence.match(line):
            inside = not inside
            found.append("")
        else:
            found.append(line if inside else "")
    return found


def _preformatted(lines: Sequence[str]) -> list[str]:
    """Return the text within ``<pre>``, if the page has it, in as many lines."""
    if not any(map(_PRE.search, lines)):
        return list(lines)
    found, inside = [], False
    for line in lines:
        kept, at = "", 0
        for tag in _PRE.finditer(line):
            kept += line[at : tag.start()] if inside else ""
            inside, at = not tag[1], tag.end()
        found.append(kept + (line[at:] if inside else ""))
    return found


def _parts(line: str) -> list[str]:
    """Return the lines that a line of a web page shows."""
    if "<" in line or "&" in line:
        line = _CELL.sub("\t", _NEW_LINE.sub("\n", line))
        line = _TAG.sub("", line)
        if _ENTITY.search(line):
            line = html.unescape(line)
    return [part for shown in line.split("\n") for part in _FLAT.split(shown)]


def _unmarked(text: str) -> str:
    """Return a line without marks of Markdown, a bullet, and quotes around it."""
    text = _BULLET.sub("", _MARKS.sub("", text), count=1)
    quoted = _QUOTED.match(text)
    return _SPACED.sub(r"\1$\2", text if quoted is None else quoted["text"], count=1)


def _setting(row: re.Match[str]) -> str:
    """Return a row of a table in the form of a terminal, its description in brackets."""
    rest = re.sub(r"[|;,\t\"'()]+", " ", row["rest"] or "").strip()
    return f"${row['key']}={row['listed'] or row['value']}" + (f" ({rest})" if rest else "")


def _pointed(setting: re.Match[str]) -> str:
    return _COMMA.sub(r"\1.\2", setting[0])
