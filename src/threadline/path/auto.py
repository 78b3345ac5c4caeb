"""The path that follows the program within a tolerance: lines where straight, B-splines elsewhere.

The programmed vertices and points added beside them are the control polygon of one cubic
B-spline per run between two rests, with knots spaced as the points are. Four control points in a
row on one line make a straight piece; whatever they are, pieces join with continuous second
derivative, and the spline stays in the hull of its polygon, so that it never leaves the travel.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray
from threadline.path.polygon import (
    EVEN_CUT,
    LEAST_SPACING_M,
    Controls,
    control_polygon,
    join_controls,
    turns,
)
from threadline.path.runs import COINCIDENT_M, Chunk, Vertices, join_vertices, runs
from threadline.path.spans import pieces_of
from threadline.path.types import PieceBlock, ProgrammedPath

_AHEAD = 1  # vertex beyond a chord that its control points depend on
_CARRIED = 2  # control points before and after a span that its shape depends on


def auto_pieces(
    programmed: ProgrammedPath, cut_m: float, near_m: float = COINCIDENT_M
) -> Iterator[PieceBlock]:
    """Yield the pieces of a path that is never farther than ``cut_m + near_m`` from the program.

    ``cut_m`` is a distance at the tool, rotary axes at their radius; vertices within ``near_m`` of
    each other are one.
    """
    run = _Run(programmed.radius_m, cut_m)
    for chunk in runs(programmed, near_m):
        yield from run.extend(chunk)


def points_added(programmed: ProgrammedPath, cut_m: float) -> int:
    """Return how many control points are not vertices of the program; reads it once."""
    run = _Run(programmed.radius_m, cut_m)
    for chunk in runs(programmed):
        for _ in run.extend(chunk):
            pass
    return run.added


@dataclass(slots=True)
class _Run:
    """The run under way: what has come in and is not yet a piece."""

    radius_m: FloatArray
    cut_m: float
    vertices: Vertices | None = None
    controls: Controls | None = None
    first_chord: int = 0  # of those between ``vertices`` that is not yet in ``controls``
    begun: bool = False  # pieces of this run are out
    added: int = 0  # control points that are not vertices, so far

    def extend(self, chunk: Chunk) -> Iterator[PieceBlock]:
        """Take in more vertices and yield the pieces that they settle."""
        self.vertices = join_vertices(self.vertices, chunk.vertices)
        while True:
            length, turn = turns(self.vertices.positions, self.radius_m)
            # A corner that leaves no room for a curve within the tolerance is met at rest.
            tight = np.flatnonzero(self.cut_m < EVEN_CUT * LEAST_SPACING_M * turn)
            tight = tight[tight >= max(self.first_chord, 1)]
            if not len(tight):
                break
            yield from self._advance(int(tight[0]), length, turn, ends=True, dwell_s=0.0)
        count = len(self.vertices)
        if chunk.ends:
            yield from self._advance(count - 1, length, turn, ends=True, dwell_s=chunk.dwell_s)
        elif count - 1 - _AHEAD > self.first_chord:
            yield from self._advance(count - 1 - _AHEAD, length, turn, ends=False, dwell_s=0.0)

    def _advance(
        self, stop: int, length: FloatArray, turn: FloatArray, *, ends: bool, dwell_s: float
    ) -> Iterator[PieceBlock]:
        """Turn the chords up to vertex ``stop`` into control points, and these into pieces."""
        assert self.vertices is not None
        vertices = self.vertices
        if ends:
            length, turn = length[:stop], np.append(turn[:stop], 0.0)
        if ends and stop == 0 and self.controls is None:
            if dwell_s > 0:
                yield _pause(vertices, dwell_s)
            return
        if self.controls is None:
            self.controls = _start_of(vertices)
        if stop > self.first_chord:
            fresh = control_polygon(vertices, length, turn, self.cut_m, self.first_chord, stop)
            self.controls = join_controls(self.controls, fresh)
            self.added += int(fresh.added.sum())
        yield from self._settle(ends, dwell_s)
        if ends:
            self.vertices, self.first_chord = vertices.take(slice(stop, None)), 0
        else:
            kept = max(stop - _AHEAD, 0)
            self.vertices, self.first_chord = vertices.take(slice(kept, None)), stop - kept

    def _settle(self, ends: bool, dwell_s: float) -> Iterator[PieceBlock]:
        controls = self.controls
        assert controls is not None
        first = _CARRIED if self.begun else 0
        stop = len(controls) - 1 - (0 if ends else _CARRIED)
        if stop > first:
            yield pieces_of(controls, first, stop, ends=ends, dwell_s=dwell_s)
            self.controls = controls.take(slice(stop - _CARRIED, None))
            self.begun = True
        if ends:
            self.controls, self.begun = None, False


def _start_of(vertices: Vertices) -> Controls:
    start = vertices.take(slice(0, 1))
    return Controls(
        positions=start.positions,
        turn=np.zeros(1),
        added=np.zeros(1, dtype=np.int64),
        length_m=np.zeros(1),
        nominal_s=np.zeros(1),
        operation=start.operation,
        line=start.line,
    )


def _pause(vertices: Vertices, dwell_s: float) -> PieceBlock:
    coefficients = np.zeros((1, 4, vertices.positions.shape[1]))
    coefficients[0, 0] = vertices.positions[0]
    return PieceBlock(
        coefficients=coefficients,
        operation=vertices.operation[:1],
        nominal_s=np.zeros(1),
        rest_after=np.ones(1, dtype=np.int64),
        dwell_s=np.array([dwell_s]),
        line=vertices.line[:1],
    )
