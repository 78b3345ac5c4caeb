"""How much of each limit a motion uses along its elements."""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.compiled import njit
from threadline.trajectory.optimal.rows import ORDER


@njit()
def shares(c, guard, y, limit_v, limit_a, limit_j, demand, cap, places):
    """Return the (n, places, 3 axes + 1 + m + k) shares of the limits at ``places`` in [0, 1].

    Velocity, acceleration and jerk of the first axis, of the next, ..., the feed, the largest of
    each of m demands on a drive, and each of k guards. The jerk at a node is that of the element
    in hand.
    """
    n, axes = len(c), c.shape[2]
    behind = 3 * axes + 1
    out = np.zeros((n, len(places), behind + len(demand) + guard.shape[2]))
    for i in range(n):
        for k in range(len(places)):
            u = places[k]
            now = (1 - u) ** 2 * y[i, 0] + 2 * u * (1 - u) * y[i, 1] + u * u * y[i, 2]
            rate = 2 * ((1 - u) * (y[i, 1] - y[i, 0]) + u * (y[i, 2] - y[i, 1]))
            bend = 2 * (y[i, 0] - 2 * y[i, 1] + y[i, 2])
            root = np.sqrt(now)
            for j in range(axes):
                first, second, third = 0.0, 0.0, 0.0
                for m in range(ORDER - 1, 0, -1):
                    first = first * u + m * c[i, m, j]
                    if m >= 2:
                        second = second * u + m * (m - 1) * c[i, m, j]
                    if m >= 3:
                        third = third * u + m * (m - 1) * (m - 2) * c[i, m, j]
                out[i, k, 3 * j] = abs(first) * root / limit_v[j]
                out[i, k, 3 * j + 1] = abs(second * now + 0.5 * first * rate) / limit_a[j]
                jerk = root * (third * now + 1.5 * second * rate + 0.5 * first * bend)
                out[i, k, 3 * j + 2] = abs(jerk) / limit_j[j]
                for m in range(len(demand)):
                    asked = demand[m, j, 0] * first * root
                    asked += demand[m, j, 1] * (second * now + 0.5 * first * rate)
                    out[i, k, behind + m] = max(out[i, k, behind + m], abs(asked))
            out[i, k, 3 * axes] = root / np.sqrt(cap[i])
            for j in range(guard.shape[2]):
                first, second = 0.0, 0.0
                for m in range(ORDER - 1, 0, -1):
                    first = first * u + m * guard[i, m, j]
                    if m >= 2:
                        second = second * u + m * (m - 1) * guard[i, m, j]
                out[i, k, behind + len(demand) + j] = abs(second * now + 0.5 * first * rate)
    return out
