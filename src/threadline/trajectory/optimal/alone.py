"""A run that is one straight line: its fastest motion is known in closed form."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from threadline.arrays import FloatArray
from threadline.laws import ShortestMove, shortest_move
from threadline.trajectory.optimal.motion_limits import Limits
from threadline.trajectory.types import TrajectoryBlock


def line_alone(
    c: FloatArray, nominal_s: float, operation: int, limits: Limits, begin_s: float
) -> TrajectoryBlock | None:
    """Return the fastest motion from rest to rest along a straight piece.

    None where a drive could bind before the limits of the axes do, or where axes brake otherwise
    than they speed up: then there is no closed form.

    Parameters
    ----------
    c
        (order, axes) of the piece.
    nominal_s
        Least time of the piece at an even speed, 0 for none.
    """
    way = np.abs(c[1])
    with np.errstate(divide="ignore", over="ignore"):
        velocity = float((limits.velocity / way).min())
        acceleration = float((limits.acceleration / way).min())
        jerk = float((limits.jerk / way).min())
    if limits.deceleration is not None:
        return None
    if limits.along is not None:
        if limits.along.sides[0] != limits.along.sides[1]:
            return None
        length = float(np.linalg.norm(way * limits.along.radius_m))
        velocity = min(velocity, limits.along.velocity / length)
        acceleration = min(acceleration, limits.along.acceleration / length)
        jerk = min(jerk, limits.along.jerk / length)
    if nominal_s > 0.0:
        velocity = min(velocity, 1.0 / nominal_s)
    rates = np.array([velocity, acceleration])
    if len(limits.demand) and (limits.demand @ rates * way > 1.0).any():
        return None
    duration_s, place = _phases(shortest_move(1.0, velocity, acceleration, jerk))
    coefficients = np.zeros((len(place), 4, len(way)))
    coefficients[:, 0] = c[0]
    coefficients += place[:, :, None] * c[1]
    return TrajectoryBlock(
        start_s=begin_s + np.concatenate([[0.0], np.cumsum(duration_s)[:-1]]),
        duration_s=duration_s,
        coefficients=coefficients,
        operation=np.full(len(place), operation),
    )


def _phases(move: ShortestMove) -> tuple[FloatArray, FloatArray]:
    """Return the (n,) durations of the phases and (n, 4) places on them in powers of u."""
    top, peak = move.velocity_si, move.acceleration_si
    gained = 0.5 * peak * move.jerk_s
    # Duration, and the velocity and acceleration at the beginning of each phase.
    begun = [
        (move.jerk_s, 0.0, 0.0),
        (move.push_s, gained, peak),
        (move.jerk_s, top - gained, peak),
        (move.cruise_s, top, 0.0),
        (move.jerk_s, top, 0.0),
        (move.push_s, top - gained, -peak),
        (move.jerk_s, gained, -peak),
        (0.0, 0.0, 0.0),
    ]
    rows, at = [], 0.0
    for k, ((lasts_s, velocity, acceleration), (_, _, then)) in enumerate(pairwise(begun)):
        if not lasts_s > 0.0:
            continue
        bent = 0.0 if k in (1, 3, 5) else (then - acceleration) * lasts_s**2 / 6.0
        rows.append([at, velocity * lasts_s, 0.5 * acceleration * lasts_s**2, bent])
        at = sum(rows[-1])
    return np.array([lasts_s for lasts_s, _, _ in begun if lasts_s > 0.0]), np.array(rows)
