"""The moves that LinuxCNC makes of a program: arcs as such, and short moves joined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.trajectory.firmware.bows import circle, ends_of_bows, rows_of
from threadline.trajectory.firmware.corner_choice import ACROSS
from threadline.trajectory.firmware.joined_moves import joined
from threadline.trajectory.firmware.junctions import along_axes
from threadline.trajectory.firmware.rules import LINEAR, Rules

Bow = tuple[float, FloatArray, FloatArray, float]
"""Radius, first direction, direction to the centre and angle of an arc."""


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """Lines and arcs, in mm and degrees.

    Parameters
    ----------
    start
        (n, axes) where each begins.
    way
        (n, axes) to its end.
    along, inward, onward
        (n, axes) its first direction over its length; of an arc the direction to its centre; its
        last direction.
    bow, length
        (n,) radius of an arc, 0 of a line; length.
    nominal_s
        (n,) time at the programmed feed, 0 for a rapid move.
    operation, last
        (n,) operation, and last move in hand.
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
        """Return (n,) speeds that the axes allow, that are asked for, too, and accelerations.

        On an arc both axes of its plane have to be as fast as any, and sqrt(3)/2 of what they
        have of acceleration is for going round.
        """
        direction = self.along
        arcs = self.bow > 0.0
        if arcs.any():
            direction = np.where(arcs[:, None], np.hypot(self.along, self.inward), self.along)
            flat = np.where(direction > 1e-9, 1.0, 0.0)
            direction = np.where(arcs[:, None], flat, self.along)
        fastest = along_axes(rules.velocity, direction)
        rate = along_axes(rules.acceleration, direction)
        fastest = np.where(arcs, np.minimum(fastest, np.sqrt(ACROSS * rate * self.bow)), fastest)
        with np.errstate(divide="ignore"):
            asked = np.where(self.nominal_s > 0.0, self.length / self.nominal_s, np.inf)
        return fastest, np.minimum(asked, fastest), rate


def course(
    rules: Rules, start: FloatArray, way: FloatArray, nominal_s: FloatArray, operation: IntArray,
    line: IntArray, cam_tolerance: float,
) -> Course:  # fmt: skip
    """Return the moves that LinuxCNC makes of n in hand, of (n, axes) mm and degrees.

    Parameters
    ----------
    line
        (n,) line of the file.
    cam_tolerance
        Q of G64, mm; 0 for none.
    """
    linear = np.array([axis in LINEAR for axis in rules.axes])
    alone = (way[:, ~linear] == 0.0).all(axis=1)
    length = rules.moves(way / rules.scale, nominal_s).length
    rows = _Rows(
        start.copy(), way.copy(), length, nominal_s.copy(), operation, np.arange(len(way)), alone
    )
    bows: dict[int, Bow] = {}
    along = np.ascontiguousarray(way[:, linear])
    found = rows_of(ends_of_bows(along, line, alone & (nominal_s > 0.0)))
    if found:
        beside = np.array([axis not in "XY" for axis in rules.axes])
        bows = rows.bend(found, beside, cam_tolerance)
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
    """Columns of moves; what they are is in ``Course``."""

    start: FloatArray
    way: FloatArray
    length: FloatArray
    nominal_s: FloatArray
    operation: IntArray
    last: IntArray
    alone: NDArray[np.bool_]

    def bend(
        self, found: list[tuple[int, int]], beside: NDArray[np.bool_], cam_tolerance: float
    ) -> dict[int, Bow]:
        """Put one row for the chords of every arc; two in X and Y alone, if that is within Q.

        ``beside`` tells the other axes.
        """
        kept = np.ones(len(self.way), np.bool_)
        bows: dict[int, Bow] = {}
        for first, end in found:
            chords = self.way[first : end + 1]
            begin, stop = self.start[first].copy(), self.start[end] + self.way[end]
            bow = circle(np.vstack([self.start[first : end + 1], stop]))
            if bow is None:
                continue
            radius, along, inward, angle = bow
            pace = self.length[first] / self.nominal_s[first]
            kept[first : end + 1] = False
            off = radius * (1.0 - np.cos(0.5 * angle))
            if off < cam_tolerance and not chords[:, beside].any():
                middle = np.sin(0.5 * angle) * along + (1.0 - np.cos(0.5 * angle)) * inward
                middle = begin + radius * middle
                for row, one, other in ((first, begin, middle), (end, middle, stop)):
                    self.start[row], self.way[row], kept[row] = one, other - one, True
                    self.length[row] = np.linalg.norm(other - one)
                    self.nominal_s[row] = self.length[row] / pace
            else:
                kept[first], self.alone[first], self.last[first] = True, False, end
                self.length[first] = radius * angle
                self.nominal_s[first] = self.length[first] / pace
                bows[first] = bow
                self.way[first] = stop - begin
        rows = np.flatnonzero(kept)
        self._take(rows)
        return {int(np.searchsorted(rows, row)): bow for row, bow in bows.items()}

    def join(
        self, linear: NDArray[np.bool_], bows: dict[int, Bow], cam_tolerance: float
    ) -> dict[int, Bow]:
        """Put one row for moves that are joined within Q; return ``bows`` by their new rows."""
        timed = self.nominal_s > 0.0
        feed = np.where(timed, self.length / np.where(timed, self.nominal_s, 1.0), 0.0)
        # In the same order always: each order would have machine code of its own.
        begun, along = (np.ascontiguousarray(of[:, linear]) for of in (self.start, self.way))
        ends = joined(begun, along, feed, self.alone, cam_tolerance)
        last = np.flatnonzero(ends)
        first = np.concatenate(([0], last[:-1] + 1))
        many = np.flatnonzero(last > first)
        stop = self.start[last[many]] + self.way[last[many]]
        way = stop - self.start[first[many]]
        start, pace = self.start[first], feed[last[many]]
        self._take(last)
        self.start = start
        self.way[many] = way
        self.length[many] = np.linalg.norm(way, axis=1)
        self.nominal_s[many] = self.length[many] / pace
        return {int(np.searchsorted(last, row)): bow for row, bow in bows.items()}

    def _take(self, rows: IntArray) -> None:
        self.start, self.way, self.length = self.start[rows], self.way[rows], self.length[rows]
        self.nominal_s, self.operation = self.nominal_s[rows], self.operation[rows]
        self.last, self.alone = self.last[rows], self.alone[rows]
