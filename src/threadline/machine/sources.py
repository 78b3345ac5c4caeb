"""Position-commanded drives: steppers, pulse-controlled servos and kinematic drives.

Such a drive prescribes the coordinate of its body: the body follows the commands against any force.
The force determines the torque that the drive needs. If this torque exceeds the available torque, a
stepper loses steps and a servo stops with a fault. The body and the motor of a kinematic drive are
unknown; its axis has only limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import model_validator
from pydantic.dataclasses import dataclass

from threadline.base.arrays import FloatArray
from threadline.machine.parts import STRICT, Axis
from threadline.machine.quantity import Quantity, Units

Torque = Annotated[Quantity, Units(("N*m", "N"), positive=True)]
Speed = Annotated[Quantity, Units(("rad/s", "m/s"), not_negative=True)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class CurvePoint:
    """A point of a data sheet's torque curve: the largest torque (force) at a speed."""

    speed: Speed
    """Speed of the body; it rises from point to point."""
    torque: Torque
    """Largest torque at this speed; it never rises with speed."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Winding:
    """The winding of a stepper, which determines its pull-out torque."""

    holding_torque: Torque
    """Holding torque at ``current``."""
    current: Annotated[Quantity, Units(("A",), positive=True)]
    """Amplitude of the sine in a phase."""
    resistance: Annotated[Quantity, Units(("ohm",), positive=True)]
    """Resistance of a phase and its leads."""
    inductance: Annotated[Quantity, Units(("H",), positive=True)]
    """Inductance of a phase."""
    supply: Annotated[Quantity, Units(("V",), positive=True)]
    """Voltage of the driver."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Stepper:
    """A stepping motor that moves its body in steps."""

    kind: Literal["stepper"]
    """A stepping motor with its driver."""
    body: str
    """The body that the motor moves; the inertia of the body includes the rotor."""
    clock: str
    """Clock of the commands; within a tick the pulses are evenly spaced."""
    full_steps: Annotated[Quantity, Units(("count/rad", "count/m"), positive=True)]
    """Full steps per unit of the body."""
    microsteps: Annotated[Quantity, Units(("",), positive=True, whole=True, most=256)]
    """Microsteps per full step."""
    curve: tuple[CurvePoint, ...] = ()
    """Torque curve of a data sheet: at least two points, the first at speed 0. The torque is 0 at
    speeds above the last point. Without it: ``winding``."""
    winding: Winding | None = None
    """Winding, from which the torque curve is computed. Without it: ``curve``."""
    microstep_error: Annotated[Quantity, Units(("rad", "m"), not_negative=True)] | None = None
    """Largest deviation of the motor from the commanded microstep; the error repeats every full
    step. Without it: 0."""
    detent: Annotated[Quantity, Units(("N*m", "N"), not_negative=True)] | None = None
    """Holding torque without current; nothing uses it."""

    @model_validator(mode="after")
    def _one_curve(self) -> Stepper:
        if bool(self.curve) == (self.winding is not None):
            raise ValueError("a stepper has either a curve or a winding")
        if self.curve and (len(self.curve) < 2 or self.curve[0].speed.si != 0.0):
            raise ValueError("a curve needs at least two points and must begin at speed 0")
        if any(b.speed.si <= a.speed.si for a, b in pairwise(self.curve)):
            raise ValueError("the speeds of a curve must rise")
        for slower, faster in pairwise(self.curve):
            if faster.torque.si > slower.torque.si:
                raise ValueError(
                    f"the torque of a curve rises, from {slower.torque.si:g} at "
                    f"{slower.speed.si:g} to {faster.torque.si:g} at {faster.speed.si:g}; the "
                    "largest torque of a stepper falls with its speed, so omit a bump"
                )
        return self

    @property
    def counts(self) -> float:
        """Microsteps per rad (m) of the body."""
        return self.full_steps.si * self.microsteps.si

    def most_torque(self, speed_si: FloatArray) -> FloatArray:
        """Return the (k,) largest torques in N m (N) at speeds of any sign in rad/s (m/s).

        Beyond the end of a curve the torque is 0.
        """
        speed = np.abs(np.asarray(speed_si, dtype=np.float64))
        if self.curve:
            speeds = [point.speed.si for point in self.curve]
            torques = [point.torque.si for point in self.curve]
            return np.where(speed <= speeds[-1], np.interp(speed, speeds, torques), 0.0)
        assert self.winding is not None
        return pull_out_torque(self.winding, self.full_steps.si, speed)

    @property
    def stiffness(self) -> float:
        """Stiffness at a step in N m/rad (N/m): the slope of a sine with four steps per period."""
        holding = self.curve[0].torque if self.winding is None else self.winding.holding_torque
        return float(holding.si * self.full_steps.si * np.pi / 2.0)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PulseServo:
    """A servo with an internal control loop that follows pulses.

    Its shaft follows the command with a critically damped second-order lag, whatever the load. A
    needed torque above ``torque_limit`` is a fault.
    """

    kind: Literal["pulse-servo"]
    """A servo with an internal control loop that takes pulses."""
    body: str
    """The body that the servo moves."""
    clock: str
    """Clock of the commands."""
    resolution: Annotated[Quantity, Units(("count/rad", "count/m"), positive=True)]
    """Pulses per unit of the body."""
    bandwidth: Annotated[Quantity, Units(("Hz",), positive=True)]
    """Bandwidth of the internal loop."""
    torque_limit: Torque
    """Largest torque at any speed; a larger needed torque is a fault (``step_loss``)."""

    @property
    def counts(self) -> float:
        """Pulses per rad (m) of the body."""
        return self.resolution.si

    def most_torque(self, speed_si: FloatArray) -> FloatArray:
        """Return the (k,) largest torques in N m (N), independent of the speed."""
        return np.full(np.shape(speed_si), self.torque_limit.si)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Kinematic:
    """A drive that takes positions on ``clock``; its motor and its load are unknown."""

    kind: Literal["kinematic"]
    """A drive of which only the limits are known."""
    clock: str
    """Clock of the commands."""


Source = Stepper | PulseServo
"""Position-commanded drives with known loads."""


def check_limits_only(
    drives: Mapping[str, object], axes: Mapping[str, Axis], tables: Mapping[str, object]
) -> None:
    """Refuse parts with dynamics in a machine with kinematic drives.

    Raises
    ------
    ValueError
        If there are such parts; the message begins with the key.
    """
    reason = "is not allowed with kinematic drives, for which only limits are known"
    for name, drive in drives.items():
        if not isinstance(drive, Kinematic):
            raise ValueError(f"drives.{name}: a drive of another kind {reason}: use one kind")
    for name, axis in axes.items():
        for key, weights in (("load", axis.load), ("frame", axis.frame)):
            if weights is not None:
                raise ValueError(f"axes.{name}.{key}: a {key} {reason}: remove it")
    for table, parts in tables.items():
        if parts:
            raise ValueError(f"{table}: [{table}] {reason}: remove it")


def pull_out_torque(winding: Winding, full_steps: float, speed: FloatArray) -> FloatArray:
    """Return the (k,) pull-out torques in N m of a two-phase stepper.

    In the rotor's frame, current i and voltage v are complex amplitudes with
    ``v = (R + j w_e L) i + j k w`` and the torque ``k Im i``. The electrical speed is
    ``w_e = p w``, with p a quarter of the full steps in a turn. The driver gives |v| <= V and
    |i| <= I, so i lies in two discs, and the largest torque is at the highest point of their
    intersection (Kenjo and Sugawara, *Stepping Motors and their Microprocessor Controls*, chapter
    4; the equations hold for any synchronous machine).

    Parameters
    ----------
    winding
        The winding.
    full_steps
        Full steps per rad.
    speed
        (k,) speeds in rad/s, not negative.
    """
    limit_a, supply_v = winding.current.si, winding.supply.si
    k, resistance = winding.holding_torque.si / limit_a, winding.resistance.si
    w = np.asarray(speed, dtype=np.float64)
    # A turn has 2 pi full_steps steps, and an electrical turn has four.
    reactance = w * (2.0 * np.pi * full_steps / 4.0 * winding.inductance.si)
    impedance_ohm = np.sqrt(resistance * resistance + reactance * reactance)
    radius_a = supply_v / impedance_ohm
    # The voltage disc has its centre at -j k w / (R + j w_e L), with coordinates across and up.
    share = -k * w / (impedance_ohm * impedance_ohm)
    across, up = share * reactance, share * resistance
    top_a = up + radius_a
    highest_a = np.where(across * across + top_a * top_a <= limit_a * limit_a, top_a, -np.inf)
    limit_inside = across * across + (limit_a - up) ** 2 <= radius_a * radius_a
    highest_a = np.where(limit_inside, limit_a, highest_a)
    # If neither top lies in the other disc, the highest point is an intersection of the circles.
    neither_inside = np.flatnonzero(np.isneginf(highest_a))
    if len(neither_inside):
        across, up, radius_a = (
            across.flat[neither_inside],
            up.flat[neither_inside],
            radius_a.flat[neither_inside],
        )
        distance_a = np.hypot(across, up)
        with np.errstate(divide="ignore", invalid="ignore"):
            along = (limit_a * limit_a - radius_a * radius_a + distance_a * distance_a) / (
                2.0 * distance_a
            )
            aside = np.sqrt(limit_a * limit_a - along * along)
            crossing = (up * along + np.abs(across) * aside) / distance_a
        highest_a.flat[neither_inside] = np.where(np.isfinite(crossing), crossing, 0.0)
    return np.asarray(k * np.maximum(highest_a, 0.0))
