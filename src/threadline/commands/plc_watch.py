"""What the end switches of every cylinder must say in each place of a sequence.

A cylinder stands at a place that its moves name, or goes from one to another. Standing, every one
of its switches is known. Going, none of the far end may come before the piston can be there, and
those of the near end must be gone once it has had ample time to leave.

One cylinder after the other, in the order that the job's ``home`` says or in which its moves bring
them back, each with the smallest level that its flow controls make, until its own end switch says
that it is there. Then it is pressed home for as long as its whole stroke takes: a switch that is
stuck on, with the piston anywhere, sends no other cylinder on its way before this one is home.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from threadline.commands.plc_net import Names, NetPlace, PetriNet
from threadline.commands.schedule import Scheduled, ScheduledMove
from threadline.commands.schedule_moves import Homing, home_stage, home_switch, slowest
from threadline.errors import Place, PlanError
from threadline.machine import Machine
from threadline.machine.pneumatics import Contact

_EARLIEST = 0.5  # of the time that the commanded speed alone needs
_AMPLE = 2.0  # times the time that leaving takes with dead time and lags


@dataclass(frozen=True, slots=True, kw_only=True)
class Watch:
    """One cylinder in one place: from where to where; both the same where it stands.

    Parameters
    ----------
    axis, begin_m, end_m
        The cylinder and its way.
    early_ms
        Since the origin of the place: before it no switch of the far end is believed.
    gone_ms
        Since the origin: after it no switch of the near end may be on.
    arrived
        Whether a switch of the far end was waited for on this way: what follows may rely on it,
        though the piston still goes the last bit.
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
    """A place with what the program calls it.

    Parameters
    ----------
    place
        Of the net.
    name, due
        Constants: its number, and the time at which it is left or its input is late.
    note
        What happens until its time has come, for people.
    watch
        What the end switches of each cylinder must say, as far as that is known.
    bounds
        Of each cylinder on its way two constants: before the first its far end is not believed,
        after the second its near end must be off.
    """

    place: NetPlace
    name: str
    due: str
    note: str
    watch: Mapping[str, Watch]
    bounds: Mapping[str, tuple[str, str]]


def switches_of(machine: Machine, axis: str) -> dict[str, Contact]:
    """Return the end switches of a cylinder."""
    return {n: c for n, c in machine.contacts.items() if c.cylinder == axis and c.at is not None}


def reads(contact: Contact, place_m: float) -> bool | None:
    """Return what an end switch says of a piston at ``place_m``; None within its tolerance."""
    assert contact.at is not None
    if abs(place_m - contact.at.si) <= contact.at.tolerance_si:
        return None
    return (place_m < contact.at.si) == (contact.beyond == "below")


def watches(scheduled: Scheduled, net: PetriNet) -> list[dict[str, Watch]]:
    """Return for every place of the net the watch of each cylinder that has end switches."""
    machine = scheduled.machine
    ways = {axis: _moves_since(scheduled, axis, -1) for axis in scheduled.axes}
    found: list[dict[str, Watch]] = []
    for number, place in enumerate(net.places):
        before = found[-1] if found else {}
        if scheduled.homings:
            ways = {a: _moves_since(scheduled, a, place.begin_tick) for a in scheduled.axes}
        now = {
            axis: _watch(machine, place, before.get(axis), axis, moves, net.scan_ms)
            for axis, moves in ways.items()
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
    """Say whether a place waited for a switch of a cylinder that is on where its way ends."""
    if place.wait is None or not place.wait[1]:
        return False
    contact = machine.contacts[place.wait[0]]
    return contact.cylinder == axis and contact.at is not None and bool(reads(contact, end_m))


def _anywhere(scheduled: Scheduled, axis: str, tick: int) -> bool:
    """Say whether a cylinder may be anywhere at a scan: an operation brings it home, or will."""
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
    ways: list[ScheduledMove],
    scan_ms: int,
) -> Watch:
    begun = [way for way in ways if way.first_tick <= place.begin_tick]
    if not begun:
        start_m = ways[0].begin_m if ways else 0.0
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
    """Return when the commanded speed alone has covered a distance, ms after it set in."""
    levels = move.levels
    edges = np.array(levels.ticks, dtype=np.float64) * scan_ms
    covered = np.concatenate(([0.0], np.cumsum(np.diff(edges) * np.array(levels.levels[:-1])))) * (
        levels.speed_m_s / 1000.0
    )
    return float(np.interp(max(distance_m, 0.0), covered, edges))


HOMING = "homing"
_SAME_M = 1e-6


def home_places(scheduled: Scheduled, after: int, scan_ms: int) -> tuple[NetPlace, ...]:
    """Return the places of the way home, numbered from ``after`` on.

    Raises
    ------
    PlanError
        If a cylinder has no end switch at its start, or starts elsewhere than at 0.
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
    """Return how long the soft start takes to bring the air up, ms, whole scans."""
    return _scans_ms(max(output.ramp_s for output in machine.outputs.values()), scan_ms)


def home_watches(places: tuple[NetPlace, ...], machine: Machine) -> list[dict[str, Watch]]:
    """Return what the end switches must say in each place of the way home.

    Nothing is known of a cylinder before its own switch has come; from then on it stands at its
    start, also while others come back.
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
    """Return the cylinders in the order in which they come back.

    That of the list's ``home``; without it the order in which the list moves each for the last
    time: a list ends at its start, so that its last moves are the way back. What never moves comes
    first, and what an interlock needs at home before what needs it.

    Raises
    ------
    PlanError
        If the list or an interlock lets a cylinder move only with another at its start, and the
        list brings it home before.
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
    """Yield (cylinder, other, switch) where an interlock has the first wait for the second."""
    for axis, cylinder in machine.cylinders.items():
        for name in cylinder.needs:
            contact = machine.contacts[name]
            if contact.cylinder is not None and contact.beyond == "below":
                yield axis, contact.cylinder, name


def _behind_needed(wanted: list[str], machine: Machine) -> Iterator[str]:
    """Yield cylinders in their order, but each behind those that its interlock needs at home."""
    left = list(wanted)
    while left:
        waits = {axis for axis, other, _ in _locked(machine) if other in left and other != axis}
        # Where each waits for another, none could come first: the order stays.
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
            # Each only with the other at home: their order is the user's.
            if (axis, other) not in away and (other, axis) in away:
                yield axis, other


Said = tuple[str, bool]


@dataclass(frozen=True, slots=True, kw_only=True)
class Jog:
    """One thing that may be done by hand.

    Parameters
    ----------
    name
        Constant that the panel gives.
    note
        For people.
    on
        Outputs that it switches on.
    needs
        Contacts that must read so while it does.
    where
        Places in which the list does it: what end switches of other cylinders read in each. One of
        them must hold; where there is none it may be done anywhere.
    """

    name: str
    note: str
    on: tuple[str, ...]
    needs: tuple[tuple[str, bool], ...]
    where: tuple[tuple[tuple[str, bool], ...], ...]


def jogs_of(
    scheduled: Scheduled,
    cycle: tuple[NamedPlace, ...],
    names: Names,
    outputs: Mapping[str, str],
) -> Iterator[Jog]:
    """Yield each thing that may be done by hand, under the conditions that the cycle does it in.

    A cylinder comes back to its start also where the way home would bring it: with all that come
    home before it at their start. So there is always a way out, however pistons were left.
    """
    machine = scheduled.machine
    order = home_order(scheduled)
    for axis, cylinder in machine.cylinders.items():
        before = tuple((home_switch(machine, other), True) for other in order[: order.index(axis)])
        for way, sense, to in ((cylinder.forward, "out", "above"), (cylinder.back, "in", "below")):
            ends = tuple(
                (n, False) for n, c in switches_of(machine, axis).items() if c.beyond == to
            )
            where = _where(machine, cycle, axis, way.valve)
            yield Jog(
                name=names.give(f"jog_{axis}_{sense}".lower()),
                note=f"{axis} {'forward' if sense == 'out' else 'back'}, slowly",
                on=(way.valve, *slowest(way)[1]),
                needs=(*ends, *_told(cylinder.needs)),
                where=_weakest([*where, before]) if sense == "in" and where else where,
            )
    for name, output in machine.outputs.items():
        if output.kind in {"tool", "vacuum"}:
            yield Jog(
                name=names.give(f"jog_{name}".lower()),
                note=outputs[name],
                on=(name,),
                needs=_told(output.needs),
                where=_where(machine, cycle, "", name) if output.kind == "tool" else (),
            )


def _told(needs: tuple[str, ...]) -> tuple[Said, ...]:
    """Return an interlock of the machine file as what contacts must read."""
    return tuple((name, True) for name in needs)


def _where(
    machine: Machine, cycle: tuple[NamedPlace, ...], own: str, output: str
) -> tuple[tuple[Said, ...], ...]:
    """Return what end switches of other cylinders read in each place that has an output on.

    Nothing is asked of a cylinder that is on its way there.
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


def _weakest(found: list[tuple[Said, ...]]) -> tuple[tuple[Said, ...], ...]:
    """Return the conditions without those that ask for more than another one of them does.

    Where one of them asks for nothing there is no condition at all.
    """
    kept = [
        one for one in dict.fromkeys(found) if not any(set(other) < set(one) for other in found)
    ]
    return () if () in kept else tuple(kept)


def interlocked(machine: Machine, places: tuple[NamedPlace, ...]) -> dict[str, tuple[str, ...]]:
    """Return for each contact that the machine file needs the places in which it must be on."""
    found: dict[str, list[str]] = {}
    for named in places:
        needs = [n for output in named.place.on for n in machine.outputs[output].needs]
        for axis, cylinder in machine.cylinders.items():
            if {cylinder.forward.valve, cylinder.back.valve} & set(named.place.on):
                needs += cylinder.needs
            elif axis in named.watch and not (
                named.watch[axis].stands or named.watch[axis].arrived
            ):
                # It still goes the last bit: the list may let another set out already.
                needs += [n for n in cylinder.needs if _stands_on(machine, named, n)]
        for name in dict.fromkeys(needs):
            found.setdefault(name, []).append(named.name)
    return {name: tuple(where) for name, where in found.items()}


def _stands_on(machine: Machine, named: NamedPlace, name: str) -> bool:
    """Say whether the cylinder of an end switch stands in a place where that is on."""
    contact = machine.contacts[name]
    watch = named.watch.get(str(contact.cylinder))
    return watch is not None and watch.stands and bool(reads(contact, watch.end_m))
