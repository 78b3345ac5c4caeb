"""Drives that are told positions: steppers and pulse-controlled servos.

Such a drive makes its body a prescribed coordinate: where the body is, is what was commanded and
not what pulls at it. What pulls at it asks for torque; where that is more than the drive has, a
stepper loses steps, and a servo faults.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import model_validator
from pydantic.dataclasses import dataclass

from threadline.arrays import FloatArray
from threadline.machine.parts import STRICT
from threadline.machine.quantity import Quantity, Units

Torque = Annotated[Quantity, Units(("N*m", "N"), positive=True)]
Speed = Annotated[Quantity, Units(("rad/s", "m/s"), not_negative=True)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class CurvePoint:
    """A point of a data sheet's curve: the most torque (force) at a speed."""

    speed: Speed
    torque: Torque


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Winding:
    """What a stepper's pull-out torque follows from when no curve is given.

    ``current`` is the amplitude of the sine in a phase, ``holding_torque`` what it holds with it;
    ``resistance`` and ``inductance`` are of a phase, ``supply`` the voltage of its driver.
    """

    holding_torque: Torque
    current: Annotated[Quantity, Units(("A",), positive=True)]
    resistance: Annotated[Quantity, Units(("ohm",), positive=True)]
    inductance: Annotated[Quantity, Units(("H",), positive=True)]
    supply: Annotated[Quantity, Units(("V",), positive=True)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Stepper:
    """A stepping motor that turns ``body`` by its steps; the body's inertia includes its rotor's.

    ``full_steps`` counts full steps per rad (m) of the body, each in ``microsteps``. The most that
    it pulls at a speed is a ``curve`` of a data sheet or follows from its ``winding``.
    ``microstep_error`` is the largest distance at which it stands from a microstep; ``detent`` is
    the torque that the motor holds without current.
    """

    kind: Literal["stepper"]
    body: str
    clock: str
    full_steps: Annotated[Quantity, Units(("count/rad", "count/m"), positive=True)]
    microsteps: Annotated[Quantity, Units(("",), positive=True, whole=True, most=256)]
    curve: tuple[CurvePoint, ...] = ()
    winding: Winding | None = None
    microstep_error: Annotated[Quantity, Units(("rad", "m"), not_negative=True)] | None = None
    detent: Annotated[Quantity, Units(("N*m", "N"), not_negative=True)] | None = None

    @model_validator(mode="after")
    def _one_curve(self) -> Stepper:
        if bool(self.curve) == (self.winding is not None):
            raise ValueError("a stepper has either a curve or a winding")
        if self.curve and (len(self.curve) < 2 or self.curve[0].speed.si != 0.0):
            raise ValueError("a curve has two points at least, and begins at speed 0")
        if any(b.speed.si <= a.speed.si for a, b in pairwise(self.curve)):
            raise ValueError("the speeds of a curve must rise")
        return self

    @property
    def counts(self) -> float:
        """Microsteps per rad (m) of the body."""
        return self.full_steps.si * self.microsteps.si

    def most_torque(self, speed_si: FloatArray) -> FloatArray:
        """Return the (k,) torque, N m (N), that it has at speeds of any sign, rad/s (m/s).

        Beyond the end of a curve there is none.
        """
        speed = np.abs(np.asarray(speed_si, dtype=np.float64))
        if self.curve:
            at = [point.speed.si for point in self.curve]
            torque = [point.torque.si for point in self.curve]
            return np.where(speed <= at[-1], np.interp(speed, at, torque), 0.0)
        assert self.winding is not None
        return pull_out_torque(self.winding, self.full_steps.si, speed)

    @property
    def stiffness(self) -> float:
        """N m/rad (N/m) about its step: the slope of a sine of which a step is a quarter."""
        held = self.curve[0].torque if self.winding is None else self.winding.holding_torque
        return float(held.si * self.full_steps.si * np.pi / 2.0)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PulseServo:
    """A servo with a loop of its own that follows pulses with a bandwidth, up to a torque.

    Its shaft follows the command as a critically damped second-order lag, whatever pulls at it.
    """

    kind: Literal["pulse-servo"]
    body: str
    clock: str
    resolution: Annotated[Quantity, Units(("count/rad", "count/m"), positive=True)]
    bandwidth: Annotated[Quantity, Units(("Hz",), positive=True)]
    torque_limit: Torque

    @property
    def counts(self) -> float:
        """Pulses per rad (m) of the body."""
        return self.resolution.si

    def most_torque(self, speed_si: FloatArray) -> FloatArray:
        """Return the (k,) torque, N m (N), that it has: the same at every speed."""
        return np.full(np.shape(speed_si), self.torque_limit.si)


Source = Stepper | PulseServo


def pull_out_torque(winding: Winding, full_steps: float, speed: FloatArray) -> FloatArray:
    """Return the most torque of a two-phase stepper at (k,) speeds >= 0, in N m.

    In the frame that turns with the rotor, with the electrical speed ``w_e = p w``, ``p`` a quarter
    of the full steps per turn, the current i and the voltage v are complex amplitudes:
    ``v = (R + j w_e L) i + j k w``, the torque is ``k Im i``. The driver gives |v| <= V and
    |i| <= I, so that i lies in two discs; wanted is the highest point of what they share
    (Kenjo and Sugawara, *Stepping Motors and their Microprocessor Controls*, chapter 4; the
    equations are those of any synchronous machine).

    Parameters
    ----------
    full_steps
        Per rad.
    """
    most, volts = winding.current.si, winding.supply.si
    k = winding.holding_torque.si / most
    w = np.asarray(speed, dtype=np.float64)
    # A turn has 2 pi full_steps of them, four to an electrical turn.
    impedance = winding.resistance.si + 1j * w * (2.0 * np.pi * full_steps / 4.0) * (
        winding.inductance.si
    )
    centre = -1j * k * w / impedance
    radius = volts / np.abs(impedance)
    top = centre + 1j * radius  # of the disc of voltages
    found = np.where(np.abs(top) <= most, top.imag, -np.inf)
    found = np.where(np.abs(1j * most - centre) <= radius, most, found)
    # Where neither top lies in the other disc it is the higher crossing of the two circles.
    apart = np.abs(centre)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = (most**2 - radius**2 + apart**2) / (2.0 * apart)
        aside = np.sqrt(most**2 - along**2)
        unit = centre / apart
        crossing = np.maximum(
            (unit * (along + 1j * aside)).imag, (unit * (along - 1j * aside)).imag
        )
    crossing = np.where(np.isfinite(crossing), crossing, 0.0)
    found = np.where(np.isfinite(found), found, crossing)
    return np.asarray(k * np.maximum(found, 0.0))
