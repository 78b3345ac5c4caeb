"""Program units of a PLC as data, the source of both structured text and PLCopen XML.

The cycle and the way home are two runs through places of one net. One token stands in one of these
places, or in ``IDLE``, where every output is off.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Literal

from threadline.commands.intents import Scheduled
from threadline.commands.plc_net import Names, NetPlace, PetriNet, petri_net
from threadline.commands.plc_watch import (
    HOMING,
    Jog,
    NamedPlace,
    Watch,
    home_places,
    home_watches,
    interlocked,
    jogs_of,
    watches,
)
from threadline.machine import Machine


@dataclass(frozen=True, slots=True, kw_only=True)
class Variable:
    """A declared variable.

    Parameters
    ----------
    name, type
        Written name and type; ``derived`` is True if the type is a function block.
    initial
        Literal; empty for the default of the type.
    address
        Address of a located variable, like ``%QX0.1``.
    values
        Literals of an array from 0 on, whose elements have the type; empty for a single variable.
    note
        Comment for people.
    """

    name: str
    type: str
    derived: bool = False
    initial: str = ""
    address: str = ""
    note: str = ""
    values: tuple[str, ...] = ()

    @property
    def runs(self) -> Iterator[tuple[str, int]]:
        """Runs of equal literals of an array: each literal, and the length of the run."""
        for literal, same in groupby(self.values):
            yield literal, len(list(same))


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """One VAR block; either all or none of its variables are located."""

    kind: Literal["VAR_INPUT", "VAR_OUTPUT", "VAR", "VAR CONSTANT"]
    variables: tuple[Variable, ...]

    def __post_init__(self) -> None:
        located = [bool(v.address) for v in self.variables]
        if any(located) and not all(located):
            raise ValueError("a VAR block mixes located and unlocated variables")


@dataclass(frozen=True, slots=True, kw_only=True)
class Pou:
    """A program or a function block with its body in structured text."""

    kind: Literal["FUNCTION_BLOCK", "PROGRAM"]
    name: str
    notes: tuple[str, ...]
    blocks: tuple[Block, ...]
    body: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class PlcProgram:
    """The program of a controller: function block, the program that calls the block, and a task."""

    block: Pou
    main: Pou
    configuration: str
    resource: str
    task: str
    instance: str
    interval_ms: int


FAULTS = {
    "no_fault": "none", "f_light_grid": "the light grid is broken",
    "f_enable": "the enable is missing", "f_late_scan": "a scan came late",
    "f_missing": "an input did not come in time", "f_stuck": "an input is on that was never off",
    "f_opposite": "both end switches are on",
    "f_lost": "an end switch is off where its piston stands",
    "f_wrong": "an end switch is on where no piston stands",
    "f_early": "an end switch came too early", "f_stayed": "an end switch did not go off",
    "f_interlock": "an interlock of the machine file is off",
}  # fmt: skip
"""Reasons for a stop, by the name of their constant. The order gives the numbers."""


CREEP_NAMES = ("creep_due", "creep_shut", "creep_calm")
"""Times since the origin: of the next opening, of its end, and of the rest after the last one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Guarded:
    """Variables and constants of a program for one cylinder.

    Parameters
    ----------
    axis
        Name of the cylinder in the machine file.
    expect, early, gone
        Variables: the expected state of the end switches, and two times since the origin.
    unknown
        Constant for an unknown position.
    known
        Constant of every way (from, to) in m of the cycle; from and to are equal at rest.
    usual
        Factor from m or rad to the unit of notes, and that unit.
    """

    axis: str
    expect: str
    early: str
    gone: str
    unknown: str
    known: Mapping[tuple[float, float], str]
    usual: tuple[float, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sequence:
    """The part of a schedule that a program is written from.

    Parameters
    ----------
    net
        Net of the cycle.
    cycle, homing
        Places of the cycle, and places of the way home.
    guarded, jogs
        Cylinders with monitored end switches, and jogs by hand.
    contacts
        Constant that names each contact.
    before_vacuum
        For every input that is waited for while a vacuum is on: the places just before the vacuum
        is switched on. The input must be off in these places.
    still_held
        Names of places that wait for an input that the same vacuum has switched on before. The
        input may still be on.
    interlocks
        For every contact that the machine file needs: names of the places in which it must be on.
    idle
        Constant of the place in which every output is off.
    air
        Outputs of kind ``soft-start``.
    again
        Place with which every further cycle begins.
    """

    net: PetriNet
    cycle: tuple[NamedPlace, ...]
    homing: tuple[NamedPlace, ...]
    guarded: tuple[Guarded, ...]
    jogs: tuple[Jog, ...]
    contacts: Mapping[str, str]
    before_vacuum: Mapping[tuple[str, bool], tuple[str, ...]]
    still_held: frozenset[str]
    interlocks: Mapping[str, tuple[str, ...]]
    idle: str
    air: tuple[str, ...]
    again: str

    def creep_times(self, named: NamedPlace) -> Iterator[tuple[str, int, str]]:
        """Yield name, milliseconds and note of the three constants of a creep."""
        place, creep = named.place, named.place.creep
        if creep is None or place.wait is None:
            return
        wait_scans = place.begin_tick - place.origin_tick
        for name, scans, note in zip(
            named.creeps,
            (wait_scans + creep.first, creep.every, creep.rest),
            ("not before", "from opening to opening", "from an opening to its rest"),
            strict=True,
        ):
            yield name, scans * self.net.scan_ms, f"{place.step}: creeps to {place.wait[0]}, {note}"

    @property
    def creeps(self) -> bool:
        """Whether a cylinder creeps in some place."""
        return any(named.place.opens for named in self.cycle)

    @property
    def places(self) -> tuple[NamedPlace, ...]:
        """All places, in the order of their numbers."""
        return (*self.cycle, *self.homing)

    def constants(
        self, outputs: Mapping[str, str], places: frozenset[str] | None = None
    ) -> Iterator[Variable]:
        """Yield the constants of the program.

        Parameters
        ----------
        outputs
            Names of outputs in notes.
        places
            Places with a name of their own, without times; None: all of them, with their times.
        """
        yield Variable(name=self.idle, type="INT", initial="0", note="every output is off")
        for named in self.places:
            if places is not None and named.name not in places:
                continue
            number = str(named.place.number)
            on = ", ".join(outputs[name] for name in named.place.on) or "nothing"
            yield Variable(name=named.name, type="INT", initial=number, note=f"on: {on}")
        for named in self.places if places is None else ():
            due = f"T#{named.place.due_ms}ms"
            yield Variable(name=named.due, type="TIME", initial=due, note=named.note)
            for name, ms, note in self.creep_times(named):
                yield Variable(name=name, type="TIME", initial=f"T#{ms}ms", note=note)
            for axis, (early, gone) in () if named.place.opens else named.bounds.items():
                watch = named.watch[axis]
                for name, ms, what in (
                    (early, watch.early_ms, f"{axis} cannot be there before"),
                    (gone, watch.gone_ms, f"{axis} must have left by then"),
                ):
                    note = f"{named.place.step}: {what}"
                    yield Variable(name=name, type="TIME", initial=f"T#{ms}ms", note=note)
        for code, (name, text) in enumerate(FAULTS.items()):
            yield Variable(name=name, type="INT", initial=str(code), note=text)
        for code, name in enumerate(self.contacts.values(), start=1):
            yield Variable(name=name, type="INT", initial=str(code))
        for one in self.guarded:
            yield Variable(name=one.unknown, type="INT", initial="0", note="anywhere")
            for code, ((begin, end), name) in enumerate(one.known.items(), start=1):
                factor, unit = one.usual
                first = "" if begin == end else f"{begin * factor:g} to "
                way = f"{first}{end * factor:g} {unit}"
                yield Variable(name=name, type="INT", initial=str(code), note=way)
        for code, jog in enumerate(self.jogs, start=1):
            yield Variable(name=jog.name, type="INT", initial=str(code), note=jog.note)


@dataclass(frozen=True, slots=True, kw_only=True)
class Words:
    """Names in the program, and some of its times.

    Parameters
    ----------
    inputs, outputs
        Names in the program, by name in the machine file.
    grids, enables
        Inputs that must all be true while the machine moves.
    start, acknowledge, home
        Inputs whose rising edges count.
    fresh
        By input and value: variable that is true if the input had its other value since it last
        counted.
    watchdog_ms
        A longer time from scan to scan is a fault.
    early_ms
        A transition fires in the scan nearest to its time, up to half a scan early.
    air_ms, dwell_ms
        Work by hand: time for the air pressure to build up, and rest of the valves between two
        jogs.
    """

    inputs: Mapping[str, str]
    outputs: Mapping[str, str]
    grids: tuple[str, ...]
    enables: tuple[str, ...]
    start: str
    acknowledge: str
    home: str
    fresh: Mapping[tuple[str, bool], str]
    watchdog_ms: int
    early_ms: int
    air_ms: int
    dwell_ms: int


def sequence_of(
    scheduled: Scheduled, names: Names, inputs: Mapping[str, str], outputs: Mapping[str, str]
) -> Sequence:
    """Return the sequence of ``scheduled``; ``inputs`` and ``outputs`` give names for its notes.

    Raises
    ------
    PlanError
        If the net cannot be built, or a cylinder cannot be brought home.
    """
    net, machine = petri_net(scheduled), scheduled.machine
    idle = names.give("idle")
    watched = watches(scheduled, net)
    back = home_places(scheduled, len(net.places), net.scan_ms)
    called = {"inputs": inputs, "outputs": outputs}
    cycle = _named(net.places, watched, scheduled, names, **called)
    homing = _named(back, home_watches(back, machine), scheduled, names, **called)
    return Sequence(
        net=net,
        cycle=cycle,
        homing=homing,
        guarded=tuple(_guarded(machine, (*cycle, *homing), names)),
        jogs=tuple(jogs_of(scheduled, cycle, names, outputs)),
        contacts={
            c: names.give(f"c_{c}") for c, k in machine.contacts.items() if k.kind == "contact"
        },
        still_held=frozenset(_still_held(machine, cycle)),
        before_vacuum=_before_vacuum(machine, cycle),
        interlocks=interlocked(machine, (*cycle, *homing)),
        idle=idle,
        air=tuple(n for n, o in machine.outputs.items() if o.kind == "soft-start"),
        again=_again(scheduled, cycle),
    )


def _again(scheduled: Scheduled, cycle: tuple[NamedPlace, ...]) -> str:
    """Return the place with which further cycles begin: the first wait that they contain.

    The time of a further cycle counts from this place. The time limit of the wait is therefore at
    least as long as in the first cycle.
    """
    if not scheduled.job.once:
        return cycle[0].name
    return next(
        named.name
        for named in cycle
        if named.place.wait is not None and named.place.begin_tick >= scheduled.again_tick
    )


def _named(
    places: tuple[NetPlace, ...],
    watched: list[dict[str, Watch]],
    scheduled: Scheduled,
    names: Names,
    *,
    inputs: Mapping[str, str],
    outputs: Mapping[str, str],
) -> tuple[NamedPlace, ...]:
    found: list[NamedPlace] = []
    count: dict[str, int] = {}
    since, last, part = "the run began", "", 1
    for place, watch in zip(places, watched, strict=True):
        step = place.step or "cycle"
        count[step] = count.get(step, 0) + 1
        name = names.give(f"s_{step}_{count[step]}")
        what = f"{place.step}: {_what(place, scheduled, inputs, outputs)}"
        part = part + 1 if what == last else 1
        last = what
        note = f"{what}{f', part {part}' if part > 1 else ''}, since {since}"
        if place.opens:
            note = what
        if place.wait is not None:
            since = f"{inputs[place.wait[0]]} was {'on' if place.wait[1] else 'off'}"
        number = f"{step}_{count[step]}"
        which = {
            axis: (
                names.give(f"t_{axis.lower()}_early_{number}"),
                names.give(f"t_{axis.lower()}_gone_{number}"),
            )
            for axis, one in watch.items()
            if not one.stands and not place.opens
        }
        creeping = ("creep", "every", "calm") if place.creep is not None else ()
        found.append(
            NamedPlace(
                place=place,
                name=name,
                due=names.give(f"t_{number}"),
                note=note,
                watch=watch,
                bounds=found[-1].bounds if place.opens else which,
                creeps=tuple(names.give(f"t_{what}_{number}") for what in creeping),
            )
        )
    return tuple(found)


def _what(
    place: NetPlace, scheduled: Scheduled, inputs: Mapping[str, str], outputs: Mapping[str, str]
) -> str:
    """Return words for what happens in a place until its due time."""
    if place.opens and place.wait is not None:
        return f"an opening by which it creeps to {inputs[place.wait[0]]}"
    if place.wait is not None:
        return f"{inputs[place.wait[0]]} must be {'on' if place.wait[1] else 'off'} by then"
    machine, tick = scheduled.machine, place.begin_tick
    if place.step == HOMING:
        moved = any(machine.outputs[name].kind == "direction" for name in place.on)
        return "pressed home" if moved else "under pressure"
    if any(one.first_tick <= tick < one.last_tick for one in scheduled.homings):
        return "pressed home"
    for move in scheduled.moves:
        way = "forward" if move.forward else "back"
        if move.first_tick <= tick < move.last_tick:
            distance = machine.cylinders[move.axis].place(move.levels.wanted_m)
            return f"{move.axis} {distance} {way}"
    scan_s = float(scheduled.commands.clock.period_s)
    stays_s = 1e-3 * place.due_ms - (tick - place.origin_tick) * scan_s
    for move in scheduled.moves:
        rest_s = machine.cylinders[move.axis].rest_s(move.forward)
        if move.last_tick <= tick < move.last_tick + math.ceil(rest_s / scan_s - 1e-9):
            return f"{move.axis} comes to rest"
    for name in place.on:
        ramp_s = machine.outputs[name].ramp_s
        if ramp_s and abs(stays_s - ramp_s) < scan_s:
            return f"{outputs[name]} is under pressure"
    return "one scan" if stays_s < 1.5 * scan_s else f"{stays_s * 1e3:g} ms more"


def _still_held(machine: Machine, cycle: tuple[NamedPlace, ...]) -> Iterator[str]:
    """Yield each place that waits for an input that has already come during the same vacuum."""
    vacuums = {name for name, output in machine.outputs.items() if output.kind == "vacuum"}
    brought: set[tuple[str, bool]] = set()
    for named in cycle:
        place = named.place
        if not vacuums & set(place.on):
            brought.clear()
        elif place.wait is not None and place.wait[1]:
            if place.wait in brought:
                yield named.name
            brought.add(place.wait)


def _before_vacuum(
    machine: Machine, cycle: tuple[NamedPlace, ...]
) -> dict[tuple[str, bool], tuple[str, ...]]:
    vacuums = {name for name, output in machine.outputs.items() if output.kind == "vacuum"}
    found: dict[tuple[str, bool], tuple[str, ...]] = {}
    for index, named in enumerate(cycle):
        wait = named.place.wait
        drawn = vacuums & set(named.place.on)
        if wait is None or not wait[1] or not drawn or machine.contacts[wait[0]].cylinder:
            continue
        before = index
        while before and drawn & set(cycle[before].place.on):
            before -= 1
        found[wait] = (*found.get(wait, ()), cycle[before].name)
    return found


def _guarded(machine: Machine, places: tuple[NamedPlace, ...], names: Names) -> Iterator[Guarded]:
    for axis in machine.cylinders:
        axis_watches = [named.watch[axis] for named in places if axis in named.watch]
        if not axis_watches:
            continue
        known: dict[tuple[float, float], str] = {}
        factor, unit = machine.cylinders[axis].usual
        for way in axis_watches:
            key = round(way.begin_m, 9), round(way.end_m, 9)
            if key not in known:
                begin, end = (f"{value * factor:g}" for value in key)
                text = f"{axis}_at_{begin}" if way.stands else f"{axis}_{begin}_to_{end}"
                known[key] = names.give(text.lower())
        low = axis.lower()
        yield Guarded(
            axis=axis,
            expect=names.give(f"{low}_expected"),
            early=names.give(f"{low}_too_early"),
            gone=names.give(f"{low}_must_be_gone"),
            unknown=names.give(f"{low}_anywhere"),
            known=known,
            usual=(factor, unit),
        )
