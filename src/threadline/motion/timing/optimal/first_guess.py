"""Feasible motions to start from, and closed forms for a run that is one straight line."""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit
from threadline.motion.timing.optimal.along_path import across
from threadline.motion.timing.optimal.barrier import room_of, values
from threadline.motion.timing.optimal.elements import Elements
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.optimal.rows import WEIGHTS
from threadline.motion.timing.types import TrajectoryBlock

if TYPE_CHECKING:
    from threadline.motion.laws import ShortestMove


def straight_run(
    c: FloatArray, nominal_s: float, operation: int, limits: Limits, begin_s: float
) -> TrajectoryBlock | None:
    """Return the fastest motion from rest to rest along a straight piece.

    None if a drive could bind before the limits of the axes do, or if axes have a braking limit of
    their own: then there is no closed form.

    Parameters
    ----------
    c
        (order, axes) of the piece.
    nominal_s
        Least time of the piece at constant speed, 0 for none.
    """
    from threadline.motion.laws import shortest_move  # it brings the catalogue of laws

    distance = np.abs(c[1])
    with np.errstate(divide="ignore", over="ignore"):
        velocity = float((limits.velocity / distance).min())
        acceleration = float((limits.acceleration / distance).min())
        jerk = float((limits.jerk / distance).min())
    if limits.deceleration is not None:
        return None
    if limits.along is not None:
        if limits.along.accelerations[0] != limits.along.accelerations[1]:
            return None
        length = float(np.linalg.norm(distance * limits.along.radius_m))
        velocity = min(velocity, limits.along.velocity / length)
        acceleration = min(acceleration, limits.along.acceleration / length)
        jerk = min(jerk, limits.along.jerk / length)
    if nominal_s > 0.0:
        velocity = min(velocity, 1.0 / nominal_s)
    rates = np.array([velocity, acceleration])
    if len(limits.demand) and (limits.demand @ rates * distance > 1.0).any():
        return None
    duration_s, place = _phases(shortest_move(1.0, velocity, acceleration, jerk))
    coefficients = np.zeros((len(place), 4, len(distance)))
    coefficients[:, 0] = c[0]
    coefficients += place[:, :, None] * c[1]
    return TrajectoryBlock(
        start_s=begin_s + np.concatenate([[0.0], np.cumsum(duration_s)[:-1]]),
        duration_s=duration_s,
        coefficients=coefficients,
        operation=np.full(len(place), operation),
    )


def _phases(move: ShortestMove) -> tuple[FloatArray, FloatArray]:
    """Return the (n,) durations of the phases and (n, 4) places on them in powers of u."""
    top, peak = move.velocity_si, move.acceleration_si
    velocity_gain = 0.5 * peak * move.jerk_s
    # Duration, and the velocity and acceleration at the beginning of each phase.
    phase_starts = [
        (move.jerk_s, 0.0, 0.0),
        (move.push_s, velocity_gain, peak),
        (move.jerk_s, top - velocity_gain, peak),
        (move.cruise_s, top, 0.0),
        (move.jerk_s, top, 0.0),
        (move.push_s, top - velocity_gain, -peak),
        (move.jerk_s, velocity_gain, -peak),
        (0.0, 0.0, 0.0),
    ]
    rows, place = [], 0.0
    for k, ((lasts_s, velocity, acceleration), (_, _, next_acceleration)) in enumerate(
        pairwise(phase_starts)
    ):
        if not lasts_s > 0.0:
            continue
        cubic_term = (
            0.0 if k in (1, 3, 5) else (next_acceleration - acceleration) * lasts_s**2 / 6.0
        )
        rows.append([place, velocity * lasts_s, 0.5 * acceleration * lasts_s**2, cubic_term])
        place = sum(rows[-1])
    return np.array([lasts_s for lasts_s, _, _ in phase_starts if lasts_s > 0.0]), np.array(rows)


_SHARE = 0.25  # of the accelerations, on the way
_USED = 0.7  # largest share of a limit
_ROUNDS = 60
_GROWTH = 3.0  # of x from element to element
_DIGITS = float(np.finfo(np.float64).eps)


@njit()
def even(length, c, guard, limits, demand, cap):
    """Return the (n,) largest constant x, in units of the common parameter, for each element.

    With such an x, the parameter advances at a constant rate and no limit is exceeded. ``limits``
    are the (axes,) limits of velocity, acceleration and jerk.
    """
    limit_v, limit_a, limit_j = limits
    n, order, axes = c.shape
    largest_x = np.empty(n)
    for i in range(n):
        y = cap[i]
        for j in range(axes):
            v, a, q = 0.0, 0.0, 0.0
            for k in range(1, order):
                magnitude = abs(c[i, k, j])
                v += k * magnitude
                a += k * (k - 1) * magnitude
                q += k * (k - 1) * (k - 2) * magnitude
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
        largest_x[i] = y * length[i] ** 2
    return largest_x


@njit()
def used(b, length, rows, tangent, out, anew):
    """Write the (n,) largest shares of a limit into ``out``; return the largest of all.

    ``anew``: set each tangent to its best first.
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
    """Return the (n,) rounding of an element's rows by the digits of y, in shares of a limit."""
    acc, jerk, count = rows[0], rows[1], rows[3]
    rounding = np.empty(len(length))
    for i in range(len(length)):
        y0, y1, y2 = values(b, length, i)
        y = max(y0, y1, y2)
        largest_row, largest_jerk_row = 0.0, 0.0
        for k in range(count[i, 0]):
            r0, r1, r2 = acc[i, k, 0], acc[i, k, 1], acc[i, k, 2]
            largest_row = max(largest_row, abs(r0), abs(r1), abs(r2))
        for k in range(count[i, 1]):
            r0, r1, r2 = jerk[i, k, 0], jerk[i, k, 1], jerk[i, k, 2]
            largest_jerk_row = max(largest_jerk_row, abs(r0), abs(r1), abs(r2))
        rounding[i] = _DIGITS * max(largest_row, largest_jerk_row * np.sqrt(y)) * y
    return rounding


@njit()
def feasible(length, rows, most):
    """Return coefficients b and tangents within all limits.

    Parameters
    ----------
    most
        (n,) largest constant x of each element, from ``even``.
    """
    acc, count = rows[0], rows[3]
    n = len(length)
    tangent, share = np.empty(n), np.empty(n)
    node = np.empty(n + 1)
    gain = np.empty(n)  # largest change of x over an element by its acceleration
    for i in range(n):
        largest_row = 0.0
        for k in range(count[i, 0]):
            r = acc[i, k]
            largest_row = max(largest_row, abs(r[0]), abs(r[1]), abs(r[2]))
        gain[i] = _SHARE / largest_row * length[i] ** 2 if largest_row > 0.0 else np.inf
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
                largest_x = max(b[i], b[i + 1], b[i + 2])
                for k in range(max(i - 1, 0), min(i + 2, n)):
                    cap[k] = min(cap[k], 0.6 * largest_x)
    lowest = most[0]
    for i in range(n):
        lowest = min(lowest, most[i])
    b[:] = 0.4 * lowest
    used(b, length, rows, tangent, share, True)
    return b, tangent


def top_of(elements: Elements, limits: Limits) -> FloatArray:
    """Return the (n,) largest u'^2 by feed, guards and centripetal limit."""
    along = limits.along
    if along is None or not np.isfinite(along.centripetal):
        return elements.top
    across_bound = across(elements.c[:, :, :-1] * along.radius_m)
    with np.errstate(divide="ignore"):
        return np.minimum(elements.top, along.centripetal / across_bound)


def evenly(elements: Elements, limits: Limits) -> FloatArray:
    """Return the (n,) largest constant x of each element within all limits."""
    at, of = elements, limits
    least, top = np.minimum(*of.accelerations), top_of(at, of)
    largest_x = even(at.length, at.c, at.guard, (of.velocity, least, of.jerk), of.demand, top)
    return np.asarray(largest_x)
