"""The words of structured text of IEC 61131-3, and its durations."""

from __future__ import annotations

import re
from typing import NamedTuple

_TOKEN = re.compile(
    r"""(?P<gap>\s+|\(\*.*?\*\)|//[^\n]*)
    |(?P<time>(?:T|TIME)\#[0-9a-z_.]+)
    |(?P<text>'[^'\n]*')
    |(?P<address>%[IQM][XBWD]?[0-9.]+)
    |(?P<number>\d+)
    |(?P<name>[A-Za-z_]\w*)
    |(?P<sign>:=|=>|<>|<=|>=|\.\.|[-+*/=<>()\[\],.;:])""",
    re.DOTALL | re.VERBOSE | re.IGNORECASE,
)
_PART = re.compile(r"(\d{1,15}(?:\.\d{1,15})?)(ms|us|d|h|m|s)")
_PART_US = {"d": 86_400_000_000, "h": 3_600_000_000, "m": 60_000_000, "s": 1_000_000}
_PART_US |= {"ms": 1000, "us": 1}


class ScanError(ValueError):
    """A text outside the structured text that sequences need, or a body that cannot go on."""

    def __init__(self, message: str, line: int | None = None) -> None:
        super().__init__(message)
        self.line = line


class Token(NamedTuple):
    """A word of the text: its kind, the word itself, and its line."""

    kind: str
    text: str
    line: int


def tokens_of(text: str) -> list[Token]:
    """Return the tokens of a text without blanks and comments.

    Raises
    ------
    ScanError
        If a character belongs to no token.
    """
    tokens, position, line = list[Token](), 0, 1
    while position < len(text):
        match = _TOKEN.match(text, position)
        if match is None:
            raise ScanError(f"{text[position : position + 20]!r} is no word of it", line)
        if match.lastgroup != "gap":
            tokens.append(Token(str(match.lastgroup), match[0], line))
        line += match[0].count("\n")
        position = match.end()
    return tokens


def time_us(text: str, line: int | None = None) -> int:
    """Return a duration such as ``T#1s500ms`` in microseconds.

    Raises
    ------
    ScanError
        If it is no duration.
    """
    body = text.partition("#")[2].lower().replace("_", "")
    parts = _PART.findall(body)
    if not parts or "".join(number + unit for number, unit in parts) != body:
        raise ScanError(f"{text[:40]!r} is no duration", line)
    return sum(round(float(number) * _PART_US[unit]) for number, unit in parts)
