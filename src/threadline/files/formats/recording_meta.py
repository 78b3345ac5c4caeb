"""The parts of a recording file other than the samples: the description and the events."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter
from pydantic.dataclasses import dataclass

from threadline import __version__
from threadline.base.reading import KnownFile
from threadline.base.wording import nearest
from threadline.errors import Place, RecordingError
from threadline.files.clock import Clock, Event, EventKind
from threadline.files.formats.archive import ColumnArchive, ColumnReader, ColumnSpool
from threadline.files.formats.common import (
    MAX_COUNTS,
    FractionText,
    Hash,
    Label,
    checked_meta,
    fraction_text,
    parse_json,
    positive_fraction,
)
from threadline.files.recording import Channel, ChannelKind, Recording, RecordingBlock
from threadline.files.stream import Stream

TITLE = "recording 1"
OPERATION_REMEDY = (
    "Write the number of the operation in progress, or leave the column out: see docs/files.md."
)
_MOST_OPERATIONS = float(2**53)
_STRICT = ConfigDict(extra="forbid")


@dataclass(frozen=True, config=_STRICT)
class ChannelMeta:
    """A channel in a file."""

    name: Label
    kind: ChannelKind
    unit: Annotated[str, Field(max_length=20)]
    clock: Label
    axis: Annotated[str, Field(max_length=20)]
    stride: Annotated[int, Field(strict=True, ge=1, le=2**40)]


@dataclass(frozen=True, config=_STRICT)
class RecordingMeta:
    """The description of a recording in a file."""

    version: Label
    clocks: dict[Label, FractionText]
    channels: Annotated[tuple[ChannelMeta, ...], Field(max_length=400)]
    simulated: Annotated[bool, Field(strict=True)]
    job_sha256: Hash
    machine_sha256: Hash
    origin: Mapping[str, str]


_META = TypeAdapter(RecordingMeta)


def recording_meta(recording: Recording) -> dict[str, Any]:
    """Return the description of ``recording`` for a file.

    Raises
    ------
    RecordingError
        If two channels, or two clocks with different periods, have the same name.
    """
    clocks: dict[str, str] = {}
    names: set[str] = set()
    for channel in recording.channels:
        period = fraction_text(channel.clock.period_s)
        if clocks.setdefault(channel.clock.name, period) != period:
            raise RecordingError(f"clock {channel.clock.name!r} has two periods")
        if channel.name in names:
            raise RecordingError(f"two channels are called {channel.name!r}")
        names.add(channel.name)
    return {
        "version": __version__,
        "clocks": clocks,
        "channels": [
            {
                "name": c.name,
                "kind": c.kind.value,
                "unit": c.unit,
                "clock": c.clock.name,
                "axis": c.axis,
                "stride": c.stride,
            }
            for c in recording.channels
        ],
        "simulated": recording.simulated,
        "job_sha256": recording.job_sha256,
        "machine_sha256": recording.machine_sha256,
        "origin": dict(recording.origin),
    }


def operation_fault(value: float) -> str | None:
    """Return what is wrong with a sample of a channel of operations, or None.

    Operations are counted from 0; -1 stands for no operation.
    """
    if -1.0 <= value <= _MOST_OPERATIONS and value.is_integer():
        return None
    return f"the operation {value:.12g} is neither a whole number from 0 on nor -1 for none"


def recording_from(
    meta: Any, path: Path, samples: Callable[..., Iterator[RecordingBlock]], *given: object
) -> Recording:
    """Return the recording with the description and the samples of a file.

    Parameters
    ----------
    meta
        The description from the file.
    path
        The file.
    samples
        Called for each reading with the file and its hash, the channels, and the arguments
        ``given``; yields the blocks.

    Raises
    ------
    RecordingError
        If the description is wrong.
    """
    description = checked_meta(_META, meta, path)
    place = Place(str(path))
    clocks = {n: Clock(n, positive_fraction(p, place)) for n, p in description.clocks.items()}
    channels = []
    for channel in description.channels:
        if channel.clock not in clocks:
            raise RecordingError(
                f"channel {channel.name!r} names the unknown clock {channel.clock!r}",
                place=place,
            )
        channels.append(
            Channel(
                name=channel.name,
                kind=channel.kind,
                unit=channel.unit,
                clock=clocks[channel.clock],
                axis=channel.axis,
                stride=channel.stride,
            )
        )
    if len({channel.name for channel in channels}) < len(channels):
        raise RecordingError("two channels have the same name", place=place)
    return Recording(
        channels=tuple(channels),
        blocks=Stream(samples, KnownFile.of(path), tuple(channels), *given),
        job_sha256=description.job_sha256,
        machine_sha256=description.machine_sha256,
        simulated=description.simulated,
        origin=dict(description.origin),
    )


KINDS: tuple[EventKind, ...] = get_args(EventKind)
_COLUMNS = {
    "event_tick": "<i8",
    "event_kind": "<u1",
    "event_operation": "<i8",
    "event_name": "<i4",
    "event_value": "<f8",
}


def events_cell(events: Iterable[Event], *, ticks: bool = False) -> str:
    """Return events as the cell of a table; an empty cell if there are none.

    Parameters
    ----------
    events
        Events of the row, in order.
    ticks
        Whether to write the tick of each event; if not, it is the tick of the row.
    """
    items = [event_item(e) if ticks else event_item(e)[:-1] for e in events]
    if not items:
        return ""
    text = json.dumps(items, ensure_ascii=False, separators=(",", ":"))
    return '"' + text.replace('"', '""') + '"'


def event_item(event: Event) -> list[Any]:
    """Return an event as a list for a file: kind, operation, name, value, tick."""
    return [event.kind, event.operation, event.name, event.value, event.tick]


def event_from(item: Any, place: Place) -> Event:
    """Return the event in a list that ``event_item`` made.

    Raises
    ------
    RecordingError
        If it is not an event.
    """
    return _event(item, None, place)


def parse_events_cell(cell: str, tick: int | None, place: Place) -> list[Event]:
    """Return the events in a cell that ``events_cell`` made; it has ticks if ``tick`` is None.

    Raises
    ------
    RecordingError
        If the cell is not a list of events.
    """
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
        raise RecordingError(f"an event has value {value}, operation {operation}", place=place)


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
        """The names that the column ``event_name`` refers to by index."""
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
        """Return the next ``count`` events, or all remaining events if they are fewer.

        Raises
        ------
        RecordingError
            If an event has an impossible kind, name or tick.
        """
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
