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
    given_parts = [part for part in (first, *others) if part is not None]
    parts = [part for part in given_parts if len(part)]
    if len(parts) < 2:
        return parts[0] if parts else given_parts[-1]
    return Vertices(
        positions=np.concatenate([part.positions for part in parts]),
        nominal_s=np.concatenate([part.nominal_s for part in parts]),
        operation=np.concatenate([part.operation for part in parts]),
        line=np.concatenate([part.line for part in parts]),
        beside_m=np.concatenate([part.beside_m for part in parts]),
        more_m=np.concatenate([part.more_m for part in parts]),
    )


@njit()
def _away(places, previous, begins, radius_m, rest, near_m):  # type: ignore[no-untyped-def]
    """Return which of (n, axes) positions are kept; ``previous`` is the position before them.

    A position is kept if it is farther than ``near_m`` from the last kept one. A rest, by ``rest``
    (n,), is kept unless it equals that one: the motion rests where the program says. Distances
    below the rounding of a position count as 0. If the path ``begins`` here, the first is kept.

    Returns
    -------
    every, rests
        Whether all are kept, and whether the motion rests at any of them.
    is_kept
        (n,) which are kept; without rows if all are.
    """
    rests = 0
    for k in range(len(rest)):
        rests += rest[k] > 0
    if _all_away(places, previous, begins, radius_m, near_m):
        return True, rests > 0, np.zeros(0, dtype=np.bool_)
    is_kept = np.zeros(len(places), dtype=np.bool_)
    kept_count, last = 0, -1
    if begins:
        is_kept[0] = True
        kept_count, last = 1, 0
    for k in range(last + 1, len(places)):
        least_m = COINCIDENT_M if rest[k] > 0 else near_m
        for axis in range(places.shape[1]):  # a difference of rows would allocate an array
            own_m = places[k, axis] * radius_m[axis]
            kept_m = (places[last, axis] if last >= 0 else previous[axis]) * radius_m[axis]
            if abs(own_m - kept_m) > max(least_m, ROUNDING * abs(own_m)):
                is_kept[k] = True
                kept_count += 1
                last = k
                break
    return kept_count == len(is_kept), rests > 0, is_kept


@njit()
def _all_away(places, previous, begins, radius_m, near_m):  # type: ignore[no-untyped-def]
    """Return whether each position is kept by its distance from its predecessor; usually it is.

    This does not track the last kept position, and takes half the time.
    """
    near_m = max(near_m, COINCIDENT_M)
    for k in range(1 if begins else 0, len(places)):
        away = False
        for axis in range(places.shape[1]):
            own_m = places[k, axis] * radius_m[axis]
            previous_m = (places[k - 1, axis] if k > 0 else previous[axis]) * radius_m[axis]
            if abs(own_m - previous_m) > max(near_m, ROUNDING * abs(own_m)):
                away = True
                break
        if not away:
            return False
    return True


@dataclass(frozen=True, slots=True, kw_only=True)
class Chunk:
    """The next vertices of a run, in parts; there may be none.

    ``is_last`` is True if the run ends with them, with a pause of ``dwell_s`` at the last vertex.
    """

    parts: tuple[Vertices, ...]
    is_last: bool
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
    held_back: Vertices | None = None  # last vertices of the current run that are in no chunk yet
    yielded_count = 0  # yielded vertices of the run, including its first
    for bite, rest, dwell_s in _bites(programmed):
        earlier = bite.positions[:1] if last is None else last.positions
        all_kept, rests, is_kept = _away(
            bite.positions, earlier[0], last is None, radius, rest, near_m
        )
        distinct = bite if all_kept else bite.take(np.flatnonzero(is_kept))
        first_left = 0
        if rests:
            # Index of the distinct vertex of each row; -1 is the last one of the earlier rows.
            distinct_index = np.arange(len(bite)) if all_kept else np.cumsum(is_kept) - 1
            stops = np.flatnonzero(rest)
            for vertex in np.unique(distinct_index[stops]):
                pause_s = float(dwell_s[stops[distinct_index[stops] == vertex]].sum())
                part = join_vertices(held_back, distinct.take(slice(first_left, vertex + 1)))
                if yielded_count + len(part) > _LEAST:
                    part = _without_near_end(part, radius, near_m)
                yield Chunk(parts=(part,), is_last=True, dwell_s=pause_s)
                first_left, held_back, yielded_count = int(vertex) + 1, None, 1
        if len(distinct):
            last = distinct.take(slice(-1, None))
        if len(distinct) > first_left:
            parts = () if held_back is None else (held_back,)
            if len(distinct) > first_left + 1:
                parts = (*parts, distinct.take(slice(first_left, -1)))
            if parts:
                yielded_count += sum(map(len, parts))
                yield Chunk(parts=parts, is_last=False, dwell_s=0.0)
            held_back = last
    if held_back is not None:
        yield Chunk(parts=(held_back,), is_last=False, dwell_s=0.0)


def _without_near_end(part: Vertices, radius_m: FloatArray, near_m: float) -> Vertices:
    """Return the last vertices of a run; if the last but one is near the end, without it."""
    if len(part) < _LEAST:
        return part
    last_leg_m = np.abs((part.positions[-1] - part.positions[-2]) * radius_m).max()
    if not last_leg_m <= near_m:
        return part
    positions = part.positions[:-1].copy()
    positions[-1] = part.positions[-1]
    return replace(part.take(slice(None, -1)), positions=positions)


def _bites(programmed: ProgrammedPath) -> Iterator[tuple[Vertices, IntArray, FloatArray]]:
    """Yield vertices, rests and dwells of a path, few at a time: they stay in a cache."""
    for block in programmed:
        for first in range(0, len(block), AT_A_TIME):
            rows = slice(first, first + AT_A_TIME)
            bite = Vertices(
                positions=block.positions[rows],
                nominal_s=block.nominal_s[rows],
                operation=block.operation[rows],
                line=block.line[rows],
                beside_m=_NOTHING[: len(block.line[rows])],
                more_m=_NOTHING[: len(block.line[rows])],
            )
            yield bite, block.rest[rows], block.dwell_s[rows]


_BACK = -0.85  # cosine of a corner (148 degrees) at which the motion rests: the speed kinks there

ALONG_ITSELF = float(np.cos(np.radians(179.0)))
"""Cosine of a corner from which on a path goes back along itself, as from the bottom of a hole."""


def reversals(places: FloatArray, back: float = _BACK) -> IntArray:
    """Return (n,) 1 for each of (n, axes) positions at which the path turns back, else 0.

    ``back`` is the cosine of the corner from which on the path turns back.
    """
    legs = np.diff(places, axis=0)
    lengths = np.linalg.norm(legs, axis=1)
    is_reversal = np.zeros(len(places), dtype=np.int64)
    moving_legs = np.flatnonzero(lengths > 0.0)
    tangent = legs[moving_legs] / lengths[moving_legs, None]
    turns_back = (tangent[1:] * tangent[:-1]).sum(axis=1) < back
    is_reversal[moving_legs[1:][turns_back]] = 1
    return is_reversal


def resting_at_reversals(programmed: ProgrammedPath, back: float = _BACK) -> Iterator[VertexBlock]:
    """Yield the vertices of ``programmed``, with a rest wherever the path turns back.

    ``back`` is as in ``reversals``.
    """
    radius_m = programmed.radius_m
    held_back: VertexBlock | None = None
    vertices_before = np.zeros((0, len(radius_m)))  # the vertex before the buffered ones
    for block in programmed:
        if held_back is not None and (block.positions == held_back.positions[-1]).all():
            held_back = _joined(held_back, block)  # nothing moves: the next vertices decide
            continue
        if held_back is not None:
            yield _rested(held_back, vertices_before, block.positions, radius_m, back)
            vertices_before = _came_from(np.concatenate([vertices_before, held_back.positions]))
        held_back = block
    if held_back is not None:
        yield _rested(held_back, vertices_before, held_back.positions[-1:], radius_m, back)


def resting_before_first_moves(
    programmed: ProgrammedPath, axes: tuple[int, ...]
) -> Iterator[VertexBlock]:
    """Yield the vertices of ``programmed``, with a rest before the first move of each of ``axes``.

    Until then the axis is where the operator has left it, and not at the zero of the program: a
    rounded corner would move it from there while the others still go to their place.
    """
    unmoved_axes = set(axes)
    held_back: VertexBlock | None = None
    start = np.zeros(0)
    for block in programmed:
        if held_back is None:
            start = block.positions[0]
        else:
            yield _before_first_moves(held_back, block.positions[:1], start, unmoved_axes)
        held_back = block
    if held_back is not None:
        yield _before_first_moves(held_back, held_back.positions[-1:], start, unmoved_axes)


def _before_first_moves(
    block: VertexBlock, next_position: FloatArray, start: FloatArray, unmoved_axes: set[int]
) -> VertexBlock:
    """Return a block with its rests, and take the axes that move out of ``unmoved_axes``."""
    has_moved = np.concatenate([block.positions, next_position]) != start
    rest = block.rest
    for axis in sorted(unmoved_axes):
        rows = np.flatnonzero(has_moved[:, axis])
        if len(rows):
            unmoved_axes.discard(axis)
            if rows[0] > 0 and has_moved[rows[0] - 1].any():
                rest = np.where(np.arange(len(rest)) == rows[0] - 1, 1, rest)
    return block if rest is block.rest else replace(block, rest=rest)


def _rested(
    block: VertexBlock,
    vertices_before: FloatArray,
    vertices_after: FloatArray,
    radius_m: FloatArray,
    back: float,
) -> VertexBlock:
    places = np.concatenate([vertices_before, block.positions, vertices_after]) * radius_m
    is_reversal = reversals(places, back)[len(vertices_before) : len(vertices_before) + len(block)]
    return replace(block, rest=np.maximum(block.rest, is_reversal))


def _came_from(places: FloatArray) -> FloatArray:
    """Return the last two of (n, axes) positions that differ, or all if there are fewer."""
    other_rows = np.flatnonzero((places != places[-1]).any(axis=1))
    return places[-1:] if not len(other_rows) else places[[other_rows[-1], -1]]


def _joined(first: VertexBlock, second: VertexBlock) -> VertexBlock:
    return VertexBlock(
        positions=np.concatenate([first.positions, second.positions]),
        operation=np.concatenate([first.operation, second.operation]),
        nominal_s=np.concatenate([first.nominal_s, second.nominal_s]),
        rest=np.concatenate([first.rest, second.rest]),
        dwell_s=np.concatenate([first.dwell_s, second.dwell_s]),
        line=np.concatenate([first.line, second.line]),
    )
