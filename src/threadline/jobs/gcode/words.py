"""The words of a block, a letter and a number each, and its comments.

Numbers are exact: integers in units of 10**-18. The order of programmed increments therefore does
not change their sum, and 780 times 0.1 is 78.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple, NoReturn

from threadline.errors import JobError, Place
from threadline.jobs.gcode.textfile import SourceFile

DECIMALS = 18
MAX_DECIMALS = 17  # one fewer: the product with 25.4 mm per inch must be exact, too
ONE: int = int(10**DECIMALS)
MAX_MAGNITUDE = 10**12
_MAX_SHOWN = 40

# No group is possessive: Python before 3.11.5 matches a possessive group that fits only in part.
_NUMBER = r"[-+]?(?:[0-9]++(?:\.[0-9]*+)?|\.[0-9]++)"
_WORD = re.compile(rf"[ \t]*([A-Za-z])[ \t]*({_NUMBER})")
_BLOCK = re.compile(rf"(?:[ \t]*+[A-Za-z][ \t]*+{_NUMBER}(?![0-9.eE]))*[ \t]*+")
_PARENTHESES = re.compile(r"\([^()]*\)")
_TO_THE_FIRST_END = re.compile(r"\([^)]*(?:\)|$)")
_TAG = re.compile(rf"([A-Za-z_][A-Za-z0-9_-]*)=({_NUMBER})")
_NAMED = re.compile(r"\s*+(?:[A-Za-z_][A-Za-z0-9_-]*+=[^\s,=]*+(?:[\s,]++|$))+")
_POWERS: tuple[int, ...] = tuple(int(10**k) for k in range(DECIMALS + 1))


class RawBlock(NamedTuple):
    """Letters (upper case) and number texts of a line, and the tags in its comment."""

    words: list[tuple[str, str]]
    tags: tuple[tuple[str, float], ...]


def split_words(
    text: str, file: str, line: int, *, one_block: bool = False, inner: bool = False
) -> RawBlock:
    """Return the words of one line.

    With ``one_block`` any text may follow ``;``; with ``inner`` a comment may hold a (, too.

    Raises
    ------
    JobError
        If the line holds text other than words and comments.
    """
    tags: tuple[tuple[str, float], ...] = ()
    if ";" in text or "(" in text or ")" in text:
        text, comment = without_comments(text, file, line, one_block=one_block, inner=inner)
        if "=" in comment:
            tags = tags_of(comment, file, line) if text.strip() else ()
    if _BLOCK.fullmatch(text) is None:
        _diagnose(text, file, line)
    return RawBlock([(letter.upper(), number) for letter, number in _WORD.findall(text)], tags)


def exact(number: str) -> int | None:
    """Return ``number`` in units of 10**-18, None if the number is too large or too fine.

    >>> exact("10.13"), exact("-.5"), exact("1" + "0" * 40)
    (10130000000000000000, -500000000000000000, None)
    """
    whole, _, fraction = number.partition(".")
    decimals = len(fraction)
    if decimals > MAX_DECIMALS or len(whole) > DECIMALS:
        return _exact_unusual(whole, fraction)
    return int(whole + fraction) * _POWERS[DECIMALS - decimals]


def _exact_unusual(whole: str, fraction: str) -> int | None:
    sign = "-" if whole.startswith("-") else ""
    whole, fraction = whole.lstrip("+-").lstrip("0"), fraction.rstrip("0")
    if len(fraction) > MAX_DECIMALS or len(whole) > DECIMALS:
        return None
    return int(f"{sign}{whole or '0'}{fraction.ljust(DECIMALS, '0')}")


def without_comments(
    text: str, file: str, line: int, *, one_block: bool = False, inner: bool = False
) -> tuple[str, str]:
    """Return ``text`` without its comments, and the comment after the semicolon.

    In the printed winder program, and in prints of Fanuc programs, ``;`` ends a block. Text after
    ``;`` that reads as a block is refused there. For all other controls ``;`` begins a comment
    with any content (``one_block``): ``M0 ;T102``. With ``inner`` a comment ends at its first ), or
    with its line, even if it contains a (.

    Raises
    ------
    JobError
        If parentheses do not match, or another block follows.
    """
    code, _, comment = _cut_at_semicolon(text)
    if "(" in code or ")" in code:
        code = (_TO_THE_FIRST_END if inner else _PARENTHESES).sub(" ", code)
        if "(" in code or ")" in code:
            fault = "is opened and not closed" if "(" in code else "is closed and not opened"
            raise JobError(
                f"a comment in parentheses {fault}",
                place=Place(file, line),
                remedy="Put a comment between one ( and one ) on the same line.",
            )
    if not one_block and comment.strip() and code.strip():
        # In "X1; Y2;" or "X1; home; Y2" the printed dialect would move Y, too.
        for part in _PARENTHESES.sub(" ", comment).split(";"):
            if _WORD.match(part) and _BLOCK.fullmatch(part):
                raise JobError(
                    f"the text after ';' reads as another block: {_shown(part.strip())}",
                    place=Place(file, line),
                    remedy="Put it on a line of its own, or in parentheses if it is a comment.",
                )
    return code, comment


def _cut_at_semicolon(text: str) -> tuple[str, str, str]:
    """Cut ``text`` at the first semicolon outside parentheses."""
    if "(" not in text:
        return text.partition(";")
    open_ = False
    for position, character in enumerate(text):
        if character == "(":
            open_ = True
        elif character == ")":
            open_ = False
        elif character == ";" and not open_:
            return text[:position], ";", text[position + 1 :]
    return text, "", ""


def tags_of(comment: str, file: str, line: int) -> tuple[tuple[str, float], ...]:
    """Return the tags of a comment like ``tension=6.5 width=4``.

    A comment with any other text has no tags.

    Raises
    ------
    JobError
        If a tag has no number.
    """
    if _NAMED.fullmatch(comment) is None:
        return ()
    tags: dict[str, float] = {}
    for part in re.split(r"[\s,]+", comment.strip(" \t,")):
        match = _TAG.fullmatch(part)
        if match is None or not math.isfinite(float(match[2])):
            raise JobError(
                f"the tag {_shown(part)} has no number",
                place=Place(file, line),
                remedy="Write it like tension_N=25, or put a comment that is no tag in ( ).",
            )
        if match[1] in tags:
            raise JobError(
                f"the tag {match[1]} stands twice in the block",
                place=Place(file, line),
                remedy="Keep one of them.",
            )
        tags[match[1]] = float(match[2])
    return tuple(tags.items())


def refuse_switched(place: Place) -> NoReturn:
    """Refuse a line that begins with ``/``.

    Raises
    ------
    JobError
        In every call.
    """
    raise JobError(
        "a line that begins with / is run or left out by a switch of the control (block delete)",
        place=place,
        remedy="Take the line out, or the / alone.",
    )


def _shown(text: str) -> str:
    short = text if len(text) <= _MAX_SHOWN else text[:_MAX_SHOWN] + "..."
    return repr(short)


def _diagnose(text: str, file: str, line: int) -> NoReturn:
    """Raise the error that explains why ``text`` is not a block."""
    position = 0
    while match := _WORD.match(text, position):
        if match.end() < len(text) and text[match.end()] in "eE,.":
            break
        position = match.end()
    rest = text[position:].strip()
    place = Place(file, line)
    word = re.split(r"[ \t](?![-+.\d])", rest, maxsplit=1)[0] if rest else ""
    if re.match(rf"[A-Za-z][ \t]*{_NUMBER}[eE][-+]?\d", rest):
        raise JobError(
            f"{_shown(word)} has an exponent",
            place=place,
            remedy="Write the number with digits and a decimal point only.",
        )
    if re.match(rf"[A-Za-z][ \t]*{_NUMBER},", rest):
        raise JobError(
            f"{_shown(word)} has a decimal comma", place=place, remedy="Write a decimal point."
        )
    if re.match(rf"[A-Za-z][ \t]*{_NUMBER}\.", rest):
        raise JobError(f"{_shown(word)} is not a number", place=place, remedy="Correct it.")
    if text.lstrip(" \t").startswith("/"):
        refuse_switched(place)
    if re.fullmatch(r"[ \t]*#[^=]*", text):
        raise JobError(
            f"{_shown(rest)}: # begins no comment",
            place=place,
            remedy="Write a comment in parentheses or behind a semicolon.",
        )
    if re.match(r"[A-Za-z]?[ \t]*[#\[]", rest):
        raise JobError(
            f"{_shown(rest)}: parameters and expressions are not read",
            place=place,
            remedy="Have the program written with numbers alone; linuxcnc and fluidnc read them "
            "(--dialect).",
        )
    if rest[:1].isascii() and rest[:1].isalpha():
        raise JobError(
            f"{_shown(rest)}: the letter {rest[0].upper()} has no number",
            place=place,
            remedy="Write a letter and a number, like X 15.79.",
        )
    if rest[:1].isdigit() or rest[:1] in {"-", "+", "."}:
        raise JobError(
            f"{_shown(rest)} has no letter before it",
            place=place,
            remedy="Write a letter and a number, like X 15.79.",
        )
    if rest.startswith("$"):
        raise JobError(
            f"{_shown(rest)} is a command to grbl's terminal and no part of a program",
            place=place,
            remedy="Take it out, and type it before the program runs ($H homes).",
        )
    raise JobError(
        f"{_shown(rest)} is not part of this dialect",
        place=place,
        remedy="A block holds words (a letter and a number) and comments only.",
    )


TAPE = "%"


class Tapes:
    """The lines with % of a file, in their order.

    Parameters
    ----------
    file
        The file, for errors.
    first_line_only
        Name of a control for which a % opens the program only on the first line that is not empty,
        and ends the file on any other line; empty for other controls.
    """

    def __init__(self, file: SourceFile, first_line_only: str = "") -> None:
        self._file = file
        self._first_line_only = first_line_only
        self._lines: list[int] = []
        self._written = False  # whether a line with text came before

    @property
    def first(self) -> int:
        """First line with a %, 0 without one."""
        return self._lines[0] if self._lines else 0

    def pass_by(self, text: str) -> None:
        """Take the text of a line without %."""
        self._written = self._written or bool(text)

    def take(self, line: int, begun: bool) -> None:
        """Take a line with %; ``begun`` says whether blocks stand before the line.

        Raises
        ------
        JobError
            If the % closes a program that no % has opened.
        """
        if self._first_line_only and self._written and not self._lines:
            raise JobError(
                f"{self._first_line_only} ends the file with this %, since lines stand before it, "
                "and runs nothing behind it",
                place=self._file.place(line),
                remedy="Write it on the first line, or take out every line with a %.",
            )
        self._lines.append(line)
        if len(self._lines) > 2 or (len(self._lines) == 1 and begun):
            raise JobError(
                "this % closes a program that no % has opened",
                place=self._file.place(line),
                remedy="Write % on the first line and on the last, or on none.",
            )

    def check(self, line: int) -> None:
        """Refuse a block behind the last %.

        Raises
        ------
        JobError
            If the % before this block has ended the file.
        """
        if len(self._lines) > 1:
            raise JobError(
                "a block after the % that ends the file is never run",
                place=self._file.place(line),
                remedy="Take it out.",
            )

    def finish(self, line: int, *, ended: bool) -> None:
        """End the file behind ``line``; ``ended`` says whether its last block ends the program.

        Raises
        ------
        JobError
            If a % has opened the program, and neither a % nor a last block ends it.
        """
        if len(self._lines) == 1 and not ended:
            raise JobError(
                f"the % on line {self._lines[0]} opens the program and none closes it: the file "
                "may be truncated",
                place=self._file.place(line),
                remedy="Add M30, or a line with %, at the end.",
            )


READ_TO_TAPE = frozenset({"winder", "fanuc"})
"""Controls that read a program up to its second %; to others the block that ends it is enough."""
O_WORDS = (
    "endrepeat", "endwhile", "continue", "elseif", "repeat", "return", "endsub", "endif", "while",
    "break", "alarm", "error", "call", "else", "sub", "do", "if",
)  # fmt: skip
_PARAMETRIC = re.compile(
    rb"[#\[]|^[ \t]*(?:n[ \t]*[0-9]+[ \t]*)?o[ \t]*"
    rb"(?:<|[0-9]+[ \t]*(?:\([^()\r\n]*\)[ \t]*)*(?:%s))" % "|".join(O_WORDS).encode(),
    re.MULTILINE | re.IGNORECASE,
)
_ENCLOSED = re.compile(rb"\([^()]*\)")


def is_parametric(file: SourceFile) -> bool:
    """Say whether a program has parameters, expressions or O words like ``o100 sub``."""
    for chunk in file.chunks(file.begin):
        if _PARAMETRIC.search(chunk.data) is None:
            continue
        for line in chunk.data.split(b"\n"):
            if _PARAMETRIC.search(_ENCLOSED.sub(b" ", line.partition(b";")[0])):
                return True
    return False
