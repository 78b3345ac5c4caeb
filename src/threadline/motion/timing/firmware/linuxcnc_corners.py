"""Corners of LinuxCNC: the arcs that it inserts, and the speeds at which moves meet.

An arc is first fitted between two lines: the moves themselves, or secants in place of arcs of G2
and G3. Then it is shifted until it touches both moves. In the plane of the corner the first move
arrives at the origin along (1, 0), and the second leaves to the left.

Sources: LinuxCNC 2.9, its documents "Trajectory Control" and "G64 Path Blending", and the behaviour
of its ``tp.c`` and ``blendmath.c``, described here in other words.

A corner is taken in the fastest of three ways:
- straight on, at the speed at which the velocity jumps within a servo cycle by a tenth of the
  axes' limit;
- by an arc that touches both moves at a distance d from the corner, d at most half of either move
  and at most cos(theta) P / (1 - sin(theta)) for the tolerance P, with the angle 2 theta between
  the moves. Its radius is d tan(theta) at most, and v^2 / r is at most sqrt(3)/2 of the
  acceleration;
- by overlapping both moves, each with half of its acceleration, so that the speed counts half.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit

_LEAST = np.pi / 12.0  # smallest theta between two arcs


class Corners(NamedTuple):
    """Geometry that LinuxCNC measures at the c corners of moves, all (c,).

    Parameters
    ----------
    apart, plain, back
        Whether a rapid move meets a move at a feed; only X, Y and Z move before and after; the path
        reverses.
    turns
        Largest change of direction of an axis, divided by its acceleration.
    theta, cosine
        Half of the angle between the moves, and its cosine.
    plane_rate, plane_speed
        Acceleration and speed that the axes reach in the plane of the corner in every direction.
    side, side_2
        1 if the first, or the second, move bends the same way as the corner, else -1.
    """

    apart: NDArray[np.bool_]
    plain: NDArray[np.bool_]
    back: NDArray[np.bool_]
    turns: FloatArray
    theta: FloatArray
    cosine: FloatArray
    plane_rate: FloatArray
    plane_speed: FloatArray
    side: FloatArray
    side_2: FloatArray


class Corner(NamedTuple):
    """The geometry of one corner; see ``Corners``."""

    turns: float
    theta: float
    cosine: float
    plane_rate: float
    plane_speed: float


class Arm(NamedTuple):
    """A move at a corner.

    Parameters
    ----------
    left, length
        Length from the corner that earlier corners have left, and programmed length.
    most, asked
        Speed limit of its axes, and programmed speed.
    rate
        Acceleration.
    bow, side
        Radius, 0 for a line; 1 if the move bends the same way as the corner, else -1.
    """

    left: float
    length: float
    most: float
    asked: float
    rate: float
    bow: float
    side: float


class Bow(NamedTuple):
    """A move that an arc of a corner touches: radius (0: a line), side, and available angle."""

    radius: float
    side: float
    angle: float


class Ramp(NamedTuple):
    """A move that overlaps another.

    Parameters
    ----------
    rate
        Acceleration.
    length, reach
        Length, and the part of it that counts for the reachable speed.
    speed
        Speed limit.
    """

    rate: float
    length: float
    reach: float
    speed: float


class Blending(NamedTuple):
    """How LinuxCNC joins moves: P of G64 (0: none), and whether G61 is in force."""

    tolerance: float
    exact: bool


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
        largest_angle = min(part * angle, theta)
        return np.sin(0.25 * largest_angle) * bow, largest_angle
    largest_angle = min(part * angle, 0.5 * np.pi)
    return largest_angle * bow, largest_angle


@njit()
def flattened(theta, first, second):
    """Return theta between the secants of two bows, 0 if there is no arc."""
    flat_theta = theta
    if first.radius > 0.0 and first.side > 0.0:
        flat_theta = min(flat_theta, theta - 0.25 * first.angle)
    if second.radius > 0.0 and second.side > 0.0:
        flat_theta = min(flat_theta, theta - 0.25 * second.angle)
    if first.radius > 0.0 and second.radius > 0.0 and flat_theta < _LEAST:
        return 0.0
    return flat_theta


@njit()
def leaning(theta, bow, side, rate, speed):
    """Return half of the angle between a move and the acceleration at the start of the next arc.

    The acceleration is ``rate`` along the arc, and centripetal at half of ``speed`` across it.
    """
    phi = np.pi - 2.0 * theta
    across = side * (0.5 * speed) ** 2 / bow
    x = rate * np.cos(phi) - across * np.sin(phi)
    return 0.5 * np.arccos(-x / np.hypot(rate, across))


@njit()
def touching(radius, theta, first, second, tolerance):
    """Return the lengths that an arc takes from both moves, and its own angle; 0 for no arc.

    Parameters
    ----------
    radius : float
        Radius of the arc.
    theta : float
        Half of the angle between the moves at the corner.
    first, second : Bow
        The moves.
    tolerance : float
        Permitted distance from the corner.
    """
    bow, side, most_angle = first
    bow_2, side_2, most_angle_2 = second
    phi = np.pi - 2.0 * theta
    u, n = np.array([np.cos(phi), np.sin(phi)]), np.array([-np.sin(phi), np.cos(phi)])
    centre_1, centre_2 = np.array([0.0, side * bow]), side_2 * bow_2 * n
    d1, d2 = bow - side * radius, bow_2 - side_2 * radius
    none = (0.0, 0.0, 0.0)
    if bow == 0.0 or bow_2 == 0.0:
        # The centre lies beside the line, at the distance d from the other move's centre.
        along, left = (u, n) if bow > 0.0 else (np.array([1.0, 0.0]), np.array([0.0, 1.0]))
        centre, centre_distance = (centre_1, d1) if bow > 0.0 else (centre_2, d2)
        c_u, c_n = (centre * along).sum(), (centre * left).sum()
        inside = centre_distance * centre_distance - (radius - c_n) ** 2
        if inside < 0.0:
            return none
        line_length = min(abs(-c_u + np.sqrt(inside)), abs(-c_u - np.sqrt(inside)))
        middle = radius * left + (line_length if bow > 0.0 else -line_length) * along
    else:
        centre_to_centre = centre_2 - centre_1
        distance = np.sqrt((centre_to_centre * centre_to_centre).sum())
        if distance == 0.0:
            return none
        c_x = (d1 * d1 - d2 * d2 + distance * distance) / (2.0 * distance)
        if d1 * d1 < c_x * c_x:
            return none
        c_y = np.sqrt(d1 * d1 - c_x * c_x)
        e = centre_to_centre / distance
        across = np.array([-e[1], e[0]])
        crossing_1 = centre_1 + c_x * e + c_y * across
        crossing_2 = centre_1 + c_x * e - c_y * across
        middle = (
            crossing_1
            if (crossing_1 * crossing_1).sum() <= (crossing_2 * crossing_2).sum()
            else crossing_2
        )
        line_length = 0.0
    if np.sqrt((middle * middle).sum()) - radius > tolerance:
        return none
    takes = line_length if bow == 0.0 else bow * _angle(-centre_1, middle - centre_1)
    takes_2 = line_length if bow_2 == 0.0 else bow_2 * _angle(-centre_2, middle - centre_2)
    if (bow > 0.0 and takes > most_angle * bow) or (bow_2 > 0.0 and takes_2 > most_angle_2 * bow_2):
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
def overlap(first, second, cosine, tolerance):
    """Return the speed at which a move lets the next one begin, and the next one's target speed.

    A move of length L and acceleration a with the speed limit v reaches r = min(v, sqrt(a L)).
    Both move together for at most t = min(L_1 / r_1, L_2 / r_2, max(r_1 / a_1, r_2 / a_2)). The
    overlap begins when the first has slowed to min(r_1, a_1 t); the second aims at min(r_2, a_2 t).
    With a tolerance P both are at most 2 sqrt(a_1 P / cos(theta)).

    Parameters
    ----------
    first, second : Ramp
        The moves; ``reach`` is the L that counts for r.
    cosine : float
        cos(theta).
    tolerance : float
        P, 0 for none.
    """
    rate, length, reach, speed = first
    rate_2, length_2, reach_2, speed_2 = second
    reached, reached_2 = min(speed, np.sqrt(rate * reach)), min(speed_2, np.sqrt(rate_2 * reach_2))
    overlap_s = min(length / reached, length_2 / reached_2, max(reached / rate, reached_2 / rate_2))
    leave, follow = min(reached, overlap_s * rate), min(reached_2, overlap_s * rate_2)
    if tolerance > 0.0 and cosine > _STRAIGHT:
        slow_speed = 2.0 * np.sqrt(rate * tolerance / cosine)
        leave, follow = min(leave, slow_speed), min(follow, slow_speed)
    return leave, follow


@njit()
def _arc(theta, at, first, second, room, tolerance):
    """Return radius, distance from the corner and speed limit of an arc; 0 for none.

    Parameters
    ----------
    theta : float
        Half of the angle between the moves, or between their secants.
    at : Corner
        The corner.
    first, second : Arm
        The moves.
    room : float
        Available length of the shorter move.
    tolerance : float
        Permitted distance from the corner.
    """
    rate, plane_speed, most, most_2 = at.plane_rate, at.plane_speed, first.most, second.most
    asked_1, asked_2 = min(first.asked, most), min(second.asked, most_2)
    if np.pi / 2.0 - theta < _TINY or theta < _TINY:
        return 0.0, 0.0, 0.0
    phi = np.pi - 2.0 * theta
    flat_cosine = np.cos(min(phi, 0.49 * np.pi))
    v1, v2 = min(most, most_2 / flat_cosine), min(most_2, most / flat_cosine)
    base = np.sqrt(v1 * v1 + v2 * v2 - 2.0 * v1 * v2 * np.cos(phi))
    speed_goal = plane_speed
    if first.bow == 0.0 and second.bow == 0.0:
        speed_goal = max(speed_goal, v1 * v2 * np.sin(phi) / base)
    speed_goal = min(max(asked_1, asked_2), speed_goal)
    distance = min(room, np.cos(theta) * tolerance / (1.0 - np.sin(theta)))
    widest_radius = np.tan(theta) * distance
    speed = min(np.sqrt(ACROSS * rate * widest_radius), speed_goal)
    # No wider than overlapping moves would need at this speed.
    overlap_s = min(np.sqrt(rate * distance), speed) / (0.5 * rate)
    radius = max(speed * speed / (ACROSS * rate), min(overlap_s * speed / phi, widest_radius))
    if radius < 1e-12 or radius * phi < _TINY:
        return 0.0, 0.0, 0.0
    return radius, radius / np.tan(theta), speed


@njit()
def corner(first, second, reduced, at, blending):
    """Return the transition from a move to the next, both of X, Y and Z only.

    Parameters
    ----------
    first, second : Arm
        The moves; nothing was taken from the second yet.
    reduced : float
        Share of the first move's acceleration that its first corner takes.
    at : Corner
        The corner.
    blending : Blending
        P of G64, or G61.

    Returns
    -------
    way : int
        ``STOPS`` after G61, ``OVERLAPS``, ``GOES_ON`` or ``BENDS``.
    limit, takes : float
        Speed limit there; share of both accelerations that it takes.
    radius, distance, distance_2, turn : float
        Radius of the arc, 0 for none; lengths that it takes from both moves; its angle.
    """
    left, length, most, asked, rate, bow, side = first
    _, length_2, most_2, asked_2, rate_2, bow_2, side_2 = second
    turns, theta, cosine = at.turns, at.theta, at.cosine
    tolerance, exact = blending
    speed_1, speed_2 = min(asked, most), min(asked_2, most_2)
    slower_speed = min(speed_1, speed_2)
    lines = bow == 0.0 and bow_2 == 0.0
    share = turns * (slower_speed / CYCLE_S + rate_2) / (1.0 if lines else ALONG)
    if share < _KINK:
        return GOES_ON, slower_speed, share, 0.0, 0.0, 0.0, 0.0
    if exact:
        return STOPS, 0.0, _KINK, 0.0, 0.0, 0.0, 0.0
    straight_speed = slower_speed * _KINK / share
    half_rate_2 = 0.5 * rate_2 * (1.0 - _KINK)
    if bow_2 > 0.0:
        theta_2 = leaning(theta, bow_2, side_2, half_rate_2, asked_2)
        cosine = np.cos(theta_2)
    else:
        theta_2 = theta
    # Each move may yet lose half of its length to its other corner.
    leaving = Ramp(
        0.5 * rate * (1.0 - max(reduced, _KINK)) * (1.0 if bow == 0.0 else ALONG),
        left,
        0.5 * left,
        speed_1,
    )
    following = Ramp(
        half_rate_2 * (1.0 if bow_2 == 0.0 else ALONG), length_2, 0.5 * length_2, speed_2
    )
    leave, follow = overlap(leaving, following, cosine, tolerance)
    overlap_speed = 0.25 * np.sin(theta_2) * (leave + follow)
    deviation_mm = _SHARE * min(length, length_2)
    if tolerance > 0.0:
        deviation_mm = min(deviation_mm, tolerance)
    room, part = min(left, 0.5 * length), 2.0 / 3.0
    room, angle = reach(bow, side, left / max(bow, _TINY), theta, part, room)
    room_2, angle_2 = reach(bow_2, side_2, length_2 / max(bow_2, _TINY), theta, 1.0 / 3.0,
                            0.5 * length_2)  # fmt: skip
    bent_1, bent_2 = Bow(bow, side, angle), Bow(bow_2, side_2, angle_2)
    flat = flattened(theta, bent_1, bent_2)
    radius, distance, arc_speed = _arc(flat, at, first, second, min(room, room_2), deviation_mm)
    distance_2, turn = distance, np.pi - 2.0 * theta
    if radius > 0.0 and not lines:
        distance, distance_2, turn = touching(radius, theta, bent_1, bent_2, deviation_mm)
    if radius > 0.0 and turn > 0.0 and arc_speed > max(overlap_speed, straight_speed):
        return BENDS, arc_speed, 0.0, radius, distance, distance_2, turn
    if overlap_speed >= straight_speed:
        return OVERLAPS, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    return GOES_ON, straight_speed, _KINK, 0.0, 0.0, 0.0, 0.0
