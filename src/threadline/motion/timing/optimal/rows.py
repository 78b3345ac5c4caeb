"""The limits on one element as rows that are linear in y = u'^2.

On an element y is a quadratic with Bernstein coefficients y0, y1, y2. The acceleration of an axis,
``q_uu y + q_u y' / 2``, is a polynomial whose Bernstein coefficients are linear in them, and so is
``l = q_uuu y + 3/2 q_uu y' + q_u y'' / 2``; the jerk is ``sqrt(y) l``. Bernstein coefficients bound
a polynomial everywhere on the element: no sampling enters these bounds.

The demand on a drive, ``k_v v + k_a a``, contains the velocity ``q_u sqrt(y)``. Where it adds to
the demand, sqrt(y) lies under each of its tangents ``1 / (2 r) + r y / 2``; where it reduces it,
the demand is less than the demand of the acceleration alone, which the acceleration limit covers.

If the velocity of an axis keeps its sign within an element, an acceleration in that direction
speeds it up and the opposite one brakes it; if it turns back, the lower limit holds both ways. The
acceleration rows keep the higher limit, and the braking rows here the lower one.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.compiled import njit

ORDER = 6  # coefficients of a piece
WEIGHTS = np.array(
    [
        [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0],
        [1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [1 / 6, 2 / 3, 1 / 6], [0.0, 0.5, 0.5], [0.0, 0.0, 1.0],
    ]
)  # fmt: skip
"""Bernstein coefficients of a quadratic from its own of degree 2: of degree 2, then of degree 4."""
BASE = np.array([[1.0, -2.0, 1.0], [0.0, 2.0, -2.0], [0.0, 0.0, 1.0]])
"""The Bernstein polynomials of degree 2 in powers of u."""


@njit()
def bernstein_of(power, degree, out):
    """Write the Bernstein coefficients of a polynomial in powers into ``out[: degree + 1]``."""
    for i in range(degree + 1):
        coefficient = 0.0
        ratio = 1.0  # binomial(i, k) / binomial(degree, k)
        for k in range(i + 1):
            coefficient += ratio * power[k]
            ratio *= (i - k) / (degree - k) if degree > k else 0.0
        out[i] = coefficient


@njit()
def degree_of(c, j):
    """Return the highest power of axis ``j`` that is not 0."""
    for k in range(ORDER - 1, 0, -1):
        if c[k, j] != 0.0:
            return k
    return 0


@njit()
def _fastest(c, j, degree):
    """Return a bound of |q_u| of one axis."""
    slope, bernstein = np.zeros(ORDER), np.zeros(ORDER)
    for k in range(degree):
        slope[k] = (k + 1) * c[k + 1, j]
    bernstein_of(slope, degree - 1, bernstein)
    largest = 0.0
    for k in range(ORDER):  # of an array, max() and min() take as long to compile as this function
        largest = max(largest, abs(bernstein[k]))
    return largest


@njit()
def acceleration_rows(c, j, degree, limit, out):
    """Write the rows of one curved axis; return their number: its degree plus 1, made odd."""
    row_degree = 3 if degree <= 3 else 5
    power, bernstein = np.zeros(ORDER + 2), np.zeros(ORDER + 2)
    for m in range(3):
        power[:] = 0.0
        for k in range(1, degree + 1):
            first = k * c[k, j]
            second = k * (k - 1) * c[k, j]
            for s in range(3):
                if k >= 2:
                    power[k - 2 + s] += second * BASE[m, s]
                if s >= 1:
                    power[k - 1 + s - 1] += 0.5 * first * s * BASE[m, s]
        bernstein_of(power, row_degree, bernstein)
        for i in range(row_degree + 1):
            out[i, m] = bernstein[i] / limit
    return row_degree + 1


@njit()
def _jerk_rows(c, j, degree, limit, out, points):
    """Write the rows of one curved axis and the weights on their right side."""
    row_degree = 2 if degree <= 3 else 4
    power, bernstein = np.zeros(ORDER + 2), np.zeros(ORDER + 2)
    for m in range(3):
        power[:] = 0.0
        for k in range(1, degree + 1):
            first = k * c[k, j]
            second = k * (k - 1) * c[k, j]
            third = k * (k - 1) * (k - 2) * c[k, j]
            for s in range(3):
                if k >= 3:
                    power[k - 3 + s] += third * BASE[m, s]
                if k >= 2 and s >= 1:
                    power[k - 2 + s - 1] += 1.5 * second * s * BASE[m, s]
                if s == 2:
                    power[k - 1] += first * BASE[m, s]
        bernstein_of(power, row_degree, bernstein)
        for i in range(row_degree + 1):
            out[i, m] = bernstein[i] / limit
    for i in range(row_degree + 1):
        points[i] = i if row_degree == 2 else 3 + i
    return row_degree + 1


@njit()
def rows_of(c, guard, limits, acc, jerk, points):
    """Write the rows of one element; return their numbers and the largest y.

    ``limits`` are the (axes,) limits of velocity, acceleration and jerk.
    ``acc[i] . y`` and ``jerk[i] . y`` are shares of the limits; ``points[i]`` names the row of
    ``WEIGHTS`` for the Bernstein coefficient of y on the right side of row i of the jerk.
    """
    limit_v, limit_a, limit_j = limits
    top = np.inf
    n_acc, n_jerk = 0, 0
    line_a, line_j = 0.0, 0.0  # of straight axes, which all share one shape
    for j in range(c.shape[1]):
        degree = degree_of(c, j)
        if degree == 0:
            continue
        top = min(top, (limit_v[j] / _fastest(c, j, degree)) ** 2)
        if degree == 1:
            line_a = max(line_a, abs(c[1, j]) / limit_a[j])
            line_j = max(line_j, abs(c[1, j]) / limit_j[j])
            continue
        n_acc += acceleration_rows(c, j, degree, limit_a[j], acc[n_acc:])
        if limit_j[j] < np.inf:
            n_jerk += _jerk_rows(c, j, degree, limit_j[j], jerk[n_jerk:], points[n_jerk:])
    for j in range(guard.shape[1]):
        degree = degree_of(guard, j)
        if degree == 1:
            line_a = max(line_a, abs(guard[1, j]))
        elif degree > 1:
            n_acc += acceleration_rows(guard, j, degree, 1.0, acc[n_acc:])
    if line_a > 0.0:
        acc[n_acc, 0], acc[n_acc, 1], acc[n_acc, 2] = -line_a, line_a, 0.0
        acc[n_acc + 1, 0], acc[n_acc + 1, 1], acc[n_acc + 1, 2] = 0.0, -line_a, line_a
        n_acc += 2
    if line_j > 0.0:
        for i in range(3):
            jerk[n_jerk, 0], jerk[n_jerk, 1], jerk[n_jerk, 2] = line_j, -2.0 * line_j, line_j
            points[n_jerk] = i
            n_jerk += 1
    return n_acc, n_jerk, top


@njit()
def _demand_rows(c, j, degree, share_v, share_a, out):
    """Write the rows of one drive's demand for one axis; return their number.

    A row is seven numbers: the factors of y0, y1, y2, their factors with the tangent's slope, and
    the factor of its constant.
    """
    row_degree = 2 if degree == 1 else degree + 1
    power, bernstein = np.zeros(ORDER + 2), np.zeros(ORDER + 2)
    for k in range(1, degree + 1):
        power[k - 1] = share_v * k * c[k, j]
    bernstein_of(power, row_degree, bernstein)
    low, high = bernstein[0], bernstein[0]
    for i in range(row_degree + 1):
        low, high = min(low, bernstein[i]), max(high, bernstein[i])
        out[i, 6] = bernstein[i]
    for m in range(3):
        power[:] = 0.0
        for k in range(1, degree + 1):
            first = k * c[k, j]
            second = k * (k - 1) * c[k, j]
            for s in range(3):
                if k >= 2:
                    power[k - 2 + s] += share_a * second * BASE[m, s]
                if s >= 1:
                    power[k - 1 + s - 1] += share_a * 0.5 * first * s * BASE[m, s]
        bernstein_of(power, row_degree, bernstein)
        for i in range(row_degree + 1):
            out[i, m] = bernstein[i]
        power[:] = 0.0
        for k in range(1, degree + 1):
            for s in range(3):
                power[k - 1 + s] += share_v * k * c[k, j] * BASE[m, s]
        bernstein_of(power, row_degree, bernstein)
        for i in range(row_degree + 1):
            out[i, 3 + m] = bernstein[i]
    rows = row_degree + 1
    if high <= 0.0:
        for i in range(rows):
            for a in range(7):
                out[i, a] = -out[i, a]
        return rows
    if low >= 0.0:
        return rows
    for i in range(rows):
        for a in range(7):
            out[rows + i, a] = -out[i, a]
    return 2 * rows


@njit()
def demand_rows(c, demand, limit_a, top):
    """Return the rows of all drives, and the first row of each element.

    Parameters
    ----------
    demand
        (m, axes, 2) share of a drive's output that an axis needs for 1 m/s, and for 1 m/s^2.
    limit_a
        (axes,) acceleration limits, within which a demand without velocity is below 1.
    top
        (n,) largest y.
    """
    n, axes = len(c), c.shape[2]
    first = np.zeros(n + 1, dtype=np.int64)
    out = np.zeros((64, 7))
    axis_rows = np.zeros((2 * (ORDER + 2), 7))
    row_count = 0
    for i in range(n):
        for j in range(axes):
            degree = degree_of(c[i], j)
            if degree == 0:
                continue
            for m in range(len(demand)):
                share_v, share_a = demand[m, j, 0], demand[m, j, 1]
                if share_v <= 0.0:
                    continue
                fastest = _fastest(c[i], j, degree) * np.sqrt(top[i])
                if share_v * fastest + share_a * limit_a[j] <= 1.0:
                    continue
                rows = _demand_rows(c[i], j, degree, share_v, share_a, axis_rows)
                if row_count + rows > len(out):
                    larger_out = np.zeros((2 * len(out) + rows, 7))
                    # No slices: assigning them takes long to compile.
                    for i_row in range(row_count):
                        for a in range(7):
                            larger_out[i_row, a] = out[i_row, a]
                    out = larger_out
                for i_row in range(rows):
                    for a in range(7):
                        out[row_count + i_row, a] = axis_rows[i_row, a]
                row_count += rows
        first[i + 1] = row_count
    return out[:row_count].copy(), first


@njit()
def assemble(c, guard, limit_v, limit_a, limit_j, cap):
    """Return the rows of all elements, their numbers, and the largest y of each."""
    n, axes = len(c), c.shape[2]
    acc = np.zeros((n, ORDER * (axes + guard.shape[2]) + 2, 3))
    most_jerk_rows = (ORDER - 1) * axes + 3
    jerk = np.zeros((n, most_jerk_rows, 3))
    points = np.zeros((n, most_jerk_rows), dtype=np.int8)
    count = np.zeros((n, 2), dtype=np.int64)
    top = np.empty(n)
    limits = (limit_v, limit_a, limit_j)
    for i in range(n):
        a, b, highest = rows_of(c[i], guard[i], limits, acc[i], jerk[i], points[i])
        count[i, 0], count[i, 1] = a, b
        top[i] = min(highest, cap[i])
    return acc, jerk, points, count, top


_COLUMNS = 7  # of a row of a drive; the last four multiply the tangent of a velocity


@njit()
def direction_of(c, j):
    """Return 1 if axis ``j`` never goes back, -1 if it never goes forward, else 0."""
    degree = degree_of(c, j)
    slope, bernstein = np.zeros(ORDER), np.zeros(ORDER)
    for k in range(degree):
        slope[k] = (k + 1) * c[k + 1, j]
    bernstein_of(slope, degree - 1, bernstein)
    low, high = bernstein[0], bernstein[0]
    for k in range(1, ORDER):
        low, high = min(low, bernstein[k]), max(high, bernstein[k])
    if low >= 0.0:
        return 1.0
    return -1.0 if high <= 0.0 else 0.0


@njit()
def with_braking(drive, begin, c, speeding, braking):
    """Return the drives' rows with the rows of the lower limits, and each element's first row.

    Parameters
    ----------
    drive, begin
        From ``demand_rows``.
    speeding, braking
        (axes,) limits of the acceleration that makes an axis faster, and slower.
    """
    n, axes = len(c), c.shape[2]
    out = np.zeros((len(drive) + n * axes * 2 * ORDER, _COLUMNS))
    first = np.zeros(n + 1, dtype=np.int64)
    axis_rows = np.zeros((ORDER, 3))
    row_count = 0
    for i in range(n):
        for k in range(begin[i], begin[i + 1]):
            for a in range(_COLUMNS):  # assigning the row takes seconds to compile
                out[row_count, a] = drive[k, a]
            row_count += 1
        for j in range(axes):
            degree = degree_of(c[i], j)
            if degree == 0 or speeding[j] == braking[j]:
                continue
            lower_limit = min(speeding[j], braking[j])
            rows = acceleration_rows(c[i], j, degree, lower_limit, axis_rows)
            # Against the motion if braking is weaker, with it if speeding up is.
            side = direction_of(c[i], j) * (1.0 if speeding[j] < braking[j] else -1.0)
            for sign in (1.0, -1.0):
                if side * sign < 0.0:
                    continue
                for k in range(rows):
                    for a in range(3):
                        out[row_count, a] = sign * axis_rows[k, a]
                    row_count += 1
        first[i + 1] = row_count
    return out[:row_count].copy(), first


@njit()
def braking_shares(c, y, speeding, braking, places):
    """Return the (n, places, axes) used shares of the limit on the side of each acceleration."""
    n, axes = len(c), c.shape[2]
    out = np.zeros((n, len(places), axes))
    for i in range(n):
        for k in range(len(places)):
            u = places[k]
            y_now = (1 - u) ** 2 * y[i, 0] + 2 * u * (1 - u) * y[i, 1] + u * u * y[i, 2]
            rate = 2 * ((1 - u) * (y[i, 1] - y[i, 0]) + u * (y[i, 2] - y[i, 1]))
            for j in range(axes):
                first, second = 0.0, 0.0
                for m in range(ORDER - 1, 0, -1):
                    first = first * u + m * c[i, m, j]
                    if m >= 2:
                        second = second * u + m * (m - 1) * c[i, m, j]
                push = second * y_now + 0.5 * first * rate
                out[i, k, j] = abs(push) / (speeding[j] if push * first > 0.0 else braking[j])
    return out


def used_shares(
    velocity: FloatArray, push: FloatArray, limits: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Return (n, axes) bounds of the used shares of the limits, from Bernstein coefficients.

    Parameters
    ----------
    velocity, push
        (n, order, axes) coefficients of velocities and accelerations.
    limits
        (axes,) limits of speeding up, and of braking.
    """
    speeding, braking = limits
    lower_limit = np.minimum(speeding, braking)
    forward, backward = (velocity >= 0.0).all(axis=1), (velocity <= 0.0).all(axis=1)
    limit_up = np.where(forward, speeding, np.where(backward, braking, lower_limit))
    limit_down = np.where(forward, braking, np.where(backward, speeding, lower_limit))
    return np.asarray(np.maximum(push.max(axis=1) / limit_up, -push.min(axis=1) / limit_down))


@njit()
def shares(c, guard, y, limits, demand, cap, places):
    """Return the (n, places, 3 axes + 1 + m + k) shares of the limits at ``places`` in [0, 1].

    The columns are velocity, acceleration and jerk of the first axis, of the next, ..., the feed,
    the largest of each of m demands on a drive, and each of k guards. The jerk at a node is the
    jerk of the present element. ``limits`` are the (axes,) limits of velocity, acceleration and
    jerk.
    """
    limit_v, limit_a, limit_j = limits
    n, axes = len(c), c.shape[2]
    first_demand = 3 * axes + 1
    out = np.zeros((n, len(places), first_demand + len(demand) + guard.shape[2]))
    for i in range(n):
        for k in range(len(places)):
            u = places[k]
            y_now = (1 - u) ** 2 * y[i, 0] + 2 * u * (1 - u) * y[i, 1] + u * u * y[i, 2]
            rate = 2 * ((1 - u) * (y[i, 1] - y[i, 0]) + u * (y[i, 2] - y[i, 1]))
            y_bend = 2 * (y[i, 0] - 2 * y[i, 1] + y[i, 2])
            root = np.sqrt(y_now)
            for j in range(axes):
                first, second, third = 0.0, 0.0, 0.0
                for m in range(ORDER - 1, 0, -1):
                    first = first * u + m * c[i, m, j]
                    if m >= 2:
                        second = second * u + m * (m - 1) * c[i, m, j]
                    if m >= 3:
                        third = third * u + m * (m - 1) * (m - 2) * c[i, m, j]
                out[i, k, 3 * j] = abs(first) * root / limit_v[j]
                out[i, k, 3 * j + 1] = abs(second * y_now + 0.5 * first * rate) / limit_a[j]
                jerk = root * (third * y_now + 1.5 * second * rate + 0.5 * first * y_bend)
                out[i, k, 3 * j + 2] = abs(jerk) / limit_j[j]
                for m in range(len(demand)):
                    demanded = demand[m, j, 0] * first * root
                    demanded += demand[m, j, 1] * (second * y_now + 0.5 * first * rate)
                    out[i, k, first_demand + m] = max(out[i, k, first_demand + m], abs(demanded))
            out[i, k, 3 * axes] = root / np.sqrt(cap[i])
            for j in range(guard.shape[2]):
                first, second = 0.0, 0.0
                for m in range(ORDER - 1, 0, -1):
                    first = first * u + m * guard[i, m, j]
                    if m >= 2:
                        second = second * u + m * (m - 1) * guard[i, m, j]
                out[i, k, first_demand + len(demand) + j] = abs(second * y_now + 0.5 * first * rate)
    return out
