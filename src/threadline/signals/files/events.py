"""Events in files: a cell of a text table, or columns of an archive."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any, get_args

import numpy as np

from threadline.errors import Place, RecordingError
from threadline.foreign_messages import nearest
from threadline.signals.event import Event, EventKind
from threadline.signals.files.archive import ColumnArchive, ColumnReader, ColumnSpool
from threadline.signals.files.common import MAX_COUNTS, parse_json

KINDS: tuple[EventKind, ...] = get_args(EventKind)
_COLUMNS = {
    "event_tick": "<i8",
    "event_kind": "<u1",
    "event_operation": "<i8",
    "event_name": "<i4",
    "event_value": "<f8",
}


def events_cell(events: Iterable[Event], *, ticks: bool = False) -> str:
    """Return events as the cell of a table; empty for none.

    Parameters
    ----------
    events
        Events of the row, in order.
    ticks
        Write the tick of each; otherwise the row tells it.
    """
    items = [event_item(e) if ticks else event_item(e)[:-1] for e in events]
    if not items:
        return ""
    text = json.dumps(items, ensure_ascii=False, separators=(",", ":"))
    return '"' + text.replace('"', '""') + '"'


def event_item(event: Event) -> list[Any]:
    """Return an event as it stands in files: kind, operation, name, value, tick."""
    return [event.kind, event.operation, event.name, event.value, event.tick]


def event_from(item: Any, place: Place) -> Event:
    """Return the event that ``event_item`` wrote.

    Raises
    ------
    RecordingError
        If it is none.
    """
    return _event(item, None, place)


def parse_events_cell(cell: str, tick: int | None, place: Place) -> list[Event]:
    """Return the events that ``events_cell`` wrote, with ticks if ``tick`` is None."""
    if not cell:
        return []
    if not (len(cell) > 1 and cell[0] == cell[-1] == '"'):
        raise RecordingError(f"{cell[:60]!r} is not a list of events", place=place)
    items = parse_json(cell[1:-1].replace('""', '"'), place)
    if not isinstance(items, list):
        raise RecordingError(f"{cell[:60]!r} is not a list of events", place=place)
    return [_event(item, tick, place) for item in items]


def _event(item: Any, tick: int | None, place: Place) -> Event:
    if isinstance(item, list) and len(item) == 5 and tick is None:
        *item, tick = item
    if not (
        isinstance(item, list)
        and len(item) == 4
        and type(tick) is int
        and 0 <= tick <= MAX_COUNTS
        and isinstance(item[0], str)
        and type(item[1]) is int
        and isinstance(item[2], str)
        and type(item[3]) in {int, float}
    ):
        raise RecordingError(
            f"{str(item)[:60]!r} is not an event",
            place=place,
            remedy="An event is [kind, operation, name, value].",
        )
    kind, operation, name, value = item
    if kind not in KINDS:
        raise RecordingError(
            f"unknown kind of event {kind[:40]!r}", place=place, remedy=nearest(kind, KINDS)
        )
    _check_numbers(operation, value, place)
    return Event(tick=tick, kind=kind, operation=operation, name=name, value=value)


def _check_numbers(operation: int, value: float, place: Place) -> None:
    if abs(operation) > MAX_COUNTS or not abs(value) < float("inf"):
        raise RecordingError(f"an event has the value {value} of {operation}", place=place)


class EventSpool:
    """Writes events into the columns of an archive."""

    def __init__(self, spool: ColumnSpool) -> None:
        self._spool = spool
        self._names: dict[str, int] = {}
        for name, dtype in _COLUMNS.items():
            spool.column(name, dtype)

    def append(self, events: Sequence[Event]) -> None:
        """Add events."""
        if not events:
            return
        names = [self._names.setdefault(e.name, len(self._names)) for e in events]
        self._spool.append("event_tick", np.array([e.tick for e in events]))
        self._spool.append("event_kind", np.array([KINDS.index(e.kind) for e in events]))
        self._spool.append("event_operation", np.array([e.operation for e in events]))
        self._spool.append("event_name", np.array(names))
        self._spool.append("event_value", np.array([e.value for e in events], dtype=np.float64))

    @property
    def names(self) -> list[str]:
        """The names that the column ``event_name`` counts."""
        return list(self._names)


class EventColumns:
    """Reads events back from the columns of an archive, in order."""

    def __init__(self, archive: ColumnArchive, names: Sequence[str], place: Place) -> None:
        self._columns: dict[str, ColumnReader] = {
            name: archive.column(name, dtype) for name, dtype in _COLUMNS.items()
        }
        self._names = names
        self._place = place
        if len({column.rows for column in self._columns.values()}) != 1:
            raise RecordingError("the columns of events differ in length", place=place)
        self.left = self._columns["event_tick"].rows

    def take(self, count: int) -> list[Event]:
        """Return the next ``count`` events, or as many as are left."""
        count = min(count, self.left)
        self.left -= count
        columns = [self._columns[name].take(count).tolist() for name in _COLUMNS]
        events = []
        for tick, kind, operation, name, value in zip(*columns, strict=True):
            if not (kind < len(KINDS) and 0 <= name < len(self._names) and tick >= 0):
                raise RecordingError(
                    f"an event has kind {kind}, name {name}, tick {tick}", place=self._place
                )
            _check_numbers(operation, value, self._place)
            events.append(
                Event(
                    tick=tick,
                    kind=KINDS[kind],
                    operation=operation,
                    name=self._names[name],
                    value=value,
                )
            )
        return events
