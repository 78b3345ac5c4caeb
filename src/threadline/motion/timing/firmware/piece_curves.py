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
    transition
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
    transition: IntArray
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
    (
        feed_meets_rapid,
        only_xyz,
        reverses,
        turns,
        theta,
        cosine,
        plane_rate,
        plane_speed,
        side,
        side_2,
    ) = corners
    count = len(length)
    real = np.zeros((9, 2 * count))
    move, transition = np.zeros(2 * count, np.int64), np.zeros(2 * count, np.int64)
    radius, turn, lead, begin, extent = real[0], real[1], real[2], real[3], real[4]
    most, speed, rate, limit = real[5], real[6], real[7], real[8]
    first, overs = np.zeros(count, np.int64), np.zeros(count, np.int64)
    cuts, shares_taken = np.zeros(count), np.zeros(count)
    usual_end = STOPS if blending.exact else OVERLAPS
    reachable = np.minimum(fastest, (length - np.where(np.arange(count) == 0, cut, 0.0)) / CYCLE_S)
    last_piece = 0
    for i in range(count):
        if i > 0:
            before, piece = i - 1, last_piece
            way, top, takes, bend, distance, cut, angle = usual_end, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            if feed_meets_rapid[before] or (only_xyz[before] and reverses[before]):
                way = STOPS
            elif only_xyz[before]:
                first_arm = Arm(
                    extent[piece],
                    length[before],
                    reachable[before],
                    asked[before],
                    acceleration[before],
                    bow[before],
                    side[before],
                )
                second_arm = Arm(
                    length[i],
                    length[i],
                    reachable[i],
                    asked[i],
                    acceleration[i],
                    bow[i],
                    side_2[before],
                )
                way, top, takes, bend, distance, cut, angle = corner(
                    first_arm,
                    second_arm,
                    shares_taken[before],
                    Corner(
                        turns[before],
                        theta[before],
                        cosine[before],
                        plane_rate[before],
                        plane_speed[before],
                    ),
                    blending,
                )
            # An overlap with a move in which a rotary axis turns does not count.
            over = 1 if way == OVERLAPS and only_xyz[before] else 0
            length_left = extent[piece] - distance
            swallows = way == BENDS and length_left < _GAP * CYCLE_S * top
            swallows = swallows and not overs[before] and bow[before] == 0.0
            if not swallows:
                extent[piece], transition[piece], speed[piece] = (
                    length_left,
                    GOES_ON if way == BENDS else way,
                    asked[before],
                )
                half_factor = 0.5 if overs[before] or way == OVERLAPS else 1.0
                most[piece], rate[piece] = _along(
                    min(reachable[before], length_left / CYCLE_S),
                    acceleration[before] * (1.0 - max(shares_taken[before], takes)) * half_factor,
                    bow[before],
                )
                limit[piece] = top if way == GOES_ON else np.inf
                last_piece += 1
            if way == BENDS:
                begin[last_piece] = begin[piece] + (0.0 if swallows else length_left)
                move[last_piece], transition[last_piece], radius[last_piece], turn[last_piece] = (
                    before,
                    GOES_ON,
                    bend,
                    angle,
                )
                lead[last_piece] = length_left if swallows else 0.0
                extent[last_piece] = bend * angle + lead[last_piece]
                most[last_piece] = min(top, extent[last_piece] / CYCLE_S)
                speed[last_piece] = max(
                    min(asked[before], reachable[before]), min(asked[i], reachable[i])
                )
                rate[last_piece], limit[last_piece] = ALONG * plane_rate[before], np.inf
                last_piece += 1
        cuts[i], shares_taken[i], overs[i], first[i] = cut, takes, over, last_piece
        move[last_piece], begin[last_piece], extent[last_piece], transition[last_piece] = (
            i,
            cut,
            length[i] - cut,
            usual_end,
        )
        most[last_piece], speed[last_piece], limit[last_piece] = reachable[i], asked[i], np.inf
        half_factor = 0.5 if over or not blending.exact else 1.0
        rate[last_piece] = (
            acceleration[i] * (1.0 - takes) * half_factor * (ALONG if bow[i] > 0.0 else 1.0)
        )
        radius[last_piece], turn[last_piece], lead[last_piece] = 0.0, 0.0, 0.0
    m = last_piece + 1
    most[:last_piece] = np.minimum(most[:last_piece], extent[:last_piece] / (_LEAST * CYCLE_S))
    speed[:m] = np.minimum(speed[:m], most[:m])
    return Links(
        move[:m], radius[:m], turn[:m], lead[:m], begin[:m], extent[:m], most[:m], speed[:m],
        rate[:m], limit[:m], transition[:m], first, cuts, shares_taken, overs,
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
        arc_length = np.where(radius > 0.0, np.maximum(place - lead, 0.0), 0.0)
        angle = (arc_length / np.where(radius > 0.0, radius, 1.0))[:, None]
        ahead, aside = self.ahead[piece], self.aside[piece]
        straight = (place - arc_length)[:, None] * ahead
        arc_part = radius[:, None] * (np.sin(angle) * ahead + (1.0 - np.cos(angle)) * aside)
        drift = self.drift[piece]
        return (
            self.origin[piece] + straight + arc_part + place[:, None] * drift,
            np.cos(angle) * ahead + np.sin(angle) * aside + drift,
        )


def _curves(links: Links, moves: Course) -> _Curves:
    """Return the pieces as curves."""
    move_of_piece = links.move
    bow = moves.bow[move_of_piece]
    first, inward = moves.along[move_of_piece], moves.inward[move_of_piece]
    angle = (links.begin / np.where(bow > 0.0, bow, 1.0) * (bow > 0.0))[:, None]
    straight = np.where(bow > 0.0, 0.0, links.begin)[:, None]
    origin = moves.start[move_of_piece] + straight * first
    origin += bow[:, None] * (np.sin(angle) * first + (1.0 - np.cos(angle)) * inward)
    ahead = np.cos(angle) * first + np.sin(angle) * inward
    aside = np.cos(angle) * inward - np.sin(angle) * first
    corner = np.flatnonzero(links.radius > 0.0)
    if len(corner):
        # In the plane of the corner, across the direction in which the first move arrives.
        arriving, leaving = (
            moves.onward[move_of_piece[corner]],
            moves.along[move_of_piece[corner] + 1],
        )
        across = leaving - (leaving * arriving).sum(axis=1)[:, None] * arriving
        across /= np.linalg.norm(across, axis=1)[:, None]
        ahead_at_corner = ahead[corner]
        along_share, across_share = (
            (ahead_at_corner * arriving).sum(axis=1)[:, None],
            (ahead_at_corner * across).sum(axis=1)[:, None],
        )
        aside[corner] = along_share * across - across_share * arriving
    radius = np.where(links.radius > 0.0, links.radius, bow)
    curves = _Curves(origin, ahead, aside, radius, links.lead, np.zeros_like(origin))
    # Rounded programs leave an arc a little beside the next move.
    arcs = np.flatnonzero(radius > 0.0)
    next_starts = np.vstack(
        [origin[1:], moves.start[move_of_piece[-1:]] + moves.way[move_of_piece[-1:]]]
    )
    gaps = next_starts[arcs] - curves.at(arcs, links.extent[arcs])[0]
    curves.drift[arcs] = gaps / links.extent[arcs, None]
    return curves


def polynomials(links: Links, moves: Course, piece: IntArray, row: FloatArray) -> FloatArray:
    """Return (r, order, axes) coefficients of rows of ``motion``, in mm and degrees.

    The polynomials are exact along lines, and match position and speed of an arc at both ends.
    """
    curves = _curves(links, moves)
    overlapping = np.flatnonzero(row[:, 4:].any(axis=1))
    parts = [_of_rows(curves, piece, row[:, 0], row[:, 1:4])]
    if len(overlapping):
        next_piece = piece[overlapping] + 1
        parts.append(_of_rows(curves, next_piece, row[overlapping, 0], row[overlapping, 4:]))
        parts[1][:, 0] -= curves.origin[next_piece]
    order = max(part.shape[1] for part in parts)
    coefficients = np.zeros((len(row), order, moves.start.shape[1]))
    coefficients[:, : parts[0].shape[1]] = parts[0]
    if len(overlapping):
        coefficients[overlapping, : parts[1].shape[1]] += parts[1]
    return coefficients


def _of_rows(
    curves: _Curves, piece: IntArray, time_s: FloatArray, motion: FloatArray
) -> FloatArray:
    """Return (r, order, axes) coefficients along pieces.

    ``motion`` (r, 3) is place, speed and its change.
    """
    place, speed, change = motion.T
    stop = place + speed * time_s + 0.5 * change * time_s**2
    point, direction = curves.at(piece, place)
    on_arc = (curves.radius[piece] > 0.0) & (stop > curves.lead[piece] + _NEAR)
    coefficients = np.zeros((len(piece), 4 if on_arc.any() else 3, point.shape[1]))
    coefficients[:, 0] = point
    coefficients[:, 1] = direction * (speed * time_s)[:, None]
    coefficients[:, 2] = direction * (0.5 * change * time_s**2)[:, None]
    if on_arc.any():
        end, end_rate = curves.at(piece[on_arc], stop[on_arc])
        start_rate = coefficients[on_arc, 1]
        end_rate = end_rate * ((speed + change * time_s) * time_s)[on_arc][:, None]
        rise = end - point[on_arc]
        coefficients[on_arc, 2] = 3.0 * rise - 2.0 * start_rate - end_rate
        coefficients[on_arc, 3] = start_rate + end_rate - 2.0 * rise
    return coefficients
