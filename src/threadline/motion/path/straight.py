"""The simple interpolations: chords, chords joined by parabolas, and polynomials in time.

Each axis passes a point at the smaller of its mean velocities before and after the point, and at 0
where it turns back. So each piece is monotone, and its end velocities are 0 to 1 times its mean.
The time of every piece, and so its mean velocity, comes from ``polynomial_time_s``. A quintic
passes the points without acceleration.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.motion.path.durations import (
    chord_time_s,
    polynomial_time_s,
    rest_to_rest_s,
    whole_ticks_s,
)
from threadline.motion.path.polygon import LEAST_SPACING_M, turns
from threadline.motion.path.runs import Chunk, Vertices, join_vertices, runs
from threadline.motion.path.types import PieceBlock, ProgrammedPath, VertexBlock

if TYPE_CHECKING:
    from threadline.machine import Machine


def velocity_limit_of(programmed: ProgrammedPath, machine: Machine) -> FloatArray:
    """Return the (axes,) velocity limits in the order of the path's axes."""
    return machine.velocity_limit[[machine.axis_names.index(axis) for axis in programmed.axes]]


def chords(programmed: ProgrammedPath) -> Iterator[PieceBlock]:
    """Yield one straight piece per move, with the time at its feed (0 for a rapid move)."""
    for block, start in with_previous(programmed):
        displacement = np.diff(block.positions, axis=0, prepend=start)
        coefficients = np.stack([block.positions - displacement, displacement], axis=1)
        yield _straight_pieces(block, coefficients, block.nominal_s, rest_after=block.rest)


def linear_pieces(programmed: ProgrammedPath, machine: Machine) -> Iterator[PieceBlock]:
    """Yield one straight piece per move, at constant velocity, all axes arriving together.

    The travel time is rounded up to whole ticks (``whole_ticks_s``).
    """
    tick_s = float(machine.tick_clock.period_s)
    limit = velocity_limit_of(programmed, machine)
    for block, start in with_previous(programmed):
        displacement = np.diff(block.positions, axis=0, prepend=start)
        time_s = whole_ticks_s(chord_time_s(displacement, block.nominal_s, limit), tick_s)
        begin = block.positions - displacement
        coefficients = np.stack([begin, displacement], axis=1)
        yield _straight_pieces(block, coefficients, time_s, rest_after=block.rest)


def point_to_point_pieces(programmed: ProgrammedPath, machine: Machine) -> Iterator[PieceBlock]:
    """Yield one straight piece per move that starts and ends at rest.

    The velocity is a parabola over time whose peak is the feed (``rest_to_rest_s``).
    """
    limit = velocity_limit_of(programmed, machine)
    for block, start in with_previous(programmed):
        displacement = np.diff(block.positions, axis=0, prepend=start)
        time_s = rest_to_rest_s(chord_time_s(displacement, block.nominal_s, limit))
        begin = block.positions - displacement
        zero = np.zeros_like(begin)
        coefficients = np.stack([begin, zero, 3.0 * displacement, -2.0 * displacement], axis=1)
        yield _straight_pieces(
            block, coefficients, time_s, rest_after=np.ones(len(block), dtype=np.int64)
        )


def with_previous(programmed: ProgrammedPath) -> Iterator[tuple[VertexBlock, FloatArray]]:
    """Yield every block with the (1, axes) position before it; for the first, the start."""
    previous: FloatArray | None = None
    for block in programmed:
        yield block, block.positions[:1] if previous is None else previous
        previous = block.positions[-1:]


def _straight_pieces(
    block: VertexBlock, coefficients: FloatArray, time_s: FloatArray, *, rest_after: object
) -> PieceBlock:
    return PieceBlock(
        coefficients=coefficients,
        operation=block.operation,
        nominal_s=time_s,
        rest_after=np.asarray(rest_after),
        dwell_s=block.dwell_s,
        line=block.line,
    )


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
    buffered: Vertices | None = None
    velocity_before: FloatArray | None = None  # mean velocities of the chord before ``buffered``
    for chunk in runs(programmed):
        buffered = join_vertices(buffered, *chunk.parts)
        count = len(buffered)
        stop = count - 1 if chunk.is_last else count - 2
        if stop > 0:
            leg = np.diff(buffered.positions, axis=0)
            time_s = polynomial_time_s(leg, buffered.nominal_s[1:], limits, quintic=quintic)
            mean_velocity = leg / time_s[:, None]
            vertex_velocity = np.zeros_like(buffered.positions)
            first_velocity = mean_velocity[:1] * 0.0 if velocity_before is None else velocity_before
            vertex_velocity[:-1] = _between(
                np.concatenate([first_velocity, mean_velocity[:-1]]), mean_velocity
            )
            yield _polynomial_pieces(buffered, vertex_velocity, time_s, stop, chunk, quintic)
            velocity_before = mean_velocity[stop - 1 : stop]
        elif chunk.is_last and chunk.dwell_s > 0:
            yield pause(buffered, chunk.dwell_s)
        if chunk.is_last:
            buffered, velocity_before = buffered.take(slice(count - 1, None)), None
        elif stop > 0:
            buffered = buffered.take(slice(stop, None))


def _between(before: FloatArray, after: FloatArray) -> FloatArray:
    """Return the smaller of two velocities with the same sign, else 0."""
    smaller = np.minimum(np.abs(before), np.abs(after))
    return np.asarray(np.where(before * after > 0, np.sign(after) * smaller, 0.0))


def _polynomial_pieces(
    vertices: Vertices,
    vertex_velocity: FloatArray,
    time_s: FloatArray,
    stop: int,
    chunk: Chunk,
    quintic: bool,
) -> PieceBlock:
    begin, end = vertices.positions[:stop], vertices.positions[1 : stop + 1]
    leg = end - begin
    first = vertex_velocity[:stop] * time_s[:stop, None]
    last = vertex_velocity[1 : stop + 1] * time_s[:stop, None]
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
    if chunk.is_last:
        rest[-1], dwell[-1] = 1, chunk.dwell_s
    return PieceBlock(
        coefficients=np.stack(shape, axis=1),
        operation=vertices.operation[1 : stop + 1],
        nominal_s=time_s[:stop],
        rest_after=rest,
        dwell_s=dwell,
        line=vertices.line[1 : stop + 1],
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


CUT = 4.0  # a parabola over the length l on either side cuts the corner by turn * l / 4


def blended_pieces(programmed: ProgrammedPath, cut_m: float) -> Iterator[PieceBlock]:
    """Yield lines and, at every vertex in motion, a parabola that cuts it by at most ``cut_m``.

    This is the linear path with parabolic blends of the textbooks (Craig, "Introduction to
    Robotics", trajectory generation): a parabola traversed evenly in its parameter is a motion of
    constant acceleration. Each parabola begins as far before the vertex as it ends after it, at
    most half way to the next vertex, and is yielded as two pieces, one for each of the two moves.
    """
    radius = programmed.radius_m
    buffered: Vertices | None = None
    first_chord = 0  # first chord in ``buffered`` that was not yielded yet
    for chunk in runs(programmed):
        buffered = join_vertices(buffered, *chunk.parts)
        while True:
            length, turn = turns(buffered.positions, radius, programmed.local)
            tight_corners = np.flatnonzero(CUT * cut_m < LEAST_SPACING_M * turn)
            tight_corners = tight_corners[tight_corners > first_chord]
            if not len(tight_corners):
                break
            stop = int(tight_corners[0])
            yield _blends_pieces(
                buffered, length, turn, cut_m, (first_chord, stop), is_last=True, dwell_s=0.0
            )
            buffered, first_chord = buffered.take(slice(stop, None)), 0
        stop = len(buffered) - 1 if chunk.is_last else len(buffered) - 2
        if stop > first_chord:
            yield _blends_pieces(
                buffered,
                length,
                turn,
                cut_m,
                (first_chord, stop),
                is_last=chunk.is_last,
                dwell_s=chunk.dwell_s,
            )
        elif chunk.is_last and chunk.dwell_s > 0:
            yield pause(buffered, chunk.dwell_s)
        if chunk.is_last:
            buffered, first_chord = buffered.take(slice(len(buffered) - 1, None)), 0
        elif stop > first_chord:
            buffered, first_chord = buffered.take(slice(stop - 1, None)), 1


def _blends_pieces(
    vertices: Vertices,
    length: FloatArray,
    turn: FloatArray,
    cut_m: float,
    chord_range: tuple[int, int],
    *,
    is_last: bool,
    dwell_s: float,
) -> PieceBlock:
    """Return the chords between two vertices and the corners at their ends."""
    first, stop = chord_range
    turn = turn.copy()
    if is_last:
        turn[stop] = 0.0
    half_legs = np.minimum(np.append(length, np.inf), np.insert(length, 0, np.inf)) / 2.0
    with np.errstate(divide="ignore"):
        blend_m = np.where(turn > 0, np.minimum(CUT * cut_m / turn, half_legs), 0.0)
    chords = np.arange(first, stop)
    leg = vertices.positions[chords + 1] - vertices.positions[chords]
    share_before = (blend_m[chords] / length[chords])[:, None]
    share_after = (blend_m[chords + 1] / length[chords])[:, None]
    next_chords = np.minimum(chords + 1, len(length) - 1)
    next_leg = vertices.positions[next_chords + 1] - vertices.positions[next_chords]
    next_share = (blend_m[chords + 1] / length[next_chords])[:, None]
    vertex = vertices.positions[chords + 1]
    enter, leave = vertex - share_after * leg, vertex + next_share * next_leg
    bend = (enter - 2.0 * vertex + leave) / 4.0
    zero = np.zeros_like(leg)
    line = [
        vertices.positions[chords] + share_before * leg,
        (1.0 - share_before - share_after) * leg,
        zero,
    ]
    first_half = [enter, vertex - enter, bend]
    second_half = [(enter + 2.0 * vertex + leave) / 4.0, (leave - enter) / 2.0, bend]
    coefficients = np.stack(
        [np.stack(part, axis=1) for part in (line, first_half, second_half)], axis=1
    )
    arriving = vertices.nominal_s[chords + 1] * share_after[:, 0]
    leaving = vertices.nominal_s[next_chords + 1] * next_share[:, 0]
    middle = (arriving + leaving) / 2.0
    nominal = np.stack(
        [
            vertices.nominal_s[chords + 1] * (1.0 - share_before - share_after)[:, 0],
            np.maximum(arriving, middle),
            np.maximum(middle, leaving),
        ],
        axis=1,
    )
    corner = blend_m[chords + 1] > 0
    straight = (1.0 - share_before - share_after)[:, 0] > 1e-12
    kept_pieces = np.flatnonzero(np.stack([straight, corner, corner], axis=1))
    operation = np.stack(
        [vertices.operation[k] for k in (chords + 1, chords + 1, next_chords + 1)], axis=1
    )
    lines = np.stack([vertices.line[k] for k in (chords + 1, chords + 1, next_chords + 1)], axis=1)
    rest, dwell = np.zeros(len(kept_pieces), dtype=np.int64), np.zeros(len(kept_pieces))
    if is_last:
        rest[-1], dwell[-1] = 1, dwell_s
    return PieceBlock(
        coefficients=coefficients.reshape(-1, 3, leg.shape[1])[kept_pieces],
        operation=operation.reshape(-1)[kept_pieces],
        nominal_s=nominal.reshape(-1)[kept_pieces],
        rest_after=rest,
        dwell_s=dwell,
        line=lines.reshape(-1)[kept_pieces],
    )
