"""The polygon of a spline that stays within a tolerance of programmed vertices.

Where the program turns so little that the spline cuts a vertex by less than the tolerance, the
vertices alone are its points. Elsewhere points are added on the chords on either side of the
vertex, the nearer to it the smaller the tolerance: one on each for a cubic, whose control points
they are, up to two for a quartic, whose knots they are. All lengths are measured at the tool, with
rotary axes at their radius.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit
from threadline.machine.mandrel import LocalRadii
from threadline.path.greville import TOUCH, knots_between, quartic_spacing
from threadline.path.runs import Vertices

STRAIGHT = 1e-9  # rad: a smaller turn is a rounding of the job's numbers
LEAST_SPACING_M = 1e-7  # a corner that would need points nearer than this is met at rest
# With neighbours at h1 and h2 a vertex is cut by at most |dt| max(h1, h2) / 4, whatever the
# spacing beyond them; with even spacing l on both sides by |dt| l / 6.
ANY_CUT = 1.0 / 4.0
EVEN_CUT = 1.0 / 6.0
EXTRA = 1.75  # share of the spacing: room for another point before a vertex without points
MOST_POINTS = 5  # most points of a chord, the vertex at its end included
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
    """Return the points of ``first``, if there are any, followed by those of ``second``."""
    if first is None:
        return second
    return Controls(
        **{n: np.concatenate([getattr(first, n), getattr(second, n)]) for n in _COLUMNS}
    )


def turns(
    positions: FloatArray, radius_m: FloatArray, local: LocalRadii | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the (n - 1,) lengths of the chords and the (n,) turns at the vertices.

    The turn of the first and the last vertex is 0. It says how far a curve of given length leaves
    the vertex, so that a turn of a mandrel counts at its largest radius on the chords beside the
    vertex; lengths count at the largest of all.
    """
    shares = np.ones((0, len(radius_m)))
    if local is not None:
        most = local.most_between(positions)
        shares = np.maximum(most[:-1], most[1:])
    found: tuple[FloatArray, FloatArray] = _turns(positions, radius_m, shares)
    return found


@njit()
def _turns(positions, radius_m, shares):
    """Return lengths and turns; ``shares`` are those of the vertices in between, or none."""
    count, axes = positions.shape
    length, turn = np.empty(max(count - 1, 0)), np.zeros(count)
    tangent = np.zeros((2, axes))
    for i in range(count - 1):
        squared, here, before = 0.0, i % 2, 1 - i % 2
        for j in range(axes):
            chord = (positions[i + 1, j] - positions[i, j]) * radius_m[j]
            tangent[here, j] = chord
            squared += chord * chord
        size = np.sqrt(squared)
        length[i] = size
        changed = 0.0
        for j in range(axes):
            tangent[here, j] /= size
            change = tangent[here, j] - tangent[before, j]
            if i > 0 and len(shares):
                change *= shares[i - 1, j]
            changed += change * change
        changed = np.sqrt(changed)
        if i > 0 and not changed <= STRAIGHT:
            turn[i] = changed
    return length, turn


@njit()
def corner_spacing(length_m, turn, cut_m, beside_m, spacing):
    """Write the (n,) distances of the points to be added beside each vertex, 0 for none.

    ``cut_m``, less what the program is beside the chord into a vertex (``beside_m``) and the next
    one, is the largest distance at the tool between the spline and the vertex, and between the
    spline and the chords. The points stand at most half way to the next vertex.
    """
    count = len(turn)
    for v in range(count):
        spacing[v] = 0.0
        if turn[v] > 0.0:
            before = length_m[v - 1] if v > 0 else 0.0
            after = length_m[v] if v < count - 1 else 0.0
            beside = max(beside_m[v], beside_m[v + 1] if v < count - 1 else 0.0)
            unit = (cut_m - beside) / turn[v]
            if max(before, after) * ANY_CUT > unit:
                spacing[v] = min(unit / EVEN_CUT, 0.5 * min(before, after))


def control_polygon(
    vertices: Vertices,
    length_m: FloatArray,
    turn: FloatArray,
    cut_m: float,
    first: int,
    stop: int,
    degree: int = CUBIC,
    *,
    begins: bool = False,
    ends: bool = False,
) -> Controls:
    """Return the points of chords ``first`` to ``stop``, the first vertex left out.

    Parameters
    ----------
    vertices
        n vertices of one run, among them one on either side of the chords, four for a quartic,
        unless the run ends there.
    length_m, turn
        (n - 1,) lengths and (n,) turns of ``turns``.
    cut_m
        Largest distance of the spline from the program, at the tool.
    begins, ends
        Whether the run begins with the first vertex, and ends with the last.
    """
    spacing = np.empty((2, len(turn)))  # on the leg into each vertex, and on the next
    if degree == CUBIC:
        corner_spacing(length_m, turn, cut_m, vertices.beside_m, spacing[0])
        spacing[1] = spacing[0]
    else:
        quartic_spacing(length_m, turn, cut_m, vertices.beside_m, first, stop, spacing)
    columns = _points(
        vertices.positions,
        vertices.nominal_s,
        vertices.operation,
        vertices.line,
        length_m,
        turn,
        spacing,
        first,
        stop,
        degree == QUARTIC,
        begins,
        ends,
    )
    return Controls(**dict(zip(_COLUMNS, columns, strict=True)))


@njit()
def _points(
    positions, nominal_s, operation, line, length_m, turn, spacing, first, stop, quartic,
    begins, ends,
):  # fmt: skip
    """Return the columns of the points of chords ``first`` to ``stop``."""
    axes = positions.shape[1]
    share = np.empty(MOST_POINTS)
    count = 0
    for c in range(first, stop):
        if not quartic and spacing[1, c] == 0.0 and spacing[0, c + 1] == 0.0:
            count += 1  # most are: told without a call
        else:
            count += _on_chord(length_m, turn, spacing, c, quartic, begins, ends, share)
    out = np.empty((count, axes))
    turned, gone, time_s = np.zeros(count), np.empty(count), np.empty(count)
    added = np.zeros(count, dtype=np.int64)
    own, row = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    n = 0
    for c in range(first, stop):
        before, between = 0.0, 0
        if quartic or spacing[1, c] > 0.0 or spacing[0, c + 1] > 0.0:
            between = _on_chord(length_m, turn, spacing, c, quartic, begins, ends, share) - 1
        for k in range(between):
            at = share[k]
            for j in range(axes):
                out[n, j] = positions[c, j] + at * (positions[c + 1, j] - positions[c, j])
            gone[n] = (at - before) * length_m[c]
            time_s[n] = (at - before) * nominal_s[c + 1]
            own[n], row[n], added[n] = operation[c + 1], line[c + 1], 1
            before = at
            n += 1
        # The end is written out so that a vertex is met bit for bit.
        for j in range(axes):
            out[n, j] = positions[c + 1, j]
        gone[n], time_s[n] = (1.0 - before) * length_m[c], (1.0 - before) * nominal_s[c + 1]
        own[n], row[n], turned[n] = operation[c + 1], line[c + 1], turn[c + 1]
        n += 1
    return out, turned, added, gone, time_s, own, row


@njit()
def _on_chord(length, turn, spacing, c, quartic, begins, ends, share):
    """Write the places (0 to 1) of the points on a chord, its end the last; count them."""
    near, far = spacing[1, c] / length[c], spacing[0, c + 1] / length[c]
    if quartic:
        opens, closes = begins and c == 0, ends and c == len(length) - 1
        other = c + 1 if near > 0.0 else c - 1
        beyond = length[other] / length[c] if 0 <= other < len(length) else np.inf
        return knots_between(near, far, opens, closes, beyond, share)
    n = 0
    room = 1.0 - near - far
    if near > 0.0 and far > 0.0 and room < TOUCH:
        share[n] = 0.5
        n += 1
    else:
        # Towards a vertex without added points, a second added point keeps the spacing even.
        if near > 0.0:
            share[n] = near
            n += 1
            if far == 0.0 and turn[c + 1] > 0.0 and room > EXTRA * near:
                share[n] = 2.0 * near
                n += 1
        if far > 0.0:
            if near == 0.0 and turn[c] > 0.0 and room > EXTRA * far:
                share[n] = 1.0 - 2.0 * far
                n += 1
            share[n] = 1.0 - far
            n += 1
    share[n] = 1.0
    return n + 1
