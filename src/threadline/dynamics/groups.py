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
    _refuse_shared_parts(machine)
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
    for group_root in dict.fromkeys(root(f"b.{b}") for b in machine.bodies):

        def members(
            letter: str, names: Iterable[str], group_root: str = group_root
        ) -> tuple[str, ...]:
            return tuple(n for n in names if root(f"{letter}.{n}") == group_root)

        groups.append(
            Group(
                bodies=members("b", machine.bodies),
                links=members("l", machine.links),
                drives=members("d", machine.motors),
                sensors=members("s", machine.sensors),
                controllers=members("c", machine.controllers),
                axes=members("a", machine.axes),
                inputs=members("i", machine.inputs),
                sources=members("d", machine.position_sources),
            )
        )
    return tuple(groups)


def _refuse_shared_parts(machine: Machine) -> None:
    single_axes = {
        name: axis
        for name, axis in machine.axes.items()
        if axis.controller
        and not isinstance(machine.controllers[axis.controller], StateSpaceController)
    }
    parts = loop_parts(machine, machine.controllers)
    commanded = {
        (
            part.controller
            if part.settings.kind != "state-space"
            else f"{part.controller} ({part.axis})"
        ): part.settings.drive
        for part in parts
    }  # fmt: skip
    for kind, users, owner in (
        ("controller", {n: a.controller for n, a in single_axes.items()}, "axes"),
        ("drive", {n: a.drive for n, a in machine.axes.items() if a.drive}, "axes"),
        ("body", {n: s.body for n, s in machine.position_sources.items()}, "drives"),
        ("drive", commanded, "controllers"),
    ):
        user_of: dict[str, str] = {}
        for name, part in users.items():
            if part in user_of:
                raise MachineError(
                    f"{owner} {user_of[part]!r} and {name!r} share the {kind} {part!r}",
                    place=machine.place,
                    remedy=f"Give each a separate {kind}.",
                )
            user_of[part] = name
