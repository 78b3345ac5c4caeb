"""A window on the rows of a tick table, with the axis positions at any place in it.

A place is a row number with a fraction: at place 7.25 a quarter of row 7 has been travelled.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import ceil

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.compiled import njit
from threadline.files import Event, TickBlock, TickTable

HALTS = frozenset(("stop", "wait"))
"""Kinds of events at which a run stands until the operator or an input answers."""

REST_S = 0.05
"""Shortest pause in s, without a count of any axis, that is a rest: slow axes pause between two
counts, too."""


class PathWindow:
    """The rows around the present place of a run, read when needed and deleted later.

    Parameters
    ----------
    table
        Table to run; it is read once.
    pass_stops
        Whether the run goes on at stops of the program.
    """

    def __init__(self, table: TickTable, *, pass_stops: bool = False) -> None:
        self._halting = HALTS - {"stop"} if pass_stops else HALTS
        self._blocks: Iterator[TickBlock] = iter(table)
        self._rest_rows = rest_rows(table)
        axes = len(table.axes)
        self._first = 0  # row of the first kept place
        self._travelled = np.zeros((1, axes), dtype=np.int64)  # counts at the kept places
        self._operation = np.zeros(0, dtype=np.int64)
        self._events: list[Event] = []
        self._all = False

    def reach(self, place: float) -> int:
        """Read rows up to ``place``, if there are as many; return the last known place."""
        while not self._all and self._last < place:
            block = next(self._blocks, None)
            if block is None:
                self._all = True
                break
            end_counts = self._travelled[-1] + np.cumsum(block.counts, axis=0)
            self._travelled = np.concatenate([self._travelled, end_counts])
            self._operation = np.concatenate([self._operation, block.operation])
            self._events.extend(block.events)
        return self._last

    @property
    def _last(self) -> int:
        return self._first + len(self._operation)

    @property
    def at_end(self) -> bool:
        """Whether the last row has been read."""
        return self._all

    def forget(self, place: float) -> None:
        """Delete the rows before ``place``."""
        row_count = min(int(place) - self._first, len(self._operation))
        if row_count > 0:
            # Views: their block stays in memory until the next one is read, one block at most.
            self._travelled = self._travelled[row_count:]
            self._operation = self._operation[row_count:]
            self._first += row_count

    def counts(self, places: FloatArray) -> FloatArray:
        """Return (n, axes) counts from the start at (n,) places, not rounded.

        Positions between two rows of the table are interpolated linearly.
        """
        return _between(self._travelled, self._first, np.asarray(places, np.float64))

    def rounded(self, places: FloatArray) -> IntArray:
        """Return (n, axes) whole counts from the start at (n,) places."""
        return np.rint(self.counts(places)).astype(np.int64)

    def operations(self, places: FloatArray) -> IntArray:
        """Return the (n,) operations of the rows at (n,) places."""
        if not len(self._operation):
            return np.zeros(len(places), dtype=np.int64)
        indices = places.astype(np.int64) - self._first
        # As np.clip, which takes ten times as long for these few.
        return self._operation[np.maximum(np.minimum(indices, len(self._operation) - 1), 0)]

    def next_rest(self, place: float) -> int | None:
        """Return the first row of the next rest from ``place`` on; None if none is known.

        In a rest no axis has a count for ``REST_S``.
        """
        first_index = max(int(place) - self._first, 0)
        is_still = (np.diff(self._travelled[first_index:], axis=0) == 0).all(axis=1)
        if len(is_still) < self._rest_rows:
            return None
        rest_starts = np.flatnonzero(
            np.convolve(is_still, np.ones(self._rest_rows), "valid") >= self._rest_rows - 0.5
        )
        return int(rest_starts[0]) + first_index + self._first if len(rest_starts) else None

    def halt(self) -> Event | None:
        """Return the next stop or wait in the known rows that was not passed, or None."""
        return next((event for event in self._events if event.kind in self._halting), None)

    def pass_halt(self) -> None:
        """Pass the next stop or wait."""
        halt = self.halt()
        if halt is not None:
            self._events.remove(halt)

    def take_events(self, place: float) -> tuple[Event, ...]:
        """Return the events up to ``place``, without stops and waits, and remove them."""
        due_events = [e for e in self._events if e.tick <= place and e.kind not in HALTS]
        if due_events:
            self._events = [e for e in self._events if e.tick > place or e.kind in HALTS]
        return tuple(due_events)

    def put_back(self, events: Sequence[Event]) -> None:
        """Add events that ``take_events`` had removed."""
        self._events = sorted([*events, *self._events], key=_tick)


@njit()
def _between(travelled: IntArray, first: int, places: FloatArray) -> FloatArray:
    """Return the (n, axes) counts at places, interpolated linearly between rows.

    It is compiled because it runs several times at every refill, on 50 to 260 places.

    Parameters
    ----------
    travelled
        (rows + 1, axes) counts at whole places, from ``first`` on.
    first
        The first of these places.
    places
        (n,) places; places outside the known range are clamped to its ends.
    """
    rows = len(travelled) - 1
    counts = np.empty((len(places), travelled.shape[1]))
    for i in range(len(places)):
        offset = min(max(places[i] - first, 0.0), float(rows))
        low = min(int(offset), max(rows - 1, 0))
        high = min(low + 1, rows)
        fraction = offset - low
        for k in range(travelled.shape[1]):
            low_counts = travelled[low, k]
            counts[i, k] = low_counts + (travelled[high, k] - low_counts) * fraction
    return counts


def rests_of(table: TickTable) -> IntArray:
    """Return the (n, 2) rests of a table: their first row, and the row after them.

    In a rest no axis has a count for ``REST_S``. It reads the table once.
    """
    still_blocks = [(block.counts == 0).all(axis=1) for block in table]
    edges = np.diff(np.concatenate([[False], *still_blocks, [False]]).astype(np.int8))
    rests = np.stack([np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)], axis=1)
    return rests[rests[:, 1] - rests[:, 0] >= rest_rows(table)]


def rest_rows(table: TickTable) -> int:
    """Return the number of rows without a count that make a rest."""
    return ceil(REST_S / float(table.clock.period_s) - 1e-9)


def _tick(event: Event) -> int:
    return event.tick
