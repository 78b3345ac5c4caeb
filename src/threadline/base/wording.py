"""Make text from users and from other libraries safe to print.

Names of jobs and machines, titles, steps, tags and file names may contain any text. This module has
one function for each kind of output, so that such a text cannot end a comment, begin a command, or
control a terminal. Only the standard library is imported here.
"""

from __future__ import annotations

import difflib
import json
import re
import unicodedata
from collections.abc import Iterable, Mapping
from typing import Any

_DRIVING = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
"""Unicode categories that are always escaped: control characters, marks that reverse the direction
of writing, lone surrogates (from file names that are not UTF-8), private or unassigned code points,
and line separators."""


def plain(text: str) -> str:
    r"""Return ``text`` as one line of visible characters.

    Other characters are escaped as in a Python string. Use this function for terminals, XML, SVG
    and HTML; escape the markup of the latter afterwards.

    >>> plain("a\x1b[2Jb\nc"), plain("10 \u00b5s"), plain("\u202etxt.exe"), plain("\udcff")
    ('a\\x1b[2Jb\\nc', '10 µs', '\\u202etxt.exe', '\\udcff')
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(
        _escaped(letter) if unicodedata.category(letter) in _DRIVING else letter for letter in text
    )


def ascii_only(text: str) -> str:
    r"""Return ``text`` in one line of ASCII, other characters written as in a Python string.

    >>> print(ascii_only("Käfig\n"))
    K\xe4fig\n
    """
    return "".join(
        letter if letter.isascii() and letter.isprintable() else _escaped(letter) for letter in text
    )


def st_comment(text: str) -> str:
    """Return ``text`` in a form that cannot end a ``(* comment *)`` of IEC 61131-3.

    The third edition of the standard allows nested comments and adds ``//`` and ``/* */``. Some
    tools also read ``{pragmas}``, ``@`` tags or quoted strings in comments. All these marks are
    broken up.

    >>> st_comment("a *) b := TRUE; (* c"), st_comment("{x}**"), st_comment("// @END")
    ('a * ) b := TRUE; ( * c', '[x]* *', '/ / at END')
    """
    text = ascii_only(text).translate(str.maketrans("{}'\"", "[]``")).replace("@", "at ")
    return re.sub(r"([(*/])(?=[)*/])", r"\1 ", text)


def nc_comment(text: str) -> str:
    """Return ``text`` in a form that is safe for a comment after ``;`` in a part program.

    Brackets begin and end comments and messages to the operator (MSG, DEBUG, PRINT), and ``%`` ends
    a program. For some controllers a second ``;`` begins a comment, and ``#`` a parameter.

    >>> nc_comment("a) M3 ; (MSG,stop) %"), nc_comment("#1=2")
    ('a] M3 , [MSG,stop] _', '_1=2')
    """
    return ascii_only(text).translate(str.maketrans("();%#", "[],__"))


def toml_string(text: str) -> str:
    r"""Return ``text`` as a basic string of TOML, in ASCII.

    >>> print(toml_string('a"b\\c\n\x7f'), toml_string("\U0001f600"))
    "a\"b\\c\u000A\u007F" "\U0001F600"
    """
    return '"' + "".join(map(_in_toml, text)) + '"'


def json_line(value: Any) -> str:
    """Return ``value`` as JSON on one line, without characters that may count as line breaks.

    If the text contains a character that ``plain`` would escape, all characters outside of ASCII
    are escaped; otherwise the text is unchanged.
    """
    text = json.dumps(value, ensure_ascii=False)
    return text if plain(text) == text else json.dumps(value)


def _in_toml(letter: str) -> str:
    if letter in '"\\':
        return f"\\{letter}"
    if letter.isascii() and letter.isprintable():
        return letter
    if unicodedata.category(letter) == "Cs":  # a lone surrogate has no escape in TOML
        return f"\\\\u{ord(letter):04x}"
    return f"\\u{ord(letter):04X}" if ord(letter) < 1 << 16 else f"\\U{ord(letter):08X}"


def _escaped(letter: str) -> str:
    return letter.encode("unicode_escape", "surrogatepass").decode("ascii")


_SHOWN = 60
_FIGURES = re.compile(r"[-+]?\b\d[\d.]*(?:e[-+]?\d+)?")
_PARTS = re.compile(r"\b(\w+)\.([A-Za-z][\w-]*)|\baxis ([A-Z])\b")

_KINDS = {
    "string": ("must be a text", 'Write it in quotes, like "servo".'),
    "tuple": ("must be a list", 'Write it in brackets, like ["a", "b"].'),
    "list": ("must be a list", 'Write it in brackets, like ["a", "b"].'),
    "dict": ("must be a table", "Write it as a [table] with a key on each line."),
    "dataclass": ("must be a table", "Write it as a [table] with a key on each line."),
    "model_attributes": ("must be a table", "Write it as a [table] with a key on each line."),
    "bool": ("must be true or false", "Write true or false, without quotes."),
    "int": ("must be a whole number", "Write it without quotes, unit and decimals."),
    "float": ("must be a number", "Write it without quotes and unit."),
}
_PATTERNS = {
    "^[A-Z]$": ("must be one capital letter", "Name it like A, X or Y."),
    "^H(0|[1-9][0-9]{0,5})$": (
        "must be the number of a tool length: H and up to six digits, without leading zeros",
        "Write it like H1.",
    ),
    "^G5[4-9]$": ("must be a work coordinate system, G54 to G59", "Write it like G55."),
    "^[A-Za-z][A-Za-z0-9_-]*$": (
        "must be a name of letters, digits, _ and - that begins with a letter",
        "Name it like x_belt.",
    ),
    "^[A-Za-z_]+(\\.(\\*|[A-Za-z0-9_-]+))+$": (
        "must be a number's place in the file, with * for any part of it",
        'Write it like "links.x_belt.stiffness" or "drives.*.resistance".',
    ),
    "^(bodies|links|drives|sensors|controllers)(\\.[A-Za-z][A-Za-z0-9_-]*){2,3}$": (
        "must be the key of a number of a body, link, drive, sensor or controller",
        "Write it like links.x_belt.stiffness.",
    ),
    "^%IX(0|[1-9][0-9]{0,3})(\\.[0-7])?$": (
        "must be the address of an input: %IX, a byte without leading zeros, a bit from 0 to 7",
        "Write it like %IX0.3.",
    ),
    "^%QX(0|[1-9][0-9]{0,3})(\\.[0-7])?$": (
        "must be the address of an output: %QX, a byte without leading zeros, a bit from 0 to 7",
        "Write it like %QX0.3.",
    ),
    "^[A-Za-z0-9]{1,4}$": (
        "must be the name of a pin, up to four letters and digits",
        "Write it like 3 or A1.",
    ),
    "^[A-Za-z0-9-]{1,20}$": (
        "must be the name of a connector, up to twenty letters, digits and -",
        "Name it like CN1.",
    ),
    "^[0-9]{1,40}/[0-9]{1,40}$": ("must be a fraction of whole numbers", "Write it like 1/200."),
}
_RANGES = {
    "greater_than": ("greater than", "gt"),
    "greater_than_equal": ("at least", "ge"),
    "less_than": ("less than", "lt"),
    "less_than_equal": ("at most", "le"),
}


def toml_fault(error: Exception, text: str) -> tuple[str, int]:
    """Return the fault of a TOML file, and its line.

    The line is 0 if it is unknown, and the last line if the fault is at the end of the file.

    Parameters
    ----------
    error
        Error from ``tomllib``: ``TOMLDecodeError``, or ``RecursionError`` for deep nesting.
    text
        Content of the file.
    """
    if isinstance(error, RecursionError):
        return "the file is nested too deeply", 0
    message = str(error)
    match = re.search(r" ?\(at (?:line (\d+), column \d+|end of document)\)$", message)
    if match is None:
        return f"not valid TOML: {message}", 0
    message = message[: match.start()]
    message = message[:1].lower() + message[1:]
    if match[1] is not None:
        return f"not valid TOML: {message}", int(match[1])
    last_line = text.rstrip("\n").count("\n") + 1
    return f"not valid TOML: {message} before the end; the file may be truncated", last_line


def line_in_rows(text: str, rows: str, index: int | None, key: str) -> int:
    """Return the line of ``key`` in a table of an array of tables of a TOML file.

    Parameters
    ----------
    text
        The file.
    rows, index
        Name of the array, ``[[rows]]``, and index of the table; None for the top of the file.
    key
        The key to find. If it is missing, the result is the line of the table's header, or 0 if the
        header is missing as well.
    """
    is_header = re.compile(rf"\s*\[\[\s*{re.escape(rows)}\s*\]\]")
    is_key = re.compile(rf'\s*"?{re.escape(key)}"?\s*=')
    table_index, header_line = -1, 0
    for number, line in enumerate(text.splitlines(), start=1):
        if is_header.match(line):
            table_index += 1
            header_line = number if table_index == index else header_line
        elif (
            key
            and is_key.match(line)
            and (table_index == index or (index is None and table_index < 0))
        ):
            return number
    return header_line


def field_fault(error: Mapping[str, Any]) -> tuple[str, str]:
    """Return the fault of a value and the remedy.

    Parameters
    ----------
    error
        One of ``ValidationError.errors()`` of pydantic.
    """
    kind, context = error["type"], error.get("ctx", {})
    got_text = f", got {_shown(error.get('input'))}"
    for ending in ("_type", "_parsing", "_exact_type"):
        if kind.endswith(ending) and kind.removesuffix(ending) in _KINDS:
            must, remedy = _KINDS[kind.removesuffix(ending)]
            return must + got_text, remedy
    if kind in _RANGES:
        words, key = _RANGES[kind]
        return f"must be {words} {context[key]}{got_text}", "Correct the number."
    if kind in {"literal_error", "enum"}:
        return f"must be {context['expected']}{got_text}", _nearest(error, context["expected"])
    if kind == "union_tag_invalid":
        tags = context["expected_tags"]
        return f"kind must be one of {tags}, got {context['tag']!r}", _nearest(context, tags)
    if kind == "too_short":
        min_length = context["min_length"]
        entries = "entry" if min_length == 1 else "entries"
        return f"must have at least {min_length} {entries}{got_text}", "Add what is missing."
    if kind == "too_long":
        # Pydantic gives the number of entries only for lists, and None for tables.
        max_length, count = context["max_length"], len(error["input"])
        entries = "entry" if max_length == 1 else "entries"
        return f"must have at most {max_length} {entries}, got {count}", "Take some out."
    if kind == "string_pattern_mismatch":
        unknown = f"must look like {context['pattern']}", "Correct it."
        must, remedy = _PATTERNS.get(context["pattern"], unknown)
        return must + got_text, remedy
    if kind == "value_error":
        return str(error["msg"]).removeprefix("Value error, "), ""
    message = str(error["msg"]).removeprefix("Input ")
    return f"{message[:1].lower()}{message[1:]}{got_text}", "Correct it."


def nearest(name: str, known: Iterable[str], otherwise: str = "Known") -> str:
    """Return a remedy for a wrong word: the most similar valid word, or all valid words.

    >>> nearest("hed", ["head", "frame"]), nearest("zz", ["head", "frame"], "There are")
    ("Did you mean 'head'?", 'There are: head, frame.')
    """
    known_words = list(known)
    matches = difflib.get_close_matches(name, known_words, n=1, cutoff=0.5)
    return (
        f"Did you mean {matches[0]!r}?"
        if matches
        else f"{otherwise}: {', '.join(known_words) or 'none'}."
    )


def _nearest(error: Mapping[str, Any], expected: str) -> str:
    known_words = re.findall(r"'([^']*)'", expected)
    given_word = error.get("tag", error.get("input"))
    matches = difflib.get_close_matches(str(given_word), known_words, n=1)
    return f"Did you mean {matches[0]!r}?" if matches else "Choose one of them."


def _shown(value: object) -> str:
    text = repr(value).lower() if isinstance(value, bool) else repr(value)
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "..."


def grouped(warnings: Iterable[str]) -> list[str]:
    """Merge warnings that differ only in numbers and in the part of the machine.

    >>> grouped(["axes.X: 3 A of 2 A", "axes.Y: 4 A of 2 A", "slow", "slow"])
    ['axes.X: 3 A of 2 A (likewise axes.Y)', 'slow (2 times)']
    """
    groups: dict[str, list[str]] = {}
    for text in warnings:
        names_a_part = _PARTS.match(text) is not None
        kind = _FIGURES.sub("#", _PARTS.sub(r"\1", text)) if names_a_part else text
        groups.setdefault(kind, []).append(text)
    lines = []
    for first, *others in groups.values():
        subjects = dict.fromkeys(text.partition(":")[0] for text in others)
        subjects.pop(first.partition(":")[0], None)
        if subjects:
            lines.append(f"{first} (likewise {', '.join(subjects)})")
        elif others:
            lines.append(f"{first} ({len(others) + 1} times)")
        else:
            lines.append(first)
    return lines
