"""Digital controllers: difference equations on the error in counts, output in DAC levels.

Each runs on its own clock; where the references come from a slower one, ``reference_clock``
names it. With ``e`` the error at this tick and ``e'`` the one before:

========  =======================================================================
``p``     ``u = kp e``  (the winder's thesis calls it PE, proportional error)
``pd``    ``u = kp e + kd (e - e')``
``pi``    ``u = u' + kp (e - e') + ki e``
``pid``   ``u = u' + kp (e - e') + ki e + kd (e - 2 e' + e'')``
``lead``  ``u = K (e - A e') - B u'``, the motion chip's filter ``K (z - A) / (z + B)``
========  =======================================================================

``proportional-velocity`` is another mode of that chip: ``u = K (r - r' - (y - y'))``, the gain
alone on the speed in counts per tick; the same as ``K (e - e')``.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.parts import STRICT, Dac, Encoder, PdController, Potentiometer
from threadline.machine.quantity import Quantity, Units

Gain = Annotated[Quantity, Units(("dac/count",), not_negative=True)]
COEFFICIENT_LOW, COEFFICIENT_HIGH = 1.0 / 256.0, 255.0 / 256.0
"""Smallest and largest A and B of the motion chip: eight bits behind the binary point."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PController:
    """Proportional gain on the error in counts."""

    kind: Literal["p"]
    clock: str
    sensor: str
    drive: str
    kp: Gain
    dac: Dac
    reference_clock: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PiController:
    """Proportional gain, and integral gain on the sum of errors over the ticks."""

    kind: Literal["pi"]
    clock: str
    sensor: str
    drive: str
    kp: Gain
    ki: Gain
    dac: Dac
    reference_clock: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PidController:
    """Proportional, integral and differential gain, per tick."""

    kind: Literal["pid"]
    clock: str
    sensor: str
    drive: str
    kp: Gain
    ki: Gain
    kd: Gain
    dac: Dac
    reference_clock: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class LeadController:
    """The motion chip's filter ``gain (z - zero) / (z + pole)`` with its 8-bit coefficients.

    ``zero`` (A) and ``pole`` (B) are bounded by 1/256 and 255/256: by Tustin's rule the pole is
    always further out than the zero, so that the filter can only lead.
    """

    kind: Literal["lead"]
    clock: str
    sensor: str
    drive: str
    gain: Gain
    zero: Annotated[Quantity, Units(("",))]
    pole: Annotated[Quantity, Units(("",))]
    dac: Dac
    reference_clock: str | None = None

    @model_validator(mode="after")
    def _in_range(self) -> LeadController:
        for name, value in (("zero", self.zero.si), ("pole", self.pole.si)):
            if not COEFFICIENT_LOW <= value <= COEFFICIENT_HIGH:
                raise ValueError(
                    f"{name} of a lead filter is {value:g}, outside 1/256 ... 255/256, which is "
                    f"all that its eight bits hold"
                )
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class VelocityController:
    """The motion chip's proportional velocity control: the gain alone, on counts per tick."""

    kind: Literal["proportional-velocity"]
    clock: str
    sensor: str
    drive: str
    gain: Gain
    dac: Dac
    reference_clock: str | None = None


Controller = Annotated[
    PController | PiController | PdController | PidController | LeadController | VelocityController,
    Field(discriminator="kind"),
]
Sensor = Annotated[Encoder | Potentiometer, Field(discriminator="kind")]
