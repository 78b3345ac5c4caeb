"""Limits of axes, drives and the tool."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import PlanError
from threadline.motion.timing.optimal.along_path import AlongPath

if TYPE_CHECKING:
    from threadline.machine import Machine

_LEAST_RAMP = 0.02  # of the time from rest to the velocity limit at the acceleration limit


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of the axes.

    Parameters
    ----------
    velocity, acceleration, jerk
        (axes,); a jerk may be infinite.
    demand
        (m, axes, 2) share of its drive's output (volts, current) that an axis needs for 1 m/s, and
        for 1 m/s^2; 0 for none. At the acceleration limit and zero velocity, no demand may exceed
        1.
    deceleration
        (axes,) braking limits, if they differ from ``acceleration``.
    along
        Limits of the tool along its path and across it.
    """

    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    demand: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 2)))
    deceleration: FloatArray | None = None
    along: AlongPath | None = None

    @property
    def accelerations(self) -> tuple[FloatArray, FloatArray]:
        """(axes,) limits of speeding up, and of braking."""
        braking = self.acceleration if self.deceleration is None else self.deceleration
        return self.acceleration, braking

    @property
    def largest_acceleration(self) -> FloatArray:
        """(axes,) the higher limit of speeding up and braking."""
        return np.maximum(*self.accelerations)

    def with_length(self) -> Limits:
        """Return the limits with those along the path as one more axis: the travelled length."""
        if self.along is None:
            return self
        path_limits = self.along
        speeding, braking = (
            np.append(limit, along)
            for limit, along in zip(self.accelerations, path_limits.accelerations, strict=True)
        )
        return replace(
            self,
            velocity=np.append(self.velocity, path_limits.velocity),
            acceleration=speeding,
            jerk=np.append(self.jerk, path_limits.jerk),
            demand=np.pad(self.demand, ((0, 0), (0, 1), (0, 0))),
            deceleration=None if np.array_equal(speeding, braking) else braking,
        )

    def ramp_s(self, fastest: FloatArray) -> float:
        """Return the approximate time of the jerk phase to the acceleration or velocity limit.

        It is the shortest of all axes, and no longer than any axis needs to reach its velocity: a
        velocity limit far above that changes nothing.

        Parameters
        ----------
        fastest
            (axes,) largest velocities of the motion.
        """
        to_limits = np.nanmin(self._ramps_s(self.velocity))
        return float(min(to_limits, np.nanmax(self._ramps_s(fastest))))

    def _ramps_s(self, velocity: FloatArray) -> FloatArray:
        """Return the jerk time of each axis, NaN for an axis without any limit."""
        with np.errstate(invalid="ignore"):
            by_jerk = np.fmin(self.acceleration / self.jerk, np.sqrt(velocity / self.jerk))
            by_acceleration = _LEAST_RAMP * velocity / self.acceleration
        return np.asarray(np.fmax(by_jerk, by_acceleration))


RESERVE = 0.1
"""Share of voltage and current kept for the loop, unless the machine file gives another."""
_UNITS = ("V at the controller", "V", "A")


def axis_limits(
    machine: Machine, axes: tuple[str, ...], radius_m: FloatArray | None = None
) -> Limits:
    """Return the limits of axes and tool, without limits of the drives.

    Parameters
    ----------
    radius_m
        (axes,) length at the tool of one unit of each axis, for limits along the path; by default
        the machine's.
    """
    columns = [machine.axis_names.index(axis) for axis in axes]
    speeding, braking = (limit[columns] for limit in machine.accelerations)
    return Limits(
        velocity=machine.velocity_limit[columns],
        acceleration=speeding,
        deceleration=None if np.array_equal(speeding, braking) else braking,
        jerk=machine.jerk_limit[columns],
        along=along_of(machine, machine.radius_m[columns] if radius_m is None else radius_m),
    )


def along_of(machine: Machine, radius_m: FloatArray) -> AlongPath | None:
    """Return the limits of a machine's tool along its path, None without any."""
    path_limits = machine.path
    if path_limits is None:
        return None
    velocity, acceleration, jerk, centripetal = (
        np.inf if limit is None else limit.si
        for limit in (
            path_limits.velocity,
            path_limits.acceleration,
            path_limits.jerk,
            path_limits.centripetal,
        )
    )
    return AlongPath(
        velocity=velocity,
        acceleration=acceleration,
        deceleration=None if path_limits.deceleration is None else path_limits.deceleration.si,
        jerk=jerk,
        centripetal=centripetal,
        radius_m=radius_m,
    )


def limits_of(
    machine: Machine,
    axes: tuple[str, ...],
    radius_m: FloatArray | None = None,
    *,
    of_loads: bool = False,
) -> Limits:
    """Return the limits of axes and tool, including limits of their drives.

    A drive gives the current that its bodies need, with all links rigid, and the voltage for it;
    sliding friction is subtracted from both beforehand, and so is the reserve for the loop.

    Parameters
    ----------
    radius_m
        As for ``axis_limits``.
    of_loads
        Whether loads follow the motion, by feed-forward. The voltage is then held over each tick,
        while the back EMF rises: the current is largest at the beginning of the tick. If motors
        follow the motion, the loops smooth this peak.

    Raises
    ------
    PlanError
        If friction and reserve leave a drive no output to move with.
    """
    limits = axis_limits(machine, axes, radius_m)
    demand = demands_of(machine, axes, of_loads=of_loads)
    with np.errstate(divide="ignore"):
        acceleration_of_drives = (1.0 / demand[:, :, 1]).min(axis=0)
    speeding, braking = (
        np.minimum(limit, acceleration_of_drives) for limit in limits.accelerations
    )
    return replace(
        limits,
        acceleration=speeding,
        deceleration=None if np.array_equal(speeding, braking) else braking,
        demand=demand[demand[:, :, 0].any(axis=1)],
    )


def reserve_of(machine: Machine, axis: str) -> tuple[float, float]:
    """Return the shares of voltage and of current of an axis that are kept for its loop."""
    amplifier = machine.drive_of(axis).amplifier
    voltage_reserve = RESERVE if amplifier.reserve is None else amplifier.reserve.si
    current_reserve = amplifier.current_reserve
    return voltage_reserve, voltage_reserve if current_reserve is None else current_reserve.si


def demands_of(machine: Machine, axes: tuple[str, ...], *, of_loads: bool = False) -> FloatArray:
    """Return (3, axes, 2) the shares of its limits that an axis needs for 1 m/s and for 1 m/s^2.

    The limits are the controller's output, the winding's voltage and its current, less friction and
    reserve; ``of_loads`` is as for ``limits_of``.

    Raises
    ------
    PlanError
        If friction and reserve leave a drive no output to move with.
    """
    demand = np.zeros((len(_UNITS), len(axes), 2))
    for k, axis in enumerate(axes):
        if machine.axes[axis].drive:  # a position interface: its torque is judged
            continue
        voltage_reserve, current_reserve = reserve_of(machine, axis)
        for m, (limit, (still, speed, push)) in enumerate(_needs(machine, axis, of_loads)):
            reserve = current_reserve if _UNITS[m] == "A" else voltage_reserve
            output_left = (1.0 - reserve) * limit - still
            if not output_left > 0.0:
                raise PlanError(
                    f"axis {axis}: friction takes {still:.3g} of the {limit:.3g} {_UNITS[m]} of "
                    f"drives.{machine.controller_of(axis).drive}, and {reserve:.0%} are kept for "
                    "its loop: nothing is left to move with",
                    place=machine.place,
                    remedy="Lower friction or reserve, or give the drive more.",
                )
            demand[m, k] = speed / output_left, push / output_left
    return demand


def _needs(machine: Machine, axis: str, of_loads: bool) -> list[tuple[float, FloatArray]]:
    """Return limit and need, at rest, per m/s and per m/s^2, in the order of ``_UNITS``."""
    from threadline.dynamics.eccentric import drive_limits, drive_needs  # loads the models

    current, winding = drive_needs(machine, axis)
    if of_loads and machine.drive_of(axis).amplifier.mode == "voltage":
        tick_s = float(machine.clock(machine.controller_of(axis).clock).period_s)
        decay_exponent = tick_s * winding[1] / winding[2]
        current = current * np.array([1.0, 1.0, decay_exponent / -np.expm1(-decay_exponent)])
    return [(limit, need) for limit, need, _ in drive_limits(machine, axis, current, winding)]
