"""Speed, gear and motor from the demands of a product, before there is a machine file.

Nothing here needs a machine or its plant; seams and searches use the same formulas.
"""

from threadline.sizing.corner import (
    corner_acceleration_m_s2,
    corner_error_m,
    corner_speed_m_s,
    ramp_acceleration_m_s2,
)
from threadline.sizing.product import Demands
from threadline.sizing.result import SizeLine, Sizing
from threadline.sizing.size import size
from threadline.sizing.speed_profile import PROFILES, SpeedProfile

__all__ = [
    "PROFILES",
    "Demands",
    "SizeLine",
    "Sizing",
    "SpeedProfile",
    "corner_acceleration_m_s2",
    "corner_error_m",
    "corner_speed_m_s",
    "ramp_acceleration_m_s2",
    "size",
]
