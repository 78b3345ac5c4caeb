"""Bounds on the distance between a quartic spline and its polygon, and the knots that keep them.

The knots lie at the vertices of the polygon and at other points of it. Each control point is the
point of the polygon at the mean of four consecutive knots (its Greville abscissa), all by length
along the polygon.

Notes
-----
Such a spline is V[p] of the polygon p, with an operator V that is linear, positive and reproduces
straight lines (Schoenberg; de Boor, "A Practical Guide to Splines", chapter IX). With the turn
dt[u] at the vertex at s[u], the polygon is a line plus the sum of dt[u] (t - s[u])+, so that

    V[p](t) - p(t) = sum of dt[u] e[u](t),    e[u] = V[(t - s[u])+] - (t - s[u])+ >= 0.

At any t only few e[u] are not 0. V preserves convexity, so each e[u] is convex on either side of
s[u], and the sum of |dt[u]| e[u] is largest at a vertex, where the knots give its exact value: that
is the bound, at one parameter of both curves. Another knot only reduces each e[u].

At a run's end the polygon continues as its mirror image: there the spline passes through the end,
straight and with even spacing.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.base.compiled import njit

REACH = 3
"""Legs on either side of a vertex that affect how far it is cut."""
AHEAD = REACH + 1
"""Vertices on either side of a leg that affect its knots."""
CUT = 7.0 / 24.0
"""With two knots no farther than l and 2 l on either side, a vertex is cut by at most |dt| l times
this, if the next vertex is beyond them, or is the second of them: then, with the first midway and
no farther than 1.5 of this leg from its next knot, its contribution begins after the mean of three.

With knots at -A, -a, 0, b, B, where b <= a + A and a <= b + B, de Boor's triangle makes e at 0

    b A^2 f / ((a + b) (A + b) (A + B)) + a A B f / ((a + b) (A + B) (a + B))
    + a^2 (b + B) / (4 (a + b) (a + B)),    f = (b + B - a) / 4,

for any farther knots. It grows with A, and so, by symmetry, with B; with A = B = 2 l it is
l / 4 + (1 - l / (2 l + a) - l / (2 l + b)) a b / (4 (a + b)), which grows with a and b. If b or a
is larger than assumed, e is less than l / 4.
"""
_LIKE = 2.0
"""Largest ratio of similar neighbouring legs. With one knot midway on each of many similar legs the
curvature is even: the contribution of one turn falls as the next one's rises."""
_NEXT = 1.5  # largest distance of the next knot beyond a leg with one knot, in legs
TOUCH = 1e-9  # share of a leg: two added knots this close become one


@njit()
def leg_of(k, count):
    """Return the index of leg ``k`` among ``count`` legs; beyond an end of the run it mirrors."""
    while k < 0 or k >= count:
        k = -1 - k if k < 0 else 2 * count - 1 - k
    return k


@njit()
def point_of(k, count):
    """Return the index of point ``k`` of ``count`` legs; beyond an end of the run it mirrors."""
    while k < 0 or k > count:
        k = -k if k < 0 else 2 * count - k
    return k


@njit()
def cut_of(length_m, turn, v):
    """Return the bound at vertex ``v``: the sum of |dt[u]| e[u] there, in units of length.

    Parameters
    ----------
    length_m, turn
        (n,) legs and (n + 1,) turns of a run; the run also ends at an end of the arrays that lies
        less than three legs from ``v``.
    """
    legs = len(length_m)
    x = np.zeros(7)  # knots, from the vertex
    for i in range(3):
        x[4 + i] = x[3 + i] + length_m[leg_of(v + i, legs)]
        x[2 - i] = x[3 - i] - length_m[leg_of(v - 1 - i, legs)]
    # De Boor's triangle of weights of the four control points at the knot in the middle.
    weight = np.zeros(4)
    a = -x[2] / (x[4] - x[2])
    b0, b1 = -x[1] / (x[4] - x[1]), -x[2] / (x[5] - x[2])
    c0, c1, c2 = -x[0] / (x[4] - x[0]), -x[1] / (x[5] - x[1]), -x[2] / (x[6] - x[2])
    first, middle, last = (1.0 - a) * (1.0 - b0), (1.0 - a) * b0 + a * (1.0 - b1), a * b1
    weight[0] = first * (1.0 - c0)
    weight[1] = first * c0 + middle * (1.0 - c1)
    weight[2] = middle * c1 + last * (1.0 - c2)
    weight[3] = last * c2
    bound = 0.0
    for i in range(1, 6):
        vertex_turn = turn[point_of(v - 3 + i, legs)]
        if vertex_turn > 0.0:
            for j in range(4):
                mean = 0.25 * (x[j] + x[j + 1] + x[j + 2] + x[j + 3])
                distance = mean - x[i] if i >= 3 else x[i] - mean
                bound += vertex_turn * weight[j] * max(distance, 0.0)
    return bound


@njit()
def quartic_spacing(length_m, turn, cut_m, beside_m, first, stop, spacing):
    """Write the largest distance of knots beside each vertex, 0 for any.

    Parameters
    ----------
    length_m, turn, beside_m
        (n - 1,), (n,), (n,) columns of vertices, including ``AHEAD`` on either side of the
        written ones, unless the run begins or ends with them.
    cut_m
        (n,) largest distance at the tool between spline and polygon at each vertex, including the
        program's deviation from the leg into a vertex (``beside_m``).
    first, stop
        Vertices ``first`` to ``stop`` are written.
    spacing
        (2, n), m: on the leg into the vertex, and on the next.
    """
    count = len(turn)
    beside = np.zeros(count)
    for v in range(max(first - 1, 0), min(stop + 2, count)):
        spacing[0, v] = 0.0
        if turn[v] == 0.0 or v == 0 or v == count - 1:
            continue
        for k in range(max(v - 2, 0), min(v + 4, count)):
            beside[v] = max(beside[v], beside_m[k])
        if cut_of(length_m, turn, v) > cut_m[v] - beside[v]:
            spacing[0, v] = (cut_m[v] - max(beside_m[v], beside_m[v + 1])) / (CUT * turn[v])
            least = min(length_m[v - 1], length_m[v])
            if max(length_m[v - 1], length_m[v]) <= _LIKE * least:
                spacing[0, v] = min(spacing[0, v], least)  # one knot on either leg, midway
    for v in range(first, stop + 1):
        spacing[1, v] = spacing[0, v]
    for v in range(first, stop + 1):
        if spacing[1, v] > 0.0 and spacing[0, v - 1] == 0.0 and spacing[0, v + 1] == 0.0:
            after = length_m[v] >= length_m[v - 1]
            if _one_is_enough(length_m, turn, v, after, spacing[1, v], cut_m[v] - beside[v]):
                spacing[0 if after else 1, v] = 0.0


@njit()
def _one_is_enough(length_m, turn, v, after, spacing, cut_m):
    """Return whether a vertex needs a knot on its longer leg only, and has it midway there.

    ``knots_between`` divides such a leg midway unless the leg or the next one is too long for one
    knot, or the leg is at the end of a run.
    """
    legs = len(length_m)
    leg, next_leg = (v, v + 1) if after else (v - 1, v - 2)
    if not 0 <= next_leg < legs:
        return False
    # The same quotients as there, so that both decide alike at a limit.
    if length_m[next_leg] / length_m[leg] > _NEXT or 2.0 * (spacing / length_m[leg]) < 1.0:
        return False
    begin, end = max(v - 3, 0), min(v + 3, legs)
    lengths, leg_turns = np.empty(end - begin + 1), np.zeros(end - begin + 2)
    n = 0
    for c in range(begin, end):
        leg_turns[n] = turn[c]
        lengths[n] = length_m[c]
        if c == leg:
            lengths[n] *= 0.5
            n += 1
            lengths[n] = lengths[n - 1]
        n += 1
    leg_turns[n] = turn[end]
    return cut_of(lengths, leg_turns, v - begin + (0 if after else 1)) <= cut_m


@njit()
def knots_between(near, far, opens, closes, beyond, share):
    """Write the places (0 to 1) of the knots on a leg, its end included; return their number.

    Parameters
    ----------
    near, far
        Spacing beside the vertices at its ends, as shares of the leg; 0 for any.
    opens, closes
        Whether the run begins or ends at that vertex.
    beyond
        Length of the next leg at a vertex without required spacing, as a share of this leg.
    """
    n = 0
    two_sided = near > 0.0 and far > 0.0
    smaller, larger = min(near, far) if two_sided else max(near, far), max(near, far)
    equal_parts = 0  # number of equal parts of the leg
    if two_sided and 2.0 * (near + far) >= 1.0 - TOUCH:
        equal_parts = 2 if larger <= _NEXT else 3
        while equal_parts < 4 and equal_parts * smaller < 1.0 - TOUCH:
            equal_parts += 1
    elif not two_sided and not opens and not closes and 3.0 * larger >= 1.0:
        equal_parts = 2 if 2.0 * larger >= 1.0 and beyond <= _NEXT else 3
    if equal_parts * smaller >= 1.0 - TOUCH:
        for i in range(1, equal_parts):
            share[n] = i / equal_parts
            n += 1
    elif two_sided and equal_parts == 0:
        share[0], share[1], share[2], share[3] = near, 2.0 * near, 1.0 - 2.0 * far, 1.0 - far
        n = 4
    elif smaller > 0.0:
        for i in range(1, 3):
            if i * smaller < 1.0 - TOUCH:
                share[n] = i * smaller
                n += 1
        if two_sided and 1.0 - 2.0 * smaller > larger:
            share[n] = 0.5 + smaller  # midway between the last and the other vertex
            n += 1
        if smaller != near:  # counted from the other end
            for i in range((n + 1) // 2):
                share[i], share[n - 1 - i] = 1.0 - share[n - 1 - i], 1.0 - share[i]
    share[n] = 1.0
    return n + 1


@njit()
def quartic_spans(positions, turn, length_m, nominal_s, first, stop):
    """Return the pieces between two knots, their paces, and which of them are straight.

    Parameters
    ----------
    positions, turn, length_m, nominal_s
        Columns of the knots, as in ``Controls``; three on either side of the pieces unless the
        run begins or ends there.

    Returns
    -------
    coefficients, pace, straight
        (m, 5, axes); (m, 4) Bezier values of the time at the feed per unit of u, s; (m,).

    Notes
    -----
    Bezier points are the blossom of the spline at the two ends of the piece, by de Boor's triangle.
    Its weights are ratios of sums of legs, so that legs of very different lengths lose no digits.
    The time at the feed is treated as one more axis.
    """
    legs, axes = len(positions) - 1, positions.shape[1]
    coefficients = np.empty((stop - first, 5, axes))
    pace = np.empty((stop - first, 4))
    straight = np.empty(stop - first, dtype=np.bool_)
    h, displacement = np.empty(7), np.empty((7, axes + 1))
    leg_index, share = np.empty(5, dtype=np.int64), np.empty(5)
    bezier = np.empty((5, axes + 1))
    work = np.zeros((18, axes + 1))  # work arrays, allocated once
    for k in range(first, stop):
        m = k - first
        for i in range(7):
            leg = leg_of(k - 3 + i, legs)
            h[i] = length_m[leg + 1]
            for j in range(axes):
                displacement[i, j] = positions[leg + 1, j] - positions[leg, j]
            displacement[i, axes] = nominal_s[leg + 1]
        _means(h, leg_index, share)
        straight[m] = True
        for i in range(leg_index[0] + 1, leg_index[4] + 1):
            if turn[point_of(k - 3 + i, legs)] > 0.0:
                straight[m] = False
        if straight[m]:
            for j in range(axes):
                coefficients[m, 0, j], coefficients[m, 1, j] = positions[k, j], displacement[3, j]
                coefficients[m, 2, j], coefficients[m, 3, j], coefficients[m, 4, j] = 0.0, 0.0, 0.0
            for i in range(4):
                pace[m, i] = displacement[3, axes]
            continue
        _blossom(h, displacement, leg_index, share, bezier, work)
        for j in range(axes + 1):
            d0, d1 = bezier[1, j] - bezier[0, j], bezier[2, j] - bezier[1, j]
            d2, d3 = bezier[3, j] - bezier[2, j], bezier[4, j] - bezier[3, j]
            if j == axes:
                pace[m, 0], pace[m, 1], pace[m, 2], pace[m, 3] = 4 * d0, 4 * d1, 4 * d2, 4 * d3
                continue
            coefficients[m, 0, j] = positions[k, j] + bezier[0, j]
            coefficients[m, 1, j] = 4.0 * d0
            coefficients[m, 2, j] = 6.0 * (d1 - d0)
            coefficients[m, 3, j] = 4.0 * (d2 - 2.0 * d1 + d0)
            coefficients[m, 4, j] = d3 - 3.0 * d2 + 3.0 * d1 - d0
    return coefficients, pace, straight


@njit()
def _means(h, leg_index, share):
    """Write the leg, of seven legs ``h``, with the mean of four knots, and its share of that leg.

    The four knots begin with the first knot, the second, and so on to the fifth.
    """
    for i in range(5):
        mean = 0.25 * (3.0 * h[i] + 2.0 * h[i + 1] + h[i + 2])
        leg_index[i] = i
        if mean > h[i]:
            mean = 0.25 * (2.0 * h[i + 1] + h[i + 2] - h[i])
            leg_index[i] = i + 1
            if mean > h[i + 1]:
                mean = 0.25 * (h[i + 2] - h[i] - 2.0 * h[i + 1])
                leg_index[i] = i + 2
        share[i] = mean / h[leg_index[i]]


@njit()
def _blossom(h, displacement, leg_index, share, bezier, work):
    """Write the (5, columns) Bezier points of the piece on the fourth leg, from its start.

    ``displacement`` is (7, columns), one row for each leg; control point i is at ``share[i]`` of
    leg ``leg_index[i]``. ``work`` is (18, columns); its fourth row is 0.
    """
    knots, e, f = work[:8], work[8:13], work[13:18]  # knots; control points at both ends
    columns = displacement.shape[1]
    # Distances of knots from the ends of the piece.
    before_start, beyond_start = np.zeros(4), np.zeros(8)
    for i in range(3):
        before_start[2 - i] = before_start[3 - i] + h[2 - i]
        beyond_start[5 + i] = beyond_start[4 + i] + h[4 + i]
    for j in range(columns):
        for i in range(3):
            knots[2 - i, j] = knots[3 - i, j] - displacement[2 - i, j]
        for i in range(3, 7):
            knots[i + 1, j] = knots[i, j] + displacement[i, j]
        for i in range(5):
            e[i, j] = knots[leg_index[i], j] + share[i] * displacement[leg_index[i], j]
    for level in range(5):  # e: number of arguments at the start of the piece
        for i in range(level, 5):
            for j in range(columns):
                f[i, j] = e[i, j]
        for end_level in range(level + 1, 5):  # f: number of arguments at its end
            for i in range(4, end_level - 1, -1):
                left, right = before_start[i - 1] + h[3], beyond_start[i + 4 - end_level]
                first, last = right / (left + right), left / (left + right)
                for j in range(columns):
                    f[i, j] = first * f[i - 1, j] + last * f[i, j]
        for j in range(columns):
            bezier[4 - level, j] = f[4, j]
        for i in range(4, level, -1):
            left, right = before_start[i - 1], h[3] + beyond_start[i + 3 - level]
            first, last = right / (left + right), left / (left + right)
            for j in range(columns):
                e[i, j] = first * e[i - 1, j] + last * e[i, j]
