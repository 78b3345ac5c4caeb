"""Readers of settings files, one for each firmware, which is recognised from the content.

Sources: grbl 1.1 wiki, "Configuring Grbl" ($100 to $135); Marlin, marlinfw.org/docs/gcode M92,
M201, M203, M503; FluidNC wiki, "Axes".
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from threadline.errors import MachineError, Place
from threadline.input_files import read_text
from threadline.machine.firmware.axis_settings import Settings, times, unknown
from threadline.machine.firmware.config_g import LINE as _OF_CONFIG_G
from threadline.machine.firmware.config_g import read_config_g
from threadline.machine.firmware.printer_cfg import read_printer_cfg

_MOST_BYTES = 1_000_000
_LETTERS = "XYZABCUVW"
_GRBL_AXES = "XYZABC"
_GRBL_DEVIATION = 11
_GRBL = {100: "steps", 110: "rate", 120: "acceleration", 130: "travel"}
_GRBL_LINE = re.compile(r"\$(\d{1,3})\s*=\s*([^\s(]*)\s*(?:\(.*)?$")
_GRBL_OTHER = re.compile(r"(?:ok|>|\$\$|\$[A-Za-z]\S*|\[.*\]|<.*>|[Gg]rbl.*|;.*)?$")
_MARLIN_LINE = re.compile(r"(?:echo:)?\s*(?:;.*|M(\d{1,4})((?:\s+[A-Z]-?[0-9.]+)*)\s*(?:;.*)?)?$")
_MARLIN = {92: "steps", 203: "rate", 201: "acceleration"}
_FLUIDNC = {
    "steps_per_mm": "steps", "max_rate_mm_per_min": "rate",
    "acceleration_mm_per_sec2": "acceleration", "max_travel_mm": "travel",
}  # fmt: skip


def read_settings(path: str | Path) -> Settings:
    """Return the settings of axes and motion planner in a settings file.

    Parameters
    ----------
    path
        File with grbl's answer to ``$$``, Marlin's answer to ``M503``, FluidNC's YAML, Klipper's
        ``printer.cfg`` or RepRapFirmware's ``config.g``.

    Raises
    ------
    MachineError
        If it is none of these, has a line that cannot be read, or has no axis.
    """
    path = Path(path)
    text = read_text(path, _MOST_BYTES, MachineError, "settings file")
    lines = text.splitlines()
    for shape, read in _READERS:
        if any(shape.match(line) for line in lines):
            settings = read(lines, str(path))
            if not settings.axes:
                raise MachineError(
                    f"the settings say nothing of any axis ({settings.firmware})",
                    place=Place(str(path)),
                    remedy="Give all of what the firmware lists.",
                )
            return settings
    raise MachineError(
        "these are no settings that are known",
        place=Place(str(path)),
        remedy="Give what grbl answers to $$, Marlin to M503, a FluidNC YAML, a printer.cfg or a "
        "config.g.",
    )


def _grbl(lines: list[str], file: str) -> Settings:
    settings = Settings("grbl", file)
    for number, line in enumerate(lines, start=1):
        match = _GRBL_LINE.match(line.strip())
        if match is None:
            if _GRBL_OTHER.match(line.strip()) is None:
                raise unknown(line, file, number, "$110=5000.000")
            continue
        code = int(match[1])
        if code == _GRBL_DEVIATION:
            settings.say_of_planner("junction_deviation", match[2], number, f"${code}")
        what = _GRBL.get(code - code % 10)
        if what is not None and code % 10 < len(_GRBL_AXES):
            settings.say(_GRBL_AXES[code % 10], what, match[2], number, f"${code}")
    return settings


def _marlin(lines: list[str], file: str) -> Settings:
    settings = Settings("marlin", file)
    for number, line in enumerate(lines, start=1):
        match = _MARLIN_LINE.match(line.strip())
        if re.match(r"\s*(?:echo:)?\s*G20\b", line):
            settings.refuse_inches(number)
        if re.match(r"\s*(?:echo:)?\s*M665\b", line):  # deltas and SCARA arms alone have it
            settings.refuse_kinematics("M665", number)
        shaper = re.match(r"\s*(?:echo:)?\s*M593\b[^;]*\bF([0-9.]+)", line)
        if shaper is not None and shaper[1].strip("0."):
            settings.shapes("M593", number)
        if match is None:
            if line.strip().startswith(("echo:", "Cap:", "ok", "FIRMWARE_NAME", "Unknown", "//")):
                continue
            raise unknown(line, file, number, "echo:  M92 X80.00 Y80.00")
        code = int(match[1] or 0)
        for letter, text in re.findall(r"([A-Z])(-?[0-9.]+)", match[2] or ""):
            name = f"M{code} {letter}"
            if code == 205 and letter == "J":
                settings.say_of_planner("junction_deviation", text, number, name)
            elif code == 205 and letter in _LETTERS and letter != "B":  # B: least segment time
                settings.say_of_planner(f"jump.{letter}", text, number, name)
            elif code == 204 and letter == "T":
                settings.say_of_planner("acceleration", text, number, name)
            if code in _MARLIN and letter in _LETTERS:
                written = times(text, 60.0) if code == 203 else text  # mm/s there
                settings.say(letter, _MARLIN[code], written, number, name, text)
    return settings


def _fluidnc(lines: list[str], file: str) -> Settings:
    settings = Settings("fluidnc", file)
    path: list[tuple[int, str]] = []
    for number, line in enumerate(lines, start=1):
        code = line.split("#", 1)[0].rstrip()
        if not code.strip() or code.strip() == "---":
            continue
        indent = len(code) - len(code.lstrip())
        if "\t" in code[:indent]:
            raise MachineError(
                "a tab before a key: YAML takes blanks alone",
                place=Place(file, number),
                remedy="Write blanks.",
            )
        key, colon, value = code.strip().partition(":")
        if not colon:
            raise unknown(line, file, number, "steps_per_mm: 80.000")
        while path and path[-1][0] >= indent:
            path.pop()
        above = [name for _, name in path]
        _refuse_elsewhere(key.strip(), value.strip(), above, Place(file, number))
        path.append((indent, key.strip()))
        if len(above) == 2 and above[0] == "axes" and key.strip() in _FLUIDNC:
            letter = above[1].upper()
            if letter in _LETTERS:
                name = f"axes.{above[1]}.{key.strip()}"
                settings.say(letter, _FLUIDNC[key.strip()], value.strip(), number, name)
        elif above == ["kinematics"] and key.strip().lower() != "cartesian":
            settings.refuse_kinematics(f"kinematics: {key.strip()[:40]}", number)
        elif not above and key.strip() == "junction_deviation_mm":
            settings.say_of_planner("junction_deviation", value.strip(), number, key.strip())
    return settings


def _refuse_elsewhere(key: str, value: str, above: list[str], place: Place) -> None:
    """Refuse what stands in another file or form: an axis would be lost without a word."""
    if key == "include" or value.startswith(("!", "&", "*")):
        raise MachineError(
            f"{key[:40]}: {value[:40]} is not followed",
            place=place,
            remedy="Put the text that it stands for in its place.",
        )
    table = key == "axes" if not above else above == ["axes"] and key.upper() in _LETTERS
    if value and table:
        raise MachineError(
            f"{key[:40]}: {value[:40]!r}: an axis has its settings on lines of their own",
            place=place,
            remedy="Write them as FluidNC's documents do: steps_per_mm: 80.000 and so on.",
        )


_READERS: tuple[tuple[re.Pattern[str], Callable[[list[str], str], Settings]], ...] = (
    (re.compile(r"\s*\$1[0-3]\d\s*="), _grbl),
    (_OF_CONFIG_G, read_config_g),
    (re.compile(r"\s*(?:echo:)?\s*M92\s"), _marlin),
    (re.compile(r"\[(?:stepper_[a-z]|manual_stepper \w+|printer)\]"), read_printer_cfg),
    (re.compile(r"axes:"), _fluidnc),
)
