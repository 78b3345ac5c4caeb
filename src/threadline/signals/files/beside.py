"""What stands beside the rows of a seam's table: the needle, and the thread."""

from __future__ import annotations

import dataclasses
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray, IntArray
from threadline.signals.commands import TickBlock

NEEDLE_COLUMNS = ("needle_down [s]", "needle_up", "trim")
"""Columns of text: time from the tick to needle-down, whether the needle must be up, trim."""


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NeedleRows:
    """The needle beside the rows of a block.

    Parameters
    ----------
    row
        (k,) rows in which the needle goes down, in order; one may be named twice.
    after_s
        (k,) how long after its tick.
    up
        (rows,) whether the needle must be up.
    trim
        (rows,) whether the thread is trimmed.
    """

    row: IntArray
    after_s: FloatArray
    up: NDArray[np.bool_]
    trim: NDArray[np.bool_]

    def changes(self) -> IntArray:
        """Return the rows at which ``up`` or ``trim`` are not what they were in the row before."""
        changed = (self.up[1:] != self.up[:-1]) | (self.trim[1:] != self.trim[:-1])
        return np.flatnonzero(changed) + 1

    def cells(self, begin: int, end: int, period_s: float) -> str:
        """Return the cells of rows that are one line of text, joined by commas.

        Parameters
        ----------
        begin, end
            Rows, in all of which ``up`` and ``trim`` are the same.
        period_s
            Of a row; a needle-down is told by its time after the first one.
        """
        first, last = np.searchsorted(self.row, (begin, end))
        times_s = self.after_s[first:last] + (self.row[first:last] - begin) * period_s
        down = " ".join(f"{time_s:.9f}" for time_s in times_s.tolist())
        return f"{down},{int(self.up[begin])},{int(self.trim[begin])}"


class Beside(Protocol):
    """Tells the needle beside every row."""

    def rows(self, block: TickBlock) -> NeedleRows:
        """Return what stands beside the rows of the next block."""
        ...
