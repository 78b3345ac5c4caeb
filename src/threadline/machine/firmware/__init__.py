"""Machine files from the settings of controllers: grbl, FluidNC, Marlin, Klipper, RRF, LinuxCNC."""

from threadline.machine.firmware.axis_settings import (
    AxisSettings,
    Settings,
    SettingValue,
    number_or_nan,
)
from threadline.machine.firmware.machine_text import (
    DEFAULTS,
    Answers,
    Missing,
    check_answers,
    machine_text,
    missing_answers,
    names_dynamics,
    parse_answers,
    turning_axes,
)
from threadline.machine.firmware.read import read_settings

__all__ = [
    "DEFAULTS", "Answers", "AxisSettings", "Missing", "SettingValue", "Settings", "check_answers",
    "machine_text", "missing_answers", "names_dynamics", "number_or_nan", "parse_answers",
    "read_settings", "turning_axes",
]  # fmt: skip
