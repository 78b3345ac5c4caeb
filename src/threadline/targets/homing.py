"""How one cylinder is brought home: slowly, until its contact says so, then pressed there.

It is pressed home for as long as its whole stroke takes: a contact that is stuck on, with the
piston anywhere, sends nothing else on its way before this cylinder is home.
"""

from __future__ import annotations

from dataclasses import dataclass

from threadline.errors import Place, PlanError
from threadline.machine import Machine
from threadline.machine.pneumatics import Way

_AMPLE = 2.0
_SPARE_S = 1.0
_WHOLE = 1.2  # strokes


@dataclass(frozen=True, slots=True, kw_only=True)
class HomeStage:
    """One cylinder on its way home.

    Parameters
    ----------
    on
        The outputs that bring it: its valve, and the flow controls of the smallest level.
    switch
        The contact that is on where it starts.
    late_s
        After so long without the contact it is a fault.
    pressed_s
        How long it is pressed home behind the contact.
    """

    on: tuple[str, ...]
    switch: str
    late_s: float
    pressed_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Homing:
    """One cylinder that an operation brings home, from its first scan until it is there."""

    operation: int
    axis: str
    first_tick: int
    last_tick: int


def home_stage(machine: Machine, axis: str, place: Place | None = None) -> HomeStage:
    """Return how a cylinder is brought home; its times hold all over its tolerances.

    Raises
    ------
    PlanError
        If no contact tells that it is there, or it may not move at all.
    """
    cylinder = machine.cylinders[axis]
    level, flows = slowest(cylinder.back)
    # As slow as its tolerances let it be.
    off = sum(cylinder.back.flows[flow].tolerance_si for flow in flows)
    speed = (level - off) * cylinder.speed.least
    if speed <= 0.0:
        raise PlanError(
            f"{axis} may stand still on its way home: its speed and flow controls have tolerances "
            "as large as they are",
            place=place,
            remedy="Measure its speed.",
        )
    rest_s = cylinder.longest_rest_s(forward=False)
    return HomeStage(
        on=(cylinder.back.valve, *flows),
        switch=home_switch(machine, axis, place),
        late_s=_AMPLE * (cylinder.stroke.si / speed + rest_s) + _SPARE_S,
        pressed_s=_WHOLE * cylinder.stroke.si / speed + rest_s,
    )


def home_switch(machine: Machine, axis: str, place: Place | None = None) -> str:
    """Return the end switch that is on where a cylinder starts, the nearest to its start.

    Raises
    ------
    PlanError
        If there is none.
    """
    near = {
        name: contact.at.si
        for name, contact in machine.contacts.items()
        if contact.cylinder == axis and contact.beyond == "below" and contact.at is not None
    }
    if not near:
        raise PlanError(
            f"no contact tells that {axis} is home, so that nothing could bring it there",
            place=place,
            remedy=f'Add a contact with cylinder = "{axis}", beyond = "below" to the machine file.',
        )
    return min(near, key=lambda name: near[name])


def slowest(way: Way) -> tuple[float, tuple[str, ...]]:
    """Return the smallest level above 0 of one direction, and the flow controls that make it."""
    sets = {flows: level for flows, level in way.levels().items() if level > 0.0}
    flows = min(sets, key=lambda chosen: sets[chosen])
    return sets[flows], flows
