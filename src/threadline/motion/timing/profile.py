"""The fastest run along pieces of a path within limits of velocity and acceleration.

Along piece i the position is q(u), u in [0, 1], and x = u'^2 is the state. On each of ``PARTS``
equal parts of a curved piece u'' is constant, so that x is linear in u and the acceleration
q_u u'' + q_uu x of an axis is a quadratic in u; its three Bernstein coefficients, linear in the
values of x at both ends, bound it everywhere on the part. On a straight piece the run
accelerates, cruises and brakes at the limits. A backward pass finds the largest x from which the
rest is feasible, a forward pass takes the largest permitted x: reachability analysis as in
Pham and Pham (2018), "A new approach to time-optimal path parameterization based on reachability
analysis", IEEE Transactions on Robotics 34(3).
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

import numpy as np

from threadline.base.compiled import njit

PARTS = 4
_TINY = 1e-300
_NO_PART = 1e-9
"""Share of a bound below which a value counts as 0 in a row: its bound would be a rounding."""


@njit()
def part_rows(c, part, limit_v, limit_a, p, s, bound):
    """Write the rows |p x0 + s x1| <= bound of one part; return its velocity limit on x."""
    axes = c.shape[1]
    du = 1.0 / PARTS
    u0 = part * du
    g = 0.5 / du
    top = np.inf
    for j in range(axes):
        e0 = 2.0 * c[2, j] + 6.0 * c[3, j] * u0
        e1 = e0 + 6.0 * c[3, j] * du
        d0 = c[1, j] + (2.0 * c[2, j] + 3.0 * c[3, j] * u0) * u0
        d1 = d0 + 0.5 * e0 * du
        d2 = d0 + 0.5 * (e0 + e1) * du
        p[3 * j] = e0 - d0 * g
        s[3 * j] = d0 * g
        p[3 * j + 1] = 0.5 * e1 - d1 * g
        s[3 * j + 1] = d1 * g + 0.5 * e0
        p[3 * j + 2] = -d2 * g
        s[3 * j + 2] = d2 * g + e1
        for k in range(3):
            bound[3 * j + k] = limit_a[j]
        fastest = max(abs(d0), abs(d1), abs(d2))
        if fastest > 0.0:
            top = min(top, (limit_v[j] / fastest) ** 2)
    return top


@njit()
def largest_start(p, s, bound, end_most, start_most):
    """Return the largest x0 <= start_most for which some x1 in [0, end_most] meets the rows."""
    x0 = start_most
    reach = max(end_most, start_most)
    for i in range(len(p)):
        if abs(s[i]) * reach < _NO_PART * bound[i] and abs(p[i]) > _TINY:
            x0 = min(x0, bound[i] / abs(p[i]))
    # lowest(x0) - highest(x0) is convex and not positive at 0: Newton's method from the right end
    # reaches the largest root after finitely many rows.
    for _ in range(100):
        low, low_slope = 0.0, 0.0
        high, high_slope = end_most, 0.0
        for i in range(len(p)):
            if abs(s[i]) * reach < _NO_PART * bound[i]:
                continue
            slope = -p[i] / s[i]
            half = bound[i] / abs(s[i])
            if slope * x0 - half > low:
                low, low_slope = slope * x0 - half, slope
            if slope * x0 + half < high:
                high, high_slope = slope * x0 + half, slope
        if low <= high + 1e-13 * end_most:
            return x0
        steep = low_slope - high_slope
        if not steep > 0.0:
            return 0.0
        x0 = max(0.0, x0 - (low - high) / steep)
    return x0


@njit()
def largest_end(p, s, bound, start, end_most):
    """Return the largest x1 <= end_most that the rows allow after x0 = start."""
    low, high = 0.0, end_most
    for i in range(len(p)):
        if abs(s[i]) * max(end_most, start) < _NO_PART * bound[i]:
            continue
        centre = -p[i] / s[i] * start
        half = bound[i] / abs(s[i])
        high = min(high, centre + half)
        low = max(low, centre - half)
    return max(min(high, end_most), min(low, end_most))


@njit()
def straight_limits(c, limit_v, limit_a):
    """Return the largest u'^2 and |u''| of a straight piece."""
    top = np.inf
    push = np.inf
    for j in range(c.shape[1]):
        rate = abs(c[1, j])
        if rate > 0.0:
            top = min(top, (limit_v[j] / rate) ** 2)
            push = min(push, limit_a[j] / rate)
    return top, push


@njit()
def backward(run, limits, end_x, most, merge):
    """Fill ``most`` (n, PARTS + 1) with the largest x from which the rest is feasible.

    Parameters
    ----------
    run : tuple
        Of n pieces: (n, 4, axes) coefficients, (n,) 0/1 whether straight, (n,) largest x, and (n,)
        ratio of x after and before the joint after each piece.
    limits : tuple
        (axes,) limits of velocity, and of acceleration.
    end_x : float
        Largest x at the end.
    most : (n, PARTS + 1)
        Output.
    merge : bool
        With ``merge`` the pass stops at the first piece, seen from the end, where it meets the
        values already in ``most``. The index of that piece is returned, and later pieces are
        unchanged.
    """
    c, straight, cap, factor = run
    limit_v, limit_a = limits
    rows = 3 * c.shape[2]
    p = np.empty(rows)
    s = np.empty(rows)
    bound = np.empty(rows)
    x_after = end_x
    for i in range(len(c) - 1, -1, -1):
        if i < len(c) - 1:
            x_after = x_after / factor[i]
        if straight[i]:
            top, push = straight_limits(c[i], limit_v, limit_a)
            top = min(top, cap[i])
            end = min(x_after, top)
            begin = min(top, end + 2.0 * push)
            if not merge:
                most[i, PARTS] = end
                most[i, 0] = begin
            elif begin <= most[i, 0] * (1.0 + 1e-12):
                return i
        else:
            end = min(x_after, cap[i])
            if not merge:
                most[i, PARTS] = end
            begin = end
            for part in range(PARTS - 1, -1, -1):
                top = min(cap[i], part_rows(c[i], part, limit_v, limit_a, p, s, bound))
                begin = largest_start(p, s, bound, min(end, top), top)
                if not merge:
                    most[i, part + 1] = min(end, top)
                    most[i, part] = begin
                end = begin
            if merge and begin <= most[i, 0] * (1.0 + 1e-12):
                return i
        x_after = begin
    return -1


@njit()
def forward(run, limits, start_x, most, x):
    """Fill ``x`` (n, PARTS + 1) with the fastest run; return x after the last piece.

    ``run``, ``limits`` and ``most`` as in ``backward``.
    """
    c, straight, _, factor = run
    limit_v, limit_a = limits
    rows = 3 * c.shape[2]
    p = np.empty(rows)
    s = np.empty(rows)
    bound = np.empty(rows)
    x_now = start_x
    for i in range(len(c)):
        x_now = min(x_now, most[i, 0])
        x[i, 0] = x_now
        if straight[i]:
            _, push = straight_limits(c[i], limit_v, limit_a)
            x_now = min(most[i, PARTS], x_now + 2.0 * push)
            x[i, PARTS] = x_now
        else:
            for part in range(PARTS):
                part_rows(c[i], part, limit_v, limit_a, p, s, bound)
                x_now = largest_end(p, s, bound, x_now, most[i, part + 1])
                x[i, part + 1] = x_now
        x_now = x_now * factor[i]
    return x_now


@njit()
def cruise(x0, x1, push, top):
    """Return the x reached between x0 and x1 on a straight piece, at most ``top``."""
    return max(x0, x1, min(top, 0.5 * (x0 + x1) + push))


@njit()
def sample(run, limits, x, step, state, out, owner):
    """Write positions every ``step`` until ``out`` is full or the pieces end; return their number.

    Parameters
    ----------
    run, limits : tuple
        As in ``backward``.
    x : (n, PARTS + 1)
        From ``forward``.
    step : float
        Time from sample to sample.
    state : (3,)
        Piece and part of the next sample, and its time since the start of the part; updated.
    out, owner : (m, axes), (m,)
        Output: the positions, and the piece of each.
    """
    c, straight, cap, _ = run
    limit_v, limit_a = limits
    count = 0
    piece, part, time = int(state[0]), int(state[1]), state[2]
    while piece < len(c):
        if straight[piece]:
            top, push = straight_limits(c[piece], limit_v, limit_a)
            x0, x1 = x[piece, 0], x[piece, PARTS]
            peak = cruise(x0, x1, push, min(top, cap[piece]))
            v0, v1, vp = np.sqrt(x0), np.sqrt(x1), np.sqrt(peak)
            t1, t3 = (vp - v0) / push, (vp - v1) / push
            cruise_share = 1.0 - (peak - x0) / (2.0 * push) - (peak - x1) / (2.0 * push)
            t2 = max(0.0, cruise_share) / vp
            part_time = t1 + t2 + t3
            while time < part_time:
                if count == len(out):
                    state[0], state[1], state[2] = piece, 0, time
                    return count
                if time < t1:
                    u = (v0 + 0.5 * push * time) * time
                elif time < t1 + t2:
                    u = (peak - x0) / (2.0 * push) + vp * (time - t1)
                else:
                    time_left = part_time - time
                    u = 1.0 - (v1 + 0.5 * push * time_left) * time_left
                for j in range(c.shape[2]):
                    out[count, j] = c[piece, 0, j] + c[piece, 1, j] * u
                owner[count] = piece
                count += 1
                time += step
            time -= part_time
        else:
            du = 1.0 / PARTS
            while part < PARTS:
                x0, x1 = x[piece, part], x[piece, part + 1]
                v0 = np.sqrt(x0)
                part_time = 2.0 * du / (v0 + np.sqrt(x1))
                push = (x1 - x0) / (2.0 * du)
                while time < part_time:
                    if count == len(out):
                        state[0], state[1], state[2] = piece, part, time
                        return count
                    u = min(part * du + (v0 + 0.5 * push * time) * time, (part + 1) * du)
                    for j in range(c.shape[2]):
                        out[count, j] = c[piece, 0, j] + u * (
                            c[piece, 1, j] + u * (c[piece, 2, j] + u * c[piece, 3, j])
                        )
                    owner[count] = piece
                    count += 1
                    time += step
                time -= part_time
                part += 1
        part = 0
        piece += 1
    state[0], state[1], state[2] = piece, 0, time
    return count
