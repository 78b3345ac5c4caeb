"""Tick tables in files: description, ``.npz`` and CSV, and the needle columns of a seam."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, TypeAdapter
from pydantic.dataclasses import dataclass

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.reading import KnownFile
from threadline.errors import Place, RecordingError
from threadline.files.clock import Clock, Event
from threadline.files.commands import TickBlock, TickTable
from threadline.files.formats.archive import ColumnArchive, ColumnSpool
from threadline.files.formats.common import (
    Counts,
    Finite,
    FractionText,
    Hash,
    Label,
    Written,
    atomic_file,
    checked_meta,
    clear_errors,
    fraction_text,
    meta_lines,
    positive_fraction,
    reading,
    written,
)
from threadline.files.formats.recording_meta import EventColumns, EventSpool, events_cell
from threadline.files.stream import Stream

NEEDLE_COLUMNS = ("needle_down [s]", "needle_up", "trim")
"""Needle columns in text: time from the tick to needle-down, whether the needle must be up, and
whether the thread is trimmed."""


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NeedleRows:
    """Needle and thread trimmer for the rows of a block.

    Parameters
    ----------
    row
        (k,) rows in which the needle goes down, in order; a row may occur twice.
    after_s
        (k,) time of needle-down after the tick of its row, s.
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
        """Return the (m,) rows at which ``up`` or ``trim`` changes."""
        changed = (self.up[1:] != self.up[:-1]) | (self.trim[1:] != self.trim[:-1])
        return np.flatnonzero(changed) + 1

    def cells(self, begin: int, end: int, period_s: float) -> str:
        """Return the needle cells of rows that share one line of text, joined by commas.

        Parameters
        ----------
        begin, end
            Range of rows with constant ``up`` and ``trim``.
        period_s
            Period of a row; needle-down times are counted from the first row.
        """
        first, last = np.searchsorted(self.row, (begin, end))
        times_s = self.after_s[first:last] + (self.row[first:last] - begin) * period_s
        down_times = " ".join(f"{time_s:.9f}" for time_s in times_s.tolist())
        return f"{down_times},{int(self.up[begin])},{int(self.trim[begin])}"


class NeedleSource(Protocol):
    """Source of the needle columns of a table."""

    def rows(self, block: TickBlock) -> NeedleRows:
        """Return the needle columns of the next block."""
        ...


READ_ROWS = 1 << 16
MAX_AXES = 64
TITLE = "tick-table 1"
END = "# end after ticks: "
"""Start of the last line of a text table; a file without this line was cut off."""


_NEEDLE_ARRAYS = (
    ("needle_down_tick", "<i8"), ("needle_down_s", "<f8"), ("needle_up", "|u1"), ("trim", "|u1"),
)  # fmt: skip

_UNIT: Final = "count/m of a linear axis, count/rad of a rotary one"


@dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class TableMeta:
    """The description of a tick table in a file."""

    clock: tuple[Label, FractionText]
    axes: Annotated[tuple[Label, ...], Field(min_length=1, max_length=MAX_AXES)]
    counts_per_unit: tuple[Finite, ...]
    start_counts: tuple[Counts, ...]
    job_sha256: Hash
    machine_sha256: Hash
    rows_sha256: Hash | None = None
    began_sha256: Hash = ""
    unit: Literal["count/m of a linear axis, count/rad of a rotary one"] = _UNIT


_META = TypeAdapter(TableMeta)


def table_meta(table: TickTable) -> dict[str, Any]:
    """Return the description of ``table`` for a file."""
    return {
        "clock": [table.clock.name, fraction_text(table.clock.period_s)],
        "axes": list(table.axes),
        "counts_per_unit": table.counts_per_unit.tolist(),
        "unit": _UNIT,
        "start_counts": table.start_counts.tolist(),
        "job_sha256": table.job_sha256,
        "machine_sha256": table.machine_sha256,
        **({"began_sha256": table.began_sha256} if table.began_sha256 else {}),
    }


def table_from(
    meta: Any, path: Path, rows: Callable[..., Iterator[TickBlock]], *given: object
) -> TickTable:
    """Return the table with the description and the rows of a file.

    Parameters
    ----------
    meta
        The description from the file.
    path
        The file.
    rows
        Called for each reading with the file and its hash, the number of axes, and the arguments
        ``given``; yields the blocks.

    Raises
    ------
    RecordingError
        If the description is wrong.
    """
    description = checked_meta(_META, meta, path)
    place = Place(str(path))
    if (
        not len(description.axes)
        == len(description.counts_per_unit)
        == len(description.start_counts)
    ):
        raise RecordingError(
            f"the description names {len(description.axes)} axes, "
            f"{len(description.counts_per_unit)} scales "
            f"and {len(description.start_counts)} start positions",
            place=place,
        )
    if len(set(description.axes)) < len(description.axes):
        raise RecordingError("the description names an axis twice", place=place)
    return TickTable(
        clock=Clock(description.clock[0], positive_fraction(description.clock[1], place)),
        axes=description.axes,
        counts_per_unit=np.array(description.counts_per_unit),
        start_counts=np.array(description.start_counts, dtype=np.int64),
        blocks=Stream(rows, KnownFile.of(path), len(description.axes), *given),
        job_sha256=description.job_sha256,
        machine_sha256=description.machine_sha256,
        began_sha256=description.began_sha256,
    )


def checked_rows(table: TickTable, meta: Any, path: Path) -> TickTable:
    """Return ``table`` after checking its rows against their hash in ``meta``.

    A table of an older version has no hash and is not checked.

    Raises
    ------
    RecordingError
        If the hash differs, or a row cannot be read.
    """
    stated = meta.get("rows_sha256")
    if stated is None:
        return table
    actual = table.rows_sha256()
    if actual != stated:
        raise RecordingError(
            f"the rows were changed after writing: their SHA-256 is {actual[:12]}..., the "
            f"file says {stated[:12]}...",
            place=Place(str(path)),
            remedy="Write or fetch it again.",
        )
    return table


def write_table_npz(table: TickTable, path: Path, needle: NeedleSource | None = None) -> Written:
    """Write ``table`` as an archive of columns: ``numpy.load(path)["counts"]`` is (n, axes).

    Only one block is in memory; the columns grow in temporary files beside ``path``.

    Parameters
    ----------
    needle
        Columns of the needle, for a seam. ``needle_down_tick`` and ``needle_down_s`` (time after
        that tick) have a row per needle-down; ``needle_up`` and ``trim`` have a row per tick.
    """
    with atomic_file(path) as file, ColumnSpool(Path(file.name).parent) as spool:
        spool.column("counts", "<i8", (len(table.axes),))
        spool.column("operation", "<i8")
        for name, dtype in _NEEDLE_ARRAYS if needle is not None else ():
            spool.column(name, dtype)
        events, digest = EventSpool(spool), table.rows_hash()
        for block in table:
            digest.add((block.counts, block.operation), block.events)
            spool.append("counts", block.counts)
            spool.append("operation", block.operation)
            events.append(block.events)
            if needle is not None:
                needle_rows = needle.rows(block)
                spool.append("needle_down_tick", block.first_tick + needle_rows.row)
                spool.append("needle_down_s", needle_rows.after_s)
                spool.append("needle_up", needle_rows.up)
                spool.append("trim", needle_rows.trim)
        meta = {**table_meta(table), "rows_sha256": digest.hexdigest()}
        spool.pack(file, {"format": TITLE, **meta, "event_names": events.names})
    return written(path)


def read_table_npz(path: Path) -> TickTable:
    """Read a file that ``write_table_npz`` wrote; the rows stay in the file until they are used.

    Raises
    ------
    RecordingError
        If it is damaged or not a tick table.
    """
    with clear_errors(path), ColumnArchive(path) as archive:
        meta, names = _split_npz_meta(archive.meta(), path)
        table = table_from(meta, path, _npz_blocks, tuple(names))
        # Open every column once, so that a wrong column is found before the table is used.
        _open_npz(archive, names, len(table.axes), path)
        archive.verify()
        return checked_rows(table, meta, path)


def _split_npz_meta(meta: Any, path: Path) -> tuple[dict[str, Any], list[str]]:
    if not isinstance(meta, dict) or meta.pop("format", None) != TITLE:
        raise RecordingError(
            "the archive does not hold a tick table of a known version", place=Place(str(path))
        )
    names = meta.pop("event_names", None)
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise RecordingError("event_names is not a list of names", place=Place(str(path)))
    return meta, names


def _open_npz(
    archive: ColumnArchive, names: Sequence[str], axes: int, path: Path
) -> tuple[Any, Any, EventColumns]:
    counts = archive.column("counts", "<i8", (axes,))
    operation = archive.column("operation", "<i8")
    if counts.rows != operation.rows:
        raise RecordingError(
            f"counts has {counts.rows} rows, operation has {operation.rows}", place=Place(str(path))
        )
    return counts, operation, EventColumns(archive, names, Place(str(path)))


def _npz_blocks(known_file: KnownFile, axes: int, names: tuple[str, ...]) -> Iterator[TickBlock]:
    path = known_file.path
    with reading(known_file), ColumnArchive(path) as archive:
        counts, operation, columns = _open_npz(archive, names, axes, path)
        pending: list[Event] = []
        first, row_count = 0, counts.rows
        for rows in counts.runs(READ_ROWS):
            end = first + len(rows)
            is_last = end == row_count
            while columns.left and (is_last or not pending or pending[-1].tick < end):
                pending += columns.take(4096)
            block_events = [e for e in pending if is_last or e.tick < end]
            pending = pending[len(block_events) :]
            yield TickBlock(
                first_tick=first,
                counts=checked_counts(rows, path),
                operation=operation.take(len(rows)),
                events=tuple(block_events),
            )
            first = end
        if not row_count and columns.left:
            yield empty_block(axes, tuple(columns.take(columns.left)))


def empty_block(axes: int, events: tuple[Event, ...]) -> TickBlock:
    """Return a block without rows that carries events."""
    return TickBlock(
        first_tick=0,
        counts=np.zeros((0, axes), dtype=np.int64),
        operation=np.zeros(0, dtype=np.int64),
        events=events,
    )


def checked_counts(counts: IntArray, path: Path) -> IntArray:
    """Return ``counts``, (n, axes); refuse numbers whose sums could overflow."""
    if counts.size and (np.abs(counts) > 2**40).any():
        raise RecordingError(
            f"a row travels {int(np.abs(counts).max())} counts in one tick",
            place=Place(str(path)),
            remedy="The table is damaged.",
        )
    return counts


def csv_columns(axes: Sequence[str], needle: bool) -> list[str]:
    """Return the names of the columns of a table in CSV."""
    counts = [f"{axis} [count]" for axis in axes]
    return ["tick", *counts, "operation", *(NEEDLE_COLUMNS if needle else ()), "events"]


def write_table_csv(table: TickTable, path: Path, needle: NeedleSource | None = None) -> Written:
    """Write ``table`` as text: comment lines with its description, then one line per tick.

    Parameters
    ----------
    needle
        Columns of the needle, for a seam.
    """
    columns = csv_columns(table.axes, needle is not None)
    period_s = float(table.clock.period_s)
    return write_text(table, path, TITLE, columns, partial(_csv_rows, needle, period_s))


def write_text(
    table: TickTable,
    path: Path,
    title: str,
    columns: list[str],
    lines: Callable[[TickBlock, int], str],
) -> Written:
    """Write ``table`` as text: its description, the columns, the lines of each block, the end.

    The hash of the rows is written into the description last, after all rows.
    """
    with atomic_file(path) as file:
        for line in meta_lines(title, {**table_meta(table), "rows_sha256": "0" * 64}):
            file.write(f"{line}\n".encode())
        hash_at = file.tell() - len('"\n') - 64
        file.write((",".join(columns) + "\n").encode())
        rows, digest = 0, table.rows_hash()
        for block in table:
            digest.add((block.counts, block.operation), block.events)
            file.write(lines(block, len(table.axes)).encode())
            rows += len(block)
        file.write(f"{END}{rows}\n".encode())
        file.seek(hash_at)
        file.write(digest.hexdigest().encode())
    return written(path)


def _csv_rows(needle: NeedleSource | None, period_s: float, block: TickBlock, axes: int) -> str:
    events_by_tick: dict[int, list[Event]] = {}
    for event in block.events:
        events_by_tick.setdefault(event.tick, []).append(event)
    lines = []
    needle_cells = [""] * len(block)
    if needle is not None:
        needle_rows = needle.rows(block)
        needle_cells = [
            f"{needle_rows.cells(row, row + 1, period_s)}," for row in range(len(block))
        ]
    rows = zip(block.counts.tolist(), block.operation.tolist(), needle_cells, strict=True)
    for tick, (counts, operation, needle_cell) in enumerate(rows, start=block.first_tick):
        cell = events_cell(events_by_tick.pop(tick)) if tick in events_by_tick else ""
        lines.append(f"{tick},{','.join(map(str, counts))},{operation},{needle_cell}{cell}\n")
    empty = "," * (axes + 2 + (0 if needle is None else len(NEEDLE_COLUMNS)))
    for tick, events in events_by_tick.items():  # after the last row: no counts, no operation
        lines.append(f"{tick}{empty}{events_cell(events)}\n")
    return "".join(lines)
