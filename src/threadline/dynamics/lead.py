"""Design of lead filters for a crossover and a phase margin, from the exact frequency response.

The filter ``K (z - A) / (z + B)`` has three numbers. Crossover and phase margin determine two of
them. B is therefore chosen in advance: by default 1/256, the smallest value of the motion chip. At
``z = exp(i w T)`` the phase of the zero must be ``psi = phase margin - 180 - arg G + arg(z + B)``,
which determines ``A = cos(w T) - sin(w T) / tan(psi)``. K then follows from the loop gain, which is
1 at the crossover.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import ComplexArray, FloatArray
from threadline.dynamics.loop import Loop
from threadline.errors import OptionError
from threadline.machine.controllers import COEFFICIENT_HIGH, COEFFICIENT_LOW


@dataclass(frozen=True, slots=True, kw_only=True)
class LeadDesign:
    """A lead filter ``gain (z - zero) / (z + pole)`` with its design values.

    Parameters
    ----------
    gain
        DAC levels per count.
    zero, pole
        A and B, without unit.
    crossover_hz, phase_margin_deg
        Crossover and phase margin of the loop with this filter.
    period_s, volt_per_level
        Tick of the controller, and the voltage of one level of its DAC.
    """

    gain: float
    zero: float
    pole: float
    crossover_hz: float
    phase_margin_deg: float
    period_s: float
    volt_per_level: float

    @property
    def continuous(self) -> tuple[float, float, float]:
        """Gain k in V/count, a and b in 1/s of ``k (s + a) / (s + b)``, by Tustin's rule."""
        return (
            self.gain * self.volt_per_level * (1 + self.zero) / (1 - self.pole),
            2.0 / self.period_s * (1 - self.zero) / (1 + self.zero),
            2.0 / self.period_s * (1 + self.pole) / (1 - self.pole),
        )

    def replaced(self, controller: str) -> dict[str, float]:
        """Return this design as numbers of ``controller``, for ``machine.with_numbers``."""
        return {
            f"controllers.{controller}.{key}": value
            for key, value in (("gain", self.gain), ("zero", self.zero), ("pole", self.pole))
        }


def lead_deg(response: ComplexArray, phase_margin_deg: FloatArray | float) -> FloatArray:
    """Return the (k,) phase lead that filters must add for a phase margin, -180 to 180 degrees.

    Parameters
    ----------
    response
        (k,) complex responses of the plants, each at the crossover of its loop.
    phase_margin_deg
        (k,) or one number: required phase margins, in degrees.
    """
    lead = phase_margin_deg - 180.0 - np.degrees(np.angle(response))
    return np.asarray((lead + 180.0) % 360.0 - 180.0)


def lead_from_response(
    response: ComplexArray,
    omega_rad_s: FloatArray | float,
    phase_margin_deg: FloatArray | float,
    period_s: float,
    pole: float = COEFFICIENT_LOW,
) -> tuple[FloatArray, FloatArray]:
    """Return (k,) gains in V/count and (k,) zeros A of lead filters, for many plants at once.

    Parameters
    ----------
    response
        (k,) complex response of the plants at ``omega_rad_s``, in counts per volt.
    omega_rad_s, phase_margin_deg
        (k,) or one number: required crossovers in rad/s and phase margins in degrees.
    period_s
        Tick of the controllers.
    pole
        B of the filters.

    Notes
    -----
    A zero outside the range of the motion chip, 1/256 ... 255/256, is returned as it is. A zero is
    NaN if no zero gives the required phase.
    """
    z = np.exp(1j * np.asarray(omega_rad_s) * period_s)
    lead = np.radians(lead_deg(np.asarray(response), phase_margin_deg))
    zero_angle = lead + np.angle(z + pole)
    possible = (zero_angle > np.angle(z)) & (zero_angle < np.pi)
    zero = np.where(possible, z.real - z.imag / np.tan(np.where(possible, zero_angle, 1.0)), np.nan)
    gain = np.abs(z + pole) / (np.abs(z - zero) * np.abs(response))
    return np.asarray(gain), np.asarray(zero)


def design_lead(
    loop: Loop, crossover_hz: float, phase_margin_deg: float, pole: float = COEFFICIENT_LOW
) -> LeadDesign:
    """Return the lead filter for a crossover and a phase margin of an axis.

    Parameters
    ----------
    loop
        Loop of the axis, with any controller; the other loops of its network piece stay closed.
    crossover_hz, phase_margin_deg
        Required crossover and phase margin of the sampled loop.
    pole
        B of the filter.

    Raises
    ------
    OptionError
        If a number is out of range, or no zero of the motion chip gives the phase margin.
    """
    period = loop.period_s
    if not 0 < crossover_hz < 0.5 / period:
        raise OptionError(
            f"crossover {crossover_hz:g} Hz is outside 0 ... {0.5 / period:g} Hz",
            remedy="Give at most half the controller's rate.",
        )
    if not 0 < phase_margin_deg < 180:
        raise OptionError(f"phase margin {phase_margin_deg:g} deg is outside 0 ... 180 deg")
    if not COEFFICIENT_LOW <= pole <= COEFFICIENT_HIGH:
        raise OptionError(f"pole B = {pole:g} is outside 1/256 ... 255/256")
    omega = np.array([2 * np.pi * crossover_hz])
    response = loop.plant_response(omega)
    gains, zeros = lead_from_response(response, omega, phase_margin_deg, period, pole)
    needed_deg = float(lead_deg(response, phase_margin_deg)[0])
    zero = float(zeros[0])
    if not COEFFICIENT_LOW <= zero <= COEFFICIENT_HIGH:
        least_deg, most_deg = _range_deg(float(omega[0]) * period, pole)
        raise OptionError(
            f"axis {loop.axis}: {phase_margin_deg:g} deg at {crossover_hz:g} Hz needs "
            f"{needed_deg:.1f} deg of lead; this filter gives {least_deg:.1f} ... {most_deg:.1f} "
            "deg there",
            remedy="Ask for a lower crossover or another phase margin.",
        )
    volt_per_level = loop.filters[loop.index].volt_per_level
    return LeadDesign(
        gain=float(gains[0]) / volt_per_level,
        zero=zero,
        pole=pole,
        crossover_hz=crossover_hz,
        phase_margin_deg=phase_margin_deg,
        period_s=period,
        volt_per_level=volt_per_level,
    )


def _range_deg(angle: float, pole: float) -> tuple[float, float]:
    """Return the smallest and largest lead of the filter at ``z = exp(i angle)``, degrees."""
    z = np.exp(1j * angle)
    leads = [
        np.angle(z - zero) - np.angle(z + pole) for zero in (COEFFICIENT_LOW, COEFFICIENT_HIGH)
    ]
    return float(np.degrees(min(leads))), float(np.degrees(max(leads)))
