"""Straight lines joined by parabolas."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from threadline.arrays import FloatArray
from threadline.path.polygon import LEAST_SPACING_M, turns
from threadline.path.polynomial import pause
from threadline.path.runs import Vertices, join_vertices, runs
from threadline.path.types import PieceBlock, ProgrammedPath

CUT = 4.0  # a parabola over the length l on either side cuts the corner by turn * l / 4


def blended_pieces(programmed: ProgrammedPath, cut_m: float) -> Iterator[PieceBlock]:
    """Yield lines and, at every vertex in motion, a parabola that cuts it by ``cut_m`` at most.

    This is the linear path with parabolic blends of the textbooks (Craig, "Introduction to
    Robotics", trajectory generation): a parabola traversed evenly in its parameter is a motion of
    constant acceleration. Each parabola begins as far before the vertex as it ends after it, at
    most half way to the next vertex, and is yielded as two pieces, one for each of the two moves.
    """
    radius = programmed.radius_m
    held: Vertices | None = None
    first = 0  # first chord between ``held`` that was not yielded yet
    for chunk in runs(programmed):
        held = join_vertices(held, *chunk.parts)
        while True:
            length, turn = turns(held.positions, radius, programmed.local)
            tight = np.flatnonzero(CUT * cut_m < LEAST_SPACING_M * turn)
            tight = tight[tight > first]
            if not len(tight):
                break
            stop = int(tight[0])
            yield _pieces(held, length, turn, cut_m, first, stop, ends=True, dwell_s=0.0)
            held, first = held.take(slice(stop, None)), 0
        stop = len(held) - 1 if chunk.ends else len(held) - 2
        if stop > first:
            yield _pieces(
                held, length, turn, cut_m, first, stop, ends=chunk.ends, dwell_s=chunk.dwell_s
            )
        elif chunk.ends and chunk.dwell_s > 0:
            yield pause(held, chunk.dwell_s)
        if chunk.ends:
            held, first = held.take(slice(len(held) - 1, None)), 0
        elif stop > first:
            held, first = held.take(slice(stop - 1, None)), 1


def _pieces(
    held: Vertices,
    length: FloatArray,
    turn: FloatArray,
    cut_m: float,
    first: int,
    stop: int,
    *,
    ends: bool,
    dwell_s: float,
) -> PieceBlock:
    """Return the chords ``first`` to ``stop`` and the corners at their ends."""
    turn = turn.copy()
    if ends:
        turn[stop] = 0.0
    room = np.minimum(np.append(length, np.inf), np.insert(length, 0, np.inf)) / 2.0
    with np.errstate(divide="ignore"):
        reach = np.where(turn > 0, np.minimum(CUT * cut_m / turn, room), 0.0)
    chords = np.arange(first, stop)
    leg = held.positions[chords + 1] - held.positions[chords]
    before = (reach[chords] / length[chords])[:, None]
    after = (reach[chords + 1] / length[chords])[:, None]
    onward = np.minimum(chords + 1, len(length) - 1)
    next_leg = held.positions[onward + 1] - held.positions[onward]
    next_share = (reach[chords + 1] / length[onward])[:, None]
    vertex = held.positions[chords + 1]
    enter, leave = vertex - after * leg, vertex + next_share * next_leg
    bend = (enter - 2.0 * vertex + leave) / 4.0
    zero = np.zeros_like(leg)
    line = [held.positions[chords] + before * leg, (1.0 - before - after) * leg, zero]
    one = [enter, vertex - enter, bend]
    two = [(enter + 2.0 * vertex + leave) / 4.0, (leave - enter) / 2.0, bend]
    coefficients = np.stack([np.stack(part, axis=1) for part in (line, one, two)], axis=1)
    arriving = held.nominal_s[chords + 1] * after[:, 0]
    leaving = held.nominal_s[onward + 1] * next_share[:, 0]
    middle = (arriving + leaving) / 2.0
    nominal = np.stack(
        [
            held.nominal_s[chords + 1] * (1.0 - before - after)[:, 0],
            np.maximum(arriving, middle),
            np.maximum(middle, leaving),
        ],
        axis=1,
    )
    corner = reach[chords + 1] > 0
    straight = (1.0 - before - after)[:, 0] > 1e-12
    kept = np.flatnonzero(np.stack([straight, corner, corner], axis=1))
    operation = np.stack([held.operation[k] for k in (chords + 1, chords + 1, onward + 1)], axis=1)
    lines = np.stack([held.line[k] for k in (chords + 1, chords + 1, onward + 1)], axis=1)
    rest, dwell = np.zeros(len(kept), dtype=np.int64), np.zeros(len(kept))
    if ends:
        rest[-1], dwell[-1] = 1, dwell_s
    return PieceBlock(
        coefficients=coefficients.reshape(-1, 3, leg.shape[1])[kept],
        operation=operation.reshape(-1)[kept],
        nominal_s=nominal.reshape(-1)[kept],
        rest_after=rest,
        dwell_s=dwell,
        line=lines.reshape(-1)[kept],
    )
