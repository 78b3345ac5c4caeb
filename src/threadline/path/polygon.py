"""Programmed vertices -> control polygon of a cubic B-spline that stays within a tolerance.

The control points are the vertices themselves, and points added on the chords where the spline
would cut a corner too far. Everything is measured at the tool: rotary axes at their radius.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from threadline.arrays import FloatArray, IntArray
from threadline.path.runs import Vertices

# Corner cut |h1 t1 - h2 t2| w for neighbours at the distances h: w = 1/6 where the spacing is
# even on both sides, and never above 1/4 while neither neighbour is farther than the longer h.
EVEN_SPACING = 6.0
ANY_SPACING = 4.0
MAX_ADDED = 4
STRAIGHT = 1e-9  # rad: a smaller turn is a rounding of the job's numbers
LEAST_SPACING_M = 1e-7  # below this a corner is met at rest instead


@dataclass(frozen=True, slots=True, kw_only=True)
class Controls:
    """Control points; row i of the last four columns is of the leg into point i.

    ``turn`` is |t2 - t1| of the unit tangents at the tool, 0 on a straight line; ``added`` is 1
    for a point that is not a vertex.
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
    """Return both in a row."""
    if first is None:
        return second
    return Controls(
        **{n: np.concatenate([getattr(first, n), getattr(second, n)]) for n in _COLUMNS}
    )


def turns(positions: FloatArray, radius_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the (n - 1,) lengths of the chords and the (n,) turns at the vertices.

    The turn of the first and the last vertex is 0.
    """
    chord = np.diff(positions, axis=0) * radius_m
    length = np.sqrt((chord**2).sum(axis=1))
    tangent = chord / length[:, None]
    turn = np.zeros(len(positions))
    turn[1:-1] = np.sqrt((np.diff(tangent, axis=0) ** 2).sum(axis=1))
    turn[turn <= STRAIGHT] = 0.0
    return length, turn


def spacings(length_m: FloatArray, turn: FloatArray, cut_m: float) -> FloatArray:
    """Return the (n,) largest distance from each vertex to its neighbouring control points.

    ``cut_m`` is the largest distance at the tool between the spline and the vertex, and between
    the spline and the chords. Where both chords are long the points stand evenly on both sides.
    """
    with np.errstate(divide="ignore"):
        unit = np.where(turn > 0, cut_m / turn, np.inf)
    shorter = np.minimum(np.append(length_m, 0.0), np.insert(length_m, 0, 0.0))
    even = shorter > MAX_ADDED * EVEN_SPACING * unit
    return np.asarray(unit * np.where(even, EVEN_SPACING, ANY_SPACING))


def control_polygon(
    vertices: Vertices, length_m: FloatArray, turn: FloatArray, spacing_m: FloatArray
) -> Controls:
    """Return the control points of the chords between ``vertices``, the first vertex left out.

    Parameters
    ----------
    vertices
        n of one run.
    length_m, turn, spacing_m
        (n - 1,), (n,) and (n,), as ``turns`` and ``spacings`` give them for the whole run.
    """
    fraction, owner, added = _insert(length_m, spacing_m)
    begin = vertices.positions[owner]
    end = vertices.positions[owner + 1]
    # The end is written out so that a vertex is met bit for bit.
    positions = np.where(added[:, None] == 1, begin + fraction[:, None] * (end - begin), end)
    before = np.where(np.diff(owner, prepend=-1) == 0, np.roll(fraction, 1), 0.0)
    share = fraction - before
    return Controls(
        positions=positions,
        turn=np.where(added == 1, 0.0, turn[owner + 1]),
        added=added,
        length_m=share * length_m[owner],
        nominal_s=share * vertices.nominal_s[owner + 1],
        operation=vertices.operation[owner + 1],
        line=vertices.line[owner + 1],
    )


@njit(cache=True)
def _insert(length: FloatArray, spacing: FloatArray) -> tuple[FloatArray, IntArray, IntArray]:
    chords = len(length)
    fraction = np.empty(chords * (MAX_ADDED + 1))
    owner = np.empty(chords * (MAX_ADDED + 1), dtype=np.int64)
    added = np.zeros(chords * (MAX_ADDED + 1), dtype=np.int64)
    n = 0
    for c in range(chords):
        whole, near, far = length[c], spacing[c], spacing[c + 1]
        first = n
        equal = np.ceil(whole / min(near, far))
        if equal <= MAX_ADDED:
            for k in range(1, int(equal)):
                fraction[n] = k / equal
                n += 1
        else:
            begins, ends = near < whole, far < whole
            most = 0.25 if begins and ends else 1.0 / 3.0
            after = min(near / whole, most) if begins else 0.0
            if begins:
                fraction[n] = after
                fraction[n + 1] = 2.0 * after
                n += 2
            if ends:
                back = min(far / whole, most)
                if 1.0 - 2.0 * back > 2.0 * after * (1.0 + 1e-9):
                    fraction[n] = 1.0 - 2.0 * back
                    n += 1
                fraction[n] = 1.0 - back
                n += 1
        added[first:n] = 1
        fraction[n] = 1.0
        n += 1
        owner[first:n] = c
    return fraction[:n], owner[:n], added[:n]
