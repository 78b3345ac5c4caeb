"""Axes that brake otherwise than they speed up: their limits on one element, each for its side.

Where the velocity of an axis keeps its sign within an element, its acceleration in that direction
speeds it up and the other one brakes it; where it turns back, the lower limit holds both ways. The
rows of the accelerations hold the higher limit, and those here the lower one.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.compiled import njit
from threadline.trajectory.optimal.rows import ORDER, acceleration_rows, bernstein_of, degree_of

_COLUMNS = 7  # of a row of a drive, whose last four stand with the tangent of a velocity


@njit()
def direction_of(c, j):
    """Return 1 where axis ``j`` nowhere goes back, -1 where it nowhere goes on, else 0."""
    degree = degree_of(c, j)
    slope, one = np.zeros(ORDER), np.zeros(ORDER)
    for k in range(degree):
        slope[k] = (k + 1) * c[k + 1, j]
    bernstein_of(slope, degree - 1, one)
    if one.min() >= 0.0:
        return 1.0
    return -1.0 if one.max() <= 0.0 else 0.0


@njit()
def with_braking(drive, begin, c, speeding, braking):
    """Return the rows of the drives with those of the lower limits, and where each element begins.

    Parameters
    ----------
    drive, begin
        As of ``demand_rows``.
    speeding, braking
        (axes,) limits of the acceleration that makes an axis faster, and slower.
    """
    n, axes = len(c), c.shape[2]
    out = np.zeros((len(drive) + n * axes * 2 * ORDER, _COLUMNS))
    first = np.zeros(n + 1, dtype=np.int64)
    own = np.zeros((ORDER, 3))
    used = 0
    for i in range(n):
        for k in range(begin[i], begin[i + 1]):
            for a in range(_COLUMNS):  # an assignment of the row takes seconds to compile
                out[used, a] = drive[k, a]
            used += 1
        for j in range(axes):
            degree = degree_of(c[i], j)
            if degree == 0 or speeding[j] == braking[j]:
                continue
            least = min(speeding[j], braking[j])
            rows = acceleration_rows(c[i], j, degree, least, own)
            # Against the motion where braking is the weaker, with it where speeding up is.
            side = direction_of(c[i], j) * (1.0 if speeding[j] < braking[j] else -1.0)
            for sign in (1.0, -1.0):
                if side * sign < 0.0:
                    continue
                for k in range(rows):
                    for a in range(3):
                        out[used, a] = sign * own[k, a]
                    used += 1
        first[i + 1] = used
    return out[:used].copy(), first


@njit()
def braking_shares(c, y, speeding, braking, places):
    """Return the (n, places, axes) shares of the limit of its side that each acceleration uses."""
    n, axes = len(c), c.shape[2]
    out = np.zeros((n, len(places), axes))
    for i in range(n):
        for k in range(len(places)):
            u = places[k]
            now = (1 - u) ** 2 * y[i, 0] + 2 * u * (1 - u) * y[i, 1] + u * u * y[i, 2]
            rate = 2 * ((1 - u) * (y[i, 1] - y[i, 0]) + u * (y[i, 2] - y[i, 1]))
            for j in range(axes):
                first, second = 0.0, 0.0
                for m in range(ORDER - 1, 0, -1):
                    first = first * u + m * c[i, m, j]
                    if m >= 2:
                        second = second * u + m * (m - 1) * c[i, m, j]
                push = second * now + 0.5 * first * rate
                out[i, k, j] = abs(push) / (speeding[j] if push * first > 0.0 else braking[j])
    return out


def asked(
    velocity: FloatArray, push: FloatArray, limits: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Return (n, axes) bounds of the shares of the limits, from Bernstein coefficients.

    Parameters
    ----------
    velocity, push
        (n, order, axes) coefficients of velocities and accelerations.
    limits
        (axes,) of speeding up, and of braking.
    """
    speeding, braking = limits
    least = np.minimum(speeding, braking)
    forward, backward = (velocity >= 0.0).all(axis=1), (velocity <= 0.0).all(axis=1)
    up = np.where(forward, speeding, np.where(backward, braking, least))
    down = np.where(forward, braking, np.where(backward, speeding, least))
    return np.asarray(np.maximum(push.max(axis=1) / up, -push.min(axis=1) / down))
