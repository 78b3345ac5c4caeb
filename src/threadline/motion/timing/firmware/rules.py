"""The moves of a program as a firmware sees them: lengths, directions, speeds, accelerations.

Sources: grbl 1.1, "Improving Grbl's cornering algorithm" (S. Jeon, 2011) and its wiki, "Configuring
Grbl", $11; Marlin 2.1, marlinfw.org/docs/configuration, Junction Deviation and Jerk; Klipper,
docs/Kinematics.md, "Look-ahead"; RepRapFirmware, ``DDA::MatchSpeeds`` and its documents of M566.

A circle touches both moves of a corner and passes it at the junction deviation d. With the angle
theta between the moves (pi if the path continues straight) its radius is
r = d sin(theta/2) / (1 - sin(theta/2)), and the speed at the corner is the one at which the circle
needs the available acceleration a: v^2 = a r.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.machine import Machine
from threadline.machine.motion_planner import (
    FirmwarePlanner,
    GrblPlanner,
    KlipperPlanner,
    MarlinPlanner,
    RepRapPlanner,
)
from threadline.machine.quantity import Quantity
from threadline.motion.timing.types import TrajectoryBlock

if TYPE_CHECKING:
    from threadline.jobs.program_limits import ProgramLimits


def standing(
    begin_s: float, position: FloatArray, duration_s: float, operation: IntArray
) -> TrajectoryBlock:
    """Return a pause at (axes,) ``position``."""
    coefficients = np.zeros((1, 3, len(position)))
    coefficients[0, 0] = position
    return TrajectoryBlock(
        start_s=np.array([begin_s]),
        duration_s=np.array([duration_s]),
        coefficients=coefficients,
        operation=operation,
    )


def _none() -> FloatArray:
    return np.empty(0)


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """Moves in mm and degrees, as firmwares count.

    Parameters
    ----------
    length
        (n,) > 0, by the firmware's own rule: of all axes together, or of X Y Z only.
    direction
        (n, axes) displacement of each axis over the length.
    speed
        (n,) programmed speed limited by the axes, per second.
    acceleration
        (n,) acceleration limit of the axes.
    most_acceleration
        (n,) Klipper's ``max_accel`` in force at each move; empty in other firmwares.
    corner_speed, cruise_ratio
        (n,) Klipper's square corner velocity and minimum cruise ratio there, or empty.
    """

    length: FloatArray
    direction: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    most_acceleration: FloatArray = field(default_factory=_none)
    corner_speed: FloatArray = field(default_factory=_none)
    cruise_ratio: FloatArray = field(default_factory=_none)

    def __len__(self) -> int:
        return len(self.length)

    def part(self, rows: slice) -> Moves:
        """Return some of the moves."""
        return Moves(
            self.length[rows],
            self.direction[rows],
            self.speed[rows],
            self.acceleration[rows],
            self.most_acceleration[rows],
            self.corner_speed[rows],
            self.cruise_ratio[rows],
        )


_STRAIGHT = 0.999999  # cosine at which grbl and Marlin call a corner straight, or a full turn
_SMALL = 1.0  # mm: in Marlin shorter moves of a bend count as an arc
_OCTAGON = -0.7071067812
_TABLE = 16  # intervals, each half as wide as the one before
_CENTRED = 1.00751495
"""Factor between Marlin's table of arc cosines and true values, to centre its errors."""


def along_axes(limits: FloatArray, directions: FloatArray) -> FloatArray:
    """Return the (n,) largest value along (n, axes) directions that keeps the (axes,) limits."""
    size = np.abs(directions)
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(size > 0.0, limits / size, np.inf).min(axis=1, initial=np.inf))


def by_junction_deviation(
    moves: Moves,
    acceleration: FloatArray | None,
    deviation: float,
    *,
    most: FloatArray | None = None,
    arcs: bool = False,
) -> FloatArray:
    """Return the (n - 1,) largest v^2 between the moves, as in grbl and Marlin.

    Parameters
    ----------
    moves
        n moves.
    acceleration
        (axes,) limits of the axes along the change of direction; None for none.
    deviation
        Junction deviation in the unit of length of the moves.
    most
        (n,) acceleration of each move, an upper bound at the corner where it begins; None for none,
        as in grbl.
    arcs
        Whether short moves that bend by less than 45 degrees count as chords of an arc.
    """
    direction_before, direction_after = moves.direction[:-1], moves.direction[1:]
    cosine = -(direction_before * direction_after).sum(axis=1)
    bend = direction_after - direction_before
    change = np.linalg.norm(bend, axis=1)
    change[change == 0.0] = 1.0
    limit = np.full(len(bend), np.inf) if most is None else most[1:]
    if acceleration is not None:
        limit = np.minimum(limit, along_axes(acceleration, bend / change[:, None]))
    # Marlin clamps the cosine at -1; grbl accepts any speed there.
    half_sine = np.sqrt(0.5 * (1.0 - np.clip(cosine, -_STRAIGHT, 1.0)))
    speed2 = limit * deviation * half_sine / (1.0 - half_sine)
    if most is None:
        speed2[cosine < -_STRAIGHT] = np.inf
    if arcs:
        is_short = (moves.length[1:] < _SMALL) & (cosine < _OCTAGON)
        angle = _arc_cosine(np.clip(-cosine, 0.0, _STRAIGHT))
        speed2 = np.where(is_short, np.minimum(speed2, moves.length[1:] * limit / angle), speed2)
    speed2[cosine > _STRAIGHT] = 0.0
    return np.asarray(speed2)


def _arc_cosine(cosine: FloatArray) -> FloatArray:
    """Return (n,) angles as Marlin computes them, by chords between the points of its table.

    The points are 1 - 2^-k, and the last is ``_STRAIGHT``; all but the two outermost angles are too
    large by ``_CENTRED``.
    """
    ends = np.append(1.0 - 0.5 ** np.arange(_TABLE), _STRAIGHT)
    angle = np.arccos(ends)
    angle[1:-1] *= _CENTRED
    return np.asarray(np.interp(cosine, ends, angle))


def by_jumps(moves: Moves, jumps: FloatArray) -> FloatArray:
    """Return the (n,) greatest v^2 at the start of each move by the (axes,) jumps of speed.

    The first move sets out from rest with a jump; Marlin's "classic jerk".
    """
    speed = moves.direction * moves.speed[:, None]
    shared = np.minimum(moves.speed[1:], moves.speed[:-1])
    change = shared[:, None] * (moves.direction[1:] - moves.direction[:-1])
    first_share = along_axes(jumps, speed[:1])
    share = np.concatenate(
        (np.minimum(first_share, 1.0), np.minimum(along_axes(jumps, change), 1.0))
    )
    return np.asarray((np.append(moves.speed[0], shared) * share) ** 2)


def by_shared_speed(moves: Moves, jumps: FloatArray) -> FloatArray:
    """Return the (n - 1,) largest squared speeds at the corners between n moves.

    The (axes,) ``jumps`` bound the speed jump of each axis there. Both moves have the same speed at
    the corner, as in RepRapFirmware.
    """
    return along_axes(jumps, np.diff(moves.direction, axis=0)) ** 2


def by_square_corner(moves: Moves, plane: FloatArray) -> FloatArray:
    """Return the (n - 1,) largest v^2 between the moves, as in Klipper.

    A corner of 90 degrees is passed at ``Moves.corner_speed``, the lower one of its two moves; no
    corner circle reaches beyond the middle of its moves.

    Parameters
    ----------
    moves
        n moves.
    plane
        (axes,) 1 for X, Y, Z, whose angle counts, 0 for others.
    """
    direction_before, direction_after = moves.direction[:-1] * plane, moves.direction[1:] * plane
    cosine = -(direction_before * direction_after).sum(axis=1)
    half_sine = np.sqrt(np.maximum(0.5 * (1.0 - cosine), 0.0))
    half_cosine = np.sqrt(np.maximum(0.5 * (1.0 + cosine), 0.0))
    bends = (half_sine < 1.0) & (half_cosine > 0.0)
    safe_sine, safe_cosine = np.where(bends, half_sine, 0.0), np.where(bends, half_cosine, 1.0)
    # The deviation of a circle that passes 90 degrees at that speed is v^2 (sqrt 2 - 1) / a: the
    # acceleration cancels if it is the same for all moves, and counts if it is less.
    radius = safe_sine / (1.0 - safe_sine) * (np.sqrt(2.0) - 1.0)
    corner_speed2 = moves.acceleration / moves.most_acceleration * moves.corner_speed**2
    speed2 = radius * np.minimum(corner_speed2[1:], corner_speed2[:-1])
    gain = 2.0 * moves.acceleration * moves.length
    speed2 = np.minimum(speed2, 0.25 * safe_sine / safe_cosine * np.minimum(gain[1:], gain[:-1]))
    return np.asarray(np.where(bends, speed2, np.inf))


MM = 1e3  # firmwares count in mm and degrees
LINEAR, _SECOND, _TURNING = "XYZ", "UVW", "ABC"
_SHORT_S = 0.02  # Marlin's default of M205 B
_INSTANT = 1.0  # mm/s or deg/s: Klipper's default for axes besides X Y Z


@dataclass(frozen=True, slots=True, eq=False)
class Rules:
    """A firmware's planner on the axes of a path.

    Parameters
    ----------
    planner
        Its entry in the machine file.
    axes
        Names, in the order of all columns.
    scale
        (axes,) mm or degrees in a m or rad.
    velocity, acceleration
        (axes,) limits in mm and degrees.
    steps
        (axes,) steps per mm or degree; None if steps are too fine to matter.
    limits
        Limits that the program sets, which Klipper alone takes; None without any.
    """

    planner: FirmwarePlanner
    axes: tuple[str, ...]
    scale: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    steps: FloatArray | None = None
    limits: ProgramLimits | None = None

    @classmethod
    def of(cls, planner: FirmwarePlanner, machine: Machine, axes: tuple[str, ...]) -> Rules:
        """Return the rules of ``planner`` on ``axes`` of ``machine``."""
        columns = [machine.axis_names.index(axis) for axis in axes]
        is_rotary = np.array([axis in machine.rotary for axis in axes])
        scale = np.where(is_rotary, np.degrees(1.0), MM)
        return cls(
            planner,
            axes,
            scale,
            machine.velocity_limit[columns] * scale,
            machine.acceleration_limit[columns] * scale,
            machine.counts_per_unit[columns] / scale,
        )

    def moves(
        self, way: FloatArray, nominal_s: FloatArray, operation: IntArray | None = None
    ) -> Moves:
        """Return (n, axes) displacements, m and rad, as the firmware's moves.

        ``nominal_s`` is the time at the programmed feed, 0 for a rapid move; ``operation`` says
        which of the program's own limits hold.
        """
        length = self.length(way)
        way = way * self.scale
        direction = way / length[:, None]
        planner = self.planner
        if isinstance(planner, KlipperPlanner):
            return self._klipper_moves(length, direction, nominal_s, operation)
        fastest = along_axes(self.velocity, direction)
        acceleration = along_axes(self.acceleration, direction)
        if isinstance(planner, MarlinPlanner):
            acceleration = np.minimum(acceleration, self.most_acceleration)
        elif isinstance(planner, RepRapPlanner) and planner.acceleration is not None:
            travel = np.where(self._across(direction), planner.acceleration.si * MM, np.inf)
            acceleration = np.minimum(acceleration, travel)
        with np.errstate(divide="ignore"):
            programmed = np.where(nominal_s > 0.0, length / nominal_s, np.inf)
        programmed = np.maximum(programmed, self.least_speed)
        return Moves(length, direction, np.minimum(programmed, fastest), acceleration)

    def _klipper_moves(
        self,
        length: FloatArray,
        direction: FloatArray,
        nominal_s: FloatArray,
        operation: IntArray | None,
    ) -> Moves:
        """Return the moves as Klipper plans them, under the limits that the program sets.

        Klipper, ``klippy/toolhead.py``: a move keeps the limits in force when it is queued. X and Y
        have none of their own there, so that one of the machine file that is not below Klipper's
        own gives way to the program's.
        """
        planner = self.planner
        assert isinstance(planner, KlipperPlanner)
        own_limits = np.array(
            [
                planner.velocity.si, planner.acceleration.si, planner.square_corner_velocity.si,
                planner.cruise_ratio,
            ]
        )  # fmt: skip
        changed = np.full((len(length), len(own_limits)), np.nan)
        if self.limits is not None and operation is not None:
            changed = self.limits.at(operation)
        top, most, corner, ratio = np.where(np.isnan(changed), own_limits, changed).T
        top, most, corner = top * MM, most * MM, corner * MM
        fastest = self._beyond(self.velocity, own_limits[0] * MM, direction, changed[:, 0])
        acceleration = self._beyond(self.acceleration, own_limits[1] * MM, direction, changed[:, 1])
        moves_xyz = (direction * self._plane != 0.0).any(axis=1)
        fastest = np.where(moves_xyz, np.minimum(fastest, top), fastest)
        single_axis_limits = along_axes(self._of_axes(planner.alone), direction)
        acceleration = np.minimum(acceleration, np.where(moves_xyz, most, single_axis_limits))
        with np.errstate(divide="ignore"):
            programmed = np.where(nominal_s > 0.0, length / nominal_s, np.inf)
        return Moves(
            length, direction, np.minimum(programmed, fastest), acceleration, most, corner, ratio
        )

    def _beyond(
        self, limits: FloatArray, own_limit: float, direction: FloatArray, changed: FloatArray
    ) -> FloatArray:
        """Return (n,) limits of the axes; X and Y do not count where the program sets a limit.

        ``own_limit`` is the limit of every move in Klipper's configuration; the limits of X and Y
        in the machine file repeat it.
        """
        all_axes = along_axes(limits, direction)
        repeats_own = np.array([axis in "XY" for axis in self.axes]) & (
            limits >= own_limit * (1.0 - 1e-9)
        )
        other_axes = along_axes(np.where(repeats_own, np.inf, limits), direction)
        return np.asarray(np.where(np.isnan(changed), all_axes, other_axes))

    @property
    def most_acceleration(self) -> float:
        """Acceleration that Marlin's settings give every move, infinite for none."""
        planner = self.planner
        if isinstance(planner, MarlinPlanner) and planner.acceleration is not None:
            return planner.acceleration.si * MM
        return np.inf

    @property
    def least_speed(self) -> float:
        """Least speed to which Marlin raises slower moves, 0 for none."""
        planner = self.planner
        if isinstance(planner, MarlinPlanner) and planner.least_speed is not None:
            return planner.least_speed.si * MM
        return 0.0

    @property
    def short_time_s(self) -> float:
        """Time below which Marlin slows a move while few are buffered."""
        planner = self.planner
        if isinstance(planner, MarlinPlanner) and planner.short_time is not None:
            return planner.short_time.si
        return _SHORT_S

    def corners(self, moves: Moves) -> FloatArray:
        """Return the (n,) largest v^2 at the start of each of n moves, the first from rest."""
        planner = self.planner
        if isinstance(planner, MarlinPlanner) and planner.jump:
            return by_jumps(moves, self._of_axes(planner.jump))
        if isinstance(planner, KlipperPlanner):
            corner2 = by_square_corner(moves, self._plane)
            moves_xyz = (moves.direction * self._plane != 0.0).any(axis=1)
            corner2 = np.minimum(corner2, self._beside(moves))
            corner2 = np.where(moves_xyz[1:] & moves_xyz[:-1], corner2, 0.0)
        elif isinstance(planner, RepRapPlanner):
            corner2 = by_shared_speed(moves, self._of_axes(planner.jump))
            if not planner.joins_all:
                moves_bed = self._across(moves.direction)
                corner2 = np.where(moves_bed[1:] == moves_bed[:-1], corner2, 0.0)
        elif isinstance(planner, GrblPlanner):
            deviation = planner.junction_deviation.si * MM
            corner2 = by_junction_deviation(moves, self.acceleration, deviation)
        else:
            assert isinstance(planner, MarlinPlanner) and planner.junction_deviation is not None
            corner2 = by_junction_deviation(
                moves,
                self.acceleration if planner.corner_axes else None,
                planner.junction_deviation.si * MM,
                most=moves.acceleration,
                arcs=True,
            )
        shared2 = np.minimum(moves.speed[1:], moves.speed[:-1]) ** 2
        return np.concatenate(([0.0], np.minimum(corner2, shared2)))

    def _of_axes(self, quantities: Mapping[str, Quantity], default: float = np.inf) -> FloatArray:
        """Return the (axes,) values in ``quantities``; ``default`` for missing ones."""
        return np.array(
            [
                quantities[axis].si * scale if axis in quantities else default
                for axis, scale in zip(self.axes, self.scale, strict=True)
            ]
        )

    def _across(self, direction: FloatArray) -> NDArray[np.bool_]:
        """Return (n,) whether X or Y takes part in each move."""
        bed_axes = np.array([axis in "XY" for axis in self.axes])
        return np.asarray((direction[:, bed_axes] != 0.0).any(axis=1))

    @property
    def _plane(self) -> FloatArray:
        return np.array([float(axis in LINEAR) for axis in self.axes])

    def _beside(self, moves: Moves) -> FloatArray:
        """Return the (n - 1,) largest v^2 at which the axes besides X Y Z may change their share.

        Klipper, docs/Config_Reference.md, ``instantaneous_corner_velocity``.
        """
        assert isinstance(self.planner, KlipperPlanner)
        jumps = self._of_axes(self.planner.jump, _INSTANT)
        change = np.diff(moves.direction, axis=0) * (1.0 - self._plane)
        return along_axes(jumps, change) ** 2

    @property
    def _counted(self) -> list[str]:
        """Axes whose length counts, in turn: the first group with a moving axis."""
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
        length_found = np.zeros(len(way))
        for group in self._counted:
            columns = [axis in group for axis in self.axes]
            group_length = np.linalg.norm(way[:, columns], axis=1)
            length_found = np.where(length_found > 0.0, length_found, group_length)
        # Klipper: a move of other axes only is as long as the longest of them.
        return np.where(length_found > 0.0, length_found, np.abs(way).max(axis=1))
