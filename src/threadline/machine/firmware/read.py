"""Choose the reader of a settings file by its content."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from threadline.base.reading import read_text
from threadline.errors import MachineError, Place
from threadline.machine.firmware.axis_settings import Settings
from threadline.machine.firmware.config_g import is_config_g, read_config_g
from threadline.machine.firmware.dump_lines import file_lines
from threadline.machine.firmware.grbl_dump import is_fluidnc, is_grbl, read_fluidnc, read_grbl
from threadline.machine.firmware.linuxcnc_ini import is_linuxcnc, read_linuxcnc
from threadline.machine.firmware.marlin_dump import is_marlin, read_marlin
from threadline.machine.firmware.printer_cfg import is_printer_cfg, read_printer_cfg

_MOST_BYTES = 4_000_000  # logs of senders are long
_DEFAULTS = {
    "grbl": {"junction_deviation": "0.01"},
    "fluidnc": {"junction_deviation": "0.01"},
    "marlin": {"junction_deviation": "0.013"},
    "klipper": {"square_corner_velocity": "5", "minimum_cruise_ratio": "0.5"},
    "reprapfirmware": {"policy": "0"},
}
_ABSENT = "is not read: no such file beside this one"
_UTF8, _LATIN1 = "utf-8-sig", "latin-1"
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")  # byte order marks of UTF-16, as some senders save logs


def read_settings(path: str | Path, firmware: str = "") -> Settings:
    """Return the settings of axes and motion planner in a settings file.

    Parameters
    ----------
    path
        File with grbl's answer to ``$$``, Marlin's answer to ``M503``, FluidNC's YAML, Klipper's
        ``printer.cfg``, RepRapFirmware's ``config.g`` or LinuxCNC's INI; logs of terminals may
        have prompts and time stamps around the answer.
    firmware
        Firmware named by the owner: ``reprapfirmware`` for commands that Marlin also has, in other
        units; empty to decide by the content.

    Raises
    ------
    MachineError
        If it is none of these files, has a line that cannot be read, or has no axis.
    """
    path = Path(path)
    encoding = _encoding(path)
    text = read_text(path, _MOST_BYTES, MachineError, "settings file", encoding)
    terminal_lines = text.splitlines()
    settings_lines = file_lines(terminal_lines)
    for is_of_firmware, read in _READERS:
        lines = terminal_lines if is_of_firmware in (is_grbl, is_marlin) else settings_lines
        if is_of_firmware(lines):
            if read is read_marlin and firmware == "reprapfirmware":
                settings = read_config_g(settings_lines, str(path))
            else:
                settings = read(lines, str(path))
            if not settings.axes:
                notes = (*settings.notes, *settings.ignored)
                absent = "".join(f"; {note}" for note in notes if _ABSENT in note)
                raise MachineError(
                    f"the settings contain no axis ({settings.firmware}){absent}",
                    place=Place(str(path)),
                    remedy="Put the included files beside this one."
                    if absent
                    else "Give the complete list of the firmware.",
                )
            _fill_defaults(settings)
            if encoding == _LATIN1:
                settings.notes.append("the file is not UTF-8 text and is read as Latin-1")
            # An included file may name Z first; a machine file begins with X.
            order = sorted(settings.axes, key=lambda axis: f"XYZ{axis}".index(axis))
            settings.axes = {axis: settings.axes[axis] for axis in order}
            return settings
    eeprom = next(
        (line_number for line_number, line in enumerate(terminal_lines, 1) if "EPR:" in line), 0
    )
    if eeprom:
        raise MachineError(
            "EPR: lines belong to Repetier-Firmware, whose planner Threadline does not know",
            place=Place(str(path), eeprom),
            remedy="Write the machine file by hand; see docs/machines.md.",
        )
    raise MachineError(
        "the settings of this file are of no known firmware",
        place=Place(str(path)),
        remedy="Give grbl's answer to $$, Marlin's to M503, a FluidNC YAML, a printer.cfg, a "
        "config.g or a LinuxCNC INI.",
    )


def _fill_defaults(settings: Settings) -> None:
    """Fill in missing planner settings with the firmware's defaults."""
    by_jerk = any(key.startswith("jump.") for key in settings.planner)
    for key, number in _DEFAULTS.get(settings.firmware, {}).items():
        if key not in settings.planner and not (by_jerk and key == "junction_deviation"):
            name = f"default of {settings.firmware}"
            settings.set_planner(key, number, Place(settings.file), name)


def _encoding(path: Path) -> str:
    """Return the encoding of the text: UTF-8, UTF-16 by its byte order mark, else Latin-1."""
    if not path.is_file():  # the reader refuses it
        return _UTF8
    try:
        with path.open("rb") as file:
            first_bytes = file.read(_MOST_BYTES + 1)
    except OSError:
        return _UTF8
    if first_bytes[:2] in _UTF16_MARKS:
        return "utf-16"
    if len(first_bytes) > _MOST_BYTES:  # the reader refuses it
        return _UTF8
    if b"\0" in first_bytes:
        return _wide_without_mark(first_bytes)
    try:
        first_bytes.decode(_UTF8)
    except UnicodeDecodeError:
        return _LATIN1
    return _UTF8


def _wide_without_mark(first_bytes: bytes) -> str:
    """Return the encoding of text with zero bytes: UTF-16 if every other byte is zero."""
    for name, high in (("utf-16-le", 1), ("utf-16-be", 0)):
        if not any(first_bytes[high::2]) and all(first_bytes[1 - high :: 2]):
            return name
    return _UTF8  # the reader refuses it


_READERS: tuple[
    tuple[Callable[[Sequence[str]], bool], Callable[[Sequence[str], str], Settings]], ...
] = (
    (is_printer_cfg, read_printer_cfg),
    (is_linuxcnc, read_linuxcnc),
    (is_fluidnc, read_fluidnc),
    (is_grbl, read_grbl),
    (is_config_g, read_config_g),
    (is_marlin, read_marlin),
)
"""Test and reader of each firmware. The order matters: macros of Klipper hold Marlin's commands."""
