"""Errors for words that a block cannot have, with their remedies."""

from __future__ import annotations

from typing import NoReturn

from threadline.errors import JobError, Place
from threadline.jobs.gcode.dialects import WHY, WHY_IN, Reading, knowing
from threadline.jobs.gcode.words import ONE

AXIS_LETTERS = "ABCXYZ"


def whole(letter: str, number: str, value: int, limit: int, line: int, reading: Reading) -> int:
    """Return a whole number from 0 to ``limit``.

    Raises
    ------
    JobError
        If it is none.
    """
    if value % ONE or not 0 <= value // ONE <= limit:
        raise JobError(
            f"{letter} {_short(number)} must be a whole number from 0 to {limit}",
            place=Place(reading.file, line),
            remedy="Correct it.",
        )
    return value // ONE


def refuse_number(
    letter: str, number: str, value: int | None, line: int, reading: Reading
) -> NoReturn:
    """Refuse a number that is too fine or too large."""
    fine = value is None and len(number.partition(".")[0].lstrip("+-").lstrip("0")) <= 12
    what = "has more than 17 decimals" if fine else "is beyond 10^12"
    raise JobError(
        f"the number of {letter} {_short(number)} {what}",
        place=Place(reading.file, line),
        remedy="Write a number that a machine can use.",
    )


def refuse_without_point(letter: str, number: str, line: int, reading: Reading) -> NoReturn:
    """Refuse a number without decimal point, whose unit depends on a parameter of the control."""
    raise JobError(
        f"{letter}{_short(number)} has no decimal point: by its parameter DPI a Fanuc control "
        "reads it in millimetres (degrees) or in thousandths of them",
        place=Place(reading.file, line),
        remedy=f"Write {letter}{_short(number)}. or the thousandths with a point.",
    )


def refuse_word(letter: str, number: str, code: int, line: int, reading: Reading) -> NoReturn:
    """Refuse an unknown word; the error lists the known ones and dialects that have this one."""
    place = Place(reading.file, line)
    dialect = reading.dialect
    if letter in AXIS_LETTERS:
        raise JobError(
            f"{letter} {_short(number)}: the machine {reading.machine!r} has no axis {letter}",
            place=place,
            remedy=f"Its axes are {', '.join(reading.axes)}; choose another machine (-m).",
        )
    if letter == "G" and code in WHY:
        raise JobError(
            f"G{_short(number)} is {WHY[code]}",
            place=place,
            remedy="Have the program written without it, or take it out if it changes nothing.",
        )
    whole = f"{code / 10 if letter == 'G' else code:g}" if letter in "GM" else ""
    why = WHY_IN.get(dialect.name, {}).get(f"{letter}{whole}")
    if why is not None:
        raise JobError(
            f"{letter}{_short(number)} is {why}",
            place=place,
            remedy="Have the program written without it, or take it out if it changes nothing.",
        )
    known = {
        "G": f"Known G words are {_list('G', [c / 10 for c in dialect.g])}.",
        "M": f"Known M words are {_list('M', list(dialect.m))}.",
    }.get(
        letter,
        f"Known letters are {' '.join(sorted('FGLMNOP' + dialect.idle_letters))} and the axes "
        f"{' '.join(reading.axes)}.",
    )
    others = [name for name in knowing(letter, code) if name != dialect.name] if code >= 0 else []
    also = f" The dialect {' or '.join(others)} has it (--dialect)." if others else ""
    raise JobError(f"unknown word {letter}{_short(number)}", place=place, remedy=f"{known}{also}")


def _list(letter: str, codes: list[float]) -> str:
    return " ".join(f"{letter}{code:g}" for code in sorted(codes))


def _short(number: str) -> str:
    return number if len(number) <= 24 else number[:24] + "..."
