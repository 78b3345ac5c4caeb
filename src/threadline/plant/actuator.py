"""A motor with its amplifier on its own, as identified before a load is connected."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from threadline.arrays import ComplexArray
from threadline.machine import Machine
from threadline.plant.boundaries import swinging
from threadline.plant.linear_model import linear_model
from threadline.plant.rigid import current_needed, drive_rate, rigid_motion

_SINGULAR = 1e-12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Actuator:
    """The response from the controller's voltage to the motor's speed, with every link removed.

    Parameters
    ----------
    dc_gain
        Steady speed per volt, rad/s/V (m/s/V for a linear motor); None where the speed never
        settles.
    loaded_dc_gain
        Steady speed per volt with the load of the axis moving along, in the same unit.
    poles
        (n,) rad/s, without the integrator from speed to position.
    natural_rad_s, damping
        Natural frequency and damping ratio of the complex pole pair; None where all poles are real.
    delay_s
        Dead time between a voltage and its effect.
    """

    dc_gain: float | None
    loaded_dc_gain: float | None
    poles: ComplexArray
    natural_rad_s: float | None
    damping: float | None
    delay_s: float


def actuator_of(machine: Machine, axis: str) -> Actuator:
    """Return the actuator of an axis."""
    name = machine.controller_of(axis).drive
    drive = machine.motors[name]
    alone = dataclasses.replace(machine, links={})
    model = next(m for m in linear_model(alone) if f"drives.{name}" in m.inputs)
    rates = [model.states.index(f"{body}'") for body in drive.acts_on]
    coil = [k for k, state in enumerate(model.states) if state == f"{name}.i"]
    kept = rates + coil
    A = model.A[np.ix_(kept, kept)]
    b = model.B[kept, model.inputs.index(f"drives.{name}")]
    speed = np.array([q.si for q in drive.acts_on.values()] + [0.0] * len(coil))
    poles = np.asarray(np.linalg.eigvals(A), dtype=np.complex128)
    settles = float(np.abs(poles).min()) > _SINGULAR * max(1.0, float(np.abs(poles).max()))
    pair = swinging(A)
    return Actuator(
        dc_gain=float(-speed @ np.linalg.solve(A, b)) if settles else None,
        loaded_dc_gain=_loaded(machine, axis),
        poles=poles,
        natural_rad_s=float(abs(pair[0])) if len(pair) else None,
        damping=float(-pair[0].real / abs(pair[0])) if len(pair) else None,
        delay_s=0.0 if drive.delay is None else drive.delay.si,
    )


def fastest(machine: Machine, axis: str) -> float | None:
    """Return the speed of an axis that its motor reaches alone at full output, in m/s or rad/s.

    Nothing behind a belt can hurry it further for long. None where that speed never settles.
    """
    dc_gain, amplifier = actuator_of(machine, axis).dc_gain, machine.drive_of(axis).amplifier
    if dc_gain is None:
        return None
    volts = machine.controller_of(axis).dac.range.si
    if amplifier.mode == "voltage" and amplifier.voltage_limit is not None:
        volts = min(volts, amplifier.voltage_limit.si / amplifier.gain.si)
    turning = drive_rate(machine, axis, rigid_motion(machine, axis))
    return abs(dc_gain * volts / turning)


def _loaded(machine: Machine, axis: str) -> float | None:
    drive = machine.drive_of(axis)
    rates = rigid_motion(machine, axis)
    turning = drive_rate(machine, axis, rates)
    viscous = current_needed(machine, axis, 1.0, 0.0) - current_needed(machine, axis, 0.0, 0.0)
    friction = sum(
        abs(rates[n]) * b.friction.si for n, b in machine.bodies.items() if b.friction is not None
    )
    viscous -= friction / (turning * drive.torque_constant.si)
    gain = drive.amplifier.gain.si
    if drive.amplifier.mode == "current":
        return None if viscous <= 0 else gain * turning / viscous
    volts = drive.resistance.si * viscous + drive.back_emf.si * turning
    return None if volts <= 0 else gain * turning / volts
