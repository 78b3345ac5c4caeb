"""The course of a fibre on its mandrel, compiled: geodesics and paths of constant friction ratio.

With the angle a between fibre and meridian, r the radius, b the angle of the meridian with the axis
and k_n the normal curvature, a fibre with ``k_g / k_n = ratio`` follows
``da/ds = ratio k_n - sin(b) sin(a) / r``. With a ratio of 0 it is a geodesic, and ``r sin(a)`` is
constant (Clairaut).
"""

from __future__ import annotations

import math

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.winding.surface import meridian

TURNED, REACHED, AWAY, ENDLESS = range(4)
"""Why a course ended: at 90 degrees, at the wanted place, along the meridian, or out of rows."""
_SHARE = 0.008  # length of a step, as a share of the smallest radius of curvature
_ROUNDS = 12  # of the search for the end of a step
_HALF_PI = 0.5 * math.pi
_ROW = 4


@njit(nogil=True)
def _rates(
    u: float, angle: float, ratio: float, side: float,
    nodes: FloatArray, x: FloatArray, r: FloatArray, hint: int, out: FloatArray,
) -> int:  # fmt: skip
    """Write the rates of u, of the angle round and of the winding angle, and the step's length."""
    hint, _, radius, cb, sb, bend, speed = meridian(nodes, x, r, u, hint)
    ca, sa = math.cos(angle), math.sin(angle)
    out[0] = side * ca / speed
    out[1] = sa / radius
    out[2] = ratio * (bend * ca * ca + cb / radius * sa * sa) - side * sb / radius * sa
    out[3] = _SHARE / max(abs(bend), 1.0 / radius)
    return hint


@njit(nogil=True)
def _step(
    y: FloatArray, h: float, ratio: float, side: float,
    nodes: FloatArray, x: FloatArray, r: FloatArray, hint: int, k: FloatArray, z: FloatArray,
) -> None:  # fmt: skip
    """Write into ``z`` the state after a step of Dormand and Prince, of fifth order, from ``y``.

    The first row of ``k`` holds the rates at ``y``. All stages use the piece ``hint`` and those
    beside it, so that a step that ends at a node sees no jump of the curvature.
    """
    piece = nodes[hint : hint + 2]
    px, pr = x[hint : hint + 1], r[hint : hint + 1]
    for stage in range(1, 6):
        for j in range(3):
            if stage == 1:
                increment = 0.2 * k[0, j]
            elif stage == 2:
                increment = 0.075 * k[0, j] + 0.225 * k[1, j]
            elif stage == 3:
                increment = 44.0 / 45.0 * k[0, j] - 56.0 / 15.0 * k[1, j] + 32.0 / 9.0 * k[2, j]
            elif stage == 4:
                increment = (
                    19372.0 / 6561.0 * k[0, j] - 25360.0 / 2187.0 * k[1, j]
                    + 64448.0 / 6561.0 * k[2, j] - 212.0 / 729.0 * k[3, j]
                )  # fmt: skip
            else:
                increment = (
                    9017.0 / 3168.0 * k[0, j] - 355.0 / 33.0 * k[1, j]
                    + 46732.0 / 5247.0 * k[2, j] + 49.0 / 176.0 * k[3, j]
                    - 5103.0 / 18656.0 * k[4, j]
                )  # fmt: skip
            z[j] = y[j] + h * increment
        _rates(z[0], z[2], ratio, side, piece, px, pr, 0, k[stage])
    for j in range(3):
        z[j] = y[j] + h * (
            35.0 / 384.0 * k[0, j] + 500.0 / 1113.0 * k[2, j] + 125.0 / 192.0 * k[3, j]
            - 2187.0 / 6784.0 * k[4, j] + 11.0 / 84.0 * k[5, j]
        )  # fmt: skip


@njit(nogil=True)
def trace(  # noqa: PLR0915 - one loop over the steps
    nodes: FloatArray, x: FloatArray, r: FloatArray,
    begin: FloatArray, ratio: float, side: float, until: float, rows: FloatArray,
) -> tuple[int, int]:  # fmt: skip
    """Write the course of a fibre into ``rows``; return their number and why it ended.

    Parameters
    ----------
    nodes, x, r
        The meridian, as in ``Surface``.
    begin
        (2,) u, m, and angle with the meridian in the direction of travel, rad, below 90 degrees.
    ratio
        k_g / k_n; positive: the angle grows.
    side
        1 to the right, -1 to the left.
    until
        u at which it ends, if it did not turn before.
    rows
        (most, 4) length, m, u, m, angle round, rad, and angle with the meridian, rad.
    """
    y, z, k = np.empty(3), np.empty(3), np.empty((6, _ROW))
    y[0], y[1], y[2] = begin[0], 0.0, begin[1]
    length, last = 0.0, len(x) - 1
    hint = 0
    while hint < last and (y[0] > nodes[hint + 1] or (side > 0.0 and y[0] == nodes[hint + 1])):
        hint += 1
    count = 0
    rows[0, 0], rows[0, 1], rows[0, 2], rows[0, 3] = 0.0, y[0], 0.0, y[2]
    while True:
        count += 1
        if y[2] >= _HALF_PI:
            return count, TURNED
        if side * (until - y[0]) <= 0.0:
            return count, REACHED
        if count == len(rows):
            return count, ENDLESS
        _rates(y[0], y[2], ratio, side, nodes[hint : hint + 2], x[hint : hint + 1],
               r[hint : hint + 1], 0, k[0])  # fmt: skip
        piece_end = nodes[hint + 1] if side > 0.0 else nodes[hint]
        target = min(piece_end, until) if side > 0.0 else max(piece_end, until)
        h = k[0, 3]
        _step(y, h, ratio, side, nodes, x, r, hint, k, z)
        crossed = False
        if z[2] >= _HALF_PI:
            for _ in range(_ROUNDS):
                missing = _HALF_PI - z[2]
                slope = k[5, 2]
                if missing == 0.0 or slope == 0.0:
                    break
                h += missing / slope
                _step(y, h, ratio, side, nodes, x, r, hint, k, z)
                if abs(missing) < 1e-15:
                    break
            z[2] = _HALF_PI
        if side * (z[0] - target) > 0.0:
            crossed = True
            h = min(h, k[0, 3])
            low, high = 0.0, h
            h = 0.5 * h
            for _ in range(60):
                _step(y, h, ratio, side, nodes, x, r, hint, k, z)
                missing = side * (target - z[0])
                if missing > 0.0:
                    low = h
                else:
                    high = h
                slope = math.cos(z[2])
                next_h = h + missing / slope if slope > 1e-9 else 0.5 * (low + high)
                if not low < next_h < high:
                    next_h = 0.5 * (low + high)
                if abs(next_h - h) < 1e-16 + 1e-15 * abs(h):
                    break
                h = next_h
            z[0] = target
        length += h
        y[0], y[1], y[2] = z[0], z[1], z[2]
        if crossed and target == piece_end:
            hint = min(hint + 1, last) if side > 0.0 else max(hint - 1, 0)
        rows[count, 0], rows[count, 1], rows[count, 2], rows[count, 3] = length, y[0], y[1], y[2]
        if y[2] <= 0.0:
            return count + 1, AWAY
