"""Arcs that LinuxCNC puts into corners of which one side, or both, is an arc of G2 or G3.

Sources as in ``corner_choice``. The arc is found as between two lines, of which one may be the
secant of an arc, and then moved until it touches what is there. In the plane of the corner the
first move arrives along (1, 0) at the origin, and the second leaves to the left.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.compiled import njit

_LEAST = np.pi / 12.0  # of theta between two arcs


@njit()
def reach(bow, side, angle, theta, part, line):
    """Return how far an arc may reach into a move, as a length, and as an angle of its bow.

    Parameters
    ----------
    bow, side, angle : float
        Radius of the move, 0 of a line; 1 where it bends as the corner does, else -1; its angle.
    theta : float
        Half of the angle between the moves.
    part : float
        Share of the angle that there is for it.
    line : float
        How far into a line.
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
    """Return theta between what is taken for lines, 0 where there is no arc."""
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
    """Return half of the angle between a move and the acceleration that the next, an arc, needs.

    It is ``rate`` along the arc, and across it that of half of its ``speed``.
    """
    phi = np.pi - 2.0 * theta
    across = side * (0.5 * speed) ** 2 / bow
    x = rate * np.cos(phi) - across * np.sin(phi)
    return 0.5 * np.arccos(-x / np.hypot(rate, across))


@njit()
def touching(radius, theta, bow, side, most, bow_2, side_2, most_2, tolerance):
    """Return what an arc takes from both moves, and its own angle; an angle of 0 for none.

    Parameters
    ----------
    radius : float
        Of the arc.
    theta : float
        Half of the angle between the moves at the corner.
    bow, side, most : float
        As in ``reach``, where ``most`` is the angle that may be taken; likewise of the next move.
    tolerance : float
        How far the corner may be left.
    """
    phi = np.pi - 2.0 * theta
    u, n = np.array([np.cos(phi), np.sin(phi)]), np.array([-np.sin(phi), np.cos(phi)])
    first, second = np.array([0.0, side * bow]), side_2 * bow_2 * n
    d1, d2 = bow - side * radius, bow_2 - side_2 * radius
    none = (0.0, 0.0, 0.0)
    if bow == 0.0 or bow_2 == 0.0:
        # The centre lies beside the line, at the distance d from the centre of the other.
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
