"""An axis with rigid links: the motion of its bodies, and the force and current that it takes."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.quantity import LEAST_SI

_CREEP = 1e-12  # m/s or rad/s: sliding, and nothing else


def current_needed(
    machine: Machine, axis: str, velocity_si: float, acceleration_si: float
) -> float:
    """Return the current in A that an axis needs at a velocity and acceleration, all links rigid.

    Parameters
    ----------
    velocity_si, acceleration_si
        Velocity and acceleration of the axis, in m/s and m/s^2 or rad/s and rad/s^2.

    Raises
    ------
    MachineError
        If the axis moves without its drive.
    """
    rates = rigid_motion(machine, axis)
    drive = machine.drive_of(axis)
    turning = drive_rate(machine, axis, rates)
    force = rigid_force(machine, axis, velocity_si, acceleration_si)
    return float(force / (turning * drive.torque_constant.si))


def drive_needs(machine: Machine, axis: str) -> tuple[FloatArray, FloatArray]:
    """Return what an axis needs of its motor, all links rigid: current in A, voltage in V.

    Returns
    -------
    tuple
        Two (3,): to overcome sliding friction, more for 1 m/s or rad/s, and more for 1 m/s^2 or
        rad/s^2; the voltage is that across the winding.
    """
    drive = machine.drive_of(axis)
    turning = abs(drive_rate(machine, axis, rigid_motion(machine, axis)))
    still, moving = (abs(current_needed(machine, axis, speed, 0.0)) for speed in (_CREEP, 1.0))
    push = abs(current_needed(machine, axis, 0.0, 1.0))
    current = np.array([still, moving - still, push])
    winding = drive.resistance.si * current
    winding[1] += drive.back_emf.si * turning
    return current, winding


def drive_limits(
    machine: Machine, axis: str, current: FloatArray, winding: FloatArray
) -> list[tuple[float, FloatArray, str]]:
    """Return the limits of an axis' drive, each beside the needs that it is a limit of.

    They are those of the controller's output and of the winding's voltage in V, and of the current
    in A; infinite where the file has none. ``current`` and ``winding`` are as from ``drive_needs``.

    Returns
    -------
    list
        Limit, (3,) needs in its unit, and what the limit is called.
    """
    amplifier = machine.drive_of(axis).amplifier
    told = (winding if amplifier.mode == "voltage" else current) / amplifier.gain.si
    most_v, most_a = (
        np.inf if limit is None else limit.si
        for limit in (amplifier.voltage_limit, amplifier.current_limit)
    )
    return [
        (machine.controller_of(axis).dac.range.si, told, "full output of the controller, {:.4g} V"),
        (most_v, winding, "voltage_limit of {:.4g} V"),
        (most_a, current, "current_limit of {:.4g} A"),
    ]


def rigid_force(machine: Machine, axis: str, velocity_si: float, acceleration_si: float) -> float:
    """Return the force in N (torque in N m) in the coordinate of the axis, all links rigid."""
    rates = rigid_motion(machine, axis)
    force = 0.0
    for name, body in machine.bodies.items():
        rate = rates[name]
        damping = 0.0 if body.damping is None else body.damping.si
        friction = 0.0 if body.friction is None else body.friction.si
        force += rate * rate * (body.inertia.si * acceleration_si + damping * velocity_si)
        force += abs(rate) * friction * np.sign(velocity_si)
    return float(force)


def drive_unit(machine: Machine, axis: str) -> str:
    """Return the unit of the torque or force of an axis' stepper or pulse servo: "N m" or "N"."""
    source = machine.source_of(axis)
    assert source is not None
    return "N" if machine.bodies[source.body].kind == "linear" else "N m"


def drive_rate(machine: Machine, axis: str, rates: dict[str, float]) -> float:
    """Return the angle of an axis's drive, in rad (m), for 1 m or rad of the axis.

    Parameters
    ----------
    rates
        Rates of the bodies, from ``rigid_motion``.

    Raises
    ------
    MachineError
        If the drive does not turn, or too little for a division by it.
    """
    source = machine.source_of(axis)
    if source is not None:
        turning = rates[source.body]
    else:
        turning = sum(q.si * rates[b] for b, q in machine.drive_of(axis).acts_on.items())
    if abs(turning) < LEAST_SI:
        raise MachineError(
            f"axes.{axis}: its load moves, and its drive does not turn with it",
            remedy="Look at the links between them, and at what the drive acts on.",
        )
    return turning


def rigid_motion(machine: Machine, axis: str) -> dict[str, float]:
    """Return the rate of every body when the axis moves at 1 m/s or rad/s and nothing stretches.

    Bodies that are not connected with the axis have the rate 0.
    """
    bodies = list(machine.bodies)
    rows: list[FloatArray] = []
    for link in machine.links.values():
        if link.stiffness.si > 0:
            rows.append(_row(bodies, {b: q.si for b, q in link.stretch.items()}))
    part = machine.axes[axis]
    if part.load is not None:
        rows.append(_row(bodies, {b: q.si for b, q in part.load.items()}))
    elif source := machine.source_of(axis):
        rows.append(_row(bodies, {source.body: source.counts / part.counts.si}))
    else:
        sensor = machine.sensors[machine.controller_of(axis).sensor]
        rows.append(_row(bodies, {b: q.si / part.counts.si for b, q in sensor.reads.items()}))
    wanted = np.zeros(len(rows))
    wanted[-1] = 1.0
    # Lengths and angles differ by orders of magnitude: the least squares are scaled per body.
    matrix = np.array(rows)
    scale = np.maximum(np.abs(matrix).max(axis=0), 1e-30)
    solution = np.linalg.lstsq(matrix / scale, wanted, rcond=None)[0] / scale
    return dict(zip(bodies, solution.tolist(), strict=True))


def _row(bodies: list[str], weights: dict[str, float]) -> FloatArray:
    return np.array([weights.get(b, 0.0) for b in bodies])
