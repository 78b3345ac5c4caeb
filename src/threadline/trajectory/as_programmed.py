"""Chords at exactly the programmed times, to be smoothed in time afterwards.

Velocity steps at every vertex, as in the linear interpolation of the 1994 controller, but no
travel time is rounded to ticks: a needle of constant speed stays one. Rapid moves, which have no
programmed time, go from rest to rest.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from threadline.arrays import FloatArray
from threadline.machine import Machine
from threadline.path.types import PieceBlock, PlannedPath
from threadline.plant.rigid import current_needed

# The law 10 u^3 - 15 u^4 + 6 u^5: its peaks, and where it is looked at for current.
_PEAKS = (1.875, 10.0 / np.sqrt(3.0), 60.0)
_U = np.linspace(0.0, 1.0, 65)
_SPEED = 30.0 * _U**2 * (1.0 - _U) ** 2
_ACCELERATION = 60.0 * _U * (1.0 - _U) * (1.0 - 2.0 * _U)
_CURRENT_SHARE = 0.8  # the rest is for what bends on the way


def as_programmed(path: PlannedPath, machine: Machine) -> Iterator[PieceBlock]:
    """Yield one timed piece per chord: straight at its programmed time, quintic where it is rapid.

    Parameters
    ----------
    path
        Chords, their nominal time 0 where they are rapid.
    machine
        Its limits are those of rapid moves.
    """
    for block in path:
        start, displacement = block.coefficients[:, 0], block.coefficients[:, 1]
        coefficients = np.zeros((len(block), 6, displacement.shape[1]))
        coefficients[:, 0] = start
        timed = block.nominal_s > 0
        coefficients[timed, 1] = displacement[timed]
        for power, factor in ((3, 10.0), (4, -15.0), (5, 6.0)):
            coefficients[~timed, power] = factor * displacement[~timed]
        duration = np.array(block.nominal_s)
        if not timed.all():
            duration[~timed] = rapid_time_s(displacement[~timed], path.axes, machine)
        yield PieceBlock(
            coefficients=coefficients,
            operation=block.operation,
            nominal_s=duration,
            rest_after=block.rest_after,
            dwell_s=block.dwell_s,
            line=block.line,
        )


def rapid_time_s(displacement: FloatArray, axes: tuple[str, ...], machine: Machine) -> FloatArray:
    """Return the (n,) least time of moves from rest to rest along the law 10 u^3 - 15 u^4 + 6 u^5.

    Within the limits of velocity, acceleration and jerk of every axis, and with four fifths of
    the current of its motor, all links taken as rigid.

    Parameters
    ----------
    displacement
        (n, axes) m or rad.
    """
    needed = np.zeros(len(displacement))
    for column, name in enumerate(axes):
        way = np.abs(displacement[:, column])
        axis = machine.axes[name]
        needed = np.maximum(needed, _PEAKS[0] * way / axis.velocity.si)
        needed = np.maximum(needed, np.sqrt(_PEAKS[1] * way / axis.acceleration.si))
        if axis.jerk is not None:
            needed = np.maximum(needed, np.cbrt(_PEAKS[2] * way / axis.jerk.si))
        needed = np.maximum(needed, _current_time_s(way, name, machine))
    return needed


def _current_time_s(way: FloatArray, axis: str, machine: Machine) -> FloatArray:
    """Return (n,) times at which the current of a rigid axis stays within its share.

    At each u the current is f + c v/T + k a/T^2, so that 1/T is bounded by a quadratic equation.
    """
    if machine.axes[axis].drive:  # told positions: its torque is judged
        return np.zeros(len(way))
    drive = machine.drive_of(axis)
    most = drive.amplifier.current_limit
    if most is None:
        return np.zeros(len(way))
    per_speed = current_needed(machine, axis, 2.0, 0.0) - current_needed(machine, axis, 1.0, 0.0)
    friction = current_needed(machine, axis, 1.0, 0.0) - per_speed
    spare = max(_CURRENT_SHARE * most.si - friction, 0.05 * most.si)
    a = current_needed(machine, axis, 0.0, 1.0) * way[:, None] * _ACCELERATION
    b = per_speed * way[:, None] * _SPEED
    # Where the motor brakes the curve may stay below its bound at any speed.
    root = np.sqrt(np.maximum(b * b + 4.0 * a * spare, 0.0))
    bound = np.where(b * b + 4.0 * a * spare >= 0.0, b + root, 0.0)
    return np.asarray((bound / (2.0 * spare)).max(axis=1))
