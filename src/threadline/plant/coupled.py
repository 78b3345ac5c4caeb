"""Connected pieces of a machine: parts that act on, read or drive the same bodies."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from threadline.errors import MachineError
from threadline.machine import Machine


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """The parts of one connected piece of the network, each in the order of the machine file."""

    bodies: tuple[str, ...]
    links: tuple[str, ...]
    drives: tuple[str, ...]
    sensors: tuple[str, ...]
    controllers: tuple[str, ...]
    axes: tuple[str, ...]
    inputs: tuple[str, ...]
    sources: tuple[str, ...] = ()


def connected_groups(machine: Machine) -> tuple[Group, ...]:
    """Return the connected pieces of the network, whose motions do not affect each other.

    Bodies are connected by links, drives and sensors; drives and sensors by controllers; and a
    switch connects its axis with the drive that it cuts.

    Raises
    ------
    MachineError
        If two axes share a controller, or two controllers a drive.
    """
    _check_shared(machine)
    parent: dict[str, str] = {f"b.{b}": f"b.{b}" for b in machine.bodies}

    def root(key: str) -> str:
        parent.setdefault(key, key)
        while parent[key] != key:
            parent[key] = parent[parent[key]]
            key = parent[key]
        return key

    def join(key: str, others: Iterable[str]) -> None:
        for other in others:
            parent[root(other)] = root(key)

    for name, link in machine.links.items():
        join(f"l.{name}", (f"b.{b}" for b in link.stretch))
    for name, drive in machine.motors.items():
        join(f"d.{name}", (f"b.{b}" for b in drive.acts_on))
    for name, source in machine.position_sources.items():
        join(f"d.{name}", (f"b.{source.body}",))
    for name, sensor in machine.sensors.items():
        join(f"s.{name}", (f"b.{b}" for b in sensor.reads))
    for name, controller in machine.controllers.items():
        join(f"c.{name}", (f"s.{controller.sensor}", f"d.{controller.drive}"))
    for name, axis in machine.axes.items():
        join(f"a.{name}", (f"d.{axis.drive}" if axis.drive else f"c.{axis.controller}",))
        join(f"a.{name}", (f"b.{b}" for b in (*(axis.load or {}), *(axis.frame or {}))))
    for name, switch in machine.inputs.items():
        join(f"i.{name}", (f"a.{switch.axis}", f"d.{switch.cuts}"))

    groups = []
    for top in dict.fromkeys(root(f"b.{b}") for b in machine.bodies):

        def mine(letter: str, names: Iterable[str], top: str = top) -> tuple[str, ...]:
            return tuple(n for n in names if root(f"{letter}.{n}") == top)

        groups.append(
            Group(
                bodies=mine("b", machine.bodies),
                links=mine("l", machine.links),
                drives=mine("d", machine.motors),
                sensors=mine("s", machine.sensors),
                controllers=mine("c", machine.controllers),
                axes=mine("a", machine.axes),
                inputs=mine("i", machine.inputs),
                sources=mine("d", machine.position_sources),
            )
        )
    return tuple(groups)


def _check_shared(machine: Machine) -> None:
    for what, users, owner in (
        ("controller", {n: a.controller for n, a in machine.axes.items() if a.controller}, "axes"),
        ("drive", {n: a.drive for n, a in machine.axes.items() if a.drive}, "axes"),
        ("body", {n: s.body for n, s in machine.position_sources.items()}, "drives"),
        ("drive", {n: c.drive for n, c in machine.controllers.items()}, "controllers"),
    ):
        seen: dict[str, str] = {}
        for name, part in users.items():
            if part in seen:
                raise MachineError(
                    f"{owner} {seen[part]!r} and {name!r} share the {what} {part!r}",
                    place=machine.place,
                    remedy=f"Give each its own {what}.",
                )
            seen[part] = name
