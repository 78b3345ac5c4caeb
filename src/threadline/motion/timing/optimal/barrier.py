"""One Newton step of a barrier method on the rows of all elements.

The unknowns b are the (n + 2,) coefficients of a quadratic spline x over the common parameter, so
that the matrix of a step has two diagonals beside the main one. The duration of an element is at
most the mean of 1 / sqrt(y) over its Bernstein coefficients, because 1 / sqrt is convex: that
bound is minimised, and no dip between nodes escapes it. The jerk limit, |l| <= 1 / sqrt(y), is not
convex; its right side lies above each of its tangents ``3/2 r - r^3 y / 2``, so that keeping a
tangent keeps the limit. The demand on a drive is bounded in the same way. The tangents follow the
solution.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.base.compiled import njit
from threadline.motion.timing.optimal.rows import WEIGHTS

_LEAST_PIVOT = 1e-13  # of the diagonal of the matrix: smaller ones are rounding
_HELD = 1e60
_SLACK_SHARE = 0.3  # of a slack when its tangent moves
_NEAR = 0.9  # of the distance to the nearest limit


@njit()
def maps(length, i):
    """Return the five weights that map b[i : i + 3] to y0, y1, y2 of element i."""
    n = len(length)
    h_before = length[i - 1] if i > 0 else 0.0
    h_after = length[i + 1] if i < n - 1 else 0.0
    h = length[i]
    q = 1.0 / (h * h)
    return (
        h / (h_before + h) * q,
        h_before / (h_before + h) * q,
        q,
        h_after / (h + h_after) * q,
        h / (h + h_after) * q,
    )


@njit()
def values(b, length, i):
    """Return y0, y1, y2 of element i."""
    m00, m01, m11, m21, m22 = maps(length, i)
    return m00 * b[i] + m01 * b[i + 1], m11 * b[i + 1], m21 * b[i + 1] + m22 * b[i + 2]


@njit()
def duration(b, length):
    """Return an upper bound of the time that all elements take."""
    total = 0.0
    for i in range(len(length)):
        y0, y1, y2 = values(b, length, i)
        total += (y0**-0.5 + y1**-0.5 + y2**-0.5) / 3.0
    return total


@njit()
def room_of(row, y0, y1, y2, tangent):
    """Return 1 less the share of its limit that a row of a drive uses."""
    slope = 0.5 * tangent
    used = 0.5 / tangent * row[6] + (row[0] + slope * row[3]) * y0
    return 1.0 - (used + (row[1] + slope * row[4]) * y1 + (row[2] + slope * row[5]) * y2)


@njit()
def derivatives(b, length, rows, tangent, weight):
    """Return matrix and gradient of duration - weight * sum(log(slack)).

    Entry (i, k) of the (n + 2, 3) matrix belongs to row i and column i + k. Contributions of an
    element stay in scalars until its last row: array entries would be written for each row.
    """
    acc, jerk, points, count, top, drive, begin = rows
    n = len(length)
    g, matrix = np.zeros(n + 2), np.zeros((n + 2, 3))
    for i in range(n):
        m00, m01, m11, m21, m22 = maps(length, i)
        y0, y1, y2 = values(b, length, i)
        g0, h00 = _of_time(y0, top[i], weight)
        g1, h11 = _of_time(y1, top[i], weight)
        g2, h22 = _of_time(y2, top[i], weight)
        sums = g0, g1 - weight / y1, g2, h00, 0.0, 0.0, h11 + weight / (y1 * y1), 0.0, h22
        for k in range(count[i, 0]):
            r0, r1, r2 = acc[i, k, 0], acc[i, k, 1], acc[i, k, 2]
            v = r0 * y0 + r1 * y1 + r2 * y2
            inverse_less, inverse_more = _inverses(1.0 - v, 1.0 + v)
            sums = _with(
                sums,
                weight * (inverse_less - inverse_more),
                weight * (inverse_less * inverse_less + inverse_more * inverse_more),
                r0,
                r1,
                r2,
            )
        t0, t1 = 1.5 * tangent[i], 0.5 * tangent[i] ** 3
        for k in range(count[i, 1]):
            r0, r1, r2 = jerk[i, k, 0], jerk[i, k, 1], jerk[i, k, 2]
            w = WEIGHTS[points[i, k]]
            w0, w1, w2 = t1 * w[0], t1 * w[1], t1 * w[2]
            v = r0 * y0 + r1 * y1 + r2 * y2
            room = t0 - t1 * (w[0] * y0 + w[1] * y1 + w[2] * y2)
            inverse_less, inverse_more = _inverses(room - v, room + v)
            less_part, more_part = weight * inverse_less, weight * inverse_more
            sums = _with(sums, less_part, less_part * inverse_less, w0 + r0, w1 + r1, w2 + r2)
            sums = _with(sums, more_part, more_part * inverse_more, w0 - r0, w1 - r1, w2 - r2)
        slope = 0.5 * tangent[i]
        for k in range(begin[i], begin[i + 1]):
            r, s = drive[k], room_of(drive[k], y0, y1, y2, tangent[i])
            d0, d1, d2 = r[0] + slope * r[3], r[1] + slope * r[4], r[2] + slope * r[5]
            sums = _with(sums, weight / s, weight / s / s, d0, d1, d2)
        g0, g1, g2, h00, h01, h02, h11, h12, h22 = sums
        # From y to b: P' g and P' H P, where P has the weights in its columns (m00, 0, 0),
        # (m01, m11, m21) and (0, 0, m22).
        g[i] += m00 * g0
        g[i + 1] += m01 * g0 + m11 * g1 + m21 * g2
        g[i + 2] += m22 * g2
        c0 = h00 * m01 + h01 * m11 + h02 * m21
        c1 = h01 * m01 + h11 * m11 + h12 * m21
        c2 = h02 * m01 + h12 * m11 + h22 * m21
        matrix[i, 0] += m00 * h00 * m00
        matrix[i, 1] += m00 * c0
        matrix[i, 2] += m00 * h02 * m22
        matrix[i + 1, 0] += m01 * c0 + m11 * c1 + m21 * c2
        matrix[i + 1, 1] += m22 * c2
        matrix[i + 2, 0] += m22 * h22 * m22
    return matrix, g


@njit()
def _with(sums, slope, bend, r0, r1, r2):
    """Return the gradient and the upper half of the matrix of one element with one more row."""
    g0, g1, g2, h00, h01, h02, h11, h12, h22 = sums
    p0, p1, p2 = bend * r0, bend * r1, bend * r2
    return (
        g0 + slope * r0, g1 + slope * r1, g2 + slope * r2,
        h00 + p0 * r0, h01 + p0 * r1, h02 + p0 * r2,
        h11 + p1 * r1, h12 + p1 * r2, h22 + p2 * r2,
    )  # fmt: skip


@njit()
def _inverses(first, second):
    """Return 1 / one and 1 / other with one division, which takes as long as twenty products."""
    inverse = 1.0 / (first * second)
    return second * inverse, first * inverse


@njit()
def _of_time(y, top, weight):
    """Return slope and bend of the duration's share of one y, and of its upper limit."""
    time = 1.0 / (3.0 * np.sqrt(y))
    slope = -0.5 * time / y
    bend = 0.75 * time / (y * y)
    if top < np.inf:
        s = top - y
        slope += weight / s
        bend += weight / (s * s)
    return slope, bend


@njit()
def solved(matrix, g):
    """Return z of ``matrix z = -g`` by L D L'; entry (i, k) belongs to row i and column i + k."""
    z = np.empty(len(g))
    first_diagonal, second_diagonal, d = _factors(matrix)
    _substitute(first_diagonal, second_diagonal, d, g, z)
    return z


@njit()
def halved(matrix, rows):
    """Return ``rows L'^-1 D^-1/2`` of ``matrix = L D L'``: times its transpose, rows B^-1 rows'."""
    out = np.empty(rows.shape)
    first_diagonal, second_diagonal, d = _factors(matrix)
    root = 1.0 / np.sqrt(d)
    for r in range(len(rows)):
        z_before, z_last = 0.0, 0.0
        for i in range(len(d)):
            v = rows[r, i]
            if i >= 1:
                v -= first_diagonal[i] * z_last
            if i >= 2:
                v -= second_diagonal[i] * z_before
            z_before, z_last = z_last, v
            out[r, i] = v * root[i]
    return out


@njit()
def _factors(matrix):
    """Return the two diagonals of L and the diagonal of D."""
    size = len(matrix)
    first_diagonal, second_diagonal, d = np.zeros(size), np.zeros(size), np.zeros(size)
    for i in range(size):
        pivot = matrix[i, 0]
        if i >= 2:
            second_diagonal[i] = matrix[i - 2, 2] / d[i - 2]
            pivot -= second_diagonal[i] * second_diagonal[i] * d[i - 2]
        if i >= 1:
            entry = matrix[i - 1, 1]
            if i >= 2:
                entry -= second_diagonal[i] * d[i - 2] * first_diagonal[i - 1]
            first_diagonal[i] = entry / d[i - 1]
            pivot -= first_diagonal[i] * first_diagonal[i] * d[i - 1]
        # A pivot lost to rounding: that unknown stays unchanged in this step.
        d[i] = pivot if pivot > _LEAST_PIVOT * matrix[i, 0] else _HELD * matrix[i, 0]
    return first_diagonal, second_diagonal, d


@njit()
def _substitute(first_diagonal, second_diagonal, d, g, z):
    """Write the z of ``L D L' z = -g``."""
    size = len(g)
    for i in range(size):
        v = -g[i]
        if i >= 1:
            v -= first_diagonal[i] * z[i - 1]
        if i >= 2:
            v -= second_diagonal[i] * z[i - 2]
        z[i] = v
    for i in range(size - 1, -1, -1):
        v = z[i] / d[i]
        if i + 1 < size:
            v -= first_diagonal[i + 1] * z[i + 1]
        if i + 2 < size:
            v -= second_diagonal[i + 2] * z[i + 2]
        z[i] = v


@njit()
def _hold(matrix, g, i):
    """Remove unknown ``i`` from a step: it stays unchanged."""
    g[i] = 0.0
    matrix[i, 0], matrix[i, 1], matrix[i, 2] = 1.0, 0.0, 0.0
    if i >= 1:
        matrix[i - 1, 1] = 0.0
    if i >= 2:
        matrix[i - 2, 2] = 0.0


@njit()
def newton(b, length, rows, tangent, weight, held):
    """Return the Newton step of duration - weight * sum(log(slack)), and its decrement.

    ``held`` are the numbers of first and last unknowns that stay unchanged.
    """
    matrix, g = derivatives(b, length, rows, tangent, weight)
    for i in range(held[0]):
        _hold(matrix, g, i)
    for i in range(len(g) - held[1], len(g)):
        _hold(matrix, g, i)
    step = solved(matrix, g)
    decrement = 0.0
    for i in range(len(g)):
        decrement -= g[i] * step[i]
    return step, decrement


@njit()
def _far(b, step, length, rows, tangent, i):
    """Return how far along the step the y of element ``i`` may go before it reaches a limit."""
    acc, jerk, points, count, top, drive, begin = rows
    y0, y1, y2 = values(b, length, i)
    d0, d1, d2 = values(step, length, i)
    largest_step = 1e300
    for y, dy in ((y0, d0), (y1, d1), (y2, d2)):
        if dy < 0.0:
            largest_step = min(largest_step, -y / dy)
        elif dy > 0.0 and top[i] < np.inf:
            largest_step = min(largest_step, (top[i] - y) / dy)
    for k in range(count[i, 0]):
        r0, r1, r2 = acc[i, k, 0], acc[i, k, 1], acc[i, k, 2]
        v = r0 * y0 + r1 * y1 + r2 * y2
        dv = r0 * d0 + r1 * d1 + r2 * d2
        room = 1.0 - v if dv > 0.0 else 1.0 + v
        if (dv != 0.0) & (room < largest_step * abs(dv)):
            largest_step = room / abs(dv)
    t0, t1 = 1.5 * tangent[i], 0.5 * tangent[i] ** 3
    for k in range(count[i, 1]):
        r0, r1, r2 = jerk[i, k, 0], jerk[i, k, 1], jerk[i, k, 2]
        w = WEIGHTS[points[i, k]]
        v = r0 * y0 + r1 * y1 + r2 * y2
        dv = r0 * d0 + r1 * d1 + r2 * d2
        room = t0 - t1 * (w[0] * y0 + w[1] * y1 + w[2] * y2)
        right_change = t1 * (w[0] * d0 + w[1] * d1 + w[2] * d2)
        if (dv + right_change > 0.0) & (room - v < largest_step * (dv + right_change)):
            largest_step = (room - v) / (dv + right_change)
        if (right_change - dv > 0.0) & (room + v < largest_step * (right_change - dv)):
            largest_step = (room + v) / (right_change - dv)
    slope = 0.5 * tangent[i]
    for k in range(begin[i], begin[i + 1]):
        r = drive[k]
        dv = (r[0] + slope * r[3]) * d0 + (r[1] + slope * r[4]) * d1 + (r[2] + slope * r[5]) * d2
        if dv > 0.0:
            largest_step = min(largest_step, room_of(r, y0, y1, y2, tangent[i]) / dv)
    return largest_step


@njit()
def advance(b, step, length, rows, tangent):
    """Go along the step as far as the slacks allow; change b, and return the share taken.

    If rounding has left no room to a limit, the share is not above 0 and b stays unchanged: a
    slack of -1e-16 over a change of 1e-30 would be a step of 1e14 backwards.
    """
    largest_step = 1e300
    for i in range(len(length)):
        largest_step = min(largest_step, _far(b, step, length, rows, tangent, i))
    share = min(1.0, _NEAR * largest_step)
    if share > 0.0:
        for k in range(len(b)):
            b[k] += share * step[k]
    return share


@njit()
def follow(b, length, rows, tangent):
    """Move each tangent towards the present y, as far as the slacks that depend on it allow."""
    _, jerk, points, count, _, drive, begin = rows
    for i in range(len(length)):
        if count[i, 1] == 0 and begin[i] == begin[i + 1]:
            continue
        y0, y1, y2 = values(b, length, i)
        old = tangent[i]
        new = ((y0 + y1 + y2) / 3.0) ** -0.5
        for _ in range(6):
            sound = True
            for k in range(count[i, 1]):
                w = WEIGHTS[points[i, k]]
                v = abs(jerk[i, k, 0] * y0 + jerk[i, k, 1] * y1 + jerk[i, k, 2] * y2)
                at = w[0] * y0 + w[1] * y1 + w[2] * y2
                before = 1.5 * old - 0.5 * old**3 * at - v
                if 1.5 * new - 0.5 * new**3 * at - v < _SLACK_SHARE * before:
                    sound = False
                    break
            if sound:
                for k in range(begin[i], begin[i + 1]):
                    before = room_of(drive[k], y0, y1, y2, old)
                    if room_of(drive[k], y0, y1, y2, new) < _SLACK_SHARE * before:
                        sound = False
                        break
            if sound:
                tangent[i] = new
                break
            new = 0.5 * (new + old)
