"""The hash of the rows of commands, which does not depend on the file that they are kept in.

It is defined in ``docs/files.md`` ("The hash of the rows"), so that another program can compute it.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Iterable
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from threadline.arrays import FloatArray, IntArray

if TYPE_CHECKING:
    from threadline.signals.event import Event

TICKS = "threadline tick table 1"
SWITCHES = "threadline switch schedule 1"
STEPS = "threadline step play 1"


class RowsHash:
    """Hashes rows and events as they are added; the division into blocks makes no difference.

    Parameters
    ----------
    title
        ``TICKS``, ``SWITCHES`` or ``STEPS``.
    period_s
        Period of the clock.
    names
        Names of the axes or outputs.
    numbers
        All other numbers besides the rows, in the order of the definition.
    """

    def __init__(
        self,
        title: str,
        period_s: Fraction,
        names: tuple[str, ...],
        *numbers: FloatArray | IntArray,
    ) -> None:
        self._head = b"".join(
            [
                _text(title),
                _text(f"{period_s.numerator}/{period_s.denominator}"),
                struct.pack("<Q", len(names)),
                *(_text(name) for name in names),
                *(_eight_bytes(column) for column in numbers),
            ]
        )
        self._rows, self._events = hashlib.sha256(), hashlib.sha256()
        self._row_count = self._event_count = 0

    def add(self, columns: Iterable[IntArray], events: Iterable[Event]) -> None:
        """Add n rows, given as (n,) or (n, k) columns, and events in their order."""
        rows = np.column_stack([*columns])
        self._rows.update(_eight_bytes(rows))
        self._row_count += len(rows)
        for event in events:
            self._events.update(
                struct.pack("<qqd", event.tick, event.operation, event.value)
                + _text(event.kind)
                + _text(event.name)
            )
            self._event_count += 1

    def hexdigest(self) -> str:
        """Return the hash of all that was added."""
        whole = hashlib.sha256(self._head)
        for count, part in ((self._row_count, self._rows), (self._event_count, self._events)):
            whole.update(struct.pack("<Q", count) + part.digest())
        return whole.hexdigest()


def _text(text: str) -> bytes:
    content = text.encode()
    return struct.pack("<Q", len(content)) + content


def _eight_bytes(numbers: FloatArray | IntArray) -> bytes:
    """Return numbers as eight bytes each, least significant first, row by row."""
    return np.ascontiguousarray(numbers, dtype=numbers.dtype.newbyteorder("<")).tobytes()
