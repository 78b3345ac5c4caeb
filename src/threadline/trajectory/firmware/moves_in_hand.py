"""Moves that a firmware has in hand: taken in piece by piece, and let go once they are settled."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from threadline.arrays import FloatArray, IntArray
from threadline.path.types import PieceBlock
from threadline.trajectory.firmware.firmware_moves import standing
from threadline.trajectory.firmware.rules import Rules
from threadline.trajectory.types import TrajectoryBlock

AT_ONCE = 16_384  # moves in hand before some are planned; more where fewer are not settled

Taken = tuple[FloatArray, FloatArray, FloatArray, IntArray]
"""Of n moves: (n, axes) starts, (n, axes) ways, (n,) times at the feed and (n,) operations."""


@dataclass(slots=True)
class MovesInHand(ABC):
    """The moves since the last rest whose speeds may still change.

    Attributes
    ----------
    begin_s
        When the first of them begins.
    begun
        Whether it goes on from one that is out.
    """

    rules: Rules
    begin_s: float = 0.0
    start: list[FloatArray] = field(default_factory=list)
    way: list[FloatArray] = field(default_factory=list)
    nominal_s: list[FloatArray] = field(default_factory=list)
    operation: list[IntArray] = field(default_factory=list)
    waiting: int = 0
    begun: bool = False

    def extend(self, block: PieceBlock, rows: slice, *, ends: bool) -> Iterator[TrajectoryBlock]:
        """Take in moves and yield what they settle; all, and the dwell, where the run ends."""
        start, way = block.coefficients[rows, 0], block.coefficients[rows, 1]
        moves = way.any(axis=1)
        nominal_s, operation = block.nominal_s[rows][moves], block.operation[rows][moves]
        taken = self._made((start[moves], way[moves], nominal_s, operation), ends)
        self.start.append(taken[0])
        self.way.append(taken[1])
        self.nominal_s.append(taken[2])
        self.operation.append(taken[3])
        self.waiting += len(taken[0])
        if self.waiting and (ends or self.waiting >= AT_ONCE):
            self._join()
            yield from self._settle(ends)
        if not ends:
            return
        dwell = float(block.dwell_s[rows][-1])
        if dwell > 0.0:
            yield standing(self.begin_s, start[-1] + way[-1], dwell, block.operation[rows][-1:])
            self.begin_s += dwell
        self._keep(self.waiting)
        self.begun = False
        self._rest()

    def _made(self, taken: Taken, ends: bool) -> Taken:  # noqa: ARG002 - Marlin's moves may wait
        """Return the moves that are made of those taken; ``ends`` where the machine rests then."""
        return taken

    @abstractmethod
    def _settle(self, ends: bool) -> Iterator[TrajectoryBlock]:
        """Yield the moves that are settled, each list in hand being of one array, and drop them."""

    @abstractmethod
    def _rest(self) -> None:
        """Forget what the first move in hand goes on from."""

    def _timed(
        self, time_s: FloatArray, coefficients: FloatArray, operation: IntArray
    ) -> TrajectoryBlock:
        """Return (n, k) parts of n moves, one behind the other, those without duration left out."""
        count, parts = time_s.shape
        lasts = time_s.reshape(-1) > 0.0
        duration = time_s.reshape(-1)[lasts]
        begin = self.begin_s + np.concatenate(([0.0], np.cumsum(duration)))
        self.begin_s = float(begin[-1])
        return TrajectoryBlock(
            start_s=begin[:-1],
            duration_s=duration,
            coefficients=coefficients.reshape(parts * count, *coefficients.shape[2:])[lasts],
            operation=np.repeat(operation, parts)[lasts],
        )

    def _join(self) -> None:
        for kept in (self.start, self.way, self.nominal_s):
            kept[:] = [np.concatenate(kept)]
        self.operation[:] = [np.concatenate(self.operation)]

    def _keep(self, done: int) -> None:
        """Let go of the moves that are out."""
        self._join()
        for kept in (self.start, self.way, self.nominal_s):
            kept[:] = [kept[0][done:]]
        self.operation[:] = [self.operation[0][done:]]
        self.waiting -= done
