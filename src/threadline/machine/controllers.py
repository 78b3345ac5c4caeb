"""Digital controllers: difference equations on the error in counts, output in DAC levels.

Each runs on its own clock; if the references come on a slower clock, ``reference_clock`` names it.
With ``e`` the error at this tick and ``e'`` the error at the preceding tick:

========  =======================================================================
``p``     ``u = kp e``  (the winder's thesis calls it PE, proportional error)
``pd``    ``u = kp e + kd (e - e')``
``pi``    ``u = u' + kp (e - e') + ki e``
``pid``   ``u = u' + kp (e - e') + ki e + kd (e - 2 e' + e'')``
``lead``  ``u = K (e - A e') - B u'``, the motion chip's filter ``K (z - A) / (z + B)``
========  =======================================================================

``proportional-velocity`` is another mode of that chip: ``u = K (r - r' - (y - y')) = K (e - e')``
for references r and readings y, a gain on the speed error in counts per tick. In two more modes the
filter ``lead`` follows positions that the chip itself generates on the filter's clock, in 256ths of
a count:

=====================  ==========================================================
``integral-velocity``  sums up a speed, which approaches the difference of the last two references
                       with ``acceleration``; speeds are 8-bit words of whole counts per tick
``trapezoid``          goes to the reference with ``acceleration`` and at most ``velocity``; a new
                       reference is followed when the last one has been reached
=====================  ==========================================================
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, StrictBool, model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.parts import STRICT, Rounding
from threadline.machine.quantity import Quantity, Units

Gain = Annotated[Quantity, Units(("dac/count",), not_negative=True)]
COEFFICIENT_LOW, COEFFICIENT_HIGH = 1.0 / 256.0, 255.0 / 256.0
"""Smallest and largest A and B of the motion chip: eight bits after the binary point."""
ACCELERATION_MOST = 32767
"""Largest acceleration of the motion chip, in 256ths of a count per tick squared."""
VELOCITY_LOW, VELOCITY_HIGH = -128.0, 127.0
"""Lowest and highest speed of the motion chip's integral velocity mode, in counts per tick."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Dac:
    """Output converter of the controller."""

    bits: Annotated[Quantity, Units(("bit",), positive=True, whole=True, most=32)]
    """Number of bits: the output is rounded to one of 2^bits levels and clamped at the ends."""
    range: Annotated[Quantity, Units(("V",), positive=True)]
    """The levels span -range to +range."""
    zero_on_reversal: StrictBool = False
    """Whether the output is 0 for one tick where it changes sign."""
    rounding: Rounding = "nearest"
    """Level of an output between two levels: the nearest (a half to the even one), the level below
    (``floor``), or the one towards zero (``truncate``)."""

    @property
    def volt_per_level(self) -> float:
        """Size of one level in V."""
        return float(2.0 * self.range.si / 2.0**self.bits.si)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Loop:
    """What every controller has: its clocks, its encoder and its motor."""

    clock: str
    """The controller's own tick, a name of ``[clocks]``."""
    sensor: str
    """The encoder that it reads."""
    drive: str
    """The motor that it commands."""
    reference_clock: str | None = None
    """Clock of the references, where they come more slowly than its own tick. Without it:
    ``clock``."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ProportionalLoop(Loop):
    """A controller with a gain on the error in counts."""

    kp: Gain
    """Gain on the error."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PController(ProportionalLoop):
    """Proportional gain on the error in counts."""

    kind: Literal["p"]
    """Law of the controller, as in the table above."""
    dac: Dac
    """Its output converter."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PdController(ProportionalLoop):
    """Proportional gain on the error in counts, differential gain on its change per tick."""

    kind: Literal["pd"]
    kd: Gain
    """Gain on the change of the error per tick."""
    dac: Dac


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PiController(ProportionalLoop):
    """Proportional gain, and integral gain on the sum of errors over the ticks."""

    kind: Literal["pi"]
    ki: Gain
    """Gain on the sum of errors over the ticks."""
    dac: Dac


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PidController(ProportionalLoop):
    """Proportional, integral and differential gain, per tick."""

    kind: Literal["pid"]
    ki: Gain
    kd: Gain
    """Gain on the change of the error per tick."""
    dac: Dac


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class LeadFilter(Loop):
    """The motion chip's filter ``gain (z - zero) / (z + pole)`` with its 8-bit coefficients.

    By Tustin's rule the continuous pole is always at a higher frequency than the zero, so the
    filter can only lead.
    """

    gain: Gain
    """K of the filter."""
    zero: Annotated[Quantity, Units(("",))]
    """A of the filter, 1/256 to 255/256."""
    pole: Annotated[Quantity, Units(("",))]
    """B of the filter, 1/256 to 255/256."""
    dac: Dac

    @model_validator(mode="after")
    def _in_range(self) -> LeadFilter:
        for name, value in (("zero", self.zero.si), ("pole", self.pole.si)):
            if not COEFFICIENT_LOW <= value <= COEFFICIENT_HIGH:
                raise ValueError(
                    f"{name} of a lead filter is {value:g}, outside 1/256 ... 255/256, the "
                    f"range of its eight bits"
                )
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class LeadController(LeadFilter):
    """The motion chip in position mode: references are positions."""

    kind: Literal["lead"]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ProfileController(LeadFilter):
    """The motion chip in modes in which it generates positions itself.

    ``acceleration`` is held in 15 bits, in 256ths of a count per tick squared.
    """

    acceleration: Annotated[Quantity, Units(("count/tick**2",), positive=True)]
    """Acceleration of the generated positions, in whole 256ths of a count/tick^2."""

    @model_validator(mode="after")
    def _has_acceleration(self) -> ProfileController:
        value = self.acceleration.si
        if not 1.0 <= np.rint(256.0 * value) <= ACCELERATION_MOST:
            raise ValueError(
                f"acceleration of a profile is {value:g} count/tick^2, outside 1/256 ... "
                f"127 255/256, the range of its fifteen bits"
            )
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class IntegralVelocityController(ProfileController):
    """The motion chip's integral velocity mode: it integrates the speed of its references."""

    kind: Literal["integral-velocity"]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class TrapezoidController(ProfileController):
    """The motion chip's trapezoid mode: a trapezoidal speed profile to each reference."""

    kind: Literal["trapezoid"]
    velocity: Annotated[Quantity, Units(("count/tick",), positive=True, whole=True, most=127)]
    """Highest speed of the generated positions, a whole number, at most 127."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class VelocityController(Loop):
    """The motion chip's proportional velocity mode: a gain on the speed error."""

    kind: Literal["proportional-velocity"]
    gain: Gain
    """Gain on the speed error."""
    dac: Dac


Controller = Annotated[
    PController
    | PiController
    | PdController
    | PidController
    | LeadController
    | VelocityController
    | IntegralVelocityController
    | TrapezoidController,
    Field(discriminator="kind"),
]
