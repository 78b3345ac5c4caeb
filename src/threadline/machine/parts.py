"""The parts of a machine: bodies and links between them, drives, sensors, axes, switches.

Every part is data from the machine file. A machine is a network: each body has one coordinate, and
each link a stretch that is a weighted sum of coordinates. A belt between motor, head and frame, a
rack on the ground, and a gear are links with different weights.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Annotated, Literal

from pydantic import AfterValidator, ConfigDict, Field, StrictBool, model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.mandrel import Mandrel
from threadline.machine.quantity import Quantity, Units

STRICT = ConfigDict(extra="forbid", defer_build=True)

PositiveTime = Annotated[Quantity, Units(("s",), positive=True)]
Period = Annotated[Quantity, Units(("s",), positive=True, most=3600.0)]
"""Period of a clock, at most one hour: no sampled controller is slower."""

Coefficient = Annotated[Quantity, Units(("", "m/rad", "rad/m"))]
Resolution = Annotated[Quantity, Units(("count/rad", "count/m"), positive=True)]
Sensitivity = Annotated[Quantity, Units(("V/m", "V/rad"))]
Position = Annotated[Quantity, Units(("m", "rad"))]


def _weighing(coefficients: dict[str, Quantity]) -> dict[str, Quantity]:
    if not any(coefficient.si for coefficient in coefficients.values()):
        raise ValueError(
            f"every coefficient is 0 ({', '.join(coefficients)}), so it has no effect. "
            "Give one that is not 0, like the radius of a pulley or 1."
        )
    return coefficients


Rounding = Literal["nearest", "floor", "truncate"]
"""Direction of rounding: to the nearest whole number, down, or towards zero."""
Weights = Annotated[dict[str, Coefficient], Field(min_length=1), AfterValidator(_weighing)]
"""Weights of coordinates in a stretch, a load or a direction of force; at least one is not 0."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Body:
    """A mass with one coordinate (m or rad), counted from the start position of the machine.

    ``friction`` opposes sliding with a constant force; ``stiction`` is the force at breakaway.
    """

    kind: Literal["linear", "rotary"]
    inertia: Annotated[Quantity, Units(("kg", "kg*m^2"), positive=True)]
    damping: Annotated[Quantity, Units(("N*s/m", "N*m*s/rad"), not_negative=True)] | None = None
    friction: Annotated[Quantity, Units(("N", "N*m"), not_negative=True)] | None = None
    stiction: Annotated[Quantity, Units(("N", "N*m"), not_negative=True)] | None = None

    @model_validator(mode="after")
    def _same_kind(self) -> Body:
        rotary = self.kind == "rotary"
        for name, part, wanted in (
            ("inertia", self.inertia, "kg*m^2" if rotary else "kg"),
            ("damping", self.damping, "N*m*s/rad" if rotary else "N*s/m"),
            ("friction", self.friction, "N*m" if rotary else "N"),
            ("stiction", self.stiction, "N*m" if rotary else "N"),
        ):
            if part is not None and part.unit != wanted:
                raise ValueError(f"{name} of a {self.kind} body is in {wanted}, not {part.unit}")
        if self.stiction is not None and (
            self.friction is None or self.stiction.si < self.friction.si
        ):
            raise ValueError("stiction must come with a friction that is not larger")
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Eccentric:
    """An eccentric gear, by which the play of a link becomes ``play + width cos(angle)``.

    ``angle`` is the gear's angle in rad as a weighted sum of coordinates, and ``phase`` its value
    at the start of the machine; ``width`` is the amplitude of the full width of the play.
    """

    angle: dict[str, Annotated[Quantity, Units(("", "rad/m"))]] = Field(min_length=1)
    width: Annotated[Quantity, Units(("m", "rad"), positive=True)]
    phase: Annotated[Quantity, Units(("rad",))]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Link:
    """A spring and damper whose stretch is ``sum(coefficient * coordinate)``.

    With ``preload`` the link is a belt of two runs: each has a share of the stiffness and goes
    slack without tension. ``first_run`` is the share of the run that a positive stretch tightens, a
    half by default. ``play`` is the full width of the backlash; with ``eccentric`` it varies with
    the angle of a gear.
    """

    stretch: Weights
    stiffness: Annotated[Quantity, Units(("N/m", "N*m/rad"), not_negative=True, certain=True)]
    damping: Annotated[Quantity, Units(("N*s/m", "N*m*s/rad"), not_negative=True)] | None = None
    preload: Annotated[Quantity, Units(("N", "N*m"), not_negative=True)] | None = None
    play: Annotated[Quantity, Units(("m", "rad"), not_negative=True)] | None = None
    first_run: Annotated[Quantity, Units(("",), positive=True)] | None = None
    eccentric: Eccentric | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Link:
        linear = self.stiffness.unit == "N/m"
        width = None if self.eccentric is None else self.eccentric.width
        for name, part, wanted in (
            ("damping", self.damping, "N*s/m" if linear else "N*m*s/rad"),
            ("preload", self.preload, "N" if linear else "N*m"),
            ("play", self.play, "m" if linear else "rad"),
            ("eccentric.width", width, "m" if linear else "rad"),
        ):
            if part is not None and part.unit != wanted:
                raise ValueError(
                    f"{name} is in {part.unit}; with a stiffness in {self.stiffness.unit} "
                    f"it must be in {wanted}"
                )
        if self.first_run is not None and not (self.preload and self.first_run.si < 1.0):
            raise ValueError("first_run must be a share between 0 and 1, and needs a preload")
        if self.eccentric is not None and (
            self.play is None or self.eccentric.width.si > self.play.si
        ):
            raise ValueError("an eccentric gear needs a play of at least its width")
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Amplifier:
    """Amplifier: the controller's voltage sets a voltage (mode voltage) or current (mode current).

    ``limits`` is the kind of current limit of a motor with inductance: ``state`` stops the current
    at the limit; ``output`` clips the output of an integrator that winds up (as in simulations with
    a saturation block). ``reserve`` is the share of the voltage and current limits that a plan
    leaves to the control loop; ``current_reserve`` is another share for the current.
    """

    mode: Literal["voltage", "current"]
    gain: Annotated[Quantity, Units(("", "A/V"), positive=True)]
    voltage_limit: Annotated[Quantity, Units(("V",), positive=True)] | None = None
    current_limit: Annotated[Quantity, Units(("A",), positive=True)] | None = None
    limits: Literal["state", "output"] = "state"
    reserve: Annotated[Quantity, Units(("",), not_negative=True, most=0.9)] | None = None
    current_reserve: Annotated[Quantity, Units(("",), not_negative=True, most=0.9)] | None = None

    @model_validator(mode="after")
    def _gain_unit(self) -> Amplifier:
        wanted = "" if self.mode == "voltage" else "A/V"
        if self.gain.unit != wanted:
            raise ValueError(
                f"gain of a {self.mode} amplifier is in {wanted or 'V/V'}, not "
                f"{self.gain.unit or 'V/V, a plain number'}"
            )
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DcMotor:
    """A permanent-magnet motor with its amplifier, acting on bodies."""

    kind: Literal["dc-motor"]
    acts_on: Weights
    torque_constant: Annotated[Quantity, Units(("N*m/A", "N/A"), positive=True)]
    back_emf: Annotated[Quantity, Units(("V*s/rad", "V*s/m"), not_negative=True)]
    resistance: Annotated[Quantity, Units(("ohm",), positive=True)]
    inductance: Annotated[Quantity, Units(("H",), positive=True)] | None = None
    amplifier: Amplifier
    delay: PositiveTime | None = None


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Encoder:
    """An encoder whose reading is ``sum(resolution * coordinate)`` in whole counts.

    ``rounding`` gives the reading between two counts.
    """

    kind: Literal["encoder"]
    reads: dict[str, Resolution] = Field(min_length=1)
    rounding: Rounding = "nearest"


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Potentiometer:
    """A sensor whose voltage is ``sum(sensitivity * coordinate)``; no loop uses it."""

    kind: Literal["potentiometer"]
    reads: dict[str, Sensitivity] = Field(min_length=1)


Sensor = Annotated[Encoder | Potentiometer, Field(discriminator="kind")]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Axis:
    """An axis that jobs move: its scale, travel and hard limits.

    ``controller`` names the controller that moves it, or ``drive`` a stepper or pulse servo.
    ``deceleration`` is the limit of braking, by default ``acceleration``. ``load`` is the position
    of the mass that does the work, in axis units, as a weighted sum of coordinates; by default it
    is the position that the sensor or drive of the axis counts, not rounded. ``frame`` is the
    position of the frame in the same form. ``endless`` axes have no travel. ``stroke`` is the
    distance between the two ends of an axis on which a job may begin anywhere: no job may span
    more. ``radius`` is the distance at which a rotary axis acts on the work, by default the tool's;
    for a mandrel, ``profile`` gives it along a linear axis instead. ``working_velocity`` is the
    speed of daily work, used for warnings.
    """

    kind: Literal["linear", "rotary"]
    controller: str = ""
    drive: str = ""
    counts: Resolution
    velocity: Annotated[Quantity, Units(("m/s", "rad/s"), positive=True)]
    acceleration: Annotated[Quantity, Units(("m/s^2", "rad/s^2"), positive=True)]
    deceleration: Annotated[Quantity, Units(("m/s^2", "rad/s^2"), positive=True)] | None = None
    jerk: Annotated[Quantity, Units(("m/s^3", "rad/s^3"), positive=True)] | None = None
    travel: tuple[Position, Position] | None = None
    stroke: Position | None = None
    endless: StrictBool = False
    radius: Annotated[Quantity, Units(("m",), positive=True)] | None = None
    profile: Mandrel | None = None
    load: Weights | None = None
    frame: Weights | None = None
    working_velocity: Annotated[Quantity, Units(("m/s", "rad/s"), positive=True)] | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Axis:
        length = "m" if self.kind == "linear" else "rad"
        for name, part, wanted in (
            ("counts", self.counts, f"count/{length}"),
            ("velocity", self.velocity, f"{length}/s"),
            ("acceleration", self.acceleration, f"{length}/s^2"),
            ("deceleration", self.deceleration, f"{length}/s^2"),
            ("jerk", self.jerk, f"{length}/s^3"),
            ("working_velocity", self.working_velocity, f"{length}/s"),
        ):
            if part is not None and part.unit != wanted:
                raise ValueError(f"{name} of a {self.kind} axis is in {wanted}, not {part.unit}")
        if bool(self.controller) == bool(self.drive):
            raise ValueError(
                "an axis has either a controller, which closes a loop, or a drive that takes "
                "positions"
            )
        if self.radius is not None and self.kind == "linear":
            raise ValueError("a linear axis has no radius: remove it")
        if self.profile is not None and (self.kind == "linear" or self.radius is not None):
            raise ValueError(
                "a profile belongs to a rotary axis and replaces its radius: remove one of them"
            )
        if (self.travel is None) != self.endless:
            raise ValueError('an axis has either travel = ["min", "max"] or endless = true')
        if self.travel is not None:
            low, high = self.travel
            if low.unit != length or high.unit != length:
                raise ValueError(f"travel of a {self.kind} axis is in {length}")
            if low.si >= high.si:
                raise ValueError(f"travel must increase, got {low.si} to {high.si} {length}")
        if self.stroke is not None:
            if self.travel is None:
                raise ValueError("an endless axis has no stroke: remove it")
            if self.stroke.unit != length or self.stroke.si <= 0.0:
                raise ValueError(f"the stroke of a {self.kind} axis must be above 0, in {length}")
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class LimitSwitch:
    """A switch that cuts a drive's supply while the axis is at ``at`` or ``beyond`` it."""

    kind: Literal["limit-switch"]
    axis: str
    at: Position
    beyond: Literal["below", "above"]
    cuts: str


def switches_in_the_way(
    axes: Mapping[str, Axis], inputs: Mapping[str, LimitSwitch]
) -> Iterator[tuple[str, str, str]]:
    """Yield key, fault and remedy of each limit switch within the travel of its axis.

    Such a switch would cut the supply of a motor during a motion within all limits. Call this for
    the nominal machine only: a variant within the tolerances may have a switch a little nearer.
    """
    for name, switch in inputs.items():
        axis = axes[switch.axis]
        if axis.travel is None:
            continue
        low, high = (end.si for end in axis.travel)
        above = switch.beyond == "above"
        if switch.at.si > high if above else switch.at.si < low:
            continue
        told = [_place(value, axis.kind) for value in (switch.at.si, low, high)]
        yield (
            f"inputs.{name}.at",
            f"the limit switch cuts drives.{switch.cuts} from {told[0]} on, within the travel of "
            f"axes.{switch.axis}, {told[1]} to {told[2]}: a job within its limits would lose "
            "its motor there",
            f"End the travel before the switch, or place the switch {'above' if above else 'below'}"
            f" {told[2] if above else told[1]}.",
        )


def _place(value_si: float, kind: str) -> str:
    return f"{1e3 * value_si:.6g} mm" if kind == "linear" else f"{math.degrees(value_si):.6g} deg"


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Operator:
    """The operator's settings, as in the parameter file of the 1994 controller.

    ``manual_feed``, ``limit_feed`` and ``knots_between`` are optional: only that controller uses
    them.
    """

    normal_feed: Annotated[Quantity, Units(("count/tick",), positive=True)]
    record_every: Annotated[Quantity, Units(("tick",), positive=True, whole=True)]
    manual_feed: Annotated[Quantity, Units(("count/tick",), positive=True)] | None = None
    limit_feed: Annotated[Quantity, Units(("count/tick",), positive=True)] | None = None
    knots_between: Annotated[Quantity, Units(("",), positive=True, whole=True)] | None = None


def check_known(names: Iterable[str], among: Iterable[str], where: str, what: str) -> None:
    """Check that the names in a key exist.

    Parameters
    ----------
    names, among
        Names in the key; names that exist.
    where, what
        The key; the kind of thing that it names, for the error.

    Raises
    ------
    ValueError
        If a name is not in ``among``; names the first one.
    """
    known = list(among)
    for name in names:
        if name not in known:
            close = difflib.get_close_matches(name, known, n=1)
            hint = f"did you mean {close[0]!r}?" if close else f"there are: {', '.join(known)}."
            raise ValueError(f"{where} names the {what} {name!r}, which does not exist; {hint}")


GuideText = Annotated[str, Field(min_length=1, max_length=400)]
_Pin = Annotated[str, Field(pattern=r"^[A-Za-z0-9]{1,4}$")]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Connector:
    """A connector: its purpose and location, and the signal at each used pin."""

    title: GuideText
    pins: dict[_Pin, GuideText] = Field(min_length=1)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Guide:
    """Additional content of ``threadline guide``, which cannot be derived from other parts.

    ``presets`` are the steps from the manual of the drives, before the general calibration steps.
    """

    presets: tuple[GuideText, ...] = ()
    connectors: dict[Annotated[str, Field(pattern=r"^[A-Za-z0-9-]{1,20}$")], Connector] = Field(
        default_factory=dict
    )
