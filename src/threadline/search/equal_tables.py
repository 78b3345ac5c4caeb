"""Tick tables read for ``equal``: by csv, json and numpy alone, without the readers of `files/`."""

from __future__ import annotations

import csv
import json
import zipfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, cast

import numpy as np

from threadline.base.arrays import IntArray
from threadline.commands.plan import Plan
from threadline.errors import Place, RecordingError
from threadline.files.commands import tick_table

_TITLES = {
    "csv": "# threadline tick-table 1",
    "ticks": "# threadline trajectory-array 1",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadTable:
    """A tick table as a plain reader finds it.

    Parameters
    ----------
    meta
        Description at the head of the file.
    counts
        (n, axes) counts of each tick.
    operation
        (n,) operation of each tick.
    line
        (n,) line of the file for each tick; the row for an archive.
    """

    meta: Mapping[str, Any]
    counts: IntArray
    operation: IntArray
    line: IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class TableDifference:
    """Differences between a table and its plan: counts, time in s, and where the worst is."""

    counts: int
    time_s: float
    at: str
    note: str


def compare_table(target: str, plan: Plan, path: Path) -> TableDifference:
    """Compare the table in a file with the commands of ``plan``, tick by tick.

    Parameters
    ----------
    target
        ``csv``, ``npz`` or ``ticks``.

    Raises
    ------
    RecordingError
        If the file is no such table, or was written for another job or machine.
    """
    planned = tick_table(plan.commands)
    found = _READERS[target](path)
    meta = found.meta
    for key, what in (("job_sha256", "job"), ("machine_sha256", "machine file")):
        wanted = getattr(planned, key)
        if meta.get(key) != wanted:
            raise RecordingError(
                f"the table was written for another {what}: it names {str(meta.get(key))[:12]}, "
                f"this one is {wanted[:12]}",
                place=Place(str(path)),
                remedy=f"Name the {what} that it was written for.",
            )
    blocks = list(planned)
    counts = np.concatenate([block.counts for block in blocks])
    operation = np.concatenate([block.operation for block in blocks])
    period = planned.clock.period_s
    rows = min(len(counts), len(found.counts))
    notes = []
    if list(meta.get("axes", ())) != list(planned.axes):
        raise RecordingError(
            f"the table has the axes {meta.get('axes')}, the plan {list(planned.axes)}",
            place=Place(str(path)),
            remedy="Name the machine that it was written for.",
        )
    if list(meta.get("counts_per_unit", ())) != planned.counts_per_unit.tolist():
        notes.append("other counts_per_unit in the head of the file")
    if meta.get("rows_sha256", "") != planned.rows_sha256():
        notes.append("other rows_sha256 in the head of the file")
    start = np.array(meta.get("start_counts", ()), dtype=np.int64)
    off = np.abs(
        np.cumsum(found.counts[:rows] - counts[:rows], axis=0)
        + (start - planned.start_counts)[None]
    )
    at, worst = "", 0
    if rows and off.any():
        worst = int(off.max())
        begins, axis = np.argwhere(off > 0)[0]
        at = f"from line {found.line[begins]}, {planned.axes[axis]}"
    if len(counts) != len(found.counts):
        notes.append(f"{len(found.counts)} ticks, the plan has {len(counts)}")
    other = np.flatnonzero(operation[:rows] != found.operation[:rows])
    if len(other):
        notes.append(f"another operation in line {found.line[other[0]]}")
    told_s = _fraction(meta["clock"][1], path) * len(found.counts)
    return TableDifference(
        counts=worst,
        time_s=float(told_s - period * len(counts)),
        at=at,
        note="; ".join(notes),
    )


def _read_csv(path: Path) -> ReadTable:
    meta, rows = _text_table(path, "csv")
    axes = len(meta["axes"])
    counts, operation, lines = [], [], []
    for number, cells in rows:
        if cells[1]:
            counts.append([int(cell) for cell in cells[1 : 1 + axes]])
            operation.append(int(cells[1 + axes]))
            lines.append(number)
            if int(cells[0]) != len(counts) - 1:
                raise ValueError(f"line {number}: tick {cells[0]}, expected {len(counts) - 1}")
    return _table(meta, counts, operation, lines)


def _read_ticks(path: Path) -> ReadTable:
    """Read a trajectory array by its formula in ``docs/files.md``, in whole numbers."""
    meta, rows = _text_table(path, "ticks")
    axes = len(meta["axes"])
    counts: list[list[int]] = []
    operation: list[int] = []
    lines: list[int] = []
    for number, cells in rows:
        span = int(cells[0])
        if span == 0:
            continue
        numbers = [int(cell) for cell in cells[1 : 1 + 3 * axes]]
        triples = list(zip(numbers[0::3], numbers[1::3], numbers[2::3], strict=True))
        for k in range(span):
            counts.append(
                [v + (h + (k + 1) * r) // span - (h + k * r) // span for v, r, h in triples]
            )
        operation += [int(cells[1 + 3 * axes])] * span
        lines += [number] * span
    return _table(meta, counts, operation, lines)


def _table(
    meta: Mapping[str, Any], counts: list[list[int]], operation: list[int], lines: list[int]
) -> ReadTable:
    return ReadTable(
        meta=meta,
        counts=np.array(counts, dtype=np.int64).reshape(-1, len(meta["axes"])),
        operation=np.array(operation, dtype=np.int64),
        line=np.array(lines, dtype=np.int64),
    )


def _text_table(path: Path, target: str) -> tuple[Mapping[str, Any], Iterator[tuple[int, Any]]]:
    """Return the description of a text table, and its numbered rows as cells."""
    lines = path.read_text(encoding="utf-8").splitlines()
    if not lines or lines[0] != _TITLES[target]:
        raise ValueError(f"its first line is not {_TITLES[target]!r}")
    meta: dict[str, Any] = {}
    head = 1
    while head < len(lines) and lines[head].startswith("# "):
        key, _, value = lines[head][2:].partition(": ")
        meta[key] = json.loads(value)
        head += 1
    if not lines[-1].startswith("# end after ticks: "):
        raise ValueError("its last line is missing: the file was cut off")
    body = lines[head + 1 : -1]
    rows = csv.reader(body)
    return meta, ((head + 2 + k, cells) for k, cells in enumerate(rows))


def _read_npz(path: Path) -> ReadTable:
    with zipfile.ZipFile(path) as archive:
        meta = json.loads(archive.read("meta.json"))
        with archive.open("counts.npy") as counts, archive.open("operation.npy") as operation:
            read = cast(IntArray, np.lib.format.read_array(counts, allow_pickle=False))
            owned = cast(IntArray, np.lib.format.read_array(operation, allow_pickle=False))
    if read.shape != (len(owned), len(meta["axes"])):
        raise ValueError(f"its counts have the shape {read.shape}")
    return ReadTable(
        meta=meta, counts=read, operation=owned, line=np.arange(len(read), dtype=np.int64)
    )


def _refusing(target: str, read: Callable[[Path], ReadTable]) -> Callable[[Path], ReadTable]:
    """Return a reader whose faults are told in one line."""

    def reader(path: Path) -> ReadTable:
        try:
            return read(path)
        except (
            ValueError, KeyError, IndexError, TypeError, EOFError, zipfile.BadZipFile,
        ) as error:  # fmt: skip
            told = " ".join(str(error).split())[:120]
            raise RecordingError(
                f"the file is no table of target {target}: {told}",
                place=Place(str(path)),
                remedy=f"Give a file that compile --target {target} wrote.",
            ) from error

    return reader


def _fraction(text: str, path: Path) -> Fraction:
    try:
        return Fraction(text)
    except (ValueError, ZeroDivisionError, TypeError) as error:
        raise RecordingError(
            f"the period {str(text)[:40]!r} is no time", place=Place(str(path))
        ) from error


_READERS: Mapping[str, Callable[[Path], ReadTable]] = {
    "csv": _refusing("csv", _read_csv),
    "ticks": _refusing("ticks", _read_ticks),
    "npz": _refusing("npz", _read_npz),
}
