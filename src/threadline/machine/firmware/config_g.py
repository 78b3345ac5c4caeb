"""Reader of a ``config.g`` of RepRapFirmware: settings of axes and planner in its M codes.

Sources: docs.duet3d.com, "Gcode dictionary": M92, M201, M203, M204, M205, M208, M350, M425, M556,
M566, M579, M584, M593, M595, M98 (files of the folder ``/sys``, which also has ``config.g``);
RepRapFirmware, ``GCodes2.cpp``: M350 keeps the travel per full step,
and ``DDARing.cpp``: M595 enlarges the queue of moves but never shrinks it.
"""

from __future__ import annotations

import glob
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from threadline.base.reading import read_text
from threadline.errors import MachineError, Place
from threadline.machine.firmware.axis_settings import Settings, number_or_nan, times
from threadline.machine.firmware.dump_lines import files_beside

_ONLY_REPRAPFIRMWARE = re.compile(
    r"\s*M(?:(?:550|552|563|566|574|584|595|669|950)\s|350\s.*\sI[01]\b|98\s+P\".+\.g\")",
    re.IGNORECASE,
)
_LETTERS = "XYZABCUVW"
_AXIS_CODES = {203: "rate", 201: "acceleration"}
_OTHER_CODES = (92, 204, 205, 208, 350, 566, 595)
Steps = tuple[float, str, Place]
_MICROSTEPS = 16.0  # default of a driver without M350
_LEAST_QUEUE = 60  # smallest queue of moves; M595 P can only enlarge it
_CODE = re.compile(r"M(\d{1,4})(?![\d.])(.*)$")
_COMMANDS = re.compile(r"(?<=\s)(?=[GM]\d)")  # a line may hold several commands
_RUN_FILE = re.compile(r"\s*M98\s+P\"(?:0:)?(?:/sys/)?([^\"{}]+)\"\s*(?:;.*)?$", re.IGNORECASE)
_MOST_BYTES = 1_000_000
_CONDITION = re.compile(r"\s*(?:if|elif|else|while)\b", re.IGNORECASE)
_WORD = re.compile(r"([A-Z])\s*(-?[0-9.]+(?::-?[0-9.]+)*)(?=\s|[A-Z]|$)")


@dataclass(slots=True)
class _Read:
    """Settings from the commands read so far.

    Attributes
    ----------
    steps
        Steps of each axis per mm or degree, and the last line that set them.
    microsteps
        Microsteps of each axis, and the line of M350; ``_MICROSTEPS`` without M350.
    ends
        Lowest and highest position of each axis, with their lines.
    """

    settings: Settings
    steps: dict[str, Steps] = field(default_factory=dict)
    microsteps: dict[str, tuple[float, str, Place]] = field(default_factory=dict)
    ends: dict[str, dict[str, tuple[float, Place]]] = field(default_factory=dict)


def is_config_g(lines: Sequence[str]) -> bool:
    """Return whether lines hold commands that only RepRapFirmware has."""
    return any(_ONLY_REPRAPFIRMWARE.match(line) for line in lines)


def read_config_g(lines: Sequence[str], file: str) -> Settings:
    """Return the settings of axes and planner in the lines of a ``config.g``.

    Raises
    ------
    MachineError
        If a relevant line cannot be read, or is inside a condition.
    """
    settings = Settings("reprapfirmware", file)
    read = _Read(settings)
    _read_lines(read, lines, (Path(file).resolve(),), file)
    for letter, axis_ends in read.ends.items():
        if letter in read.steps and len(axis_ends) == 2:
            (low, _), (high, place) = axis_ends["low"], axis_ends["high"]
            settings.record(letter, "travel", repr(high - low), place, f"M208 {letter}")
    for letter, (value, typed, place) in read.steps.items():
        settings.record(letter, "steps", repr(value), place, f"M92 {letter}", typed)
    for letter, (_, typed, place) in read.microsteps.items():
        if letter in read.steps:
            settings.record(letter, "microsteps", typed, place, f"M350 {letter}")
    return settings


def _read_lines(read: _Read, lines: Sequence[str], open_files: tuple[Path, ...], name: str) -> None:
    """Read the lines of a file, and of the files that it runs (``M98 P"drives.g"``)."""
    settings = read.settings
    condition_indent = -1  # indentation of the enclosing condition
    for number, line in enumerate(lines, start=1):
        place = Place(name, number)
        code_text = _without_comments(line)
        if not code_text.strip():
            continue
        indent = len(code_text) - len(code_text.lstrip())
        condition_indent = condition_indent if indent > condition_indent else -1
        if _CONDITION.match(code_text):
            condition_indent = indent if condition_indent < 0 else condition_indent
            continue
        runs = _RUN_FILE.match(line)
        if runs is not None and condition_indent < 0:
            for path in _files_run(runs[1], place, settings, open_files):
                text = read_text(path, _MOST_BYTES, MachineError, "settings file")
                _read_lines(read, text.splitlines(), (*open_files, path), str(path))
            continue
        commands = code_text.strip() if "{" in code_text else code_text.strip().upper()
        for command in _COMMANDS.split(commands):
            match = _CODE.match(command)
            code = int(match[1]) if match is not None else 0
            if match is None or (code not in _AXIS_CODES and code not in _OTHER_CODES):
                _note_other(settings, command, line, place)
                continue
            if condition_indent >= 0:
                raise MachineError(
                    f"M{code} is inside a condition, whose value is unknown",
                    place=place,
                    remedy="Give only the valid lines, without the condition.",
                )
            words = dict(_WORD.findall(match[2]))
            if _WORD.sub("", match[2]).strip():
                raise MachineError(
                    f"{command.strip()[:60]!r} is not a line of these settings",
                    place=place,
                    remedy=f"Lines are like M{code} X80 Y80, with numbers only.",
                )
            _take(read, code, words, place)


def _files_run(
    name: str, place: Place, settings: Settings, open_files: tuple[Path, ...]
) -> Iterator[Path]:
    """Yield the file that M98 runs, if it lies in the folder of the first file; else note it."""
    paths = files_beside(glob.escape(name), open_files[0].parent)
    if not paths:
        settings.ignored.append(
            f"{place}: the file run by M98 is not read: no such file beside this one "
            f"({name[:60]}); put its settings of axes in its place"
        )
    for path in paths:
        if path in open_files:
            raise MachineError(
                f'M98 P"{name}" runs its own file',
                place=place,
                remedy="Remove it; RepRapFirmware would run it without end.",
            )
        yield path


def _take(read: _Read, code: int, words: dict[str, str], place: Place) -> None:
    """Apply a command with its words."""
    settings = read.settings
    for letter, text in words.items():
        name = f"M{code} {letter}"
        if code == 595 and letter == "P":
            settings.set_planner("blocks", text, place, name, zero=False)
            if settings.planner["blocks"].value < _LEAST_QUEUE:  # the queue never shrinks
                del settings.planner["blocks"]
        elif code == 566 and letter == "P":
            settings.set_planner("policy", text, place, name)
        elif code == 204 and letter == "T":
            settings.set_planner("acceleration", text, place, name, zero=False)
        elif letter not in _LETTERS:
            continue
        elif code in (205, 566):  # mm/s, mm/min
            jump = times(text, 1.0 if code == 205 else 1.0 / 60.0)
            settings.set_planner(f"jump.{letter}", jump, place, name, typed=text)
        elif code == 208:
            _end(read.ends, letter, text, words, place)
        elif code == 92:
            value = settings.number(text, place, name)
            if "S" in words:  # S: microsteps for which this value holds
                value *= _microsteps_of(read, letter) / settings.number(words["S"], place, "M92 S")
            read.steps[letter] = value, text, place
        elif code == 350:
            value, micro_before = settings.number(text, place, name), _microsteps_of(read, letter)
            if letter in read.steps:  # the firmware keeps the travel per full step
                steps, typed, steps_place = read.steps[letter]
                read.steps[letter] = steps * value / micro_before, typed, steps_place
            read.microsteps[letter] = value, text, place
        elif code in _AXIS_CODES:
            settings.record(letter, _AXIS_CODES[code], text, place, name)


def _microsteps_of(read: _Read, letter: str) -> float:
    return read.microsteps[letter][0] if letter in read.microsteps else _MICROSTEPS


def _note_other(settings: Settings, plain: str, line: str, place: Place) -> None:
    """Refuse commands that change the meaning of numbers; record others that change the motion."""
    if re.match(r"M453\b", plain):
        settings.dialect = "reprapfirmware-cnc"
    if re.match(r"G20\b", plain):
        settings.refuse_inches(place)
    kinematics = re.match(r"M669\b.*?\bK\s*(\d+)", plain)
    if kinematics is not None and int(kinematics[1]) != 0:
        settings.refuse_kinematics(f"M669 K{kinematics[1]}", place)
    kinematics_match = re.match(r"(?:M665\b|M667\b.*?\bS\s*0*[1-9])", plain)  # a delta, a core XY
    if kinematics_match is not None:
        settings.refuse_kinematics(kinematics_match[0].strip(), place)
    if re.match(r"M593\b", plain) and not re.search(r'P"none"', line, re.IGNORECASE):
        settings.shapes("M593", place)
    runs = re.match(r"(M98|M501)\b", plain)
    if runs is not None:
        settings.ignored.append(
            f"{place}: the file run by {runs[1]} is not read; put its settings of axes in its place"
        )
    words = {letter: number_or_nan(text) for letter, text in _WORD.findall(plain[4:])}
    axis_words = {letter: number for letter, number in words.items() if letter in _LETTERS}
    command = plain.strip()
    if re.match(r"M579\b", plain) and any(number != 1.0 for number in axis_words.values()):
        raise MachineError(
            f"{command} scales the positions of an axis, so that all its lengths are wrong",
            place=place,
            remedy="Include the scale in the steps of M92 and remove M579, on the machine too.",
        )
    if re.match(r"M556\b", plain) and any(axis_words.values()):
        settings.leave_out(command, "moves an axis in proportion to another (skew)", place)
    if re.match(r"M425\b", plain) and any(axis_words.values()):
        settings.leave_out(command, "adds a motion of the motor at reversals (backlash)", place)
    if re.match(r"(?:M375\b|G29\b.*\bS\s*1\b|M376\b.*\bH\s*0*[1-9])", plain):
        settings.leave_out(command, "moves Z by the mesh of the bed", place)
    drivers = re.match(r"M584\b.*\bR\s*([01])\b", plain)
    if drivers is not None:
        for letter in axis_words:
            settings.turning[letter] = drivers[1] == "1"


def _without_comments(line: str) -> str:
    """Return a line without its comments and quoted texts."""
    return re.sub(r'"[^"]*"|\([^)]*\)', " ", line.split(";", 1)[0]).rstrip()


def _end(
    ends: dict[str, dict[str, tuple[float, Place]]],
    letter: str,
    text: str,
    words: dict[str, str],
    place: Place,
) -> None:
    """Record an end of an axis: ``X0:600``, or ``X600`` with ``S1`` for the lower end."""
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) == 2:
        named_ends = {"low": numbers[0], "high": numbers[1]}
    elif len(numbers) == 1:
        named_ends = {"low" if words.get("S") == "1" else "high": numbers[0]}
    else:
        raise MachineError(
            f"M208 {letter} is {text[:40]!r}; it must be a number, or two numbers with a colon",
            place=place,
            remedy="Write it like M208 X0:600.",
        )
    for end, value in named_ends.items():
        ends.setdefault(letter, {})[end] = (value, place)
