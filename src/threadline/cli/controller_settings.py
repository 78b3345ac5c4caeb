"""What an operator sets for the feed and the share of the limits that a search has found."""

from __future__ import annotations

import math
from collections.abc import Iterator

from threadline.machine import Machine
from threadline.machine.motion_planner import GrblPlanner, KlipperPlanner
from threadline.search import Rung

_GRBL_FIRST = 120  # $120 to $122: the accelerations of X, Y and Z; A, B and C follow
_GRBL_AXES = "XYZABC"


def settings_words(machine: Machine, best: Rung, *, limits: bool) -> Iterator[str]:
    """Yield lines with F and the accelerations of the axes, as the machine's controller has them.

    Firmwares count in mm and degrees. Nothing is said where no feed passes.

    Parameters
    ----------
    limits
        Whether a share of the limits was searched.
    """
    if best.found.best is None:
        return
    yield (
        f"to set: F {60_000.0 * best.found.best:.6g} as the speed of the fastest axis in mm/min "
        "(a rotary axis at its radius)"
    )
    if not limits:
        return
    shares = []
    for name, axis in machine.axes.items():
        turns = axis.kind == "rotary"
        value = axis.acceleration.si * best.share * (math.degrees(1.0) if turns else 1e3)
        unit = "deg/s^2" if turns else "mm/s^2"
        told = f"{name} {value:.4g} {unit}"
        if isinstance(machine.planner, GrblPlanner) and name in _GRBL_AXES:
            told = f"${_GRBL_FIRST + _GRBL_AXES.index(name)}={value:.3f} ({name}, {unit})"
        shares.append(told)
    where = ""
    if machine.planner is not None and not isinstance(machine.planner, GrblPlanner):
        where = " (max_accel)" if isinstance(machine.planner, KlipperPlanner) else " (M201)"
    yield f"accelerations{where}: {', '.join(shares)}"
