"""Text of the user, made harmless for the place that it is written to.

Names of jobs and machines, titles, steps, tags and file names are anybody's text. Each kind of
output has its one function here, so that no such text ends a comment, begins a command, or drives
a terminal. Only the standard library is imported here.
"""

from __future__ import annotations

import json
import re
import unicodedata
from typing import Any

_DRIVING = frozenset({"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"})
"""Unicode categories that are never written as they are: controls, marks that reverse the direction
of writing, lone surrogates (from file names that are not UTF-8), code points that are private or
unassigned, and line separators."""


def plain(text: str) -> str:
    r"""Return ``text`` in one line of characters that can be seen.

    Everything else is written as in a Python string. It is for terminals, XML, SVG and HTML: their
    own escapes of markup come after this.

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
    """Return what may stand in a ``(* comment *)`` of IEC 61131-3 text, and cannot end it.

    The third edition of the standard nests comments and adds ``//`` and ``/* */``. Some tools also
    read ``{pragmas}``, ``@`` tags or quoted strings in comments. None of these marks stays whole.

    >>> st_comment("a *) b := TRUE; (* c"), st_comment("{x}**"), st_comment("// @END")
    ('a * ) b := TRUE; ( * c', '[x]* *', '/ / at END')
    """
    text = ascii_only(text).translate(str.maketrans("{}'\"", "[]``")).replace("@", "at ")
    return re.sub(r"([(*/])(?=[)*/])", r"\1 ", text)


def nc_comment(text: str) -> str:
    """Return what may stand behind the ``;`` of a part program, and is no word of it.

    Brackets begin comments and messages to the operator (MSG, DEBUG, PRINT) and end them, ``%``
    ends a program, and a second ``;`` or a ``#`` is a comment or a parameter to some.

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
    """Return ``value`` as JSON in one line that every reader of lines takes for one.

    Text stays as it is, unless it holds a character that ``plain`` would escape: then everything
    outside of ASCII is escaped.
    """
    text = json.dumps(value, ensure_ascii=False)
    return text if plain(text) == text else json.dumps(value)


def _in_toml(letter: str) -> str:
    if letter in '"\\':
        return f"\\{letter}"
    if letter.isascii() and letter.isprintable():
        return letter
    if unicodedata.category(letter) == "Cs":  # half of a pair, which TOML has no escape for
        return f"\\\\u{ord(letter):04x}"
    return f"\\u{ord(letter):04X}" if ord(letter) < 1 << 16 else f"\\U{ord(letter):08X}"


def _escaped(letter: str) -> str:
    return letter.encode("unicode_escape", "surrogatepass").decode("ascii")
