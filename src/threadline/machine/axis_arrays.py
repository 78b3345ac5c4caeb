"""What the axes of a machine may do, as arrays in the order of its axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from threadline.arrays import FloatArray
from threadline.machine.acting_radius import acts_at_m
from threadline.machine.mandrel import LocalRadii, local_radii
from threadline.machine.parts import Axis, Tool
from threadline.machine.path_limits import PathLimits


class AxisArrays:
    """Arrays over the axes of a machine."""

    __slots__ = ()
    axes: dict[str, Axis]
    path: PathLimits | None
    tool: Tool | None

    def _column(self, field: Literal["counts", "velocity", "acceleration"]) -> FloatArray:
        return np.array([getattr(axis, field).si for axis in self.axes.values()])

    @property
    def counts_per_unit(self) -> FloatArray:
        """(axes,) counts per m or rad."""
        return self._column("counts")

    @property
    def velocity_limit(self) -> FloatArray:
        """(axes,) m/s or rad/s."""
        return self._column("velocity")

    @property
    def acceleration_limit(self) -> FloatArray:
        """(axes,) m/s^2 or rad/s^2, of speeding up and braking alike: the lower of both."""
        return np.minimum(*self.sides)

    @property
    def sides(self) -> tuple[FloatArray, FloatArray]:
        """(axes,) m/s^2 or rad/s^2: the limits of speeding up, and of braking."""
        braking = [axis.deceleration or axis.acceleration for axis in self.axes.values()]
        return self._column("acceleration"), np.array([limit.si for limit in braking])

    def least_acceleration(self, axes: Sequence[str]) -> float:
        """Return the acceleration that each of ``axes`` and the path allow, braking too: m/s^2."""
        column = [list(self.axes).index(axis) for axis in axes]
        own = [] if self.path is None else [self.path.acceleration, self.path.deceleration]
        along = [limit.si for limit in own if limit is not None]
        return min([float(self.acceleration_limit[column].min()), *along])

    @property
    def jerk_limit(self) -> FloatArray:
        """(axes,) m/s^3 or rad/s^3; infinite where the file gives none."""
        return np.array(
            [np.inf if axis.jerk is None else axis.jerk.si for axis in self.axes.values()]
        )

    @property
    def travel(self) -> FloatArray:
        """(axes, 2) lowest and highest position, m or rad; infinite for an endless axis."""
        return np.array(
            [
                (-np.inf, np.inf) if axis.travel is None else [end.si for end in axis.travel]
                for axis in self.axes.values()
            ]
        )

    @property
    def radius_m(self) -> FloatArray:
        """(axes,) 1 for a linear axis, for a rotary one its own radius, else that of the tool.

        With a profile it is the largest.
        """
        return np.array([acts_at_m(axis, self.tool) for axis in self.axes.values()])

    def local_radii(self, axes: Sequence[str]) -> LocalRadii | None:
        """Return by how much less the radii are from place to place, for a path of ``axes``."""
        profiles = {
            name: axis.profile for name, axis in self.axes.items() if axis.profile is not None
        }
        return local_radii(profiles, axes)
