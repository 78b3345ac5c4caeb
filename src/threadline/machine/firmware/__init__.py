"""Settings of firmwares (grbl, FluidNC, Marlin, Klipper) -> a machine file."""

from threadline.machine.firmware.answers import Answers, parse_answers
from threadline.machine.firmware.read import read_settings
from threadline.machine.firmware.settings import AxisSettings, Settings
from threadline.machine.firmware.write import machine_text

__all__ = [
    "Answers",
    "AxisSettings",
    "Settings",
    "machine_text",
    "parse_answers",
    "read_settings",
]
