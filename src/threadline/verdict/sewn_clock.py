"""When a needle goes down that is geared with rows which may be held: plan's time and clock's."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.verdict.samples import Block


class SewnClock:
    """Turns times of the plan into those of a recording, and back, between samples in hand.

    Until a run is held the two are one, and nothing is changed by a bit.
    """

    def __init__(self) -> None:
        self._held = False
        self._time_s: FloatArray = np.empty(0)
        self._due_s: FloatArray = np.empty(0)
        self._slow_s: FloatArray = np.empty(0)  # samples on the way to which it was held

    def take(self, block: Block, kept: IntArray) -> None:
        """Take the samples ``kept`` of a block."""
        self._time_s = np.concatenate([self._time_s, block.time_s[kept]])
        self._due_s = np.concatenate([self._due_s, block.due_s[kept]])
        if block.slow is not None:
            self._held = True
            self._slow_s = np.concatenate([self._slow_s, block.time_s[block.slow]])

    def drop(self, before_s: float, slow_before_s: float) -> None:
        """Let go of samples before an instant, but for two, and of what is slow before another."""
        first = max(int(np.searchsorted(self._time_s, before_s, side="right")) - 2, 0)
        self._time_s, self._due_s = self._time_s[first:], self._due_s[first:]
        self._slow_s = self._slow_s[np.searchsorted(self._slow_s, slow_before_s) :]

    def when(self, due_s: FloatArray) -> FloatArray:
        """Return (n,) first instants at which the plan was at rising times; infinite if not yet."""
        if not self._held or not len(due_s):
            return due_s
        after = np.searchsorted(self._due_s, due_s, side="left")
        last = len(self._due_s) - 1
        before, at = np.clip(after - 1, 0, last), np.clip(after, 0, last)
        long_s = self._due_s[at] - self._due_s[before]
        part = np.where(long_s > 0.0, due_s - self._due_s[before], 0.0) / np.where(
            long_s > 0.0, long_s, 1.0
        )
        found = self._time_s[before] + part * (self._time_s[at] - self._time_s[before])
        early = due_s - self._due_s[0] + self._time_s[0]  # before the samples in hand
        return np.where(after > last, np.inf, np.where(after == 0, early, found))

    def due(self, time_s: FloatArray) -> FloatArray:
        """Return (n,) times of the plan at rising instants."""
        if not self._held:
            return time_s
        return np.asarray(np.interp(time_s, self._time_s, self._due_s))

    def slowed(self, begin_s: FloatArray, end_s: FloatArray) -> NDArray[np.bool_]:
        """Return (n,) whether a run was held, or came to its speed, between instants."""
        first = np.searchsorted(self._slow_s, begin_s, side="right")
        return np.asarray(np.searchsorted(self._slow_s, end_s, side="right") > first)
