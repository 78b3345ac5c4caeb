"""Default speed of the head's travel to the start of a contour, and default rest after it.

After the travel the machine swings: a speed v that ends at once leaves an amplitude of ``v / w`` in
a mode of ``w`` rad/s. The default speed is the one that leaves half of the placement in the slowest
mode. The default rest is the time after which a tenth of the placement is left in every mode.
"""

from __future__ import annotations

import math
from dataclasses import replace

from threadline.jobs.seam.settings import MOST_SETTLE_S, Stitching
from threadline.machine import Machine
from threadline.plant.modes import Oscillation
from threadline.plant.without_loop import modes_held
from threadline.recent import Recent

_SWING, _LEFT = 0.5, 0.1
# A search reads its seam again for every speed, and following a damping takes 64 sets of poles.
_RECENT: Recent[tuple[Machine, tuple[str, ...]], tuple[Oscillation, ...]] = Recent(
    4, lambda a, b: a[0] is b[0] and a[1] == b[1]
)


def with_journeys(
    settings: Stitching, modes: tuple[Oscillation, ...], fastest_m_s: float
) -> Stitching:
    """Return ``settings`` with defaults for the speed and rest of travels that were left out.

    Parameters
    ----------
    settings
        Stitching of the seam.
    modes
        Modes of the machine. Without any, the head travels as fast as it can and does not rest.
    fastest_m_s
        Largest speed of the machine.
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
    """Return the modes of the axes with their motors held still."""
    return _RECENT.of(
        (machine, axes),
        lambda: tuple(mode for axis in axes for mode in modes_held(machine, axis)),
    )
