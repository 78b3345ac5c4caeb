"""The part of the programmed path around the current operations; the judge holds no other part.

The pieces of a trajectory name their operation, but a piece may span many operations, and smoothing
in time shifts the operation by up to its width. Only the order is certain: after a point, the next
point is passed at the first instant at which the distance to it is a minimum.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.motion.path.types import ProgrammedPath
from threadline.motion.timing.types import TrajectoryBlock
from threadline.verdict.straight_runs import Runs, straight_runs


@dataclass(frozen=True, slots=True)
class Remainder:
    """The part of the path that a recording never reached.

    ``distance_m``, (runs,), is the distance of its farthest vertex from the machine. ``operation``
    and ``line``, (runs,), and ``position``, (runs, axes), belong to that vertex. ``end``, (axes,),
    is the end of the path, lengths at the tool.
    """

    distance_m: FloatArray
    operation: IntArray
    line: IntArray
    position: FloatArray
    end: FloatArray


def _farther(known: Remainder, fresh: Remainder) -> Remainder:
    """Return the farther vertex of every run, and the end of the later part."""
    larger = fresh.distance_m > known.distance_m
    return Remainder(
        np.where(larger, fresh.distance_m, known.distance_m),
        np.where(larger, fresh.operation, known.operation),
        np.where(larger, fresh.line, known.line),
        np.where(larger[:, None], fresh.position, known.position),
        fresh.end,
    )


class PathWindow:
    """A stretch of consecutive programmed vertices that moves along the path.

    Moves along one straight line are one chord, see ``straight_runs``.

    Attributes
    ----------
    vertices
        (m, axes) lengths at the tool: rotary axes times their radius.
    begun, operation, line
        (m,) first and last operation of the chord into each vertex, and the job line of the last
        operation.
    speed_m_s
        (m,) programmed speed of the chord into each vertex, at the tool; NaN without one.
    radius_m, local
        As in the path.
    first
        Number of the first vertex since the start of the path.
    exhausted
        Whether the last vertex of the path is among them.
    """

    def __init__(self, path: ProgrammedPath) -> None:
        self._source: Iterator[Runs] = straight_runs(path, path.radius_m)
        self.radius_m = path.radius_m
        self.local = path.local
        self.vertices: FloatArray = np.empty((0, len(path.axes)))
        self.begun: IntArray = np.empty(0, dtype=np.int64)
        self.operation: IntArray = np.empty(0, dtype=np.int64)
        self.line: IntArray = np.empty(0, dtype=np.int64)
        self.speed_m_s: FloatArray = np.empty(0)
        # For each move: its chord, counted from the start, the distance of its end, and so on.
        self._part_of: IntArray = np.empty(0, dtype=np.int64)
        self._part_m: FloatArray = np.empty(0)
        self._part_operation: IntArray = np.empty(0, dtype=np.int64)
        self._part_line: IntArray = np.empty(0, dtype=np.int64)
        self.first = 0
        self.exhausted = False
        self._remainder: Remainder | None = None

    def __len__(self) -> int:
        return len(self.operation)

    @property
    def shares(self) -> FloatArray | None:
        """(m, axes) ratio of lengths at each vertex to lengths at the largest radii; None: 1."""
        return None if self.local is None else self.local.shares(self.vertices / self.radius_m)

    def reach(self, latest: int) -> None:
        """Read on until every chord of the operation ``latest``, and one more, is held."""
        while not self.exhausted and (not len(self) or self.operation[-1] <= latest):
            self._extend()

    def drop(self, chord: int) -> None:
        """Discard the vertices before ``chord``, counted from the start of the path."""
        surplus = min(chord - 1 - self.first, len(self) - 2)
        if surplus > 0:
            self.vertices = self.vertices[surplus:]
            self.begun = self.begun[surplus:]
            self.operation = self.operation[surplus:]
            self.line = self.line[surplus:]
            self.speed_m_s = self.speed_m_s[surplus:]
            self.first += surplus
            part = int(np.searchsorted(self._part_of, self.first))
            self._part_of, self._part_m = self._part_of[part:], self._part_m[part:]
            self._part_operation = self._part_operation[part:]
            self._part_line = self._part_line[part:]

    def lines_at(self, chord: IntArray, points: FloatArray) -> IntArray:
        """Return (n,) job lines of the moves nearest to points, each on its chord.

        Parameters
        ----------
        chord
            (n,) counted within the window.
        points
            (n, axes) lengths at the tool.
        """
        found = np.asarray(self.line[chord])
        begin = np.searchsorted(self._part_of, chord + self.first)
        end = np.searchsorted(self._part_of, chord + self.first, side="right")
        for row in np.flatnonzero(end - begin > 1):
            start = self.vertices[chord[row] - 1]
            vector = self.vertices[chord[row]] - start
            along_m = (points[row] - start) @ vector / np.linalg.norm(vector)
            inner = slice(begin[row], end[row] - 1)  # points farther on belong to the last move
            part = begin[row] + np.searchsorted(self._part_m[inner], along_m)
            found[row] = self._part_line[part]
        return found

    def begins(self, operation: IntArray, chord: IntArray) -> FloatArray:
        """Return (n,) share of a chord at which an operation's first move on it begins.

        ``chord`` is counted within the window.
        """
        part = np.searchsorted(self._part_operation, operation)
        part = np.minimum(part, len(self._part_of) - 1)
        before = self._part_of[np.maximum(part - 1, 0)] == chord + self.first
        within = (part > 0) & before & (self._part_of[part] == chord + self.first)
        last = np.searchsorted(self._part_of, chord + self.first, side="right") - 1
        share = self._part_m[np.maximum(part - 1, 0)] / np.maximum(self._part_m[last], 1e-300)
        return np.where(within, share, 0.0)

    def is_on_its_way(self, operation: int) -> bool:
        """Return whether later moves follow an operation's last one on the same chord."""
        after = int(np.searchsorted(self._part_operation, operation, side="right"))
        if not 0 < after < len(self._part_of):
            return False
        return bool(self._part_of[after] == self._part_of[after - 1])

    def chords(self, operation: IntArray) -> tuple[IntArray, IntArray]:
        """Return (n,) first and last chord of each operation; chord c ends at vertex c.

        An operation without motion (a dwell, an output) has the chord that led to its position.
        """
        left = np.searchsorted(self.operation, operation, side="left")
        last = np.searchsorted(self.begun, operation, side="right") - 1
        most = max(len(self) - 1, 1)
        # An operation without a vertex has its predecessor's chord, where the machine rests.
        first = np.minimum(np.maximum(np.minimum(left, last), 1), most)
        return first, np.minimum(np.maximum(last, 1), most)

    def remainder(self, point: FloatArray) -> Remainder | None:
        """Return the path after the window. The first call reads the path to its end.

        Parameters
        ----------
        point
            (axes, runs) position of the machine, lengths at the tool; NaN for an axis that was not
            recorded, which is then ignored.
        """
        if self.exhausted:
            return self._remainder
        worst: Remainder | None = None
        for block in self._source:
            away = np.nansum((block.vertices[:, :, None] - point) ** 2, axis=1)
            far, runs = np.argmax(away, axis=0), np.arange(point.shape[1])
            found = Remainder(
                np.sqrt(away[far, runs]),
                block.operation[far],
                block.line[far],
                block.vertices[far] / self.radius_m,
                block.vertices[-1],
            )
            worst = found if worst is None else _farther(worst, found)
        self.exhausted = True
        self._remainder = worst
        return worst

    def _extend(self) -> None:
        block = next(self._source, None)
        if block is None:
            self.exhausted = True
            if self.first + len(self) == 1:  # a job without motion: a chord from start to start
                self.vertices = np.repeat(self.vertices, 2, axis=0)
                self.begun = np.repeat(self.begun, 2)
                self.operation = np.repeat(self.operation, 2)
                self.line = np.repeat(self.line, 2)
                self.speed_m_s = np.repeat(self.speed_m_s, 2)
            return
        number = self.first + len(self)
        self._part_of = np.concatenate([self._part_of, number + block.part_of])
        self._part_m = np.concatenate([self._part_m, block.part_m])
        self._part_operation = np.concatenate([self._part_operation, block.part_operation])
        self._part_line = np.concatenate([self._part_line, block.part_line])
        self.vertices = np.concatenate([self.vertices, block.vertices])
        self.begun = np.concatenate([self.begun, block.begun])
        self.operation = np.concatenate([self.operation, block.operation])
        self.line = np.concatenate([self.line, block.line])
        self.speed_m_s = np.concatenate([self.speed_m_s, block.speed_m_s])


_NEAR = 0.25  # of the distance from point to point: a minimum this near is the passing
_FAR = 2.0
"""Path on which to look for a nearer minimum, in the sum of two distances: between the points, and
of the trajectory from the first point."""
_STRIDE = 0.125  # of the distance from point to point: the usual step, never exceeded twofold
_HALVINGS = 60  # of an interval about a minimum: to the last digits of a double
_FINEST = 1e-9  # of the duration of a piece: the shortest stride
_ROUNDING = 1e-15  # of the time
_SAME_M = 1e-12  # a piece that ends this near to a minimum ends at it


class _Pieces(NamedTuple):
    """Consecutive pieces of a trajectory, p of them: polynomials in the share of their duration.

    ``coefficients`` is (p, order, axes), lowest power first; ``start_s`` and ``duration_s`` are
    (p,). ``exhausted`` says that the trajectory has no later piece.
    """

    coefficients: FloatArray
    start_s: FloatArray
    duration_s: FloatArray
    exhausted: bool


class TrajectoryFollower:
    """Follows a trajectory from point to point.

    Parameters
    ----------
    blocks
        Blocks of the trajectory; pieces without motion may be left out.
    columns, radius
        (k,) columns of the axes, and lengths at the tool for each: m per m, or m per rad.
    start
        (k,) the point at which it begins, lengths at the tool.
    """

    def __init__(
        self,
        blocks: Iterable[TrajectoryBlock],
        columns: list[int],
        radius: FloatArray,
        start: FloatArray,
    ) -> None:
        self._blocks: Iterator[TrajectoryBlock] = iter(blocks)
        self._columns, self._radius = columns, radius
        none = np.empty(0)
        self._pieces = _Pieces(np.empty((0, 1, len(columns))), none, none, exhausted=False)
        self._point = np.asarray(start, dtype=np.float64)
        self._read()
        start_s = self._pieces.start_s
        self.time_s = float(start_s[0]) if len(start_s) else 0.0

    def times(self, points: FloatArray) -> FloatArray:
        """Return when the first of ``points``, at least one of them, are passed.

        Parameters
        ----------
        points
            (n, k) in order, lengths at the tool. A point equal to its predecessor is passed with
            it; points that the trajectory does not approach any more are passed at its end.
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        out = np.full(len(points), self.time_s)
        while len(self._pieces.start_s):
            done = _pass(points, self._point, self._pieces, self.time_s, out)
            if done:
                break
            self._read()
        else:
            done = len(points)
        self.time_s, self._point = float(out[done - 1]), points[done - 1]
        # The previous piece stays: a minimum at a joint is at its end.
        coefficients, start_s, duration_s, exhausted = self._pieces
        first = int(np.searchsorted(start_s, self.time_s, side="right")) - 2
        kept = slice(max(first, 0), None)
        self._pieces = _Pieces(coefficients[kept], start_s[kept], duration_s[kept], exhausted)
        return out[:done]

    def _read(self) -> None:
        """Append a block to the buffered pieces."""
        block = next(self._blocks, None)
        held = self._pieces
        if block is None:
            self._pieces = held._replace(exhausted=True)
            return
        fresh = block.coefficients[:, :, self._columns] * self._radius
        known = held.coefficients
        order = max(fresh.shape[1], known.shape[1])
        both = (np.pad(c, ((0, 0), (0, order - c.shape[1]), (0, 0))) for c in (known, fresh))
        self._pieces = _Pieces(
            np.concatenate(list(both)),
            np.concatenate([held.start_s, block.start_s]),
            np.concatenate([held.duration_s, block.duration_s]),
            exhausted=False,
        )


@njit()
def _evaluate(pieces, i, t, state):  # type: ignore[no-untyped-def]
    """Fill in ``state``, (2, axes), with position and velocity at the instant ``t`` of piece i."""
    c, start, duration, _ = pieces
    u = min(max((t - start[i]) / duration[i], 0.0), 1.0)
    for a in range(c.shape[2]):
        place, slope = 0.0, 0.0
        for k in range(c.shape[1] - 1, -1, -1):
            slope = slope * u + place
            place = place * u + c[i, k, a]
        state[0, a], state[1, a] = place, slope / duration[i]


@njit()
def _gap(a, b):  # type: ignore[no-untyped-def]
    total = 0.0
    for k in range(len(a)):
        total += (a[k] - b[k]) ** 2
    return np.sqrt(total)


@njit()
def _nears(state, point):  # type: ignore[no-untyped-def]
    """Return half the rate of the squared distance to ``point``: negative while approaching."""
    total = 0.0
    for k in range(len(point)):
        total += (state[0, k] - point[k]) * state[1, k]
    return total


@njit()
def _turn(pieces, piece, low, high, point, state):  # type: ignore[no-untyped-def]
    """Return when ``point`` is nearest, between two instants of a piece; by bisection."""
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        _evaluate(pieces, piece, middle, state)
        if _nears(state, point) < 0.0:
            low = middle
        else:
            high = middle
    _evaluate(pieces, piece, high, state)
    return high


@njit()
def _step(pieces, piece, t, most, state, to):  # type: ignore[no-untyped-def]
    """Return an instant after ``t`` of a piece, a path of about ``most`` later; fill in ``to``."""
    _, start, duration, _ = pieces
    end = start[piece] + duration[piece]
    finest = max(_FINEST * duration[piece], _ROUNDING * t)
    stride = min(0.5 * duration[piece], end - t)
    fast = np.sqrt((state[1] ** 2).sum())
    if fast * stride > most:
        stride = max(most / fast, finest)
    then = end if t + stride >= end else t + stride
    _evaluate(pieces, piece, then, to)
    while _gap(to[0], state[0]) > 2.0 * most and then - t > 2.0 * finest:
        then = t + 0.5 * (then - t)
        _evaluate(pieces, piece, then, to)
    return then


@njit()
def _find(pieces, piece, t, point, reach, state, to):  # type: ignore[no-untyped-def]
    """Return when and in which piece a point is passed, from ``t`` on; piece -1: not known yet.

    ``reach`` is the distance from the point before, and the path on which to look for a nearer
    minimum. ``state`` and ``to``, (2, axes), are work arrays for positions and velocities.
    """
    _, start, duration, exhausted = pieces
    _evaluate(pieces, piece, t, state)
    nears = _nears(state, point)
    travelled, least, found_s, found = 0.0, np.inf, t, piece
    while True:
        end, here = start[piece] + duration[piece], piece
        if t < end:
            then = _step(pieces, piece, t, _STRIDE * reach[0], state, to)
        elif piece + 1 < len(start):
            piece += 1
            then = start[piece]
            _evaluate(pieces, piece, then, to)
        elif not exhausted:
            return t, -1
        elif nears < 0.0 and _gap(state[0], point) < least:
            return end, piece
        else:
            return found_s, found
        after = _nears(to, point)
        travelled += _gap(to[0], state[0])
        if nears < 0.0 <= after:
            turn_s = _turn(pieces, piece, t, then, point, state) if piece == here else end
            if _gap(state[0], point) < least:
                least, found_s, found = _gap(state[0], point), turn_s, here
                if least <= _NEAR * reach[0]:
                    return found_s, found
        t, nears = then, after
        for a in range(state.shape[1]):  # assigning the whole array takes seconds to compile
            state[0, a], state[1, a] = to[0, a], to[1, a]
        if travelled > reach[1] and (nears >= 0.0 or _gap(state[0], point) >= least):
            return found_s, found


@njit()
def _end_of(pieces, begin_s, t, piece, state, to):  # type: ignore[no-untyped-def]
    """Return the instant and piece of a minimum; the end of the piece if that is very near.

    Motion that ends at a minimum approaches it ever more slowly: it is passed at the end. If a rest
    follows, that is the end before the rest.
    """
    _, start, duration, _ = pieces
    _evaluate(pieces, piece, t, state)
    for k in range(max(piece - 1, 0), piece + 1):
        end = start[k] + duration[k]
        _evaluate(pieces, k, end, to)
        if end >= begin_s and _gap(to[0], state[0]) <= _SAME_M:
            return end, k
    return t, piece


@njit()
def _pass(points, origin, pieces, begin_s, out):  # type: ignore[no-untyped-def]
    """Fill in when points are passed; return the number of points that these pieces decide."""
    c, start, duration, _ = pieces
    state, to, reach = np.empty((2, c.shape[2])), np.empty((2, c.shape[2])), np.empty(2)
    now, piece, before = begin_s, 0, origin
    while piece + 1 < len(start) and now >= start[piece] + duration[piece]:
        piece += 1
    for n in range(len(points)):
        point = points[n]
        reach[0] = _gap(point, before)
        if reach[0] > 0.0:
            t = max(now, start[piece])
            _evaluate(pieces, piece, t, state)
            reach[1] = _FAR * (reach[0] + _gap(state[0], before))
            found_s, found = _find(pieces, piece, t, point, reach, state, to)
            if found < 0:
                return n
            now, piece = _end_of(pieces, now, found_s, found, state, to)
        out[n], before = now, point
    return len(points)
