"""Places of the stitches: even lengths, and shorter stitches at bends of the drawn line."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray
from threadline.geometry.arclength import ArcTable
from threadline.jobs.seam.corners import Leg
from threadline.jobs.seam.settings import Accelerations, Stitching

_SAMPLES_PER_STITCH = 8  # samples of the line per least stitch
_FEWEST, _MOST = 64, 2_000_000
_GROWTH = 1.08
_TOLERANCE_SHARE = 0.5  # share of the tolerance by which all stitches of a leg may grow


def bow_m(arc_m: FloatArray, chord_m: FloatArray) -> FloatArray:
    """Return the largest possible distance of a curve of length ``arc_m`` from its chord.

    The farthest points of all curves of length ``arc_m`` between the ends lie on the ellipse with
    the ends as its foci. For an arc of a circle the result exceeds the rise by 15 %.
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
    """Return the (n + 1,) lengths along the contour of the stitch ends of a bent leg.

    Parameters
    ----------
    table, leg, closed
        Contour, leg of the contour, and whether the contour is closed.
    settings, accelerations
        Settings of the seam, and accelerations of the head.
    rests
        Whether the head rests at the beginning and at the end, for a needle of constant speed.

    Notes
    -----
    First, each place of the leg gets the longest stitch around it that is not longer than wanted
    and from which the line bows no more than the settings allow, but at least the least stitch.
    This length times the needle speed is a head speed. The head speed is reduced until it changes
    no faster than the accelerations allow. The stitches are the distances that the head covers in
    each turn of the needle. Finally the stitches are scaled to a whole number; they grow by at most
    half of the tolerance.
    """
    length_m = leg.length_m
    spacing = settings.least_m / _SAMPLES_PER_STITCH
    parts = math.ceil(min(max(length_m / spacing, _FEWEST), _MOST))
    s = np.linspace(0.0, length_m, parts + 1)
    points = leg_points(table, leg, closed, s)
    longest = _longest(points, length_m / parts, settings)
    if settings.needle == "constant":
        longest = _reachable(longest, s, settings, accelerations, rests)
    turns = np.concatenate([[0.0], np.cumsum(2.0 * np.diff(s) / (longest[:-1] + longest[1:]))])
    count = max(1, math.floor(turns[-1]))
    if turns[-1] > count * (1.0 + _TOLERANCE_SHARE * settings.tolerance):
        count += 1
    positions = np.interp(np.arange(count + 1) * (turns[-1] / count), turns, np.arange(parts + 1))
    k = np.minimum(positions.astype(np.int64), parts - 1)
    # Between two places the speed changes evenly over time, not over length.
    turn = (positions - k) * (turns[k + 1] - turns[k])
    speed_change = (longest[k + 1] - longest[k]) / (turns[k + 1] - turns[k])
    covered = s[k] + longest[k] * turn + 0.5 * speed_change * turn**2
    covered[0], covered[-1] = 0.0, length_m
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
    """Return the (n,) length along the line of the longest stitch around each point."""
    stitch_m, limit = settings.stitch_length_m, settings.bow_limit_m
    count = len(points)
    index = np.arange(count)
    lengths = np.full(count, stitch_m)
    growing: NDArray[np.bool_] = np.ones(count, dtype=np.bool_)
    arc, chord, bow = (np.zeros(count) for _ in range(3))
    # The reach of a stitch grows in small steps. Linear interpolation between two steps errs
    # towards shorter stitches.
    reach, most = 0, math.ceil(math.hypot(stitch_m, 2.0 * limit) / (2.0 * step))
    while reach < most and growing.any():
        reach = min(most, max(reach + 1, math.ceil(reach * _GROWTH)))
        first, last = np.maximum(index - reach, 0), np.minimum(index + reach, count - 1)
        arc_now = (last - first) * step
        chord_now = np.hypot(*(points[last] - points[first]).T)
        bow_now = bow_m(arc_now, chord_now)
        exceeds = growing & ((chord_now > stitch_m) | (bow_now > limit))
        share = np.ones(count)
        for value, value_now, bound in ((chord, chord_now, stitch_m), (bow, bow_now, limit)):
            rising = exceeds & (value_now > bound)
            share[rising] = np.minimum(
                share[rising], (bound - value[rising]) / (value_now[rising] - value[rising])
            )
        lengths[exceeds] = (arc + share * (arc_now - arc))[exceeds]
        growing &= ~exceeds
        arc, chord, bow = arc_now, chord_now, bow_now
    return np.asarray(np.maximum(lengths, settings.least_m))


def _reachable(
    longest: FloatArray,
    s: FloatArray,
    settings: Stitching,
    accelerations: Accelerations,
    rests: tuple[bool, bool],
) -> FloatArray:
    """Return ``longest``, reduced wherever the head could not change its speed in time."""
    up, down = (2.0 * a / settings.needle_speed_hz**2 for a in accelerations)
    squared = longest**2
    if rests[0]:
        squared[0] = 0.0
    if rests[1]:
        squared[-1] = 0.0
    squared = np.minimum.accumulate(squared - up * s) + up * s
    left_m = s[-1] - s
    squared = np.minimum.accumulate((squared - down * left_m)[::-1])[::-1] + down * left_m
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


EXEMPT = 2  # stitches on each side of a corner whose length may differ
_ROUNDS = 30


def stitch_lengths(
    length_m: float, settings: Stitching, accelerations: Accelerations, rests: tuple[bool, bool]
) -> FloatArray:
    r"""Return the (n,) stitch lengths of a leg, in order; their sum is ``length_m``.

    Parameters
    ----------
    length_m
        Length of the leg.
    settings
        Stitch length and needle speed.
    accelerations
        Accelerations of the head at a start from rest and at a stop.
    rests
        Whether the head rests at the beginning and at the end of the leg.

    Notes
    -----
    With a needle of constant speed N a leg of n stitches takes n/N. A head that rests at r of
    its ends, accelerates with a, and moves at v = N l' in between covers
    :math:`n l' - r l'^2 N^2/(2a)`; if the ends have different a, each end uses its own a. The
    number n brings l' as near as possible to the wanted length (``stitch_count``). Stitches during
    acceleration follow the ramp: they measure 1/4 and 3/4 of l' under the two-stitch rule.

    On a leg of few stitches, not all stitches can be within the tolerance. The middle stitches then
    differ by half of the tolerance, and the four exempt stitches take the rest.
    """
    stitch_m = settings.stitch_length_m
    count = stitch_count(length_m, settings, accelerations, rests)
    even_m = _even_m(count, length_m, _loss(settings, accelerations, rests))
    lengths = _ramped(count, even_m, settings, accelerations, rests)
    lengths *= length_m / lengths.sum()
    share = _TOLERANCE_SHARE * settings.tolerance
    middle = np.clip(even_m, stitch_m * (1.0 - share), stitch_m * (1.0 + share))
    rest_accelerations = [a for rest_m, a in zip(rests, accelerations, strict=True) if rest_m]
    ramp_stitches = middle * settings.needle_speed_hz**2 / min(rest_accelerations, default=np.inf)
    # A ramp that reaches 1/20 into the next stitch shortens that stitch by a thousandth.
    ramps_exempt = ramp_stitches <= EXEMPT * (1.0 + settings.tolerance)
    if count > 2 * EXEMPT and middle != even_m and ramps_exempt:
        rest_m = length_m - middle * (count - 2 * EXEMPT)
        exempt = exempt_mask(count)
        if rest_m > 0.0:
            lengths[~exempt] = middle
            lengths[exempt] *= rest_m / lengths[exempt].sum()
    return lengths


def stitch_count(
    length_m: float, settings: Stitching, accelerations: Accelerations, rests: tuple[bool, bool]
) -> int:
    """Return the number of stitches of a leg that brings them nearest to the wanted length.

    On a leg too short for the head to reach its speed, the result is the least possible number,
    because more stitches would be even shorter.
    """
    stitch_m = settings.stitch_length_m
    loss = _loss(settings, accelerations, rests)
    least = max(1, math.ceil(math.sqrt(4.0 * loss * length_m) - 1e-9))
    if loss * stitch_m >= length_m / stitch_m:
        return least
    ideal = length_m / stitch_m + loss * stitch_m
    counts = {max(least, math.floor(ideal)), max(least, math.ceil(ideal))}
    return min(counts, key=lambda n: abs(math.log(_even_m(n, length_m, loss) / stitch_m)))


def _loss(settings: Stitching, accelerations: Accelerations, rests: tuple[bool, bool]) -> float:
    """Return the distance lost in the ramps at rests over the squared stitch length, in 1/m."""
    inverse = sum(rest / a for rest, a in zip(rests, accelerations, strict=True))
    return settings.needle_speed_hz**2 * inverse / 2.0


def exempt_mask(count: int) -> NDArray[np.bool_]:
    """Return (count,) whether each stitch is one of the first two or last two of a leg."""
    index = np.arange(count)
    return (index < EXEMPT) | (index >= count - EXEMPT)


def _even_m(count: int, length_m: float, loss: float) -> float:
    """Return the stitch length at speed, the smaller root of ``loss l^2 - count l + L = 0``."""
    if loss == 0.0:
        return length_m / count
    root = math.sqrt(max(0.0, count**2 - 4.0 * loss * length_m))
    return 2.0 * length_m / (count + root)


def _ramped(
    count: int,
    even_m: float,
    settings: Stitching,
    accelerations: Accelerations,
    rests: tuple[bool, bool],
) -> FloatArray:
    """Return the (count,) distances that the head covers in each turn of the needle.

    The speed of the head is a trapezoid over time.
    """
    time = np.arange(count + 1, dtype=np.float64)
    covered = time * even_m
    for rest, si, clock in zip(rests, accelerations, (time, count - time), strict=True):
        if not rest:
            continue
        a = si / settings.needle_speed_hz**2  # m per period squared
        ramp = even_m / a
        # Distance lost against constant speed up to ``clock`` periods after (before) the rest.
        ramping = np.minimum(clock, ramp)
        lost = even_m * ramping - a * ramping**2 / 2.0
        covered = covered - (lost if clock is time else lost[0] - lost)
    return np.diff(covered)


def place_leg(
    table: ArcTable,
    leg: Leg,
    closed: bool,
    settings: Stitching,
    accelerations: Accelerations,
    rests: tuple[bool, bool],
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return the places on the contour of the stitch ends of a leg.

    Returns
    -------
    at_m
        (n + 1,) lengths along the contour, from ``leg.begin_m`` to ``leg.end_m``.
    points
        (n + 1, 2) points of the needle, m.
    short
        (n,) whether a bend makes the stitch shorter than wanted.

    Notes
    -----
    Stitches have even lengths. If the line would bow out of such stitches by more than the settings
    allow, the stitches are shorter at bends (``bent_stitches``).
    """
    even = _even(table, leg, closed, settings, accelerations, rests)
    if even is not None:
        at_m, points, chords = even
        if (bow_m(np.abs(np.diff(at_m)), chords) <= settings.bow_limit_m).all():
            return at_m, points, np.zeros(len(chords), dtype=np.bool_)
    at_m = bent_stitches(table, leg, closed, settings, accelerations, rests)
    points = leg_points(table, leg, closed, np.abs(at_m - leg.begin_m))
    chords = np.hypot(*np.diff(points, axis=0).T)
    is_short = chords < settings.stitch_length_m * (1.0 - _TOLERANCE_SHARE * settings.tolerance)
    return at_m, points, is_short & ~exempt_mask(len(chords))


def _even(
    table: ArcTable,
    leg: Leg,
    closed: bool,
    settings: Stitching,
    accelerations: Accelerations,
    rests: tuple[bool, bool],
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Return places, points and chords of stitches of even length; None for a loop of one stitch.

    Notes
    -----
    The length of a stitch is the length of its chord, not of its arc. If the two differ, each arc
    is divided by the ratio of chord to wanted length. Each repetition at least halves the error;
    the loop ends when the chords have the wanted proportions.
    """
    length_m = leg.length_m
    chord_sum = length_m
    for _ in range(3):
        wanted = stitch_lengths(chord_sum, settings, accelerations, rests)
        arcs = wanted * (length_m / wanted.sum())
        at_m, points, chords = _measure(table, leg, closed, arcs)
        if not chords.any():  # a loop of one stitch
            return None
        if abs(chords.sum() - chord_sum) <= 1e-3 * settings.stitch_length_m * len(chords):
            break
        chord_sum = float(chords.sum())
    best_even = (np.inf, at_m, points, chords)
    for _ in range(_ROUNDS):
        ratio = chords / wanted
        spread = float(ratio.max() / max(ratio.min(), 1e-12))
        if spread < best_even[0]:
            best_even = (spread, at_m, points, chords)
        if spread < 1.0 + 0.02 * settings.tolerance or not (chords > 0.0).all():
            break
        arcs = arcs / ratio
        arcs *= length_m / arcs.sum()
        at_m, points, chords = _measure(table, leg, closed, arcs)
    return best_even[1:]


def _measure(
    table: ArcTable, leg: Leg, closed: bool, arcs: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    sign = 1.0 if leg.end_m >= leg.begin_m else -1.0
    at_m = leg.begin_m + sign * np.concatenate([[0.0], np.cumsum(arcs)])
    at_m[-1] = leg.end_m
    points = table.points(wrap(at_m, table.length_m) if closed else at_m)
    return at_m, points, np.hypot(*np.diff(points, axis=0).T)


def wrap(at_m: FloatArray, length_m: float) -> FloatArray:
    """Return lengths along a closed contour modulo the length of the contour."""
    return np.asarray(np.mod(at_m, length_m))
