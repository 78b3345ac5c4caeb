"""The connected pieces of a machine's network; the motions of two pieces are independent."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from threadline.dynamics.matrix_controller import loop_parts
from threadline.errors import MachineError
from threadline.machine import Machine
from threadline.machine.controllers import StateSpaceController


@dataclass(frozen=True, slots=True, kw_only=True)
class Group:
    """Names of the parts of one connected piece of the network, in the order of the file."""

    bodies: tuple[str, ...]
    links: tuple[str, ...]
    drives: tuple[str, ...]
    sensors: tuple[str, ...]
    controllers: tuple[str, ...]
    axes: tuple[str, ...]
    inputs: tuple[str, ...]
    sources: tuple[str, ...] = ()


def connected_groups(machine: Machine) -> tuple[Group, ...]:
    """Return the connected pieces of the network; the motions of two pieces are independent.

    Links, drives and sensors connect bodies. Controllers connect drives and sensors. A limit switch
    connects its axis with the drive whose supply it cuts.

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
        if isinstance(controller, StateSpaceController):
            join(f"c.{name}", (f"s.{s}" for s in controller.sensors))
            join(f"c.{name}", (f"d.{d}" for d in controller.drives))
        else:
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
    single = {
        name: axis
        for name, axis in machine.axes.items()
        if axis.controller
        and not isinstance(machine.controllers[axis.controller], StateSpaceController)
    }
    parts = loop_parts(machine, machine.controllers)
    commanded = {
        part.controller if part.of.kind != "state-space" else f"{part.controller} ({part.axis})":
        part.of.drive
        for part in parts
    }  # fmt: skip
    for what, users, owner in (
        ("controller", {n: a.controller for n, a in single.items()}, "axes"),
        ("drive", {n: a.drive for n, a in machine.axes.items() if a.drive}, "axes"),
        ("body", {n: s.body for n, s in machine.position_sources.items()}, "drives"),
        ("drive", commanded, "controllers"),
    ):
        seen: dict[str, str] = {}
        for name, part in users.items():
            if part in seen:
                raise MachineError(
                    f"{owner} {seen[part]!r} and {name!r} share the {what} {part!r}",
                    place=machine.place,
                    remedy=f"Give each a separate {what}.",
                )
            seen[part] = name
