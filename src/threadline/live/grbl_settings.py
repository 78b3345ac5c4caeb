"""The settings of a grbl controller in words, compared with the values of the machine file.

Source: "Grbl v1.1 Configuration" of gnea/grbl ($0 to $132); grblHAL and grbl-Mega-5X number the
settings of further axes in the same way ($103, $113 ...).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.machine import Machine
from threadline.machine.motion_planner import GrblPlanner

SAME = 1e-3
"""Relative difference up to which a setting counts as equal to the machine file's value."""
STEPS, RATE, ACCELERATION, TRAVEL = 100, 110, 120, 130
"""Numbers of the settings of the first axis; the other axes' follow."""
REPORTS, DEVIATION, INCHES = 10, 11, 13
_LETTERS_MOST = 9
_LINE = re.compile(r"\$(\d{1,5})=([^\s(]*)")
_MASK = "mask"
_ON = "on"
_NAMES: Mapping[int, tuple[str, str]] = {
    0: ("length of a step pulse", "µs"),
    1: ("time until the motors are switched off", "ms"),
    2: ("inverted step signals", _MASK),
    3: ("inverted directions", _MASK),
    4: ("enable signal of the motors inverted", _ON),
    5: ("limit switches inverted", _ON),
    6: ("probe inverted", _ON),
    REPORTS: ("contents of a status report", ""),
    DEVIATION: ("junction deviation", "mm"),
    12: ("deviation of an arc from its chords", "mm"),
    INCHES: ("reports in inches", _ON),
    20: ("soft limits: a move beyond the travel is refused", _ON),
    21: ("hard limits: a limit switch stops the machine", _ON),
    22: ("homing to switches", _ON),
    23: ("axes that home to the other side", _MASK),
    24: ("slow speed of homing", "mm/min"),
    25: ("fast speed of homing", "mm/min"),
    26: ("time in which a switch bounces", "ms"),
    27: ("distance from the switch after homing", "mm"),
    30: ("highest speed of the spindle", "rpm"),
    31: ("lowest speed of the spindle", "rpm"),
    32: ("laser mode", _ON),
}
_OF_AXES: Mapping[int, tuple[str, str]] = {
    STEPS: ("steps", "per {u}"),
    RATE: ("highest speed", "{u}/min"),
    ACCELERATION: ("acceleration", "{u}/s²"),
    TRAVEL: ("travel", "{u}"),
}
_STAYS_ON = 255
_REPORTED = ("machine positions", "buffer")


class Mark(StrEnum):
    """How a setting of the board compares with the machine file."""

    NONE = ""  # the machine file has no such value
    SAME = "same"
    LOWER = "lower"  # allowed: the board moves slower than the file says
    OTHER = "other"  # differs, and no run is refused for it
    REFUSED = "refused"  # nothing moves until one of them is corrected


@dataclass(frozen=True, slots=True)
class BoardSetting:
    """One setting of the board.

    Parameters
    ----------
    number
        Its number: 110 for ``$110``.
    name, unit
        Name in words, and unit; the unit is empty for a code.
    board, words
        Value as the board reports it; and its meaning if it is a code, else empty.
    file
        Value of the machine file in the same unit; empty if it has none.
    mark
        How board and machine file compare.
    """

    number: int
    name: str
    unit: str
    board: str
    words: str
    file: str
    mark: Mark


def texts_of(lines: Iterable[str]) -> dict[int, str]:
    """Return the settings of a ``$$`` listing by number, as text.

    >>> texts_of(["$10=1", "$110=5000.000 (x max rate, mm/min)", "ok"])
    {10: '1', 110: '5000.000'}
    """
    matches = (_LINE.match(line) for line in lines)
    return {int(match[1]): match[2] for match in matches if match is not None}


def number_of(text: str) -> float:
    """Return the number of a setting; NaN if it is none."""
    try:
        return float(text)
    except ValueError:
        return float("nan")


def units_of(machine: Machine) -> FloatArray:
    """Return the (axes,) m or rad per unit of grbl: a millimetre, or a degree."""
    return np.array(
        [1e-3 if axis.kind == "linear" else np.pi / 180.0 for axis in machine.axes.values()]
    )


def setting_values(machine: Machine, letters: Sequence[str]) -> dict[int, float]:
    """Return the values of a machine file by the number of their settings, in grbl's units.

    Parameters
    ----------
    machine
        The machine: its axes, their travel, and the planner of its firmware.
    letters
        Axes of the controller, in the order of its reports.
    """
    values: dict[int, float] = {INCHES: 0.0}
    units = units_of(machine)
    per_unit = machine.counts_per_unit * units
    max_rates = 60.0 * machine.velocity_limit / units
    max_accelerations = machine.acceleration_limit / units
    for k, (name, axis) in enumerate(machine.axes.items()):
        if name not in letters:
            continue
        index = list(letters).index(name)
        values[STEPS + index] = float(per_unit[k])
        values[RATE + index] = float(max_rates[k])
        values[ACCELERATION + index] = float(max_accelerations[k])
        if axis.travel is not None:
            values[TRAVEL + index] = float((axis.travel[1].si - axis.travel[0].si) / units[k])
    if isinstance(machine.planner, GrblPlanner):
        values[DEVIATION] = 1e3 * machine.planner.junction_deviation.si
    return values


def compared(
    texts: Mapping[int, str], machine: Machine, letters: Sequence[str]
) -> list[BoardSetting]:
    """Return the settings of a board, compared with a machine file, in order of their numbers.

    Settings that a run needs (steps, speed, acceleration) are listed even if the board does not
    report them.
    """
    file_values = setting_values(machine, letters)
    rows = []
    needed = {number for number in file_values if STEPS <= number < TRAVEL}
    for number in sorted({*texts, *needed}):
        name, unit = _named(number, machine, letters)
        board = texts.get(number, "")
        file_value = file_values.get(number)
        rows.append(
            BoardSetting(
                number,
                name,
                "" if unit in (_MASK, _ON) else unit,
                board or "not reported",
                _words(number, unit, board, letters),
                "" if file_value is None else f"{file_value:.6g}",
                _mark(number, number_of(board), file_value),
            )
        )
    return rows


def _named(number: int, machine: Machine, letters: Sequence[str]) -> tuple[str, str]:
    """Return the name and the unit of a setting."""
    group, index = number - number % 10, number % 10
    if group in _OF_AXES and index < min(len(letters), _LETTERS_MOST):
        letter = letters[index]
        name, unit = _OF_AXES[group]
        rotary = letter in machine.axes and machine.axes[letter].kind != "linear"
        return f"{name} of {letter}", unit.format(u="°" if rotary else "mm")
    return _NAMES.get(number, ("a setting of this firmware", ""))


def _words(number: int, unit: str, board: str, letters: Sequence[str]) -> str:
    """Return the meaning of a code; empty for a plain number."""
    value = number_of(board)
    if not np.isfinite(value) or value != int(value) or value < 0:
        return ""
    code = int(value)
    if unit == _ON:
        return "yes" if code else "no"
    if unit == _MASK:
        return ", ".join(letter for k, letter in enumerate(letters) if code >> k & 1) or "none"
    if number == REPORTS:
        reported = [words for k, words in enumerate(_REPORTED) if code >> k & 1]
        return ", ".join(reported if code & 1 else ["work positions", *reported])
    if number == 1 and code == _STAYS_ON:
        return "they stay on"
    return ""


def _mark(number: int, board: float, file_value: float | None) -> Mark:
    """Return how a value compares; speeds and accelerations may be lower than the file's."""
    if number == REPORTS:
        return Mark.NONE if np.isfinite(board) and int(board) & 1 else Mark.REFUSED
    if file_value is None:
        return Mark.NONE
    same = bool(abs(board - file_value) <= SAME * abs(file_value))
    if same:
        return Mark.SAME
    if number == INCHES or STEPS <= number < RATE:
        return Mark.REFUSED
    if RATE <= number < TRAVEL:
        return Mark.LOWER if 0.0 < board < file_value else Mark.REFUSED
    return Mark.OTHER
