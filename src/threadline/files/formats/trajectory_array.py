"""The trajectory array of the 1994 controller: travel ticks, and counts per tick of every axis.

Each line holds a constant speed for n ticks: v whole counts per tick and a remainder of r counts,
which is spread evenly. With the phase h, the travel in tick k is ``v + floor((h + (k + 1) r) / n) -
floor((h + k r) / n)``. This reproduces every row of the original table.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from threadline.base.arrays import IntArray
from threadline.base.reading import KnownFile
from threadline.errors import Place, RecordingError
from threadline.files.clock import Event
from threadline.files.commands import TickBlock, TickTable
from threadline.files.formats.common import Written, reading
from threadline.files.formats.recording_meta import events_cell, parse_events_cell
from threadline.files.formats.table_text import (
    body_lines,
    check_end,
    read_text_table,
    stated_tick_count,
    whole_number,
)
from threadline.files.formats.tick_table import (
    END,
    NEEDLE_COLUMNS,
    READ_ROWS,
    NeedleSource,
    checked_counts,
    empty_block,
    write_text,
)

TITLE = "trajectory-array 1"
MAX_TICKS = 1 << 31  # largest n of a line: products with a remainder stay exact in 64 bits


def _columns(axes: Sequence[str], needle: bool) -> list[str]:
    axis_columns = [
        f"{axis} {what}" for axis in axes for what in ("[count/tick]", "remainder", "phase")
    ]
    return ["ticks", *axis_columns, "operation", *(NEEDLE_COLUMNS if needle else ()), "events"]


def write_array(table: TickTable, path: Path, needle: NeedleSource | None = None) -> Written:
    """Write ``table`` as a trajectory array.

    Parameters
    ----------
    needle
        Columns of the needle, for a seam. A line ends at every tick at which the needle must come
        up or may come down again, or at which trimming begins or ends.
    """
    columns = _columns(table.axes, needle is not None)
    period_s = float(table.clock.period_s)
    return write_text(table, path, TITLE, columns, partial(_text, needle, period_s))


def _text(needle: NeedleSource | None, period_s: float, block: TickBlock, axes: int) -> str:
    return "".join(_lines(needle, period_s, block, axes))


def _lines(
    needle: NeedleSource | None, period_s: float, block: TickBlock, axes: int
) -> Iterator[str]:
    from threadline.files.formats.array_runs import runs  # slow to import: it loads numba

    pending = list(block.events)
    needle_rows = None if needle is None else needle.rows(block)
    operation = block.operation
    cuts = {0, len(block), *(np.flatnonzero(np.diff(operation)) + 1).tolist()}
    cuts |= {e.tick - block.first_tick for e in pending if e.tick < block.first_tick + len(block)}
    if needle_rows is not None:
        cuts |= set(needle_rows.changes().tolist())
    marks = np.array(sorted(cuts), dtype=np.int64)
    run_begins, run_lengths, phases = runs(np.ascontiguousarray(block.counts), marks)
    for begin, run_length, phase in zip(
        run_begins.tolist(), run_lengths.tolist(), phases.tolist(), strict=True
    ):
        total = block.counts[begin : begin + run_length].sum(axis=0).tolist()
        cells = [
            f"{t // run_length},{t % run_length},{h}" for t, h in zip(total, phase, strict=True)
        ]
        tick = block.first_tick + begin
        row_events = [e for e in pending if e.tick == tick]
        if row_events:
            pending = [e for e in pending if e.tick != tick]
        needle_cells = (
            ""
            if needle_rows is None
            else f"{needle_rows.cells(begin, begin + run_length, period_s)},"
        )
        yield (
            f"{run_length},{','.join(cells)},{operation[begin]},{needle_cells}{events_cell(row_events)}\n"
        )
    if pending:  # at the end of the last row
        end = block.first_tick + len(block)
        if any(e.tick != end for e in pending):
            raise ValueError(f"an event lies outside its block: {pending[0]}")
        empty = 3 * axes + 2 + (0 if needle_rows is None else len(NEEDLE_COLUMNS))
        yield f"0{',' * empty}{events_cell(pending)}\n"


def read_array(path: Path) -> TickTable:
    """Read a file that ``write_array`` wrote; the lines stay in the file until they are used.

    Raises
    ------
    RecordingError
        If it is not a trajectory array, a line is wrong, or the rows disagree with their hash. A
        table of an older version has no hash; a wrong row of it is found only when it is read.
    """
    return read_text_table(path, TITLE, _columns, _blocks)


def _blocks(
    known_file: KnownFile, axes: int, head_line: int, needle_columns: int
) -> Iterator[TickBlock]:
    """Yield the blocks; the ``needle_columns`` cells of the needle are counted but not read."""
    path = known_file.path
    first, row_count = 0, 0  # tick of the next block, rows that are ready for it
    counts: list[IntArray] = []
    operation: list[IntArray] = []
    events: list[Event] = []

    def block() -> TickBlock:
        return TickBlock(
            first_tick=first,
            counts=np.concatenate(counts),
            operation=np.concatenate(operation),
            events=tuple(events),
        )

    with reading(known_file):
        for number, line in body_lines(path, head_line):
            place = Place(str(path), number)
            if line.startswith(END):
                check_end(line, first + row_count, place)
                continue
            cell_count = 3 * axes + 3 + needle_columns
            cells = line.split(",", cell_count - 1)
            if len(cells) != cell_count:
                raise RecordingError(
                    f"the line has {len(cells)} cells, expected {cell_count}", place=place
                )
            line_ticks = whole_number(cells[0], place)
            line_events = parse_events_cell(cells[-1], first + row_count, place)
            if line_ticks == 0:
                events += line_events
                continue
            operation_number = whole_number(cells[1 + 3 * axes], place)
            if not 0 < line_ticks <= MAX_TICKS:
                raise RecordingError(f"{line_ticks} ticks, limit {MAX_TICKS}", place=place)
            if line_ticks > READ_ROWS:
                _check_within(first + row_count + line_ticks, path, place)
            for rows in _rows(cells[1 : 1 + 3 * axes], line_ticks, path, place):
                if row_count >= READ_ROWS:
                    yield block()
                    first, row_count = first + row_count, 0
                    counts, operation, events = [], [], []
                events += line_events
                line_events = []
                counts.append(rows)
                operation.append(np.full(len(rows), operation_number))
                row_count += len(rows)
        if row_count:
            yield block()
        elif events:
            yield empty_block(axes, tuple(events))


def _check_within(end: int, path: Path, place: Place) -> None:
    """Refuse a line beyond the stated end of the table, before its rows are made."""
    stated_end = stated_tick_count(path)
    if end > stated_end:
        raise RecordingError(
            f"the line extends to tick {end}, but the table ends after {stated_end}",
            place=place,
            remedy="Write or fetch it again.",
        )


def _rows(cells: list[str], line_ticks: int, path: Path, place: Place) -> Iterator[IntArray]:
    """Yield the rows of one line in parts of limited length."""
    numbers = np.array([whole_number(cell, place) for cell in cells], dtype=np.int64)
    speed, remainder, phase = numbers[0::3], numbers[1::3], numbers[2::3]
    if ((remainder < 0) | (remainder >= line_ticks) | (phase < 0) | (phase >= line_ticks)).any():
        raise RecordingError(
            f"remainders and phases must lie between 0 and {line_ticks - 1}", place=place
        )
    for begin in range(0, line_ticks, READ_ROWS):
        k = np.arange(begin, min(begin + READ_ROWS, line_ticks) + 1, dtype=np.int64)[:, None]
        extra = np.diff((phase + k * remainder) // line_ticks, axis=0)
        yield checked_counts(speed + extra, path)
