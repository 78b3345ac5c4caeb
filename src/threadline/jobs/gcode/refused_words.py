"""Words that are refused, each by its meaning for the control and with a remedy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NoReturn

from threadline.errors import JobError, Place
from threadline.jobs.gcode.dialects import DIALECTS, Reading
from threadline.jobs.gcode.words import ONE

_CYCLE = "a canned cycle (drilling, boring or tapping), which is read for linuxcnc alone"
_SPINDLE_CYCLE = "a canned cycle that stops, turns or locks the spindle, which is not read"
_RADIUS = "compensation of the cutter's radius, by which the tool would leave the programmed path"
_ANALOGUE = "an analogue output, which no machine here has"
_BUILT = "what marlin knows only where it is built with"
_PEN = "files for Marlin lift the pen of a plotter by it"
WHY: Mapping[int, str] = {
    410: _RADIUS, 420: _RADIUS, 100: "a setting of data in the control (offsets, tool tables)",
    430: "compensation of the tool's length", 431: "compensation of the tool's length",
    **dict.fromkeys((382, 383, 384, 385), "probing, whose end nobody knows before"),
    **dict.fromkeys((730, 810, 820, 830, 850, 890), _CYCLE),
    **dict.fromkeys((740, 760, 840, 860, 870, 880), _SPINDLE_CYCLE),
}  # fmt: skip
"""Meaning of the G words that no dialect here has, by ten times their number."""
WHY_IN: Mapping[str, Mapping[str, str]] = {
    "grbl": {
        "G64": "no word of grbl, which blends by its own settings",
        "M300": f"no word of grbl, which stops at it with error:20: {_PEN}",
    },
    "fluidnc": {
        "G64": "no word of fluidnc, which blends by its own settings",
        "M300": f"no word of fluidnc, which stops at it: {_PEN}",
        **dict.fromkeys(("M67", "M68"), _ANALOGUE),
    },
    "linuxcnc": dict.fromkeys(("M67", "M68"), _ANALOGUE),
    "klipper": {
        "G20": "the inch, which klipper refuses",
        "G92.1": "no word of klipper, which ignores it",
        "M220": "a share of every feed behind it",
        "S": "no word of klipper's G4, whose time is P in ms",
    },
    "reprapfirmware": {
        **dict.fromkeys(
            ("G5", "G91.1", "G92.1", "M7", "M8", "M9"),
            "no command of reprapfirmware, which runs a macro file of this name if there is one",
        ),
        "G20": "the inch, by which reprapfirmware scales the words of turning axes, too",
        "G53": "a move in machine coordinates, which is not read for reprapfirmware",
        "G93": "the inverse of a move's time, which is not read for reprapfirmware",
        **dict.fromkeys(("G29", "G30", "G32"), "probing, whose end nobody knows before"),
        **dict.fromkeys(
            ("M92", "M201", "M203", "M204", "M205", "M501", "M502", "M566", "M593", "M669"),
            "a new setting of steps, limits, jerks or shaper of the firmware",
        ),
        "M98": "a macro file, whose moves are not in the program",
        "M120": "the command that saves feed and modes for M121",
        "M121": "the command that restores the feed and modes that M120 saved",
        "M220": "a share of every feed behind it",
        "M290": "a shift of the zero (baby steps)",
        "M453": "a CNC machine from there on: use --dialect reprapfirmware-cnc, and take it out",
        **dict.fromkeys(("M451", "M452"), "another kind of machine, which moves G0 anew"),
        "H": "a move to an endstop, or of motors without the axes",
        "S": "a move to an endstop in old programs, or the power of a laser",
        "T": "no word of a machine with one tool, which is T0 on a line of its own",
    },
    "marlin": {
        "G5": f"{_BUILT} BEZIER_CURVE_SUPPORT, and ignores otherwise",
        **dict.fromkeys(("G18", "G19"), f"{_BUILT} CNC_WORKSPACE_PLANES, and ignores otherwise"),
        "G20": f"{_BUILT} INCH_MODE_SUPPORT; otherwise all numbers stay millimetres",
        "G92.1": f"{_BUILT} CNC_COORDINATE_SYSTEMS, and reads as G92 otherwise",
        "G91.1": "read as G91 by marlin",
        "G26": "a test print of the mesh of the bed, whose moves only the firmware knows",
        **dict.fromkeys(("G29", "G30", "G34"), "probing, whose end nobody knows before"),
        "M420": "the compensation of the bed by a mesh, which changes the path",
        **dict.fromkeys(
            ("M92", "M201", "M203", "M204", "M205", "M501", "M502"),
            "a new setting of steps, limits or jerks of the firmware",
        ),
        "M220": "a share of every feed behind it",
        "M810": "a macro, whose moves only the firmware knows",
        "T": "no word of a machine with one tool, which is T0 on a line of its own",
    },
}
"""Meaning of the words that one control reads differently, by dialect and word."""


def knowing(letter: str, code: int) -> list[str]:
    """Return the dialects that have a G word (ten times its number) or an M word."""
    return [d.name for d in DIALECTS.values() if code in (d.g if letter == "G" else d.m)]


AXIS_LETTERS = "ABCXYZ"
_FILAMENT = (
    "the filament of a 3D print, and 3D prints are not read: their time depends on the extruder, "
    "whose limits no machine file here has"
)


def whole(letter: str, number: str, value: int, limit: int, line: int, reading: Reading) -> int:
    """Return a whole number from 0 to ``limit``.

    Raises
    ------
    JobError
        If the number is not whole, or is out of this range.
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
    is_too_fine = value is None and len(number.partition(".")[0].lstrip("+-").lstrip("0")) <= 12
    fault = "has more than 17 decimals" if is_too_fine else "is beyond 10^12"
    raise JobError(
        f"the number of {letter} {_short(number)} {fault}",
        place=Place(reading.file, line),
        remedy="Write a number that a machine can use.",
    )


def refuse_without_point(letter: str, number: str, line: int, reading: Reading) -> NoReturn:
    """Refuse a number without a decimal point: a parameter of the control sets its unit."""
    raise JobError(
        f"{letter}{_short(number)} has no decimal point: by its parameter DPI a Fanuc control "
        "reads it in millimetres (degrees) or in thousandths of them",
        place=Place(reading.file, line),
        remedy=f"Write {letter}{_short(number)}. or the thousandths with a point.",
    )


def refuse_axis(letter: str, number: str, place: Place, reading: Reading) -> NoReturn:
    """Refuse the word of an axis that the machine lacks; the error says how axes are renamed."""
    axis_words = [
        name if reading.names[index] == name else f"{reading.names[index]} (here {name})"
        for name, index in reading.axes.items()
    ]
    raise JobError(
        f"{letter} {_short(number)}: the machine {reading.machine!r} has no axis {letter}",
        place=place,
        remedy=f"Its axes are {', '.join(axis_words)}; choose another machine (-m), or rename the "
        f'program\'s (--axes "{letter}={reading.names[-1]}"; {letter}=none leaves words out).',
    )


def refuse_word(letter: str, number: str, code: int, line: int, reading: Reading) -> NoReturn:
    """Refuse an unknown word; the error lists the known words and the dialects that have it."""
    place = Place(reading.file, line)
    dialect = reading.dialect
    if letter in AXIS_LETTERS:
        refuse_axis(letter, number, place, reading)
    if letter == "G" and code in WHY:
        raise JobError(
            f"G{_short(number)} is {WHY[code]}",
            place=place,
            remedy="Have the program written without it, or take it out if it changes nothing.",
        )
    if letter == "E":
        raise JobError(
            f"E{_short(number)} is {_FILAMENT}",
            place=place,
            remedy="Leave the E words out (--axes E=none): the way of the head alone is then "
            "planned, without extrusion and the time of moves of E alone.",
        )
    number_text = f"{code / 10 if letter == 'G' else code:g}" if letter in "GM" else ""
    reason = WHY_IN.get(dialect.name.removesuffix("-cnc"), {}).get(f"{letter}{number_text}")
    if reason is not None:
        raise JobError(
            f"{letter}{_short(number)} is {reason}",
            place=place,
            remedy="Write M3 S... and M5 in its place, as the servo takes them, or read the file "
            "for Marlin (--dialect marlin)."
            if number_text == "300"
            else "Have the program written without it, or take it out if it changes nothing.",
        )
    known = {
        "G": f"Known G words are {_word_list('G', [c / 10 for c in dialect.g])}.",
        "M": f"Known M words are {_word_list('M', list(dialect.m))}.",
    }.get(
        letter,
        f"Known letters are {' '.join(sorted('FGLMNOP' + dialect.idle_letters))} and the axes "
        f"{' '.join(reading.axes)}.",
    )
    others = [name for name in knowing(letter, code) if name != dialect.name] if code >= 0 else []
    dialects_hint = f" The dialect {' or '.join(others)} has it (--dialect)." if others else ""
    raise JobError(
        f"unknown word {letter}{_short(number)}", place=place, remedy=f"{known}{dialects_hint}"
    )


def _word_list(letter: str, codes: list[float]) -> str:
    return " ".join(f"{letter}{code:g}" for code in sorted(codes))


def _short(number: str) -> str:
    return number if len(number) <= 24 else number[:24] + "..."
