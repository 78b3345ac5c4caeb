"""Each firmware's own rules: what its moves are, how they meet, and how far it looks ahead."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.machine import Machine
from threadline.machine.motion_planner import (
    FirmwarePlanner,
    GrblPlanner,
    KlipperPlanner,
    MarlinPlanner,
    RepRapPlanner,
)
from threadline.machine.quantity import Quantity
from threadline.trajectory.firmware.firmware_moves import Moves
from threadline.trajectory.firmware.junctions import (
    along_axes,
    by_jumps,
    by_junction_deviation,
    by_shared_speed,
    by_square_corner,
)

MM = 1e3  # firmwares count in mm and degrees
LINEAR, _SECOND, _TURNING = "XYZ", "UVW", "ABC"
_SHORT_S = 0.02  # Marlin's own default of M205 B
_INSTANT = 1.0  # mm/s or deg/s: Klipper's own default for axes beside X Y Z


@dataclass(frozen=True, slots=True, eq=False)
class Rules:
    """A firmware's planner on the axes of a path.

    Parameters
    ----------
    planner
        What the machine file says of it.
    axes
        Names, in the order of all columns.
    scale
        (axes,) mm or degrees in a m or rad.
    velocity, acceleration
        (axes,) limits in mm and degrees.
    steps
        (axes,) in a mm or degree; None for so many that they do not count.
    """

    planner: FirmwarePlanner
    axes: tuple[str, ...]
    scale: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    steps: FloatArray | None = None

    @classmethod
    def of(cls, planner: FirmwarePlanner, machine: Machine, axes: tuple[str, ...]) -> Rules:
        """Return the rules of ``planner`` on ``axes`` of ``machine``."""
        column = [machine.axis_names.index(axis) for axis in axes]
        turns = np.array([axis in machine.rotary for axis in axes])
        scale = np.where(turns, np.degrees(1.0), MM)
        return cls(
            planner,
            axes,
            scale,
            machine.velocity_limit[column] * scale,
            machine.acceleration_limit[column] * scale,
            machine.counts_per_unit[column] / scale,
        )

    def moves(self, way: FloatArray, nominal_s: FloatArray) -> Moves:
        """Return (n, axes) displacements, m and rad, as the firmware's moves.

        ``nominal_s`` is the time at the programmed feed, 0 for a rapid move.
        """
        length = self.length(way)
        way = way * self.scale
        direction = way / length[:, None]
        fastest = along_axes(self.velocity, direction)
        acceleration = along_axes(self.acceleration, direction)
        most = self.most_acceleration
        planner = self.planner
        if isinstance(planner, KlipperPlanner):
            plain = (direction * self._plane != 0.0).any(axis=1)
            fastest = np.where(plain, np.minimum(fastest, planner.velocity.si * MM), fastest)
            alone = along_axes(self._of_axes(planner.alone), direction)
            acceleration = np.minimum(acceleration, np.where(plain, most, alone))
        elif isinstance(planner, MarlinPlanner):
            acceleration = np.minimum(acceleration, most)
        elif isinstance(planner, RepRapPlanner) and planner.acceleration is not None:
            travel = np.where(self._across(direction), planner.acceleration.si * MM, np.inf)
            acceleration = np.minimum(acceleration, travel)
        with np.errstate(divide="ignore"):
            asked = np.where(nominal_s > 0.0, length / nominal_s, np.inf)
        asked = np.maximum(asked, self.least_speed)
        return Moves(length, direction, np.minimum(asked, fastest), acceleration, most)

    @property
    def most_acceleration(self) -> float:
        """What Klipper's and Marlin's settings give every move, infinite for none."""
        planner = self.planner
        if isinstance(planner, KlipperPlanner | MarlinPlanner) and planner.acceleration is not None:
            return planner.acceleration.si * MM
        return np.inf

    @property
    def least_speed(self) -> float:
        """What Marlin raises the speed of a slower move to, 0 for none."""
        planner = self.planner
        if isinstance(planner, MarlinPlanner) and planner.least_speed is not None:
            return planner.least_speed.si * MM
        return 0.0

    @property
    def short_time_s(self) -> float:
        """Time below which Marlin makes a move slower while few are in hand."""
        planner = self.planner
        if isinstance(planner, MarlinPlanner) and planner.short_time is not None:
            return planner.short_time.si
        return _SHORT_S

    def corners(self, moves: Moves) -> FloatArray:
        """Return the (n,) greatest v^2 at the start of each of n moves, the first from rest."""
        planner = self.planner
        if isinstance(planner, MarlinPlanner) and planner.jump:
            return by_jumps(moves, self._of_axes(planner.jump))
        if isinstance(planner, KlipperPlanner):
            between = by_square_corner(moves, self._plane, planner.square_corner_velocity.si * MM)
            plain = (moves.direction * self._plane != 0.0).any(axis=1)
            between = np.minimum(between, self._beside(moves))
            between = np.where(plain[1:] & plain[:-1], between, 0.0)
        elif isinstance(planner, RepRapPlanner):
            between = by_shared_speed(moves, self._of_axes(planner.jump))
            if not planner.joins_all:
                across = self._across(moves.direction)
                between = np.where(across[1:] == across[:-1], between, 0.0)
        elif isinstance(planner, GrblPlanner):
            deviation = planner.junction_deviation.si * MM
            between = by_junction_deviation(moves, self.acceleration, deviation)
        else:
            assert isinstance(planner, MarlinPlanner) and planner.junction_deviation is not None
            between = by_junction_deviation(
                moves,
                self.acceleration,
                planner.junction_deviation.si * MM,
                most=moves.acceleration,
                arcs=True,
            )
        top = np.minimum(moves.speed[1:], moves.speed[:-1]) ** 2
        return np.concatenate(([0.0], np.minimum(between, top)))

    def _of_axes(self, said: Mapping[str, Quantity], default: float = np.inf) -> FloatArray:
        """Return the (axes,) values of ``said``; ``default`` where it has none."""
        return np.array(
            [
                said[axis].si * scale if axis in said else default
                for axis, scale in zip(self.axes, self.scale, strict=True)
            ]
        )

    def _across(self, direction: FloatArray) -> NDArray[np.bool_]:
        """Return (n,) whether X or Y takes part in each move."""
        bed = np.array([axis in "XY" for axis in self.axes])
        return np.asarray((direction[:, bed] != 0.0).any(axis=1))

    @property
    def _plane(self) -> FloatArray:
        return np.array([float(axis in LINEAR) for axis in self.axes])

    def _beside(self, moves: Moves) -> FloatArray:
        """Return the (n - 1,) greatest v^2 at which the axes beside X Y Z may change their share.

        Klipper, docs/Config_Reference.md, ``instantaneous_corner_velocity``.
        """
        assert isinstance(self.planner, KlipperPlanner)
        jumps = self._of_axes(self.planner.jump, _INSTANT)
        change = np.diff(moves.direction, axis=0) * (1.0 - self._plane)
        return along_axes(jumps, change) ** 2

    @property
    def _counted(self) -> list[str]:
        """Axes whose length counts, in turn: the first group of which one moves."""
        if isinstance(self.planner, KlipperPlanner):
            return [LINEAR]
        if isinstance(self.planner, RepRapPlanner):
            return [LINEAR + _SECOND, _TURNING]
        return [LINEAR, _SECOND, _TURNING]

    def length(self, way: FloatArray) -> FloatArray:
        """Return the (n,) lengths of (n, axes) displacements, m and rad, as the firmware counts."""
        way = way * self.scale
        if isinstance(self.planner, GrblPlanner):
            return np.asarray(np.linalg.norm(way, axis=1))
        found = np.zeros(len(way))
        for group in self._counted:
            column = [axis in group for axis in self.axes]
            here = np.linalg.norm(way[:, column], axis=1)
            found = np.where(found > 0.0, found, here)
        # Klipper: a move of other axes alone is as long as the longest of them.
        return np.where(found > 0.0, found, np.abs(way).max(axis=1))
