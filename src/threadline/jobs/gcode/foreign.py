"""Programs that were made for another machine: the letters of its axes, and a guess of its dialect.

``letters_of`` gives each axis of the machine the letter by which a program names it. ``guesses``
orders the dialects for a program by marks in its first lines: the name of a control or of a post,
and words that few controls have.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from threadline.base.reading import open_binary
from threadline.errors import OptionError
from threadline.machine import Machine

LETTERS = "ABCUVWXYZ"
FILAMENT = "E"
"""Letter of the extruder of a 3D print, which no machine here has; its words may be left out."""
MACROS = "MACROS"
"""Name by which the macros of Klipper may be left out."""
_ONLY_OUT = {FILAMENT: "the filament of a 3D print", MACROS: "the moves of Klipper's macros"}
_NONE = "NONE"
_HEAD_BYTES = 1 << 16
_EXAMPLE = 'Write the letter of the program first: "C=A,Z=X".'


class Letters(NamedTuple):
    """Index of each axis of a machine by its letter in a program, and what to leave out."""

    axes: Mapping[str, int]
    dropped: frozenset[str]


def letters_of(machine: Machine, text: str | None) -> Letters:
    """Return the letters by which a program names the axes of a machine.

    Parameters
    ----------
    text
        Pairs like ``"C=A,Z=X,B=none"``: the letter of the program, then the axis of the machine, or
        ``none`` to leave the words of that letter out. An axis without a pair keeps its own letter,
        unless a pair takes that letter. ``E=none`` leaves out the filament of a 3D print, and
        ``macros=none`` the moves of Klipper's macros. None: no axis is renamed.

    Raises
    ------
    OptionError
        If the text cannot be read, names an unknown axis, or uses a letter or an axis twice.

    Examples
    --------
    On a machine with the axes A, X and Y the text ``"C=A,Z=X"`` gives the axes
    ``{"C": 0, "Z": 1, "Y": 2}``.
    """
    names = machine.axis_names
    if text is None:
        return Letters({name: index for index, name in enumerate(names)}, frozenset())
    pairs: dict[str, str] = {}
    for part in text.split(","):
        letter, sign, name = (piece.strip().upper() for piece in part.partition("="))
        if letter in _ONLY_OUT and name != _NONE:
            raise OptionError(
                f"axes {part.strip()[:40]!r}: {_ONLY_OUT[letter]} can only be left out",
                remedy=f"Write {letter if letter == FILAMENT else letter.lower()}=none.",
            )
        if not sign or letter not in (*LETTERS, *_ONLY_OUT):
            raise OptionError(f"axes {part.strip()[:40]!r} is no pair of axes", remedy=_EXAMPLE)
        if name not in (*names, _NONE):
            raise OptionError(
                f"axes {part.strip()[:40]!r}: {machine.name} has no axis {name[:20] or '(empty)'}",
                remedy=f"It has {', '.join(names) or 'no axes'}; none leaves words out. {_EXAMPLE}",
            )
        if letter in pairs or (name != _NONE and name in pairs.values()):
            repeated_name = letter if letter in pairs else name
            raise OptionError(f"axes {text[:40]!r} names {repeated_name} twice", remedy=_EXAMPLE)
        pairs[letter] = name
    letter_of_axis = {name: letter for letter, name in pairs.items()}
    axes = {
        letter_of_axis.get(name, name): index
        for index, name in enumerate(names)
        if name in letter_of_axis or name not in pairs
    }
    return Letters(axes, frozenset(letter for letter, name in pairs.items() if name == _NONE))


@dataclass(frozen=True, slots=True)
class Guess:
    """A dialect that a program may be in, and the mark that says so.

    Parameters
    ----------
    dialect
        Name of the dialect.
    mark
        Text of the program that points to the dialect.
    named
        Whether the mark is the name of a control or of a post, not only a word that it has.
    """

    dialect: str
    mark: str
    named: bool = False


_NAMES: Mapping[str, str] = {
    "linuxcnc": r"\b(?:linuxcnc|emc2|mach ?3|mach ?4)\b",
    "fluidnc": r"\bfluidnc\b",
    "grbl": r"\bgrbl(?:hal)?\b|\b(?:lightburn|laserGRBL)\b",
    "klipper": r"\bklipper\b",
    "reprapfirmware": r"\b(?:reprapfirmware|duet[23]?)\b",
    "marlin": r"\b(?:marlin|reprap|smoothie|cura|slic3r|prusaslicer|repetier)\b"
    r"|Parameters \{.*\"mandrel\"",  # FiberPath and Cyclone, two planners of windings
    "fanuc": r"\bfanuc\b",
}
"""Names in comments by which a program names the control that it was made for."""
_WORDS: Mapping[str, str] = {
    "linuxcnc": r"^[^(;\n]*(?:\bo\s*<|#\s*<|\bo\d+\s+(?:sub|if|while|do|repeat|call)\b|G64\s*P"
    r"|G43(?![.\d])|G91\.1|M6[2-8]\b)",
    "klipper": r"^[ \t]*(?:SET_VELOCITY_LIMIT|SET_GCODE_OFFSET|SET_PRESSURE_ADVANCE)\b",
    "reprapfirmware-cnc": r"^[ \t]*M453\b",
    "reprapfirmware": r"^[ \t]*M(?:566|568|572)\b",
    "marlin": r"^[ \t]*(?:T\d+[ \t]*$|(?:M(?:82|83|84|104|106|107|109|140|190|201|203|204|205|400)"
    r"|G29)\b|G0?[01][ \t][^(;\n]*\bE[-+.\d])",
    "fanuc": r"^[ \t]*O\d{4}\b",
    "grbl": r"^[ \t]*(?:\$H|\$[$#GIN]?[ \t]*$|M3[ \t]*S\d|[^(;\n]*\bM0?4[ \t]+S\d)",
}
"""Words that few controls but these have, by dialect."""
_PREAMBLE = re.compile(r"^[^(;\n]*\b(?:G17|G5[4-9]|M0?[34])\b", re.IGNORECASE | re.MULTILINE)
"""Words of every control for machine tools, and of no winder."""
_END = re.compile(rb"^[ \t]*(?:N\d+[ \t]*)?(?:M0?2|M30|%)[ \t\r]*$", re.IGNORECASE | re.MULTILINE)
_COMMENT = re.compile(r"\(([^()\n]*)\)|;([^\n]*)")


def guesses(path: Path) -> tuple[Guess, ...]:
    """Return the dialects that a program may be in, the likeliest first; empty without any mark.

    The first and the last 64 KiB are searched. A name in a comment counts more than any word. A
    program with the usual preamble and no other mark counts as LinuxCNC's if it has an end, else as
    grbl's, which needs no end.
    """
    with open_binary(path) as stream:
        head_bytes: bytes = stream.read(_HEAD_BYTES)
        stream.seek(max(0, stream.seek(0, 2) - _HEAD_BYTES))
        tail_bytes: bytes = stream.read()
    head = head_bytes.decode("utf-8", "replace")
    comments = " \n".join(one or other for one, other in _COMMENT.findall(head))
    guess_by_dialect: dict[str, Guess] = {}
    for patterns, text, named in ((_NAMES, comments, True), (_WORDS, head, False)):
        marks = []
        for dialect, pattern in patterns.items():
            match = re.search(pattern, text, re.IGNORECASE | re.MULTILINE)
            if match is not None:
                marks.append((match.start(), dialect, match[0].strip()))
        for _, dialect, mark in sorted(marks):
            guess_by_dialect.setdefault(dialect, Guess(dialect, mark[:40], named))
    preamble = _PREAMBLE.search(head)
    if preamble is not None:
        other = "linuxcnc" if _END.search(tail_bytes) else "grbl"
        guess_by_dialect.setdefault(other, Guess(other, preamble[0].strip()[:40]))
    return tuple(guess_by_dialect.values())
