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
    squared = 0.0
    for j in range(axes):
        squared += ((positions[stop, j] - positions[start, j]) * radius_m[j]) ** 2
    if squared > (DENSE * cut_m * legs) ** 2:
        return SMOOTH  # legs are no shorter than the average of dense ones
    # Axis after axis, so that loop iterations are independent.
    sums = np.zeros((axes + 3, legs))  # one array: allocation takes as long as the work
    t, size, turned, changed = sums[3:], sums[0], sums[1], sums[2]
    for j in range(axes):
        for i in range(legs):
            t[j, i] = (positions[start + i + 1, j] - positions[start + i, j]) * radius_m[j]
            size[i] += t[j, i] * t[j, i]
    for i in range(legs):
        size[i] = np.sqrt(size[i])
    length = 0.0
    for i in range(legs):
        length += size[i]
    for i in range(legs):
        size[i] = 1.0 / size[i]
    for j in range(axes):
        for i in range(legs):
            t[j, i] *= size[i]
        for i in range(1, legs):
            turned[i] += (t[j, i] - t[j, i - 1]) ** 2
        for i in range(2, legs):
            changed[i] += (t[j, i] - 2.0 * t[j, i - 1] + t[j, i - 2]) ** 2
    uneven = 0
    for i in range(1, legs):
        turned[i] = np.sqrt(turned[i])
        turned[i] = turned[i] if turned[i] > STRAIGHT else 0.0
        most = max(turned[i], turned[i - 1])
        uneven += (most > 0.0) & (changed[i] > (LIKE * most) ** 2)
    if 2 * uneven <= legs or length > DENSE * cut_m * legs:
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
def legs_kept(positions, radius_m, cut_m):
    """Return which legs, by the vertex where they begin, a corner at one of their ends needs.

    There a spline that follows the vertices cuts the corner by more than ``cut_m`` (see
    ``corner_spacing``), so that points are added on the leg. Without rows if no leg is long enough
    for that.
    """
    count, axes = positions.shape
    least, square = 16.0 * cut_m * cut_m, 0.0
    if axes == 3:  # the usual case; independent iterations take a fifth of the time
        r0, r1, r2 = radius_m[0], radius_m[1], radius_m[2]
        longer = 0
        for i in range(1, count):
            x = (positions[i, 0] - positions[i - 1, 0]) * r0
            y = (positions[i, 1] - positions[i - 1, 1]) * r1
            z = (positions[i, 2] - positions[i - 1, 2]) * r2
            longer += 4.0 * (x * x + y * y + z * z) > least
        if longer == 0:
            return np.zeros(0, dtype=np.bool_)
    kept = np.zeros(count, dtype=np.bool_)
    a, b = np.zeros(axes), np.zeros(axes)
    for i in range(count - 1):
        own = 0.0
        for j in range(axes):
            b[j] = (positions[i + 1, j] - positions[i, j]) * radius_m[j]
            own += b[j] * b[j]
        if i > 0 and 4.0 * max(own, square) > least:  # no turn exceeds 2
            q = np.sqrt(own / square)
            turned = 0.0  # square of the turn times the leg
            for j in range(axes):
                turned += (b[j] - q * a[j]) ** 2
            kept[i] = turned > least
            if turned > least * q * q:
                kept[i - 1] = True
        for j in range(axes):
            a[j] = b[j]
        square = own
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
    first, before_m, guess = before
    start, limit, corner, opens = legs
    room = limit - start
    if opens and room < (AHEAD if guess == 0 else 3 * guess):
        return -1, False, 0.0, first, guess
    begin, end, least = max(first - 1, 0), len(shares_m), LEAST
    if rough != ROUGH:
        begin, end, least = 0, 1, LEAST if aside else MANY
    for level in range(begin, end):
        thin_m = shares_m[level]
        n = guess
        if n == 0:
            n = _grown(program, tool_chord, start, room, thin_m)
        trimmed, walked, tried = False, False, room + 1
        while True:  # with fewer legs each time
            if corner and n < room < 2 * n and not walked and not trimmed:
                # Two chords of similar length, and no short one at the end.
                n = room if 4 * room <= 5 * n and room < tried else (room + 1) // 2
            n = min(n, room)
            tried = n
            if n < (2 if trimmed or (n == room and aside) else least):
                break
            met = not walked and _write(program, tool_chord, start, n, room)
            strayed = _strayed(positions, radius_m, here, d, start, start + n)
            longer = np.sqrt(squared_of(d)) / (GROWS * before_m)
            if strayed > thin_m:
                more, rough_m = _more(program, tool_chord, start, n, strayed, thin_m)
                if rough_m > thin_m and level < end - 1:
                    n = 0  # no chord of useful length is within the tolerance
                    break
                if not walked and strayed > _CORNER * thin_m:
                    k = _walked(positions, radius_m, here, start, start + n, thin_m, d) - start
                    about = min(k, room - k, _ABOUT)
                    if LEAST <= k < n and _turn(positions, radius_m, start + k, about) > _SHARP:
                        n, walked = k, True
                        continue
                # Beyond half of the distance to a corner, two chords follow.
                n = min(max(int(n * min(more, _LESS)), n // 2), (room + 1) // 2 if n == room else n)
                walked = False
            elif longer > 1.0 and n > 2:
                n, trimmed, walked = max(min(int(n / longer), n - 1), 2), True, False
            else:
                break
        if n < (2 if trimmed or (n == room and aside) else least):
            continue
        if rough != ROUGH and not aside and _turned(positions, radius_m, start, start + n) > BENDS:
            continue
        more, _ = _more(program, tool_chord, start, n, strayed, thin_m)
        more = min(max(more, 0.5), _GROWS_LEGS)
        return start + n, met, strayed, level, max(min(int(n * more + 0.5), MOST), LEAST)
    towards(positions, radius_m, here, start + 1, d)
    return start + 1, True, from_vertex(positions, radius_m, here, start), first, 0


@njit()
def _grown(program, tool_chord, start, room, thin_m):
    """Return how many legs a chord may have, by trying more and more of them."""
    positions, radius_m = program
    here, d, _ = tool_chord
    n = min(_FIRST, room)
    while n < min(room, MOST):
        _write(program, tool_chord, start, n, room)
        strayed = _strayed(positions, radius_m, here, d, start, start + n)
        more, _ = _more(program, tool_chord, start, n, strayed, thin_m)
        more = min(more, _FIRST_GROWS)
        if more < 1.2:
            break
        n = min(int(n * more), room, MOST)
    return n


@njit()
def _more(program, tool_chord, start, n, strayed, thin_m):
    """Return the factor by which a chord may grow, and the deviation of vertices from the curve.

    The distance of its middle from the curve grows with the square of its length; the scatter of
    the vertices about the curve does not.
    """
    positions, radius_m = program
    here, d, middle = tool_chord
    half = n // 2
    mean = min(max(n // _MEAN, 1), _MOST_MEAN, half, n - half)
    along, far, square = 0.0, 0.0, 0.0
    for j in range(len(d)):
        middle[j] = 0.0
    _add(positions[start + half - mean : start + half + mean + 1], middle)
    for j in range(len(d)):
        place = middle[j] * radius_m[j] / (2 * mean + 1) - here[j]
        along += place * d[j]
        far += place * place
        square += d[j] * d[j]
    bent = min(np.sqrt(max(far - along * along / square, 0.0)), strayed)
    left = max(_AIM * thin_m - (strayed - bent), _BENT * thin_m)
    return np.sqrt(left / max(bent, 1e-3 * thin_m)), strayed - bent


@njit()
def _write(program, tool_chord, start, n, room):
    """Write the vector along a chord of ``n`` legs; return whether it ends in its last vertex."""
    positions, radius_m = program
    here, d, _ = tool_chord
    k, axes = start + n, len(d)
    mean = min(max(n // _MEAN, 1), _MOST_MEAN, room - n)
    if mean == 0:
        towards(positions, radius_m, here, k, d)
        return True
    for j in range(axes):
        d[j] = 0.0
    _add(positions[k - mean : k + mean + 1], d)
    per = 1.0 / (2 * mean + 1)
    for j in range(axes):
        d[j] = d[j] * per * radius_m[j] - here[j]
    return False


@njit()
def _add(own, total):
    """Add the rows of (n, axes) ``own`` to (axes,) ``total``."""
    if len(total) == 3:
        x, y, z = total[0], total[1], total[2]
        for i in range(len(own)):
            x += own[i, 0]
            y += own[i, 1]
            z += own[i, 2]
        total[0], total[1], total[2] = x, y, z
        return
    for i in range(len(own)):
        for j in range(len(total)):
            total[j] += own[i, j]


@njit()
def squared_of(d):
    """Return the squared length of a vector."""
    squared = 0.0
    for j in range(len(d)):
        squared += d[j] * d[j]
    return squared


@njit()
def from_vertex(positions, radius_m, here, k):
    """Return the distance of vertex ``k`` from a point."""
    squared = 0.0
    for j in range(len(here)):
        squared += (positions[k, j] * radius_m[j] - here[j]) ** 2
    return np.sqrt(squared)


@njit()
def _turned(positions, radius_m, start, stop):
    """Return the difference of the directions of the first and the last leg between vertices."""
    axes = positions.shape[1]
    first, last, squared = 0.0, 0.0, 0.0
    for j in range(axes):
        first += ((positions[start + 1, j] - positions[start, j]) * radius_m[j]) ** 2
        last += ((positions[stop, j] - positions[stop - 1, j]) * radius_m[j]) ** 2
    first, last = np.sqrt(first), np.sqrt(last)
    for j in range(axes):
        before = (positions[start + 1, j] - positions[start, j]) / first
        after = (positions[stop, j] - positions[stop - 1, j]) / last
        squared += ((after - before) * radius_m[j]) ** 2
    return np.sqrt(squared)


@njit()
def _turn(positions, radius_m, k, legs):
    """Return the difference of the directions into and out of vertex ``k``, over some legs each."""
    axes = positions.shape[1]
    to, on, squared = 0.0, 0.0, 0.0
    for j in range(axes):
        to += ((positions[k, j] - positions[k - legs, j]) * radius_m[j]) ** 2
        on += ((positions[k + legs, j] - positions[k, j]) * radius_m[j]) ** 2
    to, on = np.sqrt(to), np.sqrt(on)
    for j in range(axes):
        before = (positions[k, j] - positions[k - legs, j]) / to
        after = (positions[k + legs, j] - positions[k, j]) / on
        squared += ((after - before) * radius_m[j]) ** 2
    return np.sqrt(squared)


@njit()
def towards(positions, radius_m, here, k, d):
    """Write the vector from ``here`` to vertex ``k``."""
    for j in range(len(d)):
        d[j] = positions[k, j] * radius_m[j] - here[j]


@njit()
def _walked(positions, radius_m, here, start, limit, thin_m, d):
    """Return the last vertex up to ``limit`` that one chord can pass; write the vector along it.

    Notes
    -----
    A vertex at w, matched to the chord's point at distance f, permits the directions c with
    |f c - w| <= e: a ball about w / f with radius e / f. Of two overlapping balls, the largest ball
    within both is kept; the chord goes along its centre. Distances do not decrease along the chord.
    """
    axes = positions.shape[1]
    w = np.empty(axes)
    far, left, k = 0.0, np.inf, start
    d[:] = 0.0
    while k < limit:
        squared, gap, move = 0.0, 0.0, 1.0
        for j in range(axes):
            w[j] = positions[k + 1, j] * radius_m[j] - here[j]
            squared += w[j] * w[j]
        reach = max(far, np.sqrt(squared))
        if not reach > 0.0:
            break
        own = thin_m / reach
        for j in range(axes):
            w[j] = w[j] / reach - d[j]
            gap += w[j] * w[j]
        if k > start and gap <= (left - own) * (left - own):  # one ball lies within the other
            move, left = (1.0, own) if own < left else (0.0, left)
        elif k > start:
            gap = np.sqrt(gap)
            both = 0.5 * (left + own - gap)
            if not both > 0.0:
                break
            move, left = 0.5 * (gap + left - own) / gap, both
        else:
            left = own
        for j in range(axes):
            d[j] += move * w[j]
        far = reach
        k += 1
    size = far / np.sqrt(squared_of(d))
    for j in range(axes):
        d[j] *= size
    return k


@njit(fastmath={"contract"})
def _strayed(positions, radius_m, here, d, start, stop):
    """Return the largest distance of vertices ``start`` to ``stop`` from their points on a chord.

    The first and the last vertex are matched to its ends, the others to the nearest point after the
    previous one. Fused multiply-add rounds once where the processor has it.
    """
    axes, square = len(d), 0.0
    for j in range(axes):
        square += d[j] * d[j]
    if not square > 0.0:
        return np.inf
    own, last = positions[start : stop + 1], stop - start
    per, share, worst = 1.0 / square, 0.0, 0.0
    if axes == 3:  # the usual case: written out, it takes a fifth of the time
        r0, r1, r2 = radius_m[0], radius_m[1], radius_m[2]
        h0, h1, h2 = here[0], here[1], here[2]
        d0, d1, d2 = d[0], d[1], d[2]
        for i in range(last + 1):
            x, y, z = own[i, 0] * r0 - h0, own[i, 1] * r1 - h1, own[i, 2] * r2 - h2
            along = (x * d0 + y * d1 + z * d2) * per
            if i > 0 and along > share:
                share = min(along, 1.0)
            if i == last:
                share = 1.0
            x, y, z = x - share * d0, y - share * d1, z - share * d2
            squared = x * x + y * y + z * z
            if squared > worst:  # noqa: PLR1730 - max() looks for NaN as well
                worst = squared
        return np.sqrt(worst)
    for i in range(last + 1):
        along = 0.0
        for j in range(axes):
            along += (own[i, j] * radius_m[j] - here[j]) * d[j]
        share = min(max(share, along * per), 1.0)
        if i == 0:
            share = 0.0
        elif i == last:
            share = 1.0
        squared = 0.0
        for j in range(axes):
            squared += (own[i, j] * radius_m[j] - here[j] - share * d[j]) ** 2
        worst = max(worst, squared)
    return np.sqrt(worst)
