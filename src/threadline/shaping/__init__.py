"""Input shapers designed exactly, their robustness, and on/off commands.

Frequencies are undamped, V is normalised to one unit impulse, insensitivity is (f_hi - f_lo) / f
at the tolerance, and the damping ratio is held while the frequency sweeps.
"""

from threadline.shaping.apply import longest_delay_s, on_tick_grid, shape_trajectory
from threadline.shaping.combine import convolve
from threadline.shaping.controller import ControllerLimits, Realised, realise
from threadline.shaping.designs import ShaperKind, design
from threadline.shaping.deviation import ShapingDeviation, shaping_deviation
from threadline.shaping.direct import Requirement, direct_shaper, specified_insensitivity
from threadline.shaping.direct_unit import direct_unit_magnitude
from threadline.shaping.higher_modes import HigherModes, check_higher_modes
from threadline.shaping.klipper import KlipperExport, klipper_export
from threadline.shaping.robustness import (
    Insensitivity,
    SensitivityMap,
    insensitivity,
    sensitivity_map,
)
from threadline.shaping.text import parse_mode_hz, parse_shaper
from threadline.shaping.types import UNSHAPED, FlexibleMode, Shaper, ShaperError
from threadline.shaping.vibration import (
    residual_vibration,
    residual_vibration_batch,
    vibration_of,
)

__all__ = [
    "UNSHAPED",
    "ControllerLimits",
    "FlexibleMode",
    "HigherModes",
    "Insensitivity",
    "KlipperExport",
    "Realised",
    "Requirement",
    "SensitivityMap",
    "Shaper",
    "ShaperError",
    "ShaperKind",
    "ShapingDeviation",
    "check_higher_modes",
    "convolve",
    "design",
    "direct_shaper",
    "direct_unit_magnitude",
    "insensitivity",
    "klipper_export",
    "longest_delay_s",
    "on_tick_grid",
    "parse_mode_hz",
    "parse_shaper",
    "realise",
    "residual_vibration",
    "residual_vibration_batch",
    "sensitivity_map",
    "shape_trajectory",
    "shaping_deviation",
    "specified_insensitivity",
    "vibration_of",
]
