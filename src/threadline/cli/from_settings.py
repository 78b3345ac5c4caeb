"""Make a project from the settings of a controller that plans its motion itself."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

from threadline import __version__
from threadline.cli.messages import warning
from threadline.errors import MachineError, OptionError, Place
from threadline.machine import library_file, load_machine
from threadline.machine.firmware import (
    DEFAULTS,
    Answers,
    Missing,
    Settings,
    SettingValue,
    machine_text,
    missing_answers,
    names_dynamics,
    number_or_nan,
    parse_answers,
    read_settings,
    turning_axes,
)

FIRMWARES = {
    "grbl": "grbl",
    "fluidnc": "fluidnc",
    "marlin": "marlin",
    "klipper": "klipper",
    "rrf": "reprapfirmware",
    "linuxcnc": "linuxcnc",
}
"""The firmware of each kind of project."""
KINDS = tuple(FIRMWARES)
ANSWERS_TO = {
    "grbl": "grbl's answer to $$",
    "fluidnc": "the YAML of FluidNC",
    "marlin": "what Marlin answers to M503",
    "klipper": "printer.cfg",
    "rrf": "config.g of RepRapFirmware",
    "linuxcnc": "the INI of LinuxCNC",
}
"""Name of the settings file of each kind of project."""
PROVE = "there-and-back.gcode -m machine.toml"
_SPEC = "stepper-winder"
_WAY_MM, _FEED_MM_MIN = 20.0, 1200.0
_ANY_STEPS = "1000"  # per mm or degree: finer than any motion that matters
_UNITS = {"steps": "/{}", "rate": "{}/min", "acceleration": "{}/s^2", "travel": "{}"}
_PLANNER_UNITS = {
    "junction_deviation": "mm", "acceleration": "mm/s^2", "velocity": "mm/s", "least_speed": "mm/s",
    "square_corner_velocity": "mm/s", "short_time": "ms", "tolerance": "mm", "cam_tolerance": "mm",
}  # fmt: skip

_LIMITS_ONLY = (
    "No motor and no mass was given, so jobs are proven for limits and time, not for placement. "
    'For placement, make the machine again with --set "torque=1.26 N m": the command asks for the '
    "other values."
)

Row = tuple[str, str, str]
"""A setting, its value, and its source."""


@dataclass(frozen=True, slots=True)
class FromSettings:
    """A project made from the settings of a controller.

    Parameters
    ----------
    contents
        Files of the project: names and contents.
    form
        Firmware and format of the settings.
    rows
        Settings that were read, given by the owner, or assumed.
    notes
        Assumptions made while reading, a sentence each.
    left_out
        Behaviour of the controller that the plan ignores.
    """

    contents: dict[str, bytes]
    form: str
    rows: list[Row]
    notes: list[str]
    left_out: list[str]


def settings_of(kind: str, source: Path) -> Settings:
    """Return the settings in a file, which must come from the controller of ``kind``.

    Raises
    ------
    MachineError
        If the settings cannot be read.
    OptionError
        If they come from another controller.
    """
    firmware = FIRMWARES[kind]
    settings = read_settings(source, firmware)
    if settings.firmware == "grbl" and firmware == "fluidnc":  # FluidNC answers $$ as grbl does
        return replace(settings, firmware="fluidnc")
    if settings.firmware != firmware:
        own_kind = next(
            name for name, firmware_name in FIRMWARES.items() if firmware_name == settings.firmware
        )
        raise OptionError(
            f"{Place(str(source))} has the settings of {settings.firmware}, not of {firmware}",
            remedy=f"Make it with: threadline new {own_kind}.",
        )
    return settings


def still_missing(
    settings: Settings, answers: Sequence[str], *, limits_only: bool
) -> list[Missing]:
    """Return the values that the owner still has to give."""
    given_answers = parse_answers(answers)
    if limits_only or not names_dynamics(given_answers):
        _assume_steps(settings, given_answers)
    return missing_answers(settings, given_answers, limits_only=limits_only)


def settings_files(
    kind: str, source: Path, answers: Sequence[str], *, limits_only: bool = False
) -> FromSettings:
    """Return the files of a project made from the settings in ``source``.

    Parameters
    ----------
    kind
        One of ``KINDS``.
    source
        Settings file as the controller lists it.
    answers
        Values that the settings lack, ``"mass=1.2 kg"`` each.
    limits_only
        Whether to make a machine with limits only, without motors and masses. Without any answer
        about motors and masses the machine is such a machine, too, and a note says so.

    Raises
    ------
    MachineError
        If the settings cannot be read.
    OptionError
        If the settings come from another controller, or a value is still missing.
    """
    settings = settings_of(kind, source)
    given_answers = parse_answers(answers)
    no_dynamics = not limits_only and not names_dynamics(given_answers)
    limits_only |= no_dynamics
    if limits_only:
        _assume_steps(settings, given_answers)
    text = machine_text(settings, given_answers, kind, limits_only=limits_only)
    _check(text, settings)
    for ignored in settings.ignored:
        warning(ignored)
    head = f"# From the settings of {settings.firmware}, by Threadline {__version__}.\n#\n"
    projects = resources.files("threadline.cli") / "projects"
    project = projects / ("limits" if limits_only else "firmware")
    if limits_only:
        specification = (project / "spec.toml").read_text(encoding="utf-8")
    else:
        library_spec = library_file(_SPEC).with_suffix(".spec.toml")
        specification = library_spec.read_text(encoding="utf-8")
    readme = (project / "README.md").read_text(encoding="utf-8")
    contents = {
        "machine.toml": (head + text).encode(),
        "spec.toml": specification.replace(f'"{_SPEC}"', f'"{kind}"').encode(),
        "README.md": readme.replace("TARGET", settings.firmware).encode(),
        "there-and-back.gcode": _job(settings, turning_axes(settings, given_answers)).encode(),
    }
    rows = list(_rows(settings, given_answers))
    if not limits_only:
        rows += [
            (key, text, "assumed")
            for key, text in DEFAULTS.items()
            if key not in given_answers.texts
        ]
    form = settings.form or settings.firmware
    notes = [*settings.notes, *([_LIMITS_ONLY] if no_dynamics else [])]
    return FromSettings(contents, form, rows, notes, settings.ignored)


def _assume_steps(settings: Settings, answers: Answers) -> None:
    """Assume the steps of LinuxCNC's axes whose INI has no scale: a HAL file has it.

    LinuxCNC plans in numbers of any size, so the steps change neither its limits nor its times.
    """
    if settings.firmware != "linuxcnc":
        return
    for axis, axis_settings in settings.axes.items():
        given_steps = answers.texts.get(f"steps.{axis}")
        given_steps = (
            given_steps if settings.turning.get(axis, False) else answers.of("steps", axis)
        )
        if axis_settings.steps is None and given_steps is None:
            name = "the INI has no scale; times do not depend on it"
            settings.record(axis, "steps", _ANY_STEPS, Place(settings.file), name)


def read_rows(settings: Settings) -> list[Row]:
    """Return the values of each axis and of the planner in the settings, with their lines."""
    return list(_rows(settings, parse_answers(())))


def _rows(settings: Settings, answers: Answers) -> Iterator[Row]:
    """Yield the settings of each axis and of the planner, read or given."""
    turning = turning_axes(settings, answers)
    for axis, axis_settings in settings.axes.items():
        unit = "deg" if axis in turning else "mm"
        for quantity, form in _UNITS.items():
            found: SettingValue | None = getattr(axis_settings, quantity)
            if quantity == "travel" and axis in turning:
                yield f"{axis} {quantity}", "none", "it turns without end"
            elif found is not None:
                yield f"{axis} {quantity}", f"{found.value:g} {form.format(unit)}", _from(found)
            elif (given_text := answers.of(quantity, axis)) is not None:
                yield f"{axis} {quantity}", given_text, "--set"
    for key, found in settings.planner.items():
        base, _, axis = key.partition(".")
        if axis and axis not in settings.axes:
            continue
        of_axis = f"{'deg' if axis in turning else 'mm'}/s{'^2' if base == 'alone' else ''}"
        unit = of_axis if axis else _PLANNER_UNITS.get(base, "")
        name = f"{axis} {base}" if axis else base.replace("_", " ")
        yield name, f"{found.value:g} {unit}".rstrip(), _from(found)
    for name, text in answers.texts.items():
        if name.partition(".")[0] not in _UNITS:
            yield name, text, "--set"


def _from(value: SettingValue) -> str:
    if not value.place.line:
        return f"assumed: {value.name}"
    typed_text = "" if number_or_nan(value.typed) == value.value else f" {value.typed}"
    return f"{value.name}{typed_text}, {value.place}"


def _check(text: str, settings: Settings) -> None:
    """Refuse a machine file that cannot be read or used, before anything is written.

    The text is not in a file yet, so the error names the settings file instead.
    """
    with tempfile.TemporaryDirectory(prefix="threadline-") as folder:
        file = Path(folder) / "machine.toml"
        file.write_text(text, encoding="utf-8")
        try:
            load_machine(file)
        except MachineError as error:
            lines = text.splitlines()
            line_number = error.place.line if error.place is not None else 0
            quoted = (
                f" ({lines[line_number - 1].strip()[:80]})" if 0 < line_number <= len(lines) else ""
            )
            raise MachineError(
                f"{error.message.rstrip('.')}{quoted}",
                place=Place(settings.file),
                remedy="Correct these settings, or write the machine file by hand.",
            ) from error


def _job(settings: Settings, rotary: str) -> str:
    """Return a short job: one axis there and back, at a feed within its limit."""
    linear = [axis for axis in settings.axes if axis not in rotary]
    axis = (linear or list(settings.axes))[0]
    axis_settings = settings.axes[axis]
    distance_mm = (
        _WAY_MM if axis_settings.travel is None else min(_WAY_MM, axis_settings.travel.value / 2.0)
    )
    feed = (
        _FEED_MM_MIN
        if axis_settings.rate is None
        else min(_FEED_MM_MIN, axis_settings.rate.value / 2.0)
    )
    lines = ["; There and back", "G21", "G90", f"G1 {axis}{distance_mm:g} F{feed:g}", f"G1 {axis}0"]
    if settings.firmware == "linuxcnc":
        lines.append("M2")
    return "\n".join(lines) + "\n"
