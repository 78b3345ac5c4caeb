"""The polygon of a spline that stays within a tolerance of programmed vertices.

Where the program turns so little that the spline cuts a vertex by less than the tolerance, the
vertices alone are the polygon's points. Elsewhere points are added on the chords on either side of
the vertex; the smaller the tolerance, the nearer. A cubic gets one control point on each chord, a
quartic up to two knots. All lengths are measured at the tool, with rotary axes at their radius.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.motion.path.greville import TOUCH, knots_between, quartic_spacing, quartic_spans
from threadline.motion.path.runs import Vertices
from threadline.motion.path.types import PieceBlock

if TYPE_CHECKING:
    from threadline.machine.mandrel import LocalRadii

STRAIGHT = 1e-9  # rad: a smaller turn is a rounding of the job's numbers
LEAST_SPACING_M = 1e-7  # a corner that would need closer points is met at rest
# With neighbours at h1 and h2 a vertex is cut by at most |dt| max(h1, h2) / 4, whatever the
# spacing beyond them; with even spacing l on both sides by |dt| l / 6.
ANY_CUT = 1.0 / 4.0
EVEN_CUT = 1.0 / 6.0
EXTRA = 1.75  # of the spacing: room needed for another point before a vertex without points
MOST_POINTS = 5  # most points of a chord, including the vertex at its end
CUBIC, QUARTIC = 3, 4
"""Degrees of a spline: with continuous second derivative, or third."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Controls:
    """Consecutive points of the polygon; the leg of point i leads from point i - 1 to it.

    Parameters
    ----------
    positions
        (n, axes) m or rad.
    turn
        (n,) |t2 - t1| of the unit tangents before and after the point, at the tool; 0 on a line.
    added
        (n,) 1 for a point that is not a vertex, else 0.
    length_m, nominal_s
        (n,) length of the leg at the tool, and its time at the feed.
    operation, line
        (n,) operation that the leg belongs to, and its line in the job file.
    """

    positions: FloatArray
    turn: FloatArray
    added: IntArray
    length_m: FloatArray
    nominal_s: FloatArray
    operation: IntArray
    line: IntArray

    def __len__(self) -> int:
        return len(self.positions)

    def take(self, rows: slice) -> Controls:
        """Return the points at ``rows``."""
        return Controls(**{name: getattr(self, name)[rows] for name in _COLUMNS})


_COLUMNS = ("positions", "turn", "added", "length_m", "nominal_s", "operation", "line")


def join_controls(first: Controls | None, second: Controls) -> Controls:
    """Return the points of ``first``, if there are any, followed by the points of ``second``."""
    if first is None:
        return second
    return Controls(
        **{n: np.concatenate([getattr(first, n), getattr(second, n)]) for n in _COLUMNS}
    )


def turns(
    positions: FloatArray, radius_m: FloatArray, local: LocalRadii | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the (n - 1,) lengths of the chords and the (n,) turns at the vertices.

    The turn of the first and the last vertex is 0. The turn tells how far a curve of given length
    misses the vertex, so for a mandrel it counts at the largest radius on the neighbouring chords;
    lengths count at the largest radius of all.
    """
    shares = np.ones((0, len(radius_m)))
    if local is not None:
        largest_shares = local.most_between(positions)
        shares = np.maximum(largest_shares[:-1], largest_shares[1:])
    lengths_and_turns: tuple[FloatArray, FloatArray] = _turns(positions, radius_m, shares)
    return lengths_and_turns


@njit()
def _turns(positions, radius_m, shares):
    """Return lengths and turns; ``shares`` belong to the vertices in between, or are empty."""
    count, axes = positions.shape
    length, turn = np.empty(max(count - 1, 0)), np.zeros(count)
    tangent = np.zeros((2, axes))
    for i in range(count - 1):
        length2_m2, current, previous = 0.0, i % 2, 1 - i % 2
        for j in range(axes):
            chord = (positions[i + 1, j] - positions[i, j]) * radius_m[j]
            tangent[current, j] = chord
            length2_m2 += chord * chord
        length_m = np.sqrt(length2_m2)
        length[i] = length_m
        changed = 0.0
        for j in range(axes):
            tangent[current, j] /= length_m
            change = tangent[current, j] - tangent[previous, j]
            if i > 0 and len(shares):
                change *= shares[i - 1, j]
            changed += change * change
        changed = np.sqrt(changed)
        if i > 0 and not changed <= STRAIGHT:
            turn[i] = changed
    return length, turn


@njit()
def corner_spacing(length_m, turn, cut_m, beside_m, spacing):
    """Write the (n,) distances of the points to add beside each vertex, 0 for none.

    ``cut_m`` is the largest distance at the tool between the spline and the vertex or the chords,
    including the program's deviation (``beside_m``) from the chord into a vertex and the next one.
    The points are at most half way to the next vertex.
    """
    count = len(turn)
    for v in range(count):
        spacing[v] = 0.0
        if turn[v] > 0.0:
            leg_before_m = length_m[v - 1] if v > 0 else 0.0
            leg_after_m = length_m[v] if v < count - 1 else 0.0
            deviation_m = max(beside_m[v], beside_m[v + 1] if v < count - 1 else 0.0)
            room_m = (cut_m - deviation_m) / turn[v]
            if max(leg_before_m, leg_after_m) * ANY_CUT > room_m:
                spacing[v] = min(room_m / EVEN_CUT, 0.5 * min(leg_before_m, leg_after_m))


class Chords(NamedTuple):
    """Some chords of a run.

    Parameters
    ----------
    first, stop
        First vertex, and last vertex.
    is_first, is_last
        Whether the run begins with its first vertex, and ends with its last.
    """

    first: int
    stop: int
    is_first: bool = False
    is_last: bool = False


def control_polygon(
    vertices: Vertices,
    length_m: FloatArray,
    turn: FloatArray,
    cut_m: float,
    chords: Chords,
    degree: int = CUBIC,
) -> Controls:
    """Return the points of some chords, the first vertex left out.

    Parameters
    ----------
    vertices
        n vertices of one run, including one on either side of the chords (four for a quartic)
        unless the run ends there.
    length_m, turn
        (n - 1,) lengths and (n,) turns from ``turns``.
    cut_m
        Largest distance of the spline from the program, at the tool. ``Vertices.more_m``
        is added at each.
    """
    spacing = np.empty((2, len(turn)))  # on the leg into each vertex, and on the next
    if degree == CUBIC:
        corner_spacing(length_m, turn, cut_m, vertices.beside_m, spacing[0])
        spacing[1] = spacing[0]
    else:
        cuts_m = cut_m + vertices.more_m
        quartic_spacing(
            length_m, turn, cuts_m, vertices.beside_m, chords.first, chords.stop, spacing
        )
    vertex_columns = vertices.positions, vertices.nominal_s, vertices.operation, vertices.line
    # Plain tuples: numba finds the type of a named one anew in each call.
    columns = _points(vertex_columns, (length_m, turn, spacing), tuple(chords), degree == QUARTIC)
    return Controls(**dict(zip(_COLUMNS, columns, strict=True)))


@njit()
def _points(vertices, legs, chords, quartic):
    """Return the columns of the points of some chords.

    ``vertices`` are (n, axes) positions, (n,) nominal times, operations and lines. ``legs`` are
    (n - 1,) lengths, (n,) turns, and (2, n) spacings on the leg into each vertex and on the next.
    ``chords`` are the values of ``Chords``.
    """
    positions, nominal_s, operation, line = vertices
    length_m, turn, spacing = legs
    first, stop, is_first, is_last = chords
    axes = positions.shape[1]
    share = np.empty(MOST_POINTS)
    count = 0
    for c in range(first, stop):
        if not quartic and spacing[1, c] == 0.0 and spacing[0, c + 1] == 0.0:
            count += 1  # the usual case, without a call
        else:
            count += _on_chord(legs, c, quartic, is_first, is_last, share)
    point_positions = np.empty((count, axes))
    point_turn, leg_m, time_s = np.zeros(count), np.empty(count), np.empty(count)
    added = np.zeros(count, dtype=np.int64)
    point_operation, point_line = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    n = 0
    for c in range(first, stop):
        last_share, added_count = 0.0, 0
        if quartic or spacing[1, c] > 0.0 or spacing[0, c + 1] > 0.0:
            added_count = _on_chord(legs, c, quartic, is_first, is_last, share) - 1
        for k in range(added_count):
            point_share = share[k]
            for j in range(axes):
                point_positions[n, j] = positions[c, j] + point_share * (
                    positions[c + 1, j] - positions[c, j]
                )
            leg_m[n] = (point_share - last_share) * length_m[c]
            time_s[n] = (point_share - last_share) * nominal_s[c + 1]
            point_operation[n], point_line[n], added[n] = operation[c + 1], line[c + 1], 1
            last_share = point_share
            n += 1
        # The end is copied so that a vertex is met bit for bit.
        for j in range(axes):
            point_positions[n, j] = positions[c + 1, j]
        leg_m[n], time_s[n] = (
            (1.0 - last_share) * length_m[c],
            (1.0 - last_share) * nominal_s[c + 1],
        )
        point_operation[n], point_line[n], point_turn[n] = (
            operation[c + 1],
            line[c + 1],
            turn[c + 1],
        )
        n += 1
    return point_positions, point_turn, added, leg_m, time_s, point_operation, point_line


@njit()
def _on_chord(legs, c, quartic, is_first, is_last, share):
    """Write the places (0 to 1) of the points on a chord, its end included; return their number."""
    length, turn, spacing = legs
    near, far = spacing[1, c] / length[c], spacing[0, c + 1] / length[c]
    if quartic:
        opens, closes = is_first and c == 0, is_last and c == len(length) - 1
        next_leg = c + 1 if near > 0.0 else c - 1
        next_share = length[next_leg] / length[c] if 0 <= next_leg < len(length) else np.inf
        return knots_between(near, far, opens, closes, next_share, share)
    n = 0
    free_share = 1.0 - near - far
    if near > 0.0 and far > 0.0 and free_share < TOUCH:
        share[n] = 0.5
        n += 1
    else:
        # Towards a vertex without added points, a second added point keeps the spacing even.
        if near > 0.0:
            share[n] = near
            n += 1
            if far == 0.0 and turn[c + 1] > 0.0 and free_share > EXTRA * near:
                share[n] = 2.0 * near
                n += 1
        if far > 0.0:
            if near == 0.0 and turn[c] > 0.0 and free_share > EXTRA * far:
                share[n] = 1.0 - 2.0 * far
                n += 1
            share[n] = 1.0 - far
            n += 1
    share[n] = 1.0
    return n + 1


_EVEN = 0.02
"""A piece is divided if its time per unit of u, by the feed, varies by more than this share."""
_MOST_PARTS = 16
_TINY = float(np.finfo(np.float64).tiny)


def pieces_of(
    controls: Controls, first: int, stop: int, *, is_last: bool, dwell_s: float, degree: int = CUBIC
) -> PieceBlock:
    """Return the pieces between points ``first`` and ``stop``.

    Parameters
    ----------
    controls
        Points, with at least two before ``first`` and two after ``stop`` (three for a quartic)
        unless the run begins at the first or ends at the last.
    is_last, dwell_s
        Whether the run ends at ``stop``, and the pause there.
    degree
        3, with the points as control points, or 4, with control points between them.
    """
    columns = controls.positions, controls.turn, controls.length_m, controls.nominal_s
    if degree == CUBIC:
        coefficients, pace, straight = _spans(*columns, first, stop)
    else:
        coefficients, pace, straight = quartic_spans(*columns, first, stop)
    end_points = slice(first + 1, stop + 1)
    coefficients, nominal_s, operation, line = even_parts(
        coefficients,
        pace,
        controls.nominal_s[end_points],
        straight,
        (controls.operation[end_points], controls.line[end_points]),
    )
    rest = np.zeros(len(nominal_s), dtype=np.int64)
    pause = np.zeros(len(nominal_s))
    if is_last:
        rest[-1], pause[-1] = 1, dwell_s
    for column in (coefficients, nominal_s, rest, pause):
        column.flags.writeable = False  # the block need not copy an array without other users
    return PieceBlock(
        coefficients=coefficients,
        operation=operation,
        nominal_s=nominal_s,
        rest_after=rest,
        dwell_s=pause,
        line=line,
    )


@njit()
def _spans(positions, turn, length_m, nominal_s, first, stop):
    """Return the pieces between two control points, their paces, and which of them are straight.

    Returns
    -------
    coefficients, pace, straight
        (m, 4, axes); (m, 3) Bezier values of the time at the feed per unit of u, s; (m,).

    Notes
    -----
    Boehm's construction: leg k, from point k to k + 1 with length h[k], has the two inner Bezier
    points of its span at the fractions h[k-1] / H and (h[k-1] + h[k]) / H,
    H = h[k-1] + h[k] + h[k+1]; the joint at point k divides the distance from the last Bezier point
    of leg k - 1 to the first of leg k as h[k-1] : h[k]. A leg between two points where the polygon
    does not turn is a line. The spline beside a line ends in their common point as at the end of a
    run: its polygon is mirrored there, so that it leaves straight, without curvature and evenly,
    whatever the length of the line. The time at the feed is a spline over the same knots as the
    path.
    """
    legs, axes = len(positions) - 1, positions.shape[1]
    line = np.empty(legs, dtype=np.bool_)
    for k in range(legs):
        line[k] = turn[k] == 0.0 and turn[k + 1] == 0.0
    # Shares of each leg before its first and after its second inner Bezier point.
    lead, trail = np.empty(legs), np.empty(legs)
    opens, closes = np.empty(legs, dtype=np.bool_), np.empty(legs, dtype=np.bool_)
    for k in range(legs):
        opens[k] = k == 0 or line[k - 1] or line[k]
        closes[k] = k == legs - 1 or line[k + 1] or line[k]
        h = length_m[k + 1]
        leg_before = h if opens[k] else length_m[k]
        leg_after = h if closes[k] else length_m[k + 2]
        total = leg_before + h + leg_after
        lead[k], trail[k] = leg_before / total, leg_after / total
    coefficients = np.empty((stop - first, 4, axes))
    pace = np.empty((stop - first, 3))
    for k in range(first, stop):
        i = k - first
        h = length_m[k + 1]
        share_at_start = 0.0 if opens[k] else h / (length_m[k] + h)
        share_at_end = 0.0 if closes[k] else h / (h + length_m[k + 2])
        for j in range(axes):
            leg = positions[k + 1, j] - positions[k, j]
            d0, d2 = lead[k] * leg, trail[k] * leg
            d1 = leg - d0 - d2
            joint = positions[k, j]
            if not opens[k]:
                start_difference = d0
                d0 = (
                    trail[k - 1] * (positions[k, j] - positions[k - 1, j]) + start_difference
                ) * share_at_start
                joint += start_difference - d0
            if not closes[k]:
                d2 = (lead[k + 1] * (positions[k + 2, j] - positions[k + 1, j]) + d2) * share_at_end
            coefficients[i, 0, j] = joint
            if line[k]:
                coefficients[i, 1, j], coefficients[i, 2, j], coefficients[i, 3, j] = leg, 0.0, 0.0
            else:
                coefficients[i, 1, j] = 3.0 * d0
                coefficients[i, 2, j] = 3.0 * (d1 - d0)
                coefficients[i, 3, j] = d0 - 2.0 * d1 + d2
        d0, d2 = lead[k] * nominal_s[k + 1], trail[k] * nominal_s[k + 1]
        pace[i, 1] = 3.0 * (nominal_s[k + 1] - d0 - d2)
        if not opens[k]:
            d0 = (trail[k - 1] * nominal_s[k] + d0) * share_at_start
        if not closes[k]:
            d2 = (lead[k + 1] * nominal_s[k + 2] + d2) * share_at_end
        pace[i, 0], pace[i, 2] = 3.0 * d0, 3.0 * d2
    return coefficients, pace, line[first:stop]


def even_parts(
    coefficients: FloatArray,
    pace: FloatArray,
    passed_s: FloatArray,
    straight: NDArray[np.bool_],
    piece_columns: tuple[IntArray, IntArray],
) -> tuple[FloatArray, FloatArray, IntArray, IntArray]:
    """Return pieces cut into parts of even pace, with adjacent straight spans of one move joined.

    Parameters
    ----------
    coefficients, pace, straight
        The m pieces, as ``_spans`` returns them.
    passed_s
        (m,) times of straight pieces at the feed, s.
    piece_columns
        (m,) operations and lines of the pieces.

    Returns
    -------
    coefficients, nominal_s, operation, line
        (n, degree + 1, axes) and (n,) of the parts; the time of a part is at its slowest pace.
    """
    operation, line = piece_columns
    parts = _parts(pace, straight)
    count = _count(parts, straight, operation)
    nominal_s = _nominal(pace, straight, passed_s)
    if count == len(parts) and parts.max() == 1:
        return coefficients, nominal_s, operation, line
    cut: tuple[FloatArray, FloatArray, IntArray, IntArray] = _cut_and_joined(
        coefficients, pace, nominal_s, straight, parts, piece_columns, count
    )
    return cut


@njit()
def _parts(pace, straight):
    """Return the number of parts into which to divide each of m pieces for an even pace.

    A piece has a single nominal time. At the slowest of its paces (m, degree) it would take up to
    half as long again as programmed, and the needle of a stitcher would wait for the head.
    """
    part_counts = np.ones(len(pace), dtype=np.int64)
    for i in range(len(pace)):
        total, least_pace, most_pace = 0.0, np.inf, -np.inf
        for k in range(pace.shape[1]):  # sum() and max() of a row would allocate an array
            total += pace[i, k]
            least_pace, most_pace = min(least_pace, pace[i, k]), max(most_pace, pace[i, k])
        uneven = (most_pace - least_pace) / max(total / pace.shape[1], _TINY)
        if not straight[i] and uneven > _EVEN:
            part_counts[i] = min(int(np.ceil(uneven / _EVEN)), _MOST_PARTS)
    return part_counts


@njit()
def _count(parts, straight, operation):
    """Return the number of pieces, with adjacent straight spans of one move joined."""
    count = 0
    for i in range(len(parts)):
        count += parts[i]
        if i > 0 and straight[i] and straight[i - 1] and operation[i] == operation[i - 1]:
            count -= 1
    return count


@njit()
def _nominal(pace, straight, passed_s):
    """Return the (m,) times of whole pieces: at the slowest pace for curved ones."""
    times_s = np.empty(len(pace))
    for i in range(len(pace)):
        slowest = -np.inf
        for k in range(pace.shape[1]):
            slowest = max(slowest, pace[i, k])
        times_s[i] = passed_s[i] if straight[i] else slowest
    return times_s


@njit()
def _cut_and_joined(coefficients, pace, nominal_s, straight, parts, piece_columns, count):
    """Return ``count`` pieces: m cut into ``parts`` each, straight spans of one move joined.

    ``piece_columns`` holds the (m,) operations and lines of the pieces.

    Returns
    -------
    coefficients, nominal_s, operation, line
        (count, degree + 1, axes) and (count,) of the pieces.
    """
    operation, line = piece_columns
    order, axes = coefficients.shape[1:]
    pieces = np.empty((count, order, axes))
    time_s = np.empty(count)
    piece_operation, piece_line = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    part_s = np.empty(order - 1)
    n = 0
    for i in range(len(parts)):
        joins_previous = (
            i > 0 and straight[i] and straight[i - 1] and operation[i] == operation[i - 1]
        )
        if joins_previous:
            for j in range(axes):
                pieces[n - 1, 1, j] += coefficients[i, 1, j]
            time_s[n - 1] += nominal_s[i]
            continue
        piece_operation[n : n + parts[i]], piece_line[n : n + parts[i]] = operation[i], line[i]
        if parts[i] == 1:
            for power in range(order):  # assigning the whole array takes seconds to compile
                for j in range(axes):
                    pieces[n, power, j] = coefficients[i, power, j]
            time_s[n] = nominal_s[i]
            n += 1
            continue
        h = 1.0 / parts[i]
        for part in range(parts[i]):
            u = h * part
            for j in range(axes):
                for power in range(order):
                    pieces[n, power, j] = coefficients[i, power, j]
                # Horner's scheme in both directions shifts a polynomial.
                for lowest in range(order - 1):
                    for power in range(order - 2, lowest - 1, -1):
                        pieces[n, power, j] += u * pieces[n, power + 1, j]
                h_power = 1.0
                for power in range(1, order):
                    h_power *= h
                    pieces[n, power, j] *= h_power
            # The largest Bezier value of the part's time per u keeps every point within its feed.
            largest_s = 0.0
            for end_arguments in range(order - 1):
                for k in range(order - 1):
                    part_s[k] = pace[i, k]
                for level in range(order - 2):
                    argument = u + h if level < end_arguments else u
                    for k in range(order - 2 - level):
                        part_s[k] += argument * (part_s[k + 1] - part_s[k])
                largest_s = max(largest_s, part_s[0])
            time_s[n] = h * largest_s
            n += 1
    return pieces, time_s, piece_operation, piece_line
