"""One Newton step of a barrier method on the rows of all elements.

The unknowns b are the (n + 2,) coefficients of a quadratic spline x over the common parameter, so
that the matrix of a step has two diagonals beside the main one. The duration of an element is at
most the mean of 1 / sqrt(y) over its Bernstein coefficients, because 1 / sqrt is convex: that
bound is what is made small, and no dip between nodes escapes it. The limit of the jerk,
|l| <= 1 / sqrt(y), is not convex; its right side lies above each of its tangents
``3/2 r - r^3 y / 2``, so that whatever keeps within a tangent keeps within the limit. What a drive
gives is bounded in the same way. The tangents follow the solution.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.compiled import njit
from threadline.trajectory.optimal.rows import WEIGHTS

_LEAST_PIVOT = 1e-13  # of the diagonal of the matrix: below is rounding
_HELD = 1e60
_SLACK_KEPT = 0.3  # of a slack when its tangent moves
_NEAR = 0.9  # of the way to the nearest limit


@njit()
def maps(length, i):
    """Return the five weights that take b[i : i + 3] to y0, y1, y2 of element i."""
    n = len(length)
    before = length[i - 1] if i > 0 else 0.0
    after = length[i + 1] if i < n - 1 else 0.0
    h = length[i]
    q = 1.0 / (h * h)
    return (
        h / (before + h) * q,
        before / (before + h) * q,
        q,
        after / (h + after) * q,
        h / (h + after) * q,
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
def room_of(row, y, tangent):
    """Return 1 less the share of its limit that a row of a drive uses."""
    used = 0.5 / tangent * row[6]
    for a in range(3):
        used += (row[a] + 0.5 * tangent * row[3 + a]) * y[a]
    return 1.0 - used


@njit()
def _add_demands(drive, y, tangent, weight, row, gy, hy):
    """Add what the rows of the drives give to the gradient and the upper half of the matrix."""
    for k in range(len(drive)):
        s = room_of(drive[k], y, tangent)
        part = weight / s
        for a in range(3):
            row[a] = drive[k, a] + 0.5 * tangent * drive[k, 3 + a]
        for a in range(3):
            gy[a] += part * row[a]
            for c in range(a, 3):
                hy[a, c] += part / s * row[a] * row[c]


@njit()
def derivatives(b, length, rows, tangent, weight):
    """Return matrix and gradient of duration - weight * sum(log(slack)).

    Entry (i, k) of the (n + 2, 3) matrix is that of row i and column i + k.
    """
    acc, jerk, points, count, top, drive, begin = rows
    n = len(length)
    size = n + 2
    g = np.zeros(size)
    matrix = np.zeros((size, 3))
    gy, hy, row, y, p = np.zeros(3), np.zeros((3, 3)), np.zeros(3), np.zeros(3), np.zeros((3, 3))
    for i in range(n):
        m00, m01, m11, m21, m22 = maps(length, i)
        p[0, 0], p[0, 1], p[1, 1], p[2, 1], p[2, 2] = m00, m01, m11, m21, m22
        y[0], y[1] = m00 * b[i] + m01 * b[i + 1], m11 * b[i + 1]
        y[2] = m21 * b[i + 1] + m22 * b[i + 2]
        hy[:] = 0.0
        for a in range(3):
            time = 1.0 / (3.0 * np.sqrt(y[a]))
            gy[a] = -0.5 * time / y[a]
            hy[a, a] = 0.75 * time / (y[a] * y[a])
            if top[i] < np.inf:
                s = top[i] - y[a]
                gy[a] += weight / s
                hy[a, a] += weight / (s * s)
        gy[1] -= weight / y[1]
        hy[1, 1] += weight / (y[1] * y[1])
        for k in range(count[i, 0]):
            r = acc[i, k]
            v = r[0] * y[0] + r[1] * y[1] + r[2] * y[2]
            s1, s2 = 1.0 - v, 1.0 + v
            first = weight * (1.0 / s1 - 1.0 / s2)
            second = weight * (1.0 / (s1 * s1) + 1.0 / (s2 * s2))
            for a in range(3):
                gy[a] += first * r[a]
                for c in range(a, 3):
                    hy[a, c] += second * r[a] * r[c]
        t0, t1 = 1.5 * tangent[i], 0.5 * tangent[i] ** 3
        for k in range(count[i, 1]):
            r = jerk[i, k]
            w = WEIGHTS[points[i, k]]
            v = r[0] * y[0] + r[1] * y[1] + r[2] * y[2]
            room = t0 - t1 * (w[0] * y[0] + w[1] * y[1] + w[2] * y[2])
            for side in range(2):
                sign = 1.0 if side == 0 else -1.0
                s = room - sign * v
                part = weight / s
                for a in range(3):
                    row[a] = -t1 * w[a] - sign * r[a]
                for a in range(3):
                    gy[a] -= part * row[a]
                    for c in range(a, 3):
                        hy[a, c] += part / s * row[a] * row[c]
        _add_demands(drive[begin[i] : begin[i + 1]], y, tangent[i], weight, row, gy, hy)
        for a in range(3):
            for c in range(a):
                hy[a, c] = hy[c, a]
        for a in range(3):
            slope = 0.0
            for k in range(3):
                slope += p[k, a] * gy[k]
            g[i + a] += slope
            for c in range(a, 3):
                bend = 0.0
                for k in range(3):
                    for m in range(3):
                        bend += p[k, a] * hy[k, m] * p[m, c]
                matrix[i + a, c - a] += bend
    return matrix, g


@njit()
def solved(matrix, g):
    """Return z of ``matrix z = -g`` by L D L'; entry (i, k) is that of row i and column i + k."""
    z = np.empty(len(g))
    one, two, d = _factors(matrix)
    _substitute(one, two, d, g, z)
    return z


@njit()
def halved(matrix, rows):
    """Return ``rows L'^-1 D^-1/2`` of ``matrix = L D L'``: times its transpose, rows B^-1 rows'."""
    out = np.empty(rows.shape)
    one, two, d = _factors(matrix)
    root = 1.0 / np.sqrt(d)
    for r in range(len(rows)):
        before, last = 0.0, 0.0
        for i in range(len(d)):
            v = rows[r, i]
            if i >= 1:
                v -= one[i] * last
            if i >= 2:
                v -= two[i] * before
            before, last = last, v
            out[r, i] = v * root[i]
    return out


@njit()
def _factors(matrix):
    """Return the two diagonals of L and that of D."""
    size = len(matrix)
    one, two, d = np.zeros(size), np.zeros(size), np.zeros(size)
    for i in range(size):
        pivot = matrix[i, 0]
        if i >= 2:
            two[i] = matrix[i - 2, 2] / d[i - 2]
            pivot -= two[i] * two[i] * d[i - 2]
        if i >= 1:
            side = matrix[i - 1, 1]
            if i >= 2:
                side -= two[i] * d[i - 2] * one[i - 1]
            one[i] = side / d[i - 1]
            pivot -= one[i] * one[i] * d[i - 1]
        # A pivot of which rounding left nothing: that unknown stays where it is in this step.
        d[i] = pivot if pivot > _LEAST_PIVOT * matrix[i, 0] else _HELD * matrix[i, 0]
    return one, two, d


@njit()
def _substitute(one, two, d, g, z):
    """Write the z of ``L D L' z = -g``."""
    size = len(g)
    for i in range(size):
        v = -g[i]
        if i >= 1:
            v -= one[i] * z[i - 1]
        if i >= 2:
            v -= two[i] * z[i - 2]
        z[i] = v
    for i in range(size - 1, -1, -1):
        v = z[i] / d[i]
        if i + 1 < size:
            v -= one[i + 1] * z[i + 1]
        if i + 2 < size:
            v -= two[i + 2] * z[i + 2]
        z[i] = v


@njit()
def _hold(matrix, g, i):
    """Take unknown ``i`` out of a step: it stays as it is."""
    g[i] = 0.0
    matrix[i, 0], matrix[i, 1], matrix[i, 2] = 1.0, 0.0, 0.0
    if i >= 1:
        matrix[i - 1, 1] = 0.0
    if i >= 2:
        matrix[i - 2, 2] = 0.0


@njit()
def newton(b, length, rows, tangent, weight, held):
    """Return the Newton step of duration - weight * sum(log(slack)), and its decrement.

    ``held`` are the numbers of the first and of the last unknowns that stay as they are.
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
def _far(y, dy, acc, jerk, points, count, top, drive, tangent):
    """Return how far along dy the y of one element may go before it reaches a limit."""
    best = 1e300
    for a in range(3):
        if dy[a] < 0.0:
            best = min(best, -y[a] / dy[a])
        elif dy[a] > 0.0 and top < np.inf:
            best = min(best, (top - y[a]) / dy[a])
    for k in range(count[0]):
        r = acc[k]
        v = r[0] * y[0] + r[1] * y[1] + r[2] * y[2]
        dv = r[0] * dy[0] + r[1] * dy[1] + r[2] * dy[2]
        if dv > 0.0:
            best = min(best, (1.0 - v) / dv)
        elif dv < 0.0:
            best = min(best, (1.0 + v) / -dv)
    t0, t1 = 1.5 * tangent, 0.5 * tangent**3
    for k in range(count[1]):
        r = jerk[k]
        w = WEIGHTS[points[k]]
        v = r[0] * y[0] + r[1] * y[1] + r[2] * y[2]
        dv = r[0] * dy[0] + r[1] * dy[1] + r[2] * dy[2]
        room = t0 - t1 * (w[0] * y[0] + w[1] * y[1] + w[2] * y[2])
        less = t1 * (w[0] * dy[0] + w[1] * dy[1] + w[2] * dy[2])
        if dv + less > 0.0:
            best = min(best, (room - v) / (dv + less))
        if less - dv > 0.0:
            best = min(best, (room + v) / (less - dv))
    for k in range(len(drive)):
        dv = 0.0
        for a in range(3):
            dv += (drive[k, a] + 0.5 * tangent * drive[k, 3 + a]) * dy[a]
        if dv > 0.0:
            best = min(best, room_of(drive[k], y, tangent) / dv)
    return best


@njit()
def advance(b, step, length, rows, tangent):
    """Go along the step as far as the slacks allow; change b, and return the share taken.

    Where rounding has left no room to a limit, the share is not above 0 and b stays as it is: a
    slack of -1e-16 over a change of 1e-30 would be a step of 1e14 backwards.
    """
    acc, jerk, points, count, top, drive, begin = rows
    best = 1e300
    y, dy = np.zeros(3), np.zeros(3)
    for i in range(len(length)):
        y[0], y[1], y[2] = values(b, length, i)
        dy[0], dy[1], dy[2] = values(step, length, i)
        own = drive[begin[i] : begin[i + 1]]
        far = _far(y, dy, acc[i], jerk[i], points[i], count[i], top[i], own, tangent[i])
        best = min(best, far)
    share = min(1.0, _NEAR * best)
    if share > 0.0:
        for k in range(len(b)):
            b[k] += share * step[k]
    return share


@njit()
def follow(b, length, rows, tangent):
    """Move each tangent towards the present y, as far as the slacks that depend on it allow."""
    _, jerk, points, count, _, drive, begin = rows
    y = np.zeros(3)
    for i in range(len(length)):
        if count[i, 1] == 0 and begin[i] == begin[i + 1]:
            continue
        y[0], y[1], y[2] = values(b, length, i)
        old = tangent[i]
        new = ((y[0] + y[1] + y[2]) / 3.0) ** -0.5
        for _ in range(6):
            sound = True
            for k in range(count[i, 1]):
                r = jerk[i, k]
                w = WEIGHTS[points[i, k]]
                v = abs(r[0] * y[0] + r[1] * y[1] + r[2] * y[2])
                at = w[0] * y[0] + w[1] * y[1] + w[2] * y[2]
                before = 1.5 * old - 0.5 * old**3 * at - v
                if 1.5 * new - 0.5 * new**3 * at - v < _SLACK_KEPT * before:
                    sound = False
                    break
            if sound:
                for k in range(begin[i], begin[i + 1]):
                    if room_of(drive[k], y, new) < _SLACK_KEPT * room_of(drive[k], y, old):
                        sound = False
                        break
            if sound:
                tangent[i] = new
                break
            new = 0.5 * (new + old)
