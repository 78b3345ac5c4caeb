"""Comparison of tick tables with a plan, for ``equal``: by csv, json and numpy, not ``files/``."""

from __future__ import annotations

import csv
import json
import math
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.arrays import IntArray
from threadline.commands.plan import Plan
from threadline.errors import Place, RecordingError
from threadline.files.commands import tick_table
from threadline.readback.equal_found import (
    MOST_BYTES,
    Curve,
    Found,
    of_another,
    refusing,
    thinned,
    whole_fraction,
)

_READ_BY = {"csv": "csv and json", "npz": "numpy and json", "ticks": "whole numbers, and json"}
_MOST_COUNTS = 1 << 40  # of a tick: sums over all ticks of a table stay whole
_LONGER, _MORE = 2, 1000  # a table may have twice the ticks of the plan, and 1000 more
_HEADERS = {
    (1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0,
}  # fmt: skip
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


def compare_table(target: str, plan: Plan, path: Path) -> Found:
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
    blocks = list(planned)
    counts = np.concatenate([block.counts for block in blocks])
    operation = np.concatenate([block.operation for block in blocks])
    period = planned.clock.period_s

    def check(meta: Mapping[str, Any]) -> int:
        """Refuse the table of another plan; return how many ticks are read at most."""
        for key, kind in (("job_sha256", "job"), ("machine_sha256", "machine file")):
            planned_hash = getattr(planned, key)
            if meta.get(key) != planned_hash:
                raise of_another(kind, meta.get(key), planned_hash, path)
        if list(meta["axes"]) != list(planned.axes):
            raise RecordingError(
                f"the table has the axes {str(meta['axes'])[:60]}, the plan {list(planned.axes)}",
                place=Place(str(path)),
                remedy="Name the machine that it was written for.",
            )
        return _LONGER * len(counts) + _MORE

    with refusing(f"table of target {target}", target, path):
        table = _READERS[target](path, check)
        meta = table.meta
        start = np.array(_counts(meta["start_counts"], len(planned.axes)), dtype=np.int64)
        stated_s = whole_fraction(meta["clock"][1]) * len(table.counts)
        per_unit = list(meta["counts_per_unit"])
    rows = min(len(counts), len(table.counts))
    notes = []
    if per_unit != planned.counts_per_unit.tolist():
        notes.append("other counts_per_unit in the head of the file")
    if meta.get("rows_sha256", "") != planned.rows_sha256():
        notes.append("other rows_sha256 in the head of the file")
    off_counts = np.abs(
        np.cumsum(table.counts[:rows] - counts[:rows], axis=0)
        + (start - planned.start_counts)[None]
    )
    at, worst, axis_name = "", 0, ""
    if rows and off_counts.any():
        worst = int(off_counts.max())
        begins, axis = np.argwhere(off_counts > 0)[0]
        axis_name = planned.axes[int(np.argmax(off_counts.max(axis=0)))]
        at = f"from line {table.line[begins]}, {planned.axes[axis]}"
    if len(counts) != len(table.counts):
        notes.append(f"{len(table.counts)} ticks, the plan has {len(counts)}")
    other_rows = np.flatnonzero(operation[:rows] != table.operation[:rows])
    if len(other_rows):
        notes.append(f"another operation in line {table.line[other_rows[0]]}")
    radii = plan.machine.radius_m[[plan.machine.axis_names.index(a) for a in planned.axes]]
    at_tool = np.linalg.norm(off_counts / planned.counts_per_unit * radii, axis=1)
    largest = np.asarray(off_counts.max(axis=1, initial=0), dtype=np.float64)
    times, thinned_counts = thinned(np.arange(1, rows + 1) * np.float64(period), largest)
    return Found(
        reader=_READ_BY[target],
        place=float(worst),
        place_limit=0.0,
        unit="count",
        axis=axis_name,
        tool_m=float(at_tool.max(initial=0.0)),
        time_s=float(stated_s - period * len(counts)),
        time_limit_s=0.0,
        at=at,
        wrong="; ".join(notes),
        curve=Curve(time_s=times, place=thinned_counts),
    )


Check = Callable[[Mapping[str, Any]], int]
"""Refuses the head of another plan's table, and returns how many ticks are read at most."""


def _counts(numbers: object, axes: int) -> Sequence[int]:
    """Return one whole number for each axis, small enough to add up.

    Raises
    ------
    ValueError
        If ``numbers`` is anything else.
    """
    if not isinstance(numbers, list) or len(numbers) != axes:
        raise ValueError(f"{str(numbers)[:40]!r} is not one count for each of {axes} axes")
    for number in numbers:
        if type(number) is not int or abs(number) > _MOST_COUNTS:
            raise ValueError(f"{str(number)[:40]!r} is no count from -2**40 to 2**40")
    return numbers


def _too_long(most: int) -> ValueError:
    return ValueError(f"it has more than {most} ticks, far more than the plan")


def _read_csv(path: Path, check: Check) -> ReadTable:
    meta, rows = _text_table(path, "csv")
    most_ticks, axes = check(meta), len(meta["axes"])
    counts: list[Sequence[int]] = []
    operation: list[int] = []
    lines: list[int] = []
    for number, cells in rows:
        if cells[1]:
            counts.append(_counts([int(cell) for cell in cells[1 : 1 + axes]], axes))
            operation.append(int(cells[1 + axes]))
            lines.append(number)
            if len(counts) > most_ticks:
                raise _too_long(most_ticks)
            if int(cells[0]) != len(counts) - 1:
                raise ValueError(f"line {number}: tick {cells[0]}, expected {len(counts) - 1}")
    return _table(meta, counts, operation, lines)


def _read_ticks(path: Path, check: Check) -> ReadTable:
    """Read a trajectory array by its formula in ``docs/files.md``, in whole numbers."""
    meta, rows = _text_table(path, "ticks")
    most_ticks, axes = check(meta), len(meta["axes"])
    counts: list[Sequence[int]] = []
    operation: list[int] = []
    lines: list[int] = []
    for number, cells in rows:
        ticks = int(cells[0])
        if ticks == 0:
            continue
        if ticks < 0:
            raise ValueError(f"line {number}: {ticks} ticks")
        if ticks > most_ticks - len(counts):
            raise _too_long(most_ticks)
        numbers = _counts([int(cell) for cell in cells[1 : 1 + 3 * axes]], 3 * axes)
        triples = list(zip(numbers[0::3], numbers[1::3], numbers[2::3], strict=True))
        for k in range(ticks):
            counts.append(
                [v + (h + (k + 1) * r) // ticks - (h + k * r) // ticks for v, r, h in triples]
            )
        operation += [int(cells[1 + 3 * axes])] * ticks
        lines += [number] * ticks
    return _table(meta, counts, operation, lines)


def _table(
    meta: Mapping[str, Any], counts: list[Sequence[int]], operation: list[int], lines: list[int]
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


def _read_npz(path: Path, check: Check) -> ReadTable:
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            if member.file_size > MOST_BYTES:
                raise ValueError(f"its {member.filename[:40]!r} is larger than 1 GB")
        meta = json.loads(archive.read("meta.json"))
        check(meta)
        counts, operations = _array(archive, "counts.npy"), _array(archive, "operation.npy")
    if operations.ndim != 1 or counts.shape != (len(operations), len(meta["axes"])):
        raise ValueError(
            f"its counts have the shape {counts.shape}, its operations {operations.shape}"
        )
    if counts.size and (counts.max() > _MOST_COUNTS or counts.min() < -_MOST_COUNTS):
        raise ValueError("it has counts beyond -2**40 to 2**40")
    return ReadTable(
        meta=meta, counts=counts, operation=operations, line=np.arange(len(counts), dtype=np.int64)
    )


def _array(archive: zipfile.ZipFile, name: str) -> IntArray:
    """Return an array of whole numbers, as long as the archive says that it is."""
    with archive.open(name) as file:
        version = np.lib.format.read_magic(file)
        if version not in _HEADERS:
            raise ValueError(f"its {name} is of version {version}")
        shape, _, kind = _HEADERS[version](file)
        if kind != np.dtype("<i8"):
            raise ValueError(f"its {name} holds {kind}, not int64")
        if math.prod(shape) * kind.itemsize > archive.getinfo(name).file_size:
            raise ValueError(f"its {name} is shorter than it says")
    with archive.open(name) as file:
        array: IntArray = np.lib.format.read_array(file, allow_pickle=False)
    return array


_READERS: Mapping[str, Callable[[Path, Check], ReadTable]] = {
    "csv": _read_csv, "ticks": _read_ticks, "npz": _read_npz,
}  # fmt: skip
