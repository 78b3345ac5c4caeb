"""Cubic and quintic polynomials in time from point to point, passing the points in motion.

Each axis passes a point at the smaller of the mean velocities before and after it, and at 0 where
it turns back. So each piece is monotone and its end velocities are 0 to 1 times its mean velocity.
The time of every piece, on which the mean velocities depend, is that of ``polynomial_time_s``. A
quintic passes the points without acceleration.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from threadline.arrays import FloatArray
from threadline.durations.polynomial_times import polynomial_time_s
from threadline.path.runs import Chunk, Vertices, join_vertices, runs
from threadline.path.types import PieceBlock, ProgrammedPath


def polynomial_pieces(
    programmed: ProgrammedPath, limits: tuple[FloatArray, ...], *, quintic: bool
) -> Iterator[PieceBlock]:
    """Yield one polynomial in time per move.

    Parameters
    ----------
    programmed
        The programmed path.
    limits
        (axes,) limits of velocity, acceleration and, for a quintic, jerk.
    quintic
        Whether the pieces have continuous acceleration.
    """
    held: Vertices | None = None
    before: FloatArray | None = None  # mean velocities of the chord before ``held``
    for chunk in runs(programmed):
        held = join_vertices(held, *chunk.parts)
        count = len(held)
        stop = count - 1 if chunk.ends else count - 2
        if stop > 0:
            leg = np.diff(held.positions, axis=0)
            time_s = polynomial_time_s(leg, held.nominal_s[1:], limits, quintic=quintic)
            mean = leg / time_s[:, None]
            via = np.zeros_like(held.positions)
            first = mean[:1] * 0.0 if before is None else before
            via[:-1] = _between(np.concatenate([first, mean[:-1]]), mean)
            yield _pieces(held, via, time_s, stop, chunk, quintic)
            before = mean[stop - 1 : stop]
        elif chunk.ends and chunk.dwell_s > 0:
            yield pause(held, chunk.dwell_s)
        if chunk.ends:
            held, before = held.take(slice(count - 1, None)), None
        elif stop > 0:
            held = held.take(slice(stop, None))


def _between(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the smaller of two velocities of one sign, else 0."""
    smaller = np.minimum(np.abs(before), np.abs(after))
    return np.asarray(np.where(before * after > 0, np.sign(after) * smaller, 0.0))


def _pieces(
    held: Vertices, via: FloatArray, time_s: FloatArray, stop: int, chunk: Chunk, quintic: bool
) -> PieceBlock:
    begin, end = held.positions[:stop], held.positions[1 : stop + 1]
    leg = end - begin
    first = via[:stop] * time_s[:stop, None]
    last = via[1 : stop + 1] * time_s[:stop, None]
    zero = np.zeros_like(leg)
    if quintic:
        shape = [
            begin,
            first,
            zero,
            10.0 * leg - 6.0 * first - 4.0 * last,
            -15.0 * leg + 8.0 * first + 7.0 * last,
            6.0 * leg - 3.0 * first - 3.0 * last,
        ]
    else:
        shape = [begin, first, 3.0 * leg - 2.0 * first - last, first + last - 2.0 * leg]
    rest = np.zeros(stop, dtype=np.int64)
    dwell = np.zeros(stop)
    if chunk.ends:
        rest[-1], dwell[-1] = 1, chunk.dwell_s
    return PieceBlock(
        coefficients=np.stack(shape, axis=1),
        operation=held.operation[1 : stop + 1],
        nominal_s=time_s[:stop],
        rest_after=rest,
        dwell_s=dwell,
        line=held.line[1 : stop + 1],
    )


def pause(held: Vertices, dwell_s: float) -> PieceBlock:
    """Return a pause of ``dwell_s`` at the last of the vertices."""
    return PieceBlock(
        coefficients=held.positions[-1:, None, :],
        operation=held.operation[-1:],
        nominal_s=np.zeros(1),
        rest_after=np.ones(1, dtype=np.int64),
        dwell_s=np.array([dwell_s]),
        line=held.line[-1:],
    )
