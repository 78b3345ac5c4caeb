"""Machine files from the settings of firmwares (grbl, FluidNC, Marlin, Klipper, RepRapFirmware)."""

from threadline.machine.firmware.axis_settings import AxisSettings, Settings
from threadline.machine.firmware.machine_text import machine_text
from threadline.machine.firmware.owner_answers import Answers, parse_answers
from threadline.machine.firmware.read import read_settings

__all__ = [
    "Answers",
    "AxisSettings",
    "Settings",
    "machine_text",
    "parse_answers",
    "read_settings",
]
