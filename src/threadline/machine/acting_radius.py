"""The radius at which an axis acts on the work."""

from __future__ import annotations

from collections.abc import Mapping

from threadline.machine.parts import Axis, Tool
from threadline.machine.references import check_known


def check_radii(axes: Mapping[str, Axis], tool: Tool | None) -> None:
    """Check that every rotary axis has a radius, and every profile an axis to go along.

    Raises
    ------
    ValueError
        With the axis that has none.
    """
    rotary = sorted(name for name, axis in axes.items() if axis.kind == "rotary")
    for name in rotary:
        axis = axes[name]
        if axis.profile is not None:
            along = axis.profile.along
            check_known([along], axes, f"axes.{name}.profile.along", "axis")
            if along in rotary:
                raise ValueError(
                    f"axes.{name}.profile goes along {along}, which turns; name a linear axis"
                )
        elif axis.radius is None and tool is None:
            raise ValueError(
                f"'tool' is missing: it says at which radius the rotary axis {name} acts, like "
                '[tool] radius = "100 mm exact, assumed", or give the axis a radius of its own'
            )


def acts_at_m(axis: Axis, tool: Tool | None) -> float:
    """Return 1 for a linear axis; for a rotary one its radius in m, the largest of its profile."""
    if axis.kind == "linear":
        return 1.0
    if axis.profile is not None:
        return axis.profile.largest_m
    if axis.radius is not None:
        return axis.radius.si
    # Where an axis without one turns there is a tool: ``check_radii`` has seen to it.
    return 1.0 if tool is None else tool.radius.si
