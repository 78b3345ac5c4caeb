"""Lines of settings: strip prompts from a log, find the last dump, and find included files.

Users copy the answers of a firmware to ``$$`` or ``M503`` from terminals and logs of senders, which
add prefixes: ``> $$``, ``< $0=10``, ``Recv: echo: M92 X80.00``, ``22:24:55.009 : echo:``,
``[12:31:07] $0=10``, ``Config: M92 X80``. Any other text is a prefix if several settings have it.

Settings are also pasted from web pages, tables and mails. HTML tags and entities, Markdown, quotes
and bullets are removed. Rows of a table, like ``| $100 | 250 |`` or ``$100<tab>250.000<tab>X
steps``, become ``$100=250``. A dump without decimal points may have decimal commas.
"""

from __future__ import annotations

import html
import re
import textwrap
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from threadline.errors import Place

_DATE = r"\[?\d{4}[-/.]\d{1,2}[-/.]\d{1,2}[ T]?"
_TIME = r"\[?\d{1,2}:\d{2}(?::\d{2})?(?:[.,]\d+)?(?:\s*[AaPp][Mm]|Z)?\]?"
_WORDS = (
    r"\[?(?:recv|received|rcvd|rx|read|send|sending|sent|tx|write|client|console|feeder|serial\w*|info|"
    r"debug)\b\s*[:>|<\]-]+"
)
_PREFIX = re.compile(
    rf"\s*(?:{_DATE}|{_TIME}|{_WORDS}|echo:|config:|[<>│┃]+|->|<-|=>|[:|-](?=\s))\s*",
    re.IGNORECASE,
)
_SETTING = re.compile(r"\$\d{1,3}\s*=|(?<![\w.])M(?:92|20[1345])\s*[A-Z]\s*-?\d")
_NO_PREFIX = re.compile(r"[;#%(/]|.*[\"']|.*\b(?:unknown|invalid|error|default|old|was)\b", re.I)
_LEAST_PREFIXED = 3  # a text before so many settings is a prefix
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
_ROWS_OF_A_TABLE = 3  # smallest number of rows of a table
_PASTED_SETTING = re.compile(
    r"(?<![\w$])\$\d{1,3}\s*=\s*-?[\d.,]+|\bM(?:92|20[1345]|350)\s.*", re.I
)
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


@dataclass(frozen=True, slots=True)
class DumpLine:
    """A line of a log.

    Parameters
    ----------
    place
        File and line.
    text
        The line without prefixes of terminals.
    """

    place: Place
    text: str


@dataclass(frozen=True, slots=True)
class DumpSetting:
    """A setting and its value in one line of a log.

    Parameters
    ----------
    order
        Rank of the setting in a dump: firmwares list their settings in a fixed order.
    key
        The setting.
    text
        Its value, as typed.
    place
        Where it stands.
    """

    order: int
    key: str
    text: str
    place: Place


def dump_lines(lines: Sequence[tuple[int, str]], file: str) -> list[DumpLine]:
    """Return the numbered lines of a log without prompts, time stamps and echoes."""
    texts = [_without(_PREFIX, line.strip()) for _, line in lines]
    prefix_counts = Counter(
        re.sub(r"\d+", "0", text[: match.start()].rstrip())
        for text in texts
        if (match := _SETTING.search(text)) is not None and match.start()
    )
    for prefix, count in prefix_counts.items():
        if count >= _LEAST_PREFIXED and _NO_PREFIX.match(prefix) is None:
            pattern = re.compile("^" + re.escape(prefix).replace("0", r"\d+") + r"\s*")
            texts = [_without(_PREFIX, pattern.sub("", text, count=1)) for text in texts]
    return [
        DumpLine(Place(file, number), text) for (number, _), text in zip(lines, texts, strict=True)
    ]


def _without(prefix: re.Pattern[str], text: str) -> str:
    while (match := prefix.match(text)) is not None and match.end():
        text = text[match.end() :]
    return text.strip()


def in_force(
    sayings: Sequence[DumpSetting], same: Callable[[str, str], bool]
) -> tuple[list[DumpSetting], str]:
    """Return the settings of the last complete dump among ``sayings``, and a note or "".

    Settings that do not contradict each other are one dump. Otherwise a new dump begins where the
    order of the settings restarts, and the dumps with the most settings are complete. Settings
    after the last complete dump are appended; the caller refuses contradictions.

    Parameters
    ----------
    sayings
        All settings, in the order of the log.
    same
        Returns whether two texts mean the same value.
    """
    first: dict[str, DumpSetting] = {}
    if all(same(first.setdefault(setting.key, setting).text, setting.text) for setting in sayings):
        return list(first.values()), ""
    dumps: list[list[DumpSetting]] = [[]]
    for setting in sayings:
        if dumps[-1] and setting.order < dumps[-1][-1].order:
            dumps.append([])
        dumps[-1].append(setting)
    most_keys = max(len({setting.key for setting in dump}) for dump in dumps)
    complete = [
        at for at, dump in enumerate(dumps) if len({setting.key for setting in dump}) == most_keys
    ]
    last = complete[-1]
    kept = dumps[last]
    note = ""
    if len(complete) > 1:
        note = (
            f"{kept[0].place}: the last of {len(complete)} complete dumps in this file is read, "
            "lines "
            f"{kept[0].place.line} to {kept[-1].place.line}"
        )
    return [setting for dump in dumps[last:] for setting in dump], note


def files_beside(pattern: str, folder: Path) -> list[Path]:
    """Return the files that match ``pattern``, only in ``folder`` or below it."""
    try:
        paths = sorted(folder.glob(pattern)) if pattern.strip("/") else []
    except (NotImplementedError, ValueError, IndexError):
        paths = []
    files = [path.resolve() for path in paths if path.is_file()]
    return [path for path in files if path.is_relative_to(folder)]


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
    shown_lines = [
        (number, _unmarked(part))
        for number, line in enumerate(lines, start=1)
        for part in _shown_lines(line)
    ]
    rows = [_ROW.match(text) for _, text in shown_lines]
    if sum(row is not None for row in rows) >= _ROWS_OF_A_TABLE:
        shown_lines = [
            (number, text if row is None else _pasted_setting(row))
            for (number, text), row in zip(shown_lines, rows, strict=True)
        ]
    settings = [
        match[0] for _, text in shown_lines if (match := _PASTED_SETTING.search(text)) is not None
    ]
    commas = any(_COMMA.search(text) for text in settings)
    if not commas or any(_POINT.search(text) for text in settings):
        return Pasted(shown_lines, "")
    return Pasted(
        [(number, _PASTED_SETTING.sub(_pointed, text)) for number, text in shown_lines], _COMMAS
    )


def file_lines(lines: Sequence[str]) -> list[str]:
    """Return the lines of a pasted file without the marks that a web page or a mail adds.

    Quote marks, line numbers or time stamps before nearly every line, the fences of Markdown, tags
    of HTML and of forums, and an indentation of the whole file are removed. Lines outside of the
    fences or of ``<pre>`` become empty, so that the number of lines does not change.
    """
    kept_lines = list(lines)
    filled_count = sum(bool(line.strip()) for line in kept_lines)
    for prefix in _PREFIXES:
        matches = [prefix.match(line) for line in kept_lines]
        if (
            filled_count
            and sum(match is not None for match in matches) >= _NEARLY_ALL * filled_count
        ):
            kept_lines = [
                "" if match is None else line[match.end() :]
                for line, match in zip(kept_lines, matches, strict=True)
            ]
    kept_lines = (
        _between_fences(kept_lines, _FENCE) if any(map(_FENCE.match, kept_lines)) else kept_lines
    )
    if any(map(_PAGE.search, kept_lines)):
        kept_lines = [html.unescape(_PAGE.sub("", line)) for line in _preformatted(kept_lines)]
    kept_lines = ["" if _BOARD.match(line) else line for line in kept_lines]
    return textwrap.dedent("\n".join(kept_lines)).split("\n") if kept_lines else kept_lines


def _between_fences(lines: Sequence[str], fence: re.Pattern[str]) -> list[str]:
    """Return the lines between fences; all others are empty."""
    fenced, inside = [], False
    for line in lines:
        if fence.match(line):
            inside = not inside
            fenced.append("")
        else:
            fenced.append(line if inside else "")
    return fenced


def _preformatted(lines: Sequence[str]) -> list[str]:
    """Return the lines with only the text within ``<pre>`` kept, if the page has a ``<pre>``."""
    if not any(map(_PRE.search, lines)):
        return list(lines)
    kept_lines, inside = [], False
    for line in lines:
        kept_text, position = "", 0
        for tag in _PRE.finditer(line):
            kept_text += line[position : tag.start()] if inside else ""
            inside, position = not tag[1], tag.end()
        kept_lines.append(kept_text + (line[position:] if inside else ""))
    return kept_lines


def _shown_lines(line: str) -> list[str]:
    """Return the lines that a line of a web page shows."""
    if "<" in line or "&" in line:
        line = _CELL.sub("\t", _NEW_LINE.sub("\n", line))
        line = _TAG.sub("", line)
        if _ENTITY.search(line):
            line = html.unescape(line)
    return [part for line_shown in line.split("\n") for part in _FLAT.split(line_shown)]


def _unmarked(text: str) -> str:
    """Return a line without marks of Markdown, a bullet, and quotes around it."""
    text = _BULLET.sub("", _MARKS.sub("", text), count=1)
    quoted = _QUOTED.match(text)
    return _SPACED.sub(r"\1$\2", text if quoted is None else quoted["text"], count=1)


def _pasted_setting(row: re.Match[str]) -> str:
    """Return a row of a table in the form of a terminal, its description in brackets."""
    rest = re.sub(r"[|;,\t\"'()]+", " ", row["rest"] or "").strip()
    return f"${row['key']}={row['listed'] or row['value']}" + (f" ({rest})" if rest else "")


def _pointed(setting: re.Match[str]) -> str:
    return _COMMA.sub(r"\1.\2", setting[0])
