"""A machine for planners that know one acceleration for each axis, and nothing along the path."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from threadline.arrays import FloatArray
from threadline.machine.model import Machine
from threadline.machine.parts import Axis


def within_path(machine: Machine, axes: tuple[str, ...], radius_m: FloatArray) -> Machine:
    """Return ``machine`` with lower limits of ``axes`` in place of those along the path.

    However the axes move within them together, the velocity, acceleration and jerk of the tool are
    no longer as vectors than what ``[path]`` allows: whatever knows of axes alone may plan with it.
    The acceleration is then within the centripetal limit, too. Of two axes that could do the same,
    one that moves alone gets 0.71 of what the path allows. A jerk along the path is more than the
    vector of the jerk where a slow motion turns: there the limit may still be exceeded. An axis
    that brakes otherwise than it speeds up is left with the lower of the two limits.

    Parameters
    ----------
    axes
        Those that move.
    radius_m
        (axes,) length at the tool of one unit of each.
    """
    braking = any(machine.axes[axis].deceleration is not None for axis in axes)
    if machine.path is None and not braking:
        return machine
    own = machine.path
    velocity = jerk = push = None
    if own is not None:
        velocity, jerk = own.velocity, own.jerk
        pushes = [q for q in (own.acceleration, own.deceleration, own.centripetal) if q is not None]
        push = min(pushes, key=lambda limit: limit.si, default=None)
    column = [machine.axis_names.index(axis) for axis in axes]
    limits = {
        name: limit[column] if most is None else _shared(limit[column], most.si, radius_m)
        for name, limit, most in (
            ("velocity", machine.velocity_limit, velocity),
            ("acceleration", machine.acceleration_limit, push),
            ("jerk", machine.jerk_limit, jerk),
        )
    }
    limited = {
        axis: _with(machine.axes[axis], {name: float(of[j]) for name, of in limits.items()})
        for j, axis in enumerate(axes)
    }
    return replace(machine, axes={**machine.axes, **limited}, path=None)


def _shared(limit: FloatArray, most: float, radius_m: FloatArray) -> FloatArray:
    """Return (axes,) limits whose vector at the tool is no longer than ``most``."""
    alone = np.minimum(limit, most / radius_m)
    size = float(np.linalg.norm(alone * radius_m))
    return np.asarray(alone * min(1.0, most / size))


def _with(axis: Axis, limits: dict[str, float]) -> Axis:
    length = "m" if axis.kind == "linear" else "rad"
    jerk = axis.jerk
    if np.isfinite(limits["jerk"]):
        jerk = replace(jerk or axis.acceleration, unit=f"{length}/s^3", si=limits["jerk"])
    return replace(
        axis,
        velocity=replace(axis.velocity, si=limits["velocity"]),
        acceleration=replace(axis.acceleration, si=limits["acceleration"]),
        deceleration=None,
        jerk=jerk,
    )
