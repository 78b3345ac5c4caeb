"""Places and speeds of axes in messages to the operator, in mm and degrees."""

from __future__ import annotations

import math

from threadline.machine import Machine


def place_words(machine: Machine, axis: str, place: float) -> str:
    """Return a place of an axis, m or rad, as mm or degrees with the unit."""
    if machine.axes[axis].kind == "linear":
        return f"{1e3 * place:.5g} mm"
    return f"{math.degrees(place):.5g} deg"


def speed_words(machine: Machine, axis: str, speed: float) -> str:
    """Return a speed of an axis, m/s or rad/s, as mm/s or degrees/s with the unit."""
    return f"{place_words(machine, axis, speed)}/s"
