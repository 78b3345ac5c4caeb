"""Input shapers designed exactly, their robustness, and on/off commands.

Frequencies are undamped, V is normalised to one unit impulse, insensitivity is (f_hi - f_lo) / f
at the tolerance, and the damping ratio is held while the frequency sweeps.
"""

from threadline.shaping.apart import MOST_APART, check_apart
from threadline.shaping.apply import longest_delay_s, on_tick_grid, shape_trajectory
from threadline.shaping.combine import convolve
from threadline.shaping.controller import ControllerLimits, Realised, realise
from threadline.shaping.designs import ShaperKind, design
from threadline.shaping.deviation import ShapingDeviation, shaping_deviation
from threadline.shaping.direct import Requirement, direct_shaper, specified_insensitivity
from threadline.shaping.direct_unit import direct_unit_magnitude
from threadline.shaping.direct_unit_bands import unit_magnitude_over_bands
from threadline.shaping.higher_modes import HigherModes, check_higher_modes
from threadline.shaping.klipper import KlipperExport, klipper_export
from threadline.shaping.law_residual import Ringing, residual_m, ringing
from threadline.shaping.mode_law import Demand, MadeLaw, made_law, outside, usual_jerk_m_s3
from threadline.shaping.robustness import (
    Insensitivity,
    SensitivityMap,
    insensitivity,
    sensitivity_map,
)
from threadline.shaping.shaped_law import ShapedWindow, shaped_law, shaped_windows
from threadline.shaping.text import parse_mode_hz, parse_shaper
from threadline.shaping.types import UNSHAPED, FlexibleMode, Shaper, ShaperError
from threadline.shaping.vibration import (
    residual_vibration,
    residual_vibration_batch,
    vibration_of,
)

__all__ = [
    "MOST_APART",
    "UNSHAPED",
    "ControllerLimits",
    "Demand",
    "FlexibleMode",
    "HigherModes",
    "Insensitivity",
    "KlipperExport",
    "MadeLaw",
    "Realised",
    "Requirement",
    "Ringing",
    "SensitivityMap",
    "ShapedWindow",
    "Shaper",
    "ShaperError",
    "ShaperKind",
    "ShapingDeviation",
    "check_apart",
    "check_higher_modes",
    "convolve",
    "design",
    "direct_shaper",
    "direct_unit_magnitude",
    "insensitivity",
    "klipper_export",
    "longest_delay_s",
    "made_law",
    "on_tick_grid",
    "outside",
    "parse_mode_hz",
    "parse_shaper",
    "realise",
    "residual_m",
    "residual_vibration",
    "residual_vibration_batch",
    "ringing",
    "sensitivity_map",
    "shape_trajectory",
    "shaped_law",
    "shaped_windows",
    "shaping_deviation",
    "specified_insensitivity",
    "unit_magnitude_over_bands",
    "usual_jerk_m_s3",
    "vibration_of",
]
