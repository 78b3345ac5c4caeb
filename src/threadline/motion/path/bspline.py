"""The uniform cubic B-spline of the 1994 controller, plain and pulled to its turning points."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.motion.path.durations import chord_time_s, longest_demand_s
from threadline.motion.path.straight import velocity_limit_of, with_previous
from threadline.motion.path.types import PieceBlock, ProgrammedPath

if TYPE_CHECKING:
    from threadline.machine import Machine

MULTIPLICITY = 3  # the curve passes a point repeated three times, and rests there


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlPoints:
    """Consecutive control points; row i of a column belongs to point i or the move into it.

    Parameters
    ----------
    positions
        (n, axes) m or rad.
    chord_s
        (n,) time of the move into the point at its feed; 0 for a repetition of the point.
    operation, line
        (n,) operation of that move, and its line in the job file.
    rest, dwell_s
        (n,) 1 if the motion rests at the point, else 0; time spent there.
    copy
        (n,) number of the repetition of one vertex, counted from 0.
    span
        (n,) knot interval from the previous point, in units of the regular one.
    """

    positions: FloatArray
    chord_s: FloatArray
    operation: IntArray
    line: IntArray
    rest: IntArray
    dwell_s: FloatArray
    copy: IntArray
    span: FloatArray

    def __len__(self) -> int:
        return len(self.positions)

    def take(self, rows: IntArray | slice) -> ControlPoints:
        """Return the points at ``rows``."""
        return ControlPoints(**{name: getattr(self, name)[rows] for name in _COLUMNS})


_COLUMNS = ("positions", "chord_s", "operation", "line", "rest", "dwell_s", "copy", "span")

Refine = Callable[[ControlPoints, FloatArray, ControlPoints | None, float], ControlPoints]
"""Turns vertices into control points.

Arguments are the vertices, (n,) 1 for each that is a turning point and 0 for the others, the
vertex before the first of them (or None), and 1.0 if that one is a turning point.
"""


def join(parts: list[ControlPoints]) -> ControlPoints:
    """Return the points of all ``parts``, one after another."""
    return ControlPoints(
        **{name: np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS}
    )


def bspline_coefficients(points: FloatArray) -> FloatArray:
    """Return the (n - 3, 4, axes) coefficients of the uniform cubic B-spline on (n, axes) points.

    Each piece is ``a0 + a1 u + a2 u^2 + a3 u^3`` for u in [0, 1]: filament winding thesis, section
    8.8.1.
    """
    out = np.empty((max(len(points) - 3, 0), 4, points.shape[1]))
    _fill(np.ascontiguousarray(points), out)
    return out


@njit()
def _fill(points, out):  # type: ignore[no-untyped-def]
    for i in range(len(out)):
        for j in range(points.shape[1]):
            p0, p1 = points[i, j], points[i + 1, j]
            p2, p3 = points[i + 2, j], points[i + 3, j]
            out[i, 0, j] = (p0 + 4.0 * p1 + p2) / 6.0
            out[i, 1, j] = (p2 - p0) / 2.0
            out[i, 2, j] = (p0 - 2.0 * p1 + p2) / 2.0
            out[i, 3, j] = (-p0 + 3.0 * p1 - 3.0 * p2 + p3) / 6.0


def vertices_as_points(
    programmed: ProgrammedPath, machine: Machine
) -> Iterator[tuple[ControlPoints, FloatArray]]:
    """Yield every vertex once, with 1 for those where an axis turns back, 0 for the others.

    The next vertex decides whether a vertex is a turning point, so the last vertex of each block is
    yielded with the next block.
    """
    limit = velocity_limit_of(programmed, machine)
    held_back: ControlPoints | None = None
    last_signs = np.zeros(len(programmed.axes))
    for block, start in with_previous(programmed):
        displacement = np.diff(block.positions, axis=0, prepend=start)
        points = ControlPoints(
            positions=block.positions,
            chord_s=chord_time_s(displacement, block.nominal_s, limit),
            operation=block.operation,
            line=block.line,
            rest=block.rest,
            dwell_s=block.dwell_s,
            copy=np.zeros(len(block), dtype=np.int64),
            span=np.ones(len(block)),
        )
        # Sign of the latest movement of each axis before each displacement.
        signs = np.vstack([last_signs[None], np.sign(displacement)])
        moving_row = np.where(signs != 0, np.arange(len(signs))[:, None], 0)
        latest_signs = np.take_along_axis(signs, np.maximum.accumulate(moving_row, axis=0), axis=0)
        # Axis by axis: numpy is slow along a short inner dimension.
        is_turning = np.logical_or.reduce([*(signs[1:] * latest_signs[:-1] < 0).T]).astype(
            np.float64
        )
        last_signs = latest_signs[-1]
        if held_back is not None:
            points = join([held_back, points])
        else:
            is_turning = is_turning[1:]  # nothing precedes the start
        yield points.take(slice(0, -1)), is_turning
        held_back = points.take(slice(-1, None))
    if held_back is not None:
        yield held_back, np.zeros(1)


def repeat(points: ControlPoints, times: IntArray) -> ControlPoints:
    """Return ``points`` with point i repeated ``times[i]`` times."""
    rows = np.repeat(np.arange(len(points)), times)
    first_rows = np.concatenate([[0], np.cumsum(times)[:-1]])
    copy = np.arange(len(rows)) - first_rows[rows]
    repeated = points.take(rows)
    return ControlPoints(
        positions=repeated.positions,
        chord_s=np.where(copy == 0, repeated.chord_s, 0.0),
        operation=repeated.operation,
        line=repeated.line,
        rest=repeated.rest,
        dwell_s=repeated.dwell_s,
        copy=copy,
        span=np.where(copy == 0, repeated.span, 1.0),
    )


def plain(
    points: ControlPoints, turning: FloatArray, before: ControlPoints | None, turned: float
) -> ControlPoints:
    """Return the vertices as control points, tripled at every rest of the motion (a ``Refine``)."""
    del turning, before, turned
    return repeat(points, np.where(points.rest == 1, MULTIPLICITY, 1))


@dataclass(frozen=True, slots=True)
class Window:
    """Control points that determine the pieces from ``first`` up to ``stop``.

    Piece j leads from point j to point j + 1.
    """

    points: ControlPoints
    first: int
    stop: int


def windows(programmed: ProgrammedPath, machine: Machine, refine: Refine) -> Iterator[Window]:
    """Yield the control points in windows whose pieces, in order, make up the whole path."""
    carried: ControlPoints | None = None
    last_vertex: ControlPoints | None = None
    last_turns, first = 0.0, 1
    for points, turning in vertices_as_points(programmed, machine):
        if not len(points):
            continue
        new_points = refine(points, turning, last_vertex, last_turns)
        last_vertex, last_turns = points.take(slice(-1, None)), float(turning[-1])
        carried = new_points if carried is None else join([carried, new_points])
        stop = len(carried) - 3
        if stop > first:
            yield Window(carried, first, stop)
            carried, first = carried.take(slice(stop - 2, None)), 2
    if carried is not None and len(carried) - 2 > first:
        yield Window(carried, first, len(carried) - 2)


def interval_time_s(programmed: ProgrammedPath, machine: Machine, refine: Refine) -> float:
    """Return the time of a regular knot interval, in s, that keeps every interval within its feed.

    The velocity in an interval is a weighted mean of three successive differences of control points
    (with even knots the weights are (1-u)^2/2, -u^2+u+1/2, u^2/2). The same mean of the times that
    these differences take at their feeds is an upper bound of the interval's time, for any kind of
    feed. The bound is exact if the three differences have one direction.
    """
    longest_s = 0.0
    for window in windows(programmed, machine, refine):
        points, rows = window.points, slice(window.first, window.stop)
        span = points.span[1:]
        differences = bezier_differences(points.chord_s[1:, None], span)
        first, middle, last = (3.0 * t[rows, 0] / span[rows] for t in differences)
        longest_s = max(longest_s, longest_demand_s(first, middle, last))
    return longest_s


def bezier_differences(
    leg: FloatArray, span: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the three (n, axes) differences of the Bezier points on each knot span.

    ``leg`` (n, axes) and ``span`` (n,) are the differences of n + 1 control points and the knot
    intervals between them. The Bezier points follow Boehm's construction; the differences on the
    first and the last span, which lack a neighbour, are invalid.
    """
    span_before = np.concatenate([span[:1], span[:-1]])
    span_after = np.concatenate([span[1:], span[-1:]])
    span_sum = span_before + span + span_after
    lead, trail = (span_before / span_sum)[:, None] * leg, (span_after / span_sum)[:, None] * leg
    joint_differences = np.zeros((len(leg) + 1, leg.shape[1]))
    joint_differences[:-1] += lead
    joint_differences[1:] += trail
    first = joint_differences[:-1] * (span / (span_before + span))[:, None]
    last = joint_differences[1:] * (span / (span + span_after))[:, None]
    return first, leg - lead - trail, last


def _coefficients(window: Window) -> FloatArray:
    """Return the (n, 4, axes) coefficients of the pieces of a window."""
    points, rows = window.points, slice(window.first, window.stop)
    if (points.span == 1.0).all():
        return bspline_coefficients(points.positions[window.first - 1 : window.stop + 2])
    leg, span = np.diff(points.positions, axis=0), points.span[1:]
    d0, d1, d2 = (part[rows] for part in bezier_differences(leg, span))
    span_before = span[window.first - 1 : window.stop - 1]
    span_sum = span_before + span[rows] + span[window.first + 1 : window.stop + 1]
    start = points.positions[rows] + (span_before / span_sum)[:, None] * leg[rows] - d0
    return np.stack([start, 3.0 * d0, 3.0 * (d1 - d0), d0 - 2.0 * d1 + d2], axis=1)


def bspline_pieces(
    programmed: ProgrammedPath, machine: Machine, refine: Refine, interval_s: float
) -> Iterator[PieceBlock]:
    """Yield one cubic piece per knot interval; ``interval_s`` is the time of a regular one."""
    begun = False
    for window in windows(programmed, machine, refine):
        points = window.points
        if not begun and points.dwell_s[0] > 0:
            yield _dwell_at_start(points)
        begun = True
        end_points = slice(window.first + 1, window.stop + 1)
        next_points = slice(window.first + 2, window.stop + 2)
        # The interval into point j + 1 belongs to the move into it; the one between the last two
        # of three copies leaves the vertex, and belongs to the next move.
        leaves = points.copy[end_points] == MULTIPLICITY - 1
        arrives = (points.rest[end_points] == 1) & (points.copy[end_points] == 1)
        yield PieceBlock(
            coefficients=_coefficients(window),
            operation=np.where(leaves, points.operation[next_points], points.operation[end_points]),
            nominal_s=interval_s * points.span[end_points],
            rest_after=arrives.astype(np.int64),
            dwell_s=np.where(arrives, points.dwell_s[end_points], 0.0),
            line=np.where(leaves, points.line[next_points], points.line[end_points]),
        )


def _dwell_at_start(points: ControlPoints) -> PieceBlock:
    return PieceBlock(
        coefficients=points.positions[:1, None, :],
        operation=points.operation[:1],
        nominal_s=np.zeros(1),
        rest_after=np.ones(1, dtype=np.int64),
        dwell_s=points.dwell_s[:1],
        line=points.line[:1],
    )


Pull = Literal["repeat", "points", "spacing"]

NEARBY = 1.0 / 8.0  # distance of added points from a turning point, as a share of the chord
CLOSE_KNOTS = 1.0 / 8.0  # knot intervals beside a turning point, in units of the others


def by_repetition(
    points: ControlPoints, turning: FloatArray, before: ControlPoints | None, turned: float
) -> ControlPoints:
    """Repeat each turning point three times: the curve passes and rests there (a ``Refine``)."""
    del before, turned
    return repeat(points, np.where((points.rest == 1) | (turning == 1), MULTIPLICITY, 1))


def by_points(
    points: ControlPoints, turning: FloatArray, before: ControlPoints | None, turned: float
) -> ControlPoints:
    """Add a point on either side of each turning point, at an eighth of its chord (a ``Refine``).

    The curve misses the turning point by |P0 - 2 P1 + P2| / 48, an eighth of the distance without
    the added points.
    """
    chain = points if before is None else join([before, points])
    turns = turning if before is None else np.concatenate([[turned], turning])
    parts = [] if before is not None else [chain.take(slice(0, 1))]
    if len(chain) > 1:
        begin, end = chain.take(slice(0, -1)), chain.take(slice(1, None))
        near_points = _on_chords(begin, end, NEARBY)
        far_points = _on_chords(begin, end, 1.0 - NEARBY)
        rows, is_used = [], []
        for k in range(3):
            rows.append(3 * np.arange(len(end)) + k)
            is_used.append((turns[:-1] == 1, turns[1:] == 1, np.ones(len(end), dtype=bool))[k])
        order = np.argsort(np.concatenate(rows), kind="stable")
        kept_rows = order[np.concatenate(is_used)[order]]
        new_points = join([near_points, far_points, end]).take(kept_rows)
        # The time of a chord is divided among its points in proportion to their distances.
        share = np.concatenate(
            [np.full(len(end), NEARBY), np.full(len(end), 1.0 - NEARBY), np.ones(len(end))]
        )[kept_rows]
        chord = np.concatenate([np.arange(len(end))] * 3)[kept_rows]
        opens_chord = np.diff(chord, prepend=-1) > 0
        share_passed = share - np.where(opens_chord, 0.0, np.roll(share, 1))
        parts.append(replace(new_points, chord_s=share_passed * end.chord_s[chord]))
    all_points = join(parts)
    return repeat(all_points, np.where(all_points.rest == 1, MULTIPLICITY, 1))


def by_spacing(
    points: ControlPoints, turning: FloatArray, before: ControlPoints | None, turned: float
) -> ControlPoints:
    """Shorten the knot intervals on either side of each turning point to an eighth (a ``Refine``).

    The curve misses the turning point by |P0 - 2 P1 + P2| e / (2 (1 + 2 e)) with e = 1/8, and
    its peak velocity is 3 / (1 + 2 e) times that with even knots.
    """
    del before
    leaves = np.concatenate([[turned], turning[:-1]]) == 1
    is_short = (turning == 1) | leaves
    spaced = replace(points, span=np.where(is_short, CLOSE_KNOTS, 1.0))
    return repeat(spaced, np.where(points.rest == 1, MULTIPLICITY, 1))


def _on_chords(begin: ControlPoints, end: ControlPoints, fraction: float) -> ControlPoints:
    """Return an added point at ``fraction`` of each chord; it belongs to the move along it."""
    return replace(
        end,
        positions=begin.positions + fraction * (end.positions - begin.positions),
        rest=np.zeros(len(end), dtype=np.int64),
        dwell_s=np.zeros(len(end)),
    )


PULLS: dict[Pull, Refine] = {"repeat": by_repetition, "points": by_points, "spacing": by_spacing}
