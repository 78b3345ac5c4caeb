"""Reader of grbl's answers to ``$$`` and ``$I``, and of FluidNC's YAML (same motion planner).

Sources: grbl 1.1 wiki, "Configuring Grbl" ($11, $100 to $135) and "Grbl v1.1 Interface"
(``[OPT:]``, whose C is CoreXY; ``[AXS:]`` of grbl-Mega-5X and grblHAL names the axes); grbl 0.8,
README ($0 in steps per mm); FluidNC wiki, "Axes" and "Kinematics"; FluidNC,
``Configuration/Parser.cpp``: keys are compared without regard to case.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from threadline.errors import MachineError, Place
from threadline.machine.firmware.axis_settings import AxisSettings, Settings, number_or_nan, unknown
from threadline.machine.firmware.dump_lines import (
    DumpLine,
    DumpSetting,
    dump_lines,
    in_force,
    pasted,
)

_LETTERS = "XYZABCUVW"
_GRBL_AXES = "XYZABC"
_DEVIATION = 11
_GRBL = {100: "steps", 110: "rate", 120: "acceleration", 130: "travel"}
_SETTING = re.compile(r"\$(\d{1,3})\s*=\s*([^\s(;,>]*)")
_QUERY = re.compile(r"\$\d{1,3}$")  # query of a single setting in grblHAL
_COMMENT = re.compile(r"\s*(?:[A-Za-z(;,>|/#<\[-].*)?$")
_SETTING_AMID = re.compile(r"(?<![\w$])\$1[0-3]\d\s*=")
_OPTIONS = re.compile(r"\[OPT:([A-Z+0-9]*)")
_AXES = re.compile(r"\[AXS:\d:([A-Z]{1,9})\]")
_OLD = re.compile(r"\$[0-2]\s*=\s*[\d.]+\s*\(\s*[xyz]\W.*step")
_NONE_IS_ZERO = "0 means none"
_FLUIDNC = {
    "steps_per_mm": "steps", "max_rate_mm_per_min": "rate",
    "acceleration_mm_per_sec2": "acceleration", "max_travel_mm": "travel",
}  # fmt: skip
_FLUIDNC_TAKES = {"steps": "80", "rate": "1000", "acceleration": "25", "travel": "1000"}
"""FluidNC's defaults for keys that an axis leaves out (``Axis.h``)."""
_OF_TERMINAL = re.compile(r"(?:\[|<|>|\$|ok\b|\.\.\.$|---)")


def is_grbl(lines: Sequence[str]) -> bool:
    """Return whether lines hold settings in grbl's form."""
    return any(
        re.search(r"(?<![\w$])\$1[0-3]\d\s*=", line) or _OLD.search(line)
        for _, line in pasted(lines).lines
    )


def read_grbl(lines: Sequence[str], file: str) -> Settings:
    """Return the settings of axes and planner in grbl's answer to ``$$``.

    Raises
    ------
    MachineError
        If a setting cannot be read, has two values, or has the numbering of grbl 0.8.
    """
    settings = Settings("grbl", file)
    letters = _GRBL_AXES
    sayings: list[DumpSetting] = []
    terminal = pasted(lines)
    settings.notes += [terminal.note] if terminal.note else []
    for line in dump_lines(terminal.lines, file):
        text = line.text
        if "FluidNC" in text and not text.startswith(";"):
            settings.firmware = "fluidnc"
        axes = _AXES.search(text)
        letters = letters if axes is None else axes[1]
        options = _OPTIONS.search(text)
        if options is not None and "C" in options[1]:
            settings.refuse_kinematics(f"{options[0]}...]: C is CoreXY", line.place)
        if _OLD.match(text):
            raise MachineError(
                f"{text[:50]!r} is a setting of grbl 0.8 or older",
                place=line.place,
                remedy="Give the answer of grbl 0.9 or later to $$, with $100 and following.",
            )
        sayings += _settings_of(line)
    kept, note = in_force(sayings, lambda a, b: number_or_nan(a) == number_or_nan(b))
    settings.notes += [note] if note else []
    steps_given = {
        setting.key for setting in kept if setting.order // 10 == 10 and not _is_zero(setting.text)
    }
    absent: dict[str, None] = {}
    for setting in kept:
        name = f"${setting.key}"
        if setting.order == _DEVIATION:
            settings.set_planner("junction_deviation", setting.text, setting.place, name)
            continue
        letter = letters[setting.order % 10]
        if _is_zero(setting.text) and setting.order < 110:
            absent.setdefault(letter)
            settings.notes.append(f"{setting.place}: {name}={setting.text}: no axis {letter}")
        if letter in absent or letter not in _LETTERS:
            continue
        quantity = _GRBL[setting.order - setting.order % 10]
        if _is_zero(setting.text):  # the axis exists
            settings.axes.setdefault(letter, AxisSettings())
            settings.notes.append(
                f"{setting.place}: {name}={setting.text}: {_NONE_IS_ZERO} ({quantity})"
            )
            continue
        settings.record(letter, quantity, setting.text, setting.place, name)
    if not steps_given and absent:
        settings.axes.clear()
    return settings


def _is_zero(text: str) -> bool:
    return number_or_nan(text) == 0.0


def _settings_of(line: DumpLine) -> list[DumpSetting]:
    """Return the settings of axes and planner in a line, which may hold several."""
    text = line.text
    if text[:1] in ";(%":
        return []
    if re.match(r"\$\d", text) is None:
        if _SETTING_AMID.search(text.split(";", 1)[0]):
            raise unknown(text, line.place, "$110=5000.000, with nothing before the $")
        return []
    if _QUERY.match(text):
        return []
    settings, position = [], 0
    while (match := _SETTING.match(text, position)) is not None:
        code = int(match[1])
        if code == _DEVIATION or (code - code % 10 in _GRBL and code % 10 < len(_GRBL_AXES)):
            settings.append(DumpSetting(code, match[1], match[2], line.place))
        position = match.end()
        position += len(text[position:]) - len(text[position:].lstrip(" \t,;"))
    if not position or _COMMENT.match(text, position) is None:
        raise unknown(text, line.place, "$110=5000.000")
    return settings


def is_fluidnc(lines: Sequence[str]) -> bool:
    """Return whether lines are a YAML with axes in FluidNC's form."""
    return any(re.match(r"axes\s*:", line, re.IGNORECASE) for line in lines)


def read_fluidnc(lines: Sequence[str], file: str) -> Settings:
    """Return the settings of axes and planner in a YAML of FluidNC; keys ignore case.

    A key that an axis leaves out has FluidNC's default.

    Raises
    ------
    MachineError
        If a line cannot be read, an axis is in another file, or a motor moves several axes.
    """
    settings = Settings("fluidnc", file)
    path: list[tuple[int, str]] = []
    for number, line in enumerate(lines, start=1):
        place = Place(file, number)
        code = line.split("#", 1)[0].rstrip()
        if not code.strip() or _OF_TERMINAL.match(code):
            continue
        indent = len(code) - len(code.lstrip())
        if "\t" in code[:indent]:
            raise MachineError(
                "a tab before a key: YAML allows only blanks", place=place, remedy="Write blanks."
            )
        typed, colon, value = (part.strip() for part in code.strip().partition(":"))
        key = typed.lower()
        if not colon:
            raise unknown(line, place, "steps_per_mm: 80.000")
        while path and path[-1][0] >= indent:
            path.pop()
        parents = [name for _, name in path]
        _refuse_elsewhere(typed, key, value, parents, place)
        path.append((indent, key))
        if parents == ["axes"] and not value and typed.upper() in _LETTERS:
            settings.axes.setdefault(typed.upper(), AxisSettings())
        if len(parents) == 2 and parents[0] == "axes" and key in _FLUIDNC:
            letter = parents[1].upper()
            if letter in _LETTERS:
                name = f"axes.{parents[1]}.{key}"
                settings.record(letter, _FLUIDNC[key], value, place, name)
        elif parents == ["kinematics"] and key != "cartesian":
            settings.refuse_kinematics(f"kinematics: {typed[:40]}", place)
        elif not parents and key == "kinematics" and value.lower() not in ("", "cartesian"):
            settings.refuse_kinematics(f"kinematics: {value[:40]}", place)
        elif not parents and key == "junction_deviation_mm":
            settings.set_planner("junction_deviation", value, place, key)
    for letter, axis in settings.axes.items():
        for quantity, default in _FLUIDNC_TAKES.items():
            if getattr(axis, quantity) is None:
                settings.record(letter, quantity, default, Place(file), "default of fluidnc")
    return settings


def _refuse_elsewhere(typed: str, key: str, value: str, parents: list[str], place: Place) -> None:
    """Refuse includes and inline forms: an axis in them would be lost without a warning."""
    if key == "include" or value.startswith(("!", "&", "*")):
        raise MachineError(
            f"{typed[:40]}: {value[:40]} is not followed",
            place=place,
            remedy="Replace it by its text.",
        )
    table = key == "axes" if not parents else parents == ["axes"] and key.upper() in _LETTERS
    if value and table:
        raise MachineError(
            f"{typed[:40]}: {value[:40]!r}: each setting of an axis needs a separate line",
            place=place,
            remedy="Write them as in FluidNC's documents: steps_per_mm: 80.000 and so on.",
        )
