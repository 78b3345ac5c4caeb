"""Recordings in ``.csv`` files: written by Threadline, or traces from other programs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.reading import KnownFile
from threadline.errors import Place, RecordingError
from threadline.files.clock import Clock, Event
from threadline.files.formats.common import (
    MAX_COUNTS,
    TIME,
    Column,
    Written,
    atomic_file,
    check_on_grid,
    clear_errors,
    find_grid,
    in_si,
    meta_lines,
    parse_column,
    parse_meta_lines,
    reading,
    text_lines,
    written,
)
from threadline.files.formats.recording_meta import (
    OPERATION_REMEDY,
    TITLE,
    events_cell,
    operation_fault,
    parse_events_cell,
    recording_from,
    recording_meta,
)
from threadline.files.formats.tick_table import READ_ROWS
from threadline.files.recording import Channel, ChannelKind, Recording, RecordingBlock
from threadline.files.stream import Stream

END = "# end after samples: "
_EVENTS = "events"
_TIME_COLUMN = f"{TIME} [s]"


def write_recording_csv(recording: Recording, path: Path) -> Written:
    """Write ``recording`` as text: comment lines with its description, then one line per instant.

    Raises
    ------
    RecordingError
        If its channels differ in clock or stride, or there is a gap between samples.
    """
    channels = recording.channels
    grids = {(c.clock, c.stride) for c in channels}
    if len(grids) != 1:
        raise RecordingError(
            f"the channels of the recording lie on {len(grids)} clocks or strides; "
            "a table has one time column for all channels",
            remedy="Write it as .npz.",
        )
    for channel in channels:
        if set(channel.name + channel.unit) & set(',"\r\n[]'):
            raise RecordingError(
                f"{channel.name!r} cannot be the heading of a column", remedy="Write it as .npz."
            )
    clock, stride = next(iter(grids))
    with atomic_file(path) as file:
        for line in meta_lines(TITLE, recording_meta(recording)):
            file.write(f"{line}\n".encode())
        headings = [_TIME_COLUMN, *map(_head, channels), _EVENTS]
        file.write((",".join(headings) + "\n").encode())
        rows = 0
        expected_tick: int | None = None
        for block in recording:
            tick = block.first_tick[clock.name]
            arrays = [block.samples[c.name] for c in channels]
            if len({len(array) for array in arrays}) != 1 or expected_tick not in {None, tick}:
                raise RecordingError(
                    "the recording has a gap at tick "
                    f"{expected_tick if expected_tick is not None else tick}",
                    remedy="Write it as .npz.",
                )
            times = clock.times_s(tick, len(arrays[0]), stride).tolist()
            columns = [array.tolist() for array in arrays]
            cell = events_cell(block.events, ticks=True)
            if cell and not times:
                raise RecordingError("a block without samples has events; write it as .npz")
            for row in zip(times, *columns, strict=True):
                file.write((",".join(map(repr, row)) + f",{cell}\n").encode())
                cell = ""
            rows += len(times)
            expected_tick = tick + stride * len(times)
        file.write(f"{END}{rows}\n".encode())
    return written(path)


def _head(channel: Channel) -> str:
    return f"{channel.name} [{channel.unit}]" if channel.unit else channel.name


def read_recording_csv(path: Path) -> Recording:
    """Read a recording from text.

    A file of Threadline is read without loss. Any other file begins, after comment lines with
    ``#``, with a line of columns and units, such as ``time [s],X [mm],A [deg]``. Separators are
    commas, semicolons or tabs. The instants must lie on an even grid, within ``JITTER`` of a
    period. The whole file is checked before the first sample is returned.

    Raises
    ------
    RecordingError
        If the file is neither a recording nor such a trace; names the line.
    """
    with clear_errors(path):
        is_native = next(text_lines(path), (1, ""))[1] == f"# threadline {TITLE}"
        recording = _read_native(path) if is_native else _foreign(path)
        for _ in recording:
            pass  # read every line now, so that a wrong line is found before the recording is used
    return recording


def _read_native(path: Path) -> Recording:
    header_lines: list[tuple[int, str]] = []

    def is_comment(numbered: tuple[int, str]) -> bool:
        if not numbered[1].startswith("#"):
            header_lines.append(numbered)
        return not header_lines

    lines = text_lines(path)
    next(lines)
    meta = parse_meta_lines(takewhile(is_comment, lines), path)
    if not header_lines:
        raise RecordingError("the file ends before its columns", place=Place(str(path)))
    number, text = header_lines[0]
    recording = recording_from(meta, path, _native_blocks, number)
    channels = recording.channels
    place = Place(str(path), number)
    if len({(c.clock, c.stride) for c in channels}) != 1:
        raise RecordingError("the channels are not on one clock and stride", place=place)
    expected = [_TIME_COLUMN, *map(_head, channels), _EVENTS]
    if text.split(",") != expected:
        raise RecordingError(
            f"the columns are {text[:200]!r}, expected {','.join(expected)!r}", place=place
        )
    return in_si(recording, place)


def _native_blocks(
    known_file: KnownFile, channels: tuple[Channel, ...], head_line: int
) -> Iterator[RecordingBlock]:
    layout = _Layout(
        separator=",",
        factors=(1.0, *(1.0 for _ in channels)),
        order=tuple(range(len(channels) + 1)),
        own=True,
    )
    return _blocks(known_file, channels, head_line, layout)


def _foreign(path: Path) -> Recording:
    number, text = next(
        ((n, line) for n, line in text_lines(path) if line.strip() and not line.startswith("#")),
        (0, ""),
    )
    place = Place(str(path), number)
    if not number:
        raise RecordingError("the file is empty", place=place, remedy="Give a recorded trace.")
    separator = max(",;\t", key=text.count)
    columns = [parse_column(part, place) for part in text.split(separator)]
    names = [column.name for column in columns]
    for name in names:
        if names.count(name) > 1:
            raise RecordingError(f"column {name!r} occurs twice", place=place)
    if TIME not in names or len(names) < 2:
        raise RecordingError(
            "the trace needs a column of time and at least one column of positions",
            place=place,
            remedy='Begin with a line like "time [s],X [mm],Y [mm],A [deg]".',
        )
    time_column = names.index(TIME)
    channel_columns = [k for k in range(len(columns)) if k != time_column]
    layout = _Layout(
        separator=separator,
        factors=(columns[time_column].factor, *(columns[k].factor for k in channel_columns)),
        order=(time_column, *channel_columns),
        own=False,
    )
    instants = ((n, row[0]) for n, row, _ in _rows(path, number, layout))
    grid = find_grid(instants, str(path))
    clock = Clock("recording", grid.period_s)
    channels = tuple(_channel(columns[k], clock) for k in channel_columns)
    layout = replace(layout, first=grid.first)
    return Recording(
        channels=channels,
        blocks=Stream(_blocks, KnownFile.of(path), channels, number, layout),
        job_sha256="",
        machine_sha256="",
        simulated=False,
    )


def _channel(column: Column, clock: Clock) -> Channel:
    kind = column.kind or ChannelKind.MEASURED
    return Channel(name=column.name, kind=kind, unit=column.unit, clock=clock, axis=column.axis)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Layout:
    """Layout of a line: its separator, factors to SI, and the column of time and each channel."""

    separator: str
    factors: tuple[float, ...]
    order: tuple[int, ...]
    own: bool
    first: int | None = None  # tick of the first row; None: from its time


def _rows(
    path: Path, head_line: int, layout: _Layout
) -> Iterator[tuple[int, list[float], list[Event]]]:
    """Yield line number, time and samples in SI, and events."""
    width = len(layout.order)
    rows, ended = 0, not layout.own
    for number, line in text_lines(path):
        if number <= head_line:
            continue
        place = Place(str(path), number)
        if layout.own and line.startswith(END):
            if line != f"{END}{rows}":
                raise RecordingError(f"the file has {rows} samples, {line[2:60]!r}", place=place)
            ended = True
            continue
        if not line.strip() and not layout.own:
            continue
        if layout.own and ended:
            raise RecordingError("rows follow the end of the table", place=place)
        cells = line.split(layout.separator, width if layout.own else -1)
        cell_count = len(cells) - layout.own
        if cell_count != width:
            raise RecordingError(
                f"the line has {cell_count} cells, but there are {width} columns",
                place=place,
                remedy="The file may have been cut off.",
            )
        events = parse_events_cell(cells[-1], None, place) if layout.own else []
        values = [
            parse_number(cells[k], place, nan=layout.own and k > 0) * factor
            for k, factor in zip(layout.order, layout.factors, strict=True)
        ]
        rows += 1
        yield number, values, events
    if not ended:
        raise RecordingError(
            "the table is cut off before its end",
            place=Place(str(path)),
            remedy="Write or fetch it again.",
        )


def parse_number(cell: str, place: Place, *, nan: bool = False) -> float:
    """Return the number in ``cell``; ``nan`` allows infinity and NaN, as in Threadline's files.

    Raises
    ------
    RecordingError
        If the cell is not a number.
    """
    value: float | None = None
    if cell.isascii() and "_" not in cell:
        with suppress(ValueError):
            value = float(cell)
    if value is None or not (nan or math.isfinite(value)):
        raise RecordingError(
            f"{cell.strip()[:40]!r} is not a finite number",
            place=place,
            remedy="Write numbers with a point, and leave no gaps.",
        )
    return value


def _blocks(
    known_file: KnownFile, channels: tuple[Channel, ...], head_line: int, layout: _Layout
) -> Iterator[RecordingBlock]:
    path, clock, stride = known_file.path, channels[0].clock, channels[0].stride
    values: list[list[float]] = []
    events: list[Event] = []
    first = layout.first
    operation_columns = [k + 1 for k, c in enumerate(channels) if c.kind is ChannelKind.OPERATION]

    def block(tick: int) -> RecordingBlock:
        columns: Any = np.array(values).T[1:]
        samples = {c.name: columns[k] for k, c in enumerate(channels)}
        return RecordingBlock(first_tick={clock.name: tick}, samples=samples, events=tuple(events))

    with reading(known_file):
        for number, row, row_events in _rows(path, head_line, layout):
            place = Place(str(path), number)
            if first is None:
                first = min(max(0, round(row[0] / float(clock.period_s))), MAX_COUNTS)
            if len(values) == READ_ROWS:
                yield block(first)
                first += stride * len(values)
                values, events = [], []
            check_on_grid(row[0], first + stride * len(values), clock.period_s, stride, place)
            for k in operation_columns:
                if (fault := operation_fault(row[k])) is not None:
                    raise RecordingError(fault, place=place, remedy=OPERATION_REMEDY)
            values.append(row)
            events += row_events
        if values:
            assert first is not None
            yield block(first)
