"""Programmed path -> runs of distinct vertices between two rests, in chunks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numba import njit

from threadline.arrays import FloatArray, IntArray
from threadline.path.types import ProgrammedPath

COINCIDENT_M = 1e-12  # vertices nearer than this at the tool are one


@dataclass(frozen=True, slots=True, kw_only=True)
class Vertices:
    """Vertices without repetitions; row i of a column is of the move into vertex i."""

    positions: FloatArray
    nominal_s: FloatArray
    operation: IntArray
    line: IntArray

    def __len__(self) -> int:
        return len(self.positions)

    def take(self, rows: slice | IntArray) -> Vertices:
        """Return the vertices at ``rows``."""
        return Vertices(
            positions=self.positions[rows],
            nominal_s=self.nominal_s[rows],
            operation=self.operation[rows],
            line=self.line[rows],
        )


def join_vertices(first: Vertices | None, second: Vertices) -> Vertices:
    """Return both in a row."""
    if first is None or not len(first):
        return second
    return Vertices(
        positions=np.concatenate([first.positions, second.positions]),
        nominal_s=np.concatenate([first.nominal_s, second.nominal_s]),
        operation=np.concatenate([first.operation, second.operation]),
        line=np.concatenate([first.line, second.line]),
    )


@njit(cache=True)
def _away(places, near_m):  # type: ignore[no-untyped-def]
    """Return which of (n + 1, axes) places but the first are away from the last that counted."""
    away = np.zeros(len(places) - 1, dtype=np.bool_)
    last = 0
    for k in range(1, len(places)):
        if np.abs(places[k] - places[last]).max() > near_m:
            away[k - 1] = True
            last = k
    return away


@dataclass(frozen=True, slots=True, kw_only=True)
class Chunk:
    """More vertices of the run under way (none is possible).

    ``ends`` tells that the run ends at the last vertex so far, with a pause of ``dwell_s``.
    """

    vertices: Vertices
    ends: bool
    dwell_s: float


def runs(programmed: ProgrammedPath, near_m: float = COINCIDENT_M) -> Iterator[Chunk]:
    """Yield every run in chunks: a run begins where the one before it ended.

    Moves of no length are left out; the rest and the pause that follow them count for the
    vertex at which they happen. The start is a run of one vertex.

    Parameters
    ----------
    near_m
        A vertex no farther at the tool from the one before it that counts is the same vertex.
    """
    radius = programmed.radius_m
    last: Vertices | None = None
    for block in programmed:
        own = Vertices(
            positions=block.positions,
            nominal_s=block.nominal_s,
            operation=block.operation,
            line=block.line,
        )
        before = block.positions[:1] if last is None else last.positions
        new = _away(np.concatenate([before, block.positions]) * radius, near_m)
        if last is None:
            new[0] = True
        # Which distinct vertex each row stands at; -1 is the last one of the block before.
        at = np.cumsum(new) - 1
        distinct = own.take(np.flatnonzero(new))
        stops = np.flatnonzero(block.rest)
        first = 0
        for vertex in np.unique(at[stops]):
            dwell = float(block.dwell_s[stops[at[stops] == vertex]].sum())
            part = distinct.take(slice(first, vertex + 1))
            yield Chunk(vertices=part, ends=True, dwell_s=dwell)
            first = int(vertex) + 1
        part = distinct.take(slice(first, None))
        if len(part):
            yield Chunk(vertices=part, ends=False, dwell_s=0.0)
        if len(distinct):
            last = distinct.take(slice(-1, None))
