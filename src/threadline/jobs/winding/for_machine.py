"""Warnings about a winding on its machine: a planner that jumps, a brake set otherwise."""

from __future__ import annotations

from pathlib import Path

from threadline.errors import Place
from threadline.jobs.winding.layers import Winding
from threadline.machine import Machine
from threadline.machine.motion_planner import MarlinPlanner
from threadline.machine.spool import Spool
from threadline.machine.tool import Tool

_LINEAR = ("X", "Y", "Z")  # letters whose way is the length of a move
_OFF = 0.05  # of a tension, as the winder thesis lets it vary


def turning_at_once(machine: Machine, tool: Tool, path: Path) -> tuple[str, ...]:
    """Return a warning if Marlin plans the mandrel as a rotary axis beside linear ones.

    Marlin then takes the length of a move, and the speed between two moves, from the linear axes
    alone. Where the carriage turns back, its travel vanishes, and so does this length: at the same
    speed in mm/s one move turns the mandrel several times as fast as the next.
    """
    if not isinstance(machine.planner, MarlinPlanner):
        return ()
    assert tool.turn is not None
    turn = tool.turn.axis
    along = "" if tool.along is None else tool.along.axis
    if turn in _LINEAR or along not in _LINEAR:
        return ()
    return (
        f"{Place(str(path))}: Marlin counts the speed of a move along {along} alone, so the speed "
        f"of {turn} jumps where {along} turns back. Wire the mandrel as X, Y or Z (overlay xyz of "
        "stepper-winder).",
    )


def other_tensions(machine: Machine, winding: Winding) -> tuple[str, ...]:
    """Return a warning for each layer whose tension the machine's spool does not give as it is.

    A brake that can be set follows the layers, but its spring arm may come to lie at a stop.
    """
    spool = machine.spool
    if spool is None:
        return ()
    if spool.most_torque is not None:
        return _beyond_the_arm(spool, winding)
    own = spool.tension_n
    found = []
    for layer in winding.layers:
        tension_n = layer.tension_n
        if tension_n is None or abs(own - tension_n) <= _OFF * tension_n:
            continue
        torque = spool.torque_for(tension_n)
        found.append(
            f"{Place(str(winding.path), layer.line)}: layer {layer.number} asks for a tension of "
            f"{tension_n:.3g} N, and the spool of {machine.name} gives {own:.3g} N: set its "
            f"brake to about {torque:.3g} N m for this layer."
        )
    return tuple(found)


def _beyond_the_arm(spool: Spool, winding: Winding) -> tuple[str, ...]:
    """Return a warning for each layer at whose tension the spring arm lies at a stop."""
    low, high = spool.floats_n
    found = []
    for layer in winding.layers:
        tension_n = layer.tension_n
        if tension_n is None or low < tension_n < high:
            continue
        stop = "lower" if tension_n <= low else "upper"
        found.append(
            f"{Place(str(winding.path), layer.line)}: layer {layer.number} asks for a tension of "
            f"{tension_n:.3g} N, at which the spring arm lies at its {stop} stop: it takes up "
            f"no change. It is free from {low:.3g} to {high:.3g} N: change spool.arm.preload, "
            "or the tension."
        )
    return tuple(found)
