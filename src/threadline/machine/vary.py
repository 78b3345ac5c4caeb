"""Vary a machine: from run to run, to the ends of its tolerances, or with lower limits."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.errors import OptionError
from threadline.machine.model import Drive, Machine
from threadline.machine.parts import Axis, DcMotor
from threadline.machine.pneumatics import Cylinder
from threadline.machine.quantity import Provenance, Quantity
from threadline.machine.sources import Stepper

REPEAT_SEED = 1994
"""Seed of the runs of one machine."""
DAMPING_OF_DAYS = (0.7, 1.3)
"""Smallest and largest damping from run to run, as factors on the value in the file."""
FRICTION_OF_DAYS, SUPPLY_OF_DAYS, TENSION_OF_DAYS = (0.7, 1.3), (0.95, 1.05), (0.95, 1.05)
"""Smallest and largest friction, supply, and brake torque of a spool from run to run, as factors on
the values in the file."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Days:
    """Variation from run to run of a machine with control loops; the first run is nominal.

    Parameters
    ----------
    friction, supply
        (runs,) factors on the values in the file, as in ``vary``.
    phases
        (runs, axes) position of each encoder between two counts at the start, 0 to 1.
    tension
        (runs,) factors on the brake of a winder's spool.
    """

    friction: FloatArray
    supply: FloatArray
    phases: FloatArray
    tension: FloatArray

    def __len__(self) -> int:
        return len(self.friction)

    def taken(self, index: IntArray) -> Days:
        """Return the runs with the (k,) numbers ``index``."""
        return Days(
            friction=self.friction[index],
            supply=self.supply[index],
            phases=self.phases[index],
            tension=self.tension[index],
        )


def drawn_days(count: int, axes: int, random: np.random.Generator) -> Days:
    """Draw ``count`` runs: friction within +-30 %, supply within +-5 %, random encoder phases.

    The brake torque of a spool, within +-5 %, is drawn from a separate generator, so that machines
    without a spool keep the same days.
    """
    tension = np.random.default_rng((REPEAT_SEED, axes)).uniform(*TENSION_OF_DAYS, count)
    tension[:1] = 1.0
    friction, supply = np.ones(count), np.ones(count)
    phases = np.full((count, axes), 0.5)
    for day in range(1, count):
        friction[day] = random.uniform(*FRICTION_OF_DAYS)
        supply[day] = random.uniform(*SUPPLY_OF_DAYS)
        phases[day] = random.uniform(0.0, 1.0, axes)
    return Days(friction=friction, supply=supply, phases=phases, tension=tension)


def vary(
    machine: Machine, *, friction: float = 1.0, supply: float = 1.0, damping: float = 1.0,
    tension: float = 1.0,
) -> Machine:  # fmt: skip
    """Return ``machine`` with friction, supply and damping scaled.

    Parameters
    ----------
    friction
        Scales sliding friction and stiction of every body and every cylinder, and the friction of
        the guides behind a spool.
    supply
        Scales the voltage and current limits of amplifiers (not their gain, which is set by
        feedback) and the supply voltage of steppers' drivers. In cylinders it scales the stiffness
        of the air, which is proportional to the pressure. Their speed does not change: the flow
        through an exhaust flow control is choked below about half of the upstream pressure, and its
        volume flow then does not depend on that pressure.
    damping
        Scales the viscous damping of every body and every link.
    tension
        Scales the torque and stiction of the brake of a spool.

    Raises
    ------
    ValueError
        If a factor is not positive.
    """
    factors = friction, supply, damping, tension
    if not min(factors) > 0:
        raise ValueError(f"factors must be positive, got {', '.join(map(repr, factors))}")
    spool = machine.spool
    if spool is not None:
        spool = replace(
            spool,
            torque=replace(spool.torque, si=spool.torque.si * tension),
            stiction=_scaled(spool.stiction, tension),
            friction=_scaled(spool.friction, friction),
        )
    bodies = {
        name: replace(
            body,
            friction=_scaled(body.friction, friction),
            stiction=_scaled(body.stiction, friction),
            damping=_scaled(body.damping, damping),
        )
        for name, body in machine.bodies.items()
    }
    links = {
        name: replace(link, damping=_scaled(link.damping, damping))
        for name, link in machine.links.items()
    }
    drives: dict[str, Drive] = dict(machine.drives)
    for name, drive in machine.motors.items():
        drives[name] = replace(
            drive,
            amplifier=replace(
                drive.amplifier,
                voltage_limit=_scaled(drive.amplifier.voltage_limit, supply),
                current_limit=_scaled(drive.amplifier.current_limit, supply),
            ),
        )
    for name, source in machine.position_sources.items():
        if isinstance(source, Stepper) and source.winding is not None:
            voltage = source.winding.supply
            winding = replace(source.winding, supply=replace(voltage, si=voltage.si * supply))
            drives[name] = replace(source, winding=winding)
    cylinders = {
        name: replace(
            cylinder,
            friction=_scaled(cylinder.friction, friction),
            stiction=_scaled(cylinder.stiction, friction),
            **_air(cylinder, lambda number: replace(number, si=number.si * supply)),
        )
        for name, cylinder in machine.cylinders.items()
    }
    return replace(
        machine, bodies=bodies, links=links, drives=drives, cylinders=cylinders, spool=spool
    )


def varied_numbers(machine: Machine, days: Days) -> dict[str, FloatArray]:
    """Return the numbers that ``vary`` changes in a machine with control loops, for many days.

    The result has the (days,) SI values of each dotted name.
    """
    friction, supply = days.friction, days.supply
    values: dict[str, FloatArray] = {}
    spool = machine.spool
    factors = {"torque": days.tension, "stiction": days.tension, "friction": friction}
    for key, factor in factors.items() if spool is not None else ():
        number = getattr(spool, key)
        if number is not None:
            values[f"spool.{key}"] = number.si * factor
    for name, body in machine.bodies.items():
        for key, quantity in (("friction", body.friction), ("stiction", body.stiction)):
            if quantity is not None:
                values[f"bodies.{name}.{key}"] = quantity.si * friction
    for name, drive in machine.motors.items():
        limits = drive.amplifier
        for key, quantity in (
            ("voltage_limit", limits.voltage_limit),
            ("current_limit", limits.current_limit),
        ):
            if quantity is not None:
                values[f"drives.{name}.amplifier.{key}"] = quantity.si * supply
    return values


def off_tolerance(machine: Machine, *, mass: float = 0.0, stiffness: float = 0.0) -> Machine:
    """Return ``machine`` with loads and springs that deviate within their tolerances.

    Parameters
    ----------
    mass, stiffness
        Relative position in the tolerance: 1 is the upper end (heavier, stiffer), -1 the lower end.
        Loads are the bodies in ``load`` of an axis (by default the bodies of its drive) and the
        bodies that cylinders push. Springs are the links and the air of cylinders.
    """
    loads = {body for name in machine.axes for body in _carrying(machine, name)} | {
        cylinder.pushes for cylinder in machine.cylinders.values()
    }
    bodies = {
        name: replace(body, inertia=_off(body.inertia, mass)) if name in loads else body
        for name, body in machine.bodies.items()
    }
    links = {
        name: replace(link, stiffness=_off(link.stiffness, stiffness))
        for name, link in machine.links.items()
    }
    cylinders = {
        name: replace(cylinder, **_air(cylinder, lambda number: _off(number, stiffness)))
        for name, cylinder in machine.cylinders.items()
    }
    return replace(machine, bodies=bodies, links=links, cylinders=cylinders)


def corners(machine: Machine, share: float = 1.0) -> list[Machine]:
    """Return ``machine`` and the machines at the ends of the tolerances of loads and springs.

    These are nine machines, with the nominal machine first: nominal, lighter and heavier loads,
    each with nominal, softer and stiffer springs.

    Parameters
    ----------
    share
        Share of the tolerances at whose ends the machines are.

    Raises
    ------
    OptionError
        If no number of a load or a spring has a tolerance.
    """
    ends = (0.0, -share, share)
    machines = [off_tolerance(machine, mass=m, stiffness=k) for m in ends for k in ends]
    if machines[-1] == machine:
        raise OptionError(
            f"loads and springs of {machine.name} have no tolerances",
            remedy='Write them in the machine file: "111 kg +- 10 %".',
        )
    return machines


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Others:
    """Other machines that must pass as well.

    Parameters
    ----------
    name
        Description of the group.
    machines
        Pairs of a description of the difference from the machine of the file, and the machine.
    """

    name: str
    machines: tuple[tuple[str, Machine], ...]

    def __len__(self) -> int:
        return len(self.machines)


def ends_of(machine: Machine, share: float) -> Others:
    """Return the distinct other machines of ``corners``, each with a description.

    Raises
    ------
    OptionError
        If no number of a load or a spring has a tolerance.
    """
    descriptions = [
        " and ".join(filter(None, (mass, spring)))
        for mass in ("", "lighter loads", "heavier loads")
        for spring in ("", "softer springs", "stiffer springs")
    ]
    name = "at the ends of the tolerances of loads and springs"
    others: list[tuple[str, Machine]] = []
    for description, end_machine in zip(descriptions, corners(machine, share), strict=True):
        if end_machine != machine and all(
            end_machine != known_machine for _, known_machine in others
        ):
            others.append((description, end_machine))
    return Others(name=name, machines=tuple(others))


_BAND = 17  # number of machines in a band


def band_parts(share: float) -> list[float]:
    """Return the relative deviation of the modes of each machine of ``band_of``."""
    return [float(part) for part in np.linspace(-share, share, _BAND)]


def band_of(machine: Machine, share: float) -> Others:
    """Return machines whose mode frequencies cover a band, each made by ``mode_off``.

    Parameters
    ----------
    share
        Half width of the band, as a share of the frequency: 0.2 for +-20 %.

    Raises
    ------
    OptionError
        If the machine has no spring, or the band is not above 0 and below 1.
    """
    if not 0.0 < share < 1.0:
        raise OptionError(
            f"a band of +-{share * 100:g} % must be above 0 % and below 100 %",
            remedy='A fifth to either side is "20 %".',
        )
    if not machine.links:
        raise OptionError(
            f"{machine.name} has no link with a stiffness, and so no mode to be off",
            place=machine.place,
            remedy="Leave --band out, or write the springs of the machine as [links].",
        )
    others = (
        (f"modes at {part * 100.0:+.3g} %", mode_off(machine, part)) for part in band_parts(share)
    )
    return Others(name="with modes all over the band", machines=tuple(others))


def mode_off(machine: Machine, relative: float) -> Machine:
    """Return ``machine`` with its modes at (1 + ``relative``) times their frequencies.

    The stiffness of every link is multiplied by the square of this factor, and the viscous damping
    of every link and body by the factor, so that damping ratios do not change. The air in cylinders
    does not change.

    Raises
    ------
    ValueError
        If ``relative`` is not above -1.
    """
    if not relative > -1.0:
        raise ValueError(f"relative must be above -1, got {relative!r}")
    factor = 1.0 + relative
    links = {
        name: replace(link, stiffness=replace(link.stiffness, si=link.stiffness.si * factor**2))
        for name, link in machine.links.items()
    }
    return vary(replace(machine, links=links), damping=factor)


def with_reserve(machine: Machine, reserve: tuple[float, float] | None) -> Machine:
    """Return ``machine`` with shares of voltage and current of each drive reserved for its loop.

    With None the machine is returned unchanged. Drives without an amplifier have no reserve.
    """
    if reserve is None:
        return machine
    voltage_reserve, current_reserve = (
        Quantity(si=share, unit="", tolerance_si=0.0, provenance=Provenance.ASSUMED)
        for share in reserve
    )
    drives = {
        name: replace(
            drive,
            amplifier=replace(
                drive.amplifier, reserve=voltage_reserve, current_reserve=current_reserve
            ),
        )
        if isinstance(drive, DcMotor)
        else drive
        for name, drive in machine.drives.items()
    }
    return replace(machine, drives=drives)


def derate(machine: Machine, share: float) -> Machine:
    """Return ``machine`` with its acceleration and jerk limits multiplied by ``share``.

    The limits of braking and the limits along the path are multiplied as well.

    The following error of a loop grows with the acceleration. A plan with lower accelerations may
    therefore have a higher speed, and often takes less time, within the same tolerance.

    Raises
    ------
    ValueError
        If ``share`` is not in (0, 1].
    """
    if not 0.0 < share <= 1.0:
        raise ValueError(f"share must be in (0, 1], got {share!r}")
    if share == 1.0:
        return machine
    axes = {
        name: replace(
            axis,
            acceleration=replace(axis.acceleration, si=axis.acceleration.si * share),
            deceleration=_scaled(axis.deceleration, share),
            jerk=_scaled(axis.jerk, share),
        )
        for name, axis in machine.axes.items()
    }
    path_limits = machine.path
    if path_limits is not None:
        path_limits = replace(
            path_limits,
            acceleration=_scaled(path_limits.acceleration, share),
            deceleration=_scaled(path_limits.deceleration, share),
            jerk=_scaled(path_limits.jerk, share),
            centripetal=_scaled(path_limits.centripetal, share),
        )
    return replace(machine, axes=axes, path=path_limits)


def _carrying(machine: Machine, axis: str) -> Iterable[str]:
    """Return the bodies of an axis's load, by default the bodies of its drive."""
    load, source = machine.axes[axis].load, machine.source_of(axis)
    if load is not None:
        return load
    return machine.drive_of(axis).acts_on if source is None else (source.body,)


def _air(cylinder: Cylinder, change: Callable[[Quantity], Quantity]) -> dict[str, Any]:
    """Return the field to replace when the air's stiffness changes: it, or the pressure."""
    if cylinder.torque is not None:
        torque = replace(cylinder.torque, pressure=change(cylinder.torque.pressure))
        return {"torque": torque}
    assert cylinder.air_stiffness is not None
    return {"air_stiffness": change(cylinder.air_stiffness)}


def _off(quantity: Quantity, parts: float) -> Quantity:
    return replace(quantity, si=quantity.si + parts * quantity.tolerance_si)


def _scaled(quantity: Quantity | None, factor: float) -> Quantity | None:
    return None if quantity is None else replace(quantity, si=quantity.si * factor)


def within_path(machine: Machine, axes: tuple[str, ...], radius_m: FloatArray) -> Machine:
    """Return ``machine`` with lower limits of ``axes`` instead of limits along the path.

    Any joint motion of the axes within the new limits keeps the vectors of the tool's velocity,
    acceleration and jerk within the limits of ``[path]``, including the centripetal limit. A
    planner that knows only axis limits can therefore use the result. With two equal axes, the limit
    of each axis is 0.71 of the path limit, even if only one axis moves. Where a slow motion turns,
    the jerk along the path is larger than the jerk vector and may still exceed its limit. If the
    limits of braking and speeding up of an axis differ, the lower limit is used for both.

    Parameters
    ----------
    axes
        The moving axes.
    radius_m
        (axes,) length at the tool per unit of each axis.
    """
    braking = any(machine.axes[axis].deceleration is not None for axis in axes)
    if machine.path is None and not braking:
        return machine
    path_limits = machine.path
    velocity = jerk = acceleration = None
    if path_limits is not None:
        velocity, jerk = path_limits.velocity, path_limits.jerk
        accelerations = [
            q
            for q in (path_limits.acceleration, path_limits.deceleration, path_limits.centripetal)
            if q is not None
        ]
        acceleration = min(accelerations, key=lambda limit: limit.si, default=None)
    columns = [machine.axis_names.index(axis) for axis in axes]
    limits = {
        name: limit[columns]
        if path_limit is None
        else _shared(limit[columns], path_limit.si, radius_m)
        for name, limit, path_limit in (
            ("velocity", machine.velocity_limit, velocity),
            ("acceleration", machine.acceleration_limit, acceleration),
            ("jerk", machine.jerk_limit, jerk),
        )
    }
    limited = {
        axis: _with(machine.axes[axis], {name: float(values[j]) for name, values in limits.items()})
        for j, axis in enumerate(axes)
    }
    return replace(machine, axes={**machine.axes, **limited}, path=None)


def _shared(limit: FloatArray, vector_limit: float, radius_m: FloatArray) -> FloatArray:
    """Return (axes,) limits whose vector at the tool has at most the length ``vector_limit``."""
    separate_limits = np.minimum(limit, vector_limit / radius_m)
    vector_length = float(np.linalg.norm(separate_limits * radius_m))
    return np.asarray(separate_limits * min(1.0, vector_limit / vector_length))


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
