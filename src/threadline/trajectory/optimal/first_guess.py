"""A motion within all limits to begin with: slow, but of about the right shape."""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.compiled import njit
from threadline.trajectory.optimal.barrier import room_of, values
from threadline.trajectory.optimal.rows import WEIGHTS

_SHARE = 0.25  # of the accelerations, on the way
_USED = 0.7  # of a limit, at most
_ROUNDS = 60
_GROWTH = 3.0  # of x from element to element
_DIGITS = float(np.finfo(np.float64).eps)


@njit()
def even(length, c, guard, limit_v, limit_a, limit_j, demand, cap):
    """Return the (n,) largest even x, in units of the common parameter, that each element allows.

    At an even rate of the parameter the motion keeps within every limit.
    """
    n, order, axes = c.shape
    out = np.empty(n)
    for i in range(n):
        y = cap[i]
        for j in range(axes):
            v, a, q = 0.0, 0.0, 0.0
            for k in range(1, order):
                size = abs(c[i, k, j])
                v += k * size
                a += k * (k - 1) * size
                q += k * (k - 1) * (k - 2) * size
            if v > 0.0:
                y = min(y, (limit_v[j] / v) ** 2)
            for m in range(len(demand)):
                if demand[m, j, 0] * v > 0.0:
                    y = min(y, (0.5 / (demand[m, j, 0] * v)) ** 2)
                if demand[m, j, 1] * a > 0.0:
                    y = min(y, 0.5 / (demand[m, j, 1] * a))
            if a > 0.0:
                y = min(y, limit_a[j] / a)
            if q > 0.0 and limit_j[j] < np.inf:
                y = min(y, (limit_j[j] / q) ** (2.0 / 3.0))
        for j in range(guard.shape[2]):
            a = 0.0
            for k in range(2, order):
                a += k * (k - 1) * abs(guard[i, k, j])
            if a > 0.0:
                y = min(y, 1.0 / a)
        out[i] = y * length[i] ** 2
    return out


@njit()
def used(b, length, rows, tangent, out, anew):
    """Write the (n,) largest shares of a limit into ``out``; return the largest of all.

    ``anew`` says whether each tangent is put to its best first.
    """
    acc, jerk, points, count, top, drive, begin = rows
    worst = 0.0
    for i in range(len(length)):
        y0, y1, y2 = values(b, length, i)
        share = 0.0
        if top[i] < np.inf:
            share = max(y0, y1, y2) / top[i]
        for k in range(count[i, 0]):
            share = max(share, abs(acc[i, k, 0] * y0 + acc[i, k, 1] * y1 + acc[i, k, 2] * y2))
        if anew:
            tangent[i] = ((y0 + y1 + y2) / 3.0) ** -0.5
        t0, t1 = 1.5 * tangent[i], 0.5 * tangent[i] ** 3
        for k in range(count[i, 1]):
            w = WEIGHTS[points[i, k]]
            room = t0 - t1 * (w[0] * y0 + w[1] * y1 + w[2] * y2)
            v = abs(jerk[i, k, 0] * y0 + jerk[i, k, 1] * y1 + jerk[i, k, 2] * y2)
            share = max(share, v / room if room > 0.0 else np.inf)
        for k in range(begin[i], begin[i + 1]):
            share = max(share, 1.0 - room_of(drive[k], y0, y1, y2, tangent[i]))
        out[i] = share
        worst = max(worst, share)
    return worst


@njit()
def roundings(b, length, rows):
    """Return the (n,) shares of a limit by which the digits of y round the rows of an element."""
    acc, jerk, count = rows[0], rows[1], rows[3]
    out = np.empty(len(length))
    for i in range(len(length)):
        y0, y1, y2 = values(b, length, i)
        y = max(y0, y1, y2)
        steep, steep_jerk = 0.0, 0.0
        for k in range(count[i, 0]):
            r0, r1, r2 = acc[i, k, 0], acc[i, k, 1], acc[i, k, 2]
            steep = max(steep, abs(r0), abs(r1), abs(r2))
        for k in range(count[i, 1]):
            r0, r1, r2 = jerk[i, k, 0], jerk[i, k, 1], jerk[i, k, 2]
            steep_jerk = max(steep_jerk, abs(r0), abs(r1), abs(r2))
        out[i] = _DIGITS * max(steep, steep_jerk * np.sqrt(y)) * y
    return out


@njit()
def feasible(length, rows, most):
    """Return coefficients b and tangents within all limits.

    Parameters
    ----------
    most
        (n,) largest even x of each element, by ``even``.
    """
    acc, count = rows[0], rows[3]
    n = len(length)
    tangent, share = np.empty(n), np.empty(n)
    node = np.empty(n + 1)
    gain = np.empty(n)  # largest change of x over an element by its acceleration
    for i in range(n):
        steep = 0.0
        for k in range(count[i, 0]):
            r = acc[i, k]
            steep = max(steep, abs(r[0]), abs(r[1]), abs(r[2]))
        gain[i] = _SHARE / steep * length[i] ** 2 if steep > 0.0 else np.inf
    cap = most.copy()
    b = np.empty(n + 2)
    for _ in range(_ROUNDS):
        node[0], node[n] = cap[0], cap[n - 1]
        for i in range(1, n):
            node[i] = min(cap[i - 1], cap[i])
        for i in range(n):
            node[i + 1] = min(node[i + 1], node[i] + gain[i], _GROWTH * node[i])
        for i in range(n - 1, -1, -1):
            node[i] = min(node[i], node[i + 1] + gain[i], _GROWTH * node[i + 1])
        for i in range(n + 2):
            b[i] = 0.5 * (node[max(i - 1, 0)] + node[min(i, n)])
        if used(b, length, rows, tangent, share, True) < _USED:
            return b, tangent
        for i in range(n):
            if share[i] >= _USED:
                reach = max(b[i], b[i + 1], b[i + 2])
                for k in range(max(i - 1, 0), min(i + 2, n)):
                    cap[k] = min(cap[k], 0.6 * reach)
    lowest = most[0]
    for i in range(n):
        lowest = min(lowest, most[i])
    b[:] = 0.4 * lowest
    used(b, length, rows, tangent, share, True)
    return b, tangent
