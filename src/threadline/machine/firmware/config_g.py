"""Settings in a ``config.g`` of RepRapFirmware: what its M codes say of axes and planner.

Source: docs.duet3d.com, "Gcode dictionary": M92, M201, M203, M204, M208, M350 and M566.
"""

from __future__ import annotations

import re

from threadline.errors import MachineError, Place
from threadline.machine.firmware.axis_settings import Settings

LINE = re.compile(r"\s*M(?:566|584)\s")
"""Of RepRapFirmware alone: an axis' jump of speed, and which drivers it has."""
_LETTERS = "XYZABCUVW"
_READ = {92: "steps", 203: "rate", 201: "acceleration", 350: "microsteps"}
_OTHERS = (204, 208, 566)
_CODE = re.compile(r"\s*M(\d{1,4})(?![\d.])(.*)$")
_COUNTS = re.compile(r"(?<![A-Z\d.])(?:G20|M(?:92|98|20[1348]|350|501|566|593|66[579]))(?![\d.])")
_WORD = re.compile(r"([A-Z])\s*(-?[0-9.]+(?::-?[0-9.]+)*)(?=\s|[A-Z]|$)")


def read_config_g(lines: list[str], file: str) -> Settings:
    """Return the settings of axes and planner in the lines of a ``config.g``.

    Raises
    ------
    MachineError
        If a line of those that count cannot be read, stands under a condition, holds another
        command as well, or comes before the microsteps that its numbers are counted in.
    """
    settings = Settings("reprapfirmware", file)
    ends: dict[str, dict[str, tuple[float, int]]] = {}
    for number, line in enumerate(lines, start=1):
        plain = _plain(line)
        _alone(plain, Place(file, number))
        _heed(settings, plain, line, number)
        match = _CODE.match(plain)
        code = int(match[1]) if match else 0
        if match is None or (code not in _READ and code not in _OTHERS):
            continue
        place = Place(file, number)
        if line[:1] in " \t":
            raise MachineError(
                f"M{code} stands under a condition, which is not known here",
                place=place,
                remedy="Give the lines that hold, without indentation.",
            )
        words = dict(_WORD.findall(match[2]))
        if _WORD.sub("", match[2]).strip():
            raise MachineError(
                f"{line.strip()[:60]!r} is no line of these settings",
                place=place,
                remedy=f"Lines are like M{code} X80 Y80, with numbers alone.",
            )
        if code == 92 and "S" in words:
            raise MachineError(
                f"M92 S{words['S']} counts its steps in other microsteps than are set",
                place=place,
                remedy="Write the steps of the microsteps that M350 sets, without S.",
            )
        for letter, text in words.items():
            name = f"M{code} {letter}"
            if code == 566 and letter == "P":
                settings.say_of_planner("policy", text, number, name)
            elif code == 204 and letter == "T":
                settings.say_of_planner("acceleration", text, number, name)
            elif letter not in _LETTERS:
                continue
            elif code == 566:
                settings.say_of_planner(f"jump.{letter}", _scaled(text), number, name)
            elif code == 208:
                _end(ends, letter, text, words, place)
            elif code in _READ:
                if code == 350 and letter in settings.axes and settings.axes[letter].steps:
                    raise MachineError(
                        f"{name} comes after the steps of {letter}, and changes them",
                        place=place,
                        remedy="Put M350 before M92.",
                    )
                settings.say(letter, _READ[code], text, number, name)
    for letter, found in ends.items():
        if letter in settings.axes and len(found) == 2:
            (low, _), (high, line_of_high) = found["low"], found["high"]
            settings.say(letter, "travel", repr(high - low), line_of_high, f"M208 {letter}")
    return settings


def _alone(plain: str, place: Place) -> None:
    """Refuse a line with a command that counts behind something else: the firmware obeys both."""
    for found in _COUNTS.finditer(plain):
        if plain[: found.start()].strip():
            raise MachineError(
                f"{found[0]} is not alone on its line",
                place=place,
                remedy="Give every command a line of its own, without a number before it.",
            )


def _heed(settings: Settings, plain: str, line: str, number: int) -> None:
    """Refuse what makes the numbers others, and record what else changes the motion."""
    if re.match(r"\s*G20\b", plain):
        settings.refuse_inches(number)
    kinematics = re.match(r"\s*M669\b.*?\bK\s*(\d+)", plain)
    if kinematics is not None and int(kinematics[1]) != 0:
        settings.refuse_kinematics(f"M669 K{kinematics[1]}", number)
    other = re.match(r"\s*(?:M665\b|M667\b.*?\bS\s*0*[1-9])", plain)  # a delta, a core XY
    if other is not None:
        settings.refuse_kinematics(other[0].strip(), number)
    if re.match(r"\s*M593\b", plain) and not re.search(r'P"none"', line, re.IGNORECASE):
        settings.shapes("M593", number)
    runs = re.match(r"\s*(M98|M501)\b", plain)
    if runs is not None:
        settings.unheeded.append(
            f"{Place(settings.file, number)}: the file that {runs[1]} runs is not read; put what "
            "it sets of the axes in its place"
        )


def _plain(line: str) -> str:
    """Return a line without its comments and quoted texts."""
    return re.sub(r'"[^"]*"|\([^)]*\)', " ", line.split(";", 1)[0])


def _scaled(text: str) -> str:
    """Return a speed in mm/s, which is written in mm/min."""
    try:
        return repr(float(text) / 60.0)
    except ValueError:
        return text


def _end(
    ends: dict[str, dict[str, tuple[float, int]]],
    letter: str,
    text: str,
    words: dict[str, str],
    place: Place,
) -> None:
    """Take in an end of an axis: ``X0:600``, or ``X600`` with ``S1`` where it is the lower."""
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) == 2:
        said = {"low": numbers[0], "high": numbers[1]}
    elif len(numbers) == 1:
        said = {"low" if words.get("S") == "1" else "high": numbers[0]}
    else:
        raise MachineError(
            f"M208 {letter} is {text[:40]!r}; it must be a number, or two with a colon between",
            place=place,
            remedy="Write it like M208 X0:600.",
        )
    for end, value in said.items():
        ends.setdefault(letter, {})[end] = (value, place.line)
