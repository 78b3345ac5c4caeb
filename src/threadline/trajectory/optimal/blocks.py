"""The fastest motion along a planned path as polynomials in time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.machine import Machine
from threadline.path.types import PieceBlock, PlannedPath
from threadline.trajectory.optimal.elements import elements_of, restricted
from threadline.trajectory.optimal.solve import Limits, Solution, fastest
from threadline.trajectory.pieces import factors
from threadline.trajectory.timed import held_block
from threadline.trajectory.types import TrajectoryBlock

MOST_PIECES = 20_000
"""Pieces of one run that are solved together; where a run has more, the motion rests between."""
GAP = 1e-4
_ORDER = 6
_WITHIN = 1.0  # of a limit: a polynomial in time that has more is cut in two
_CUTS = 6
# Nodes and weights of Gauss and Legendre on [0, 1]: y changes little within an element.
_NODES, _WEIGHTS = (0.5 * (1.0 + np.polynomial.legendre.leggauss(6)[0]),
                    0.5 * np.polynomial.legendre.leggauss(6)[1])  # fmt: skip


def fastest_blocks(path: PlannedPath, machine: Machine) -> Iterator[TrajectoryBlock]:
    """Yield the fastest trajectory of ``path`` within velocity, acceleration and jerk limits."""
    column = [machine.axis_names.index(axis) for axis in path.axes]
    limits = Limits(
        velocity=machine.velocity_limit[column],
        acceleration=machine.acceleration_limit[column],
        jerk=machine.jerk_limit[column],
    )
    yield from limited_blocks(path, limits)


def limited_blocks(path: PlannedPath, limits: Limits) -> Iterator[TrajectoryBlock]:
    """Yield the fastest trajectory of ``path`` within limits of its axes."""
    now = 0.0
    for run in _runs(path):
        moves = np.abs(run.coefficients[:, 1:]).max(axis=(1, 2)) > 0.0
        if moves.any():
            block = _moved(run, moves, path.radius_m, limits, now)
            now = block.end_s
            yield block
        dwell_s = float(run.dwell_s[-1])
        if dwell_s > 0.0:
            end = run.coefficients[-1].sum(axis=0)
            yield held_block(end, now, dwell_s, int(run.operation[-1]))
            now += dwell_s


def _runs(path: PlannedPath) -> Iterator[PieceBlock]:
    """Yield the pieces from rest to rest."""
    pending: list[PieceBlock] = []
    count = 0
    for block in path:
        first = 0
        for stop in [*(int(k) + 1 for k in np.flatnonzero(block.rest_after)), len(block)]:
            while first < stop:
                last = min(stop, first + MOST_PIECES - count)
                pending.append(_rows(block, first, last))
                count += last - first
                first = last
                if block.rest_after[last - 1] or count == MOST_PIECES:
                    yield _joined(pending)
                    pending, count = [], 0
    if pending:
        yield _joined(pending)


def _rows(block: PieceBlock, first: int, stop: int) -> PieceBlock:
    rows = slice(first, stop)
    return PieceBlock(
        coefficients=block.coefficients[rows],
        operation=block.operation[rows],
        nominal_s=block.nominal_s[rows],
        rest_after=block.rest_after[rows],
        dwell_s=block.dwell_s[rows],
        line=block.line[rows],
    )


def _joined(parts: list[PieceBlock]) -> PieceBlock:
    order = max(part.coefficients.shape[1] for part in parts)
    padded = [
        np.pad(p.coefficients, ((0, 0), (0, order - p.coefficients.shape[1]), (0, 0)))
        for p in parts
    ]
    return PieceBlock(
        coefficients=np.concatenate(padded),
        operation=np.concatenate([p.operation for p in parts]),
        nominal_s=np.concatenate([p.nominal_s for p in parts]),
        rest_after=np.concatenate([p.rest_after for p in parts]),
        dwell_s=np.concatenate([p.dwell_s for p in parts]),
        line=np.concatenate([p.line for p in parts]),
    )


def _moved(
    run: PieceBlock,
    moves: np.ndarray[tuple[int, ...], np.dtype[np.bool_]],
    radius_m: FloatArray,
    limits: Limits,
    begin_s: float,
) -> TrajectoryBlock:
    c = run.coefficients[moves]
    if c.shape[1] < 4:
        c = np.pad(c, ((0, 0), (0, 4 - c.shape[1]), (0, 0)))
    elements = elements_of(
        c,
        1.0 / np.sqrt(factors(c, radius_m)[:-1]),
        run.nominal_s[moves],
        run.operation[moves],
        1.0,
        from_rest=True,
        to_rest=True,
    )
    solution = fastest(elements, limits, GAP)
    coefficients, duration_s, operation = in_time(solution, limits)
    start_s = begin_s + np.concatenate([[0.0], np.cumsum(duration_s)[:-1]])
    return TrajectoryBlock(
        start_s=start_s, duration_s=duration_s, coefficients=coefficients, operation=operation
    )


def in_time(solution: Solution, limits: Limits) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return the motion as polynomials of fifth degree in time.

    Each has the position, velocity and acceleration of the motion at both ends; where one of them
    would leave a limit in between, it is cut in two. What still would after some cuts slows the
    whole motion down: the motion runs from rest to rest, so that it may be stretched evenly.

    Returns
    -------
    (m, 6, axes) coefficients over [0, 1], (m,) durations in s, (m,) operations.
    """
    elements, y = solution.elements, solution.y
    c, power, operation = elements.c, _powers(y), elements.operation
    done: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    source = np.arange(len(c), dtype=np.float64)
    for cut in range(_CUTS + 1):
        coefficients, duration_s = _hermite(c, power)
        beyond = _beyond(coefficients, duration_s, limits)
        if cut == _CUTS:
            beyond[:] = False
        kept = ~beyond
        done.append((source[kept], coefficients[kept], duration_s[kept]))
        if not beyond.any():
            break
        c, power, source = _halved(c[beyond], power[beyond], source[beyond], 0.5 ** (cut + 1))
    places = np.concatenate([part[0] for part in done])
    order = np.argsort(places, kind="stable")
    coefficients = np.concatenate([part[1] for part in done])[order]
    duration_s = np.concatenate([part[2] for part in done])[order]
    return (
        coefficients,
        duration_s * _stretch(coefficients, duration_s, limits),
        operation[np.floor(places[order]).astype(np.int64)],
    )


def _powers(y: FloatArray) -> FloatArray:
    """Return (n, 3) powers of quadratics from their Bernstein coefficients."""
    first, middle, last = y.T
    return np.asarray(np.stack([first, 2.0 * (middle - first), first - 2.0 * middle + last], 1))


def _halved(
    c: FloatArray, power: FloatArray, source: FloatArray, place: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    n = len(c)
    begin = np.tile([0.0, 0.5], n)
    half = np.full(2 * n, 0.5)
    twice = np.repeat(np.arange(n), 2)
    # In the parameter of a half, u' is twice as large.
    y = 4.0 * restricted(power[twice][:, :, None], begin, half)[:, :, 0]
    return restricted(c[twice], begin, half), y, source[twice] + np.tile([0.0, place], n)


def _hermite(c: FloatArray, power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (n, 6, axes) polynomials over [0, 1] of time, and (n,) durations."""
    y = power[:, :1] + (power[:, 1:2] + power[:, 2:] * _NODES) * _NODES
    duration_s = (y**-0.5) @ _WEIGHTS
    number = np.arange(_ORDER)[:, None]
    ends = []
    for u in (0.0, 1.0):
        now = power[:, 0] + u * (power[:, 1] + u * power[:, 2])
        rate = power[:, 1] + 2.0 * u * power[:, 2]
        first = c[:, 1] if u == 0.0 else (number * c).sum(axis=1)
        second = 2.0 * c[:, 2] if u == 0.0 else (number * (number - 1) * c).sum(axis=1)
        ends.append(
            (
                first * (np.sqrt(now) * duration_s)[:, None],
                second * (now * duration_s**2)[:, None]
                + first * (0.5 * rate * duration_s**2)[:, None],
            )
        )
    (v0, a0), (v1, a1) = ends
    q0 = c[:, 0]
    # Without the position itself: its rounding, over the cube of a short time, would be a jerk.
    gone = c[:, 1:].sum(axis=1) - v0 - 0.5 * a0
    slope, bend = v1 - v0 - a0, a1 - a0
    return np.stack(
        [
            q0,
            v0,
            0.5 * a0,
            10.0 * gone - 4.0 * slope + 0.5 * bend,
            -15.0 * gone + 7.0 * slope - bend,
            6.0 * gone - 3.0 * slope + 0.5 * bend,
        ],
        axis=1,
    ), duration_s


def _beyond(
    coefficients: FloatArray, duration_s: FloatArray, limits: Limits
) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return which polynomials may leave a limit, by their Bernstein coefficients."""
    out = np.zeros(len(duration_s), dtype=bool)
    for _, share in _shares(coefficients, duration_s, limits):
        out |= share > _WITHIN
    return out


def _stretch(coefficients: FloatArray, duration_s: FloatArray, limits: Limits) -> float:
    """Return by how much the time is to be stretched so that no limit is left."""
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
    """Yield orders of derivatives and (n,) bounds of the shares of their limits."""
    power = coefficients
    for order, limit in enumerate((limits.velocity, limits.acceleration, limits.jerk), start=1):
        power = power[:, 1:] * np.arange(1, power.shape[1])[None, :, None]
        yield order, (_hull(power) / (limit * duration_s[:, None] ** order)).max(axis=1)


def _hull(power: FloatArray) -> FloatArray:
    """Return (n, axes): the largest of the absolute Bernstein coefficients."""
    degree = power.shape[1] - 1
    matrix = np.zeros((degree + 1, degree + 1))
    for i in range(degree + 1):
        share = 1.0
        for k in range(i + 1):
            matrix[i, k] = share
            share *= (i - k) / (degree - k) if degree > k else 0.0
    return np.asarray(np.abs(np.einsum("ik,nka->nia", matrix, power)).max(axis=1))
