"""Digital controllers as difference equations and as the continuous filters they stand for.

The difference equation is ``u = b0 e + b1 e' + b2 e'' - a1 u' - a2 u''`` in DAC levels, where each
prime means one tick earlier. In its continuous form a sum over ticks is an integral and a
difference per tick is a derivative. A lead filter is converted by Tustin's rule, so that
``K (z - A) / (z + B)`` has its zero at ``(2/T)(1 - A)/(1 + A)``, its pole at
``(2/T)(1 + B)/(1 - B)`` and the high-frequency gain ``K (1 + A)/(1 - B)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, Locked, read_only
from threadline.machine import Machine
from threadline.machine.controllers import (
    LeadFilter,
    PController,
    PdController,
    PiController,
    VelocityController,
)
from threadline.plant.values import Values


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DigitalFilter(Locked):
    """A controller with its DAC, as a difference equation and in continuous form.

    Parameters
    ----------
    numerator, denominator
        (3,) ``b0 b1 b2`` in V/count and ``1 a1 a2`` without unit, of the difference equation.
    continuous_numerator, continuous_denominator
        Polynomials in s, highest power first, of the continuous form in V/count.
    period_s
        Tick of the controller.
    volt_per_level
        Voltage of one level of the DAC.
    """

    numerator: FloatArray
    denominator: FloatArray
    continuous_numerator: FloatArray
    continuous_denominator: FloatArray
    period_s: float
    volt_per_level: float = 1.0

    def __post_init__(self) -> None:
        for name in (
            "numerator",
            "denominator",
            "continuous_numerator",
            "continuous_denominator",
        ):
            object.__setattr__(self, name, read_only(getattr(self, name), name, ndim=1))

    def sampled_response(self, omega_rad_s: FloatArray) -> NDArray[np.complex128]:
        """Return the (k,) response of the difference equation at ``z = exp(i w T)``, V/count."""
        back = np.exp(-1j * np.asarray(omega_rad_s) * self.period_s)
        powers = np.stack([np.ones_like(back), back, back**2])
        return np.asarray((self.numerator @ powers) / (self.denominator @ powers))

    def continuous_response(self, omega_rad_s: FloatArray) -> NDArray[np.complex128]:
        """Return the (k,) response of the continuous form at ``s = i w``, V/count."""
        s = 1j * np.asarray(omega_rad_s)
        top = np.polyval(self.continuous_numerator, s)
        return np.asarray(top / np.polyval(self.continuous_denominator, s))


def difference_equation(
    machine: Machine, name: str, values: Values
) -> tuple[FloatArray, FloatArray]:
    """Return (variants, 3) ``b0 b1 b2`` in DAC levels per count and (variants, 2) ``a1 a2``.

    Parameters
    ----------
    name
        Name of the controller.
    values
        Replaced numbers, one of each for every variant.
    """
    controller, path = machine.controllers[name], f"controllers.{name}"
    numerator, denominator = np.zeros((values.count, 3)), np.zeros((values.count, 2))
    if isinstance(controller, LeadFilter):
        gain = values.at(f"{path}.gain", controller.gain)
        numerator[:, 0] = gain
        numerator[:, 1] = -np.asarray(gain) * values.at(f"{path}.zero", controller.zero)
        denominator[:, 0] = values.at(f"{path}.pole", controller.pole)
        return numerator, denominator
    if isinstance(controller, VelocityController):
        numerator[:, 0] = values.at(f"{path}.gain", controller.gain)
        numerator[:, 1] = -numerator[:, 0]
        return numerator, denominator
    kp = np.asarray(values.at(f"{path}.kp", controller.kp))
    if isinstance(controller, PController):
        numerator[:, 0] = kp
    elif isinstance(controller, PdController):
        kd = np.asarray(values.at(f"{path}.kd", controller.kd))
        numerator[:, 0], numerator[:, 1] = kp + kd, -kd
    else:
        ki = np.asarray(values.at(f"{path}.ki", controller.ki))
        numerator[:, 0], numerator[:, 1], denominator[:, 0] = kp + ki, -kp, -1.0
        if not isinstance(controller, PiController):
            kd = np.asarray(values.at(f"{path}.kd", controller.kd))
            numerator[:, 0] += kd
            numerator[:, 1] -= 2.0 * kd
            numerator[:, 2] = kd
    return numerator, denominator


def digital_filter(machine: Machine, name: str, values: Values | None = None) -> DigitalFilter:
    """Return the controller ``name`` with the DAC behind it, in volts per count.

    ``values`` may replace numbers; its first variant is used.
    """
    used = Values.of(machine) if values is None else values
    controller = machine.controllers[name]
    b, a = difference_equation(machine, name, used)
    (b0, b1, b2), (a1, _) = b[0], a[0]
    bits = np.ravel(used.at(f"controllers.{name}.dac.bits", controller.dac.bits))[0]
    swing = np.ravel(used.at(f"controllers.{name}.dac.range", controller.dac.range))[0]
    volts = 2.0 * swing / 2.0**bits
    period = float(machine.clock(controller.clock).period_s)
    if isinstance(controller, LeadFilter):
        # s -> z by Tustin: b0 (z - A)/(z + B).
        top = [b0 - b1, (b0 + b1) * 2.0 / period]
        bottom = [1.0 - a1, (1.0 + a1) * 2.0 / period]
    elif a1 == 0.0:
        # b0 e + b1 e' = (b0 + b1) e - b1 (e - e').
        top, bottom = [-b1 * period, b0 + b1], [1.0]
    else:
        # Integrating: u - u' = ki e + kp (e - e') + kd (e - 2 e' + e'').
        top = [b2 * period, -(b1 + 2.0 * b2), (b0 + b1 + b2) / period]
        bottom = [1.0, 0.0]
    return DigitalFilter(
        numerator=volts * b[0],
        denominator=np.array([1.0, *a[0]]),
        continuous_numerator=np.trim_zeros(volts * np.array(top), "f")
        if np.any(top)
        else np.zeros(1),
        continuous_denominator=np.array(bottom),
        period_s=period,
        volt_per_level=float(volts),
    )
