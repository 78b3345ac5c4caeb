"""Expected readings of all end switches in each place of a sequence, the way home, and jogs.

A cylinder either stands at a position of its moves or travels from one to another. While a cylinder
stands, all of its switches have known values. While a cylinder travels, no switch at the far end
may come before the piston can be there, and every switch at the near end must be off after ample
time to leave.

Cylinders go home one after the other, in the order of the job's ``home`` or, without it, in the
order in which the job's moves bring them back. Each cylinder moves at the smallest level of its
flow controls until its end switch is on. Then pressure stays on for as long as the whole stroke
takes. A switch that is stuck on therefore starts no other cylinder before this cylinder is home,
wherever its piston stands.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from threadline.commands.intents import Scheduled, ScheduledMove
from threadline.commands.plc_net import Names, NetPlace, PetriNet
from threadline.commands.schedule_moves import Homing, home_stage, home_switch, slowest
from threadline.errors import Place, PlanError
from threadline.machine import Machine
from threadline.machine.pneumatics import Contact

_EARLIEST = 0.5  # share of the time that the commanded speed needs to reach a switch
_AMPLE = 2.0  # factor on the time to leave a switch, dead time and lags included


@dataclass(frozen=True, slots=True, kw_only=True)
class Watch:
    """The expected way of one cylinder in one place; start and end are equal at rest.

    Parameters
    ----------
    axis, begin_m, end_m
        Cylinder and its way, m.
    early_ms
        Time since the origin of the place before which a switch at the far end is not believed.
    gone_ms
        Time since the origin of the place after which no switch at the near end may be on.
    arrived
        Whether a wait on this way confirmed a switch at the far end. Later operations may rely on
        the arrival, although the piston still travels the last bit.
    """

    axis: str
    begin_m: float
    end_m: float
    early_ms: int = 0
    gone_ms: int = 0
    arrived: bool = False

    @property
    def stands(self) -> bool:
        """Whether the cylinder stands."""
        return abs(self.end_m - self.begin_m) <= _SAME_M


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedPlace:
    """A place with its names in the program.

    Parameters
    ----------
    place
        Place of the net.
    name, due
        Constants: number of the place, and the time at which the token leaves or the input is late.
    note
        Words for what happens until the due time.
    watch
        Expected way of each cylinder, as far as known.
    creeps
        Constants of a place with a creep: time since the origin before its first opening, from
        opening to opening, and from the end of one to the rest of the cylinder.
    bounds
        Two constants for each travelling cylinder: before the first time its far end is not
        believed, after the second time its near end must be off.
    """

    place: NetPlace
    name: str
    due: str
    note: str
    watch: Mapping[str, Watch]
    bounds: Mapping[str, tuple[str, str]]
    creeps: tuple[str, ...] = ()


def switches_of(machine: Machine, axis: str) -> dict[str, Contact]:
    """Return the end switches of a cylinder."""
    return {n: c for n, c in machine.contacts.items() if c.cylinder == axis and c.at is not None}


def reads(contact: Contact, place_m: float) -> bool | None:
    """Return the value of an end switch for a piston at ``place_m``; None within its tolerance."""
    assert contact.at is not None
    if abs(place_m - contact.at.si) <= contact.at.tolerance_si:
        return None
    return (place_m < contact.at.si) == (contact.beyond == "below")


def watches(scheduled: Scheduled, net: PetriNet) -> list[dict[str, Watch]]:
    """Return, for every place of the net, the watch of each cylinder with end switches."""
    machine = scheduled.machine
    moves_of = {axis: _moves_since(scheduled, axis, -1) for axis in scheduled.axes}
    found: list[dict[str, Watch]] = []
    for number, place in enumerate(net.places):
        before = found[-1] if found else {}
        if place.opens:
            found.append(before)
            continue
        if scheduled.homings:
            moves_of = {a: _moves_since(scheduled, a, place.begin_tick) for a in scheduled.axes}
        now = {
            axis: _watch(machine, place, before.get(axis), axis, moves, net.scan_ms)
            for axis, moves in moves_of.items()
            if switches_of(machine, axis) and not _anywhere(scheduled, axis, place.begin_tick)
        }
        for axis, watch in now.items():
            last = before.get(axis)
            same = last is not None and (last.begin_m, last.end_m) == (watch.begin_m, watch.end_m)
            if same and not watch.stands and last is not None:
                came = last.arrived or _came(machine, net.places[number - 1], axis, watch.end_m)
                now[axis] = replace(watch, arrived=came)
        found.append(now)
    return found


def _came(machine: Machine, place: NetPlace, axis: str, end_m: float) -> bool:
    """Say whether a place waited for a switch that confirms the end of a cylinder's way."""
    if place.wait is None or not place.wait[1]:
        return False
    contact = machine.contacts[place.wait[0]]
    return contact.cylinder == axis and contact.at is not None and bool(reads(contact, end_m))


def _anywhere(scheduled: Scheduled, axis: str, tick: int) -> bool:
    """Say whether a cylinder may be anywhere at a scan: its homing runs or is still to come."""
    return any(
        one.axis == axis
        and tick < one.last_tick
        and (
            tick >= one.first_tick
            or not any(m.axis == axis and m.first_tick < one.first_tick for m in scheduled.moves)
        )
        for one in scheduled.homings
    )


def _moves_since(scheduled: Scheduled, axis: str, tick: int) -> list[ScheduledMove]:
    """Return the moves of a cylinder since an operation last brought it home."""
    homed = [h.last_tick for h in scheduled.homings if h.axis == axis and h.last_tick <= tick]
    since = max(homed, default=0)
    return [m for m in scheduled.moves if m.axis == axis and m.first_tick >= since]


def _watch(
    machine: Machine,
    place: NetPlace,
    before: Watch | None,
    axis: str,
    moves: list[ScheduledMove],
    scan_ms: int,
) -> Watch:
    begun = [way for way in moves if way.first_tick <= place.begin_tick]
    if not begun:
        start_m = moves[0].begin_m if moves else 0.0
        return Watch(axis=axis, begin_m=start_m, end_m=start_m)
    way, cylinder = begun[-1], machine.cylinders[axis]
    calm_ms = 1000.0 * cylinder.rest_s(way.forward)
    opens_ms = 1000.0 * cylinder.way(way.forward).opens_s
    rest_tick = way.last_tick + math.ceil(calm_ms / scan_ms - 1e-9)
    awaited = place.wait is not None and machine.contacts[place.wait[0]].cylinder == axis
    going = place.begin_tick < rest_tick or (
        awaited and before is not None and not before.stands and before.end_m == way.end_m
    )
    if not going:
        return Watch(axis=axis, begin_m=way.end_m, end_m=way.end_m)
    since_ms = (way.first_tick - place.origin_tick) * scan_ms
    early, gone = math.inf, 0.0
    for contact in switches_of(machine, axis).values():
        assert contact.at is not None
        first, last = reads(contact, way.begin_m), reads(contact, way.end_m)
        away_m = abs(contact.at.si - way.begin_m)
        if last and not first:
            reached = _commanded_ms(way, away_m - contact.at.tolerance_si, scan_ms)
            early = min(early, _EARLIEST * (1000.0 * cylinder.delay.si + opens_ms + reached))
        elif first and not last:
            reached = _commanded_ms(way, away_m + contact.at.tolerance_si, scan_ms)
            gone = max(gone, _AMPLE * (calm_ms + opens_ms + reached))
    return Watch(
        axis=axis,
        begin_m=way.begin_m,
        end_m=way.end_m,
        early_ms=max(0, since_ms + math.floor(early)) if math.isfinite(early) else 0,
        gone_ms=max(0, since_ms + math.ceil(gone)),
    )


def _commanded_ms(move: ScheduledMove, distance_m: float, scan_ms: int) -> float:
    """Return when the commanded speed has covered a distance, ms after its first switching."""
    levels = move.levels
    edges = np.array(levels.ticks, dtype=np.float64) * scan_ms
    covered = np.concatenate(([0.0], np.cumsum(np.diff(edges) * np.array(levels.levels[:-1])))) * (
        levels.speed_m_s / 1000.0
    )
    return float(np.interp(max(distance_m, 0.0), covered, edges))


HOMING = "homing"
_SAME_M = 1e-6


def home_places(scheduled: Scheduled, after: int, scan_ms: int) -> tuple[NetPlace, ...]:
    """Return the places of the way home, with numbers after ``after``.

    Raises
    ------
    PlanError
        If a cylinder has no end switch at its start, or does not start at 0.
    """
    machine = scheduled.machine
    air = tuple(n for n, o in machine.outputs.items() if o.kind == "soft-start")
    now_ms = air_ms(machine, scan_ms)
    places = [_place(after + 1, air, now_ms, None)]
    for axis in home_order(scheduled):
        stage = home_stage(machine, axis)
        on, late_ms = (*air, *stage.on), _scans_ms(stage.late_s, scan_ms)
        wait = (stage.switch, True)
        places.append(_place(after + len(places) + 1, on, now_ms + late_ms, wait))
        now_ms = _scans_ms(stage.pressed_s, scan_ms)
        places.append(_place(after + len(places) + 1, on, now_ms, None))
    return tuple(places)


def air_ms(machine: Machine, scan_ms: int) -> int:
    """Return the time of the soft start to build up air pressure, ms in whole scans."""
    return _scans_ms(max(output.ramp_s for output in machine.outputs.values()), scan_ms)


def home_watches(places: tuple[NetPlace, ...], machine: Machine) -> list[dict[str, Watch]]:
    """Return the expected watches in each place of the way home.

    The position of a cylinder is unknown until its own switch is on. From then on the cylinder
    stands at its start, also while other cylinders come back.
    """
    found: list[dict[str, Watch]] = []
    home: dict[str, Watch] = {}
    for place in places:
        found.append(dict(home))
        axis = machine.contacts[place.wait[0]].cylinder if place.wait is not None else None
        if axis is not None:
            home[axis] = Watch(axis=axis, begin_m=0.0, end_m=0.0)
    return found


def _place(
    number: int, on: tuple[str, ...], due_ms: int, wait: tuple[str, bool] | None
) -> NetPlace:
    return NetPlace(number=number, step=HOMING, on=on, due_ms=due_ms, wait=wait)


def _scans_ms(time_s: float, scan_ms: int) -> int:
    return math.ceil(1000.0 * time_s / scan_ms - 1e-9) * scan_ms


def home_order(scheduled: Scheduled) -> tuple[str, ...]:
    """Return the cylinders in the order in which they come home.

    The order is the list's ``home``. Without ``home``, the order is the order of the last moves of
    the cylinders: a list ends at its start, so its last moves are the way back. Cylinders that
    never move come first. A cylinder comes after the cylinders that its interlock needs at home.

    Raises
    ------
    PlanError
        If the list or an interlock moves a cylinder only with another one at its start, and the
        list's ``home`` brings the first one back before the other.
    """
    last = {move.axis: move.first_tick for move in scheduled.moves}
    order = scheduled.job.home
    if not order:
        wanted = sorted(scheduled.machine.cylinders, key=lambda axis: last.get(axis, -1))
        return tuple(_behind_needed(wanted, scheduled.machine))
    for axis, other in _needed(scheduled):
        if order.index(axis) < order.index(other):
            raise PlanError(
                f"home = {', '.join(order)} brings {axis} back before {other}, and the list moves "
                f"{axis} only with {other} at its start",
                place=Place(scheduled.job.file),
                remedy=f"Write {other} before {axis}.",
            )
    for axis, other, name in _locked(scheduled.machine):
        if order.index(axis) < order.index(other):
            raise PlanError(
                f"home = {', '.join(order)} brings {axis} back before {other}, and {axis} moves "
                f"only with {name} on",
                place=Place(scheduled.job.file),
                remedy=f"Write {other} before {axis}.",
            )
    return order


def _locked(machine: Machine) -> Iterator[tuple[str, str, str]]:
    """Yield (cylinder, other, switch) where an interlock makes the first wait for the second."""
    for axis, cylinder in machine.cylinders.items():
        for name in cylinder.needs:
            contact = machine.contacts[name]
            if contact.cylinder is not None and contact.beyond == "below":
                yield axis, contact.cylinder, name


def _behind_needed(wanted: list[str], machine: Machine) -> Iterator[str]:
    """Yield cylinders in order, each after the cylinders that its interlock needs at home."""
    left = list(wanted)
    while left:
        waits = {axis for axis, other, _ in _locked(machine) if other in left and other != axis}
        # If each waits for another, none can come first, and the order stays.
        first = next((axis for axis in left if axis not in waits), left[0])
        left.remove(first)
        yield first


def _needed(scheduled: Scheduled) -> Iterator[tuple[str, str]]:
    """Yield (cylinder, other) where the list moves the first only with the second at its start."""
    at = dict(zip(scheduled.job.axes, scheduled.job.start, strict=True))
    start, moving = dict(at), {move.axis for move in scheduled.moves}
    away: set[tuple[str, str]] = set()
    both: list[ScheduledMove | Homing] = [*scheduled.moves, *scheduled.homings]
    for move in sorted(both, key=lambda one: one.first_tick):
        away |= {(move.axis, o) for o in moving - {move.axis} if abs(at[o] - start[o]) > _SAME_M}
        at[move.axis] = 0.0 if isinstance(move, Homing) else move.end_m
    for axis in sorted(moving):
        for other in sorted(moving - {axis}):
            # If each moves only with the other at its start, the user decides their order.
            if (axis, other) not in away and (other, axis) in away:
                yield axis, other


Reading = tuple[str, bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class Jog:
    """One action by hand.

    Parameters
    ----------
    name
        Constant that the panel sends.
    note
        Words for people.
    on
        Outputs that the jog switches on.
    needs
        Required readings of contacts during the jog.
    where
        Alternative conditions, one per place in which the list does the same action: readings of
        other cylinders' end switches. At least one alternative must hold. Empty: allowed anywhere.
    """

    name: str
    note: str
    on: tuple[str, ...]
    needs: tuple[tuple[str, bool], ...]
    where: tuple[tuple[tuple[str, bool], ...], ...]


def jogs_of(
    scheduled: Scheduled, cycle: tuple[NamedPlace, ...], names: Names, outputs: Mapping[str, str]
) -> Iterator[Jog]:
    """Yield each action by hand, under the conditions under which the cycle does it.

    A cylinder may also go back to its start under the condition of the way home: all cylinders that
    come home before it are at their start. So a way out exists for any positions of the pistons.
    """
    machine = scheduled.machine
    order = home_order(scheduled)
    for axis, cylinder in machine.cylinders.items():
        before = tuple((home_switch(machine, other), True) for other in order[: order.index(axis)])
        for way, sense, to in ((cylinder.forward, "out", "above"), (cylinder.back, "in", "below")):
            ends = tuple(
                (n, False) for n, c in switches_of(machine, axis).items() if c.beyond == to
            )
            where = _places_with(machine, cycle, axis, way.valve)
            yield Jog(
                name=names.give(f"jog_{axis}_{sense}".lower()),
                note=f"{axis} {'forward' if sense == 'out' else 'back'}, slowly",
                on=(way.valve, *slowest(way)[1]),
                needs=(*ends, *_required_readings(cylinder.needs)),
                where=_weakest([*where, before]) if sense == "in" and where else where,
            )
    for name, output in machine.outputs.items():
        if output.kind in {"tool", "vacuum"}:
            yield Jog(
                name=names.give(f"jog_{name}".lower()),
                note=outputs[name],
                on=(name,),
                needs=_required_readings(output.needs),
                where=_places_with(machine, cycle, "", name) if output.kind == "tool" else (),
            )


def _required_readings(needs: tuple[str, ...]) -> tuple[Reading, ...]:
    """Return an interlock of the machine file as required readings of contacts."""
    return tuple((name, True) for name in needs)


def _places_with(
    machine: Machine, cycle: tuple[NamedPlace, ...], own: str, output: str
) -> tuple[tuple[Reading, ...], ...]:
    """Return readings of other cylinders' end switches in each place with an output on.

    A cylinder that still travels in a place adds no condition.
    """
    found = []
    for named in cycle:
        if output in named.place.on:
            found.append(
                tuple(
                    (name, value)
                    for axis, watch in named.watch.items()
                    if axis != own and (watch.stands or watch.arrived)
                    for name, contact in switches_of(machine, axis).items()
                    if (value := reads(contact, watch.end_m)) is not None
                )
            )
    return _weakest(found)


def _weakest(found: list[tuple[Reading, ...]]) -> tuple[tuple[Reading, ...], ...]:
    """Return the conditions, except conditions that are stricter than another one.

    If one condition is empty, the result is empty.
    """
    kept = [
        one for one in dict.fromkeys(found) if not any(set(other) < set(one) for other in found)
    ]
    return () if () in kept else tuple(kept)


def interlocked(machine: Machine, places: tuple[NamedPlace, ...]) -> dict[str, tuple[str, ...]]:
    """Return, for each contact that the machine file needs, the places in which it must be on."""
    found: dict[str, list[str]] = {}
    for named in places:
        needs = [n for output in named.place.on for n in machine.outputs[output].needs]
        for axis, cylinder in machine.cylinders.items():
            if {cylinder.forward.valve, cylinder.back.valve} & set(named.place.on):
                needs += cylinder.needs
            elif axis in named.watch and not (
                named.watch[axis].stands or named.watch[axis].arrived
            ):
                # The cylinder still travels the last bit, so another one may already start.
                needs += [n for n in cylinder.needs if _stands_on(machine, named, n)]
        for name in dict.fromkeys(needs):
            found.setdefault(name, []).append(named.name)
    return {name: tuple(where) for name, where in found.items()}


def _stands_on(machine: Machine, named: NamedPlace, name: str) -> bool:
    """Say whether a switch's cylinder stands, in a place, where it turns the switch on."""
    contact = machine.contacts[name]
    watch = named.watch.get(str(contact.cylinder))
    return watch is not None and watch.stands and bool(reads(contact, watch.end_m))
