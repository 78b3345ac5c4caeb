"""Distance of a planned path from the programmed one, as the planner reports it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.path.nearest import compare
from threadline.path.types import PieceBlock, PlannedPath, ProgrammedPath

WINDOW = 2  # number of moves, before its own and after, with which a piece is compared
_PIECES = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class PathDeviation:
    """Largest deviation of a planned path, and where it is.

    Parameters
    ----------
    at_tool_m
        Largest distance at the tool, with rotary axes at their radius.
    at_vertex
        True if that is the distance of a programmed vertex from the path, False if it is that of
        the path from a chord.
    line, operation
        Line of the job file and operation at that place.
    position
        (axes,) the vertex, or the place of the path, m or rad.
    per_axis
        (axes,) largest difference of each axis, m or rad, between the path and the nearest place of
        the program, or between a vertex and the nearest place of the path.
    """

    at_tool_m: float
    at_vertex: bool
    line: int
    operation: int
    position: FloatArray
    per_axis: FloatArray


def path_deviation(programmed: ProgrammedPath, planned: PlannedPath) -> PathDeviation:
    """Return the largest deviation between the two paths.

    It is the larger one of two distances: from the planned path to the nearest programmed chord,
    and from a programmed vertex to the nearest place of the planned path. Each piece is compared
    with a few moves before and after its own alone, because paths cross and retrace themselves.

    Planners report this number. The judge measures the deviation independently
    (``threadline.verdict.deviation``).
    """
    return _Comparison(programmed, planned).run()


@dataclass(slots=True)
class _Window:
    """Vertices near the current piece; ``best`` is the squared distance of each to the path."""

    positions: FloatArray
    operation: IntArray
    line: IntArray
    best: FloatArray
    offset: FloatArray


class _Comparison:
    def __init__(self, programmed: ProgrammedPath, planned: PlannedPath) -> None:
        self._radius = programmed.radius_m
        self._source = iter(programmed)
        self._planned = planned
        axes = len(programmed.axes)
        self._window = _Window(
            np.zeros((0, axes)),
            np.zeros(0, dtype=np.int64),
            np.zeros(0, dtype=np.int64),
            np.zeros(0),
            np.zeros((0, axes)),
        )
        self._ended = False
        self._worst = -1.0
        self._where: tuple[bool, int, int, FloatArray] = (False, 0, 0, np.zeros(axes))
        self._per_axis = np.zeros(axes)

    def run(self) -> PathDeviation:
        for block in self._planned:
            for part in _parts(block):
                self._take(*part)
        while not self._ended:
            self._read()
        self._settle(len(self._window.best))
        return PathDeviation(
            at_tool_m=float(np.sqrt(max(self._worst, 0.0))),
            at_vertex=self._where[0],
            line=self._where[1],
            operation=self._where[2],
            position=self._where[3],
            per_axis=self._per_axis / self._radius,
        )

    def _read(self) -> None:
        """Append the distinct vertices of the next block."""
        block = next(self._source, None)
        w = self._window
        if block is None:
            self._ended = True
            return
        scaled = block.positions * self._radius
        before = w.positions[-1:] if len(w.positions) else np.full_like(scaled[:1], np.inf)
        moved = np.abs(np.diff(scaled, axis=0, prepend=before)).max(axis=1) > 0
        rows = np.flatnonzero(moved)
        self._window = _Window(
            np.concatenate([w.positions, scaled[rows]]),
            np.concatenate([w.operation, block.operation[rows]]),
            np.concatenate([w.line, block.line[rows]]),
            np.concatenate([w.best, np.full(len(rows), np.inf)]),
            np.concatenate([w.offset, np.zeros((len(rows), scaled.shape[1]))]),
        )

    def _take(self, coefficients: FloatArray, operation: IntArray) -> None:
        """Compare pieces with the vertices around each."""
        last = int(operation[-1])
        while not self._ended and int((self._window.operation > last).sum()) <= 2 * WINDOW:
            self._read()
        w = self._window
        # The vertex that the operation of each piece leads to; the start shares operation 0.
        vertex = np.searchsorted(w.operation, operation, side="right") - 1
        first = max(int(vertex[0]) - 4 * WINDOW, 0)
        self._settle(first)
        w = self._window
        strayed, at, u, difference = compare(
            coefficients * self._radius, vertex - first, w.positions, WINDOW, w.best, w.offset
        )
        self._per_axis = np.maximum(self._per_axis, difference)
        if strayed > self._worst:
            powers = u ** np.arange(coefficients.shape[1])
            position = np.asarray(powers @ coefficients[at])
            mine = int(vertex[at]) - first
            self._worst = strayed
            self._where = (False, int(w.line[mine]), int(operation[at]), position)

    def _settle(self, count: int) -> None:
        """Record the distances of the first ``count`` vertices, which no later piece can change."""
        w = self._window
        reached = w.best[:count]
        seen = np.flatnonzero(np.isfinite(reached))
        if len(seen):
            self._per_axis = np.maximum(self._per_axis, np.abs(w.offset[seen]).max(axis=0))
            at = int(seen[np.argmax(reached[seen])])
            if reached[at] > self._worst:
                self._worst = float(reached[at])
                position = np.asarray(w.positions[at] / self._radius)
                self._where = (True, int(w.line[at]), int(w.operation[at]), position)
        self._window = _Window(
            w.positions[count:],
            w.operation[count:],
            w.line[count:],
            w.best[count:],
            w.offset[count:],
        )


def _parts(block: PieceBlock) -> Iterator[tuple[FloatArray, IntArray]]:
    for first in range(0, len(block), _PIECES):
        rows = slice(first, first + _PIECES)
        yield block.coefficients[rows], block.operation[rows]
