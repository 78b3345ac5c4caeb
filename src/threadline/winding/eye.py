"""Compiled pay-out point of an eye: fixed on its carrier, or where the fibre leaves its roller.

Along, across and up are the directions of the machine. ``q`` and ``v`` are turn, along, across, up,
yaw and roll, and their rates; ``payout`` is as in ``laying.Tables``.
"""

from __future__ import annotations

import math

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit


@njit(nogil=True)
def turned(
    point: FloatArray, q: FloatArray, v: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Return a vector that is fixed on the eye's carrier, along, across and up, and its rate.

    ``q`` and ``v`` are turn, along, across, up, yaw and roll, and their rates.
    """
    cos, sin = math.cos(q[5]), math.sin(q[5])
    a, c, h = point[0] * cos + point[2] * sin, point[1], point[2] * cos - point[0] * sin
    da, dh = h * v[5], -a * v[5]
    cos, sin = math.cos(q[4]), math.sin(q[4])
    a2, c2 = a * cos - c * sin, a * sin + c * cos
    return a2, c2, h, da * cos - c2 * v[4], da * sin + a2 * v[4], dh


@njit(nogil=True)
def centre(
    q: FloatArray, v: FloatArray, payout: FloatArray
) -> tuple[float, float, float, float, float, float]:
    """Return place and velocity of the roller's centre along, across and up, on the machine."""
    along, across, up = q[1], q[2], q[3]
    d_along, d_across, d_up = v[1], v[2], v[3]
    if payout[0] != 0.0 or payout[1] != 0.0 or payout[2] != 0.0:
        a, c, h, da, dc, dh = turned(payout[:3], q, v)
        along += a
        across += c
        up += h
        d_along += da
        d_across += dc
        d_up += dh
    return along, across, up, d_along, d_across, d_up


@njit(nogil=True)
def _move_round_roller(
    point: FloatArray, rate: FloatArray, axis: FloatArray, spin: FloatArray, radius: float
) -> None:
    """Move the centre of a roller to the point where the fibre leaves it.

    The fibre from the laid point is tangent to the circle round the centre, across the axis. As the
    laid point moves along the fibre alone, its own motion does not move the tangent.

    Parameters
    ----------
    seen, rate
        (3,) centre from the laid point, m, and its rate with that point held; both are changed.
    axis, spin
        (3,) direction of the roller's axis, positive on the side where the fibre passes, and its
        rate.
    radius
        Radius of the roller, m; negative: the fibre passes on the other side.
    """
    towards = np.empty(3)
    d_towards = np.empty(3)
    along_axis, d_along_axis = 0.0, 0.0
    for j in range(3):
        along_axis += axis[j] * point[j]
        d_along_axis += axis[j] * rate[j] + spin[j] * point[j]
    distance2, d_distance2_half = 0.0, 0.0
    for j in range(3):
        towards[j] = point[j] - axis[j] * along_axis
        d_towards[j] = rate[j] - spin[j] * along_axis - axis[j] * d_along_axis
        distance2 += towards[j] * towards[j]
        d_distance2_half += towards[j] * d_towards[j]
    distance = math.sqrt(distance2)
    if distance <= abs(radius):
        return  # the laid point is within the roller: the clearance says so
    d_distance = d_distance2_half / distance
    share = abs(radius) / distance
    d_share = -share * d_distance / distance
    root = math.copysign(math.sqrt(1.0 - share * share), radius)
    d_root = -share * d_share / root
    radius_m = abs(radius)
    for j in range(3):
        towards[j] /= distance
        d_towards[j] = (d_towards[j] - towards[j] * d_distance) / distance
    for j in range(3):
        k, m = (j + 1) % 3, (j + 2) % 3
        side = axis[k] * towards[m] - axis[m] * towards[k]
        d_side = (
            spin[k] * towards[m]
            - spin[m] * towards[k]
            + axis[k] * d_towards[m]
            - axis[m] * d_towards[k]
        )
        point[j] += radius_m * (root * side - share * towards[j])
        rate[j] += radius_m * (
            root * d_side + d_root * side - d_share * towards[j] - share * d_towards[j]
        )


@njit(nogil=True)
def ahead(
    x: float, r: float, psi: float, q: FloatArray, v: FloatArray, payout: FloatArray
) -> tuple[float, float, float, float, float, float, float]:
    """Return the pay-out point relative to a laid point at x, r and the machine's angle psi.

    The result is its distance along, out and round; the rates of each in the turning mandrel's
    frame; and the angle at which the fibre leaves the roller, seen from its carrier, 0 without a
    roller.
    """
    along, across, up, d_along, d_across, d_up = centre(q, v, payout)
    cos, sin = math.cos(psi), math.sin(psi)
    er, ec = across * cos + up * sin, up * cos - across * sin
    vr = d_across * cos + d_up * sin + v[0] * ec
    vc = d_up * cos - d_across * sin - v[0] * er
    if payout[6] == 0.0:
        return along - x, er - r, ec, d_along, vr, vc, 0.0
    a, c, h, da, dc, dh = turned(payout[3:6], q, v)
    axis = np.array([a, c * cos + h * sin, h * cos - c * sin])
    spin = np.array(
        [da, dc * cos + dh * sin + v[0] * axis[2], dh * cos - dc * sin - v[0] * axis[1]]
    )
    point, rate = np.array([along - x, er - r, ec]), np.array([d_along, vr, vc])
    _move_round_roller(point, rate, axis, spin, payout[6])
    # Across on the carrier is square to the axis of a roller.
    a, c, h, da, dc, dh = turned(payout[7:10], q, v)
    from_centre = np.array([point[0] - along + x, point[1] - er + r, point[2] - ec])
    across_carrier = np.array([a, c * cos + h * sin, h * cos - c * sin])
    along_carrier, square_to_carrier = 0.0, 0.0
    for j in range(3):
        k, m = (j + 1) % 3, (j + 2) % 3
        along_carrier += from_centre[j] * across_carrier[j]
        square_to_carrier += from_centre[j] * (
            axis[k] * across_carrier[m] - axis[m] * across_carrier[k]
        )
    return (
        point[0],
        point[1],
        point[2],
        rate[0],
        rate[1],
        rate[2],
        math.atan2(square_to_carrier, along_carrier),
    )
