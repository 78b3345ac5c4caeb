"""Chords through rough programs: test whether vertices scatter about a curve, and replace them.

A chord ends at the mean of the vertices around its last one, so that its ends lie on the intended
curve. With ends anywhere within the tolerance, long and short chords would alternate.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.motion.path.polygon import STRAIGHT

APART = 4  # legs between the directions that are compared
ALIKE = 0.28
"""A program is rough if its direction changes over several legs by less than this share of all
single turns between."""
LIKE = 0.3
"""It is uneven if a turn differs by more than this share from the previous one."""
DENSE = 4.0
"""Vertices are dense if legs are shorter, on average, than this many tolerances."""
SMOOTH, UNEVEN, ROUGH = 0, 1, 2


@njit()
def roughness(positions, radius_m, cut_m, start, stop):
    """Return the roughness of the program between two vertices, decided by most of its legs.

    Consecutive turns of a smooth curve are similar. If they are not, the program is uneven; if most
    of them cancel each other, it is rough. A program with sparse vertices counts as smooth.
    """
    axes, legs = positions.shape[1], stop - start
    if legs <= APART:
        return SMOOTH
    chord2_m2 = 0.0
    for j in range(axes):
        chord2_m2 += ((positions[stop, j] - positions[start, j]) * radius_m[j]) ** 2
    if chord2_m2 > (DENSE * cut_m * legs) ** 2:
        return SMOOTH  # legs are no shorter than the average of dense ones
    # Axis after axis, so that loop iterations are independent.
    sums = np.zeros((axes + 3, legs))  # one array: allocation takes as long as the work
    t, size, turned, change2 = sums[3:], sums[0], sums[1], sums[2]
    for j in range(axes):
        for i in range(legs):
            t[j, i] = (positions[start + i + 1, j] - positions[start + i, j]) * radius_m[j]
            size[i] += t[j, i] * t[j, i]
    for i in range(legs):
        size[i] = np.sqrt(size[i])
    length_m = 0.0
    for i in range(legs):
        length_m += size[i]
    for i in range(legs):
        size[i] = 1.0 / size[i]
    for j in range(axes):
        for i in range(legs):
            t[j, i] *= size[i]
        for i in range(1, legs):
            turned[i] += (t[j, i] - t[j, i - 1]) ** 2
        for i in range(2, legs):
            change2[i] += (t[j, i] - 2.0 * t[j, i - 1] + t[j, i - 2]) ** 2
    uneven = 0
    for i in range(1, legs):
        turned[i] = np.sqrt(turned[i])
        turned[i] = turned[i] if turned[i] > STRAIGHT else 0.0
        larger_turn = max(turned[i], turned[i - 1])
        uneven += (larger_turn > 0.0) & (change2[i] > (LIKE * larger_turn) ** 2)
    if 2 * uneven <= legs or length_m > DENSE * cut_m * legs:
        return SMOOTH
    rough, total = 0, 0.0
    size[:] = 0.0
    for j in range(axes):
        for i in range(APART, legs):
            size[i] += (t[j, i] - t[j, i - APART]) ** 2
    for i in range(APART, legs):
        total = turned[i - 3] + turned[i - 2] + turned[i - 1] + turned[i]
        rough += size[i] < (ALIKE * total) ** 2
    return ROUGH if 2 * rough >= legs - APART else UNEVEN


@njit()
def needed_legs(positions, radius_m, cut_m):
    """Return which legs, by the vertex where they begin, a corner at one of their ends needs.

    There a spline that follows the vertices cuts the corner by more than ``cut_m`` (see
    ``corner_spacing``), so that points are added on the leg. Without rows if no leg is long enough
    for that.
    """
    count, axes = positions.shape
    least_m2, previous_m2 = 16.0 * cut_m * cut_m, 0.0
    if axes == 3:  # the usual case; independent iterations take a fifth of the time
        r0, r1, r2 = radius_m[0], radius_m[1], radius_m[2]
        long_legs = 0
        for i in range(1, count):
            x = (positions[i, 0] - positions[i - 1, 0]) * r0
            y = (positions[i, 1] - positions[i - 1, 1]) * r1
            z = (positions[i, 2] - positions[i - 1, 2]) * r2
            long_legs += 4.0 * (x * x + y * y + z * z) > least_m2
        if long_legs == 0:
            return np.zeros(0, dtype=np.bool_)
    kept = np.zeros(count, dtype=np.bool_)
    a, b = np.zeros(axes), np.zeros(axes)
    for i in range(count - 1):
        leg_m2 = 0.0
        for j in range(axes):
            b[j] = (positions[i + 1, j] - positions[i, j]) * radius_m[j]
            leg_m2 += b[j] * b[j]
        if i > 0 and 4.0 * max(leg_m2, previous_m2) > least_m2:  # no turn exceeds 2
            q = np.sqrt(leg_m2 / previous_m2)
            turn2_m2 = 0.0  # square of the turn times the leg
            for j in range(axes):
                turn2_m2 += (b[j] - q * a[j]) ** 2
            kept[i] = turn2_m2 > least_m2
            if turn2_m2 > least_m2 * q * q:
                kept[i - 1] = True
        for j in range(axes):
            a[j] = b[j]
        previous_m2 = leg_m2
    return kept


SHARES = np.array([0.3, 0.4, 0.5, 0.6])
"""Shares of the tolerance that vertices may deviate from a chord, tried in this order.

Chords of a curve with their ends on it, at the share e, turn so much that the spline cuts twice as
much; the increment from share to share is a quarter of the rest for that.
"""
MOST = 512  # legs of a chord
AHEAD = 3 * MOST  # legs after its start that decide its length
LEAST = 4  # legs of a chord: fewer are not worth the tolerance
MANY = 12  # legs of a chord in an uneven, but not rough program, which gains less
BENDS = 0.25
"""Largest turn of an uneven program at its first chord: tighter curves gain too little."""
GROWS = 2.0  # largest ratio of a chord to the previous one, to limit the knot spacing
_GROWS_LEGS = 1.5  # or of their numbers of legs
_FIRST = 16  # legs of a chord without a predecessor, to begin with
_FIRST_GROWS = 4.0
_AIM = 0.85  # share of the permitted deviation of vertices at which the next chord aims
_LESS = 0.85  # largest factor on the legs of a chord that deviates too much
_BENT = 0.3  # share of the permitted deviation: distance of a chord from the curve itself
_CORNER = 1.5  # times the permitted deviation: vertices with more may follow a corner
_SHARP = 0.5  # difference of the directions on both sides of a corner
_ABOUT = 6  # number of legs for these directions
_MEAN = 3  # an end is the mean of vertices over a third of the chord's legs on either side
_MOST_MEAN = 16


class Program(NamedTuple):
    """The vertices of a program: (n, axes) positions, and (axes,) radii of the axes, m."""

    positions: FloatArray
    radius_m: FloatArray


class ToolChord(NamedTuple):
    """A chord at the tool: (axes,) start, (axes,) vector along it, and an (axes,) work array."""

    here: FloatArray
    d: FloatArray
    middle: FloatArray


class Before(NamedTuple):
    """The chord before.

    Parameters
    ----------
    level
        Number of the share that it needed.
    length_m
        Its length; infinite without a chord before.
    guess
        Number of legs to try for the next chord; 0 without a chord before.
    """

    level: int
    length_m: float
    guess: int


class Legs(NamedTuple):
    """The legs that a chord may replace.

    Parameters
    ----------
    start, limit
        Row where the chord begins, and row that it must not pass.
    corner
        Whether ``limit`` is a vertex that a chord has to meet.
    opens
        Whether ``limit`` is the last row so far.
    """

    start: int
    limit: int
    corner: bool
    opens: bool


@njit()
def chord(program, shares_m, rough, aside, before, legs, tool_chord):
    """Write the vector along the next chord; return the row of its end, and its quality.

    ``shares_m`` are permitted deviations of vertices, tried in this order; ``rough`` is the
    roughness of the program; ``aside`` says whether the chord begins beside its first vertex. The
    chord may replace ``legs``. It begins at the start in ``tool_chord``, whose vector is written.

    Returns
    -------
    k
        The last vertex that the chord passes; -1 if more vertices must be read first.
    met
        Whether it ends in that vertex.
    strayed
        Largest deviation of the vertices from it.
    level, guess
        Number of its share, and number of legs to try for the next one.
    """
    positions, radius_m = program
    here, d, _ = tool_chord
    previous_level, previous_m, guess = before
    start, limit, corner, opens = legs
    legs_left = limit - start
    if opens and legs_left < (AHEAD if guess == 0 else 3 * guess):
        return -1, False, 0.0, previous_level, guess
    first_level, stop_level, least_legs = max(previous_level - 1, 0), len(shares_m), LEAST
    if rough != ROUGH:
        first_level, stop_level, least_legs = 0, 1, LEAST if aside else MANY
    for level in range(first_level, stop_level):
        permitted_m = shares_m[level]
        n = guess
        if n == 0:
            n = _grown(program, tool_chord, start, legs_left, permitted_m)
        trimmed, walked, tried_legs = False, False, legs_left + 1
        while True:  # with fewer legs each time
            if corner and n < legs_left < 2 * n and not walked and not trimmed:
                # Two chords of similar length, and no short one at the end.
                n = (
                    legs_left
                    if 4 * legs_left <= 5 * n and legs_left < tried_legs
                    else (legs_left + 1) // 2
                )
            n = min(n, legs_left)
            tried_legs = n
            if n < (2 if trimmed or (n == legs_left and aside) else least_legs):
                break
            met = not walked and _write(program, tool_chord, start, n, legs_left)
            strayed = _strayed(positions, radius_m, here, d, start, start + n)
            length_ratio = np.sqrt(squared_of(d)) / (GROWS * previous_m)
            if strayed > permitted_m:
                growth, scatter_m = _more(program, tool_chord, start, n, strayed, permitted_m)
                if scatter_m > permitted_m and level < stop_level - 1:
                    n = 0  # no chord of useful length is within the tolerance
                    break
                if not walked and strayed > _CORNER * permitted_m:
                    k = _walked(positions, radius_m, here, start, start + n, permitted_m, d) - start
                    corner_legs = min(k, legs_left - k, _ABOUT)
                    if (
                        LEAST <= k < n
                        and _turn(positions, radius_m, start + k, corner_legs) > _SHARP
                    ):
                        n, walked = k, True
                        continue
                # Beyond half of the distance to a corner, two chords follow.
                n = min(
                    max(int(n * min(growth, _LESS)), n // 2),
                    (legs_left + 1) // 2 if n == legs_left else n,
                )
                walked = False
            elif length_ratio > 1.0 and n > 2:
                n, trimmed, walked = max(min(int(n / length_ratio), n - 1), 2), True, False
            else:
                break
        if n < (2 if trimmed or (n == legs_left and aside) else least_legs):
            continue
        if rough != ROUGH and not aside and _turned(positions, radius_m, start, start + n) > BENDS:
            continue
        growth, _ = _more(program, tool_chord, start, n, strayed, permitted_m)
        growth = min(max(growth, 0.5), _GROWS_LEGS)
        return start + n, met, strayed, level, max(min(int(n * growth + 0.5), MOST), LEAST)
    towards(positions, radius_m, here, start + 1, d)
    return start + 1, True, from_vertex(positions, radius_m, here, start), previous_level, 0


@njit()
def _grown(program, tool_chord, start, legs_left, permitted_m):
    """Return how many legs a chord may have, by trying more and more of them."""
    positions, radius_m = program
    here, d, _ = tool_chord
    n = min(_FIRST, legs_left)
    while n < min(legs_left, MOST):
        _write(program, tool_chord, start, n, legs_left)
        strayed = _strayed(positions, radius_m, here, d, start, start + n)
        growth, _ = _more(program, tool_chord, start, n, strayed, permitted_m)
        growth = min(growth, _FIRST_GROWS)
        if growth < 1.2:
            break
        n = min(int(n * growth), legs_left, MOST)
    return n


@njit()
def _more(program, tool_chord, start, n, strayed, permitted_m):
    """Return the factor by which a chord may grow, and the deviation of vertices from the curve.

    The distance of its middle from the curve grows with the square of its length; the scatter of
    the vertices about the curve does not.
    """
    positions, radius_m = program
    here, d, middle = tool_chord
    middle_leg = n // 2
    mean_legs = min(max(n // _MEAN, 1), _MOST_MEAN, middle_leg, n - middle_leg)
    projection, distance2_m2, chord2_m2 = 0.0, 0.0, 0.0
    for j in range(len(d)):
        middle[j] = 0.0
    _add(positions[start + middle_leg - mean_legs : start + middle_leg + mean_legs + 1], middle)
    for j in range(len(d)):
        offset_m = middle[j] * radius_m[j] / (2 * mean_legs + 1) - here[j]
        projection += offset_m * d[j]
        distance2_m2 += offset_m * offset_m
        chord2_m2 += d[j] * d[j]
    curve_m = min(np.sqrt(max(distance2_m2 - projection * projection / chord2_m2, 0.0)), strayed)
    left_m = max(_AIM * permitted_m - (strayed - curve_m), _BENT * permitted_m)
    return np.sqrt(left_m / max(curve_m, 1e-3 * permitted_m)), strayed - curve_m


@njit()
def _write(program, tool_chord, start, n, legs_left):
    """Write the vector along a chord of ``n`` legs; return whether it ends in its last vertex."""
    positions, radius_m = program
    here, d, _ = tool_chord
    end_row, axes = start + n, len(d)
    mean_legs = min(max(n // _MEAN, 1), _MOST_MEAN, legs_left - n)
    if mean_legs == 0:
        towards(positions, radius_m, here, end_row, d)
        return True
    for j in range(axes):
        d[j] = 0.0
    _add(positions[end_row - mean_legs : end_row + mean_legs + 1], d)
    weight = 1.0 / (2 * mean_legs + 1)
    for j in range(axes):
        d[j] = d[j] * weight * radius_m[j] - here[j]
    return False


@njit()
def _add(rows, total):
    """Add the rows of (n, axes) ``rows`` to (axes,) ``total``."""
    if len(total) == 3:
        x, y, z = total[0], total[1], total[2]
        for i in range(len(rows)):
            x += rows[i, 0]
            y += rows[i, 1]
            z += rows[i, 2]
        total[0], total[1], total[2] = x, y, z
        return
    for i in range(len(rows)):
        for j in range(len(total)):
            total[j] += rows[i, j]


@njit()
def squared_of(d):
    """Return the squared length of a vector."""
    length2 = 0.0
    for j in range(len(d)):
        length2 += d[j] * d[j]
    return length2


@njit()
def from_vertex(positions, radius_m, here, k):
    """Return the distance of vertex ``k`` from a point."""
    distance2 = 0.0
    for j in range(len(here)):
        distance2 += (positions[k, j] * radius_m[j] - here[j]) ** 2
    return np.sqrt(distance2)


@njit()
def _turned(positions, radius_m, start, stop):
    """Return the difference of the directions of the first and the last leg between vertices."""
    axes = positions.shape[1]
    first, last, difference2 = 0.0, 0.0, 0.0
    for j in range(axes):
        first += ((positions[start + 1, j] - positions[start, j]) * radius_m[j]) ** 2
        last += ((positions[stop, j] - positions[stop - 1, j]) * radius_m[j]) ** 2
    first, last = np.sqrt(first), np.sqrt(last)
    for j in range(axes):
        direction_in = (positions[start + 1, j] - positions[start, j]) / first
        direction_out = (positions[stop, j] - positions[stop - 1, j]) / last
        difference2 += ((direction_out - direction_in) * radius_m[j]) ** 2
    return np.sqrt(difference2)


@njit()
def _turn(positions, radius_m, k, legs):
    """Return the difference of the directions into and out of vertex ``k``, over some legs each."""
    axes = positions.shape[1]
    to, on, difference2 = 0.0, 0.0, 0.0
    for j in range(axes):
        to += ((positions[k, j] - positions[k - legs, j]) * radius_m[j]) ** 2
        on += ((positions[k + legs, j] - positions[k, j]) * radius_m[j]) ** 2
    to, on = np.sqrt(to), np.sqrt(on)
    for j in range(axes):
        direction_in = (positions[k, j] - positions[k - legs, j]) / to
        direction_out = (positions[k + legs, j] - positions[k, j]) / on
        difference2 += ((direction_out - direction_in) * radius_m[j]) ** 2
    return np.sqrt(difference2)


@njit()
def towards(positions, radius_m, here, k, d):
    """Write the vector from ``here`` to vertex ``k``."""
    for j in range(len(d)):
        d[j] = positions[k, j] * radius_m[j] - here[j]


@njit()
def _walked(positions, radius_m, here, start, limit, permitted_m, d):
    """Return the last vertex up to ``limit`` that one chord can pass; write the vector along it.

    Notes
    -----
    A vertex at w, matched to the chord's point at distance f, permits the directions c with
    |f c - w| <= e: a ball about w / f with radius e / f. Of two overlapping balls, the largest ball
    within both is kept; the chord goes along its centre. Distances do not decrease along the chord.
    """
    axes = positions.shape[1]
    w = np.empty(axes)
    reached_m, radius, k = 0.0, np.inf, start
    d[:] = 0.0
    while k < limit:
        distance2_m2, gap, shift = 0.0, 0.0, 1.0
        for j in range(axes):
            w[j] = positions[k + 1, j] * radius_m[j] - here[j]
            distance2_m2 += w[j] * w[j]
        distance_m = max(reached_m, np.sqrt(distance2_m2))
        if not distance_m > 0.0:
            break
        new_radius = permitted_m / distance_m
        for j in range(axes):
            w[j] = w[j] / distance_m - d[j]
            gap += w[j] * w[j]
        # If one ball lies within the other, the smaller one is kept.
        if k > start and gap <= (radius - new_radius) * (radius - new_radius):
            shift, radius = (1.0, new_radius) if new_radius < radius else (0.0, radius)
        elif k > start:
            gap = np.sqrt(gap)
            common_radius = 0.5 * (radius + new_radius - gap)
            if not common_radius > 0.0:
                break
            shift, radius = 0.5 * (gap + radius - new_radius) / gap, common_radius
        else:
            radius = new_radius
        for j in range(axes):
            d[j] += shift * w[j]
        reached_m = distance_m
        k += 1
    scale = reached_m / np.sqrt(squared_of(d))
    for j in range(axes):
        d[j] *= scale
    return k


@njit(fastmath={"contract"})
def _strayed(positions, radius_m, here, d, start, stop):
    """Return the largest distance of vertices ``start`` to ``stop`` from their points on a chord.

    The first and the last vertex are matched to its ends, the others to the nearest point after the
    previous one. Fused multiply-add rounds once where the processor has it.
    """
    axes, chord2_m2 = len(d), 0.0
    for j in range(axes):
        chord2_m2 += d[j] * d[j]
    if not chord2_m2 > 0.0:
        return np.inf
    rows, last_index = positions[start : stop + 1], stop - start
    per_chord2, share, worst2_m2 = 1.0 / chord2_m2, 0.0, 0.0
    if axes == 3:  # the usual case: written out, it takes a fifth of the time
        r0, r1, r2 = radius_m[0], radius_m[1], radius_m[2]
        h0, h1, h2 = here[0], here[1], here[2]
        d0, d1, d2 = d[0], d[1], d[2]
        for i in range(last_index + 1):
            x, y, z = rows[i, 0] * r0 - h0, rows[i, 1] * r1 - h1, rows[i, 2] * r2 - h2
            nearest_share = (x * d0 + y * d1 + z * d2) * per_chord2
            if i > 0 and nearest_share > share:
                share = min(nearest_share, 1.0)
            if i == last_index:
                share = 1.0
            x, y, z = x - share * d0, y - share * d1, z - share * d2
            distance2_m2 = x * x + y * y + z * z
            if distance2_m2 > worst2_m2:  # noqa: PLR1730 - max() looks for NaN as well
                worst2_m2 = distance2_m2
        return np.sqrt(worst2_m2)
    for i in range(last_index + 1):
        nearest_share = 0.0
        for j in range(axes):
            nearest_share += (rows[i, j] * radius_m[j] - here[j]) * d[j]
        share = min(max(share, nearest_share * per_chord2), 1.0)
        if i == 0:
            share = 0.0
        elif i == last_index:
            share = 1.0
        distance2_m2 = 0.0
        for j in range(axes):
            distance2_m2 += (rows[i, j] * radius_m[j] - here[j] - share * d[j]) ** 2
        worst2_m2 = max(worst2_m2, distance2_m2)
    return np.sqrt(worst2_m2)
