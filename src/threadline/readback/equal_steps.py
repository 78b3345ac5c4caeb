"""Comparison of step tables with a plan, for ``equal``: by ``docs/files.md`` and the motion law.

No code of the writer is used. Each step in the file has a time and a place. The plan's place at
that time follows from the design and the motion law s: after the share u of its window, a move of n
steps is at n s(u), and its step j is due where n s(u) is j.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.commands.turns import Stitched
from threadline.motion.laws import Law
from threadline.readback.equal_found import (
    MOST_BYTES,
    Curve,
    Found,
    of_another,
    refusing,
    thinned,
    whole_fraction,
)

STEPS = 1.0
"""Steps by which a place may differ from the plan's."""
PERIODS = 1.0
"""Counts of an interval by which a step may come earlier or later than by the law: periods of the
timer, or parts of the shaft's turn where intervals are counted by angle."""
_READER = "a decoder of docs/files.md"
_MOST = 1 << 28
_GRID = 20_000  # finds a step within a thousandth of a count


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Read:
    """The files of a set of step tables: n turns, A axes."""

    meta: Mapping[str, Any]
    units: IntArray
    tables: list[IntArray]
    begin: IntArray
    window: IntArray
    start: IntArray
    needle: IntArray
    operation: IntArray
    table: IntArray
    sign: IntArray
    wrong: list[str]


def compare_steps(stitched: Stitched, path: Path) -> Found:
    """Compare the step tables of a manifest with a plan, step by step.

    Raises
    ------
    RecordingError
        If the manifest or one of its files is not valid, is missing, or belongs to another job or
        machine file.
    """
    commands = stitched.commands
    with refusing("set of step tables", "steps", path):
        meta = _manifest(path)
        for key, kind in (("job_sha256", "job"), ("machine_sha256", "machine file")):
            planned = getattr(commands, key)
            if meta[key] != planned:
                raise of_another(kind, meta[key], planned, path)
        if meta["axes"] != list(commands.axes):
            raise ValueError(
                f"it has the axes {str(meta['axes'])[:40]}, the plan {list(commands.axes)}"
            )
        read = _read(path, meta)
        wrong = _manifest_faults(stitched, read)
    return _compared(stitched, read, wrong)


def _manifest(path: Path) -> Mapping[str, Any]:
    text = path.read_text(encoding="utf-8")
    if not text.strip():
        raise ValueError("it is empty")
    meta = json.loads(text)
    if not isinstance(meta, dict) or meta.get("format") != "threadline step tables 1":
        raise ValueError("its format is not 'threadline step tables 1'")
    return meta


def _read(path: Path, meta: Mapping[str, Any]) -> _Read:
    faults = list[str]()
    contents = {}
    for name, digest in meta["files"].items():
        if Path(name).name != name:
            raise ValueError(f"it names {name[:60]!r}, which is not beside it")
        content = _file_beside(path, name)
        if hashlib.sha256(content).hexdigest() != digest:
            faults.append(f"{name} is not the file of the manifest: its SHA-256 is another one")
        contents[name.partition(".")[2] if name.startswith(path.stem) else name] = content
    kinds = {}
    for kind in ("tables.bin", "tables.csv", "stitches.bin", "stitches.csv"):
        kinds[kind] = next(
            (file_content for name, file_content in contents.items() if name.endswith(kind)), b""
        )
        if not kinds[kind]:
            raise ValueError(f"it names no NAME.{kind} with anything in it")
    axes = list(meta["axes"])
    units, tables = _tables(kinds["tables.bin"])
    rows = _stitches(kinds["stitches.bin"], len(axes))
    faults += _text_faults(kinds, units, tables, rows)
    columns = {name: rows[name].astype(np.int64) for name in rows.dtype.names or ()}
    return _Read(
        meta=meta, units=units, tables=tables, wrong=faults,
        table=np.column_stack([columns[f"table{k}"] for k in range(len(axes))]),
        sign=np.column_stack([columns[f"sign{k}"] for k in range(len(axes))]),
        **{name: columns[name] for name in ("begin", "window", "start", "needle", "operation")},
    )  # fmt: skip


def _file_beside(path: Path, name: str) -> bytes:
    file = path.with_name(name)
    if not file.is_file():
        raise ValueError(f"{name} is missing beside it")
    if file.stat().st_size > MOST_BYTES:
        raise ValueError(f"{name} is larger than 1 GB")
    return file.read_bytes()


def _tables(content: bytes) -> tuple[IntArray, list[IntArray]]:
    if content[:8] != b"TLSTEPT1":
        raise ValueError("its tables do not begin with TLSTEPT1")
    (count,), offset = struct.unpack_from("<I", content, 8), 12
    units, tables = [], []
    for number in range(count):
        unit, steps = struct.unpack_from("<II", content, offset)
        offset += 8
        if offset + 4 * steps > len(content):
            raise ValueError(f"its tables end in the middle of table {number}: the file was cut")
        tables.append(np.frombuffer(content, "<u4", steps, offset).astype(np.int64))
        units.append(unit)
        offset += 4 * steps
    if not tables:
        raise ValueError("it has no tables")
    if offset != len(content):
        raise ValueError(f"its tables have {len(content) - offset} bytes after the last table")
    return np.array(units, dtype=np.int64), tables


def _stitches(content: bytes, axes: int) -> np.ndarray[Any, np.dtype[np.void]]:
    if content[:8] != b"TLSTEPS1":
        raise ValueError("its stitches do not begin with TLSTEPS1")
    (count,) = struct.unpack_from("<I", content, 8)
    fields = [("begin", "<i8"), ("window", "<i8"), ("start", "<i4"), ("needle", "<i4")]
    for k in range(axes):
        fields += [(f"table{k}", "<i4"), (f"sign{k}", "<i4")]
    kind = np.dtype([*fields, ("operation", "<i8")])
    if len(content) != 12 + count * kind.itemsize or count > _MOST:
        raise ValueError(f"its stitches are not {count} turns of {kind.itemsize} bytes")
    return np.frombuffer(content, kind, count, 12)


def _text_faults(
    kinds: Mapping[str, bytes],
    units: IntArray,
    tables: list[IntArray],
    rows: np.ndarray[Any, np.dtype[np.void]],
) -> list[str]:
    """Return how the texts differ from the binary files."""
    faults = []
    lines = list(csv.DictReader(io.StringIO(kinds["tables.csv"].decode())))
    text_tables = [(int(line["units"]), *map(int, line["intervals"].split())) for line in lines]
    binary_tables = [(int(u), *t.tolist()) for u, t in zip(units, tables, strict=True)]
    if text_tables != binary_tables:
        number = _first_other(text_tables, binary_tables)
        faults.append(f"table {number} of the text is not table {number} of the binary file")
    turns = [
        tuple(map(int, row))[1:]
        for row in csv.reader(io.StringIO(kinds["stitches.csv"].decode()))
        if row and row[0] != "turn"
    ]
    rows_held = [tuple(row) for row in rows.tolist()]
    if turns != rows_held:
        number = _first_other(turns, rows_held)
        faults.append(f"turn {number} of the text is not turn {number} of the binary file")
    return faults


def _first_other(first_list: Sequence[object], second_list: Sequence[object]) -> int:
    """Return the first place at which two lists differ."""
    pairs = enumerate(zip(first_list, second_list, strict=False))
    return next((k for k, (a, b) in pairs if a != b), min(len(first_list), len(second_list)))


def _compared(stitched: Stitched, read: _Read, heads: Sequence[str]) -> Found:
    commands, turns = stitched.commands, stitched.turns
    period_s = float(commands.clock.period_s)
    faults = [*read.wrong, *heads]
    count = min(len(turns), len(read.begin))
    if len(read.begin) != len(turns):
        faults.append(f"{len(read.begin)} turns, the plan has {len(turns)}")
    for name, planned_values in (("needle", turns.moves.needle), ("operation", turns.operation)):
        differing = np.flatnonzero(getattr(read, name)[:count] != planned_values[:count])
        if len(differing):
            faults.append(f"another {name} in turn {differing[0]}")
    steps = turns.moves.units[:count] * stitched.steps_per_unit
    counted = turns.window[:count] / commands.window_angle if commands.counted_by == "angle" else 1
    one_count = np.maximum(np.ones(count), counted)  # in periods of the timer
    late_counts = _late_windows(stitched, read, count) / one_count
    places = [f"turn {k}" for k in range(count)]
    off_steps = np.zeros((count, len(commands.axes)))
    shift = np.zeros((count, len(commands.axes)), dtype=np.int64)
    by_law = _ByLaw(stitched.law, commands.window_angle)
    moves = (read.table[:count] >= 0) | (steps != 0)
    for turn, axis in zip(*(column.tolist() for column in np.nonzero(moves)), strict=True):
        number = int(read.table[turn, axis])
        if number >= len(read.tables):
            faults.append(f"turn {turn} asks for table {number} of {len(read.tables)}")
            break
        planned_values = read.tables[number] if number >= 0 else read.tables[0][:0]
        shift[turn, axis] = int(read.sign[turn, axis]) * len(planned_values) - int(
            steps[turn, axis]
        )
        if not shift[turn, axis] and len(planned_values):
            off_steps[turn, axis], counts, step = by_law.off(number, planned_values)
            if counts > late_counts[turn]:
                late_counts[turn], places[turn] = (
                    counts,
                    f"turn {turn}, step {step} of table {number}",
                )
    off_steps = np.maximum(off_steps, np.abs(np.cumsum(shift, axis=0)))
    turn, axis = divmod(int(np.argmax(off_steps)), off_steps.shape[1]) if off_steps.size else (0, 0)
    slowest = int(np.argmax(late_counts)) if count else 0
    place = float(off_steps[turn, axis]) if off_steps.size else 0.0
    lateness_s: FloatArray = np.asarray(late_counts * one_count * period_s, dtype=np.float64)
    begin_s: FloatArray = np.asarray(turns.begin[:count] * period_s, dtype=np.float64)
    largest: FloatArray = np.asarray(off_steps.max(axis=1, initial=0.0), dtype=np.float64)
    times, worst, slow = thinned(begin_s, largest, lateness_s)
    return Found(
        reader=_READER,
        place=place,
        place_limit=STEPS,
        unit="step",
        axis=commands.axes[axis],
        tool_m=place / float(commands.steps_per_unit[axis]),
        time_s=float(lateness_s[slowest]) if count else 0.0,
        time_limit_s=PERIODS * period_s * float(one_count[slowest]) if count else period_s,
        at=f"turn {turn}" if place > STEPS else places[slowest] if count else "",
        wrong="; ".join(dict.fromkeys(faults)),
        curve=Curve(time_s=times, place=worst, late_s=slow),
    )


def _late_windows(stitched: Stitched, read: _Read, count: int) -> FloatArray:
    """Return (n,) periods by which begin or end of a window, or its angle, differ at most."""
    turns = stitched.turns
    begin = np.abs(read.begin[:count] - turns.begin[:count])
    read_end = (read.begin + read.window)[:count]
    end = np.abs(read_end - (turns.begin + turns.window)[:count])
    periods: FloatArray = (np.maximum(begin, end) + np.abs(read.start[:count])).astype(np.float64)
    return periods


class _ByLaw:
    """Compares the steps of tables with a motion law, which is interpolated on a fine grid."""

    def __init__(self, law: Law, window: int) -> None:
        self._share = np.linspace(0.0, 1.0, _GRID + 1)
        self._risen = np.maximum.accumulate(law(self._share))
        self._window = window
        self._known: dict[int, tuple[float, float, int]] = {}

    def off(self, number: int, intervals: IntArray) -> tuple[float, float, int]:
        """Return a table's largest difference from the law: steps, counts, and step of the counts.

        The counts are counts of an interval. At step j the table is at j, and the law at n times
        its rise.
        """
        if number not in self._known:
            n, ticks = len(intervals), np.cumsum(intervals)
            order = np.arange(1, n + 1)
            window_share = np.clip(ticks / self._window, 0.0, 1.0)
            off_steps = np.abs(n * np.interp(window_share, self._share, self._risen) - order)
            due_counts: FloatArray = np.interp(order / n, self._risen, self._share) * self._window
            counts_apart = np.abs(due_counts - ticks)
            step = int(np.argmax(counts_apart))
            self._known[number] = float(off_steps.max()), float(counts_apart[step]), step + 1
        return self._known[number]


def _manifest_faults(stitched: Stitched, read: _Read) -> list[str]:
    """Return how the manifest differs from the plan."""
    commands, faults = stitched.commands, []
    planned: dict[str, Any] = {
        "axes": list(commands.axes),
        "counted_by": commands.counted_by,
        "angles_of_window": commands.window_angle,
        "angles_per_turn": commands.steps_per_turn,
        "steps_per_m": commands.steps_per_unit.tolist(),
        "start_steps": commands.start_steps.tolist(),
        "duration_ticks": commands.duration_ticks,
        "turns": len(stitched.turns),
        "tables": len(read.tables),
        "law": stitched.law.name,
    }
    if whole_fraction(read.meta["timer_s"]) != commands.clock.period_s:
        faults.append(f"timer_s is {read.meta['timer_s']}, the plan has {commands.clock.period_s}")
    faults += [
        f"{key} is {str(read.meta[key])[:40]}, the plan has {str(value)[:40]}"
        for key, value in planned.items()
        if read.meta[key] != value
    ]
    per_unit = stitched.steps_per_unit
    wrong_length = [k for k, t in enumerate(read.tables) if len(t) != per_unit * int(read.units[k])]
    if wrong_length:
        faults.append(
            f"table {wrong_length[0]} has {len(read.tables[wrong_length[0]])} steps for its units"
        )
    return faults
