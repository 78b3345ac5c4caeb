"""Moves of LinuxCNC as its planner runs them: lines, arcs in their corners, and how each ends.

If the rest of a move before an arc takes less than four servo cycles, the piece of the arc begins
with that rest, a line (``linuxcnc_corners`` names the sources).
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.motion.timing.firmware.linuxcnc_corners import (
    ACROSS,
    ALONG,
    BENDS,
    CYCLE_S,
    GOES_ON,
    OVERLAPS,
    STOPS,
    Arm,
    Corner,
    corner,
)
from threadline.motion.timing.firmware.linuxcnc_moves import Course

_GAP = 4  # cycles: [TRAJ]ARC_BLEND_GAP_CYCLES
_LEAST = 1.02  # cycles of a piece that is settled


class Links(NamedTuple):
    """The m pieces of n moves: lines, arcs, and arcs in corners.

    Parameters
    ----------
    move
        (m,) the move of each piece, or the move before the arc of a corner.
    radius, turn, lead
        (m,) radius of a corner's arc, 0 for other pieces; angle of the arc, and length of the line
        before it.
    begin, extent
        (m,) start of the piece on its move (for an arc, of the line before it), and its length.
    most, speed, rate
        (m,) speed limit; speed limit including the feed; acceleration along the path.
    limit
        (m,) speed limit at the end of the piece.
    ends
        (m,) how the piece ends, such as ``STOPS``.
    first
        (n,) the piece that begins with each move.
    cut, takes, over
        (n,) length and acceleration that the corner before each move takes from it; whether the
        move overlaps the previous one.
    """

    move: IntArray
    radius: FloatArray
    turn: FloatArray
    lead: FloatArray
    begin: FloatArray
    extent: FloatArray
    most: FloatArray
    speed: FloatArray
    rate: FloatArray
    limit: FloatArray
    ends: IntArray
    first: IntArray
    cut: FloatArray
    takes: FloatArray
    over: IntArray


class TimedMoves(NamedTuple):
    """The n moves that ``link`` joins, all (n,).

    Parameters
    ----------
    length
        Length, mm or degrees.
    fastest, asked
        Speed limit of the axes, and programmed speed.
    acceleration
        Acceleration along the move.
    bow
        Radius, 0 for a line.
    """

    length: FloatArray
    fastest: FloatArray
    asked: FloatArray
    acceleration: FloatArray
    bow: FloatArray


@njit()
def _along(most, rate, bow):
    """Return speed limit and acceleration along a move, less the centripetal part on an arc."""
    if bow == 0.0:
        return most, rate
    across = most * most / bow
    if across > ACROSS * rate:
        return np.sqrt(ACROSS * rate * bow), ALONG * rate
    return most, rate * np.sqrt(1.0 - (across / rate) ** 2)


@njit()
def link(moves, corners, blending, cut, takes, over):
    """Return the ``Links`` of n moves.

    Parameters
    ----------
    moves : TimedMoves
        The moves.
    corners : Corners
        Their n - 1 corners.
    blending : Blending
        P of G64, or G61.
    cut, takes : float
        Length and acceleration that the corner before the first move took from it.
    over : int
        Whether the first move overlaps the previous one.
    """
    length, fastest, asked, acceleration, bow = moves
    apart, plain, back, turns, theta, cosine, plane_rate, plane_speed, side, side_2 = corners
    count = len(length)
    real = np.zeros((9, 2 * count))
    move, ends = np.zeros(2 * count, np.int64), np.zeros(2 * count, np.int64)
    radius, turn, lead, begin, extent = real[0], real[1], real[2], real[3], real[4]
    most, speed, rate, limit = real[5], real[6], real[7], real[8]
    first, overs = np.zeros(count, np.int64), np.zeros(count, np.int64)
    cuts, taken = np.zeros(count), np.zeros(count)
    usual = STOPS if blending.exact else OVERLAPS
    able = np.minimum(fastest, (length - np.where(np.arange(count) == 0, cut, 0.0)) / CYCLE_S)
    last = 0
    for i in range(count):
        if i > 0:
            k, p = i - 1, last
            way, top, takes, bend, distance, cut, angle = usual, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            if apart[k] or (plain[k] and back[k]):
                way = STOPS
            elif plain[k]:
                first_arm = Arm(
                    extent[p], length[k], able[k], asked[k], acceleration[k], bow[k], side[k]
                )
                second_arm = Arm(
                    length[i], length[i], able[i], asked[i], acceleration[i], bow[i], side_2[k]
                )
                way, top, takes, bend, distance, cut, angle = corner(
                    first_arm,
                    second_arm,
                    taken[k],
                    Corner(turns[k], theta[k], cosine[k], plane_rate[k], plane_speed[k]),
                    blending,
                )
            # An overlap with a move in which a rotary axis turns does not count.
            over = 1 if way == OVERLAPS and plain[k] else 0
            rest = extent[p] - distance
            swallows = way == BENDS and rest < _GAP * CYCLE_S * top
            swallows = swallows and not overs[k] and bow[k] == 0.0
            if not swallows:
                extent[p], ends[p], speed[p] = rest, GOES_ON if way == BENDS else way, asked[k]
                half = 0.5 if overs[k] or way == OVERLAPS else 1.0
                most[p], rate[p] = _along(
                    min(able[k], rest / CYCLE_S),
                    acceleration[k] * (1.0 - max(taken[k], takes)) * half,
                    bow[k],
                )
                limit[p] = top if way == GOES_ON else np.inf
                last += 1
            if way == BENDS:
                begin[last] = begin[p] + (0.0 if swallows else rest)
                move[last], ends[last], radius[last], turn[last] = k, GOES_ON, bend, angle
                lead[last] = rest if swallows else 0.0
                extent[last] = bend * angle + lead[last]
                most[last] = min(top, extent[last] / CYCLE_S)
                speed[last] = max(min(asked[k], able[k]), min(asked[i], able[i]))
                rate[last], limit[last] = ALONG * plane_rate[k], np.inf
                last += 1
        cuts[i], taken[i], overs[i], first[i] = cut, takes, over, last
        move[last], begin[last], extent[last], ends[last] = i, cut, length[i] - cut, usual
        most[last], speed[last], limit[last] = able[i], asked[i], np.inf
        half = 0.5 if over or not blending.exact else 1.0
        rate[last] = acceleration[i] * (1.0 - takes) * half * (ALONG if bow[i] > 0.0 else 1.0)
        radius[last], turn[last], lead[last] = 0.0, 0.0, 0.0
    m = last + 1
    most[:last] = np.minimum(most[:last], extent[:last] / (_LEAST * CYCLE_S))
    speed[:m] = np.minimum(speed[:m], most[:m])
    return Links(
        move[:m], radius[:m], turn[:m], lead[:m], begin[:m], extent[:m], most[:m], speed[:m],
        rate[:m], limit[:m], ends[:m], first, cuts, taken, overs,
    )  # fmt: skip


_NEAR = 1e-9  # mm


class _Curves(NamedTuple):
    """(m,) pieces: a line of length ``lead`` from ``origin`` along ``ahead``, then an arc.

    The arc bends towards ``aside``; radius 0: the line continues. ``drift`` is added evenly.
    """

    origin: FloatArray
    ahead: FloatArray
    aside: FloatArray
    radius: FloatArray
    lead: FloatArray
    drift: FloatArray

    def at(self, piece: IntArray, place: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (r, axes) points and directions at (r,) distances along (r,) pieces."""
        radius, lead = self.radius[piece], self.lead[piece]
        over = np.where(radius > 0.0, np.maximum(place - lead, 0.0), 0.0)
        angle = (over / np.where(radius > 0.0, radius, 1.0))[:, None]
        ahead, aside = self.ahead[piece], self.aside[piece]
        straight = (place - over)[:, None] * ahead
        bent = radius[:, None] * (np.sin(angle) * ahead + (1.0 - np.cos(angle)) * aside)
        drift = self.drift[piece]
        return (
            self.origin[piece] + straight + bent + place[:, None] * drift,
            np.cos(angle) * ahead + np.sin(angle) * aside + drift,
        )


def _curves(links: Links, moves: Course) -> _Curves:
    """Return the pieces as curves."""
    of = links.move
    bow = moves.bow[of]
    first, inward = moves.along[of], moves.inward[of]
    angle = (links.begin / np.where(bow > 0.0, bow, 1.0) * (bow > 0.0))[:, None]
    straight = np.where(bow > 0.0, 0.0, links.begin)[:, None]
    origin = moves.start[of] + straight * first
    origin += bow[:, None] * (np.sin(angle) * first + (1.0 - np.cos(angle)) * inward)
    ahead = np.cos(angle) * first + np.sin(angle) * inward
    aside = np.cos(angle) * inward - np.sin(angle) * first
    corner = np.flatnonzero(links.radius > 0.0)
    if len(corner):
        # In the plane of the corner, across the direction in which the first move arrives.
        arrives, leaves = moves.onward[of[corner]], moves.along[of[corner] + 1]
        across = leaves - (leaves * arrives).sum(axis=1)[:, None] * arrives
        across /= np.linalg.norm(across, axis=1)[:, None]
        here = ahead[corner]
        along, left = (here * arrives).sum(axis=1)[:, None], (here * across).sum(axis=1)[:, None]
        aside[corner] = along * across - left * arrives
    radius = np.where(links.radius > 0.0, links.radius, bow)
    curves = _Curves(origin, ahead, aside, radius, links.lead, np.zeros_like(origin))
    # Rounded programs leave an arc a little beside the next move.
    arcs = np.flatnonzero(radius > 0.0)
    stop = np.vstack([origin[1:], moves.start[of[-1:]] + moves.way[of[-1:]]])
    gap = stop[arcs] - curves.at(arcs, links.extent[arcs])[0]
    curves.drift[arcs] = gap / links.extent[arcs, None]
    return curves


def polynomials(links: Links, moves: Course, piece: IntArray, row: FloatArray) -> FloatArray:
    """Return (r, order, axes) coefficients of rows of ``motion``, in mm and degrees.

    The polynomials are exact along lines, and match position and speed of an arc at both ends.
    """
    curves = _curves(links, moves)
    following = np.flatnonzero(row[:, 4:].any(axis=1))
    parts = [_of_rows(curves, piece, row[:, 0], row[:, 1:4])]
    if len(following):
        after = piece[following] + 1
        parts.append(_of_rows(curves, after, row[following, 0], row[following, 4:]))
        parts[1][:, 0] -= curves.origin[after]
    order = max(part.shape[1] for part in parts)
    found = np.zeros((len(row), order, moves.start.shape[1]))
    found[:, : parts[0].shape[1]] = parts[0]
    if len(following):
        found[following, : parts[1].shape[1]] += parts[1]
    return found


def _of_rows(
    curves: _Curves, piece: IntArray, time_s: FloatArray, motion: FloatArray
) -> FloatArray:
    """Return (r, order, axes) coefficients along pieces.

    ``motion`` (r, 3) is place, speed and its change.
    """
    place, speed, change = motion.T
    stop = place + speed * time_s + 0.5 * change * time_s**2
    point, direction = curves.at(piece, place)
    bent = (curves.radius[piece] > 0.0) & (stop > curves.lead[piece] + _NEAR)
    found = np.zeros((len(piece), 4 if bent.any() else 3, point.shape[1]))
    found[:, 0] = point
    found[:, 1] = direction * (speed * time_s)[:, None]
    found[:, 2] = direction * (0.5 * change * time_s**2)[:, None]
    if bent.any():
        end, last = curves.at(piece[bent], stop[bent])
        first = found[bent, 1]
        last = last * ((speed + change * time_s) * time_s)[bent][:, None]
        rise = end - point[bent]
        found[bent, 2] = 3.0 * rise - 2.0 * first - last
        found[bent, 3] = first + last - 2.0 * rise
    return found
