"""Reader of LinuxCNC's INI: limits of axes and joints, and the initial path mode.

Source: linuxcnc.org/docs, "INI Configuration": [KINS], [TRAJ], [AXIS_<letter>], [JOINT_<number>],
[RS274NGC] RS274NGC_STARTUP_CODE, [HAL] HALFILE; in version 2.7 and before, [AXIS_<number>] has the
meaning of today's [JOINT_<number>]; "G Codes", G61 and G64.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from threadline.base.reading import read_text
from threadline.errors import MachineError, Place
from threadline.machine.firmware.axis_settings import (
    AxisSettings,
    Settings,
    number_or_nan,
    times,
    unknown,
)
from threadline.machine.firmware.dump_lines import files_beside

_LETTERS = "XYZABCUVW"
_TURNING = "ABC"
_OWN = re.compile(
    r"\s*\[(?:EMC|EMCMOT|KINS|TRAJ|JOINT_\d+|AXIS_\w+)\]\s*(?:[;#].*)?$", re.IGNORECASE
)
_SECTION = re.compile(r"\[([A-Za-z0-9_]+)\]")  # LinuxCNC also ignores text after the bracket
_INCHES = ("in", "inch", "imperial")
_MILLIMETRES = ("mm", "metric")
_ANGLES = {"degree": 1.0, "deg": 1.0, "radian": 57.29577951308232, "rad": 57.29577951308232,
           "gradian": 0.9, "grad": 0.9}  # fmt: skip
_LIMITS = {
    "MAX_VELOCITY": ("rate", 60.0), "MAX_ACCELERATION": ("acceleration", 1.0),
}  # fmt: skip
_SCALES = ("STEP_SCALE", "SCALE", "ENCODER_SCALE", "INPUT_SCALE")
"""Keys of steps or counts per unit. OUTPUT_SCALE is not one: it scales the amplifier's input."""
_READ = frozenset(
    (*_LIMITS, *_SCALES, "MIN_LIMIT", "MAX_LIMIT", "COORDINATES", "KINEMATICS", "LINEAR_UNITS")
)
_MOST_BYTES = 1_000_000
_ENDLESS = 1e9  # INI files write this for "no limit"

Keys = dict[str, tuple[str, Place]]


def is_linuxcnc(lines: Sequence[str]) -> bool:
    """Return whether lines are a LinuxCNC INI: two of its sections, or any one and an #INCLUDE."""
    section_count = sum(_OWN.match(line) is not None for line in lines)
    if section_count > 1:
        return True
    included = any(line.strip().upper().startswith("#INCLUDE") for line in lines)
    return included and any(_SECTION.match(line.strip()) is not None for line in lines)


def read_linuxcnc(lines: Sequence[str], file: str) -> Settings:
    """Return the settings of axes and path mode in the lines of an INI.

    Raises
    ------
    MachineError
        If a line cannot be read, or a joint moves more than one axis.
    """
    settings = Settings("linuxcnc", file)
    sections = _sections(lines, file, settings.notes)
    file_place = Place(file)
    traj, kins = sections.get("TRAJ", {}), sections.get("KINS", {})
    _check_kinematics(settings, kins)
    length, angle = _units(traj)
    letters = _letters(kins, traj, file_place)
    joints = "JOINT" if any(name.startswith("JOINT_") for name in sections) else "AXIS"
    for index, letter in enumerate(letters):
        if letter in letters[:index]:
            continue  # a second motor of the axis
        joint = sections.get(f"{joints}_{index}", {})
        axis = sections.get(f"AXIS_{letter}", {}) if joints == "JOINT" else {}
        turns = _turns(letter, joint, axis)
        settings.turning[letter] = turns
        settings.axes[letter] = AxisSettings()
        factor = angle if turns else length
        _set_axis(settings, letter, axis, joint, factor)
    _path_limits(settings, traj, length)
    _path_mode(settings, sections.get("RS274NGC", {}), length)
    for key, (text, place) in sections.get("HAL", {}).items():
        if key.startswith("HALFILE"):
            settings.notes.append(f"{place}: the HAL file {text} is not read")
    return settings


def _sections(lines: Sequence[str], file: str, notes: list[str]) -> dict[str, Keys]:
    """Return the sections by name, in capitals; repeated keys get an apostrophe each time.

    A line without ``=`` is noted in ``notes``, because LinuxCNC ignores it. If such a line begins
    with a key that this module reads, it is refused.
    """
    sections: dict[str, Keys] = {}
    section: Keys | None = None
    for place, code in _joined_lines(lines, (Path(file).resolve(),)):
        header = _SECTION.match(re.sub(r"\s*[;#].*", "", code))
        if header is not None:
            section = sections.setdefault(header[1].upper(), {})
            continue
        key, equals, value = (part.strip() for part in code.partition("="))
        if not equals:
            if code.split()[0].upper() in _READ:
                raise unknown(code, place, "MAX_VELOCITY = 100.0")
            notes.append(f"{place}: {code[:40]!r} has no = and is passed over, as by LinuxCNC")
            continue
        if section is None:
            raise unknown(code, place, "[TRAJ], with its keys behind it")
        key = key.upper()
        while key in section:
            key += "'"
        section[key] = re.sub(r"\s+[;#].*", "", value), place
    return sections


def _joined_lines(
    lines: Sequence[str], open_files: tuple[Path, ...]
) -> Iterator[tuple[Place, str]]:
    """Yield the lines with their places, with continued lines joined and includes replaced."""
    joined_code, first_place = "", Place(str(open_files[-1]))
    for number, line in enumerate(lines, start=1):
        place = Place(str(open_files[-1]), number)
        code = line.strip()
        if code.upper().startswith("#INCLUDE"):
            yield from _included(code[len("#INCLUDE") :].strip(), place, open_files)
            continue
        if not joined_code and (not code or code[0] in ";#"):
            continue
        first_place = first_place if joined_code else place
        joined_code += code
        if joined_code.endswith("\\"):
            joined_code = joined_code.removesuffix("\\").rstrip() + " "
            continue
        yield first_place, joined_code
        joined_code = ""
    if joined_code:
        yield first_place, joined_code


def _included(name: str, place: Place, open_files: tuple[Path, ...]) -> Iterator[tuple[Place, str]]:
    """Yield the lines of an included file in the same folder or below."""
    paths = files_beside(name, open_files[-1].parent)
    if len(paths) != 1 or paths[0] in open_files:
        raise MachineError(
            f"#INCLUDE {name[:60]}: no such file beside this one, or it includes itself",
            place=place,
            remedy="Put the file there, or replace this line by its text.",
        )
    text = read_text(paths[0], _MOST_BYTES, MachineError, "INI")
    yield from _joined_lines(text.splitlines(), (*open_files, paths[0]))


def _check_kinematics(settings: Settings, kins: Keys) -> None:
    text, place = kins.get("KINEMATICS", ("trivkins", Place(settings.file)))
    if text.split()[:1] not in ([], ["trivkins"]):
        settings.refuse_kinematics(f"KINEMATICS = {text[:40]}", place)


def _letters(kins: Keys, traj: Keys, file_place: Place) -> str:
    """Return the axis letter of each joint, in the order of the joints."""
    match = re.search(r"coordinates\s*=\s*([A-Za-z]+)", kins.get("KINEMATICS", ("", file_place))[0])
    text = match[1] if match is not None else traj.get("COORDINATES", ("XYZ", file_place))[0]
    place = traj.get("COORDINATES", kins.get("KINEMATICS", ("", file_place)))[1]
    letters = "".join(text.split()).upper()
    wrong = [letter for letter in letters if letter not in _LETTERS]
    if wrong or not letters:
        raise MachineError(
            f"COORDINATES is {text[:40]!r}; it must be letters of {', '.join(_LETTERS)}",
            place=place,
            remedy="Write it like COORDINATES = XYZA.",
        )
    return letters


def _units(traj: Keys) -> tuple[float, float]:
    """Return mm per unit of length and degrees per unit of angle."""
    text, place = traj.get("LINEAR_UNITS", ("mm", Place("")))
    word = text.lower()
    if word not in _INCHES + _MILLIMETRES and number_or_nan(text) != 1.0:
        raise MachineError(
            f"LINEAR_UNITS is {text[:40]!r}; it must be mm or inch",
            place=place,
            remedy="Write it like LINEAR_UNITS = mm.",
        )
    angle_unit, angle_place = traj.get("ANGULAR_UNITS", ("degree", Place("")))
    if angle_unit.lower() not in _ANGLES and number_or_nan(angle_unit) != 1.0:
        raise MachineError(
            f"ANGULAR_UNITS is {angle_unit[:40]!r}; it must be degree, radian or gradian",
            place=angle_place,
            remedy="Write it like ANGULAR_UNITS = degree.",
        )
    return (25.4 if word in _INCHES else 1.0), _ANGLES.get(angle_unit.lower(), 1.0)


def _turns(letter: str, *sections: Keys) -> bool:
    for keys in sections:
        if "TYPE" in keys:
            return keys["TYPE"][0].upper() == "ANGULAR"
    return letter in _TURNING


def _set_axis(settings: Settings, letter: str, axis: Keys, joint: Keys, factor: float) -> None:
    """Set the limits of an axis: the smaller of its [AXIS_] and [JOINT_] limits."""
    for key, (quantity, a_minute) in _LIMITS.items():
        limits_given = [(keys[key], keys is joint) for keys in (axis, joint) if key in keys]
        if not limits_given:
            continue
        (text, place), of_joint = min(
            limits_given, key=lambda limit: _number_or_negative(limit[0][0])
        )
        name = f"[{'JOINT' if of_joint and axis else 'AXIS'}] {letter} {key}"
        settings.record(letter, quantity, times(text, a_minute * factor), place, name, text)
    for key in _SCALES:
        if key in joint:
            text, place = joint[key]
            size = repr(abs(number_or_nan(text)) / factor)
            settings.record(letter, "steps", size, place, f"{letter} {key}", text.removeprefix("-"))
            break
    low, high = (_first_of(key, axis, joint) for key in ("MIN_LIMIT", "MAX_LIMIT"))
    if low is not None and high is not None and not settings.turning[letter]:
        travel = number_or_nan(high[0]) - number_or_nan(low[0])
        if not travel >= _ENDLESS:
            name = f"{letter} MIN_LIMIT {low[0]} MAX_LIMIT"
            settings.record(letter, "travel", repr(travel * factor), high[1], name)
    for keys in (axis, joint):
        if keys.get("WRAPPED_ROTARY", ("0", None))[0] not in ("", "0"):
            settings.axes[letter].wrapped = settings.turning[letter]
    backlash = joint.get("BACKLASH")
    if backlash is not None and number_or_nan(backlash[0]) != 0.0:
        settings.leave_out(
            f"BACKLASH = {backlash[0][:20]}", "adds a motion of the motor at reversals", backlash[1]
        )


def _number_or_negative(text: str) -> float:
    number = number_or_nan(text)
    return -1.0 if math.isnan(number) else number  # ``record`` refuses other texts


def _first_of(key: str, *sections: Keys) -> tuple[str, Place] | None:
    return next((keys[key] for keys in sections if key in keys), None)


def _path_limits(settings: Settings, traj: Mapping[str, tuple[str, Place]], length: float) -> None:
    """Apply the limit of path speed to axes with a higher limit."""
    path_limit = traj.get("MAX_LINEAR_VELOCITY", traj.get("MAX_VELOCITY"))
    if path_limit is None:
        return
    path_rate = number_or_nan(path_limit[0]) * length * 60.0
    slower = [
        axis
        for axis, axis_settings in settings.axes.items()
        if not settings.turning[axis]
        and axis_settings.rate is not None
        and path_rate < axis_settings.rate.value
    ]
    for axis in slower:
        settings.axes[axis].rate = None
        settings.record(
            axis,
            "rate",
            repr(path_rate),
            path_limit[1],
            "[TRAJ] MAX_LINEAR_VELOCITY",
            path_limit[0],
        )
    if slower:
        settings.notes.append(
            f"{path_limit[1]}: [TRAJ] limits the speed of the path to less than "
            f"{', '.join(slower)} may "
            "do alone, so it is the limit of each of them"
        )


def _path_mode(settings: Settings, interpreter: Keys, length: float) -> None:
    """Set the path mode from RS274NGC_STARTUP_CODE; LinuxCNC starts in G64 without P."""
    text, place = interpreter.get("RS274NGC_STARTUP_CODE", ("", Place(settings.file)))
    code = text.upper()
    factor = 25.4 if re.search(r"\bG20\b", code) else 1.0 if "G21" in code else length
    if re.search(r"\bG61(?:\.1)?\b", code):
        settings.set_planner("exact_stop", "1", place, "G61")
        return
    blend = re.search(r"\bG64\s*(?:P\s*([\d.]+))?\s*(?:Q\s*([\d.]+))?", code)
    if blend is None:
        settings.notes.append(
            "assumed G64 without P (no tolerance): no RS274NGC_STARTUP_CODE of the INI sets a path "
            "mode"
        )
        return
    for key, number, letter in (("tolerance", blend[1], "P"), ("cam_tolerance", blend[2], "Q")):
        if number is not None:
            name = f"G64 {letter}"
            settings.set_planner(key, times(number, factor), place, name, typed=number)
