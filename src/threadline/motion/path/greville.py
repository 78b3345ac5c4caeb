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
        turned = turn[point_of(v - 3 + i, legs)]
        if turned > 0.0:
            for j in range(4):
                mean = 0.25 * (x[j] + x[j + 1] + x[j + 2] + x[j + 3])
                beyond = mean - x[i] if i >= 3 else x[i] - mean
                bound += turned * weight[j] * max(beyond, 0.0)
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
    own, beyond = (v, v + 1) if after else (v - 1, v - 2)
    if not 0 <= beyond < legs:
        return False
    # The same quotients as there, so that both decide alike at a limit.
    if length_m[beyond] / length_m[own] > _NEXT or 2.0 * (spacing / length_m[own]) < 1.0:
        return False
    begin, end = max(v - 3, 0), min(v + 3, legs)
    length, turned = np.empty(end - begin + 1), np.zeros(end - begin + 2)
    n = 0
    for c in range(begin, end):
        turned[n] = turn[c]
        length[n] = length_m[c]
        if c == own:
            length[n] *= 0.5
            n += 1
            length[n] = length[n - 1]
        n += 1
    turned[n] = turn[end]
    return cut_of(length, turned, v - begin + (0 if after else 1)) <= cut_m


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
    both = near > 0.0 and far > 0.0
    least, most = min(near, far) if both else max(near, far), max(near, far)
    even = 0  # number of equal parts of the leg
    if both and 2.0 * (near + far) >= 1.0 - TOUCH:
        even = 2 if most <= _NEXT else 3
        while even < 4 and even * least < 1.0 - TOUCH:
            even += 1
    elif not both and not opens and not closes and 3.0 * most >= 1.0:
        even = 2 if 2.0 * most >= 1.0 and beyond <= _NEXT else 3
    if even * least >= 1.0 - TOUCH:
        for i in range(1, even):
            share[n] = i / even
            n += 1
    elif both and even == 0:
        share[0], share[1], share[2], share[3] = near, 2.0 * near, 1.0 - 2.0 * far, 1.0 - far
        n = 4
    elif least > 0.0:
        for i in range(1, 3):
            if i * least < 1.0 - TOUCH:
                share[n] = i * least
                n += 1
        if both and 1.0 - 2.0 * least > most:
            share[n] = 0.5 + least  # midway between the last and the other vertex
            n += 1
        if least != near:  # counted from the other end
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
    out = np.empty((stop - first, 5, axes))
    pace = np.empty((stop - first, 4))
    straight = np.empty(stop - first, dtype=np.bool_)
    h, way = np.empty(7), np.empty((7, axes + 1))
    at, share = np.empty(5, dtype=np.int64), np.empty(5)
    bezier = np.empty((5, axes + 1))
    kept = np.zeros((18, axes + 1))  # work arrays, allocated once
    for k in range(first, stop):
        m = k - first
        for i in range(7):
            own = leg_of(k - 3 + i, legs)
            h[i] = length_m[own + 1]
            for j in range(axes):
                way[i, j] = positions[own + 1, j] - positions[own, j]
            way[i, axes] = nominal_s[own + 1]
        _means(h, at, share)
        straight[m] = True
        for i in range(at[0] + 1, at[4] + 1):
            if turn[point_of(k - 3 + i, legs)] > 0.0:
                straight[m] = False
        if straight[m]:
            for j in range(axes):
                out[m, 0, j], out[m, 1, j] = positions[k, j], way[3, j]
                out[m, 2, j], out[m, 3, j], out[m, 4, j] = 0.0, 0.0, 0.0
            for i in range(4):
                pace[m, i] = way[3, axes]
            continue
        _blossom(h, way, at, share, bezier, kept)
        for j in range(axes + 1):
            d0, d1 = bezier[1, j] - bezier[0, j], bezier[2, j] - bezier[1, j]
            d2, d3 = bezier[3, j] - bezier[2, j], bezier[4, j] - bezier[3, j]
            if j == axes:
                pace[m, 0], pace[m, 1], pace[m, 2], pace[m, 3] = 4 * d0, 4 * d1, 4 * d2, 4 * d3
                continue
            out[m, 0, j] = positions[k, j] + bezier[0, j]
            out[m, 1, j] = 4.0 * d0
            out[m, 2, j] = 6.0 * (d1 - d0)
            out[m, 3, j] = 4.0 * (d2 - 2.0 * d1 + d0)
            out[m, 4, j] = d3 - 3.0 * d2 + 3.0 * d1 - d0
    return out, pace, straight


@njit()
def _means(h, at, share):
    """Write the leg, of seven legs ``h``, with the mean of four knots, and its share of that leg.

    The four knots begin with the first knot, the second, and so on to the fifth.
    """
    for i in range(5):
        along = 0.25 * (3.0 * h[i] + 2.0 * h[i + 1] + h[i + 2])
        at[i] = i
        if along > h[i]:
            along = 0.25 * (2.0 * h[i + 1] + h[i + 2] - h[i])
            at[i] = i + 1
            if along > h[i + 1]:
                along = 0.25 * (h[i + 2] - h[i] - 2.0 * h[i + 1])
                at[i] = i + 2
        share[i] = along / h[at[i]]


@njit()
def _blossom(h, way, at, share, bezier, work):
    """Write the (5, columns) Bezier points of the piece on the fourth leg, from its start.

    ``way`` (7, columns) is the displacement on each leg; control point i is at ``share[i]`` of leg
    ``at[i]``. ``work`` is (18, columns); its fourth row is 0.
    """
    place, e, f = work[:8], work[8:13], work[13:18]  # knots; control points at both ends
    columns = way.shape[1]
    before, beyond = np.zeros(4), np.zeros(8)  # distances of knots from the ends of the piece
    for i in range(3):
        before[2 - i] = before[3 - i] + h[2 - i]
        beyond[5 + i] = beyond[4 + i] + h[4 + i]
    for j in range(columns):
        for i in range(3):
            place[2 - i, j] = place[3 - i, j] - way[2 - i, j]
        for i in range(3, 7):
            place[i + 1, j] = place[i, j] + way[i, j]
        for i in range(5):
            e[i, j] = place[at[i], j] + share[i] * way[at[i], j]
    for level in range(5):  # e: number of arguments at the start of the piece
        for i in range(level, 5):
            for j in range(columns):
                f[i, j] = e[i, j]
        for deeper in range(level + 1, 5):  # f: number of arguments at its end
            for i in range(4, deeper - 1, -1):
                left, right = before[i - 1] + h[3], beyond[i + 4 - deeper]
                first, last = right / (left + right), left / (left + right)
                for j in range(columns):
                    f[i, j] = first * f[i - 1, j] + last * f[i, j]
        for j in range(columns):
            bezier[4 - level, j] = f[4, j]
        for i in range(4, level, -1):
            left, right = before[i - 1], h[3] + beyond[i + 3 - level]
            first, last = right / (left + right), left / (left + right)
            for j in range(columns):
                e[i, j] = first * e[i - 1, j] + last * e[i, j]
