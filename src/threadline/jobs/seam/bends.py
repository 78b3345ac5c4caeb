"""Stitches that are shorter where the drawn line bends, so that they stay close to it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.drawing.arclength import ArcTable
from threadline.jobs.seam.legs import Leg
from threadline.jobs.seam.settings import Accelerations, Stitching

_PARTS = 8  # samples of the line in the length of the least stitch
_FEWEST, _MOST = 64, 2_000_000
_GROWTH = 1.08
_SHARE = 0.5  # share of the tolerance by which all stitches of a leg may be longer than planned


def bow_m(arc_m: FloatArray, chord_m: FloatArray) -> FloatArray:
    """Return the largest distance from its chord that a curve of length ``arc_m`` can have.

    The farthest points of all curves of that length between the ends lie on the ellipse with the
    ends as its foci. For an arc of a circle the result is 15 % more than its rise.
    """
    return np.asarray(0.5 * np.sqrt(np.maximum(arc_m - chord_m, 0.0) * (arc_m + chord_m)))


def bent_stitches(
    table: ArcTable,
    leg: Leg,
    closed: bool,
    settings: Stitching,
    accelerations: Accelerations,
    rests: tuple[bool, bool],
) -> FloatArray:
    """Return (n + 1,) lengths along the contour at which the stitches of a bent leg begin and end.

    Parameters
    ----------
    table, leg, closed
        The contour, the leg of it, and whether the contour is closed.
    settings, accelerations
        Stitching, and accelerations of the head.
    rests
        Whether the head rests at the beginning, and at the end; for a needle of constant speed.

    Notes
    -----
    For each place of the leg the longest stitch around it is found that is not longer than wanted
    and out of which the line does not bow more than the settings allow; it is at least the least
    stitch. That length times the needle's speed is a speed of the head, which is then reduced until
    it changes no faster than the accelerations. The stitches are the distances that the head covers
    in each turn of the needle. Last, they are scaled so that their number is whole; they grow by at
    most half of the tolerance.
    """
    whole = leg.length_m
    spacing = settings.least_m / _PARTS
    parts = math.ceil(min(max(whole / spacing, _FEWEST), _MOST))
    s = np.linspace(0.0, whole, parts + 1)
    points = leg_points(table, leg, closed, s)
    longest = _longest(points, whole / parts, settings)
    if settings.needle == "constant":
        longest = _reached(longest, s, settings, accelerations, rests)
    turns = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / (longest[:-1] + longest[1:]))])
    count = max(1, math.floor(turns[-1]))
    if turns[-1] > count * (1.0 + _SHARE * settings.tolerance):
        count += 1
    at = np.interp(np.arange(count + 1) * (turns[-1] / count), turns, np.arange(parts + 1))
    k = np.minimum(at.astype(np.int64), parts - 1)
    # Between two places the speed changes evenly with time, not with length.
    turn = (at - k) * (turns[k + 1] - turns[k])
    gain = (longest[k + 1] - longest[k]) / (turns[k + 1] - turns[k])
    covered = s[k] + longest[k] * turn + 0.5 * gain * turn**2
    covered[0], covered[-1] = 0.0, whole
    sign = 1.0 if leg.end_m >= leg.begin_m else -1.0
    at_m = leg.begin_m + sign * covered
    at_m[-1] = leg.end_m
    return np.asarray(at_m)


def leg_points(table: ArcTable, leg: Leg, closed: bool, s: FloatArray) -> FloatArray:
    """Return the (n, 2) points at lengths ``s`` from the beginning of a leg."""
    at_m = leg.begin_m + (s if leg.end_m >= leg.begin_m else -s)
    points: FloatArray = table.points(np.mod(at_m, table.length_m) if closed else at_m)
    return points


def _longest(points: FloatArray, step: float, settings: Stitching) -> FloatArray:
    """Return (n,) the longest stitch, along the line, about each point."""
    wanted, limit = settings.stitch_length_m, settings.bow_limit_m
    count = len(points)
    place = np.arange(count)
    found = np.full(count, wanted)
    going: NDArray[np.bool_] = np.ones(count, dtype=np.bool_)
    arc, chord, bow = (np.zeros(count) for _ in range(3))
    # The reach of a stitch grows in small steps, and between two of them values are interpolated
    # linearly, which gives shorter stitches rather than longer ones.
    reach, most = 0, math.ceil(math.hypot(wanted, 2.0 * limit) / (2.0 * step))
    while reach < most and going.any():
        reach = min(most, max(reach + 1, math.ceil(reach * _GROWTH)))
        first, last = np.maximum(place - reach, 0), np.minimum(place + reach, count - 1)
        arc_now = (last - first) * step
        chord_now = np.hypot(*(points[last] - points[first]).T)
        bow_now = bow_m(arc_now, chord_now)
        over = going & ((chord_now > wanted) | (bow_now > limit))
        share = np.ones(count)
        for value, now, bound in ((chord, chord_now, wanted), (bow, bow_now, limit)):
            rising = over & (now > bound)
            share[rising] = np.minimum(
                share[rising], (bound - value[rising]) / (now[rising] - value[rising])
            )
        found[over] = (arc + share * (arc_now - arc))[over]
        going &= ~over
        arc, chord, bow = arc_now, chord_now, bow_now
    return np.asarray(np.maximum(found, settings.least_m))


def _reached(
    longest: FloatArray,
    s: FloatArray,
    settings: Stitching,
    accelerations: Accelerations,
    rests: tuple[bool, bool],
) -> FloatArray:
    """Return ``longest``, reduced where the head could not change its speed in time."""
    up, down = (2.0 * a / settings.needle_speed_hz**2 for a in accelerations)
    squared = longest**2
    if rests[0]:
        squared[0] = 0.0
    if rests[1]:
        squared[-1] = 0.0
    squared = np.minimum.accumulate(squared - up * s) + up * s
    left = s[-1] - s
    squared = np.minimum.accumulate((squared - down * left)[::-1])[::-1] + down * left
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))
