"""Settings in Klipper's ``printer.cfg``: its sections, and the steppers of axes beside X, Y and Z.

Sources: Klipper, docs/Config_Reference.md, [stepper], [manual_stepper], [printer] and
[input_shaper]; docs/G-Codes.md, MANUAL_STEPPER; klippy/extras/manual_stepper.py for its defaults.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from threadline.errors import MachineError, Place
from threadline.machine.firmware.axis_settings import Settings, times, unknown

_LETTERS = "XYZABCUVW"
_OF_KINEMATICS = "XYZ"
_PRINTER = {
    "max_velocity": "velocity", "max_accel": "acceleration",
    "square_corner_velocity": "square_corner_velocity",
    "minimum_cruise_ratio": "minimum_cruise_ratio",
}  # fmt: skip
_COMMENT = re.compile(r"#.*|(?:^|(?<=\s));.*")
_TEETH = re.compile(r"(\d+\.?\d*|\.\d+)\s*:\s*(\d+\.?\d*|\.\d+)")
_KEY = re.compile(r"([A-Za-z0-9_]+)\s*[:=]\s*(.*)$")
_WORD = re.compile(r"([A-Z_]+)=([^\s;{}]+)")
_OF_AXIS = {
    "LIMIT_VELOCITY": ("rate", 60.0), "LIMIT_ACCEL": ("acceleration", 1.0),
}  # fmt: skip

_LEAST_STEPS, _MOST_STEPS = 1e-3, 1e7

Keys = dict[str, tuple[str, int]]


@dataclass(slots=True)
class _File:
    """Sections of the file, by name, and its commands that make a stepper an axis of programs."""

    sections: dict[str, Keys] = field(default_factory=dict)
    axes: dict[str, list[tuple[dict[str, str], int]]] = field(default_factory=dict)
    taken: dict[str, tuple[str, int]] = field(default_factory=dict)


def read_printer_cfg(lines: list[str], file: str) -> Settings:
    """Return the settings of axes and motion planner in the lines of a ``printer.cfg``.

    Raises
    ------
    MachineError
        If a line that counts cannot be read, another file is included, or the machine's kinematics
        are others than a motor for each axis.
    """
    settings = Settings("klipper", file)
    read = _sections(lines, file, settings)
    sections = read.sections
    printer = sections.get("printer", {})
    kinematics, at = printer.get("kinematics", ("cartesian", 0))
    if kinematics not in ("cartesian", "none"):
        settings.refuse_kinematics(f"kinematics: {kinematics}", at)
    if "input_shaper" in sections:
        first = min((line for _, line in sections["input_shaper"].values()), default=0)
        settings.shapes("[input_shaper]", first)
    for key, ours in _PRINTER.items():
        if key in printer:
            text, number = printer[key]
            settings.say_of_planner(ours, text, number, f"[printer] {key}")
    for name, keys in sections.items():
        found = re.match(r"stepper_([a-z])$", name)
        if found is not None and found[1].upper() in _LETTERS:
            _of_kinematics(settings, found[1].upper(), keys, name, printer)
        elif name.startswith("manual_stepper "):
            _beside(settings, name, keys, read)
    return settings


def _sections(lines: list[str], file: str, settings: Settings) -> _File:
    read = _File()
    section: Keys | None = None
    for number, whole in enumerate(lines, start=1):
        # What SAVE_CONFIG has added is in force, behind a mark that makes it a comment elsewhere.
        saved = whole.startswith("#*#")
        line = whole.removeprefix("#*#").strip() if saved else whole
        code = _COMMENT.sub("", line).rstrip()
        if not code.strip():
            continue
        header = re.match(r"\[([^\]]+)\]$", code)
        if header is not None:
            if header[1].startswith("include "):
                raise MachineError(
                    f"[{header[1]}] is not followed",
                    place=Place(file, number),
                    remedy="Put the text of that file in its place.",
                )
            section = read.sections.setdefault(" ".join(header[1].split()), {})
            continue
        if saved and (section is None or "=" not in code):
            continue  # its heading
        if section is None:
            raise unknown(line, file, number, "[stepper_x]")
        _note_axis(settings, read, code, number)
        if code[0] in " \t":  # the value of the key before it goes on, as Klipper reads it
            if (last := next(reversed(section), None)) is not None:
                section[last] = f"{section[last][0]} {code.strip()}".strip(), section[last][1]
            continue
        match = _KEY.match(code)
        if match is None:
            raise unknown(line, file, number, "rotation_distance: 40")
        section[match[1].lower()] = match[2].strip(), number
    return read


def _note_axis(settings: Settings, read: _File, code: str, number: int) -> None:
    """Note a command MANUAL_STEPPER, of a macro, that makes a stepper an axis of programs."""
    command = re.search(r"\bMANUAL_STEPPER\b([^;]*)", code.upper())
    letters = None if command is None else re.search(r"\bGCODE_AXIS=(\S*)", command[1])
    if command is None or letters is None:
        return
    words = dict(_WORD.findall(command[1]))
    if not letters[1]:
        settings.unheeded.append(
            f"{Place(settings.file, number)}: GCODE_AXIS= takes the axis away again; programs are "
            "planned for the time while it is one"
        )
    elif len(letters[1]) > 1:
        raise MachineError(
            f"GCODE_AXIS={letters[1][:40]} is no axis: it must be one letter",
            place=Place(settings.file, number),
            remedy="Write it like GCODE_AXIS=A.",
        )
    elif "STEPPER" in words:
        read.axes.setdefault(words["STEPPER"], []).append((words, number))


def _of_kinematics(settings: Settings, axis: str, keys: Keys, section: str, printer: Keys) -> None:
    _steps(settings, axis, keys, section)
    slow = "z_" if axis == "Z" and "max_z_velocity" in printer else ""
    for key, what, factor in (
        (f"max_{slow}velocity", "rate", 60.0),
        (f"max_{slow}accel", "acceleration", 1.0),
    ):
        if key in printer:
            text, number = printer[key]
            settings.say(axis, what, times(text, factor), number, f"[printer] {key}", text)


def _beside(settings: Settings, section: str, keys: Keys, read: _File) -> None:
    """Take a [manual_stepper] as an axis, by the command that makes it one, else by its name.

    Its ``velocity`` is of MANUAL_STEPPER MOVE alone; ``accel`` holds in moves without X, Y and Z.
    """
    name = section.partition(" ")[2].upper()
    line = min((line for _, line in keys.values()), default=0)
    commands = read.axes.get(name, [])
    axis = commands[0][0]["GCODE_AXIS"] if commands else name
    if len(axis) != 1 or axis not in _LETTERS or axis in _OF_KINEMATICS:
        if commands:
            raise MachineError(
                f"MANUAL_STEPPER makes {name.lower()} the axis {axis}; it must be one of "
                f"{', '.join(sorted(set(_LETTERS) - set(_OF_KINEMATICS)))}",
                place=Place(settings.file, commands[0][1]),
                remedy="Give it another letter.",
            )
        example = f"MANUAL_STEPPER STEPPER={name.lower()} GCODE_AXIS=A LIMIT_VELOCITY=..."
        settings.unheeded.append(
            f"{Place(settings.file, line)}: [{section}] is left out: no macro of this file makes "
            f"it an axis of programs, as {example} would"
        )
        return
    if not commands:
        settings.unheeded.append(
            f"{Place(settings.file, line)}: [{section}] is taken for the axis {axis}, which it is "
            f"after MANUAL_STEPPER STEPPER={name.lower()} GCODE_AXIS={axis}"
        )
    own = commands[0][1] if commands else line
    if axis in read.taken:
        other, at = read.taken[axis]
        raise MachineError(
            f"{name.lower()} is the axis {axis} here, and {other} on line {at}",
            place=Place(settings.file, own),
            remedy="Give one of them another letter.",
        )
    read.taken[axis] = name.lower(), own
    _steps(settings, axis, keys, section)
    if "accel" in keys:
        text, number = keys["accel"]
        if text.strip("0. "):  # 0 stands for none
            settings.say_of_planner(f"alone.{axis}", text, number, f"[{section}] accel")
    for words, number in commands:
        if words["GCODE_AXIS"] != axis:
            raise MachineError(
                f"MANUAL_STEPPER makes {name.lower()} the axis {words['GCODE_AXIS']} here and "
                f"{axis} on line {commands[0][1]}",
                place=Place(settings.file, number),
                remedy="Keep one of them.",
            )
        for word, (what, factor) in _OF_AXIS.items():
            if word in words:
                settings.say(axis, what, times(words[word], factor), number, word, words[word])
        jump = words.get("INSTANTANEOUS_CORNER_VELOCITY")
        if jump is not None:
            name_of_it = "INSTANTANEOUS_CORNER_VELOCITY"
            settings.say_of_planner(f"jump.{axis}", jump, number, name_of_it)


def _steps(settings: Settings, axis: str, keys: Keys, section: str) -> None:
    def number(key: str, default: str) -> float:
        text, line = keys.get(key, (default, 0))
        try:
            return float(text)
        except ValueError:
            raise unknown(f"{key}: {text}", settings.file, line, f"{key}: {default}") from None

    if "rotation_distance" in keys and "microsteps" in keys:
        ratio = 1.0
        for part in keys.get("gear_ratio", ("1:1", 0))[0].split(","):
            teeth = _TEETH.fullmatch(part.strip())
            if teeth is None or not (float(teeth[1]) and float(teeth[2])):
                line = keys["gear_ratio"][1]
                raise unknown(f"gear_ratio: {part}", settings.file, line, "gear_ratio: 60:20")
            ratio *= float(teeth[1]) / float(teeth[2])
        typed, line = keys["rotation_distance"]
        distance = settings.number(typed, line, f"[{section}] rotation_distance")
        micro = settings.number(*keys["microsteps"], f"[{section}] microsteps")
        whole = keys.get("full_steps_per_rotation", ("200", 0))
        full = settings.number(*whole, f"[{section}] full_steps_per_rotation")
        if micro != int(micro):
            raise MachineError(
                f"[{section}] microsteps is {keys['microsteps'][0]!r}; it must be a whole number",
                place=Place(settings.file, keys["microsteps"][1]),
                remedy="Write it like microsteps: 16.",
            )
        steps = full * micro * ratio / distance
        if not _LEAST_STEPS <= steps <= _MOST_STEPS:
            raise MachineError(
                f"[{section}] rotation_distance is {typed!r} at microsteps "
                f"{keys['microsteps'][0]} on line {keys['microsteps'][1]}: {steps:g} steps per mm "
                f"or degree; they must be from {_LEAST_STEPS:g} to {_MOST_STEPS:g}",
                place=Place(settings.file, line),
                remedy="Correct the one that is wrong.",
            )
        settings.say(axis, "steps", repr(steps), line, f"[{section}] rotation_distance")
        settings.say(axis, "microsteps", *keys["microsteps"], f"[{section}] microsteps")
    if "position_max" in keys:
        way = number("position_max", "200") - number("position_min", "0")
        settings.say(
            axis, "travel", repr(way), keys["position_max"][1], f"[{section}] position_max"
        )
