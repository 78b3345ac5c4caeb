"""A solution as polynomials in time, every one of them within all limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.motion.timing.optimal.along_path import across, true_shares
from threadline.motion.timing.optimal.elements import restricted
from threadline.motion.timing.optimal.motion_limits import Limits
from threadline.motion.timing.optimal.rows import used_shares
from threadline.motion.timing.optimal.solve import Solution
from threadline.motion.timing.types import TrajectoryBlock

_ORDER = 6
_WITHIN = 1.0  # of a limit: a polynomial in time that exceeds it is cut in two
CUTS = 6
# Nodes and weights of Gauss and Legendre on [0, 1]: y changes little within an element.
_NODES, _WEIGHTS = (0.5 * (1.0 + np.polynomial.legendre.leggauss(6)[0]),
                    0.5 * np.polynomial.legendre.leggauss(6)[1])  # fmt: skip
_SHARES = np.stack([(1.0 - _NODES) ** 2, 2.0 * _NODES * (1.0 - _NODES), _NODES**2])


def in_time(solution: Solution, limits: Limits, begin_s: float = 0.0) -> TrajectoryBlock:
    """Return the motion as polynomials of fifth degree in time, from ``begin_s`` on.

    Each has the position, velocity and acceleration of the motion at both ends; if one of them
    would exceed a limit in between, it is cut in two. If some still do after a few cuts the whole
    motion is slowed evenly, as a motion from rest to rest may be.
    """
    return _stretched_motion(solution, limits, begin_s, np.inf)[0]


def as_it_is(
    solution: Solution, limits: Limits, begin_s: float, most: float
) -> TrajectoryBlock | None:
    """Return the motion of a part of a run as ``in_time`` does, but without slowing it.

    None if it would have to be stretched by more than a share ``most``.
    """
    block, factor = _stretched_motion(solution, limits, begin_s, 1.0)
    return block if factor <= 1.0 + most else None


def _stretched_motion(
    solution: Solution, limits: Limits, begin_s: float, largest_factor: float
) -> tuple[TrajectoryBlock, float]:
    """Return the motion, stretched at most by ``largest_factor``, and the factor it needs."""
    elements, y = solution.elements, solution.y
    c, operation = elements.c, elements.operation
    finished: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    source = np.arange(len(c), dtype=np.float64)
    for cut in range(CUTS + 1):
        coefficients, duration_s = _hermite(c, y)
        exceeds = _beyond(coefficients, duration_s, limits)
        if cut == CUTS:
            exceeds[:] = False
        is_kept = ~exceeds
        finished.append((source[is_kept], coefficients[is_kept], duration_s[is_kept]))
        if not exceeds.any():
            break
        c, y, source = _halved(c[exceeds], y[exceeds], source[exceeds], 0.5 ** (cut + 1))
    places = np.concatenate([part[0] for part in finished])
    order = np.argsort(places, kind="stable")
    coefficients = np.concatenate([part[1] for part in finished])[order]
    duration_s = np.concatenate([part[2] for part in finished])[order]
    stretch = _stretch(coefficients, duration_s, limits)
    duration_s = duration_s * min(stretch, largest_factor)
    if limits.along is not None:
        # Drop the travelled path length, which was one of the axes, and check its true value.
        coefficients = coefficients[:, :, :-1]
        shares_used = true_shares(coefficients, duration_s, limits.along)
        path_stretch = max(1.0, *(share ** (1.0 / k) for k, share in enumerate(shares_used, 1)))
        duration_s = duration_s * min(path_stretch, largest_factor)
        stretch *= path_stretch
    return TrajectoryBlock(
        start_s=begin_s + np.concatenate([[0.0], np.cumsum(duration_s)[:-1]]),
        duration_s=duration_s,
        coefficients=coefficients,
        operation=operation[np.floor(places[order]).astype(np.int64)],
    ), stretch


def _halved(
    c: FloatArray, y: FloatArray, source: FloatArray, place: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    n = len(c)
    begin = np.tile([0.0, 0.5], n)
    half_widths = np.full(2 * n, 0.5)
    doubled_rows = np.repeat(np.arange(n), 2)
    first, middle, last = y.T
    left, right = 0.5 * (first + middle), 0.5 * (middle + last)
    centre = 0.5 * (left + right)
    # In the parameter of a half, u' is twice as large.
    halves = 4.0 * np.stack([first, left, centre, centre, right, last], axis=1).reshape(-1, 3)
    return (
        restricted(c[doubled_rows], begin, half_widths),
        halves,
        source[doubled_rows] + np.tile([0.0, place], n),
    )


def _hermite(c: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (n, 6, axes) polynomials over [0, 1] of a piece's time, and (n,) durations, s.

    ``c`` are the coefficients of the pieces of the path. ``y`` are (n, 3) Bernstein coefficients of
    the squared speed along each: weighted sums of them stay positive under rounding.
    """
    duration_s = ((y @ _SHARES) ** -0.5) @ _WEIGHTS
    number = np.arange(_ORDER)[:, None]
    ends = []
    for u in (0.0, 1.0):
        rate2 = y[:, 0] if u == 0.0 else y[:, 2]
        rate2_slope = 2.0 * (y[:, 1] - y[:, 0] if u == 0.0 else y[:, 2] - y[:, 1])
        first = c[:, 1] if u == 0.0 else (number * c).sum(axis=1)
        second = 2.0 * c[:, 2] if u == 0.0 else (number * (number - 1) * c).sum(axis=1)
        ends.append(
            (
                first * (np.sqrt(rate2) * duration_s)[:, None],
                second * (rate2 * duration_s**2)[:, None]
                + first * (0.5 * rate2_slope * duration_s**2)[:, None],
            )
        )
    (v0, a0), (v1, a1) = ends
    q0 = c[:, 0]
    # Without the position itself: its rounding, over the cube of a short time, would be a jerk.
    rise_rest = c[:, 1:].sum(axis=1) - v0 - 0.5 * a0
    velocity_rest, acceleration_rest = v1 - v0 - a0, a1 - a0
    return np.stack(
        [
            q0,
            v0,
            0.5 * a0,
            10.0 * rise_rest - 4.0 * velocity_rest + 0.5 * acceleration_rest,
            -15.0 * rise_rest + 7.0 * velocity_rest - acceleration_rest,
            6.0 * rise_rest - 3.0 * velocity_rest + 0.5 * acceleration_rest,
        ],
        axis=1,
    ), duration_s


def _beyond(
    coefficients: FloatArray, duration_s: FloatArray, limits: Limits
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return which polynomials may exceed a limit, by their Bernstein coefficients."""
    exceeds = np.zeros(len(duration_s), dtype=bool)
    for _, share in _shares(coefficients, duration_s, limits):
        exceeds |= share > _WITHIN
    return exceeds


def _stretch(coefficients: FloatArray, duration_s: FloatArray, limits: Limits) -> float:
    """Return the factor by which the time must be stretched so that no limit is exceeded."""
    return max(
        1.0,
        *(
            float(np.power(share.max(), 1.0 / order))
            for order, share in _shares(coefficients, duration_s, limits)
        ),
    )


def _shares(
    coefficients: FloatArray, duration_s: FloatArray, limits: Limits
) -> Iterator[tuple[int, FloatArray]]:
    """Yield orders of derivatives and (n,) bounds of the used shares of their limits."""
    rates = [coefficients]
    largest = limits.largest_acceleration
    for order, limit in enumerate((limits.velocity, largest, limits.jerk), start=1):
        power = rates[-1]
        rates.append(power[:, 1:] * np.arange(1, power.shape[1])[None, :, None])
        yield order, (_hull(rates[-1]) / (limit * duration_s[:, None] ** order)).max(axis=1)
    _, velocity, acceleration, _ = rates
    time_s = duration_s[:, None, None]
    if limits.deceleration is not None:
        pushes = _bernstein(acceleration) / time_s**2
        yield 2, used_shares(_bernstein(velocity), pushes, limits.accelerations).max(axis=1)
    if limits.along is not None and np.isfinite(limits.along.centripetal):
        across_bound = across(coefficients[:, :, :-1] * limits.along.radius_m)
        yield 2, across_bound / (limits.along.centripetal * duration_s**2)
    for demand in limits.demand:
        share = velocity * (demand[:, 0] / time_s)
        share[:, :-1] += acceleration * (demand[:, 1] / time_s**2)
        # Slowing by a factor lowers a demand at least by that factor.
        yield 1, _hull(share).max(axis=1)


def _hull(power: FloatArray) -> FloatArray:
    """Return (n, axes): the largest of the absolute Bernstein coefficients."""
    return np.asarray(np.abs(_bernstein(power)).max(axis=1))


def _bernstein(power: FloatArray) -> FloatArray:
    """Return the (n, order, axes) Bernstein coefficients."""
    degree = power.shape[1] - 1
    matrix = np.zeros((degree + 1, degree + 1))
    for i in range(degree + 1):
        share = 1.0
        for k in range(i + 1):
            matrix[i, k] = share
            share *= (i - k) / (degree - k) if degree > k else 0.0
    return np.asarray(np.einsum("ik,nka->nia", matrix, power))


def slowed(block: TrajectoryBlock, by: float) -> TrajectoryBlock:
    """Return the motion of ``block`` slowed evenly, ``by`` times as long, with the same start."""
    begin_s = float(block.start_s[0])
    return replace(
        block, start_s=begin_s + by * (block.start_s - begin_s), duration_s=by * block.duration_s
    )
