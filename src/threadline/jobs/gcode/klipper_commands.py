"""Klipper's commands with a name, and its M204: limits, words without effect, macros.

A name that Klipper does not have is the name of a macro of ``printer.cfg``, whose moves no program
shows. Sources for the commands: Klipper, ``docs/G-Codes.md``, ``klippy/toolhead.py``
(``SET_VELOCITY_LIMIT``, M204) and, for the form of a line, ``klippy/gcode.py``.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

from threadline.errors import JobError, Place
from threadline.jobs.program_limits import LimitChange

_NAMED = re.compile(r" *(?:N *[0-9]+ *)?([A-Z_][A-Z_]+[0-9]*(?:_[A-Z0-9_]*)?)(?![-+.])", re.I)
_M204 = re.compile(r" *(?:N *[0-9]+ *)?M *0*204(?![0-9.])(.*)", re.I)
_LETTERED = re.compile(r"([A-Z]) *([-+0-9.]*)")
_DOES = {
    "SET_INPUT_SHAPER": "changes the input shaper",
    "SET_GCODE_OFFSET": "moves the zero",
    "SAVE_GCODE_STATE": "keeps the zero and the feed for later",
    "RESTORE_GCODE_STATE": "takes back the zero and the feed of before",
    "MANUAL_STEPPER": "moves or renames a motor beside the axes",
    "FORCE_MOVE": "moves a motor beside the axes",
    "SET_KINEMATIC_POSITION": "moves the zero",
    "EXCLUDE_OBJECT": "leaves out the moves of an object",
    "TUNING_TOWER": "changes a setting with the height",
    "SET_SKEW": "changes the path by a skew",
    "SKEW_PROFILE": "changes the path by a skew",
    "SET_DUAL_CARRIAGE": "moves another carriage",
    **dict.fromkeys(("PAUSE", "RESUME", "CANCEL_PRINT"), "stops the program or goes on with it"),
    **dict.fromkeys(("BED_MESH_PROFILE", "BED_MESH_CLEAR"), "changes the mesh that bends the path"),
}
"""Effects on time or motion of klipper's commands with names."""
_IDLE = frozenset(
    {
        "EXCLUDE_OBJECT_DEFINE", "EXCLUDE_OBJECT_START", "EXCLUDE_OBJECT_END",
        "SET_PRESSURE_ADVANCE", "SET_RETRACTION", "SET_FAN_SPEED", "SET_TEMPERATURE_FAN_TARGET",
        "SET_HEATER_TEMPERATURE", "TURN_OFF_HEATERS", "SET_PIN", "SET_SERVO", "SET_LED",
        "SET_LED_TEMPLATE", "SET_FILAMENT_SENSOR", "SET_IDLE_TIMEOUT", "SET_PRINT_STATS_INFO",
        "SET_DISPLAY_TEXT", "RESPOND", "SET_GCODE_VARIABLE", "SAVE_VARIABLE",
        "TIMELAPSE_TAKE_FRAME",
    }
)  # fmt: skip
"""Commands that neither move an axis nor end the look-ahead."""
_LIMITS = {
    "VELOCITY": "velocity_m_s",
    "ACCEL": "acceleration_m_s2",
    "SQUARE_CORNER_VELOCITY": "corner_m_s",
    "MINIMUM_CRUISE_RATIO": "cruise_ratio",
}


class Named(NamedTuple):
    """A command with a name: its text, the limits that it sets, and its name if it moves nothing.

    ``macro`` is the name of a macro that is left out.
    """

    text: str
    limits: LimitChange | None = None
    idle: str = ""
    macro: str = ""


def named_command(text: str, place: Place, *, without_macros: bool = False) -> Named | None:
    """Return Klipper's command of a line if it has a name or is M204; None for other lines.

    ``without_macros`` leaves the moves of macros out.

    Raises
    ------
    JobError
        If the command changes the motion otherwise than by limits, or runs a macro.
    """
    code = text.partition(";")[0].replace("\t", " ").strip()
    m204_match = _M204.fullmatch(code)
    if m204_match is not None:
        return _m204(code, m204_match[1].upper(), place)
    name_match = _NAMED.match(code)
    if name_match is None:
        return None
    name = name_match[1].upper()
    if name == "SET_VELOCITY_LIMIT":
        command = code.partition("#")[0].rstrip()
        return Named(command, _velocity_limit(command[name_match.end() :], place))
    if name in _IDLE:
        return Named(code, idle=name)
    effect = _DOES.get(name)
    if effect is not None:
        raise JobError(
            f"{name} {effect}",
            place=place,
            remedy="Have the program written without it, or take it out if it changes nothing.",
        )
    if without_macros:
        return Named(code, macro=name)
    raise JobError(
        f"{name} runs a macro, whose moves are not in the program",
        place=place,
        remedy="Leave macros out (--axes macros=none): the rest is then planned, without their "
        "moves and time; or write the moves of the macro in its place.",
    )


def _velocity_limit(arguments: str, place: Place) -> LimitChange:
    limits: dict[str, float] = {}
    for argument in arguments.split():
        name, sign, value = argument.upper().partition("=")
        if not sign:
            raise JobError(
                f"klipper cannot read {argument[:40]!r} of SET_VELOCITY_LIMIT",
                place=place,
                remedy="Write it like SET_VELOCITY_LIMIT ACCEL=3000.",
            )
        if name in _LIMITS or name == "ACCEL_TO_DECEL":
            limits[name] = _number(name, value.strip("\"'"), place)
    accel_to_decel = limits.pop("ACCEL_TO_DECEL", None)
    if accel_to_decel is not None and "MINIMUM_CRUISE_RATIO" not in limits:
        if "ACCEL" not in limits:
            raise JobError(
                "ACCEL_TO_DECEL without ACCEL, which klipper's releases read differently",
                place=place,
                remedy="Write MINIMUM_CRUISE_RATIO=... in its place.",
            )
        limits["MINIMUM_CRUISE_RATIO"] = 1.0 - min(1.0, accel_to_decel / limits["ACCEL"])
    limits_si = {
        _LIMITS[name]: value if name == "MINIMUM_CRUISE_RATIO" else value / 1e3
        for name, value in limits.items()
    }
    return LimitChange(**limits_si)


def _m204(code: str, arguments: str, place: Place) -> Named:
    """Return M204: its S, or the lower one of P and T; Klipper ignores M204 without them."""
    given = dict(_LETTERED.findall(arguments))
    letters = ["S"] if "S" in given else ["P", "T"]
    if not all(letter in given for letter in letters):
        return Named(code, idle="M204")
    acceleration_mm_s2 = min(_number(letter, given[letter], place) for letter in letters)
    return Named(code, LimitChange(acceleration_m_s2=acceleration_mm_s2 / 1e3))


def _number(name: str, text: str, place: Place) -> float:
    """Return the value of a limit in Klipper's unit."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    may_be_zero = name in {"SQUARE_CORNER_VELOCITY", "MINIMUM_CRUISE_RATIO"}
    is_allowed = (value >= 0.0 if may_be_zero else value > 0.0) and value < 1e9
    if name == "MINIMUM_CRUISE_RATIO":
        is_allowed = is_allowed and value < 1.0
    if not is_allowed:
        allowed_range = "from 0, and below 1" if name == "MINIMUM_CRUISE_RATIO" else "above 0"
        raise JobError(
            f"{name} {text[:24] or '(nothing)'} must be a number "
            + ("from 0 on" if name == "SQUARE_CORNER_VELOCITY" else allowed_range),
            place=place,
            remedy="Correct it; klipper refuses it, too.",
        )
    return value
