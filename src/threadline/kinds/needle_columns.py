"""Columns of a seam's table beside its rows: needle-down instants, needle to be up, trims."""

from __future__ import annotations

from math import ceil

import numpy as np
from numpy.typing import NDArray

from threadline.arrays import FloatArray
from threadline.plan import Plan
from threadline.signals import Clock, TickBlock
from threadline.signals.files.beside import NeedleRows
from threadline.verdict.needle import planned_stitches

_SLACK = 1e-6  # ticks: a needle-down at most this long before a tick counts as at the tick


class NeedleColumns:
    """Tells the needle beside the rows of a seam's table, block by block.

    The needle goes down at the end of every stitch, and once before the first one of a contour: a
    turn of it earlier. Before that and after a contour's last needle-down it must be up.

    Parameters
    ----------
    plan
        Of a job with stitches.
    clock
        Of the rows.
    """

    def __init__(self, plan: Plan, clock: Clock) -> None:
        self._clock = clock
        self._runs = planned_stitches(plan)
        self._down_s: FloatArray = np.zeros(0)  # still to be told, in order
        self._begin_s: list[float] = []  # first and last needle-down of every contour so far
        self._end_s: list[float] = []
        self._known_s = -np.inf
        self._ended = False
        self._trim_until = 0  # tick

    def rows(self, block: TickBlock) -> NeedleRows:
        """Return the needle's columns for the rows of ``block``, which is the next of the table."""
        first, rows = block.first_tick, len(block)
        period_s = float(self._clock.period_s)
        self._pull(float(self._clock.time_s(first + rows)) + period_s)
        ticks = np.floor(self._down_s / period_s + _SLACK).astype(np.int64)
        here = ticks < first + rows
        began_s = np.array([float(self._clock.time_s(tick)) for tick in ticks[here].tolist()])
        after_s = np.maximum(self._down_s[here] - began_s, 0.0)
        row = np.maximum(ticks[here] - first, 0)
        self._down_s = self._down_s[~here]
        middle_s = (first + np.arange(rows) + 0.5) * period_s
        begun = np.searchsorted(self._begin_s, middle_s, side="right")
        up = begun == np.searchsorted(self._end_s, middle_s, side="left")
        return NeedleRows(row=row, after_s=after_s, up=up, trim=self._trims(block))

    def _pull(self, until_s: float) -> None:
        """Read stitches until one is later than ``until_s``."""
        while not self._ended and self._known_s <= until_s:
            run = next(self._runs, None)
            if run is None:
                self._ended = True
                self._end_s.append(self._known_s)
                return
            first_s = run.down_s[run.first] - run.period_s[run.first]
            before_s = np.concatenate(([self._known_s], run.down_s[:-1]))[run.first]
            if not self._begin_s:
                before_s = before_s[1:]
            self._begin_s += first_s.tolist()
            self._end_s += before_s.tolist()
            self._down_s = np.sort(np.concatenate((self._down_s, first_s, run.down_s)))
            self._known_s = float(run.down_s[-1])

    def _trims(self, block: TickBlock) -> NDArray[np.bool_]:
        """Return (rows,) whether the thread is trimmed while the row is played."""
        first, rows = block.first_tick, len(block)
        trims = np.zeros(rows, dtype=bool)
        trims[: max(self._trim_until - first, 0)] = True
        events = {(event.kind, event.operation): event for event in block.events}
        for event in block.events:
            if (event.kind, event.name) != ("tool", "trim"):
                continue
            rest = events.get(("dwell", event.operation + 1))
            lasts_s = 0.0 if rest is None else rest.value
            lasts = max(1, ceil(lasts_s / float(self._clock.period_s) - _SLACK))
            self._trim_until = event.tick + lasts
            trims[event.tick - first : max(self._trim_until - first, 0)] = True
        return trims
