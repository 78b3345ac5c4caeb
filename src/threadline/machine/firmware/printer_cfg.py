"""Reader of Klipper's ``printer.cfg``: sections, and manual steppers as additional axes.

Sources: Klipper, docs/Config_Reference.md, [include], [stepper], [manual_stepper], [printer],
[input_shaper], [bed_mesh], [skew_correction]; docs/Config_Changes.md, 20240313 (meaning of
max_accel_to_decel); docs/G-Codes.md, MANUAL_STEPPER; klippy/extras/manual_stepper.py for its
defaults; klippy/kinematics/corexy.py and similar files, whose limits apply to X, Y and Z.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from threadline.base.reading import read_text
from threadline.errors import MachineError, Place
from threadline.machine.firmware.axis_settings import Settings, times, unknown
from threadline.machine.firmware.dump_lines import files_beside

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

_MOST_BYTES = 1_000_000
_COUPLED = ("corexy", "hybrid_corexy", "corexz", "hybrid_corexz")
_CHANGES_MOTION = {
    "input_shaper": "shapes the motion",
    "bed_mesh": "moves Z by the mesh of the bed, once a mesh is loaded",
    "bed_tilt": "moves Z by the tilt of the bed",
    "z_thermal_adjust": "moves Z by the temperature of the frame",
    "axis_twist_compensation": "moves Z along X",
    "skew_correction": "moves an axis in proportion to another, once a profile is loaded",
    "dual_carriage": "gives an axis a second carriage",
}
_OWN = re.compile(r"\s*\[(?:stepper_[a-z]\d*|manual_stepper \w+|printer|include [^\]]+)\]")
_LOG = re.compile(r"={3,} Config file ={3,}")

_LEAST_STEPS, _MOST_STEPS = 1e-3, 1e7

Keys = dict[str, tuple[str, Place]]


@dataclass(slots=True)
class _File:
    """Sections by name, the commands that turn a stepper into an axis, and the axes in use."""

    sections: dict[str, Keys] = field(default_factory=dict)
    axes: dict[str, list[tuple[dict[str, str], Place]]] = field(default_factory=dict)
    taken: dict[str, tuple[str, Place]] = field(default_factory=dict)


def is_printer_cfg(lines: Sequence[str]) -> bool:
    """Return whether lines hold a section of Klipper with motors or kinematics, or an include."""
    return any(_OWN.match(line) for line in lines)


def read_printer_cfg(lines: Sequence[str], file: str) -> Settings:
    """Return the settings of axes and motion planner in the lines of a ``printer.cfg``.

    Raises
    ------
    MachineError
        If a relevant line cannot be read, or the kinematics have neither one motor per axis nor
        limits that apply to axes.
    """
    settings = Settings("klipper", file)
    read = _sections(_last_logged(lines), file, settings)
    sections = read.sections
    file_place = Place(file)
    printer = sections.get("printer", {})
    kinematics, place_of_kinematics = printer.get("kinematics", ("cartesian", file_place))
    if kinematics in _COUPLED:
        settings.coupled = f"kinematics: {kinematics}"
        settings.notes.append(
            f"{place_of_kinematics}: {settings.coupled}: its limits apply to X, Y and Z"
        )
    elif kinematics not in ("cartesian", "none"):
        settings.refuse_kinematics(f"kinematics: {kinematics}", place_of_kinematics)
    noted: set[str] = set()
    for name, keys in sections.items():
        kind = name.split()[0]
        effect = None if kind in noted else _CHANGES_MOTION.get(kind)
        if effect is not None and (kind != "input_shaper" or _shapes(keys)):
            noted.add(kind)
            first = min(
                (place for _, place in keys.values()), key=lambda p: p.line, default=file_place
            )
            settings.leave_out(f"[{name}]", effect, first)
    for key, planner_key in _PRINTER.items():
        if key in printer:
            text, place = printer[key]
            settings.set_planner(planner_key, text, place, f"[printer] {key}")
    _braking(settings, printer)
    for name, keys in sections.items():
        match = re.match(r"stepper_([a-z])$", name)
        if match is not None and match[1].upper() in _LETTERS:
            _from_kinematics(settings, match[1].upper(), keys, name, printer)
        elif name.startswith("manual_stepper "):
            _from_manual_stepper(settings, name, keys, read)
    return settings


def _shapes(keys: Keys) -> bool:
    """Return whether an axis has a shaper frequency; 0 switches the shaper off."""
    return any(
        key.startswith("shaper_freq") and text.strip("0. ") for key, (text, _) in keys.items()
    )


def _braking(settings: Settings, printer: Keys) -> None:
    """Set the minimum cruise ratio from ``max_accel_to_decel``, its form until 2024."""
    if "max_accel_to_decel" not in printer or "minimum_cruise_ratio" in printer:
        return
    text, place = printer["max_accel_to_decel"]
    name = "[printer] max_accel_to_decel"
    decel = settings.number(text, place, name)
    max_accel = settings.planner.get("acceleration")
    if max_accel is None:
        return  # without max_accel the file is incomplete
    ratio = 1.0 - min(1.0, decel / max_accel.value)
    settings.set_planner("minimum_cruise_ratio", repr(ratio), place, name, typed=text)
    settings.notes.append(
        f"{place}: max_accel_to_decel is deprecated; used minimum_cruise_ratio = 1 - "
        f"max_accel_to_decel / max_accel = {ratio:g}"
    )


def _last_logged(lines: Sequence[str]) -> Sequence[str]:
    """Return the lines of the last configuration in a ``klippy.log``; all lines of other files."""
    begins = [row for row, line in enumerate(lines) if _LOG.match(line)]
    if not begins:
        return lines
    log_lines = list(lines)
    end = next(
        (row for row in range(begins[-1] + 1, len(lines)) if re.match(r"={10}", lines[row])), 0
    )
    log_lines[: begins[-1] + 1] = [""] * (begins[-1] + 1)  # lines keep their numbers
    return log_lines[:end] if end else log_lines


def _sections(lines: Sequence[str], file: str, settings: Settings) -> _File:
    read = _File()
    _take_lines(lines, file, settings, read, (Path(file).resolve(),))
    return read


def _take_lines(
    lines: Sequence[str], file: str, settings: Settings, read: _File, open_files: tuple[Path, ...]
) -> None:
    section: Keys | None = None
    key, margin = "", 0  # the key of the line before, and the blanks before it
    for number, raw_line in enumerate(lines, start=1):
        place = Place(file, number)
        # Lines that SAVE_CONFIG added are valid; elsewhere their mark would make them comments.
        saved = raw_line.startswith("#*#")
        line = raw_line.removeprefix("#*#").strip() if saved else raw_line
        code = _COMMENT.sub("", line).rstrip()
        if not code.strip():
            continue
        blanks = len(code) - len(code.lstrip())
        within_value = bool(key) and blanks > margin  # Klipper appends it to the value
        margin = margin if within_value else blanks
        header = None if within_value else re.match(r"\s*\[([^\]]+)\]$", code)
        if header is not None:
            key, name = "", " ".join(header[1].split())
            if name.startswith("include "):
                for path in _included(name.removeprefix("include "), place, settings, open_files):
                    text = read_text(path, _MOST_BYTES, MachineError, "file of settings")
                    _take_lines(text.splitlines(), str(path), settings, read, (*open_files, path))
                section = None
                continue
            section = read.sections.setdefault(name, {})
            continue
        if saved and (section is None or "=" not in code):
            continue  # heading of the SAVE_CONFIG block
        if section is None:
            raise unknown(line, place, "[stepper_x]")
        _note_axis(settings, read, code, place)
        if re.search(r"\bSET_VELOCITY_LIMIT\b", code, re.IGNORECASE):
            settings.notes.append(f"{place}: SET_VELOCITY_LIMIT of a macro is not followed")
        if within_value:
            section[key] = f"{section[key][0]} {code.strip()}".strip(), section[key][1]
            continue
        match = _KEY.match(code.strip())
        if match is None:
            raise unknown(line, place, "rotation_distance: 40")
        key = match[1].lower()
        section[key] = match[2].strip(), place


def _included(
    pattern: str, place: Place, settings: Settings, open_files: tuple[Path, ...]
) -> Iterator[Path]:
    """Yield the files of ``[include pattern]`` in this folder or below; note a missing file."""
    paths = files_beside(pattern, open_files[-1].parent)
    if not paths:
        settings.notes.append(
            f"{place}: [include {pattern}] is not read: no such file beside this one"
        )
    for path in paths:
        if path in open_files:
            raise MachineError(
                f"[include {pattern}] includes its own file",
                place=place,
                remedy="Remove it; Klipper refuses it, too.",
            )
        yield path


def _note_axis(settings: Settings, read: _File, code: str, place: Place) -> None:
    """Record a macro's MANUAL_STEPPER command that turns a stepper into an axis of programs."""
    command = re.search(r"\bMANUAL_STEPPER\b([^;]*)", code.upper())
    letters = None if command is None else re.search(r"\bGCODE_AXIS=(\S*)", command[1])
    if command is None or letters is None:
        return
    words = dict(_WORD.findall(command[1]))
    if not letters[1]:
        settings.ignored.append(
            f"{place}: GCODE_AXIS= removes the axis again; programs are planned for the time before"
        )
    elif len(letters[1]) > 1:
        raise MachineError(
            f"GCODE_AXIS={letters[1][:40]} is not an axis: it must be one letter",
            place=place,
            remedy="Write it like GCODE_AXIS=A.",
        )
    elif "STEPPER" in words:
        read.axes.setdefault(words["STEPPER"], []).append((words, place))


def _from_kinematics(
    settings: Settings, axis: str, keys: Keys, section: str, printer: Keys
) -> None:
    _steps(settings, axis, keys, section)
    prefix = "z_" if axis == "Z" and "max_z_velocity" in printer else ""
    for key, quantity, factor in (
        (f"max_{prefix}velocity", "rate", 60.0),
        (f"max_{prefix}accel", "acceleration", 1.0),
    ):
        if key in printer:
            text, place = printer[key]
            settings.record(axis, quantity, times(text, factor), place, f"[printer] {key}", text)


def _from_manual_stepper(settings: Settings, section: str, keys: Keys, read: _File) -> None:
    """Read a [manual_stepper] as an axis, named by its MANUAL_STEPPER command, else by its name.

    Its ``velocity`` applies only to MANUAL_STEPPER MOVE; ``accel`` applies to moves without X, Y
    and Z.
    """
    name = section.partition(" ")[2].upper()
    line = min(
        (other_place for _, other_place in keys.values()),
        key=lambda other_place: other_place.line,
        default=Place(settings.file),
    )
    commands = read.axes.get(name, [])
    axis = commands[0][0]["GCODE_AXIS"] if commands else name
    if len(axis) != 1 or axis not in _LETTERS or axis in _OF_KINEMATICS:
        if commands:
            raise MachineError(
                f"MANUAL_STEPPER makes {name.lower()} the axis {axis}; it must be one of "
                f"{', '.join(sorted(set(_LETTERS) - set(_OF_KINEMATICS)))}",
                place=commands[0][1],
                remedy="Give it another letter.",
            )
        example = f"MANUAL_STEPPER STEPPER={name.lower()} GCODE_AXIS=A LIMIT_VELOCITY=..."
        settings.ignored.append(
            f"{line}: [{section}] is omitted: no macro of this file makes "
            f"it an axis of programs, as {example} would"
        )
        return
    if not commands:
        settings.ignored.append(
            f"{line}: [{section}] is read as the axis {axis}, assuming "
            f"MANUAL_STEPPER STEPPER={name.lower()} GCODE_AXIS={axis}"
        )
    place = commands[0][1] if commands else line
    if axis in read.taken:
        other_stepper, other_place = read.taken[axis]
        raise MachineError(
            f"{name.lower()} is the axis {axis} here, and {other_stepper} on line "
            f"{other_place.line}",
            place=place,
            remedy="Give one of them another letter.",
        )
    read.taken[axis] = name.lower(), place
    _steps(settings, axis, keys, section)
    if "accel" in keys:
        text, number = keys["accel"]
        if text.strip("0. "):  # 0 means none
            settings.set_planner(f"alone.{axis}", text, number, f"[{section}] accel")
    for words, number in commands:
        if words["GCODE_AXIS"] != axis:
            raise MachineError(
                f"MANUAL_STEPPER makes {name.lower()} the axis {words['GCODE_AXIS']} here and "
                f"{axis} on line {commands[0][1].line}",
                place=number,
                remedy="Keep one of them.",
            )
        for word, (quantity, factor) in _OF_AXIS.items():
            if word in words:
                settings.record(
                    axis, quantity, times(words[word], factor), number, word, words[word]
                )
        jump = words.get("INSTANTANEOUS_CORNER_VELOCITY")
        if jump is not None:
            name_of_it = "INSTANTANEOUS_CORNER_VELOCITY"
            settings.set_planner(f"jump.{axis}", jump, number, name_of_it)


def _steps(settings: Settings, axis: str, keys: Keys, section: str) -> None:
    def number(key: str, default: str) -> float:
        text, line = keys.get(key, (default, Place(settings.file)))
        try:
            return float(text)
        except ValueError:
            raise unknown(f"{key}: {text}", line, f"{key}: {default}") from None

    if "rotation_distance" in keys and "microsteps" in keys:
        ratio = 1.0
        for part in keys.get("gear_ratio", ("1:1", None))[0].split(","):
            teeth = _TEETH.fullmatch(part.strip())
            if teeth is None or not (float(teeth[1]) and float(teeth[2])):
                line = keys["gear_ratio"][1]
                raise unknown(f"gear_ratio: {part}", line, "gear_ratio: 60:20")
            ratio *= float(teeth[1]) / float(teeth[2])
        typed, line = keys["rotation_distance"]
        distance = settings.number(typed, line, f"[{section}] rotation_distance")
        micro = settings.number(*keys["microsteps"], f"[{section}] microsteps")
        full_steps_text = keys.get("full_steps_per_rotation", ("200", Place(settings.file)))
        full_steps = settings.number(*full_steps_text, f"[{section}] full_steps_per_rotation")
        if micro != int(micro):
            raise MachineError(
                f"[{section}] microsteps is {keys['microsteps'][0]!r}; it must be a whole number",
                place=keys["microsteps"][1],
                remedy="Write it like microsteps: 16.",
            )
        steps = full_steps * micro * ratio / distance
        if not _LEAST_STEPS <= steps <= _MOST_STEPS:
            raise MachineError(
                f"[{section}] rotation_distance is {typed!r} at microsteps "
                f"{keys['microsteps'][0]} on line {keys['microsteps'][1].line}: {steps:g} steps "
                f"per mm or degree; they must be from {_LEAST_STEPS:g} to {_MOST_STEPS:g}",
                place=line,
                remedy="Correct the wrong one.",
            )
        settings.record(axis, "steps", repr(steps), line, f"[{section}] rotation_distance", typed)
        settings.record(axis, "microsteps", *keys["microsteps"], f"[{section}] microsteps")
    elif "step_distance" in keys:  # until 2020
        typed, line = keys["step_distance"]
        steps = 1.0 / settings.number(typed, line, f"[{section}] step_distance")
        settings.record(axis, "steps", repr(steps), line, f"[{section}] step_distance", typed)
    if "position_max" in keys:
        travel = number("position_max", "200") - number("position_min", "0")
        settings.record(
            axis, "travel", repr(travel), keys["position_max"][1], f"[{section}] position_max"
        )
