"""Exact designs of input shapers, their robustness, and shapers for on/off commands.

Frequencies are undamped. The residual vibration V is normalised to the vibration of one unit
impulse. Insensitivity is (f_hi - f_lo) / f at the tolerance. The damping ratio is constant over a
frequency sweep.
"""

from typing import TYPE_CHECKING

from threadline.base.importing import later

if TYPE_CHECKING:
    from threadline.motion.shaping.apply import longest_delay_s, shape_trajectory
    from threadline.motion.shaping.controller import ControllerLimits, Realised, realise
    from threadline.motion.shaping.designs import (
        MOST_APART,
        ShaperKind,
        check_apart,
        convolve,
        design,
        parse_mode_hz,
        parse_shaper,
    )
    from threadline.motion.shaping.deviation import ShapingDeviation, shaping_deviation
    from threadline.motion.shaping.direct import Requirement, direct_shaper, specified_insensitivity
    from threadline.motion.shaping.direct_unit import (
        direct_unit_magnitude,
        unit_magnitude_over_bands,
    )
    from threadline.motion.shaping.firmwares import (
        FirmwareExport,
        klipper_export,
        marlin_export,
        reprap_export,
    )
    from threadline.motion.shaping.law_residual import Ringing, residual_m, ringing
    from threadline.motion.shaping.mode_law import (
        Demand,
        MadeLaw,
        made_law,
        outside,
        usual_jerk_m_s3,
    )
    from threadline.motion.shaping.response import (
        residual_vibration,
        residual_vibration_batch,
        vibration_of,
    )
    from threadline.motion.shaping.robustness import (
        HigherModes,
        Insensitivity,
        check_higher_modes,
        insensitivity,
    )
    from threadline.motion.shaping.shaped_law import ShapedWindow, shaped_windows
    from threadline.motion.shaping.types import UNSHAPED, FlexibleMode, Shaper, ShaperError

__all__ = [
    "MOST_APART", "UNSHAPED", "ControllerLimits", "Demand", "FirmwareExport", "FlexibleMode",
    "HigherModes", "Insensitivity", "MadeLaw", "Realised", "Requirement", "Ringing",
    "ShapedWindow", "Shaper", "ShaperError", "ShaperKind", "ShapingDeviation",
    "check_apart", "check_higher_modes", "convolve", "design", "direct_shaper",
    "direct_unit_magnitude", "insensitivity", "klipper_export", "longest_delay_s", "made_law",
    "marlin_export", "outside", "parse_mode_hz", "parse_shaper", "realise",
    "reprap_export", "residual_m", "residual_vibration", "residual_vibration_batch", "ringing",
    "shape_trajectory", "shaped_windows", "shaping_deviation",
    "specified_insensitivity", "unit_magnitude_over_bands", "usual_jerk_m_s3", "vibration_of",
]  # fmt: skip

__getattr__ = later(
    __name__,
    {
        "apply": "longest_delay_s shape_trajectory",
        "controller": "ControllerLimits Realised realise",
        "designs": "MOST_APART ShaperKind check_apart convolve design parse_mode_hz parse_shaper",
        "deviation": "ShapingDeviation shaping_deviation",
        "direct": "Requirement direct_shaper specified_insensitivity",
        "direct_unit": "direct_unit_magnitude unit_magnitude_over_bands",
        "firmwares": "FirmwareExport klipper_export marlin_export reprap_export",
        "law_residual": "Ringing residual_m ringing",
        "mode_law": "Demand MadeLaw made_law outside usual_jerk_m_s3",
        "response": "residual_vibration residual_vibration_batch vibration_of",
        "robustness": "HigherModes Insensitivity check_higher_modes insensitivity",
        "shaped_law": "ShapedWindow shaped_windows",
        "types": "UNSHAPED FlexibleMode Shaper ShaperError",
    },
)
