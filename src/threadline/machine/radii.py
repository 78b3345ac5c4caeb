"""The radii at which the rotary axes of a machine act on one job."""

from __future__ import annotations

from dataclasses import replace

from threadline.errors import OptionError, UnitError
from threadline.machine.model import Machine
from threadline.machine.quantity import parse_machine_quantity


def with_radii(machine: Machine, text: str | None) -> Machine:
    """Return ``machine`` with radii of its rotary axes, given like ``"A=40 mm, B=2 mm"``.

    With None the machine is returned as it is.

    Raises
    ------
    OptionError
        If the text cannot be read, or names an axis that is not rotary.
    """
    if text is None:
        return machine
    axes = dict(machine.axes)
    for part in text.split(","):
        name, equals, written = (piece.strip() for piece in part.partition("="))
        axis = machine.axes.get(name)
        if not equals or axis is None or axis.kind != "rotary":
            turning = ", ".join(sorted(machine.rotary)) or "none"
            raise OptionError(
                f"--radius {part.strip()[:40]!r} is not the radius of a rotary axis of "
                f"{machine.name!r}",
                remedy=f'Write it like "A=40 mm"; its rotary axes: {turning}.',
            )
        try:
            radius = parse_machine_quantity(f"{written} exact, assumed", ("m",))
        except UnitError as error:
            raise OptionError(
                f"--radius {part.strip()[:40]!r}: {error.message}",
                remedy='Write it like "A=40 mm".',
            ) from error
        if axes[name] is not axis:
            raise OptionError(
                f"--radius {text[:80]!r} gives {name} two radii", remedy="Give each axis one."
            )
        if radius.si <= 0.0:
            raise OptionError(f"--radius {part.strip()[:40]!r} must be greater than 0")
        axes[name] = replace(axis, radius=radius)
    return replace(machine, axes=axes)
