"""Distances between polynomial pieces and a polyline, both in order (compiled)."""
# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.motion.path.types import PieceBlock, PlannedPath, ProgrammedPath

SAMPLES = 8  # per curved piece, before refining
NEAREST = 40  # most steps to the nearest place of a piece; Newton's method needs a few
CLOSE = 1e-12  # least step, as a share of a piece
REFINE = 24  # golden-section steps: 1e-5 of a sample interval
_GOLDEN = 0.6180339887498949


@njit()
def _at(c, u, out):
    for j in range(c.shape[1]):
        value = 0.0
        for k in range(c.shape[0] - 1, -1, -1):
            value = value * u + c[k, j]
        out[j] = value


@njit()
def _to_chords(point, vertices, first, last, difference):
    """Return the squared distance to the chords between vertices ``first`` and ``last``."""
    least2 = np.inf
    axes = len(point)
    for v in range(first, max(last, first + 1)):
        w = min(v + 1, len(vertices) - 1)
        projection = 0.0
        chord2 = 0.0
        for j in range(axes):
            d = vertices[w, j] - vertices[v, j]
            projection += d * (point[j] - vertices[v, j])
            chord2 += d * d
        t = min(max(projection / chord2, 0.0), 1.0) if chord2 > 0.0 else 0.0
        distance2 = 0.0
        for j in range(axes):
            e = point[j] - vertices[v, j] - t * (vertices[w, j] - vertices[v, j])
            distance2 += e * e
        if distance2 < least2:
            least2 = distance2
            for j in range(axes):
                difference[j] = point[j] - vertices[v, j] - t * (vertices[w, j] - vertices[v, j])
    return least2


@njit()
def _gap(c, u, target):
    distance2 = 0.0
    for j in range(c.shape[1]):
        value = 0.0
        for k in range(c.shape[0] - 1, -1, -1):
            value = value * u + c[k, j]
        distance2 += (value - target[j]) ** 2
    return distance2


@njit()
def _bracketed(c, target, low, high, u):
    """Return u and the squared distance of the nearest point between ``low`` and ``high``.

    It takes Newton steps on the slope of the squared distance from ``u`` on, and halves the
    bracket if such a step would leave it. The bracket shrinks towards smaller distances, so that a
    slope of 0 elsewhere (where a piece begins at rest) does not end the search.
    """
    least2, u_least = np.inf, u
    for _ in range(NEAREST):
        distance2, slope, curvature = 0.0, 0.0, 0.0
        for j in range(c.shape[1]):
            value, first, second = 0.0, 0.0, 0.0
            for k in range(c.shape[0] - 1, -1, -1):
                second = second * u + first
                first = first * u + value
                value = value * u + c[k, j]
            offset = value - target[j]
            distance2 += offset * offset
            slope += offset * first
            curvature += first * first + 2.0 * offset * second
        if distance2 < least2:
            least2, u_least = distance2, u
        if slope > 0.0 or u >= high:
            high = u
        else:
            low = u
        next_u = 0.5 * (low + high)
        if curvature > 0.0:
            newton = u - slope / curvature
            if low < newton < high:
                next_u = newton
        if abs(next_u - u) < CLOSE:
            break
        u = next_u
    return u_least, least2


@njit()
def nearest_on_piece(c, target, limit, gaps):
    """Return u and the squared distance of the point of a piece that is nearest to ``target``.

    If it is farther away than ``limit`` (a squared distance), only the nearest sample is returned.
    ``gaps`` is (SAMPLES + 1,) scratch space.
    """
    least2, u_least = np.inf, 0.0
    for k in range(SAMPLES + 1):
        gaps[k] = _gap(c, k / SAMPLES, target)
        if gaps[k] < least2:
            least2, u_least = gaps[k], k / SAMPLES
    # A point between two samples is nearer than they are by at most the path length between them.
    way = 0.0
    for j in range(c.shape[1]):
        rate = 0.0
        for k in range(1, c.shape[0]):
            rate += k * abs(c[k, j])
        way += rate * rate
    way = np.sqrt(way) / SAMPLES
    for k in range(SAMPLES + 1):
        # Around every sample that is nearer than its neighbours there is a local minimum.
        if (k > 0 and gaps[k] > gaps[k - 1]) or (k < SAMPLES and gaps[k] > gaps[k + 1]):
            continue
        if np.sqrt(gaps[k]) - way > np.sqrt(min(least2, limit)):
            continue
        low, high = max(k - 1, 0) / SAMPLES, min(k + 1, SAMPLES) / SAMPLES
        u, distance2 = _bracketed(c, target, low, high, k / SAMPLES)
        if distance2 < least2:
            least2, u_least = distance2, u
    return u_least, least2


@njit()
def compare(c, vertex, vertices, window, best, offset):
    """Compare n pieces with the vertices around them.

    Parameters
    ----------
    c
        (n, order, axes) coefficients, at the tool.
    vertex
        (n,) the vertex at the end of each piece's move.
    vertices
        (k, axes) positions at the tool.
    window
        Number of vertices on either side whose chords are compared with a piece.
    best, offset
        (k,) and (k, axes): squared distance of each vertex to the path so far, and the vector
        there; both are updated.

    Returns
    -------
    The largest squared distance of the path to the chords, its piece and u, and the (axes,) largest
    differences.
    """
    axes = c.shape[2]
    point = np.empty(axes)
    difference = np.empty(axes)
    gaps = np.empty(SAMPLES + 1)
    largest = np.zeros(axes)
    worst2, worst_piece, worst_u = -1.0, 0, 0.0
    for i in range(len(c)):
        first_vertex = max(vertex[i] - window, 0)
        last_vertex = min(vertex[i] + window, len(vertices) - 1)
        piece_worst2, worst_sample = -1.0, 0
        # The distance of a straight piece from a chord is largest at one of its ends.
        straight = True
        for k in range(2, c.shape[1]):
            for j in range(axes):
                straight = straight and c[i, k, j] == 0.0
        for k in range(0, SAMPLES + 1, SAMPLES if straight else 1):
            _at(c[i], k / SAMPLES, point)
            distance2 = _to_chords(point, vertices, first_vertex, last_vertex, difference)
            for j in range(axes):
                largest[j] = max(largest[j], abs(difference[j]))
            if distance2 > piece_worst2:
                piece_worst2, worst_sample = distance2, k
        if piece_worst2 > 0.8 * worst2 and not straight:
            low, high = max(worst_sample - 1, 0) / SAMPLES, min(worst_sample + 1, SAMPLES) / SAMPLES
            for _ in range(REFINE):
                a = high - _GOLDEN * (high - low)
                b = low + _GOLDEN * (high - low)
                _at(c[i], a, point)
                distance2_a = _to_chords(point, vertices, first_vertex, last_vertex, difference)
                _at(c[i], b, point)
                if distance2_a > _to_chords(point, vertices, first_vertex, last_vertex, difference):
                    high = b
                else:
                    low = a
            u = 0.5 * (low + high)
            _at(c[i], u, point)
            distance2 = _to_chords(point, vertices, first_vertex, last_vertex, difference)
            for j in range(axes):
                largest[j] = max(largest[j], abs(difference[j]))
            if distance2 < piece_worst2:
                distance2, u = piece_worst2, worst_sample / SAMPLES
            piece_worst2 = distance2
        else:
            u = worst_sample / SAMPLES
        if piece_worst2 > worst2:
            worst2, worst_piece, worst_u = piece_worst2, i, u
        for v in range(max(vertex[i] - 2, 0), min(vertex[i] + 2, len(vertices))):
            if best[v] == 0.0:
                continue
            u, distance2 = nearest_on_piece(c[i], vertices[v], best[v], gaps)
            if distance2 < best[v]:
                best[v] = distance2
                _at(c[i], u, point)
                for j in range(axes):
                    offset[v, j] = point[j] - vertices[v, j]
    return worst2, worst_piece, worst_u, largest


WINDOW = 2  # number of moves, before its own and after, with which a piece is compared
_PIECES = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class PathDeviation:
    """Largest deviation of a planned path, and its place.

    Parameters
    ----------
    at_tool_m
        Largest distance at the tool, with rotary axes at their radius.
    at_vertex
        True if it is the distance of a programmed vertex from the path, False for the distance of
        the path from a chord.
    line, operation
        Line of the job file and operation at that place.
    position
        (axes,) the vertex, or the point of the path, m or rad.
    per_axis
        (axes,) largest difference of each axis, m or rad, between the path and the nearest point of
        the program, or between a vertex and the nearest point of the path.
    """

    at_tool_m: float
    at_vertex: bool
    line: int
    operation: int
    position: FloatArray
    per_axis: FloatArray


def path_deviation(programmed: ProgrammedPath, planned: PlannedPath) -> PathDeviation:
    """Return the largest deviation between the two paths.

    It is the larger of two distances: from the planned path to the nearest programmed chord, and
    from a programmed vertex to the nearest point of the planned path. Each piece is compared only
    with a few moves before and after its own, because paths cross and retrace themselves.

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
        self._exhausted = False
        self._worst = -1.0
        self._where: tuple[bool, int, int, FloatArray] = (False, 0, 0, np.zeros(axes))
        self._per_axis = np.zeros(axes)

    def run(self) -> PathDeviation:
        for block in self._planned:
            for part in _parts(block):
                self._take(*part)
        while not self._exhausted:
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
            self._exhausted = True
            return
        scaled = block.positions * self._radius
        previous = w.positions[-1:] if len(w.positions) else np.full_like(scaled[:1], np.inf)
        has_moved = np.abs(np.diff(scaled, axis=0, prepend=previous)).max(axis=1) > 0
        rows = np.flatnonzero(has_moved)
        self._window = _Window(
            np.concatenate([w.positions, scaled[rows]]),
            np.concatenate([w.operation, block.operation[rows]]),
            np.concatenate([w.line, block.line[rows]]),
            np.concatenate([w.best, np.full(len(rows), np.inf)]),
            np.concatenate([w.offset, np.zeros((len(rows), scaled.shape[1]))]),
        )

    def _take(self, coefficients: FloatArray, operation: IntArray) -> None:
        """Compare pieces with the vertices around each."""
        last_operation = int(operation[-1])
        while (
            not self._exhausted
            and int((self._window.operation > last_operation).sum()) <= 2 * WINDOW
        ):
            self._read()
        w = self._window
        # The vertex at the end of each piece's operation; the start shares operation 0.
        vertex = np.searchsorted(w.operation, operation, side="right") - 1
        first_kept = max(int(vertex[0]) - 4 * WINDOW, 0)
        self._settle(first_kept)
        w = self._window
        deviation2, worst_piece, u, difference = compare(
            coefficients * self._radius, vertex - first_kept, w.positions, WINDOW, w.best, w.offset
        )
        self._per_axis = np.maximum(self._per_axis, difference)
        if deviation2 > self._worst:
            powers = u ** np.arange(coefficients.shape[1])
            position = np.asarray(powers @ coefficients[worst_piece])
            vertex_row = int(vertex[worst_piece]) - first_kept
            self._worst = deviation2
            self._where = (False, int(w.line[vertex_row]), int(operation[worst_piece]), position)

    def _settle(self, count: int) -> None:
        """Record the distances of the first ``count`` vertices, which no later piece can change."""
        w = self._window
        distances2 = w.best[:count]
        reached_rows = np.flatnonzero(np.isfinite(distances2))
        if len(reached_rows):
            self._per_axis = np.maximum(self._per_axis, np.abs(w.offset[reached_rows]).max(axis=0))
            farthest = int(reached_rows[np.argmax(distances2[reached_rows])])
            if distances2[farthest] > self._worst:
                self._worst = float(distances2[farthest])
                position = np.asarray(w.positions[farthest] / self._radius)
                self._where = (True, int(w.line[farthest]), int(w.operation[farthest]), position)
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
