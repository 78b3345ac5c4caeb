"""What a block asks for: its words sorted by meaning, each checked as far as one block can be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, NoReturn

from threadline.errors import JobError, Place
from threadline.jobs.gcode.words import MAX_MAGNITUDE, ONE, exact, split_words

AXIS_LETTERS = "ABCXYZ"
MAX_PASSES = 10**12
_MAX_LABEL = 10**9
_LIMIT = MAX_MAGNITUDE * ONE

# G codes by modal group: one of each group in a block, as in RS274/NGC.
_MOTION = {0: 0, 1: 1}
_GROUPS = {
    0: "motion", 1: "motion", 4: "action", 28: "action", 20: "units", 21: "units",
    90: "distance", 91: "distance", 93: "feed", 94: "feed", 64: "blending",
}  # fmt: skip
_PROGRAM_M = (0, 2, 30, 98, 99)
_SPINDLE_M = 5


class Block(NamedTuple):
    """One block; exact numbers are in units of 10**-18 of what is written.

    Parameters
    ----------
    line
        From 1.
    motion
        0 or 1 for a G0 or G1 word, else -1.
    action
        4 or 28, else -1.
    settings
        The words of G20 G21 G90 G91 G93 G94 G64, as numbers.
    axes
        Index of the axis and exact number, in the order written.
    feed
        Exact F, or None.
    p, passes
        Exact P, or None; L, 1 unless written.
    program
        0, 2, 30, 98 or 99 for that M word, else -1.
    tool_off
        M5 is there.
    label
        O number, else -1.
    tags
        Numbers that the comment names.
    """

    line: int
    motion: int
    action: int
    settings: tuple[int, ...]
    axes: tuple[tuple[int, int], ...]
    feed: int | None
    p: int | None
    passes: int
    program: int
    tool_off: bool
    label: int
    tags: tuple[tuple[str, float], ...]


@dataclass(frozen=True, slots=True)
class Dialect:
    """What a block is read against.

    Parameters
    ----------
    file
        Named in errors.
    machine
        Name of the machine, for errors.
    axes
        Index by axis letter.
    """

    file: str
    machine: str
    axes: Mapping[str, int]


def parse_block(  # noqa: PLR0915 - one loop over the words, the hot path of the reader
    text: str, line: int, dialect: Dialect
) -> Block | None:
    """Return the block on a line, None when it has no words.

    Raises
    ------
    JobError
        If a word is unknown, doubled, out of range, or has no use in its block.
    """
    words, tags = split_words(text, dialect.file, line)
    if not words:
        return None
    motion = action = program = label = -1
    settings: tuple[int, ...] = ()
    axes: tuple[tuple[int, int], ...] = ()
    feed = p = passes = None
    tool_off = False
    seen = ""
    groups: tuple[str, ...] = ()
    for letter, number in words:
        value = exact(number)
        if value is None or not -_LIMIT <= value <= _LIMIT:
            _refuse_number(letter, number, value, line, dialect)
        if letter == "G":
            code = value // ONE if value % ONE == 0 else -1
            group = _GROUPS.get(code)
            if group is None:
                _refuse_word(letter, number, line, dialect)
            if group in groups:
                raise JobError(
                    f"two G words of one kind ({group}) in a block, the second is G{number}",
                    place=Place(dialect.file, line),
                    remedy="Keep one of them.",
                )
            groups = (*groups, group)
            if code in _MOTION:
                motion = code
            elif group == "action":
                action = code
            else:
                settings = (*settings, code)
            continue
        if letter == "M":
            code = value // ONE if value % ONE == 0 else -1
            if code == _SPINDLE_M and not tool_off:
                tool_off = True
                continue
            if code not in _PROGRAM_M:
                _refuse_word(letter, number, line, dialect)
            if program != -1:
                raise JobError(
                    f"two M words that direct the program in a block, the second is M{number}",
                    place=Place(dialect.file, line),
                    remedy="Keep one of them.",
                )
            program = code
            continue
        if letter in seen:
            raise JobError(
                f"the word {letter} stands twice in the block",
                place=Place(dialect.file, line),
                remedy="Keep one of them.",
            )
        seen += letter
        index = dialect.axes.get(letter)
        if index is not None:
            axes = (*axes, (index, value))
        elif letter == "F":
            feed = value
        elif letter == "P":
            p = value
        elif letter == "L":
            passes = _whole(letter, number, value, MAX_PASSES, line, dialect)
        elif letter == "O":
            label = _whole(letter, number, value, _MAX_LABEL, line, dialect)
        elif letter == "N":
            _whole(letter, number, value, MAX_MAGNITUDE, line, dialect)
        else:
            _refuse_word(letter, number, line, dialect)
    if p is not None or action != -1 or feed is not None or program == 98 or passes is not None:
        _check_use(action, motion, program, feed, p, passes, axes, settings, line, dialect)
    return Block(
        line, motion, action, settings, axes, feed, p, 1 if passes is None else passes,
        program, tool_off, label, tags,
    )  # fmt: skip


def _check_use(
    action: int,
    motion: int,
    program: int,
    feed: int | None,
    p: int | None,
    passes: int | None,
    axes: tuple[tuple[int, int], ...],
    settings: tuple[int, ...],
    line: int,
    dialect: Dialect,
) -> None:
    """Refuse words that say nothing, or two things, in the block where they stand."""
    place = Place(dialect.file, line)
    if feed is not None and feed <= 0:
        raise JobError(
            f"feed F {feed / ONE:g} must be greater than 0", place=place, remedy="Give a feed."
        )
    if action == 4 and (axes or p is None):
        what = "has no P" if p is None else "stands with axis words"
        raise JobError(
            f"G4 {what}", place=place, remedy="Write a dwell as a block G4 P with its seconds."
        )
    if action == 28 and motion != -1:
        raise JobError(
            f"G28 and G{motion} both take the axis words of the block",
            place=place,
            remedy="Write two blocks.",
        )
    users = (action == 4) + (program == 98) + (64 in settings)
    if p is not None and users != 1:
        what = "has no use in this block" if users == 0 else "could belong to two words"
        raise JobError(f"P {what}", place=place, remedy="P belongs to G4, G64 or M98.")
    if p is not None and p < 0:
        raise JobError(f"P {p / ONE:g} must not be negative", place=place)
    if program == 98 and (p is None or p % ONE or p > _MAX_LABEL * ONE):
        raise JobError(
            f"M98 needs the number of a subroutine as P from 0 to {_MAX_LABEL}",
            place=place,
            remedy="Write M98 P 999 L 3 for three passes of O 999.",
        )
    if passes is not None and program != 98:
        raise JobError("L has no use in this block", place=place, remedy="L belongs to M98.")
    if passes == 0:
        raise JobError("L 0 calls the subroutine no times", place=place, remedy="Give L 1 or more.")


def _whole(letter: str, number: str, value: int, limit: int, line: int, dialect: Dialect) -> int:
    if value % ONE or not 0 <= value // ONE <= limit:
        raise JobError(
            f"{letter} {_short(number)} must be a whole number from 0 to {limit}",
            place=Place(dialect.file, line),
            remedy="Correct it.",
        )
    return value // ONE


def _refuse_number(
    letter: str, number: str, value: int | None, line: int, dialect: Dialect
) -> NoReturn:
    fine = value is None and len(number.partition(".")[0].lstrip("+-").lstrip("0")) <= 12
    what = "has more than 17 decimals" if fine else "is beyond 10^12"
    raise JobError(
        f"the number of {letter} {_short(number)} {what}",
        place=Place(dialect.file, line),
        remedy="Write a number that a machine can use.",
    )


def _refuse_word(letter: str, number: str, line: int, dialect: Dialect) -> NoReturn:
    place = Place(dialect.file, line)
    if letter in AXIS_LETTERS:
        raise JobError(
            f"{letter} {_short(number)}: the machine {dialect.machine!r} has no axis {letter}",
            place=place,
            remedy=f"Its axes are {', '.join(dialect.axes)}; choose another machine (-m).",
        )
    known = {
        "G": "Known G words are G0 G1 G4 G20 G21 G28 G64 G90 G91 G93 G94.",
        "M": "Known M words are M0 M2 M5 M30 M98 M99.",
    }.get(letter, f"Known letters are F G L M N O P and the axes {' '.join(dialect.axes)}.")
    raise JobError(f"unknown word {letter}{_short(number)}", place=place, remedy=known)


def _short(number: str) -> str:
    return number if len(number) <= 24 else number[:24] + "..."
