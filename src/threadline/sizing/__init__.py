"""Sizing of speed, gear and motor from the demands of a product, without a machine file.

Seams and searches use the same formulas.
"""

from threadline.sizing.profiles import (
    PROFILES,
    SpeedProfile,
    corner_acceleration_m_s2,
    corner_error_m,
    corner_speed_m_s,
    ramp_acceleration_m_s2,
)
from threadline.sizing.size import Demands, SizeLine, Sizing, size

__all__ = [
    "PROFILES", "Demands", "SizeLine", "Sizing", "SpeedProfile", "corner_acceleration_m_s2",
    "corner_error_m", "corner_speed_m_s", "ramp_acceleration_m_s2", "size",
]  # fmt: skip
