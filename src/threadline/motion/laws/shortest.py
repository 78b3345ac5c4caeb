"""The shortest move of one axis from rest to rest within velocity, acceleration and jerk."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, isfinite, sqrt

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.errors import OptionError


@dataclass(frozen=True, slots=True, kw_only=True)
class ShortestMove:
    """A symmetric move of seven phases of constant jerk.

    Parameters
    ----------
    distance_si
        Distance in m or rad, not negative.
    jerk_s, push_s, cruise_s
        Time of each of the four phases with jerk, of each of the two with constant acceleration,
        and of the phase with constant velocity; 0 for a phase that vanishes.
    velocity_si, acceleration_si
        Largest velocity and acceleration of the move.
    """

    distance_si: float
    jerk_s: float
    push_s: float
    cruise_s: float
    velocity_si: float
    acceleration_si: float

    @property
    def duration_s(self) -> float:
        """Duration of the move."""
        return 4.0 * self.jerk_s + 2.0 * self.push_s + self.cruise_s

    def __call__(self, time_s: FloatArray | float, order: int = 0) -> FloatArray:
        """Return (n,) the derivative of ``order`` 0 to 2 at (n,) times; at rest outside the move.

        Each phase is a polynomial that starts at the exact end of the previous phase.
        """
        t = np.atleast_1d(np.asarray(time_s, dtype=np.float64))
        jerk = self.acceleration_si / self.jerk_s if self.jerk_s > 0.0 else 0.0
        peak, ramp = self.acceleration_si, self.jerk_s
        phases = [  # length, acceleration at its start, jerk
            (ramp, 0.0, jerk), (self.push_s, peak, 0.0), (ramp, peak, -jerk),
            (self.cruise_s, 0.0, 0.0),
            (ramp, 0.0, -jerk), (self.push_s, -peak, 0.0), (ramp, -peak, jerk),
        ]  # fmt: skip
        values = np.zeros_like(t)
        begin, position, speed = 0.0, 0.0, 0.0
        for length, a, j in phases:
            inside = (t >= begin) & (t < begin + length)
            u = t[inside] - begin
            values[inside] = (
                position + u * (speed + u * (a / 2.0 + u * j / 6.0)),
                speed + u * (a + u * j / 2.0),
                a + u * j,
            )[order]
            position += length * (speed + length * (a / 2.0 + length * j / 6.0))
            speed += length * (a + length * j / 2.0)
            begin += length
        if order == 0:
            values[t >= begin] = self.distance_si
        return values


def shortest_move(
    distance_si: float, velocity_si: float, acceleration_si: float, jerk_si: float = inf
) -> ShortestMove:
    """Return the shortest move over a distance within limits of velocity, acceleration and jerk.

    A long move reaches all limits. A shorter move has no phase of constant velocity, and a still
    shorter move has no phase of constant acceleration. If the jerk limit is so low that a move
    reaches the velocity limit before the acceleration limit, no move reaches the acceleration
    limit. The formulas come from Biagiotti and Melchiorri, *Trajectory Planning for Automatic
    Machines and Robots* (2008), section 3.4.

    >>> round(shortest_move(1.0, 0.5, 2.0).duration_s, 12)
    2.25
    >>> round(shortest_move(1.0, 1.0, 5.0, 50.0).duration_s, 12)
    1.3
    >>> round(shortest_move(0.05, 1.0, 5.0, 50.0).duration_s, 5)
    0.31748

    Parameters
    ----------
    distance_si
        Distance in m or rad, not negative.
    velocity_si, acceleration_si, jerk_si
        Limits above 0; the jerk limit may be infinite.

    Raises
    ------
    OptionError
        If an argument is out of its range.
    """
    if not 0.0 <= distance_si < inf:
        raise OptionError(f"the distance of a move is {distance_si!r}; it must be 0 or more")
    for name, limit in (("velocity", velocity_si), ("acceleration", acceleration_si)):
        if not 0.0 < limit < inf:
            raise OptionError(f"the {name} of a move is {limit!r}; it must be above 0, and finite")
    if not jerk_si > 0.0:
        raise OptionError(f"the jerk of a move is {jerk_si!r}; it must be above 0")
    finite = isfinite(jerk_si)
    ramp = min(acceleration_si / jerk_si, sqrt(velocity_si / jerk_si)) if finite else 0.0
    peak = jerk_si * ramp if finite else acceleration_si
    push = max(velocity_si / peak - ramp, 0.0)
    top = velocity_si
    if top * (2.0 * ramp + push) > distance_si:
        # Without cruise, the phases of constant acceleration are shortened first, then those of
        # jerk.
        if finite and distance_si < 2.0 * jerk_si * ramp**3:
            ramp = (distance_si / (2.0 * jerk_si)) ** (1.0 / 3.0)
            peak, push = jerk_si * ramp, 0.0
        else:
            half_ramps = 1.5 * ramp
            push = sqrt((0.5 * ramp) ** 2 + distance_si / peak) - half_ramps
        top = peak * (ramp + push)
        cruise = 0.0
    else:
        cruise = distance_si / top - 2.0 * ramp - push
    return ShortestMove(
        distance_si=distance_si,
        jerk_s=ramp,
        push_s=max(push, 0.0),
        cruise_s=cruise,
        velocity_si=top,
        acceleration_si=peak,
    )
