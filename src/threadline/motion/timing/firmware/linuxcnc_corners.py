"""Corners of LinuxCNC: the arcs that it inserts, and the speeds at which moves meet.

An arc is found as between two lines, where the secant may stand for an arc of G2 or G3, and then
moved until it touches both moves. In the plane of the corner the first move arrives along (1, 0) at
the origin, and the second leaves to the left.

Sources: LinuxCNC 2.9, its documents "Trajectory Control" and "G64 Path Blending", and the behaviour
of its ``tp.c`` and ``blendmath.c``, described here in other words.

A corner is taken in the fastest of three ways:
- straight on, at the speed whose jump within a servo cycle is a tenth of the axes' limit;
- by an arc that touches both moves at a distance d from the corner, d at most half of either move
  and at most cos(theta) P / (1 - sin(theta)) for the tolerance P, with the angle 2 theta between
  the moves. Its radius is d tan(theta) at most, and v^2 / r is at most sqrt(3)/2 of the
  acceleration;
- by overlapping both moves, each with half of its acceleration, so that its speed counts half.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.base.compiled import njit

_LEAST = np.pi / 12.0  # smallest theta between two arcs


@njit()
def reach(bow, side, angle, theta, part, line):
    """Return how far a corner arc may reach into a move, as a length, and as an angle of its bow.

    Parameters
    ----------
    bow, side, angle : float
        Radius of the move, 0 for a line; 1 if it bends the same way as the corner, else -1; its
        angle.
    theta : float
        Half of the angle between the moves.
    part : float
        Share of the angle that is available.
    line : float
        Permitted reach into a line.
    """
    if bow == 0.0:
        return line, 0.0
    if side > 0.0:
        most = min(part * angle, theta)
        return np.sin(0.25 * most) * bow, most
    most = min(part * angle, 0.5 * np.pi)
    return most * bow, most


@njit()
def flattened(theta, bow, side, most, bow_2, side_2, most_2):
    """Return theta between the secants that stand for the moves, 0 if there is no arc."""
    found = theta
    if bow > 0.0 and side > 0.0:
        found = min(found, theta - 0.25 * most)
    if bow_2 > 0.0 and side_2 > 0.0:
        found = min(found, theta - 0.25 * most_2)
    if bow > 0.0 and bow_2 > 0.0 and found < _LEAST:
        return 0.0
    return found


@njit()
def leaning(theta, bow, side, rate, speed):
    """Return half of the angle between a move and the acceleration needed by the next one, an arc.

    It is ``rate`` along the arc, and across it the centripetal one at half of its ``speed``.
    """
    phi = np.pi - 2.0 * theta
    across = side * (0.5 * speed) ** 2 / bow
    x = rate * np.cos(phi) - across * np.sin(phi)
    return 0.5 * np.arccos(-x / np.hypot(rate, across))


@njit()
def touching(radius, theta, bow, side, most, bow_2, side_2, most_2, tolerance):
    """Return the lengths that an arc takes from both moves, and its own angle; 0 for no arc.

    Parameters
    ----------
    radius : float
        Radius of the arc.
    theta : float
        Half of the angle between the moves at the corner.
    bow, side, most : float
        As in ``reach``, where ``most`` is the available angle; likewise for the next move.
    tolerance : float
        Permitted distance from the corner.
    """
    phi = np.pi - 2.0 * theta
    u, n = np.array([np.cos(phi), np.sin(phi)]), np.array([-np.sin(phi), np.cos(phi)])
    first, second = np.array([0.0, side * bow]), side_2 * bow_2 * n
    d1, d2 = bow - side * radius, bow_2 - side_2 * radius
    none = (0.0, 0.0, 0.0)
    if bow == 0.0 or bow_2 == 0.0:
        # The centre lies beside the line, at the distance d from the other move's centre.
        along, left = (u, n) if bow > 0.0 else (np.array([1.0, 0.0]), np.array([0.0, 1.0]))
        centre, away = (first, d1) if bow > 0.0 else (second, d2)
        c_u, c_n = (centre * along).sum(), (centre * left).sum()
        inside = away * away - (radius - c_n) ** 2
        if inside < 0.0:
            return none
        way = min(abs(-c_u + np.sqrt(inside)), abs(-c_u - np.sqrt(inside)))
        middle = radius * left + (way if bow > 0.0 else -way) * along
    else:
        between = second - first
        apart = np.sqrt((between * between).sum())
        if apart == 0.0:
            return none
        c_x = (d1 * d1 - d2 * d2 + apart * apart) / (2.0 * apart)
        if d1 * d1 < c_x * c_x:
            return none
        c_y = np.sqrt(d1 * d1 - c_x * c_x)
        e = between / apart
        across = np.array([-e[1], e[0]])
        one, other = first + c_x * e + c_y * across, first + c_x * e - c_y * across
        middle = one if (one * one).sum() <= (other * other).sum() else other
        way = 0.0
    if np.sqrt((middle * middle).sum()) - radius > tolerance:
        return none
    takes = way if bow == 0.0 else bow * _angle(-first, middle - first)
    takes_2 = way if bow_2 == 0.0 else bow_2 * _angle(-second, middle - second)
    if (bow > 0.0 and takes > most * bow) or (bow_2 > 0.0 and takes_2 > most_2 * bow_2):
        return none
    turn = phi + (side * takes / bow if bow > 0.0 else 0.0)
    turn += side_2 * takes_2 / bow_2 if bow_2 > 0.0 else 0.0
    return takes, takes_2, max(turn, 0.0)


@njit()
def _angle(a, b):
    """Return the angle between two vectors of the plane."""
    return abs(np.arctan2(a[0] * b[1] - a[1] * b[0], (a * b).sum()))


CYCLE_S = 1e-3
STOPS, OVERLAPS, GOES_ON, BENDS = 0, 1, 2, 3  # how a move ends
ALONG, ACROSS = 0.5, 0.75**0.5  # share of acceleration along an arc, and across it
_KINK = 0.1  # [TRAJ]ARC_BLEND_KINK_RATIO
_SHARE = 0.25  # of each move: the largest tolerance
_TINY = 1e-6  # rad or mm: no arc
_STRAIGHT = 1e-3  # of cos(theta): no tolerance below


@njit()
def overlap(rate, length, reach, speed, rate_2, length_2, reach_2, speed_2, cosine, tolerance):
    """Return the speed at which a move lets the next one begin, and the next one's target speed.

    A move of length L and acceleration a with the speed limit v reaches r = min(v, sqrt(a L)).
    Both move together for at most t = min(L_1 / r_1, L_2 / r_2, max(r_1 / a_1, r_2 / a_2)). The
    overlap begins when the first has slowed to min(r_1, a_1 t); the second aims at min(r_2, a_2 t).
    With a tolerance P both are at most 2 sqrt(a_1 P / cos(theta)).

    Parameters
    ----------
    rate, length, reach, speed : float
        Acceleration; length; the part of it that counts for r; speed limit. Likewise for the next.
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
    """Return radius, distance from the corner and speed limit of an arc; 0 for none.

    Parameters
    ----------
    theta : float
        Half of the angle between the moves.
    rate, planar : float
        Acceleration and speed that the axes have in its plane in every direction.
    here, there, most, most_2 : float
        Programmed speeds of both moves, and the speed limits of their axes.
    room : float
        Available length of the shorter move.
    tolerance : float
        Permitted distance from the corner.
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
    # No wider than overlapping moves would need at this speed.
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
    """Return the transition from a move to the next, both of X, Y and Z only.

    Parameters
    ----------
    left, length, most, asked, rate : float
        First move: remaining length, programmed length, speed limit of its axes, programmed speed,
        and acceleration; likewise for the next.
    reduced : float
        Share of the first move's acceleration that its first corner takes.
    turns : float
        Largest change of direction of an axis, divided by its acceleration.
    theta, cosine : float
        Half of the angle between them, and its cosine.
    plane_rate, plane_speed : float
        Acceleration and speed of the axes in their plane in every direction.
    bow, side, bow_2, side_2 : float
        Radius of each, 0 for a line; 1 if it bends the same way as the corner, else -1.
    tolerance, exact
        P, 0 for none; whether G61 is in force.

    Returns
    -------
    way : int
        ``STOPS`` after G61, ``OVERLAPS``, ``GOES_ON`` or ``BENDS``.
    limit, takes : float
        Speed limit there; share of both accelerations that it takes.
    radius, distance, distance_2, turn : float
        Radius of the arc, 0 for none; lengths that it takes from both moves; its angle.
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
