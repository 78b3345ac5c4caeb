"""Runs: the distinct vertices of a programmed path from rest to rest, read in chunks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.motion.path.types import ProgrammedPath, VertexBlock

COINCIDENT_M = 1e-10
"""A vertex nearer than this at the tool to its predecessor is left out: the size of atoms."""
ROUNDING = 1e-14
"""Or nearer than this share of its coordinates: such a short distance has hardly a valid digit."""
_LEAST = 2  # vertices of a run
AT_A_TIME = 8192  # vertices; their control points and pieces stay in a cache
_NOTHING = np.zeros(AT_A_TIME)


@dataclass(frozen=True, slots=True, kw_only=True)
class Vertices:
    """Vertices without repetitions; row i of a column belongs to vertex i or the move into it.

    ``positions`` are (n, axes) in m or rad; ``nominal_s``, ``operation`` and ``line`` are (n,), as
    in ``VertexBlock``; ``beside_m`` is the largest distance of left-out vertices from the move,
    ``more_m`` by how much more than others a vertex may be cut. All are read-only, so that their
    readers are compiled for one kind of array.
    """

    positions: FloatArray
    nominal_s: FloatArray
    operation: IntArray
    line: IntArray
    beside_m: FloatArray
    more_m: FloatArray

    def __post_init__(self) -> None:
        self.positions.flags.writeable = False
        self.nominal_s.flags.writeable = False
        self.operation.flags.writeable = False
        self.line.flags.writeable = False
        self.beside_m.flags.writeable = False
        self.more_m.flags.writeable = False

    def __len__(self) -> int:
        return len(self.positions)

    def take(self, rows: slice | IntArray) -> Vertices:
        """Return the vertices at ``rows``."""
        return Vertices(
            positions=self.positions[rows],
            nominal_s=self.nominal_s[rows],
            operation=self.operation[rows],
            line=self.line[rows],
            beside_m=self.beside_m[rows],
            more_m=self.more_m[rows],
        )


def join_vertices(first: Vertices | None, *others: Vertices) -> Vertices:
    """Return the vertices of ``first``, if there are any, followed by the others'."""
    given = [part for part in (first, *others) if part is not None]
    parts = [part for part in given if len(part)]
    if len(parts) < 2:
        return parts[0] if parts else given[-1]
    return Vertices(
        positions=np.concatenate([part.positions for part in parts]),
        nominal_s=np.concatenate([part.nominal_s for part in parts]),
        operation=np.concatenate([part.operation for part in parts]),
        line=np.concatenate([part.line for part in parts]),
        beside_m=np.concatenate([part.beside_m for part in parts]),
        more_m=np.concatenate([part.more_m for part in parts]),
    )


@njit()
def _away(places, before, begins, radius_m, rest, near_m):  # type: ignore[no-untyped-def]
    """Return which of (n, axes) positions are kept; ``before`` is the position before them.

    A position is kept if it is farther than ``near_m`` from the last kept one. A rest, by ``rest``
    (n,), is kept unless it equals that one: the motion rests where the program says. Distances
    below the rounding of a position count as 0. If the path ``begins`` here, the first is kept.

    Returns
    -------
    every, rests
        Whether all are kept, and whether the motion rests at any of them.
    away
        (n,) which are kept; without rows if all are.
    """
    rests = 0
    for k in range(len(rest)):
        rests += rest[k] > 0
    if _all_away(places, before, begins, radius_m, near_m):
        return True, rests > 0, np.zeros(0, dtype=np.bool_)
    away = np.zeros(len(places), dtype=np.bool_)
    kept, last = 0, -1
    if begins:
        away[0] = True
        kept, last = 1, 0
    for k in range(last + 1, len(places)):
        least_m = COINCIDENT_M if rest[k] > 0 else near_m
        for axis in range(places.shape[1]):  # a difference of rows would allocate an array
            here_m = places[k, axis] * radius_m[axis]
            there_m = (places[last, axis] if last >= 0 else before[axis]) * radius_m[axis]
            if abs(here_m - there_m) > max(least_m, ROUNDING * abs(here_m)):
                away[k] = True
                kept += 1
                last = k
                break
    return kept == len(away), rests > 0, away


@njit()
def _all_away(places, before, begins, radius_m, near_m):  # type: ignore[no-untyped-def]
    """Return whether each position is kept by its distance from its predecessor; usually it is.

    This does not track the last kept position, and takes half the time.
    """
    near_m = max(near_m, COINCIDENT_M)
    for k in range(1 if begins else 0, len(places)):
        away = False
        for axis in range(places.shape[1]):
            here_m = places[k, axis] * radius_m[axis]
            there_m = (places[k - 1, axis] if k > 0 else before[axis]) * radius_m[axis]
            if abs(here_m - there_m) > max(near_m, ROUNDING * abs(here_m)):
                away = True
                break
        if not away:
            return False
    return True


@dataclass(frozen=True, slots=True, kw_only=True)
class Chunk:
    """The next vertices of a run, in parts; there may be none.

    ``ends`` is True if the run ends with them, with a pause of ``dwell_s`` at the last vertex.
    """

    parts: tuple[Vertices, ...]
    ends: bool
    dwell_s: float

    @property
    def vertices(self) -> Vertices:
        """All of them; use the parts directly to avoid a copy."""
        return join_vertices(*self.parts)


def runs(programmed: ProgrammedPath, near_m: float = COINCIDENT_M) -> Iterator[Chunk]:
    """Yield every run in chunks; the last vertex of a run is where the next run begins.

    Moves of zero length are left out; a rest or a pause after such a move belongs to its vertex.
    The start is a run of one vertex.

    Parameters
    ----------
    near_m
        Vertices within this distance of the last kept one are left out, except rests. At a rest the
        last kept vertex gives way, so that no curve ends in such a short chord; its move is then
        the last one of the run, and ends at the rest.
        Distances are the largest difference of an axis, at the tool.
    """
    radius = programmed.radius_m
    last: Vertices | None = None
    held: Vertices | None = None  # last vertices of the current run that are in no chunk yet
    begun = 0  # yielded vertices of the run, including its first
    for own, rest, dwell_s in _bites(programmed):
        before = own.positions[:1] if last is None else last.positions
        every, rests, new = _away(own.positions, before[0], last is None, radius, rest, near_m)
        distinct = own if every else own.take(np.flatnonzero(new))
        first = 0
        if rests:
            # Index of the distinct vertex of each row; -1 is the last one of the earlier rows.
            at = np.arange(len(own)) if every else np.cumsum(new) - 1
            stops = np.flatnonzero(rest)
            for vertex in np.unique(at[stops]):
                pause_s = float(dwell_s[stops[at[stops] == vertex]].sum())
                part = join_vertices(held, distinct.take(slice(first, vertex + 1)))
                if begun + len(part) > _LEAST:
                    part = _without_near_end(part, radius, near_m)
                yield Chunk(parts=(part,), ends=True, dwell_s=pause_s)
                first, held, begun = int(vertex) + 1, None, 1
        if len(distinct):
            last = distinct.take(slice(-1, None))
        if len(distinct) > first:
            parts = () if held is None else (held,)
            if len(distinct) > first + 1:
                parts = (*parts, distinct.take(slice(first, -1)))
            if parts:
                begun += sum(map(len, parts))
                yield Chunk(parts=parts, ends=False, dwell_s=0.0)
            held = last
    if held is not None:
        yield Chunk(parts=(held,), ends=False, dwell_s=0.0)


def _without_near_end(part: Vertices, radius_m: FloatArray, near_m: float) -> Vertices:
    """Return the last vertices of a run; if the last but one is near the end, without it."""
    if len(part) < _LEAST:
        return part
    way_m = np.abs((part.positions[-1] - part.positions[-2]) * radius_m).max()
    if not way_m <= near_m:
        return part
    positions = part.positions[:-1].copy()
    positions[-1] = part.positions[-1]
    return replace(part.take(slice(None, -1)), positions=positions)


def _bites(programmed: ProgrammedPath) -> Iterator[tuple[Vertices, IntArray, FloatArray]]:
    """Yield vertices, rests and dwells of a path, few at a time: they stay in a cache."""
    for block in programmed:
        for first in range(0, len(block), AT_A_TIME):
            rows = slice(first, first + AT_A_TIME)
            own = Vertices(
                positions=block.positions[rows],
                nominal_s=block.nominal_s[rows],
                operation=block.operation[rows],
                line=block.line[rows],
                beside_m=_NOTHING[: len(block.line[rows])],
                more_m=_NOTHING[: len(block.line[rows])],
            )
            yield own, block.rest[rows], block.dwell_s[rows]


_BACK = -0.85  # cosine of a corner (148 degrees) at which the motion rests: the speed kinks there

ALONG_ITSELF = float(np.cos(np.radians(179.0)))
"""Cosine of a corner from which on a path goes back along itself, as from the bottom of a hole."""


def reversals(places: FloatArray, back: float = _BACK) -> IntArray:
    """Return (n,) 1 for each of (n, axes) positions at which the path turns back, else 0.

    ``back`` is the cosine of the corner from which on the path turns back.
    """
    way = np.diff(places, axis=0)
    size = np.linalg.norm(way, axis=1)
    out = np.zeros(len(places), dtype=np.int64)
    moved = np.flatnonzero(size > 0.0)
    tangent = way[moved] / size[moved, None]
    turned = (tangent[1:] * tangent[:-1]).sum(axis=1) < back
    out[moved[1:][turned]] = 1
    return out


def resting_at_reversals(programmed: ProgrammedPath, back: float = _BACK) -> Iterator[VertexBlock]:
    """Yield the vertices of ``programmed``, with a rest wherever the path turns back.

    ``back`` is as in ``reversals``.
    """
    radius_m = programmed.radius_m
    held: VertexBlock | None = None
    before = np.zeros((0, len(radius_m)))  # the vertex before the buffered ones
    for block in programmed:
        if held is not None and (block.positions == held.positions[-1]).all():
            held = _joined(held, block)  # nothing moves: the next vertices decide
            continue
        if held is not None:
            yield _rested(held, before, block.positions, radius_m, back)
            before = _came_from(np.concatenate([before, held.positions]))
        held = block
    if held is not None:
        yield _rested(held, before, held.positions[-1:], radius_m, back)


def resting_before_first_moves(
    programmed: ProgrammedPath, axes: tuple[int, ...]
) -> Iterator[VertexBlock]:
    """Yield the vertices of ``programmed``, with a rest before the first move of each of ``axes``.

    Until then the axis is where the operator has left it, and not at the zero of the program: a
    rounded corner would move it from there while the others still go to their place.
    """
    still = set(axes)
    held: VertexBlock | None = None
    start = np.zeros(0)
    for block in programmed:
        if held is None:
            start = block.positions[0]
        else:
            yield _before_first_moves(held, block.positions[:1], start, still)
        held = block
    if held is not None:
        yield _before_first_moves(held, held.positions[-1:], start, still)


def _before_first_moves(
    block: VertexBlock, after: FloatArray, start: FloatArray, still: set[int]
) -> VertexBlock:
    """Return a block with its rests, and take the axes that move out of ``still``."""
    moved = np.concatenate([block.positions, after]) != start
    rest = block.rest
    for axis in sorted(still):
        rows = np.flatnonzero(moved[:, axis])
        if len(rows):
            still.discard(axis)
            if rows[0] > 0 and moved[rows[0] - 1].any():
                rest = np.where(np.arange(len(rest)) == rows[0] - 1, 1, rest)
    return block if rest is block.rest else replace(block, rest=rest)


def _rested(
    block: VertexBlock, before: FloatArray, after: FloatArray, radius_m: FloatArray, back: float
) -> VertexBlock:
    places = np.concatenate([before, block.positions, after]) * radius_m
    turned = reversals(places, back)[len(before) : len(before) + len(block)]
    return replace(block, rest=np.maximum(block.rest, turned))


def _came_from(places: FloatArray) -> FloatArray:
    """Return the last two of (n, axes) positions that differ, or all if there are fewer."""
    moved = np.flatnonzero((places != places[-1]).any(axis=1))
    return places[-1:] if not len(moved) else places[[moved[-1], -1]]


def _joined(first: VertexBlock, then: VertexBlock) -> VertexBlock:
    return VertexBlock(
        positions=np.concatenate([first.positions, then.positions]),
        operation=np.concatenate([first.operation, then.operation]),
        nominal_s=np.concatenate([first.nominal_s, then.nominal_s]),
        rest=np.concatenate([first.rest, then.rest]),
        dwell_s=np.concatenate([first.dwell_s, then.dwell_s]),
        line=np.concatenate([first.line, then.line]),
    )
