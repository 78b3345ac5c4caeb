"""From the demands of a product to a machine, before there is a machine file.

A room of its own because it needs neither machine nor plant, and seams and searches ask it alike.
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
