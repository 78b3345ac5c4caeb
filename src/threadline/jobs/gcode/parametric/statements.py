"""Blocks with formulas for numbers, and with settings of parameters: ``G1 X[#1 + 2] #3 = 5``."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from decimal import Decimal
from typing import NamedTuple

from threadline.errors import Place
from threadline.jobs.gcode.dialects import Flavour
from threadline.jobs.gcode.parametric.formulas import NUMBER, Formula, FormulaReader
from threadline.jobs.gcode.parametric.parameters import Values
from threadline.jobs.gcode.words import MAX_DECIMALS, RawBlock, tags_of, without_comments

_WHOLE = {"G": (10.0, 1e-3), "M": (1.0, 1e-4), "L": (1.0, 1e-4), "T": (1.0, 1e-4)}
_BLANKS = re.compile(r"[ \t]+")
_LOOSE = re.compile(r"\([^)]*(?:\)|$)|\)")
_UNREAL = re.compile(r"[^\x21-\x7e]")


class Setting(NamedTuple):
    """A setting of a parameter in a block: its name or its number, and its value."""

    name: str
    number: Callable[[Values], int] | None
    value: Formula


class Statement(NamedTuple):
    """A block: its words, each with a number text or a formula, and its settings."""

    words: tuple[tuple[str, str | Formula], ...]
    settings: tuple[Setting, ...]
    tags: tuple[tuple[str, float], ...]
    place: Place

    def worked_out(self, values: Values) -> RawBlock:
        """Return the block with formulas replaced by numbers, and set its parameters.

        The parameters are set after every formula of the block is evaluated.
        """
        words = [
            (
                letter,
                expression
                if isinstance(expression, str)
                else number_text(letter, expression(values)),
            )
            for letter, expression in self.words
        ]
        new_values = [
            (
                setting,
                setting.number(values) if setting.number is not None else 0,
                setting.value(values),
            )
            for setting in self.settings
        ]
        for setting, number, value in new_values:
            if setting.number is None:
                values.set_named(setting.name, value, self.place)
            else:
                values.set_number(number, value, self.place)
        return RawBlock(words, self.tags)


class Code(NamedTuple):
    """The code of a line in lower case without blanks, and the comment after ``;``."""

    text: str
    comment: str


def code_of(text: str, flavour: Flavour, file: str, line: int) -> Code:
    """Return the code of a line.

    Raises
    ------
    JobError
        If the parentheses do not match.
    """
    comment = ""
    if text.strip().upper() in flavour.queries:
        return Code("", "")
    if flavour.loose_comments:
        text, _, comment = text.partition(";")
        text = _LOOSE.sub("", text)
    elif ";" in text or "(" in text or ")" in text:
        text, comment = without_comments(text, file, line, one_block=True)
    return Code(_BLANKS.sub("", text).lower(), comment)


def statement(code: Code, flavour: Flavour, place: Place) -> Statement | None:
    """Return the statement of a line that is no O word, None for an empty line.

    Raises
    ------
    JobError
        If the line is no block.
    """
    if not code.text:
        return None
    reader = FormulaReader(code.text, flavour, place)
    stray_character = _UNREAL.search(code.text)
    if stray_character is not None:
        reader.at = stray_character.start()
        reader.refuse("this is not part of this dialect")
    words: list[tuple[str, str | Formula]] = []
    settings: list[Setting] = []
    while reader.more():
        letter = reader.peek()
        if letter == "#":
            settings.append(_setting(reader))
            continue
        if not letter.isalpha():
            reader.refuse("a letter is missing", "A block holds words and settings like #1 = 2.")
        reader.at += 1
        number = NUMBER.match(reader.text, reader.at)
        if number is not None:
            reader.at = number.end()
            words.append((letter.upper(), number[0]))
        else:
            words.append((letter.upper(), reader.value()))
    tags = tags_of(code.comment, place.file, place.line) if "=" in code.comment else ()
    return Statement(tuple(words), tuple(settings), tags, place)


def _setting(reader: FormulaReader) -> Setting:
    reader.take("#")
    name, number = "", None
    if reader.peek() == "<":
        name = reader.name()
    else:
        number = reader.whole()
    if not reader.take("="):
        reader.refuse("= is missing behind a parameter", "Write a setting like #1 = 2.")
    return Setting(name, number, reader.value())


def number_text(letter: str, value: float) -> str:
    """Return the number of a word as digits.

    A G number close to a tenth is rounded to a tenth, and an M, L or T number close to a whole
    number is rounded to a whole number.

    >>> number_text("X", 0.1 + 0.2), number_text("G", 1.00000001), number_text("X", 1e-20)
    ('0.30000000000000004', '1', '0')
    """
    scale, tolerance = _WHOLE.get(letter, (1.0, 0.0))
    nearest = math.floor(scale * value + 0.5)
    if abs(scale * value - nearest) <= tolerance:
        value = nearest / scale
    text = format(Decimal(repr(value)), "f")
    if len(text.partition(".")[2]) > MAX_DECIMALS:
        text = format(Decimal(repr(value)), f".{MAX_DECIMALS}f")
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return "0" if text in {"-0", ""} else text
