"""What a machine winds on, for the view in three dimensions."""

from __future__ import annotations

from threadline.machine import Machine
from threadline.panel.protocol import Mandrel


def mandrel_of(machine: Machine) -> Mandrel | None:
    """Return the mandrel of a machine: its first rotary axis beside a linear one; None for none.

    Where the machine has no profile of it, it is as thick everywhere as the radius at which that
    axis acts.
    """
    linear = [name for name, axis in machine.axes.items() if axis.kind == "linear"]
    for (name, axis), radius_m in zip(machine.axes.items(), machine.radius_m, strict=True):
        if axis.kind != "rotary" or not linear:
            continue
        if axis.profile is None:
            return Mandrel(axis=name, along=linear[0], at=[0.0], radius=[float(radius_m)])
        return Mandrel(
            axis=name,
            along=axis.profile.along,
            at=[place.si for place in axis.profile.at],
            radius=[radius.si for radius in axis.profile.radius],
        )
    return None
