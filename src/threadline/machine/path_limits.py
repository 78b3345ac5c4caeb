"""What the tool of a machine may do along its path, whatever its axes could do."""

from __future__ import annotations

from collections.abc import Mapping, Sized
from typing import Annotated

from pydantic import model_validator
from pydantic.dataclasses import dataclass

from threadline.machine.parts import STRICT, Axis
from threadline.machine.quantity import Quantity, Units

_Acceleration = Annotated[Quantity, Units(("m/s^2",), positive=True)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class PathLimits:
    """Limits of the way that the tool goes, rotary axes at the radius at which they act.

    ``velocity``, ``acceleration`` and ``jerk`` are of the length of that way, ``deceleration`` is
    what it may brake with, where that is not ``acceleration``, and ``centripetal`` is the
    acceleration across the path. What is left out is no limit.
    """

    velocity: Annotated[Quantity, Units(("m/s",), positive=True)] | None = None
    acceleration: _Acceleration | None = None
    deceleration: _Acceleration | None = None
    jerk: Annotated[Quantity, Units(("m/s^3",), positive=True)] | None = None
    centripetal: _Acceleration | None = None

    @property
    def asks_for_rests(self) -> bool:
        """Whether the tool rests where its path turns back: its speed has a kink there."""
        return self.acceleration is not None or self.jerk is not None

    @model_validator(mode="after")
    def _consistent(self) -> PathLimits:
        if self.deceleration is not None and self.acceleration is None:
            raise ValueError("a deceleration along the path goes with an acceleration: give both")
        if not any((self.velocity, self.acceleration, self.jerk, self.centripetal)):
            raise ValueError(
                "a path without any limit: give velocity, acceleration, jerk or centripetal, or "
                "take the table out"
            )
        return self


def check_asked_of_paths(
    path: PathLimits | None, axes: Mapping[str, Axis], cylinders: Sized, tables: object
) -> None:
    """Refuse limits of planned motion where none is planned; ``ValueError`` begins with the key."""
    if path is not None and not axes:
        raise ValueError(
            "path: limits along the path are of [axes.X], and cylinders are switched: take it out"
        )
    if path is not None and cylinders:
        raise ValueError(
            "path: limits along the path mean nothing beside [cylinders.X], which are switched "
            "and follow no path: take it out"
        )
    if tables is None:
        return
    if path is not None:
        raise ValueError(
            "path: step tables move each axis for itself between two stitches, along no path: "
            "take it out"
        )
    for name, axis in axes.items():
        if axis.deceleration is not None:
            raise ValueError(
                f"axes.{name}.deceleration: the laws of step tables brake as they speed up: take "
                "it out"
            )
