"""Reading a trajectory at rising times, in bounded memory."""

from __future__ import annotations

import numpy as np

from threadline.arrays import FloatArray
from threadline.trajectory.types import Trajectory, TrajectoryBlock


class TrajectoryReader:
    """Reads position and derivatives of a trajectory at times that ``drop`` has not let go of.

    The trajectory is held at its first and last position before and after.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self._source = iter(trajectory)
        self._axes = len(trajectory.axes)
        self._blocks: list[TrajectoryBlock] = []
        self._ended = False

    def ladder(self, time_s: FloatArray, orders: int) -> FloatArray:
        """Return the (n, orders, axes) position and derivatives at (n,) rising times."""
        found = np.zeros((len(time_s), orders, self._axes))
        if not len(time_s):
            return found
        self._reach(float(time_s[-1]))
        if not self._blocks:
            return found
        edges = np.searchsorted(time_s, [block.end_s for block in self._blocks], side="right")
        edges[-1] = len(time_s)
        begin = 0
        for block, end in zip(self._blocks, edges.tolist(), strict=True):
            if end > begin:
                part = slice(begin, end)
                for order in range(orders):
                    found[part, order] = block.evaluate(time_s[part], order)
                begin = end
        outside = (time_s < self._blocks[0].start_s[0]) | (time_s > self._blocks[-1].end_s)
        found[outside, 1:] = 0.0
        return found

    def drop(self, before_s: float) -> None:
        """Let go of what ends before an instant, but for the last block that is known."""
        while len(self._blocks) > 1 and self._blocks[0].end_s < before_s:
            self._blocks.pop(0)

    def _reach(self, time_s: float) -> None:
        while not self._ended and (not self._blocks or self._blocks[-1].end_s < time_s):
            block = next(self._source, None)
            if block is None:
                self._ended = True
            elif len(block):
                self._blocks.append(block)
