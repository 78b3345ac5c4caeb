"""Where an axis of the programmed path turns back, found as the path streams by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.compiled import njit
from threadline.verdict.window import PathWindow


@dataclass(frozen=True, slots=True)
class Turning:
    """A value at which an axis turns back, or the end of the path.

    Parameters
    ----------
    value
        Length at the tool.
    direction
        +1 where it is a highest value, -1 where it is a lowest one, 0 if the axis never moved.
    operation, line, position
        Of the first vertex there; the position in the units of the axes.
    leaves
        Number of the chord that leaves it: the axis may stand there for many chords before.
    """

    value: float
    direction: int
    operation: int
    line: int
    position: tuple[float, ...]
    leaves: int


def _scan(
    vertices: FloatArray,
    column: int,
    smallest: float,
    direction: int,
    at: int,
    extreme: FloatArray,
    found_at: IntArray,
    found_leaves: IntArray,
) -> tuple[int, int, int]:
    """Run the hysteresis over ``vertices``; return direction, index of the extreme, and count.

    ``at`` is the vertex of the running extreme, -1 while it is that of an earlier call, whose
    (axes,) position ``extreme`` holds.
    """
    count = 0
    value = extreme[column]
    for i in range(len(vertices)):
        rise = vertices[i, column] - value
        if direction == 0:
            if abs(rise) > smallest:
                direction, value, at = (1 if rise > 0 else -1), vertices[i, column], i
        elif direction * rise > 0:
            value, at = vertices[i, column], i
        elif direction * rise < -smallest:
            found_at[count], found_leaves[count] = at, i
            count += 1
            direction, value, at = -direction, vertices[i, column], i
    return direction, at, count


_scan_fast = njit(nogil=True)(_scan)


class ReversalScan:
    """Finds the turnings of one axis; moves back by no more than ``smallest`` do not count.

    Ignoring such a wiggle can hide an error of its own size at most.
    """

    def __init__(self, column: int, smallest: float, radius_m: FloatArray) -> None:
        self._column = column
        self._smallest = smallest
        self._radius_m = radius_m
        self._seen = -1  # number of the next vertex, -1 before the first
        self.direction = 0  # 0 until the axis has moved
        self._extreme: FloatArray = np.zeros(len(radius_m))
        self._operation = self._line = 0

    def scan(self, path: PathWindow) -> list[Turning]:
        """Return the turnings that the vertices read since the last call confirm."""
        if self._seen < 0:
            self._seen = path.first
            self._keep(path, 0)
        begin = max(self._seen - path.first, 0)
        self._seen = path.first + len(path)
        vertices = path.vertices[begin:]
        if not len(vertices):
            return []
        first_direction = self.direction
        where = np.empty(len(vertices), dtype=np.int64)
        leaves = np.empty(len(vertices), dtype=np.int64)
        self.direction, at, count = _scan_fast(
            vertices,
            self._column,
            self._smallest,
            self.direction,
            -1,
            self._extreme,
            where,
            leaves,
        )
        found = []
        # Only the first one can be at an extreme of an earlier call. Before the first, the axis
        # may have begun to move, so its direction is counted back from the last one.
        direction = first_direction or (self.direction if count % 2 == 0 else -self.direction)
        for index, leaving in zip(where[:count], leaves[:count], strict=True):
            if index >= 0:
                self._keep(path, begin + int(index))
            found.append(self._turning(direction, path.first + begin + int(leaving)))
            direction = -direction
        if at >= 0:
            self._keep(path, begin + int(at))
        return found

    def end(self) -> Turning:
        """Return the end of what was scanned, which counts as a turning."""
        return self._turning(self.direction, self._seen)

    def _turning(self, direction: int, leaves: int) -> Turning:
        return Turning(
            value=float(self._extreme[self._column]),
            direction=direction,
            operation=self._operation,
            line=self._line,
            position=tuple((self._extreme / self._radius_m).tolist()),
            leaves=leaves,
        )

    def _keep(self, path: PathWindow, index: int) -> None:
        self._extreme = path.vertices[index].copy()
        self._operation = int(path.operation[index])
        self._line = int(path.line[index])
