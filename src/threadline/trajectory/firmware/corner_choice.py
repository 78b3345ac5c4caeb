"""How LinuxCNC takes a corner between two moves of X, Y and Z.

Sources: LinuxCNC 2.9, its documents "Trajectory Control" and "G64 Path Blending", and what its
``tp.c`` and ``blendmath.c`` do, told here in other words.

A corner is taken in that one of three ways which is fastest there:

- straight on, at the speed whose jump within a servo cycle is a tenth of what the axes may;
- by an arc that touches both moves at a distance d from the corner, d at most half of either move
  and at most cos(theta) P / (1 - sin(theta)) for the tolerance P, 2 theta being the angle between
  the moves. Its radius is d tan(theta) at most, and v^2 / r is at most sqrt(3)/2 of the
  acceleration;
- one move over the other, both with half of their acceleration, wherefore its speed counts half.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.compiled import njit
from threadline.trajectory.firmware.curved_corner import flattened, leaning, reach, touching

CYCLE_S = 1e-3
STOPS, OVERLAPS, GOES_ON, BENDS = 0, 1, 2, 3  # how a move ends
ALONG, ACROSS = 0.5, 0.75**0.5  # share of acceleration along an arc, and across it
_KINK = 0.1  # [TRAJ]ARC_BLEND_KINK_RATIO
_SHARE = 0.25  # of each move: the greatest tolerance
_TINY = 1e-6  # rad or mm: no arc
_STRAIGHT = 1e-3  # of cos(theta): no tolerance there


@njit()
def overlap(rate, length, reach, speed, rate_2, length_2, reach_2, speed_2, cosine, tolerance):
    """Return at which speed a move lets the next one begin, and which that makes for meanwhile.

    A move of length L and acceleration a that may be as fast as v reaches r = min(v, sqrt(a L)).
    Both move together for at most t = min(L_1 / r_1, L_2 / r_2, max(r_1 / a_1, r_2 / a_2)). It
    begins when the first is as slow as min(r_1, a_1 t), and the second makes for min(r_2, a_2 t).
    With a tolerance P both are at most 2 sqrt(a_1 P / cos(theta)).

    Parameters
    ----------
    rate, length, reach, speed : float
        Acceleration; length; as much of it as counts for r; greatest speed. Likewise of the next.
    cosine : float
        cos(theta).
    tolerance : float
        P, 0 for none.
    """
    here, there = min(speed, np.sqrt(rate * reach)), min(speed_2, np.sqrt(rate_2 * reach_2))
    lasts = min(length / here, length_2 / there, max(here / rate, there / rate_2))
    leave, follow = min(here, lasts * rate), min(there, lasts * rate_2)
    if tolerance > 0.0 and cosine > _STRAIGHT:
        slow = 2.0 * np.sqrt(rate * tolerance / cosine)
        leave, follow = min(leave, slow), min(follow, slow)
    return leave, follow


@njit()
def _arc(theta, rate, planar, here, there, most, most_2, room, tolerance, lines):
    """Return radius, distance from the corner and greatest speed of an arc; 0 for none.

    Parameters
    ----------
    theta : float
        Half of the angle between the moves.
    rate, planar : float
        Acceleration and speed that the axes have in its plane in every direction.
    here, there, most, most_2 : float
        Speeds of both moves as asked for, and as far as their axes allow.
    room : float
        Of the move that has less.
    tolerance : float
        How far the corner may be left.
    lines : bool
        Whether both moves are lines.
    """
    if np.pi / 2.0 - theta < _TINY or theta < _TINY:
        return 0.0, 0.0, 0.0
    phi = np.pi - 2.0 * theta
    flat = np.cos(min(phi, 0.49 * np.pi))
    v1, v2 = min(most, most_2 / flat), min(most_2, most / flat)
    base = np.sqrt(v1 * v1 + v2 * v2 - 2.0 * v1 * v2 * np.cos(phi))
    goal = planar
    if lines:
        goal = max(goal, v1 * v2 * np.sin(phi) / base)
    goal = min(max(here, there), goal)
    distance = min(room, np.cos(theta) * tolerance / (1.0 - np.sin(theta)))
    widest = np.tan(theta) * distance
    speed = min(np.sqrt(ACROSS * rate * widest), goal)
    # No wider than moves that overlap would need at this speed.
    lasts = min(np.sqrt(rate * distance), speed) / (0.5 * rate)
    radius = max(speed * speed / (ACROSS * rate), min(lasts * speed / phi, widest))
    if radius < 1e-12 or radius * phi < _TINY:
        return 0.0, 0.0, 0.0
    return radius, radius / np.tan(theta), speed


@njit()
def corner(
    left, length, most, asked, rate, reduced, length_2, most_2, asked_2, rate_2,
    turns, theta, cosine, plane_rate, plane_speed, bow, side, bow_2, side_2, tolerance, exact,
):  # fmt: skip
    """Return how a move goes over into the next, both of X, Y and Z alone.

    Parameters
    ----------
    left, length, most, asked, rate : float
        Of the first move: what is left of it, programmed length, speed that its axes allow, that
        is asked for, and acceleration; likewise of the next.
    reduced : float
        Share that its first corner takes from the acceleration of the first move.
    turns : float
        The greatest change of direction of an axis, by its acceleration.
    theta, cosine : float
        Half of the angle between them, and its cosine.
    plane_rate, plane_speed : float
        What the axes have in their plane in every direction.
    bow, side, bow_2, side_2 : float
        Radius of each, 0 of a line; 1 where it bends as the corner does, else -1.
    tolerance, exact
        P, 0 for none; whether G61 is in force.

    Returns
    -------
    way : int
        ``STOPS`` after G61, ``OVERLAPS``, ``GOES_ON`` or ``BENDS``.
    limit, takes : float
        Greatest speed there; share of both accelerations that is taken.
    radius, distance, distance_2, turn : float
        Of the arc, 0 for none: what it takes from both moves, and its angle.
    """
    here, there = min(asked, most), min(asked_2, most_2)
    slower = min(here, there)
    lines = bow == 0.0 and bow_2 == 0.0
    share = turns * (slower / CYCLE_S + rate_2) / (1.0 if lines else ALONG)
    if share < _KINK:
        return GOES_ON, slower, share, 0.0, 0.0, 0.0, 0.0
    if exact:
        return STOPS, 0.0, _KINK, 0.0, 0.0, 0.0, 0.0
    straight = slower * _KINK / share
    before = 0.5 * rate_2 * (1.0 - _KINK)
    if bow_2 > 0.0:
        theta_2 = leaning(theta, bow_2, side_2, before, asked_2)
        cosine = np.cos(theta_2)
    else:
        theta_2 = theta
    # Either may yet lose half of its length to its other corner.
    first, second = overlap(
        0.5 * rate * (1.0 - max(reduced, _KINK)) * (1.0 if bow == 0.0 else ALONG),
        left, 0.5 * left, here,
        before * (1.0 if bow_2 == 0.0 else ALONG),
        length_2, 0.5 * length_2, there, cosine, tolerance,
    )  # fmt: skip
    over = 0.25 * np.sin(theta_2) * (first + second)
    leaves = _SHARE * min(length, length_2)
    if tolerance > 0.0:
        leaves = min(leaves, tolerance)
    room, part = min(left, 0.5 * length), 2.0 / 3.0
    room, angle = reach(bow, side, left / max(bow, _TINY), theta, part, room)
    room_2, angle_2 = reach(bow_2, side_2, length_2 / max(bow_2, _TINY), theta, 1.0 / 3.0,
                            0.5 * length_2)  # fmt: skip
    flat = flattened(theta, bow, side, angle, bow_2, side_2, angle_2)
    radius, distance, bent = _arc(
        flat, plane_rate, plane_speed, here, there, most, most_2, min(room, room_2), leaves, lines
    )
    distance_2, turn = distance, np.pi - 2.0 * theta
    if radius > 0.0 and not lines:
        distance, distance_2, turn = touching(
            radius, theta, bow, side, angle, bow_2, side_2, angle_2, leaves
        )
    if radius > 0.0 and turn > 0.0 and bent > max(over, straight):
        return BENDS, bent, 0.0, radius, distance, distance_2, turn
    if over >= straight:
        return OVERLAPS, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    return GOES_ON, straight, _KINK, 0.0, 0.0, 0.0, 0.0
