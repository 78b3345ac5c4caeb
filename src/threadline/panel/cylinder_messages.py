"""The parts of a machine with cylinders, as the page draws them before any program."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel

from threadline.machine import Machine


class EndSwitch(BaseModel):
    """A contact that closes where its cylinder is ``beyond`` a position, SI."""

    name: str
    at: float
    beyond: Literal["below", "above"]


class Cylinder(BaseModel):
    """A cylinder, from 0 to its stroke, SI; the outputs that move it, and its contacts."""

    name: str
    unit: Literal["m", "rad"]
    stroke: float
    forward: list[str]
    """Valve and flow controls of the outward stroke."""
    back: list[str]
    contacts: list[EndSwitch]


def cylinders_of(machine: Machine) -> list[Cylinder]:
    """Return the cylinders of a machine with their outputs and their contacts."""
    return [
        Cylinder(
            name=name,
            unit="rad" if one.kind == "rotary" else "m",
            stroke=one.stroke.si,
            forward=[one.forward.valve, *one.forward.flows],
            back=[one.back.valve, *one.back.flows],
            contacts=[
                EndSwitch(name=contact, at=switch.at.si, beyond=switch.beyond)
                for contact, switch in machine.contacts.items()
                if switch.cylinder == name and switch.at is not None and switch.beyond is not None
            ],
        )
        for name, one in machine.cylinders.items()
    ]
