"""Reader of Marlin's answer to ``M503``, in each of its historical forms.

``M204`` and ``M205`` changed their letters, and some letters changed their meaning:

===================== ============== ===================================== =======================
form                  acceleration   least speeds and time of a move       jerk
===================== ============== ===================================== =======================
Marlin 1.0            ``M204 S T``   ``M205 S T B``                        ``X`` of X and Y, ``Z``
MarlinKimbra, MK4duo  ``M204 P V``   ``M205 S V B``                        ``X Y Z``, or as 1.0
Marlin 1.1 and later  ``M204 P R T`` ``M205 S T B`` (``Q`` in 1.1.9)       ``X Y Z``, or ``J``
===================== ============== ===================================== =======================

Sources: Marlin 1.0.2, ``ConfigurationStore.cpp`` (S acceleration, T acceleration of retracting, X
"maximum XY jerk"); 1.1.9 and 2.1, ``configuration_store.cpp`` and ``settings.cpp`` (P printing, R
retracting, T travel); MarlinKimbra, ``configuration_store.cpp`` (V travel, ``M204 T0 R`` of a
tool); ``planner.cpp`` of these versions (limits of a move without extrusion);
marlinfw.org/docs/gcode, M92, M201, M203 to M206, M420, M425, M493, M593, M665, M852.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from threadline.errors import MachineError, Place
from threadline.machine.firmware.axis_settings import Settings, number_or_nan, times, unknown
from threadline.machine.firmware.dump_lines import DumpSetting, dump_lines, in_force, pasted

FIRST = "Marlin 1.0"
KIMBRA = "MarlinKimbra or MK4duo"
LATER = "Marlin 1.1 or later"
_LETTERS = "XYZABCUVW"
_ORDER = (92, 203, 201, 204, 205, 350)
_LIMITS = _ORDER[:5]
_OF_AXES = {92: "steps", 203: "rate", 201: "acceleration", 350: "microsteps"}
_SEGMENT_US = 20_000.0
_ENDS = {210: "low", 211: "high"}
_CODE = re.compile(r"(?:N\d+\s+)?([GM])(\d{1,4})(?:\.\d+)?(?![\d.])(.*)$")
_COUNTS = re.compile(r"(?<![\w.])M(?:92|20[1345])\s+[A-Z]\s*-?\d")
_WORD = re.compile(r"\s*([A-LN-Z])\s*(-?(?:\d+\.?\d*|\.\d+))(?![\d.])")
_COMMENT = re.compile(r"\s*(?:$|[;#(<*/>-].*|=.*)")
_HEEDED = (206, 420, 425, 493, 593, 665, 666, 852)
_ASSUMED = "default of marlin"
_CORNERS_BY_JERK = (2, 1, 3)
"""First version in which axis acceleration does not bound the speed through a corner."""
_DEFAULT_JERK = {FIRST: {"X": "20", "Y": "20", "Z": "0.4"}}
_LATER_JERK = {"X": "10", "Y": "10", "Z": "0.3"}


@dataclass(slots=True)
class _Evidence:
    """Evidence for the form of a dump, from its comments and letters."""

    kimbra: bool = False
    first: bool = False
    later: bool = False
    version: tuple[tuple[int, ...], Place] | None = None  # from an M115 line or the start message
    of_both: bool = False  # a comment says that the jerk of X also applies to Y
    stealth: bool = False  # lines of Prusa's second motor mode follow

    def note(self, text: str, place: Place) -> None:
        """Take evidence from a line, in lower case, that is not a command."""
        if "acceleration" in text and "retract" in text:
            self.kimbra |= "v=travel" in text or " v<" in text
            self.first |= "s=acceleration" in text
            self.later |= "t=travel" in text or "t<travel" in text
        version = re.match(r"(?:firmware_name:\s*)?marlin\s*v?(\d+)\.(\d+)(?:\.(\d+))?", text)
        if version is not None:
            numbers = tuple(int(number or 0) for number in version.groups())
            self.later |= numbers >= (1, 1)
            self.version = numbers, place
        self.of_both |= "maximum xy jerk" in text
        if text.startswith(("maximum ", "; maximum ")):
            self.stealth = "stealth" in text


def is_marlin(lines: Sequence[str]) -> bool:
    """Return whether lines hold limits or steps in Marlin's form."""
    return any(
        (match := _CODE.match(line.text)) is not None and int(match[2]) in _LIMITS
        for line in dump_lines(pasted(lines).lines, "")
        if line.text[:1] in "MN"
    )


def read_marlin(lines: Sequence[str], file: str) -> Settings:
    """Return the settings of axes and planner in Marlin's answer to ``M503``.

    Raises
    ------
    MachineError
        If a relevant line cannot be read, has two values, or belongs to a machine in which a motor
        moves several axes.
    """
    settings = Settings("marlin", file)
    evidence = _Evidence()
    sayings: list[DumpSetting] = []
    other_commands: dict[tuple[int, str], Place] = {}
    terminal = pasted(lines)
    settings.notes += [terminal.note] if terminal.note else []
    for line in dump_lines(terminal.lines, file):
        match = _CODE.match(line.text)
        if match is None:
            _take_evidence(line.text, line.place, evidence)
            continue
        code = int(match[2])
        if match[1] == "G" and code == 20:
            settings.refuse_inches(line.place)
        if match[1] == "G" or code not in (*_ORDER, *_HEEDED, *_ENDS):
            continue
        words, rest = _words(match[3])
        if code in _LIMITS and not (words and _COMMENT.match(rest)):
            raise unknown(line.text, line.place, "echo:  M92 X80.00 Y80.00")
        if code in _HEEDED:
            other_commands[code, match[3].split(";", 1)[0].strip()] = line.place
        elif evidence.stealth and code in (203, 201):
            settings.notes.append(f"{line.place}: M{code} of the stealth mode is not read")
        else:
            sayings += _sayings(code, words, line.place, evidence)
    kept, note = in_force(sayings, lambda a, b: number_or_nan(a) == number_or_nan(b))
    settings.notes += [note] if note else []
    for (code, text), place in other_commands.items():
        if not note or place.line > kept[0].place.line:  # in the valid dump
            _note_other(settings, code, text, place)
    _interpret(settings, evidence, kept)
    settings.notes.append(
        "assumed one motor per axis: M503 does not tell whether the machine is a CoreXY"
    )
    return settings


def _take_evidence(text: str, place: Place, evidence: _Evidence) -> None:
    """Take evidence from a line that is not a command; refuse a command in the middle of a line."""
    code_text = re.split(r"[;#]", text, maxsplit=1)[0]
    if _COUNTS.search(code_text) is not None and not text.lower().startswith("unknown command"):
        raise unknown(text, place, "echo:  M92 X80.00 Y80.00, with nothing before the M")
    evidence.note(text.lower(), place)


def _words(text: str) -> tuple[dict[str, str], str]:
    """Return the words of a command (repeated letters get an apostrophe) and the rest."""
    words: dict[str, str] = {}
    position = 0
    while (match := _WORD.match(text, position)) is not None:
        letter = match[1]
        while letter in words:  # keeps two values of a letter apart
            letter += "'"
        words[letter] = match[2]
        position = match.end()
    return words, text[position:]


def _sayings(
    code: int, words: dict[str, str], place: Place, evidence: _Evidence
) -> list[DumpSetting]:
    """Return the settings of a command, except settings of extruders and tools."""
    order = _ORDER.index(code) if code in _ORDER else len(_ORDER)
    letters = {letter.rstrip("'") for letter in words}
    if "E" in letters and letters <= {"T", "E"}:
        return []
    if code == 204:
        evidence.kimbra |= "V" in letters
        evidence.later |= "P" in letters and "V" not in letters
        if evidence.kimbra and "R" in letters and letters <= {"T", "R"}:
            return []  # of a tool
    if code == 205 and letters <= {"T", "E"}:
        return []
    return [
        DumpSetting(order, f"M{code} {letter.rstrip(chr(39))}", text, place)
        for letter, text in words.items()
        if letter != "E"
    ]


def _interpret(settings: Settings, evidence: _Evidence, kept: Sequence[DumpSetting]) -> None:
    """Set the axis and planner settings, according to the form of the dump."""
    keys = {setting.key for setting in kept}
    doubtful = "M204 S" in keys and "M204 T" in keys and not (evidence.first or evidence.later)
    if evidence.kimbra:
        form = KIMBRA
    elif evidence.first or doubtful or ("M204 S" in keys and not evidence.later):
        form = FIRST
    else:
        form = LATER
    settings.form = form
    if doubtful:
        settings.notes.append(
            "M204 S T is read as in Marlin 1.0: S acceleration, T acceleration of retracting"
        )
    travel_letters = {FIRST: "S", KIMBRA: "V", LATER: "T"}
    travel = {travel_letters[form]} | ({"S"} if form == LATER and "M204 T" not in keys else set())
    slowest = {FIRST: "T", KIMBRA: "V", LATER: "T"}[form]
    segment = "Q" if "M205 Q" in keys else "B"
    ends: dict[str, dict[str, tuple[str, Place]]] = {}
    for setting in kept:
        code, letter = int(setting.key[1:].split()[0]), setting.key[-1]
        if code in _OF_AXES and letter in _LETTERS:
            written = times(setting.text, 60.0) if code == 203 else setting.text  # mm/s there
            settings.record(
                letter, _OF_AXES[code], written, setting.place, setting.key, setting.text
            )
        elif code in _ENDS and letter in _LETTERS:
            ends.setdefault(letter, {})[_ENDS[code]] = setting.text, setting.place
        elif code == 201 and letter == "F" and number_or_nan(setting.text) != 0.0:
            settings.leave_out(
                setting.key, "slows X and Y in short zigzags (frequency)", setting.place
            )
        elif code == 205 and letter == "S" and number_or_nan(setting.text) != 0.0:
            settings.notes.append(
                f"{setting.place}: M205 S{setting.text}: only for moves with extrusion"
            )
        elif code == 204 and letter in travel:
            settings.set_planner(
                "acceleration", setting.text, setting.place, setting.key, zero=False
            )
        elif code == 205 and letter == "J":
            settings.set_planner("junction_deviation", setting.text, setting.place, setting.key)
        elif code == 205 and letter == slowest:
            if number_or_nan(setting.text) != 0.0:
                settings.set_planner("least_speed", setting.text, setting.place, setting.key)
        elif code == 205 and letter == segment:
            if number_or_nan(setting.text) != _SEGMENT_US:
                settings.set_planner(
                    "short_time",
                    times(setting.text, 1e-3),
                    setting.place,
                    setting.key,
                    typed=setting.text,
                )
        elif code == 205 and letter in _LETTERS:
            settings.set_planner(f"jump.{letter}", setting.text, setting.place, setting.key)
    for letter, axis_ends in ends.items():
        if letter in settings.axes and len(axis_ends) == 2:
            text, place = axis_ends["high"]
            way = number_or_nan(text) - number_or_nan(axis_ends["low"][0])
            settings.record(letter, "travel", repr(way), place, f"M211 {letter}", text)
    if "acceleration" not in settings.planner and "M204 P" in keys:
        settings.notes.append(
            f"M204 {travel_letters[form]} is missing: moves without extrusion are limited only "
            "by M201"
        )
    _corners(settings, evidence, form, keys)


def _corners(settings: Settings, evidence: _Evidence, form: str, keys: set[str]) -> None:
    """Give every axis its jerk, if corner speed is limited by jerk."""
    planner = settings.planner
    by_jerk = any(key.startswith("jump.") for key in planner)
    if "junction_deviation" in planner or (not by_jerk and form == LATER):
        _set_corner_axes(settings, evidence)
        return  # cornering is by junction deviation, with its default if no value is given
    common_jerk = evidence.of_both or form == FIRST or "M205 Z" in keys
    if "jump.X" in planner and "jump.Y" not in planner and "Y" in settings.axes and common_jerk:
        planner["jump.Y"] = planner["jump.X"]
        settings.notes.append(
            f"{planner['jump.X'].place}: M205 X is the common jerk of X and Y; here each axis has "
            "it alone, so a diagonal corner may be planned faster than on the machine"
        )
    for axis in settings.axes:
        default = _DEFAULT_JERK.get(form, _LATER_JERK).get(axis)
        if f"jump.{axis}" in planner:
            continue
        if default is None:
            raise MachineError(
                f"the settings do not give the jerk of axis {axis}",
                place=Place(settings.file),
                remedy=f"Add it to M205, like M205 {axis}5.",
            )
        settings.set_planner(f"jump.{axis}", default, Place(settings.file), _ASSUMED)
        settings.notes.append(f"no jerk of {axis}: {default} mm/s, the default of {form}")


def _set_corner_axes(settings: Settings, evidence: _Evidence) -> None:
    """Set whether the acceleration of each axis bounds the speed through a corner."""
    if evidence.version is None:
        settings.notes.append(
            "M503 does not tell the version (M115 does): Marlin up to 2.1.2 is slower in some "
            "corners, and needs corner_axes = true in [planner]"
        )
        return
    version, place = evidence.version
    if version < _CORNERS_BY_JERK:
        settings.set_planner("corner_axes", "1", place, "Marlin " + ".".join(map(str, version)))


def _note_other(settings: Settings, code: int, text: str, place: Place) -> None:
    """Refuse kinematics that move several axes; record other settings that change the motion."""
    words = dict(re.findall(r"([A-Z])(-?[\d.]*)", text))
    letters_set = {letter for letter, number in words.items() if number_or_nan(number) != 0.0}
    command = f"M{code} " + " ".join(f"{letter}{number}" for letter, number in words.items())
    if code == 665:  # only delta and SCARA machines have it
        settings.refuse_kinematics("M665", place)
    elif code == 852 and letters_set & set("IJKS"):
        settings.leave_out(command, "moves an axis in proportion to another (skew)", place)
    elif code == 425 and "F" in letters_set and letters_set - set("FS"):
        settings.leave_out(command, "adds a motion of the motor at reversals (backlash)", place)
    elif code == 420 and "S" in letters_set:
        settings.leave_out(command, "moves Z by the mesh of the bed", place)
    elif code == 493 and "S" in letters_set:
        settings.leave_out(command, "shapes the motion (fixed-time motion)", place)
    elif code == 593 and "F" in letters_set:
        settings.shapes("M593", place)
    elif code in (206, 666) and letters_set:
        settings.notes.append(
            f"{place}: {command} shifts zero after homing and does not change the motion of a job"
        )
