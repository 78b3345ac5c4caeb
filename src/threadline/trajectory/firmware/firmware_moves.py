"""The moves of a program in a firmware's own terms: lengths, directions, speeds, accelerations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.trajectory.types import TrajectoryBlock


def standing(
    begin_s: float, position: FloatArray, duration_s: float, operation: IntArray
) -> TrajectoryBlock:
    """Return a pause at (axes,) ``position``."""
    held = np.zeros((1, 3, len(position)))
    held[0, 0] = position
    return TrajectoryBlock(
        start_s=np.array([begin_s]),
        duration_s=np.array([duration_s]),
        coefficients=held,
        operation=operation,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """Moves in mm and degrees, as firmwares count.

    Parameters
    ----------
    length
        (n,) > 0, by the firmware's own rule: of all axes together, or of X Y Z alone.
    direction
        (n, axes) the way of each axis over the length.
    speed
        (n,) that the program asks for, as far as the axes allow, per second.
    acceleration
        (n,) that the axes allow.
    most_acceleration
        The greatest that any move may have; Klipper's ``max_accel``.
    """

    length: FloatArray
    direction: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    most_acceleration: float = np.inf

    def __len__(self) -> int:
        return len(self.length)

    def part(self, rows: slice) -> Moves:
        """Return some of the moves."""
        return Moves(
            self.length[rows],
            self.direction[rows],
            self.speed[rows],
            self.acceleration[rows],
            self.most_acceleration,
        )
