"""Interlocks of a sequence: what contacts read while something moves, in the cycle and by hand."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from threadline.machine import Machine
from threadline.targets.homing import home_switch, slowest
from threadline.targets.plc_home import home_order
from threadline.targets.plc_names import Names
from threadline.targets.plc_watch import NamedPlace, reads, switches_of
from threadline.targets.schedule import Scheduled

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
