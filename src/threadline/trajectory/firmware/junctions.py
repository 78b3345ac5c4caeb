"""How fast a firmware lets its moves meet: the square of the speed at every corner.

Sources: grbl 1.1, "Improving Grbl's cornering algorithm" (S. Jeon, 2011) and its wiki, "Configuring
Grbl", $11; Marlin 2.1, marlinfw.org/docs/configuration, Junction Deviation and Jerk; Klipper,
docs/Kinematics.md, "Look-ahead"; RepRapFirmware, ``DDA::MatchSpeeds`` and its documents of M566.

A circle touches both moves of a corner and passes it at the junction deviation d. With the angle
theta between the moves (pi where the path goes straight on) its radius is
r = d sin(theta/2) / (1 - sin(theta/2)), and the speed at the corner is that at which the circle
needs the acceleration a that there is: v^2 = a r.
"""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.trajectory.firmware.firmware_moves import Moves

_STRAIGHT = 0.999999  # of the cosine: grbl and Marlin call a corner straight, or a full turn, here
_SMALL = 1.0  # mm: shorter moves of a bend count as an arc, in Marlin
_OCTAGON = -0.7071067812
_TABLE = 16  # intervals, each half as wide as the one before
_CENTRED = 1.00751495
"""By what Marlin's table of arc cosines multiplies them, for errors of both signs."""


def along_axes(limits: FloatArray, directions: FloatArray) -> FloatArray:
    """Return the (n,) most along (n, axes) directions that keeps the (axes,) limits."""
    size = np.abs(directions)
    with np.errstate(divide="ignore"):
        return np.asarray(np.where(size > 0.0, limits / size, np.inf).min(axis=1, initial=np.inf))


def by_junction_deviation(
    moves: Moves,
    acceleration: FloatArray,
    deviation: float,
    *,
    most: FloatArray | None = None,
    arcs: bool = False,
) -> FloatArray:
    """Return the (n - 1,) greatest v^2 between the moves, as grbl and Marlin have it.

    Parameters
    ----------
    moves
        n moves.
    acceleration
        (axes,) limits of the axes.
    deviation
        In the length of the moves.
    most
        (n,) acceleration of each move, no more than which counts at the corner that it begins
        at; None for the limits of the axes alone.
    arcs
        Whether short moves that bend by less than 45 degrees count as chords of an arc.
    """
    before, after = moves.direction[:-1], moves.direction[1:]
    cosine = -(before * after).sum(axis=1)
    bend = after - before
    size = np.linalg.norm(bend, axis=1)
    size[size == 0.0] = 1.0
    limit = along_axes(acceleration, bend / size[:, None]) if most is None else most[1:]
    # Marlin keeps the cosine from -1; grbl takes any speed there.
    half = np.sqrt(0.5 * (1.0 - np.clip(cosine, -_STRAIGHT, 1.0)))
    square = limit * deviation * half / (1.0 - half)
    if most is None:
        square[cosine < -_STRAIGHT] = np.inf
    if arcs:
        short = (moves.length[1:] < _SMALL) & (cosine < _OCTAGON)
        angle = _arc_cosine(np.clip(-cosine, 0.0, _STRAIGHT))
        square = np.where(short, np.minimum(square, moves.length[1:] * limit / angle), square)
    square[cosine > _STRAIGHT] = 0.0
    return np.asarray(square)


def _arc_cosine(cosine: FloatArray) -> FloatArray:
    """Return (n,) angles as Marlin has them, on chords between the ends of its table's intervals.

    The ends are 1 - 2^-k, and the last is ``_STRAIGHT``; but for the two outermost their angles are
    by ``_CENTRED`` too large.
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
    first = along_axes(jumps, speed[:1])
    share = np.concatenate((np.minimum(first, 1.0), np.minimum(along_axes(jumps, change), 1.0)))
    return np.asarray((np.append(moves.speed[0], shared) * share) ** 2)


def by_shared_speed(moves: Moves, jumps: FloatArray) -> FloatArray:
    """Return the (n - 1,) greatest squares of the speed at the corners between n moves.

    By how much the speed of each axis may jump there is given by the (axes,) ``jumps``. Both
    moves have the same speed at the corner, as RepRapFirmware has it.
    """
    return along_axes(jumps, np.diff(moves.direction, axis=0)) ** 2


def by_square_corner(moves: Moves, plane: FloatArray, corner_speed: float) -> FloatArray:
    """Return the (n - 1,) greatest v^2 between the moves, as Klipper has it.

    A corner of 90 degrees is passed at ``corner_speed``; the circle of no corner reaches beyond
    the middle of its moves.

    Parameters
    ----------
    moves
        n moves.
    plane
        (axes,) 1 for X, Y, Z, whose angle counts, 0 for others.
    corner_speed
        The square corner velocity.
    """
    before, after = moves.direction[:-1] * plane, moves.direction[1:] * plane
    cosine = -(before * after).sum(axis=1)
    half = np.sqrt(np.maximum(0.5 * (1.0 - cosine), 0.0))
    other = np.sqrt(np.maximum(0.5 * (1.0 + cosine), 0.0))
    bends = (half < 1.0) & (other > 0.0)
    safe_half, safe_other = np.where(bends, half, 0.0), np.where(bends, other, 1.0)
    # The deviation of a circle that passes 90 degrees at that speed is v^2 (sqrt 2 - 1) / a: the
    # acceleration of the move falls out where it is that of all moves, and counts where it is less.
    radius = safe_half / (1.0 - safe_half) * (np.sqrt(2.0) - 1.0) * corner_speed**2
    ratio = moves.acceleration / moves.most_acceleration
    square = radius * np.minimum(ratio[1:], ratio[:-1])
    gain = 2.0 * moves.acceleration * moves.length
    square = np.minimum(square, 0.25 * safe_half / safe_other * np.minimum(gain[1:], gain[:-1]))
    return np.asarray(np.where(bends, square, np.inf))
