"""The programmed path about the operations under way: all that the judge holds of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.path.types import ProgrammedPath, VertexBlock


@dataclass(frozen=True, slots=True)
class Remainder:
    """The part of the path that a recording never came to.

    ``distance_m``, (runs,), is that of its farthest vertex from where the machine stands;
    operation and line, (runs,), and position, (runs, axes), are that vertex'; ``end`` is the
    (axes,) end of the path, lengths at the tool.
    """

    distance_m: FloatArray
    operation: IntArray
    line: IntArray
    position: FloatArray
    end: FloatArray


def _farther(known: Remainder, fresh: Remainder) -> Remainder:
    """Return the farther vertex of every run, and the end of what came later."""
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

    Attributes
    ----------
    vertices
        (m, axes) lengths at the tool: rotary axes times their radius.
    operation, line
        (m,) operation that moves to each vertex, and its job line.
    speed_m_s
        (m,) programmed speed of the chord into each vertex, at the tool; NaN where there is none.
    radius_m, local
        Those of the path.
    first
        Number of the first of them since the start of the path.
    ended
        The last vertex of the path is among them.
    """

    def __init__(self, path: ProgrammedPath) -> None:
        self._source: Iterator[VertexBlock] = iter(path)
        self.radius_m = path.radius_m
        self.local = path.local
        self.vertices: FloatArray = np.empty((0, len(path.axes)))
        self.operation: IntArray = np.empty(0, dtype=np.int64)
        self.line: IntArray = np.empty(0, dtype=np.int64)
        self.speed_m_s: FloatArray = np.empty(0)
        self.first = 0
        self.ended = False
        self._remainder: Remainder | None = None

    def __len__(self) -> int:
        return len(self.operation)

    @property
    def shares(self) -> FloatArray | None:
        """(m, axes) what a length at each vertex is of one at the largest radii; None: the same."""
        return None if self.local is None else self.local.shares(self.vertices / self.radius_m)

    def reach(self, latest: int) -> None:
        """Read on until every chord of the operation ``latest`` and the one after are held."""
        while not self.ended and (not len(self) or self.operation[-1] <= latest):
            self._extend()

    def drop(self, chord: int) -> None:
        """Let go of the vertices before ``chord``, counted from the start of the path."""
        surplus = min(chord - 1 - self.first, len(self) - 2)
        if surplus > 0:
            self.vertices = self.vertices[surplus:]
            self.operation = self.operation[surplus:]
            self.line = self.line[surplus:]
            self.speed_m_s = self.speed_m_s[surplus:]
            self.first += surplus

    def chords(self, operation: IntArray) -> tuple[IntArray, IntArray]:
        """Return (n,) first and last chord of each operation; chord c ends at vertex c.

        An operation without motion (a dwell, an output) has the chord that led to where it is.
        """
        left = np.searchsorted(self.operation, operation, side="left")
        last = np.searchsorted(self.operation, operation, side="right") - 1
        most = max(len(self) - 1, 1)
        # Where the operation has no vertex, its predecessor's chord is where the machine stands.
        first = np.minimum(np.maximum(np.minimum(left, last), 1), most)
        return first, np.minimum(np.maximum(last, 1), most)

    def remainder(self, point: FloatArray) -> Remainder | None:
        """Return what of the path lies after the window; reads it to its end, once.

        Parameters
        ----------
        point
            (axes, runs) where the machine stands, lengths at the tool; NaN of an axis that was not
            recorded, which then counts for nothing.
        """
        if self.ended:
            return self._remainder
        worst: Remainder | None = None
        for block in self._source:
            vertices = block.positions * self.radius_m
            away = np.nansum((vertices[:, :, None] - point) ** 2, axis=1)
            far, runs = np.argmax(away, axis=0), np.arange(point.shape[1])
            found = Remainder(
                np.sqrt(away[far, runs]),
                block.operation[far],
                block.line[far],
                block.positions[far],
                vertices[-1],
            )
            worst = found if worst is None else _farther(worst, found)
        self.ended = True
        self._remainder = worst
        return worst

    def _extend(self) -> None:
        block = next(self._source, None)
        if block is None:
            self.ended = True
            if self.first + len(self) == 1:  # a job without motion: a chord from start to start
                self.vertices = np.repeat(self.vertices, 2, axis=0)
                self.operation = np.repeat(self.operation, 2)
                self.line = np.repeat(self.line, 2)
                self.speed_m_s = np.repeat(self.speed_m_s, 2)
            return
        if not len(block):
            return
        vertices = block.positions * self.radius_m
        before = self.vertices[-1:] if len(self) else vertices[:1]
        length = np.linalg.norm(np.diff(vertices, axis=0, prepend=before), axis=1)
        timed = block.nominal_s > 0
        speed = np.where(timed, length / np.where(timed, block.nominal_s, 1.0), np.nan)
        self.speed_m_s = np.concatenate([self.speed_m_s, speed])
        self.vertices = np.concatenate([self.vertices, vertices])
        self.operation = np.concatenate([self.operation, block.operation])
        self.line = np.concatenate([self.line, block.line])
