"""The zero-vibration train that Marlin plays for ``M593``.

Source: Marlin 2.1, ``Stepper::set_shaping_damping_ratio`` and ``set_shaping_frequency``: an echo
half a period of F after the move, the shares of both in 128ths. So F is the damped frequency.
"""

from __future__ import annotations

import math

import numpy as np

from threadline.shaping.types import FlexibleMode, Shaper

_PARTS = 128.0


def damped_frequency_hz(mode: FlexibleMode) -> float:
    """Return the F of ``M593`` for a mode."""
    return mode.frequency_hz * math.sqrt(1.0 - mode.damping_ratio**2)


def marlin_impulses(frequency_hz: float, damping_ratio: float) -> Shaper:
    """Return the impulses of ``M593 F D``; ``damping_ratio`` lies in [0, 1)."""
    powers = damping_ratio ** np.arange(4)
    fitted = np.array([64.44056192, -99.02008832, -7.58095488, 43.073216]) @ powers
    echo = 64.0 if damping_ratio <= 0.0 else math.floor(fitted)
    return Shaper(
        amplitudes=np.array([_PARTS - echo, echo]) / _PARTS,
        times_s=np.array([0.0, 0.5 / frequency_hz]),
        name="marlin zv",
    )
