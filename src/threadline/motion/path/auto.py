"""Paths that follow the program within a tolerance: lines where straight, B-splines elsewhere.

Between two rests, the programmed vertices and points added beside them are the polygon of one
B-spline. A cubic has them as control points, with knots spaced like them; its pieces join with
continuous second derivative. A quartic has them as knots, with control points in between
(``greville``); its pieces join with continuous third derivative. A piece is straight if all of its
control points are on one line. Both splines stay in the convex hull of their polygon and so within
the travel of the axes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.motion.path.greville import AHEAD, CUT, REACH
from threadline.motion.path.polygon import (
    CUBIC,
    EVEN_CUT,
    LEAST_SPACING_M,
    Chords,
    Controls,
    control_polygon,
    join_controls,
    pieces_of,
    turns,
)
from threadline.motion.path.runs import COINCIDENT_M, Chunk, Vertices, join_vertices, runs
from threadline.motion.path.thinned import thinned_runs
from threadline.motion.path.types import PieceBlock, ProgrammedPath
from threadline.motion.path.wide_corners import EVEN, Corners, moved_outside

if TYPE_CHECKING:
    from threadline.machine.mandrel import LocalRadii


def auto_pieces(
    programmed: ProgrammedPath,
    cut_m: float,
    near_m: float = COINCIDENT_M,
    *,
    degree: int = CUBIC,
    thin: bool = False,
    corners: Corners = EVEN,
) -> Iterator[PieceBlock]:
    """Yield the pieces of a path that is never farther than ``cut_m + near_m`` from the program.

    Both are distances at the tool, with rotary axes at their radius. A vertex within ``near_m`` of
    its predecessor is left out; ``degree`` is as for ``pieces_of``. With ``thin``, chords replace
    moves where the program is rough (``thinned_runs``); the pieces of a chord belong to the last of
    its moves. With ``corners`` the path may leave the program on the outside of a corner, too,
    or cut single corners less; then ``cut_m`` holds at corners that their neighbours do not reach.
    """
    run = _Run(programmed.radius_m, programmed.local, cut_m, degree)
    chunks = thinned_runs(programmed, near_m, cut_m) if thin else runs(programmed, near_m)
    if corners != EVEN:
        chunks = moved_outside(chunks, programmed, cut_m, corners)
    for chunk in chunks:
        yield from run.extend(chunk)


def points_added(
    programmed: ProgrammedPath, cut_m: float, degree: int = CUBIC, corners: Corners = EVEN
) -> int:
    """Return the number of added points, which are not vertices; reads the whole program."""
    run = _Run(programmed.radius_m, programmed.local, cut_m, degree)
    chunks = runs(programmed)
    if corners != EVEN:
        chunks = moved_outside(chunks, programmed, cut_m, corners)
    for chunk in chunks:
        for _ in run.extend(chunk):
            pass
    return run.added


@dataclass(slots=True)
class _Run:
    """State of the current run: vertices and control points that are not yet in a piece."""

    radius_m: FloatArray
    local: LocalRadii | None
    cut_m: float
    degree: int = CUBIC
    vertices: Vertices | None = None
    controls: Controls | None = None
    first_chord: int = 0  # first chord between ``vertices`` that is not yet in ``controls``
    is_first: bool = True  # whether the run begins with the first of ``vertices``
    begun: bool = False  # whether pieces of this run were yielded already
    added: int = 0  # number of control points so far that are not vertices

    @property
    def _ahead(self) -> int:
        """Number of vertices beyond a chord that affect its points."""
        return 1 if self.degree == CUBIC else AHEAD

    @property
    def _carried(self) -> int:
        """Number of points on either side of a span that affect its shape."""
        return 2 if self.degree == CUBIC else REACH

    def extend(self, chunk: Chunk) -> Iterator[PieceBlock]:
        """Add vertices, and yield the pieces that no later vertex can change."""
        self.vertices = join_vertices(self.vertices, *chunk.parts)
        cut_factor = EVEN_CUT if self.degree == CUBIC else CUT
        while True:
            length, turn = turns(self.vertices.positions, self.radius_m, self.local)
            # At a corner too tight for a curve within the tolerance the motion comes to rest.
            least_m = self.cut_m + self.vertices.more_m - self.vertices.beside_m.max()
            tight_corners = np.flatnonzero(least_m < cut_factor * LEAST_SPACING_M * turn)
            tight_corners = tight_corners[tight_corners >= max(self.first_chord, 1)]
            if not len(tight_corners):
                break
            yield from self._advance(int(tight_corners[0]), length, turn, is_last=True, dwell_s=0.0)
        count = len(self.vertices)
        if chunk.is_last:
            yield from self._advance(count - 1, length, turn, is_last=True, dwell_s=chunk.dwell_s)
        elif count - 1 - self._ahead > self.first_chord:
            stop = count - 1 - self._ahead
            yield from self._advance(stop, length, turn, is_last=False, dwell_s=0.0)

    def _advance(
        self, stop: int, length: FloatArray, turn: FloatArray, *, is_last: bool, dwell_s: float
    ) -> Iterator[PieceBlock]:
        """Turn the chords up to vertex ``stop`` into control points, and these into pieces."""
        assert self.vertices is not None
        vertices = self.vertices
        if is_last:
            length, turn = length[:stop], np.append(turn[:stop], 0.0)
        if is_last and stop == 0 and self.controls is None:
            if dwell_s > 0:
                yield _pause(vertices, dwell_s)
            return
        if self.controls is None:
            self.controls = _start_of(vertices)
        if stop > self.first_chord:
            chords = Chords(self.first_chord, stop, self.is_first, is_last)
            new_controls = control_polygon(vertices, length, turn, self.cut_m, chords, self.degree)
            self.controls = join_controls(self.controls, new_controls)
            self.added += int(new_controls.added.sum())
        yield from self._settle(is_last, dwell_s)
        if is_last:
            self.vertices, self.first_chord = vertices.take(slice(stop, None)), 0
            self.is_first = True
        else:
            first_kept = max(stop - self._ahead, 0)
            self.is_first = self.is_first and first_kept == 0
            self.vertices, self.first_chord = (
                vertices.take(slice(first_kept, None)),
                stop - first_kept,
            )

    def _settle(self, is_last: bool, dwell_s: float) -> Iterator[PieceBlock]:
        controls = self.controls
        assert controls is not None
        first = self._carried if self.begun else 0
        stop = len(controls) - 1 - (0 if is_last else self._carried)
        # The first pieces of a run carry as many points as any others.
        if stop > first and (is_last or stop >= self._carried):
            yield pieces_of(
                controls, first, stop, is_last=is_last, dwell_s=dwell_s, degree=self.degree
            )
            self.controls = controls.take(slice(stop - self._carried, None))
            self.begun = True
        if is_last:
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
