"""What the valves of a cylinder make of a command: each opens and closes in its own time."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from threadline.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Valves:
    """The flow controls of one sense.

    Parameters
    ----------
    flows
        What each adds to the level, together 1.
    opens, closes
        From a command to the flow that follows it, in scans; what is common to both need not be in.
    """

    flows: tuple[float, ...]
    opens: float = 0.0
    closes: float = 0.0

    @property
    def longer(self) -> float:
        """By how many scans each stretch of flow is longer than its command."""
        return self.closes - self.opens

    @property
    def at_once(self) -> bool:
        """Whether the flow follows each command at once."""
        return self.opens == self.closes == 0.0

    def switchings(
        self, ticks: tuple[int, ...], levels: tuple[float, ...]
    ) -> tuple[FloatArray, FloatArray]:
        """Return when the level changes, in scans, and by how much, each flow control by itself.

        Parameters
        ----------
        ticks, levels
            Level from each scan on, the last 0.
        """
        if self.at_once:
            return np.asarray(ticks, dtype=np.float64), np.diff(levels, prepend=0.0)
        opened = np.array([self._opened(level) for level in levels], dtype=np.float64)
        changes = np.diff(opened, axis=0, prepend=np.zeros((1, len(self.flows))))
        row, flow = np.nonzero(changes)
        height = changes[row, flow] * np.asarray(self.flows)[flow]
        late = np.where(height > 0.0, self.opens, self.closes)
        return np.asarray(ticks, dtype=np.float64)[row] + late, height

    def _opened(self, level: float) -> tuple[bool, ...]:
        """Return which of them are open for a level: the set that comes closest, the smaller."""
        places = range(len(self.flows))
        sets = [
            chosen for size in range(len(self.flows) + 1) for chosen in combinations(places, size)
        ]
        best = min(sets, key=lambda chosen: abs(sum(self.flows[i] for i in chosen) - level))
        return tuple(i in best for i in places)

    def covered(self, ticks: tuple[int, ...], levels: tuple[float, ...]) -> float:
        """Return the distance of a command, in scans of level 1."""
        at, height = self.switchings(ticks, levels)
        return float(-np.dot(at, height))
