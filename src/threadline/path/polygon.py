"""The control polygon of a cubic B-spline that stays within a tolerance of programmed vertices.

Where the program turns so little that the spline cuts a vertex by less than the tolerance, the
vertices alone are the control points. Elsewhere points are added on the chords on either side of
the vertex, the nearer to it the smaller the tolerance. All lengths are measured at the tool, with
rotary axes at their radius.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit
from threadline.machine.mandrel import LocalRadii
from threadline.path.runs import Vertices

STRAIGHT = 1e-9  # rad: a smaller turn is a rounding of the job's numbers
LEAST_SPACING_M = 1e-7  # a corner that would need points nearer than this is met at rest
# With neighbours at h1 and h2 a vertex is cut by at most |dt| max(h1, h2) / 4, whatever the
# spacing beyond them; with even spacing l on both sides by |dt| l / 6.
ANY_CUT = 1.0 / 4.0
EVEN_CUT = 1.0 / 6.0
TOUCH = 1e-9  # share of the chord: two added points that are nearer to each other become one
EXTRA = 1.75  # share of the spacing: room for another point before a vertex without points
MOST_POINTS = 4  # most control points of a chord, the vertex at its end included


@dataclass(frozen=True, slots=True, kw_only=True)
class Controls:
    """Consecutive control points; the leg of point i leads from point i - 1 to it.

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
    chord = np.diff(positions, axis=0) * radius_m
    length = np.sqrt((chord**2).sum(axis=1))
    tangent = chord / length[:, None]
    turn = np.zeros(len(positions))
    change = np.diff(tangent, axis=0)
    if local is not None:
        most = local.most_between(positions)
        change *= np.maximum(most[:-1], most[1:])
    turn[1:-1] = np.sqrt((change**2).sum(axis=1))
    turn[turn <= STRAIGHT] = 0.0
    return length, turn


def corner_spacing(length_m: FloatArray, turn: FloatArray, cut_m: float) -> FloatArray:
    """Return the (n,) distance of the points to be added beside each vertex, 0 for none.

    ``cut_m`` is the largest distance at the tool between the spline and the vertex, and between
    the spline and the chords. The points stand at most half way to the next vertex.
    """
    with np.errstate(divide="ignore"):
        unit = np.where(turn > 0, cut_m / turn, np.inf)
    before, after = np.insert(length_m, 0, 0.0), np.append(length_m, 0.0)
    spacing = np.minimum(unit / EVEN_CUT, 0.5 * np.minimum(before, after))
    return np.where(np.maximum(before, after) * ANY_CUT <= unit, 0.0, spacing)


def control_polygon(
    vertices: Vertices,
    length_m: FloatArray,
    turn: FloatArray,
    cut_m: float,
    first: int,
    stop: int,
) -> Controls:
    """Return the control points of chords ``first`` to ``stop``, the first vertex left out.

    Parameters
    ----------
    vertices
        n vertices of one run, among them one on either side of the chords unless the run ends
        there.
    length_m, turn
        (n - 1,) lengths and (n,) turns of ``turns``.
    cut_m
        Largest distance of the spline from vertices and chords, at the tool.
    """
    spacing = corner_spacing(length_m, turn, cut_m)
    fraction, owner, vertex = _insert(length_m, turn, spacing, first, stop)
    begin, end = vertices.positions[owner], vertices.positions[owner + 1]
    opens = np.diff(owner, prepend=-1) > 0
    share = fraction - np.where(opens, 0.0, np.roll(fraction, 1))
    return Controls(
        # The end is written out so that a vertex is met bit for bit.
        positions=np.where(vertex[:, None] == 1, end, begin + fraction[:, None] * (end - begin)),
        turn=np.where(vertex == 1, turn[owner + 1], 0.0),
        added=1 - vertex,
        length_m=share * length_m[owner],
        nominal_s=share * vertices.nominal_s[owner + 1],
        operation=vertices.operation[owner + 1],
        line=vertices.line[owner + 1],
    )


@njit()
def _insert(
    length: FloatArray, turn: FloatArray, spacing: FloatArray, first: int, stop: int
) -> tuple[FloatArray, IntArray, IntArray]:
    """Return of every control point its place on its chord (0 to 1), the chord, 1 if a vertex."""
    fraction = np.empty((stop - first) * MOST_POINTS)
    owner = np.empty((stop - first) * MOST_POINTS, dtype=np.int64)
    vertex = np.zeros((stop - first) * MOST_POINTS, dtype=np.int64)
    n = 0
    for c in range(first, stop):
        near, far = spacing[c] / length[c], spacing[c + 1] / length[c]
        begin = n
        room = 1.0 - near - far
        if near > 0.0 and far > 0.0 and room < TOUCH:
            fraction[n] = 0.5
            n += 1
        else:
            # Towards a vertex without added points, a second added point keeps the spacing even.
            if near > 0.0:
                fraction[n] = near
                n += 1
                if far == 0.0 and turn[c + 1] > 0.0 and room > EXTRA * near:
                    fraction[n] = 2.0 * near
                    n += 1
            if far > 0.0:
                if near == 0.0 and turn[c] > 0.0 and room > EXTRA * far:
                    fraction[n] = 1.0 - 2.0 * far
                    n += 1
                fraction[n] = 1.0 - far
                n += 1
        fraction[n] = 1.0
        vertex[n] = 1
        n += 1
        owner[begin:n] = c
    return fraction[:n], owner[:n], vertex[:n]
