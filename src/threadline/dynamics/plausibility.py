"""Warnings about contradictory or improbable numbers of a machine."""

from __future__ import annotations

import numpy as np

from threadline.dynamics.eccentric import (
    current_needed,
    drive_limits,
    drive_needs,
    drive_rate,
    drive_unit,
    rigid_force,
    rigid_motion,
)
from threadline.dynamics.pneumatic import short_of_torque
from threadline.dynamics.sampled import difference_equation
from threadline.dynamics.values import Values
from threadline.machine import Machine
from threadline.machine.controllers import StateSpaceController
from threadline.machine.parts import Axis

_VISCOUS_SHARE = 0.5
_CONSTANTS_APART = 0.05
_SCALES_APART = 0.01
_DEAD_COUNTS = 5.0
_ROUNDING_FACTOR = 1.0 + 1e-9
_MAX_LIMIT_RATIO = (
    1.05  # allowed ratio of an axis limit to its drive's limit: data sheets round numbers
)


def plausibility_warnings(machine: Machine) -> list[str]:
    """Return one sentence for every suspicious number.

    The following is suspicious:

    - torque and back-emf constants that differ by more than 5 % (in SI they are equal),
    - counts of an axis that differ from the counts of its sensor, through belt and gear, by more
      than 1 % plus tolerances,
    - an inductance together with the voltage limit of a current amplifier, because the current loop
      is not simulated,
    - friction that takes at least half of a motor's current at the axis' working speed,
    - a velocity or acceleration limit of an axis more than 5 % above the capability of its motor
      and amplifier,
    - a working speed and an acceleration limit that together need more current, or more torque of a
      stepper or pulse servo, than the drive has,
    - a controller that rounds a static error of several counts to zero DAC levels,
    - a rotary cylinder whose torque is too small to bring its load to speed within its lag.
    """
    if machine.without_dynamics:
        return []
    warnings = [text for name in machine.motors for text in _unequal_constants(machine, name)]
    warnings += [text for name in machine.motors for text in _coil_left_out(machine, name)]
    for name in machine.axes:
        if machine.source_of(name) is not None:
            warnings += _beyond_torque(machine, name)
            continue
        warnings += _scale_contradicted(machine, name)
        warnings += _high_damping(machine, name)
        warnings += _beyond_drive(machine, name)
        warnings += _beyond_current(machine, name)
        warnings += _dead_band(machine, name)
    return [*warnings, *short_of_torque(machine)]


def _unequal_constants(machine: Machine, name: str) -> list[str]:
    drive = machine.motors[name]
    torque, emf = drive.torque_constant, drive.back_emf
    if emf.si <= 0 and drive.amplifier.mode == "current":
        return []  # a current amplifier compensates the back-emf
    difference = emf.si / torque.si - 1.0
    if abs(difference) <= _CONSTANTS_APART:
        return []
    return [
        f"drives.{name}: torque_constant {torque.si:.4g} N m/A and back_emf {emf.si:.4g} V s/rad "
        f"should be the same number; they disagree by {abs(difference) * 100:.0f} %"
    ]


def _coil_left_out(machine: Machine, name: str) -> list[str]:
    """Return a warning if the current loop of an amplifier would need its voltage limit."""
    drive = machine.motors[name]
    volts = drive.amplifier.voltage_limit
    if drive.amplifier.mode != "current" or volts is None or drive.inductance is None:
        return []
    rise_s = drive.inductance.si / volts.si
    return [
        f"drives.{name}: its current follows at once where voltage_limit suffices for resistance "
        f"and back EMF; the rise against the inductance, {1e3 * rise_s:.2g} ms for each ampere at "
        f"{volts.si:.4g} V, is not simulated"
    ]


def _scale_contradicted(machine: Machine, name: str) -> list[str]:
    """Return a warning if the counts of an axis contradict those of its sensor and the gearing.

    This finds forgotten quadrature (four counts per line) and misplaced decimal points.
    """
    axis = machine.axes[name]
    if axis.load is None:  # the load is then the position of the encoder
        return []
    sensor_name = machine.controller_of(name).sensor
    rates = rigid_motion(machine, name)
    reads = machine.sensors[sensor_name].reads
    through_gears = sum(q.si * rates[b] for b, q in reads.items())
    links = [q for link in machine.links.values() for q in link.stretch.values()]
    numbers = [axis.counts, *reads.values(), *axis.load.values(), *links]
    allowed = _SCALES_APART + sum(q.tolerance_si / abs(q.si) for q in numbers if q.si)
    if abs(through_gears / axis.counts.si - 1.0) <= allowed:
        return []
    consequence = (
        f"would move {axis.counts.si / through_gears:.4g} times as far as commanded"
        if through_gears
        else "would not move"
    )
    return [
        f"axes.{name}: counts is {axis.counts.si:.6g} per m or rad, but through belt and gear "
        f"sensors.{sensor_name} gives {through_gears:.6g}: the load {consequence}"
    ]


def _high_damping(machine: Machine, name: str) -> list[str]:
    axis = machine.axes[name]
    drive_name = machine.controller_of(name).drive
    drive = machine.motors[drive_name]
    limit = drive.amplifier.current_limit
    if limit is None or axis.working_velocity is None:
        return []
    speed = axis.working_velocity.si
    rates = rigid_motion(machine, name)
    drive_per_axis = drive_rate(machine, name, rates)
    driven = [b for b in drive.acts_on if machine.bodies[b].damping is not None]
    motor_a = 0.0
    for body in driven:
        damping = machine.bodies[body].damping
        assert damping is not None
        motor_a += (
            rates[body] ** 2 * damping.si * speed / (drive_per_axis * drive.torque_constant.si)
        )
    needed_a = current_needed(machine, name, speed, 0.0)
    if needed_a < _VISCOUS_SHARE * limit.si:
        return []
    dampings = ", ".join(f"{machine.bodies[b].damping.si:.3g}" for b in driven)  # type: ignore[union-attr]
    return [
        f"axes.{name}: at its working speed of {_speed(axis, speed)} the motor's damping of "
        f"{dampings} "
        f"N m s/rad takes {motor_a:.1f} A of the {limit.si:g} A of drives.{drive_name}, all "
        "friction "
        f"{needed_a:.1f} A; check the damping"
    ]


def _beyond_current(machine: Machine, name: str) -> list[str]:
    axis = machine.axes[name]
    drive_name = machine.controller_of(name).drive
    limit = machine.motors[drive_name].amplifier.current_limit
    if limit is None or axis.working_velocity is None:
        return []
    speed, acceleration = axis.working_velocity.si, axis.acceleration.si
    needed_a = current_needed(machine, name, speed, acceleration)
    if needed_a <= limit.si * _ROUNDING_FACTOR:
        return []
    unit = "m/s^2" if axis.kind == "linear" else "rad/s^2"
    spare_a = limit.si - current_needed(machine, name, speed, 0.0)
    per_acceleration = current_needed(machine, name, 0.0, 1.0)
    left_acceleration = f"{max(spare_a, 0.0) / per_acceleration:.3g} {unit}"
    return [
        f"axes.{name}: a reference that reaches {_speed(axis, speed)} at the allowed "
        f"{acceleration:.4g} {unit} needs {needed_a:.1f} A, more than the {limit.si:g} A of "
        f"drives.{drive_name}; at that speed {left_acceleration} are left"
    ]


def _beyond_drive(machine: Machine, name: str) -> list[str]:
    """Return a warning for each limit of an axis far above the capability of its drive.

    The speed is the final speed without acceleration, and the acceleration is from rest, both with
    sliding friction.
    """
    axis = machine.axes[name]
    drive = machine.controller_of(name).drive
    needs = drive_limits(machine, name, *drive_needs(machine, name))
    warnings = []
    for limit_name, limit, column, unit in (
        ("velocity", axis.velocity.si, 1, "/s"),
        ("acceleration", axis.acceleration.si, 2, "/s^2"),
    ):
        reached, why = min(
            (
                (
                    max(drive_limit - needs_of_limit[0], 0.0) / needs_of_limit[column],
                    limit_text.format(drive_limit),
                )
                for drive_limit, needs_of_limit, limit_text in needs
                if needs_of_limit[column] > 0.0 and np.isfinite(drive_limit)
            ),
            default=(np.inf, ""),
        )
        if limit > _MAX_LIMIT_RATIO * reached:
            warnings.append(
                f"axes.{name}: {limit_name} is {_shown(axis, limit)}{unit} in the machine file, "
                "but "
                f"drives.{drive} reaches at most {_shown(axis, reached)}{unit}, with the {why}: "
                f"the machine would lag behind a faster plan; lower axes.{name}.{limit_name}"
            )
    return warnings


def _shown(axis: Axis, value_si: float) -> str:
    """Return a value in m or degrees, without the time part of its unit."""
    return f"{value_si:.4g} m" if axis.kind == "linear" else f"{np.degrees(value_si):.4g} deg"


def _beyond_torque(machine: Machine, name: str) -> list[str]:
    """Return warnings about an axis that needs more torque than its stepper or pulse servo has.

    Also check its counts.
    """
    axis, source = machine.axes[name], machine.source_of(name)
    assert source is not None
    drive = axis.drive
    rates = rigid_motion(machine, name)
    gear_ratio = rates[source.body] * source.counts / axis.counts.si
    warnings = []
    allowed = _SCALES_APART + sum(
        q.tolerance_si / abs(q.si)
        for q in [axis.counts, *(q for p in machine.links.values() for q in p.stretch.values())]
        if q.si
    )
    if axis.load is not None and abs(gear_ratio - 1.0) > allowed:
        warnings.append(
            f"axes.{name}: counts is {axis.counts.si:.6g} per m or rad, but drives.{drive} gives "
            f"{source.counts * rates[source.body]:.6g} through belt and gear"
        )
    speed = axis.velocity.si
    force = rigid_force(machine, name, speed, axis.acceleration.si)
    drive_per_axis = abs(drive_rate(machine, name, rates))
    needed = force / drive_per_axis
    torque_at_speed = float(source.most_torque(np.array([speed * drive_per_axis]))[0])
    if needed > torque_at_speed * _ROUNDING_FACTOR:
        unit = "m/s^2" if axis.kind == "linear" else "rad/s^2"
        needed_text = f"{needed:.4g} {drive_unit(machine, name)}"
        warnings.append(
            f"axes.{name}: at its limits, {_speed(axis, speed)} and {axis.acceleration.si:.4g} "
            f"{unit}, drives.{drive} needs {needed_text} but has {torque_at_speed:.4g}"
        )
    return warnings


def _dead_band(machine: Machine, name: str) -> list[str]:
    """Return a warning if a static error of several counts rounds to zero DAC levels."""
    controller = machine.axes[name].controller
    if isinstance(machine.controllers[controller], StateSpaceController):
        return []  # it may integrate, and its output at rest depends on all of its readings
    b, a = difference_equation(machine, controller, Values.of(machine))
    denominator_sum = 1.0 + float(a[0].sum())
    if abs(denominator_sum) < _ROUNDING_FACTOR - 1.0:
        return []
    static_gain = float(b[0].sum()) / denominator_sum
    if static_gain <= 0 or 0.5 / static_gain < _DEAD_COUNTS:
        return []
    band = 0.5 / static_gain
    axis = machine.axes[name]
    band_si = band / axis.counts.si
    band_text = (
        f"{band_si * 1e3:.3g} mm" if axis.kind == "linear" else f"{np.degrees(band_si):.3g} deg"
    )
    return [
        f"controllers.{controller}: its static gain is {static_gain:.3g} DAC levels per count, "
        "so an "
        f"error of up to {band:.0f} counts ({band_text}) on axis {name} is rounded to 0"
    ]


def _speed(axis: Axis, speed_si: float) -> str:
    return f"{speed_si:.4g} m/s" if axis.kind == "linear" else f"{speed_si:.4g} rad/s"
