"""Reader of tick tables in CSV, and of the lines that all text formats of tick tables share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import takewhile
from os import SEEK_END
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.reading import KnownFile
from threadline.base.wording import nearest
from threadline.errors import Place, RecordingError
from threadline.files.clock import Event
from threadline.files.commands import TickBlock, TickTable
from threadline.files.formats.common import (
    MAX_COUNTS,
    clear_errors,
    parse_meta_lines,
    reading,
    text_lines,
)
from threadline.files.formats.recording_meta import parse_events_cell
from threadline.files.formats.tick_table import (
    END,
    NEEDLE_COLUMNS,
    READ_ROWS,
    TITLE,
    checked_counts,
    checked_rows,
    csv_columns,
    empty_block,
    table_from,
)

_LAST = 200  # bytes at the end of a file that hold its last line


def read_head(path: Path, title: str) -> tuple[dict[str, Any], int, str]:
    """Return the description, and the number and the text of the line of column names.

    Raises
    ------
    RecordingError
        If the first line is not ``title``.
    """
    lines = text_lines(path)
    _, first = next(lines, (1, ""))
    if first != f"# threadline {title}":
        raise RecordingError(
            f"the file begins with {first[:60]!r}, expected '# threadline {title}'",
            place=Place(str(path), 1),
            remedy="Give a table written by Threadline.",
        )
    columns: list[tuple[int, str]] = []

    def is_comment(numbered: tuple[int, str]) -> bool:
        if numbered[1].startswith("#"):
            return True
        columns.append(numbered)
        return False

    meta = parse_meta_lines(takewhile(is_comment, lines), path)
    if not columns:
        raise RecordingError("the file ends before its columns", place=Place(str(path)))
    return meta, *columns[0]


def check_columns(found: str, expected: list[str], place: Place) -> None:
    """Refuse unexpected column names; the error names the first unknown column."""
    names = found.split(",")
    for name in names:
        if name not in expected:
            raise RecordingError(
                f"unknown column {name[:60]!r}", place=place, remedy=nearest(name, expected)
            )
    if names != expected:
        raise RecordingError(
            f"the columns are {found[:200]!r}, expected {','.join(expected)!r}", place=place
        )


def read_table_csv(path: Path) -> TickTable:
    """Read a file that ``write_table_csv`` wrote; the rows stay in the file until they are used.

    Raises
    ------
    RecordingError
        If it is not a tick table, a row is wrong, or the rows disagree with their hash. A table of
        an older version has no hash; a wrong row of such a table is found only when it is read.
    """
    return read_text_table(path, TITLE, csv_columns, _blocks)


def read_text_table(
    path: Path,
    title: str,
    columns_of: Callable[[Sequence[str], bool], list[str]],
    blocks: Callable[..., Iterator[TickBlock]],
) -> TickTable:
    """Read a tick table from lines of text; the rows stay in the file until they are used.

    Parameters
    ----------
    title
        Name and version of the format, on the first line.
    columns_of
        Returns the column names for the given axes, with or without the columns of the needle.
    blocks
        Called for each reading with the file and its hash, the number of axes, the line number of
        the column names, and the number of needle columns; yields the blocks.

    Raises
    ------
    RecordingError
        As in ``read_table_csv`` and ``read_array``.
    """
    with clear_errors(path):
        meta, number, columns = read_head(path, title)
        needle = NEEDLE_COLUMNS[0] in columns.split(",")
        table = table_from(meta, path, blocks, number, len(NEEDLE_COLUMNS) if needle else 0)
        check_columns(columns, columns_of(table.axes, needle), Place(str(path), number))
        return checked_rows(table, meta, path)


def _blocks(
    known_file: KnownFile, axes: int, head_line: int, needle_columns: int
) -> Iterator[TickBlock]:
    """Yield the blocks; the ``needle_columns`` cells of the needle are counted but not read."""
    path = known_file.path
    with reading(known_file):
        rows: list[list[int]] = []
        events: list[Event] = []
        end_events: list[Event] = []
        first = 0
        for number, line in body_lines(path, head_line):
            place = Place(str(path), number)
            if line.startswith(END):
                check_end(line, first + len(rows), place)
                continue
            cells = line.split(",", axes + needle_columns + 2)
            if len(cells) != axes + needle_columns + 3:
                raise RecordingError(
                    f"the line has {len(cells)} cells, expected {axes + needle_columns + 3}",
                    place=place,
                    remedy="The file may have been cut off.",
                )
            del cells[axes + 2 : -1]
            tick = whole_number(cells[0], place)
            if not any(cells[1:-1]):
                if tick < first + len(rows):
                    raise RecordingError(f"tick {tick} occurs twice", place=place)
                line_events = parse_events_cell(cells[-1], tick, place)
                if not line_events:
                    raise RecordingError("the line has no counts and no events", place=place)
                end_events += line_events
                continue
            if end_events:
                raise RecordingError("a row follows the events after the end", place=place)
            if tick != first + len(rows):
                raise RecordingError(
                    f"tick {tick} follows tick {first + len(rows) - 1}",
                    place=place,
                    remedy="A line is missing or doubled.",
                )
            if len(rows) == READ_ROWS:
                yield _block(first, rows, events, path)
                first, rows, events = tick, [], []
            rows.append([whole_number(cell, place) for cell in cells[1:-1]])
            events += parse_events_cell(cells[-1], tick, place)
        if rows:
            yield _block(first, rows, events + end_events, path)
        elif end_events:
            yield empty_block(axes, tuple(end_events))


def body_lines(path: Path, head: int) -> Iterator[tuple[int, str]]:
    """Yield the lines after line ``head``, up to and including the end line of the table.

    Raises
    ------
    RecordingError
        If lines follow the end line, or there is no end line.
    """
    ended, number = False, head
    for number, line in text_lines(path):
        if number <= head:
            continue
        if ended:
            raise RecordingError("rows follow the end of the table", place=Place(str(path), number))
        ended = line.startswith(END)
        yield number, line
    if not ended:
        raise _cut_off(Place(str(path), number))


def _cut_off(place: Place) -> RecordingError:
    return RecordingError(
        f"the table is cut off: no line {END.strip()!r} at the end",
        place=place,
        remedy="Write or fetch it again.",
    )


def stated_tick_count(path: Path) -> int:
    """Return the number of ticks in the last line of a table, without reading the other lines.

    Raises
    ------
    RecordingError
        If the last line is not an end line.
    """
    place = Place(str(path))
    with path.open("rb") as file:
        file.seek(max(file.seek(0, SEEK_END) - _LAST, 0))
        _, separator, count = file.read().decode("utf-8", "replace").rpartition(END)
    if not separator:
        raise _cut_off(place)
    return whole_number(count.strip(), place)


def check_end(line: str, ticks: int, place: Place) -> None:
    """Refuse an end line whose number of ticks differs from ``ticks``."""
    if whole_number(line.removeprefix(END), place) != ticks:
        raise RecordingError(
            f"the table has {ticks} ticks, its end says {line.removeprefix(END)[:20]}",
            place=place,
            remedy="Lines are missing or doubled.",
        )


def _block(first: int, rows: list[list[int]], events: list[Event], path: Path) -> TickBlock:
    values = np.array(rows, dtype=np.int64)
    counts = checked_counts(values[:, :-1], path)
    return TickBlock(first_tick=first, counts=counts, operation=values[:, -1], events=tuple(events))


def whole_number(cell: str, place: Place) -> int:
    """Return the whole number in ``cell``.

    Raises
    ------
    RecordingError
        If it is not a whole number, or larger than ``MAX_COUNTS``.
    """
    digits = cell[1:] if cell[:1] == "-" else cell
    if not (digits.isascii() and digits.isdigit() and len(digits) <= 18):
        raise RecordingError(f"{cell[:40]!r} is not a whole number", place=place)
    value = int(cell)
    if abs(value) > MAX_COUNTS:
        raise RecordingError(f"{cell} is beyond {MAX_COUNTS}", place=place)
    return value
