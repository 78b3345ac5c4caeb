"""Digital controllers: difference equations on the error in counts, output in DAC levels.

Each controller runs on its own clock. If its references come on a slower clock, ``reference_clock``
names that clock. With ``e`` the error at this tick and ``e'`` the error at the preceding tick:

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
``integral-velocity``  the positions are the sum of a speed. The speed approaches the difference of
                       the last two references with ``acceleration``; it is an 8-bit word of whole
                       counts per tick
``trapezoid``          the positions go to the reference with ``acceleration`` and at most
                       ``velocity``; a new reference is followed when the preceding reference has
                       been reached
=====================  ==========================================================
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, StrictBool, model_validator
from pydantic.dataclasses import dataclass

from threadline.base.arrays import FloatArray
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
    """Whether the output is 0 for one tick when it changes sign."""
    rounding: Rounding = "nearest"
    """Rounding of an output between two levels: to the nearest level (a half to the even level), to
    the level below (``floor``), or to the level towards zero (``truncate``)."""

    @property
    def volt_per_level(self) -> float:
        """Size of one level in V."""
        return float(2.0 * self.range.si / 2.0**self.bits.si)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Loop:
    """Common keys of controllers: clocks, encoder and motor."""

    clock: str
    """Clock of the controller's ticks, a name of ``[clocks]``."""
    sensor: str
    """The encoder that the controller reads."""
    drive: str
    """The motor that the controller commands."""
    reference_clock: str | None = None
    """Clock of the references, if they come more slowly than the controller's ticks. Without it:
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
    """Control law, as in the table above."""
    dac: Dac
    """Output converter of the controller."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PdController(ProportionalLoop):
    """Proportional gain on the error in counts, and differential gain on its change per tick."""

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
    """Gain K of the filter."""
    zero: Annotated[Quantity, Units(("",))]
    """Zero A of the filter, 1/256 to 255/256."""
    pole: Annotated[Quantity, Units(("",))]
    """B of the filter, 1/256 to 255/256: its pole is at -B."""
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
    """The motion chip in a mode in which the chip itself generates positions.

    ``acceleration`` is stored in 15 bits, in 256ths of a count per tick squared.
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
    """With ``proportional-velocity``: gain on the speed error."""
    dac: Dac


MOST_ENTRY = 10**12
"""Largest magnitude of an entry of the matrices of a state-space controller."""
Entry = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=-MOST_ENTRY, le=MOST_ENTRY)]
Matrix = tuple[tuple[Entry, ...], ...]
MOST_STATES = 64
"""Largest number of states of a state-space controller."""


@dataclass(frozen=True, slots=True)
class AxisOfStateSpace:
    """The part of a state-space controller for one of its axes; see ``Loop``."""

    kind: Literal["state-space"]
    clock: str
    reference_clock: str | None
    sensor: str
    drive: str
    dac: Dac


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class StateSpaceController:
    """One linear controller for the references, sensors and drives of several axes."""

    kind: Literal["state-space"]
    """One linear controller of several axes, by the equations above."""
    clock: str
    """Clock of the controller's ticks, a name of ``[clocks]``."""
    reference_clock: str | None = None
    """Clock of the references, if they come more slowly than the controller's ticks. Without it:
    ``clock``."""
    references: tuple[str, ...] = Field(min_length=1, max_length=6)
    """Axes that the controller moves: their commanded positions in counts are the first inputs."""
    sensors: tuple[str, ...] = Field(min_length=1, max_length=24)
    """Sensors that the controller reads: first the encoder of each axis, in the order of
    ``references``, then any others."""
    drives: tuple[str, ...] = Field(min_length=1)
    """Motors that the controller commands, one for each axis, in the order of ``references``."""
    A: Matrix = ()
    """(states, states) matrix from the states to the states at the next tick. Without it: no
    states."""
    B: Matrix = ()
    """(states, inputs) matrix from references and readings to the states at the next tick. Without
    it: no states."""
    C: Matrix = ()
    """(drives, states) matrix from the states to the outputs in DAC levels. Without it: no
    states."""
    D: Matrix
    """(drives, inputs) matrix from references and readings to the outputs in DAC levels."""
    L: Matrix = ()
    """(states, drives) matrix from the levels by which the DAC clamps the outputs to the states at
    the next tick: anti-windup for integrators and observers. Without it: 0."""
    made: str = ""
    """Source of the numbers."""
    dac: Dac
    """Output converter of each drive; all drives have equal converters."""

    @model_validator(mode="after")
    def _sizes(self) -> StateSpaceController:
        axes, inputs, n = (
            len(self.references),
            len(self.references) + len(self.sensors),
            len(self.A),
        )
        for name, names in (
            ("references", self.references), ("sensors", self.sensors), ("drives", self.drives),
        ):  # fmt: skip
            if len(set(names)) < len(names):
                raise ValueError(f"{name}: a name occurs twice in {', '.join(names)}")
        if len(self.drives) != axes:
            raise ValueError(f"drives: {len(self.drives)} names, but references has {axes}")
        if len(self.sensors) < axes:
            raise ValueError(
                f"sensors: {len(self.sensors)} names, but references has {axes}, and the first "
                "sensors are the encoders of these axes"
            )
        if n > MOST_STATES:
            raise ValueError(f"A: {n} rows, limit {MOST_STATES} states")
        expected_sizes = {"A": (n, n), "B": (n, inputs), "C": (axes, n), "D": (axes, inputs)}
        if self.L:
            expected_sizes["L"] = (n, axes)
        for name, (rows, columns) in expected_sizes.items():
            matrix: Matrix = getattr(self, name)
            if not n and name != "D" and not any(matrix):
                continue
            if len(matrix) != rows:
                raise ValueError(
                    f"{name}: {len(matrix)} rows, {_expected_size(name, rows, columns)}"
                )
            for row_index, row in enumerate(matrix):
                if len(row) != columns:
                    raise ValueError(
                        f"{name}: {len(row)} numbers in row {row_index + 1}, "
                        f"{_expected_size(name, rows, columns)}"
                    )
        return self

    def matrix(self, name: Literal["A", "B", "C", "D", "L"]) -> FloatArray:
        """Return a matrix as an array (rows, columns); zeros if the file leaves it out."""
        n, axes = len(self.A), len(self.references)
        inputs = axes + len(self.sensors)
        shape = {"A": (n, n), "B": (n, inputs), "C": (axes, n), "D": (axes, inputs), "L": (n, axes)}
        written = getattr(self, name)
        if not any(written):
            return np.zeros(shape[name])
        return np.array(written, dtype=np.float64).reshape(shape[name])

    def of_axis(self, axis: str) -> AxisOfStateSpace:
        """Return the settings for one of its axes."""
        index = self.references.index(axis)
        return AxisOfStateSpace(
            kind="state-space",
            clock=self.clock,
            reference_clock=self.reference_clock,
            sensor=self.sensors[index],
            drive=self.drives[index],
            dac=self.dac,
        )


def _expected_size(name: str, rows: int, columns: int) -> str:
    sizes = {
        "A": "states x states", "B": "states x (references + sensors)", "C": "drives x states",
        "D": "drives x (references + sensors)", "L": "states x drives",
    }  # fmt: skip
    return f"expected {rows} x {columns}: {sizes[name]}"


AxisController = (
    PController
    | PiController
    | PdController
    | PidController
    | LeadController
    | VelocityController
    | IntegralVelocityController
    | TrapezoidController
)
"""A controller of one axis: one encoder, one drive."""

Controller = Annotated[AxisController | StateSpaceController, Field(discriminator="kind")]
