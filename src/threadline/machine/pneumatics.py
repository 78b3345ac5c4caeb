"""Parts of an on/off machine: cylinders, valves that set their speed, contacts and the PLC.

A flow control behind an open valve lets the exhaust out at a set rate. The open valves therefore
set the *speed* of the piston, not its force: ``speed`` times the sum of their flows, because flow
controls of one direction work in parallel. Every subset of them gives a speed level.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Annotated, Literal

from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.parts import STRICT, PositiveTime, Weights
from threadline.machine.quantity import Quantity, Units

Length = Annotated[Quantity, Units(("m",), positive=True)]
ShortTime = Annotated[Quantity, Units(("s",), positive=True, most=100.0)]
"""A delay or lag of compressed air, of at most 100 s; one second is long."""
REST_LAGS = 4.0
"""Time after the end of the flow, in lags, until a cylinder is at rest within 2 %."""
MOST_SCANS = 100
"""Longest watchdog, in scans. Plants use a few scans; a longer watchdog protects nothing."""
TIMES = (".delay", ".opens", ".closes")
"""Last parts of the paths of numbers that are instants of a simulation."""
# A byte and its bit, or the number of a bit. No leading zeros, so each bit has one spelling.
InputAddress = Annotated[str, Field(pattern=r"^%IX(0|[1-9][0-9]{0,3})(\.[0-7])?$")]
OutputAddress = Annotated[str, Field(pattern=r"^%QX(0|[1-9][0-9]{0,3})(\.[0-7])?$")]
Fraction = Annotated[Quantity, Units(("",), positive=True)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Output:
    """A digital output of the PLC.

    ``ramp`` is the time that a soft-start valve takes to pressurise the circuit. ``needs`` is the
    interlock of a tool or a vacuum: end switches that must be on while the output is on.
    """

    kind: Literal["direction", "flow", "soft-start", "vacuum", "tool"]
    address: OutputAddress
    ramp: PositiveTime | None = None
    needs: tuple[str, ...] = ()

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
    """A digital input of the PLC.

    ``light-grid`` and ``enable`` are true while the machine may move; ``start`` starts a cycle,
    ``home`` the return to the home position, and ``acknowledge`` clears a fault. A ``contact`` with
    a ``cylinder`` is an end switch, closed while the cylinder is at ``at`` or beyond; without a
    cylinder it is an external input.
    """

    kind: Literal["light-grid", "enable", "start", "acknowledge", "home", "contact"]
    address: InputAddress
    cylinder: str | None = None
    at: Annotated[Quantity, Units(("m",), not_negative=True)] | None = None
    beyond: Literal["below", "above"] | None = None

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
    """One direction of a cylinder: the valve that selects it, and its flow controls.

    ``opens`` is the delay from the command of one of these valves to its flow, and ``closes`` from
    the end of the command to the end of the flow; a delay common to both may be in the ``delay`` of
    the cylinder. None means no delay.
    """

    valve: str
    flows: dict[str, Fraction] = Field(min_length=1)
    opens: ShortTime | None = None
    closes: ShortTime | None = None

    def levels(self) -> dict[tuple[str, ...], float]:
        """Return every set of open flow controls, including the empty set, with its level."""
        names = list(self.flows)
        return {
            chosen: sum(self.flows[n].si for n in chosen)
            for size in range(len(names) + 1)
            for chosen in combinations(names, size)
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
    """End cushioning: over the last ``length`` of the stroke the exhaust is throttled to ``flow``.

    A piston with metered exhaust moves at the speed of the flow, independent of the opposing force,
    so a cushion slows it by reducing the flow.
    """

    length: Length
    flow: Fraction


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Cylinder:
    """A pneumatic axis: valves set the speed of a flow, which moves the piston by an air spring.

    The piston pushes the body ``pushes``, and its reaction acts on ``reacts_on``. ``delay`` is the
    time from a valve's command to the first flow, and ``lag`` the time constant of the flow's
    speed. The air is a spring with a damper between flow and piston; ``air_ramp`` is the distance
    over which its damping builds up after each standstill. ``friction`` and ``stiction`` act
    between piston and housing. ``frame`` gives the position whose vibration is judged, as a
    weighted sum of coordinates. ``needs`` is its interlock: end switches of other cylinders that
    must be on while it moves.
    """

    pushes: str
    reacts_on: str
    frame: Weights
    stroke: Length
    speed: Annotated[Quantity, Units(("m/s",), positive=True)]
    forward: Way
    back: Way
    delay: ShortTime
    lag: ShortTime
    air_stiffness: Annotated[Quantity, Units(("N/m",), positive=True)]
    air_damping: Annotated[Quantity, Units(("N*s/m",), not_negative=True)]
    air_ramp: Length | None = None
    cushion: Cushion | None = None
    friction: Annotated[Quantity, Units(("N",), not_negative=True)] | None = None
    stiction: Annotated[Quantity, Units(("N",), not_negative=True)] | None = None
    needs: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _stiction(self) -> Cylinder:
        if self.stiction is not None and (
            self.friction is None or self.stiction.si < self.friction.si
        ):
            raise ValueError("stiction must come with a friction that is not larger")
        return self

    def way(self, forward: bool) -> Way:
        """Return the valve and flow controls of one direction."""
        return self.forward if forward else self.back

    def rest_s(self, forward: bool) -> float:
        """Return the time from its last switching to its rest, s."""
        return self.way(forward).closes_s + self.delay.si + REST_LAGS * self.lag.si

    def longest_rest_s(self, forward: bool) -> float:
        """Return the time from its last switching to its rest, at the end of its tolerances."""
        closes = self.way(forward).closes
        shut_s = 0.0 if closes is None else closes.most
        return shut_s + self.delay.most + REST_LAGS * self.lag.most


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Plc:
    """The controller of an on/off machine.

    ``dwell`` is the shortest time between two switchings of one valve. A scan that takes longer
    than ``watchdog`` is a fault. With ``never_over``, shaped commands may not exceed the unshaped
    level.
    """

    clock: str
    watchdog: PositiveTime
    dwell: PositiveTime
    never_over: bool


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
        If a switch is always on or always off; if an interlock names something else than an end
        switch, or a cylinder's interlock names its own end switch.
    """
    for name, contact in contacts.items():
        if contact.cylinder is None or contact.at is None:
            continue
        stroke, at = cylinders[contact.cylinder].stroke.si, contact.at.si
        if at > stroke or (at == stroke and contact.beyond == "below"):
            raise ValueError(
                f"contacts.{name}.at: {at * 1e3:g} mm is not within the stroke of "
                f"{contact.cylinder}, {stroke * 1e3:g} mm, so that the switch would always be "
                f"{'on' if contact.beyond == 'below' else 'off'}"
            )
    parts = [(f"cylinders.{name}", name, one.needs) for name, one in cylinders.items()]
    parts += [(f"outputs.{name}", "", one.needs) for name, one in outputs.items()]
    for where, own, needs in parts:
        for name in needs:
            if name not in contacts or contacts[name].cylinder is None:
                known = [n for n, c in contacts.items() if c.cylinder not in {None, own}]
                raise ValueError(
                    f"{where}.needs names {name!r}, which is not an end switch; "
                    f"there are: {', '.join(known)}"
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

    Call this for the nominal machine only: a variant keeps the tolerances, which may then lie
    partly outside.
    """
    for name, contact in contacts.items():
        if contact.cylinder is None or contact.at is None:
            continue
        stroke = cylinders[contact.cylinder].stroke.si
        low, high = contact.at.least <= 0.0, contact.at.most >= stroke
        if contact.at.tolerance_si and (low or high):
            always = low == (contact.beyond == "above")
            yield (
                f"contacts.{name}.at",
                f"{_in_mm(contact.at)} reaches the end of the stroke of {contact.cylinder} at "
                f"{0.0 if low else stroke * 1e3:g} mm, so that the switch may "
                f"{'always' if always else 'never'} be on",
                "Move the switch into the stroke by more than its tolerance.",
            )
        for other, far in contacts.items():
            if far.at is None or far.cylinder != contact.cylinder:
                continue
            ends = (contact.beyond, far.beyond) == ("below", "above")
            if ends and contact.at.most >= far.at.least:
                yield (
                    f"contacts.{name}.at",
                    f"on below {_in_mm(contact.at)}, and {other} above {_in_mm(far.at)}: both end "
                    f"switches of {contact.cylinder} can be on at once",
                    "Move them apart by more than their tolerances.",
                )


def _in_mm(place: Quantity) -> str:
    within = f" +- {place.tolerance_si * 1e3:g} mm" if place.tolerance_si else ""
    return f"{place.si * 1e3:g} mm{within}"
