"""Parts of an on/off machine: cylinders, valves that set their speed, contacts and the PLC.

A flow control after an open valve lets the exhaust out at a set rate. The open valves therefore set
the *speed* of the piston and not its force. The speed is ``speed`` times the sum of the open flows,
because flow controls of one direction work in parallel. Every subset of these flow controls gives a
speed level.

A rotary cylinder (a vane, or pistons on a rack) has the same equations with angles: its stroke,
speed and switches are in rad, and its forces are torques.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.parts import STRICT, PositiveTime, Weights
from threadline.machine.quantity import Quantity, Units

Length = Annotated[Quantity, Units(("m", "rad"), positive=True)]
ShortTime = Annotated[Quantity, Units(("s",), positive=True, most=100.0)]
"""A delay or lag of compressed air, at most 100 s; one second is already a long lag."""
ATMOSPHERE_PA = 101_325.0
SPRING_OF_FORCE = 5.6
"""Dimensionless stiffness of the air in the middle of a stroke: stiffness times stroke / (p A), the
force of the absolute pressure. The stiffness is 1.4 p A (1/l1 + 1/l2), and both chambers are half a
stroke long."""
REST_LAGS = 4.0
"""Time from the end of the flow, in time constants, until a cylinder is at rest within 2 %."""
MOST_SCANS = 100
"""Longest watchdog, in scans. Plants use a few scans; a longer watchdog would not protect them."""
TIMES = (".delay", ".opens", ".closes")
"""Last parts of the dotted names of numbers that set instants of a simulation."""
# A byte and its bit, or the number of a bit. No leading zeros, so that each bit has one spelling.
InputAddress = Annotated[str, Field(pattern=r"^%IX(0|[1-9][0-9]{0,3})(\.[0-7])?$")]
OutputAddress = Annotated[str, Field(pattern=r"^%QX(0|[1-9][0-9]{0,3})(\.[0-7])?$")]
Fraction = Annotated[Quantity, Units(("",), positive=True)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Output:
    """A digital output of the PLC."""

    kind: Literal["direction", "flow", "soft-start", "vacuum", "tool"]
    """Purpose of the output."""
    address: OutputAddress
    """Address in the PLC, ``%QX0.1``: byte and bit, 0 to 7, without leading zeros."""
    ramp: PositiveTime | None = None
    """Time in which a soft-start valve builds up full pressure; the program waits for the upper end
    of its tolerance. Without it: no soft-start valve."""
    needs: tuple[str, ...] = ()
    """Interlock of a tool or a vacuum: end switches that must be on while the output is on."""

    @property
    def ramp_s(self) -> float:
        """Longest time until the circuit is under pressure, with tolerance; 0 without a ramp."""
        return 0.0 if self.ramp is None else self.ramp.most

    @model_validator(mode="after")
    def _check_kind_keys(self) -> Output:
        if (self.kind == "soft-start") != (self.ramp is not None):
            raise ValueError("a soft-start valve needs a ramp; other outputs have none")
        if self.needs and self.kind not in {"tool", "vacuum"}:
            raise ValueError(
                f"only a tool, a vacuum or a cylinder has needs, not a {self.kind} output"
            )
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Contact:
    """A digital input of the PLC."""

    kind: Literal["light-grid", "enable", "start", "acknowledge", "home", "contact"]
    """Purpose of the input: ``light-grid`` and ``enable`` are true while the machine may move,
    ``start`` asks for a cycle, ``home`` asks for a return to the home position, ``acknowledge``
    clears a fault, and ``contact`` is any other input."""
    address: InputAddress
    """Address in the PLC, ``%IX0.1``: byte and bit, 0 to 7, without leading zeros."""
    cylinder: str | None = None
    """For an end switch: its cylinder. ``at`` and ``beyond`` come with it."""
    at: Annotated[Quantity, Units(("m", "rad"), not_negative=True)] | None = None
    """For an end switch: position at which it closes. This position is inside the stroke by more
    than its tolerance, and no switch of the other end is closed there."""
    beyond: Literal["below", "above"] | None = None
    """For an end switch: the side of ``at`` on which it is closed."""

    @model_validator(mode="after")
    def _complete(self) -> Contact:
        given = [part is not None for part in (self.cylinder, self.at, self.beyond)]
        if any(given) and not all(given):
            raise ValueError("an end switch needs cylinder, at and beyond")
        if any(given) and self.kind != "contact":
            raise ValueError(f"a {self.kind} has no cylinder")
        return self


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Way:
    """One direction of motion of a cylinder: the valve that selects it, and its flow controls."""

    valve: str
    """The output of kind ``direction`` that selects this direction."""
    flows: dict[str, Fraction] = Field(min_length=1)
    """Outputs of kind ``flow``, each with its share of ``speed``; the shares of outputs that are on
    add up."""
    opens: ShortTime | None = None
    """Time from the command of one of these valves to its flow, in addition to ``delay``. Without
    it: 0."""
    closes: ShortTime | None = None
    """Time from the end of the command to the end of the flow, in addition to ``delay``. Without
    it: 0."""

    def levels(self) -> dict[tuple[str, ...], float]:
        """Return every set of open flow controls, including the empty set, with its level."""
        names = list(self.flows)
        return {
            open_flows: sum(self.flows[n].si for n in open_flows)
            for size in range(len(names) + 1)
            for open_flows in combinations(names, size)
        }

    @property
    def opens_s(self) -> float:
        """Delay from the command to the opening of its valves, s."""
        return 0.0 if self.opens is None else self.opens.si

    @property
    def closes_s(self) -> float:
        """Delay from the command to the closing of its valves, s."""
        return 0.0 if self.closes is None else self.closes.si

    def least_hold_s(self, plc: Plc) -> float:
        """Return the shortest allowed time between two switchings of one of its valves, s."""
        return max(plc.dwell.si, self.opens_s, self.closes_s)

    @property
    def level_tolerance(self) -> float:
        """Tolerance of the level with all flow controls open."""
        return sum(flow.tolerance_si for flow in self.flows.values())


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Cushion:
    """End cushioning: the exhaust is throttled over the last part of the stroke.

    A piston with metered exhaust moves at the speed of the flow, whatever force opposes it. A
    cushion therefore slows the piston by reducing the flow.
    """

    length: Length
    """Length of the throttled end of the stroke."""
    flow: Fraction
    """Share of the flow that the throttled exhaust lets through."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Torque:
    """Torque of a rotary cylinder with a vane, or with pistons on a rack."""

    pressure: Annotated[Quantity, Units(("Pa",), positive=True, most=5e6)]
    """Gauge pressure of the supply."""
    area: Annotated[Quantity, Units(("m^2",), positive=True)]
    """Area of the vane, or of one piston on the rack."""
    radius: Annotated[Quantity, Units(("m",), positive=True)]
    """Distance of the middle of the vane from the shaft, or pitch radius of the pinion."""
    pistons: Annotated[Quantity, Units(("",), positive=True, whole=True)] | None = None
    """Vanes, or pistons on racks, that push together. Without it: 1."""

    @property
    def lever_m3(self) -> float:
        """Torque / pressure, m^3."""
        return self.area.si * self.radius.si * (1.0 if self.pistons is None else self.pistons.si)

    @property
    def torque_n_m(self) -> float:
        """Torque at standstill with an empty exhaust, N m."""
        return self.pressure.si * self.lever_m3


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Cylinder:
    """A pneumatic axis: valves set the speed of a flow, which moves the piston.

    The air between flow and piston is a spring with a damper.
    """

    kind: Literal["linear", "rotary"] = "linear"
    """``rotary`` for a vane, or for pistons on a rack: the stroke is an angle, and both bodies
    (``pushes``, ``reacts_on``) are rotary. Without it: linear."""
    radius: Annotated[Quantity, Units(("m",), positive=True)] | None = None
    """Distance from the shaft at which a rotary cylinder does its work; not for a linear cylinder.
    """
    pushes: str
    """The body that the piston pushes."""
    reacts_on: str
    """The body that the cylinder is fixed to. A link, or a chain of links, connects this body with
    ``pushes``; the stiffness of a link between the two may be 0."""
    frame: Weights
    """Position whose vibration is judged, in m: weights of the bodies, in m/rad for rotary bodies.
    """
    stroke: Length
    """Largest position of the piston; the smallest is 0."""
    speed: Annotated[Quantity, Units(("m/s", "rad/s"), positive=True)]
    """Speed of the piston with all flow controls of a direction open (level 1)."""
    forward: Way
    """Valve and flow controls of the outward stroke."""
    back: Way
    """Valve and flow controls of the return stroke."""
    delay: ShortTime
    """Time from a valve's command to the first flow."""
    lag: ShortTime
    """Time constant of the first-order lag from the flow command to the speed."""
    air_stiffness: Annotated[Quantity, Units(("N/m", "N*m/rad"), positive=True)] | None = None
    """Stiffness of the air between flow and piston. A rotary cylinder may give ``torque`` instead.
    """
    torque: Torque | None = None
    """Pressure, area and radius that give the torque of a rotary cylinder. They also give the
    stiffness of the air in the middle of the stroke: ``5.6 p A r / stroke``, with p absolute."""
    air_damping: Annotated[Quantity, Units(("N*s/m", "N*m*s/rad"), not_negative=True)]
    """Damping of that air."""
    air_ramp: Length | None = None
    """Distance over which the damping of the air builds up after a standstill. Without it: 0."""
    cushion: Cushion | None = None
    """End cushioning."""
    friction: Annotated[Quantity, Units(("N", "N*m"), not_negative=True)] | None = None
    """Friction between piston and housing. Without it: 0."""
    stiction: Annotated[Quantity, Units(("N", "N*m"), not_negative=True)] | None = None
    """Force at breakaway, at least ``friction``. Without it: ``friction``."""
    needs: tuple[str, ...] = ()
    """Interlock: end switches of other cylinders that must be on while this cylinder moves."""

    @model_validator(mode="after")
    def _stiction(self) -> Cylinder:
        if self.stiction is not None and (
            self.friction is None or self.stiction.si < self.friction.si
        ):
            raise ValueError("stiction must come with a friction that is not larger")
        return self

    @model_validator(mode="after")
    def _of_its_kind(self) -> Cylinder:
        rotary = self.kind == "rotary"
        length_unit = "rad" if rotary else "m"
        stiffness_unit, damping_unit = ("N*m/rad", "N*m*s/rad") if rotary else ("N/m", "N*s/m")
        cushion_length = None if self.cushion is None else self.cushion.length
        for name, part, unit in (
            ("stroke", self.stroke, length_unit),
            ("speed", self.speed, f"{length_unit}/s"),
            ("air_stiffness", self.air_stiffness, stiffness_unit),
            ("air_damping", self.air_damping, damping_unit),
            ("air_ramp", self.air_ramp, length_unit),
            ("cushion.length", cushion_length, length_unit),
            ("friction", self.friction, "N*m" if rotary else "N"),
            ("stiction", self.stiction, "N*m" if rotary else "N"),
        ):
            if part is not None and part.unit != unit:
                raise ValueError(
                    f"{name} of a {self.kind} cylinder is in {unit}, not {part.unit}"
                    + ("" if rotary else '; one that turns has kind = "rotary"')
                )
        if cushion_length is not None and cushion_length.si >= self.stroke.si:
            raise ValueError(
                f"cushion.length {self.place(cushion_length.si)} is not shorter than the stroke, "
                f"{self.place(self.stroke.si)}"
            )
        if rotary != (self.radius is not None):
            raise ValueError(
                "radius is missing: a rotary cylinder does its work at some distance from its shaft"
                if rotary
                else "a linear cylinder has no radius"
            )
        if self.torque is not None and not rotary:
            raise ValueError("torque belongs to a rotary cylinder; a linear one has air_stiffness")
        if (self.air_stiffness is None) == (self.torque is None):
            either = " or torque" if rotary else ""
            raise ValueError(
                f"air_stiffness{either} is missing"
                if self.torque is None
                else "air_stiffness and torque both give the stiffness of the air: remove one"
            )
        return self

    @property
    def usual(self) -> tuple[float, str]:
        """Factor from SI to the usual unit of its positions, and that unit: mm or deg."""
        return (1e3, "mm") if self.kind == "linear" else (180.0 / math.pi, "deg")

    def pace(self, speed: float, form: str = "g") -> str:
        """Return a speed as text: ``0.43 m/s``, ``180 deg/s``."""
        return f"{speed:{form}} m/s" if self.kind == "linear" else f"{self.place(speed, form)}/s"

    def place(self, at: float, form: str = "g") -> str:
        """Return a position as text in the usual unit: ``200 mm``, ``90 deg``."""
        factor, unit = self.usual
        return f"{at * factor:{form}} {unit}"

    def way(self, forward: bool) -> Way:
        """Return the valve and flow controls of one direction."""
        return self.forward if forward else self.back

    def rest_s(self, forward: bool) -> float:
        """Return the time from the last switching of a move to the rest of the piston, s."""
        return self.way(forward).closes_s + self.delay.si + REST_LAGS * self.lag.si

    def longest_rest_s(self, forward: bool) -> float:
        """Return ``rest_s`` with every number at the end of its tolerance that makes it longer."""
        closes = self.way(forward).closes
        closing_s = 0.0 if closes is None else closes.most
        return closing_s + self.delay.most + REST_LAGS * self.lag.most


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Plc:
    """The controller of an on/off machine."""

    clock: str
    """Clock of the scans, a name of ``[clocks]``."""
    watchdog: PositiveTime
    """Longest time of a scan that is not a fault: more than one scan, and at most 100 scans."""
    dwell: PositiveTime
    """Shortest time between two switchings of one valve."""
    never_over: bool
    """Whether no command may exceed the unshaped level."""
    jitter: Annotated[Quantity, Units(("",), not_negative=True, most=0.5)] | None = None
    """Share of a scan by which each scan may begin early or late, such as 0.2; at most 0.5. It is
    drawn for every scan of every run except the nominal run. Without it: 0."""


def check_addresses(outputs: Mapping[str, Output], contacts: Mapping[str, Contact]) -> None:
    """Check that no two inputs or outputs share a bit: ``%IX8`` and ``%IX1.0`` are the same.

    Raises
    ------
    ValueError
        If two share a bit; names both.
    """
    taken: dict[tuple[str, int], str] = {}
    for table, parts in (("outputs", outputs), ("contacts", contacts)):
        for name, part in parts.items():
            number, _, bit = part.address[3:].partition(".")
            key = table, 8 * int(number) + int(bit) if bit else int(number)
            if key in taken:
                raise ValueError(f"{table}.{name}.address: {taken[key]} already has {part.address}")
            taken[key] = name


def check_contacts(
    cylinders: Mapping[str, Cylinder],
    outputs: Mapping[str, Output],
    contacts: Mapping[str, Contact],
) -> None:
    """Check that every end switch can be on and off, and that interlocks name end switches.

    Raises
    ------
    ValueError
        If a switch is always on or always off, if an interlock names anything but an end switch, or
        if a cylinder's interlock names one of its own end switches.
    """
    for name, contact in contacts.items():
        if contact.cylinder is None or contact.at is None:
            continue
        part = cylinders[contact.cylinder]
        if contact.at.unit != part.stroke.unit:
            raise ValueError(
                f"contacts.{name}.at: it is in {contact.at.unit}, and the stroke of "
                f"{contact.cylinder}, a {part.kind} cylinder, in {part.stroke.unit}"
            )
        stroke, at = part.stroke.si, contact.at.si
        if at > stroke or (at == stroke and contact.beyond == "below"):
            raise ValueError(
                f"contacts.{name}.at: {part.place(at)} is not within the stroke of "
                f"{contact.cylinder}, {part.place(stroke)}, so that the switch would always be "
                f"{'on' if contact.beyond == 'below' else 'off'}"
            )
    parts = [(f"cylinders.{name}", name, part.needs) for name, part in cylinders.items()]
    parts += [(f"outputs.{name}", "", part.needs) for name, part in outputs.items()]
    for where, own, needs in parts:
        for name in needs:
            if name not in contacts or contacts[name].cylinder is None:
                end_switches = [n for n, c in contacts.items() if c.cylinder not in {None, own}]
                raise ValueError(
                    f"{where}.needs names {name!r}, which is not an end switch; "
                    f"there are: {', '.join(end_switches)}"
                )
            if contacts[name].cylinder == own:
                raise ValueError(
                    f"{where}.needs names {name!r}, an end switch of {own} itself, which opens "
                    "as it moves"
                )


def switch_faults(
    cylinders: Mapping[str, Cylinder], contacts: Mapping[str, Contact]
) -> Iterator[tuple[str, str, str]]:
    """Yield key, fault and remedy of each end switch whose tolerance makes it useless.

    Call this for the nominal machine only: a variant has shifted values with the same tolerances,
    which may then lie partly outside of the stroke.
    """
    for name, contact in contacts.items():
        if contact.cylinder is None or contact.at is None:
            continue
        cylinder = cylinders[contact.cylinder]
        stroke = cylinder.stroke.si
        reaches_start, reaches_end = contact.at.least <= 0.0, contact.at.most >= stroke
        if contact.at.tolerance_si and (reaches_start or reaches_end):
            always_on = reaches_start == (contact.beyond == "above")
            yield (
                f"contacts.{name}.at",
                f"{_within(cylinder, contact.at)} reaches the end of the stroke of "
                f"{contact.cylinder} at {cylinder.place(0.0 if reaches_start else stroke)}, so "
                f"that the switch may {'always' if always_on else 'never'} be on",
                "Move the switch into the stroke by more than its tolerance.",
            )
        for other_name, other_contact in contacts.items():
            if other_contact.at is None or other_contact.cylinder != contact.cylinder:
                continue
            face_each_other = (contact.beyond, other_contact.beyond) == ("below", "above")
            if face_each_other and contact.at.most >= other_contact.at.least:
                yield (
                    f"contacts.{name}.at",
                    f"on below {_within(cylinder, contact.at)}, and {other_name} above "
                    f"{_within(cylinder, other_contact.at)}: both end switches of "
                    f"{contact.cylinder} can be on at once",
                    "Move them apart by more than their tolerances.",
                )


def _within(cylinder: Cylinder, at: Quantity) -> str:
    tolerance = f" +- {cylinder.place(at.tolerance_si)}" if at.tolerance_si else ""
    return f"{cylinder.place(at.si)}{tolerance}"
