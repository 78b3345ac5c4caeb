"""Moves of LinuxCNC as its planner runs them: lines, arcs in their corners, and how each ends.

An arc swallows what is left of the move before it, if that takes less than four servo cycles, and
begins with that piece of line (``corner_choice`` names the sources).
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit
from threadline.trajectory.firmware.corner_choice import (
    ACROSS,
    ALONG,
    BENDS,
    CYCLE_S,
    GOES_ON,
    OVERLAPS,
    STOPS,
    corner,
)

_GAP = 4  # cycles: [TRAJ]ARC_BLEND_GAP_CYCLES
_LEAST = 1.02  # cycles of a piece that is settled


class Links(NamedTuple):
    """Pieces of moves.

    Parameters
    ----------
    move
        (m,) the move that a piece is of, or that is before the arc of a corner.
    radius, turn, lead
        (m,) of a corner's arc, 0 of others: also its angle, and the line that it begins with.
    begin, extent
        (m,) where on its move it begins, of an arc the line in front of it; its length.
    most, speed, rate
        (m,) greatest speed; that is asked for, too; its acceleration along the way.
    limit
        (m,) greatest speed at its end.
    ends
        (m,) how it ends.
    first
        (n,) the piece that begins with each move.
    cut, takes, over
        (n,) what the corner before each move takes from its length and from its acceleration;
        whether the move overlaps the one before.
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


@njit()
def _along(most, rate, bow):
    """Return greatest speed and acceleration, with what an arc needs across it taken off."""
    if bow == 0.0:
        return most, rate
    across = most * most / bow
    if across > ACROSS * rate:
        return np.sqrt(ACROSS * rate * bow), ALONG * rate
    return most, rate * np.sqrt(1.0 - (across / rate) ** 2)


@njit()
def link(
    length, fastest, asked, acceleration, apart, plain, back, turns, theta, cosine, plane_rate,
    plane_speed, side, side_2, bow, tolerance, exact, cut, takes, over,
):  # fmt: skip
    """Return the columns of ``Links`` for n moves.

    Parameters
    ----------
    length, fastest, asked, acceleration : (n,)
        Of the moves: mm or degrees; speed that their axes allow; speed that is asked for.
    apart, plain, back : (n - 1,) bool
        Of the corners: a rapid move and one at a feed meet; X, Y and Z alone move before and
        after; the way goes back.
    turns, theta, cosine, plane_rate, plane_speed, side, side_2 : (n - 1,)
        As in ``corner``.
    bow : (n,)
        Radius of each move, 0 of a line.
    tolerance : float
        P of G64, 0 for none.
    exact : bool
        Whether G61 is in force.
    cut, takes : float
        What the corner before the first move took from its length and its acceleration.
    over : int
        Whether the first move overlaps the one before.
    """
    count = len(length)
    whole, real = np.zeros((2, 2 * count), np.int64), np.zeros((9, 2 * count))
    move, ends = whole[0], whole[1]
    radius, turn, lead, begin, extent = real[0], real[1], real[2], real[3], real[4]
    most, speed, rate, limit = real[5], real[6], real[7], real[8]
    first, overs = np.zeros(count, np.int64), np.zeros(count, np.int64)
    cuts, taken = np.zeros(count), np.zeros(count)
    usual = STOPS if exact else OVERLAPS
    able = np.minimum(fastest, (length - np.where(np.arange(count) == 0, cut, 0.0)) / CYCLE_S)
    last = 0
    for i in range(count):
        if i > 0:
            k, p = i - 1, last
            way, top, takes, bend, distance, cut, angle = usual, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            if apart[k] or (plain[k] and back[k]):
                way = STOPS
            elif plain[k]:
                way, top, takes, bend, distance, cut, angle = corner(
                    extent[p], length[k], able[k], asked[k], acceleration[k], taken[k],
                    length[i], able[i], asked[i], acceleration[i], turns[k], theta[k], cosine[k],
                    plane_rate[k], plane_speed[k], bow[k], side[k], bow[i], side_2[k],
                    tolerance, exact,
                )  # fmt: skip
            # After moves in which a rotary axis turns it does not count.
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
        half = 0.5 if over or not exact else 1.0
        rate[last] = acceleration[i] * (1.0 - takes) * half * (ALONG if bow[i] > 0.0 else 1.0)
        radius[last], turn[last], lead[last] = 0.0, 0.0, 0.0
    m = last + 1
    most[:last] = np.minimum(most[:last], extent[:last] / (_LEAST * CYCLE_S))
    speed[:m] = np.minimum(speed[:m], most[:m])
    return (
        move[:m], radius[:m], turn[:m], lead[:m], begin[:m], extent[:m], most[:m], speed[:m],
        rate[:m], limit[:m], ends[:m], first, cuts, taken, overs,
    )  # fmt: skip
