"""The parts of a machine: bodies and links between them, drives, sensors, axes, switches.

Every part is data from the machine file. A machine is a network. Each body has one coordinate. Each
link has a stretch, which is a weighted sum of coordinates. A belt between motor, head and frame, a
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
"""Rounding to the nearest whole number, down, or towards zero."""
Weights = Annotated[dict[str, Coefficient], Field(min_length=1), AfterValidator(_weighing)]
"""Weights of coordinates in a stretch, a load or a direction of force; at least one is not 0."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Body:
    """A mass with one coordinate (m or rad), counted from the start position of the machine."""

    kind: Literal["linear", "rotary"]
    """Whether the coordinate is in m or rad; it is 0 at the start position of the machine."""
    inertia: Annotated[Quantity, Units(("kg", "kg*m^2"), positive=True)]
    """Mass, or moment of inertia, of everything that moves with the coordinate."""
    damping: Annotated[Quantity, Units(("N*s/m", "N*m*s/rad"), not_negative=True)] | None = None
    """Viscous friction to the ground. Without it: 0."""
    friction: Annotated[Quantity, Units(("N", "N*m"), not_negative=True)] | None = None
    """Coulomb friction: constant force against the motion. Without it: 0."""
    stiction: Annotated[Quantity, Units(("N", "N*m"), not_negative=True)] | None = None
    """Force at breakaway, at least ``friction``. Without it: ``friction``."""

    @model_validator(mode="after")
    def _same_kind(self) -> Body:
        rotary = self.kind == "rotary"
        for name, part, unit in (
            ("inertia", self.inertia, "kg*m^2" if rotary else "kg"),
            ("damping", self.damping, "N*m*s/rad" if rotary else "N*s/m"),
            ("friction", self.friction, "N*m" if rotary else "N"),
            ("stiction", self.stiction, "N*m" if rotary else "N"),
        ):
            if part is not None and part.unit != unit:
                raise ValueError(f"{name} of a {self.kind} body is in {unit}, not {part.unit}")
        if self.stiction is not None and (
            self.friction is None or self.stiction.si < self.friction.si
        ):
            raise ValueError("stiction must come with a friction that is not larger")
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Eccentric:
    """An eccentric gear, which makes the play of a link ``play + width cos(angle)``."""

    angle: dict[str, Annotated[Quantity, Units(("", "rad/m"))]] = Field(min_length=1)
    """Weight of each coordinate in the gear's angle, which is in rad."""
    width: Annotated[Quantity, Units(("m", "rad"), positive=True)]
    """Amplitude by which the full width of the play varies, at most ``play``."""
    phase: Annotated[Quantity, Units(("rad",))]
    """The gear's angle at the start position of the machine."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Link:
    """A spring and damper whose stretch is ``sum(coefficient * coordinate)``.

    With ``preload`` the link is a belt with two runs.
    """

    stretch: Weights
    """Weight of each body's coordinate in the stretch: ``{ motor = "...", head = "-1 ..." }``. A
    link with only one body connects this body to the ground."""
    stiffness: Annotated[Quantity, Units(("N/m", "N*m/rad"), not_negative=True, certain=True)]
    """Force per stretch."""
    damping: Annotated[Quantity, Units(("N*s/m", "N*m*s/rad"), not_negative=True)] | None = None
    """Force per rate of stretch. Without it: 0."""
    preload: Annotated[Quantity, Units(("N", "N*m"), not_negative=True)] | None = None
    """Tension of each of the two runs of a belt at rest. A run falls slack when its tension falls
    to 0. Without it: never slack."""
    play: Annotated[Quantity, Units(("m", "rad"), not_negative=True)] | None = None
    """Full width of the dead band. Without it: 0."""
    first_run: Annotated[Quantity, Units(("",), positive=True)] | None = None
    """Share of the stiffness that is due to the run that a positive stretch tightens. Without it: a
    half."""
    eccentric: Eccentric | None = None
    """An eccentric gear: the play varies as the gear turns."""

    @model_validator(mode="after")
    def _consistent(self) -> Link:
        linear = self.stiffness.unit == "N/m"
        width = None if self.eccentric is None else self.eccentric.width
        for name, part, unit in (
            ("damping", self.damping, "N*s/m" if linear else "N*m*s/rad"),
            ("preload", self.preload, "N" if linear else "N*m"),
            ("play", self.play, "m" if linear else "rad"),
            ("eccentric.width", width, "m" if linear else "rad"),
        ):
            if part is not None and part.unit != unit:
                raise ValueError(
                    f"{name} is in {part.unit}; with a stiffness in {self.stiffness.unit} "
                    f"it must be in {unit}"
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
    """An amplifier: the controller's voltage sets a voltage or a current."""

    mode: Literal["voltage", "current"]
    """Quantity that the input sets: the output voltage or the output current."""
    gain: Annotated[Quantity, Units(("", "A/V"), positive=True)]
    """Volts per volt (a plain number) in mode ``voltage``, amperes per volt in mode ``current``."""
    voltage_limit: Annotated[Quantity, Units(("V",), positive=True)] | None = None
    """Highest output voltage."""
    current_limit: Annotated[Quantity, Units(("A",), positive=True)] | None = None
    """Highest output current."""
    limits: Literal["state", "output"] = "state"
    """How the current of a motor with ``inductance`` is limited. ``state``: the current itself
    stays at the limit. ``output``: the current that acts is clipped, but the integrated current is
    not limited."""
    reserve: Annotated[Quantity, Units(("",), not_negative=True, most=0.9)] | None = None
    """Share of voltage and current that ``--interpolation optimal`` reserves for the control loop,
    at most 90 %. Without it: 10 %."""
    current_reserve: Annotated[Quantity, Units(("",), not_negative=True, most=0.9)] | None = None
    """Reserved share of the current, if it differs. Without it: ``reserve``."""

    @model_validator(mode="after")
    def _gain_unit(self) -> Amplifier:
        unit = "" if self.mode == "voltage" else "A/V"
        if self.gain.unit != unit:
            raise ValueError(
                f"gain of a {self.mode} amplifier is in {unit or 'V/V'}, not "
                f"{self.gain.unit or 'V/V, a plain number'}"
            )
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DcMotor:
    """A permanent-magnet motor with its amplifier, acting on bodies."""

    kind: Literal["dc-motor"]
    """A brushed motor with permanent magnets, or a servo motor that behaves like one."""
    acts_on: Weights
    """The bodies that the motor moves, each with its weight: 1 for its own rotor."""
    torque_constant: Annotated[Quantity, Units(("N*m/A", "N/A"), positive=True)]
    """Torque per ampere; force per ampere of a linear motor."""
    back_emf: Annotated[Quantity, Units(("V*s/rad", "V*s/m"), not_negative=True)]
    """Induced voltage per speed."""
    resistance: Annotated[Quantity, Units(("ohm",), positive=True)]
    """Resistance of the winding and its leads."""
    inductance: Annotated[Quantity, Units(("H",), positive=True)] | None = None
    """Inductance of the winding. Without it: 0."""
    amplifier: Amplifier
    """The amplifier that feeds the motor."""
    delay: PositiveTime | None = None
    """Dead time between the controller's output and the amplifier. Without it: 0."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Encoder:
    """An encoder whose reading is ``sum(resolution * coordinate)`` in whole counts."""

    kind: Literal["encoder"]
    """An encoder at a motor, or a scale at the head; control loops may read it."""
    reads: dict[str, Resolution] = Field(min_length=1)
    """Counts per unit of each body's coordinate; the reading is a whole number of counts."""
    rounding: Rounding = "nearest"
    """Reading at a position between two counts: the nearest count, the count below (``floor``), or
    the count towards zero (``truncate``)."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Potentiometer:
    """A sensor whose voltage is ``sum(sensitivity * coordinate)``, counted from the start."""

    kind: Literal["potentiometer"]
    """A potentiometer; a state-space controller may read it."""
    reads: dict[str, Sensitivity] = Field(min_length=1)
    """Voltage per unit of each body's coordinate."""
    range: Annotated[Quantity, Units(("V",), positive=True)] | None = None
    """Largest magnitude of the reading, counted from the start; the reading is clamped to it.
    Without it: no limit."""
    resolution: Annotated[Quantity, Units(("V",), positive=True)] | None = None
    """Step of the converter: the reading is rounded to a multiple of it. Without it: no rounding.
    """
    noise: Annotated[Quantity, Units(("V",), not_negative=True)] | None = None
    """Standard deviation of the noise, drawn anew for every reading. Without it: 0."""


Acceleration = Annotated[Quantity, Units(("m/s^2", "rad/s^2"), positive=True)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Accelerometer:
    """A sensor whose reading is ``sum(weight * acceleration)`` of bodies, in m/s^2 or rad/s^2."""

    kind: Literal["accelerometer"]
    """An accelerometer; a state-space controller may read it."""
    reads: Weights
    """Bodies whose acceleration the sensor measures, each with its weight: 1 for a sensor that is
    fixed to the body."""
    range: Acceleration | None = None
    """Largest magnitude of the reading; the reading is clamped to it. Without it: no limit."""
    resolution: Acceleration | None = None
    """Step of the converter: the reading is rounded to a multiple of it. Without it: no rounding.
    """
    noise: Annotated[Quantity, Units(("m/s^2", "rad/s^2"), not_negative=True)] | None = None
    """Standard deviation of the noise, drawn anew for every reading. Without it: 0."""


Sensor = Annotated[Encoder | Potentiometer | Accelerometer, Field(discriminator="kind")]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Axis:
    """An axis that jobs move: its scale, travel and hard limits."""

    kind: Literal["linear", "rotary"]
    """Whether positions are lengths or angles."""
    controller: str = ""
    """The controller that moves the axis. Without it: ``drive``."""
    drive: str = ""
    """The stepper, pulse servo or kinematic drive that takes the positions of the axis. Without it:
    ``controller``."""
    counts: Resolution
    """Counts of the encoder, or microsteps, per unit of the axis."""
    velocity: Annotated[Quantity, Units(("m/s", "rad/s"), positive=True)]
    """Limit of the speed."""
    acceleration: Annotated[Quantity, Units(("m/s^2", "rad/s^2"), positive=True)]
    """Limit of the acceleration."""
    deceleration: Annotated[Quantity, Units(("m/s^2", "rad/s^2"), positive=True)] | None = None
    """Limit of braking. Without it: ``acceleration``."""
    jerk: Annotated[Quantity, Units(("m/s^3", "rad/s^3"), positive=True)] | None = None
    """Limit of the jerk. Without it: the acceleration may step."""
    travel: tuple[Position, Position] | None = None
    """Lowest and highest position: ``["-500 mm ...", "500 mm ..."]``. Without it: ``endless``."""
    stroke: Position | None = None
    """Distance between the two ends of an axis on which a job may begin anywhere: the largest span
    of a job. Without it: only ``travel`` limits a job."""
    endless: StrictBool = False
    """Whether the axis turns without end and has no ``travel``."""
    wrapped: StrictBool = False
    """Whether LinuxCNC reads the angles of an endless rotary axis modulo one turn, as with its
    setting ``WRAPPED_ROTARY``: in G90 an angle is below 360 degrees, and its sign gives the
    direction in which the axis turns to it."""
    radius: Annotated[Quantity, Units(("m",), positive=True)] | None = None
    """Distance at which a rotary axis acts on the work: the mandrel's radius, or half of the band's
    width for an eye that rolls. Without it: ``radius`` of ``[tool]``."""
    profile: Mandrel | None = None
    """Radius of a mandrel along a linear axis, in place of ``radius``."""
    load: Weights | None = None
    """Position of the mass that does the work, in axis units, by weights of the bodies. This
    position is judged. If another body holds the work, its weight is included: a head over cloth on
    a springy frame is judged relative to the frame (``stitcher+cloth-on-frame``). Without it: the
    position that the encoder or drive counts, unrounded."""
    frame: Weights | None = None
    """Position of the machine's frame, in the form of ``load``. Without it: not recorded."""
    working_velocity: Annotated[Quantity, Units(("m/s", "rad/s"), positive=True)] | None = None
    """Speed of daily work, for warnings."""

    @model_validator(mode="after")
    def _consistent(self) -> Axis:
        length_unit = "m" if self.kind == "linear" else "rad"
        for name, part, unit in (
            ("counts", self.counts, f"count/{length_unit}"),
            ("velocity", self.velocity, f"{length_unit}/s"),
            ("acceleration", self.acceleration, f"{length_unit}/s^2"),
            ("deceleration", self.deceleration, f"{length_unit}/s^2"),
            ("jerk", self.jerk, f"{length_unit}/s^3"),
            ("working_velocity", self.working_velocity, f"{length_unit}/s"),
        ):
            if part is not None and part.unit != unit:
                raise ValueError(f"{name} of a {self.kind} axis is in {unit}, not {part.unit}")
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
            if low.unit != length_unit or high.unit != length_unit:
                raise ValueError(f"travel of a {self.kind} axis is in {length_unit}")
            if low.si >= high.si:
                raise ValueError(f"travel must increase, got {low.si} to {high.si} {length_unit}")
        if self.wrapped and not (self.kind == "rotary" and self.endless):
            raise ValueError("wrapped is for a rotary axis with endless = true: remove it")
        if self.stroke is not None:
            if self.travel is None:
                raise ValueError("an endless axis has no stroke: remove it")
            if self.stroke.unit != length_unit or self.stroke.si <= 0.0:
                raise ValueError(
                    f"the stroke of a {self.kind} axis must be above 0, in {length_unit}"
                )
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class LimitSwitch:
    """A switch that cuts a drive's supply while the axis is at ``at`` or ``beyond`` it."""

    kind: Literal["limit-switch"]
    """A limit switch."""
    axis: str
    """The axis whose position closes the switch."""
    at: Position
    """Position at which the switch closes."""
    beyond: Literal["below", "above"]
    """On which side of ``at`` the switch is closed."""
    cuts: str
    """The drive whose supply the switch cuts."""


class SupplyCut(LimitSwitch):
    """A switch that cuts the supply of a drive on purpose, within the travel of its axis.

    A machine file cannot have such a switch; an experiment adds it.
    """


def switches_in_the_way(
    axes: Mapping[str, Axis], inputs: Mapping[str, LimitSwitch]
) -> Iterator[tuple[str, str, str]]:
    """Yield key, fault and remedy of each limit switch within the travel of its axis.

    Such a switch would cut the supply of a motor during a motion that keeps all limits. Call this
    for the nominal machine only: a switch of a variant within the tolerances may be closer.
    """
    for name, switch in inputs.items():
        axis = axes[switch.axis]
        if axis.travel is None:
            continue
        low, high = (end.si for end in axis.travel)
        above = switch.beyond == "above"
        if switch.at.si > high if above else switch.at.si < low:
            continue
        places = [_place(value, axis.kind) for value in (switch.at.si, low, high)]
        yield (
            f"inputs.{name}.at",
            f"the limit switch cuts drives.{switch.cuts} from {places[0]} on, within the travel of "
            f"axes.{switch.axis}, {places[1]} to {places[2]}: a job within its limits would lose "
            "its motor there",
            f"End the travel before the switch, or place the switch {'above' if above else 'below'}"
            f" {places[2] if above else places[1]}.",
        )


def _place(value_si: float, kind: str) -> str:
    return f"{1e3 * value_si:.6g} mm" if kind == "linear" else f"{math.degrees(value_si):.6g} deg"


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Operator:
    """The operator's settings, as in the parameter file of the 1994 controller."""

    normal_feed: Annotated[Quantity, Units(("count/tick",), positive=True)]
    """Upper limit of every programmed feed, measured on the fastest axis, unless ``--feed`` is
    given; also the feed of a move without F. A machine that is based on this one does not inherit
    it."""
    record_every: Annotated[Quantity, Units(("tick",), positive=True, whole=True)]
    """Ticks between two positions of the 1994 recording, as ``prove`` reports it; the simulation
    records every tick."""
    manual_feed: Annotated[Quantity, Units(("count/tick",), positive=True)] | None = None
    """Feed of manual control; nothing uses it."""
    limit_feed: Annotated[Quantity, Units(("count/tick",), positive=True)] | None = None
    """Largest value of the other two feeds in a parameter file; it does not limit a plan."""
    knots_between: Annotated[Quantity, Units(("",), positive=True, whole=True)] | None = None
    """Number of points that the 1994 controller inserted between two points of a spline; nothing
    uses it, because splines are exact here."""


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
    """Purpose and location of the connector."""
    pins: dict[_Pin, GuideText] = Field(min_length=1)
    """The signal at each used pin: ``{ 1 = "opto-switch, Y axis" }``."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Guide:
    """Content of ``threadline guide`` that cannot be derived from the other parts."""

    presets: tuple[GuideText, ...] = ()
    """Steps that the manual of the drives requires before the general steps."""
    connectors: dict[Annotated[str, Field(pattern=r"^[A-Za-z0-9-]{1,20}$")], Connector] = Field(
        default_factory=dict
    )
    """Connectors by name."""
