"""The radius at which an axis acts, and limits of the tool along its path."""

from __future__ import annotations

from collections.abc import Mapping, Sized
from typing import Annotated

from pydantic import model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.eye import Tool
from threadline.machine.parts import STRICT, Axis, check_known
from threadline.machine.quantity import Quantity, Units


def check_radii(axes: Mapping[str, Axis], tool: Tool | None) -> None:
    """Check that every rotary axis has a radius, and every profile a linear axis.

    Raises
    ------
    ValueError
        If an axis has none; names the axis.
    """
    rotary = sorted(name for name, axis in axes.items() if axis.kind == "rotary")
    for name in rotary:
        axis = axes[name]
        if axis.profile is not None:
            along = axis.profile.along
            check_known([along], axes, f"axes.{name}.profile.along", "axis")
            if along in rotary:
                raise ValueError(
                    f"axes.{name}.profile is along {along}, a rotary axis; name a linear axis"
                )
        elif axis.radius is None and tool is None:
            raise ValueError(
                f"'tool' is missing: it gives the radius of the rotary axis {name}, like "
                '[tool] radius = "100 mm exact, assumed"; or give the axis a radius'
            )


def acts_at_m(axis: Axis, tool: Tool | None) -> float:
    """Return 1 for a linear axis; for a rotary axis its (largest) radius in m."""
    if axis.kind == "linear":
        return 1.0
    if axis.profile is not None:
        return axis.profile.largest_m
    if axis.radius is not None:
        return axis.radius.si
    # ``check_radii`` ensures a tool if a rotary axis has no radius.
    return 1.0 if tool is None else tool.radius.si


_Acceleration = Annotated[Quantity, Units(("m/s^2",), positive=True)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PathLimits:
    """Limits of the tool's motion along its path, with rotary axes at their radii.

    ``velocity``, ``acceleration`` and ``jerk`` are derivatives of the path length, ``deceleration``
    is the limit of braking, by default ``acceleration``, and ``centripetal`` is the acceleration
    across the path. A missing value is no limit.
    """

    velocity: Annotated[Quantity, Units(("m/s",), positive=True)] | None = None
    acceleration: _Acceleration | None = None
    deceleration: _Acceleration | None = None
    jerk: Annotated[Quantity, Units(("m/s^3",), positive=True)] | None = None
    centripetal: _Acceleration | None = None

    @property
    def asks_for_rests(self) -> bool:
        """Whether the tool must stop where its path turns back: its speed has a kink there."""
        return self.acceleration is not None or self.jerk is not None

    @model_validator(mode="after")
    def _consistent(self) -> PathLimits:
        if self.deceleration is not None and self.acceleration is None:
            raise ValueError("a deceleration along the path needs an acceleration: give both")
        if not any((self.velocity, self.acceleration, self.jerk, self.centripetal)):
            raise ValueError(
                "a [path] without limits: give velocity, acceleration, jerk or centripetal, or "
                "remove the table"
            )
        return self


def check_path_limits(
    path: PathLimits | None, axes: Mapping[str, Axis], cylinders: Sized, tables: object
) -> None:
    """Refuse path limits on machines that follow no path; ``ValueError`` begins with the key."""
    if path is not None and not axes:
        raise ValueError(
            "path: limits along the path need [axes.X]; cylinders are switched: remove it"
        )
    if path is not None and cylinders:
        raise ValueError(
            "path: limits along the path have no meaning for [cylinders.X], which are switched "
            "and follow no path: remove it"
        )
    if tables is None:
        return
    if path is not None:
        raise ValueError(
            "path: step tables move each axis separately between two stitches, along no path: "
            "remove it"
        )
    for name, axis in axes.items():
        if axis.deceleration is not None:
            raise ValueError(
                f"axes.{name}.deceleration: the laws of step tables brake as they speed up: "
                "remove it"
            )
