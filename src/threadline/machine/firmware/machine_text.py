"""Write a machine file from firmware settings, and name the numbers that the owner must add."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from threadline.base.wording import plain
from threadline.errors import MachineError, OptionError, Place, UnitError
from threadline.machine.firmware.axis_settings import AxisSettings, Settings, SettingValue
from threadline.units import parse_quantity

QUESTIONS: dict[str, tuple[str, str]] = {
    "rotary": ("the letters of the axes that turn, or none", "A"),
    "microsteps": ("of the drivers", "16"),
    "torque": ("holding torque of the motors", "1.26 N m"),
    "current": ("per phase, set in the drivers", "2.8 A"),
    "resistance": ("of a phase", "0.9 ohm"),
    "inductance": ("of a phase", "2.5 mH"),
    "supply": ("of the drivers", "36 V"),
    "mass": ("that a linear axis moves", "1.2 kg"),
    "inertia": ("that a rotary axis turns", "4e-3 kg m^2"),
    "radius": ("at which a rotary axis acts: of the mandrel or workpiece", "50 mm"),
}
"""Name of each question, its meaning, and an example of an answer."""
OPTIONAL: dict[str, tuple[str, str]] = {
    "steps": ("per mm, where the settings have none", "80 count/mm"),
    "travel": ("from end to end, where the settings have none", "600 mm"),
    "rate": ("greatest speed a minute, where the settings have none", "6000 mm/min"),
    "acceleration": ("where the settings have none", "500 mm/s^2"),
    "rotor": ("inertia of a motor's rotor and pulley", "3.2e-5 kg m^2"),
    "friction": ("of a motor and its bearings", "0.03 N m"),
}
_NONE = ("", "0", "-", "no", "none")
_OF_AN_AXIS = frozenset(QUESTIONS) - {"rotary"} | frozenset(OPTIONAL)


@dataclass(frozen=True, slots=True)
class Answers:
    """The owner's answers, by name, or by name and axis (``mass.X``)."""

    texts: dict[str, str]

    @property
    def rotary(self) -> str:
        """Letters of the rotary axes; empty if there are none."""
        answer = self.texts.get("rotary", "")
        if answer.lower() in _NONE:
            return ""
        return "".join(c for c in answer.upper() if c.isalpha())

    def of(self, name: str, axis: str) -> str | None:
        """Return the answer for an axis, else the answer for all axes, else None."""
        return self.texts.get(f"{name}.{axis}", self.texts.get(name))


def parse_answers(texts: Sequence[str]) -> Answers:
    """Return the answers written like ``"mass=1.2 kg"`` or ``"mass.X=1.2 kg"``.

    Raises
    ------
    OptionError
        If an answer has another form or an unknown name, or is given twice.
    """
    texts_by_name: dict[str, str] = {}
    known = {**QUESTIONS, **OPTIONAL}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        base, dot, axis = name.partition(".")
        is_empty = not value and base != "rotary"
        if not equals or is_empty or base not in known or (dot and base not in _OF_AN_AXIS):
            similar = difflib.get_close_matches(base, known, n=1)
            hint = f"Did you mean {similar[0]}? " if similar and similar[0] != base else ""
            raise OptionError(
                f"--set {text[:60]!r} does not answer any question",
                remedy=f'{hint}Write it like --set "mass=1.2 kg"; names: {", ".join(known)}.',
            )
        key = f"{base}.{axis.upper()}" if dot else base
        if key in texts_by_name:
            raise OptionError(f"--set {key} is given twice", remedy="Keep one of them.")
        texts_by_name[key] = value
    return Answers(texts_by_name)


_FULL_STEPS = 200
_PLANNERS = {
    "grbl": "grbl", "fluidnc": "grbl", "marlin": "marlin", "klipper": "klipper",
    "reprapfirmware": "reprapfirmware", "linuxcnc": "linuxcnc",
}  # fmt: skip
_BY_JUMPS = ("marlin", "klipper", "reprapfirmware")
_PLANNER_KEYS = {
    "grbl": {"junction_deviation": "mm"},
    "marlin": {
        "junction_deviation": "mm", "acceleration": "mm/s^2", "least_speed": "mm/s",
        "short_time": "ms",
    },
    "klipper": {
        "velocity": "mm/s", "acceleration": "mm/s^2", "square_corner_velocity": "mm/s",
        "minimum_cruise_ratio": "",
    },
    "reprapfirmware": {"policy": "", "acceleration": "mm/s^2", "blocks": ""},
    "linuxcnc": {"tolerance": "mm", "cam_tolerance": "mm"},
}  # fmt: skip
"""Unit of each key of [planner]."""
_SWITCHES = ("exact_stop", "corner_axes")
_KLIPPER_WORDS = {"velocity": "max_velocity", "acceleration": "max_accel"}
DEFAULTS = {"rotor": "3.2e-5 kg m^2", "friction": "0.03 N m"}
_UNITS = {
    "torque": "N*m", "current": "A", "resistance": "ohm", "inductance": "H", "supply": "V",
    "mass": "kg", "inertia": "kg*m^2", "radius": "m", "rotor": "kg*m^2", "friction": "N*m",
    "microsteps": "",
}  # fmt: skip
_MAY_TURN = "ABC"
_TURNS = {
    "steps": ("per degree, where the settings have none", "26.667 count/deg"),
    "rate": ("greatest speed a minute, where the settings have none", "36000 deg/min"),
    "acceleration": ("where the settings have none", "2000 deg/s^2"),
}
_OF_DYNAMICS = ("torque", "current", "resistance", "inductance", "supply", "mass", "inertia",
                "rotor", "friction", "microsteps")  # fmt: skip
_LINEAR_UNITS = {"travel": "m", "rate": "m/s", "acceleration": "m/s^2", "steps": "count/m"}
_ROTARY_UNITS = {"travel": "rad", "rate": "rad/s", "acceleration": "rad/s^2", "steps": "count/rad"}


@dataclass(frozen=True, slots=True)
class Missing:
    """A number that neither the settings nor the owner have given.

    Parameters
    ----------
    key
        Its name in ``--set``: ``mass``, ``travel.X``.
    what
        Its meaning.
    example
        A valid value.
    """

    key: str
    what: str
    example: str


def missing_answers(settings: Settings, answers: Answers, *, limits_only: bool) -> list[Missing]:
    """Return the missing numbers, each once, in the order of the questions."""
    missing = dict.fromkeys(_missing(settings, answers, limits_only))
    return [Missing(key, what, example) for key, (what, example) in missing]


def _answer_forms(missing: Sequence[Missing]) -> Iterator[str]:
    """Yield the missing answers with examples; linear axes that lack the same share one answer."""
    for number in missing:
        base, _, axis = number.key.partition(".")
        same_example = [
            m for m in missing if m.key.startswith(f"{base}.") and m.example == number.example
        ]
        if axis and len(same_example) > 1 and number.example == OPTIONAL[base][1]:
            if number is same_example[0]:
                note = f"{base}.{axis} is for {axis} alone"
                yield f'--set "{base}={number.example}" ({number.what}; {note})'
        else:
            yield f'--set "{number.key}={number.example}" ({number.what})'


def turning_axes(settings: Settings, answers: Answers) -> str:
    """Return the letters of the rotary axes, from the owner if given, else from the settings."""
    if "rotary" in answers.texts:
        return answers.rotary
    return "".join(axis for axis in settings.axes if settings.turning.get(axis, False))


def machine_text(
    settings: Settings, answers: Answers, name: str, *, limits_only: bool = False
) -> str:
    """Return the machine file for axes with steppers, from firmware settings and answers.

    Every axis is rigid: its load is added to the inertia of its motor. The limits of speed and
    acceleration are the firmware's limits.

    Parameters
    ----------
    limits_only
        Whether to write kinematic drives, which need no values of motors and masses.

    Raises
    ------
    OptionError
        If numbers are missing (the error names all of them, with examples); if an answer names an
        unknown axis, has a wrong unit, or concerns dynamics that ``limits_only`` omits; or if a
        motor moves several axes and ``limits_only`` is False.
    MachineError
        If the settings lack limits that Klipper requires.
    """
    turning = turning_axes(settings, answers)
    check_answers(settings, answers)
    if limits_only:
        _refuse_dynamics(answers)
    elif settings.coupled:
        raise OptionError(
            f"{Place(settings.file)}: {settings.coupled}: a motor moves more than one axis, so "
            "motors and masses cannot be described axis by axis",
            remedy="Add --limits-only: limits apply to axes.",
        )
    missing = missing_answers(settings, answers, limits_only=limits_only)
    if missing:
        hint = "" if limits_only else " Limits and time alone need no motors: --limits-only."
        raise OptionError(
            f"{Place(settings.file)} does not give all numbers of the machine",
            remedy=f"Add: {'; '.join(_answer_forms(missing))}.{hint}",
        )
    drive_text = "with limits alone" if limits_only else "with steppers"
    parts = [
        f'name = "{name}"',
        f'title = "machine of {len(settings.axes)} axes {drive_text}, made from the settings of '
        f'{settings.firmware}"',
        f'sources = ["settings of {settings.form or settings.firmware}; what they do not say, its '
        'owner"]',
        'tick_budget = "1e9 tick exact, assumed: 11 days at 1 ms"',
        "",
        "[clocks]",
        'pulse = "1 ms exact, assumed: the segment within which pulses come evenly"',
        "",
        "[programs]",
        f'dialect = "{settings.dialect or settings.firmware}"',
    ]
    parts += ["", *_planner(settings, turning)]
    if turning:
        parts += ["", "[tool]", f'radius = "{answers.of("radius", "")} exact, assumed: the owner"']
    for axis, axis_settings in settings.axes.items():
        turns = axis in turning
        drive = _kinematic(axis) if limits_only else _stepper(axis, axis_settings, answers, turns)
        parts += ["", *drive, "", *_limits_of(axis, axis_settings, settings, answers, turns)]
    return "\n".join(parts) + "\n"


def check_answers(settings: Settings, answers: Answers) -> None:
    """Refuse an answer for an unknown axis, or in a wrong unit.

    Raises
    ------
    OptionError
        If there is such an answer.
    """
    turning = turning_axes(settings, answers)
    answer_axes = [key.partition(".")[2] for key in answers.texts if "." in key]
    unknown_axes = [axis for axis in [*answers.rotary, *answer_axes] if axis not in settings.axes]
    if unknown_axes:
        raise OptionError(
            f"the settings have no axis {unknown_axes[0][:20]}",
            remedy=f"They have {', '.join(settings.axes)}.",
        )
    for axis, turns in settings.turning.items():
        if "rotary" in answers.texts and turns != (axis in answers.rotary):
            raise OptionError(
                f"the settings say that {axis} {'turns' if turns else 'moves along a line'}, and "
                f"rotary={answers.texts['rotary'][:20]} says otherwise",
                remedy="Leave rotary out.",
            )
    for key, text in answers.texts.items():
        base, _, axis = key.partition(".")
        if base == "rotary":
            continue
        turns = bool(axis) and axis in turning  # an answer without an axis is for linear axes
        if turns and base == "travel":
            raise OptionError(
                f"--set {key}={text[:40]!r}: axis {axis} turns without end, it has no travel",
                remedy="Leave it out, or name the letters that do turn with rotary.",
            )
        unit = _UNITS[base] if base in _UNITS else (_ROTARY_UNITS if turns else _LINEAR_UNITS)[base]
        try:
            positive = parse_quantity(text, unit) > 0
        except UnitError as error:
            questions = {**QUESTIONS, **OPTIONAL, **(_TURNS if turns else {})}
            raise OptionError(
                f"--set {key}={text!r}: {error.message}",
                remedy=f'Write it like "{key}={questions[base][1]}".',
            ) from error
        if not positive:
            raise OptionError(f"--set {key}={text!r} must be greater than 0")


def names_dynamics(answers: Answers) -> bool:
    """Return whether an answer concerns motors or masses."""
    return any(key.partition(".")[0] in _OF_DYNAMICS for key in answers.texts)


def _refuse_dynamics(answers: Answers) -> None:
    for key in answers.texts:
        if key.partition(".")[0] in _OF_DYNAMICS:
            raise OptionError(
                f"--set {key} concerns motors and masses, which --limits-only omits",
                remedy="Leave one of them out.",
            )


def _missing(
    settings: Settings, answers: Answers, limits_only: bool
) -> Iterator[tuple[str, tuple[str, str]]]:
    may_turn = [
        axis for axis in settings.axes if axis in _MAY_TURN and axis not in settings.turning
    ]
    turning = turning_axes(settings, answers)
    if may_turn and "rotary" not in answers.texts:
        quantity, _ = QUESTIONS["rotary"]
        turning += "".join(may_turn)  # as if rotary, so that the list of missing numbers is whole
        yield "rotary", (quantity, turning)
    for axis, axis_settings in settings.axes.items():
        turns = axis in turning
        if not limits_only:
            yield from _missing_of_motor(axis, axis_settings, answers, turns)
        for quantity in ("steps", "rate", "acceleration"):
            answer = (
                answers.texts.get(f"{quantity}.{axis}") if turns else answers.of(quantity, axis)
            )
            if getattr(axis_settings, quantity) is None and answer is None:
                yield f"{quantity}.{axis}", _TURNS[quantity] if turns else OPTIONAL[quantity]
        if not turns and axis_settings.travel is None and answers.of("travel", axis) is None:
            yield f"travel.{axis}", OPTIONAL["travel"]
    if turning and "radius" not in answers.texts:
        yield "radius", QUESTIONS["radius"]


def _missing_of_motor(
    axis: str, axis_settings: AxisSettings, answers: Answers, turns: bool
) -> Iterator[tuple[str, tuple[str, str]]]:
    for name in ("torque", "current", "resistance", "inductance", "supply"):
        if answers.of(name, axis) is None:
            yield name, QUESTIONS[name]
    if axis_settings.microsteps is None and answers.of("microsteps", axis) is None:
        yield "microsteps", QUESTIONS["microsteps"]
    load = "inertia" if turns else "mass"
    if answers.of(load, axis) is None:
        yield load, QUESTIONS[load]


def _planner(settings: Settings, turning: str) -> Iterator[str]:
    """Yield the lines of [planner]."""
    planner = settings.planner
    firmware = settings.firmware
    yield "[planner]"
    yield f'kind = "{_PLANNERS[firmware]}"'
    jumps = {key: value for key, value in planner.items() if key.startswith("jump.")}
    if firmware == "reprapfirmware":
        _check_jumps(settings)
    if firmware in _BY_JUMPS and jumps and "junction_deviation" not in planner:
        texts = (
            f'{key.removeprefix("jump.")} = "'
            + _planner_value(value, f"{_unit(key[-1], turning)}/s", firmware)
            + '"'
            for key, value in jumps.items()
            if key.removeprefix("jump.") in settings.axes
        )
        yield f"jump = {{ {', '.join(texts)} }}"
    yield from (f"{key} = true" for key in _SWITCHES if key in planner)
    if settings.ignored:
        texts = (f'"{_printable(text)}"' for text in settings.ignored)
        yield f"left_out = [{', '.join(texts)}]"
    axis_accelerations = {
        key[-1]: value for key, value in planner.items() if key.startswith("alone.")
    }
    if axis_accelerations:
        texts = (
            f'{axis} = "{_planner_value(value, f"{_unit(axis, turning)}/s^2", firmware)}"'
            for axis, value in axis_accelerations.items()
        )
        yield f"alone = {{ {', '.join(texts)} }}"
    for key, unit in _PLANNER_KEYS[_PLANNERS[firmware]].items():
        if key in planner:
            yield f'{key} = "{_planner_value(planner[key], unit, firmware)}"'
        elif firmware == "klipper":
            raise MachineError(
                f"[printer] does not give {_KLIPPER_WORDS[key]}",
                place=Place(settings.file),
                remedy="Give the complete printer.cfg: Klipper itself requires this value.",
            )


def _printable(text: str) -> str:
    """Return a sentence escaped for the quotes of a machine file."""
    return plain(text).replace("\\", "/").replace('"', "'")


def _unit(axis: str, turning: str) -> str:
    return "deg" if axis in turning else "mm"


def _check_jumps(settings: Settings) -> None:
    for axis in settings.axes:
        if f"jump.{axis}" not in settings.planner:
            raise MachineError(
                f"the settings do not give the speed jump of axis {axis}",
                place=Place(settings.file),
                remedy=f"Add the firmware's answer to M566, like M566 {axis}900 (mm/min).",
            )


def _planner_value(setting: SettingValue, unit: str, firmware: str) -> str:
    return f"{setting.value!r} {unit}".rstrip() + f" exact, {_source(setting, firmware)}"


def _source(setting: SettingValue, firmware: str) -> str:
    if not setting.place.line:
        return f"assumed: the {setting.name}"
    return f"checked: {firmware}, {setting.name} in {setting.source}"


def _kinematic(axis: str) -> Iterator[str]:
    yield f"[drives.{axis.lower()}]"
    yield 'kind = "kinematic"'
    yield 'clock = "pulse"'


def _stepper(
    axis: str, axis_settings: AxisSettings, answers: Answers, turns: bool
) -> Iterator[str]:
    unit = "deg" if turns else "mm"
    steps = _steps(axis, axis_settings, answers, turns)
    micro = (
        axis_settings.microsteps.value
        if axis_settings.microsteps
        else _number(answers, "microsteps", axis)
    )
    # A turn of the motor moves the axis by full steps x microsteps / steps, in mm or degrees.
    per_turn = _FULL_STEPS * micro / steps
    lever = (math.radians(per_turn) if turns else per_turn / 1e3) / (2.0 * math.pi)
    load_si = _number(answers, "inertia" if turns else "mass", axis)
    rotor_text = answers.of("rotor", axis) or DEFAULTS["rotor"]
    inertia = parse_quantity(rotor_text, "kg*m^2") + load_si * lever**2
    friction = answers.of("friction", axis) or DEFAULTS["friction"]
    body_name = axis.lower()
    load = answers.of("inertia" if turns else "mass", axis)
    yield f"[bodies.{body_name}]"
    yield 'kind = "rotary"'
    yield (
        f'inertia = "{inertia:.6g} kg m^2 +- 20 %, checked: rotor {rotor_text} and {load} at '
        f'{per_turn:.6g} {unit} a turn"'
    )
    yield f'friction = "{friction} +- 50 %, assumed"'
    yield ""
    yield f"[drives.{body_name}]"
    yield 'kind = "stepper"'
    yield f'body = "{body_name}"'
    yield 'clock = "pulse"'
    yield f'full_steps = "{_FULL_STEPS} count/rev exact, assumed: 1.8 deg"'
    yield f'microsteps = "{micro:g} exact, assumed: set in the driver"'
    yield 'microstep_error = "0.09 deg +- 50 %, assumed: 5 % of a step, as catalogues have it"'
    yield "winding = { " + ", ".join(
        f'{key} = "{answers.of(name, axis)} +- 10 %, assumed: the owner"'
        for key, name in (
            ("holding_torque", "torque"), ("current", "current"), ("resistance", "resistance"),
            ("inductance", "inductance"), ("supply", "supply"),
        )
    ) + " }"  # fmt: skip


def _steps(axis: str, axis_settings: AxisSettings, answers: Answers, turns: bool) -> float:
    """Return the steps of an axis per mm or degree."""
    if axis_settings.steps is not None:
        return axis_settings.steps.value
    answer = answers.texts.get(f"steps.{axis}") if turns else answers.of("steps", axis)
    if turns:
        return parse_quantity(answer or "", "count/rad") * math.radians(1.0)
    return parse_quantity(answer or "", "count/m") / 1e3


def _limits_of(
    axis: str, limits: AxisSettings, settings: Settings, answers: Answers, turns: bool
) -> Iterator[str]:
    unit = "deg" if turns else "mm"
    origin = settings.firmware
    steps = _limit(limits.steps, answers, "steps", axis, f"count/{unit}", origin)
    yield f"[axes.{axis}]"
    yield f'kind = "{"rotary" if turns else "linear"}"'
    yield f'drive = "{axis.lower()}"'
    yield f'counts = "{steps}"'
    yield f'velocity = "{_limit(limits.rate, answers, "rate", axis, f"{unit}/min", origin)}"'
    yield (
        f'acceleration = "'
        f'{_limit(limits.acceleration, answers, "acceleration", axis, f"{unit}/s^2", origin)}"'
    )
    if turns:
        yield "endless = true"
        if limits.wrapped:
            yield "wrapped = true"
        return
    travel = answers.of("travel", axis)
    if limits.travel is not None:
        travel = f"{limits.travel.value!r} mm"
    # A job may begin anywhere between the ends, so it may move by at most the full stroke.
    yield (
        f'travel = ["-{travel} exact, assumed: no further than from end to end", '
        f'"{travel} exact, assumed: likewise"]'
    )
    yield f'stroke = "{travel} exact, assumed: from end to end, wherever a job begins"'


def _limit(
    setting: SettingValue | None,
    answers: Answers,
    name: str,
    axis: str,
    unit: str,
    firmware: str,
) -> str:
    if setting is not None:
        return f"{setting.value!r} {unit} exact, {_source(setting, firmware)}"
    return f"{answers.of(name, axis)} exact, assumed: the owner"


def _number(answers: Answers, name: str, axis: str) -> float:
    return parse_quantity(answers.of(name, axis) or "", _UNITS[name])
