"""How the head goes to where a contour begins, when the seam file does not say.

A springy machine swings after a journey: a speed v that ends at once leaves ``v / w`` in a mode of
``w`` rad/s. The speed is taken so that this is half of the placement in the slowest mode, and the
head then rests until a tenth of the placement is left in every mode.
"""

from __future__ import annotations

import math
from dataclasses import replace

from threadline.jobs.seam.settings import MOST_SETTLE_S, Stitching
from threadline.machine import Machine
from threadline.plant.modes import Oscillation, locked_modes

_SWING, _LEFT = 0.5, 0.1


def with_journeys(
    settings: Stitching, modes: tuple[Oscillation, ...], fastest_m_s: float
) -> Stitching:
    """Return ``settings`` with speed and rest of a journey where they were left out.

    Parameters
    ----------
    modes
        Of the machine; one without modes goes as fast as it can and does not rest.
    fastest_m_s
        What the machine can do.
    """
    omegas = [2.0 * math.pi * mode.frequency_hz for mode in modes]
    speed = settings.travel_speed_m_s
    if speed is None and omegas:
        speed = _SWING * settings.placement_m * min(omegas)
    settle = settings.settle_s
    if settle is None:
        settle = 0.0
        for omega, mode in zip(omegas, modes, strict=True):
            reached = fastest_m_s if speed is None else min(speed, fastest_m_s)
            swings = reached / omega / (_LEFT * settings.placement_m)
            if swings > 1.0 and mode.damping > 0.0:
                settle = max(settle, math.log(swings) / (mode.damping * omega))
    return replace(settings, travel_speed_m_s=speed, settle_s=min(settle, MOST_SETTLE_S))


def swinging_modes(machine: Machine, axes: tuple[str, ...]) -> tuple[Oscillation, ...]:
    """Return the modes of the axes with their motors held."""
    return tuple(mode for axis in axes for mode in locked_modes(machine, axis))
