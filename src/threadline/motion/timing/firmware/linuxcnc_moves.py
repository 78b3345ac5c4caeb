"""Moves as LinuxCNC sees them: arcs recovered from chords, and short lines joined.

The chords of one G2 or G3 block have its line number, are consecutive, equally long and turn by
equal angles, and their arc is at most 2 um away from them. LinuxCNC runs such an arc as one move.
As the ends of arcs are rounded in programs, the radius may change a little along the way.

With Q of G64 (default P) a move of X, Y and Z only is joined with its predecessors if all of their
end points are within Q of the straight line from the start of the first move to the end of this
move (LinuxCNC 2.9, documents, "G64 Path Blending"; ``emccanon.cc``). At most 101 moves become one.
"""
# mypy: disable-error-code="no-untyped-def,untyped-decorator"

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.motion.timing.firmware.linuxcnc_corners import ACROSS
from threadline.motion.timing.firmware.rules import LINEAR, Rules, along_axes

_ALIKE = 2e-3  # share of a chord by which equal chords may differ
_OFF_MM = 2e-3
_SAG_MM = 2.001e-3  # the reader's own 2 um


@njit()
def ends_of_bows(way, line, xyz_only):
    """Return the (n,) first move of the arc or line that each of n moves belongs to.

    Parameters
    ----------
    way : (n, axes)
        Displacements of the moves, mm.
    line : (n,)
        Line of the file.
    alone : (n,) bool
        Whether only X, Y and Z move.
    """
    count = len(way)
    first_moves = np.arange(count)
    first, first_length, cosine = 0, 0.0, 1.0
    for i in range(1, count):
        length, length_before, dot, difference = 0.0, 0.0, 0.0, 0.0
        for k in range(way.shape[1]):
            length += way[i, k] ** 2
            length_before += way[i - 1, k] ** 2
            dot += way[i, k] * way[i - 1, k]
        length, length_before = np.sqrt(length), np.sqrt(length_before)
        continues = line[i] == line[i - 1] and xyz_only[i] and xyz_only[i - 1] and dot > 0.0
        if not continues:
            first = first_moves[i] = i
            continue
        if i - first == 1:
            first_length, cosine = (
                length_before,
                min(1.0, max(-1.0, dot / (length * length_before))),
            )
        else:
            for k in range(way.shape[1]):
                difference = max(
                    difference, abs(way[i, k] - 2.0 * cosine * way[i - 1, k] + way[i - 2, k])
                )
        # The arc of a chord c with the angle h is c tan(h / 4) / 2 away from it.
        sag = 0.5 * length * np.tan(0.25 * np.arccos(cosine))
        continues = (
            0.0 < sag < _SAG_MM and max(abs(length - first_length), difference) <= _ALIKE * length
        )
        if not continues:
            first = i
        first_moves[i] = first
    return first_moves


def circle(points: FloatArray) -> tuple[float, FloatArray, FloatArray, float] | None:
    """Return radius, first direction, direction to the centre and angle of an arc; None for none.

    Parameters
    ----------
    points
        (k, axes) end points of equal chords, k > 2; mm.
    """
    count = len(points) - 1
    a, b, c = points[0], points[max(1, count // 3)], points[max(2, 2 * count // 3)]
    u, v = b - a, c - a
    uu, vv, uv = u @ u, v @ v, u @ v
    divisor = 2.0 * (uu * vv - uv**2)
    centre = (vv * (uu - uv) * u + uu * (vv - uv) * v) / divisor
    radius = float(np.sqrt(centre @ centre))
    inward = centre / radius
    along = u - (u @ inward) * inward
    along /= np.sqrt(along @ along)
    from_centre = points - a - centre
    if np.abs(np.sqrt((from_centre**2).sum(axis=1)) - radius).max() > _OFF_MM:
        return None
    end_from_centre = from_centre[-1]
    angle = np.arctan2(end_from_centre @ along, -(end_from_centre @ inward)) % (2.0 * np.pi)
    chord = points[1] - a
    chord_angle = 2.0 * np.arcsin(min(1.0, float(np.sqrt(chord @ chord)) / (2.0 * radius)))
    turns = np.round((chord_angle * count - angle) / (2.0 * np.pi))
    # The curve ends where the last chord does: its radius changes a little.
    return radius, along, inward, float(angle + 2.0 * np.pi * turns)


def rows_of(first: IntArray) -> list[tuple[int, int]]:
    """Return first and last move of each run of two or more with the same ``first``."""
    begins = np.flatnonzero(first == np.arange(len(first)))
    stops = np.append(begins[1:], len(first)) - 1
    return [(int(a), int(b)) for a, b in zip(begins, stops, strict=True) if b > a]


_MOST = 101
_SAME = 1e-9  # share of a feed


@njit()
def joined(start, way, feed, xyz_only, tolerance):
    """Return for n moves whether each ends a joined move, (n,) 1 or 0.

    Parameters
    ----------
    start, way : (n, axes)
        Starts and displacements of the moves, mm.
    feed : (n,)
        Speed that F asks for; 0 for a rapid move.
    alone : (n,) bool
        Whether only X, Y and Z move.
    tolerance : float
        Q.
    """
    count, axes = way.shape
    is_end = np.ones(count, np.int64)
    first = 0
    for i in range(1, count):
        may_join = i - first < _MOST and xyz_only[i] and xyz_only[first] and feed[i] > 0.0
        may_join = may_join and abs(feed[i] - feed[first]) <= _SAME * feed[first]
        if may_join:
            chord2 = 0.0
            for k in range(axes):
                chord2 += (start[i, k] + way[i, k] - start[first, k]) ** 2
            may_join = chord2 > 0.0
        j = first
        while may_join and j < i:
            chord_share, distance2 = 0.0, 0.0
            for k in range(axes):
                chord_part = start[i, k] + way[i, k] - start[first, k]
                chord_share += chord_part * (start[j, k] + way[j, k] - start[first, k])
            chord_share = min(1.0, max(0.0, chord_share / chord2))
            for k in range(axes):
                chord_part = start[i, k] + way[i, k] - start[first, k]
                distance2 += (
                    start[j, k] + way[j, k] - start[first, k] - chord_share * chord_part
                ) ** 2
            may_join = distance2 <= tolerance * tolerance
            j += 1
        if may_join:
            is_end[i - 1] = 0
        else:
            first = i
    return is_end


Bow = tuple[float, FloatArray, FloatArray, float]
"""Radius, first direction, direction to the centre and angle of an arc."""


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Lines and arcs, in mm and degrees.

    Parameters
    ----------
    start
        (n, axes) start of each move.
    way
        (n, axes) vector from start to end.
    along, inward, onward
        (n, axes) first direction over the length; for an arc the direction to the centre; last
        direction.
    bow, length
        (n,) radius of an arc, 0 for a line; length.
    nominal_s
        (n,) time at the programmed feed, 0 for a rapid move.
    operation, last
        (n,) operation, and index of the last buffered move in it.
    """

    start: FloatArray
    way: FloatArray
    along: FloatArray
    inward: FloatArray
    onward: FloatArray
    bow: FloatArray
    length: FloatArray
    nominal_s: FloatArray
    operation: IntArray
    last: IntArray

    def __len__(self) -> int:
        return len(self.length)

    def limits(self, rules: Rules) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (n,) speed limits of the axes, limits including the feed, and accelerations.

        On an arc both axes of its plane must reach every speed, and sqrt(3)/2 of their acceleration
        is reserved for the centripetal part.
        """
        direction = self.along
        arcs = self.bow > 0.0
        if arcs.any():
            direction = np.where(arcs[:, None], np.hypot(self.along, self.inward), self.along)
            in_plane = np.where(direction > 1e-9, 1.0, 0.0)
            direction = np.where(arcs[:, None], in_plane, self.along)
        fastest = along_axes(rules.velocity, direction)
        rate = along_axes(rules.acceleration, direction)
        fastest = np.where(arcs, np.minimum(fastest, np.sqrt(ACROSS * rate * self.bow)), fastest)
        with np.errstate(divide="ignore"):
            programmed = np.where(self.nominal_s > 0.0, self.length / self.nominal_s, np.inf)
        return fastest, np.minimum(programmed, fastest), rate


def course(
    rules: Rules, start: FloatArray, way: FloatArray, nominal_s: FloatArray, operation: IntArray,
    line: IntArray, cam_tolerance: float,
) -> Course:  # fmt: skip
    """Return the moves that LinuxCNC makes from n buffered moves, (n, axes) mm and degrees.

    Parameters
    ----------
    line
        (n,) line of the file.
    cam_tolerance
        Q of G64, mm; 0 for none.
    """
    linear = np.array([axis in LINEAR for axis in rules.axes])
    xyz_only = (way[:, ~linear] == 0.0).all(axis=1)
    length = rules.moves(way / rules.scale, nominal_s).length
    rows = _Rows(
        start.copy(), way.copy(), length, nominal_s.copy(), operation, np.arange(len(way)), xyz_only
    )
    bows: dict[int, Bow] = {}
    along = np.ascontiguousarray(way[:, linear])
    bow_rows = rows_of(ends_of_bows(along, line, xyz_only & (nominal_s > 0.0)))
    if bow_rows:
        beside = np.array([axis not in "XY" for axis in rules.axes])
        bows = rows.bend(bow_rows, beside, cam_tolerance)
    if cam_tolerance > 0.0:
        bows = rows.join(linear, bows, cam_tolerance)
    start, way, length, nominal_s = rows.start, rows.way, rows.length, rows.nominal_s
    along = way / length[:, None]
    inward, onward, bow = np.zeros_like(along), along.copy(), np.zeros(len(way))
    for row, (radius, first, centre, angle) in bows.items():
        along[row], inward[row], bow[row] = first, centre, radius
        onward[row] = np.cos(angle) * first + np.sin(angle) * centre
    return Course(
        start, way, along, inward, onward, bow, length, nominal_s, rows.operation,
        rows.last,
    )  # fmt: skip


@dataclass(slots=True, eq=False)
class _Rows:
    """Columns of moves, as in ``Course``."""

    start: FloatArray
    way: FloatArray
    length: FloatArray
    nominal_s: FloatArray
    operation: IntArray
    last: IntArray
    xyz_only: NDArray[np.bool_]

    def bend(
        self, found: list[tuple[int, int]], beside: NDArray[np.bool_], cam_tolerance: float
    ) -> dict[int, Bow]:
        """Replace the chords of every arc by one row; an arc in X and Y within Q by two lines.

        ``beside`` marks the other axes.
        """
        is_kept = np.ones(len(self.way), np.bool_)
        bows: dict[int, Bow] = {}
        for first, end in found:
            chords = self.way[first : end + 1]
            begin, stop = self.start[first].copy(), self.start[end] + self.way[end]
            bow = circle(np.vstack([self.start[first : end + 1], stop]))
            if bow is None:
                continue
            radius, along, inward, angle = bow
            pace = self.length[first] / self.nominal_s[first]
            is_kept[first : end + 1] = False
            deviation_mm = radius * (1.0 - np.cos(0.5 * angle))
            if deviation_mm < cam_tolerance and not chords[:, beside].any():
                middle = np.sin(0.5 * angle) * along + (1.0 - np.cos(0.5 * angle)) * inward
                middle = begin + radius * middle
                for row, line_start, line_end in ((first, begin, middle), (end, middle, stop)):
                    self.start[row], self.way[row], is_kept[row] = (
                        line_start,
                        line_end - line_start,
                        True,
                    )
                    self.length[row] = np.linalg.norm(line_end - line_start)
                    self.nominal_s[row] = self.length[row] / pace
            else:
                is_kept[first], self.xyz_only[first], self.last[first] = True, False, end
                self.length[first] = radius * angle
                self.nominal_s[first] = self.length[first] / pace
                bows[first] = bow
                self.way[first] = stop - begin
        rows = np.flatnonzero(is_kept)
        self._take(rows)
        return {int(np.searchsorted(rows, row)): bow for row, bow in bows.items()}

    def join(
        self, linear: NDArray[np.bool_], bows: dict[int, Bow], cam_tolerance: float
    ) -> dict[int, Bow]:
        """Replace moves that are joined within Q by one row; return ``bows`` by their new rows."""
        timed = self.nominal_s > 0.0
        feed = np.where(timed, self.length / np.where(timed, self.nominal_s, 1.0), 0.0)
        # Always in the same memory order: numba compiles a version for each order.
        starts, along = (np.ascontiguousarray(of[:, linear]) for of in (self.start, self.way))
        ends = joined(starts, along, feed, self.xyz_only, cam_tolerance)
        last = np.flatnonzero(ends)
        first = np.concatenate(([0], last[:-1] + 1))
        joined_rows = np.flatnonzero(last > first)
        stop = self.start[last[joined_rows]] + self.way[last[joined_rows]]
        way = stop - self.start[first[joined_rows]]
        start, pace = self.start[first], feed[last[joined_rows]]
        self._take(last)
        self.start = start
        self.way[joined_rows] = way
        self.length[joined_rows] = np.linalg.norm(way, axis=1)
        self.nominal_s[joined_rows] = self.length[joined_rows] / pace
        return {int(np.searchsorted(last, row)): bow for row, bow in bows.items()}

    def _take(self, rows: IntArray) -> None:
        self.start, self.way, self.length = self.start[rows], self.way[rows], self.length[rows]
        self.nominal_s, self.operation = self.nominal_s[rows], self.operation[rows]
        self.last, self.xyz_only = self.last[rows], self.xyz_only[rows]
