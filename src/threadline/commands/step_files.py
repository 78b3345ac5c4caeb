"""Step tables and stitches as a set of files: binary, CSV, and a manifest with their hashes.

``docs/files.md`` describes the files byte by byte for authors of other programs.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from threadline import __version__
from threadline.base.arrays import FloatArray, IntArray
from threadline.base.writing import is_stdout
from threadline.commands.step_tables import shortest_s, steps_residual_m
from threadline.commands.turns import Stitched
from threadline.errors import OptionError, Place, PlanError
from threadline.files import StepPlay
from threadline.files.formats.common import Written, atomic_file, written
from threadline.jobs.embroidery.records import SUFFIXES, UNIT_M, sewn_units
from threadline.jobs.embroidery.t15 import MOST, SUFFIX, t15_bytes
from threadline.jobs.embroidery.tapes import (
    DST,
    DST_MOST,
    FAST,
    MOST_JUMPS,
    SLOW,
    U01,
    dst_bytes,
    u01_bytes,
)

FORMAT = "threadline step tables 1"
_CUTS = ("colour", "trim")
_DESIGNS = {SUFFIX: "a Saurer T15 card", DST: "a DST design", U01: "a U01 design"}
_ROUNDING = 1e-9
TABLES_MAGIC, STITCHES_MAGIC = b"TLSTEPT1", b"TLSTEPS1"


def write_steps(stitched: Stitched, path: Path) -> list[Written]:
    """Write tables and stitches; return the manifest at ``path`` and the files beside it.

    The files beside the manifest have its name: ``NAME.tables.bin``, ``NAME.tables.csv``,
    ``NAME.stitches.bin``, ``NAME.stitches.csv`` and ``NAME.events.csv``.

    Raises
    ------
    RecordingError
        If a file cannot be written.
    """
    commands = stitched.commands
    stem = path.with_suffix("") if path.suffix else path
    left_m = _amplitudes_left_m(stitched)
    content = {
        ".tables.bin": _tables_bytes(commands),
        ".tables.csv": _tables_text(commands, left_m),
        ".stitches.bin": _stitches_bytes(commands),
        ".stitches.csv": _stitches_text(commands),
        ".events.csv": _events_text(stitched),
    }
    files: list[Written] = []
    for ending, parts in content.items():
        beside = stem.with_name(stem.name + ending)
        with atomic_file(beside) as file:
            for part in parts:
                file.write(part)
        facts = table_facts(commands, left_m) if ending == ".tables.csv" else ()
        files.append(replace(written(beside), facts=facts))
    with atomic_file(path) as file:
        file.write(json.dumps(_manifest(stitched, files), indent=1, sort_keys=True).encode())
        file.write(b"\n")
    return [written(path), *files]


def table_facts(commands: StepPlay, residual_m: FloatArray) -> tuple[str, ...]:
    """Return the checked facts of the tables: counts, intervals, ends, and swing from rounding.

    Parameters
    ----------
    residual_m
        (tables, A) amplitudes that the steps of each table leave in the slowest mode, m.

    Raises
    ------
    PlanError
        If the number of steps in a table does not match its length, a step has no interval, or a
        step is due after the window.
    """
    library, timer_s = commands.library, float(commands.clock.period_s)
    per_unit = len(library[0]) // library[0].units
    over = [commands.window_angle - int(table.intervals.sum()) for table in library]
    for table, left in zip(library, over, strict=True):
        if len(table) != per_unit * table.units or table.intervals.min() < 1 or left < 0:
            raise PlanError(
                f"step tables: a table of {table.units} units has {len(table)} steps, the shortest "
                f"interval {table.intervals.min()}, and ends {left} periods before its window",
                remedy="Take a finer timer or a longer window.",
            )
    shortest = min(library, key=lambda table: int(table.intervals.min()))
    interval = int(shortest.intervals.min())
    worst, axis = np.unravel_index(int(np.argmax(residual_m)), residual_m.shape)
    window_s = commands.window_angle * timer_s
    return (
        f"{len(library)} tables of {per_unit} steps a unit, {len(library[0])} to "
        f"{len(library[-1])}, counted by {commands.counted_by}; window {window_s * 1e3:.6g} ms",
        f"shortest interval {interval} periods ({interval * timer_s * 1e6:.4g} us at that speed), "
        f"in the table of {shortest.units} units; the last step is due {min(over)} to {max(over)} "
        "periods before the end of the window",
        f"left swinging after the rounded steps: at most {residual_m[worst, axis] * 1e3:.4g} mm on "
        f"{commands.axes[axis]}, by the table of {library[worst].units} units at that speed",
    )


def write_t15(stitched: Stitched, path: Path) -> Written:
    """Write the design as a Saurer T15 card.

    Raises
    ------
    PlanError
        If a card does not have the units of the design.
    OptionError
        If the file name has the ending of another design format.
    """
    warnings = _check_design(stitched, path, SUFFIX, MOST)
    units = _units_xy(stitched)
    turns = stitched.turns
    changes = {e.tick for e in stitched.turns.events if e.kind == "tool" and e.name in _CUTS}
    with atomic_file(path) as file:
        file.write(t15_bytes(units, turns.moves.needle, changes | {len(turns)}))
    return replace(written(path), warnings=warnings)


def write_dst(stitched: Stitched, path: Path) -> Written:
    """Write the design as DST, as it was read: merged, with its trims and thread changes.

    Raises
    ------
    PlanError
        If DST does not have the units of the design, or it reads back as another design.
    OptionError
        If the file name has the ending of another design format.
    """
    warnings = _check_design(stitched, path, DST, (MOST_JUMPS + 1) * DST_MOST)
    events = _events(stitched)
    needle = stitched.turns.moves.needle
    content = dst_bytes(_units_xy(stitched), needle, events, stitched.job.name)
    names = [name for found in events.values() for name in found]
    if stops := names.count("stop"):
        warnings += (f"{path}: DST has no stops: {stops} are written as thread changes",)
    if paces := names.count(SLOW) + names.count(FAST):
        warnings += (f"{path}: DST has no marks of speed: {paces} are left out",)
    return _write_design(stitched, path, content, DST, warnings)


def write_u01(stitched: Stitched, path: Path) -> Written:
    """Write the design as Barudan's U01, with SLOW and FAST where planned speeds change most.

    A machine has one speed for each mark. A stitch is SLOW if its planned speed is below a
    threshold; the threshold is the one with the shortest total time, if the stitches of each mark
    are sewn at the slowest speed planned for one of them. Marks of the design are replaced.

    Raises
    ------
    PlanError
        If U01 does not have the units of the design, or it reads back as another design.
    OptionError
        If the file name has the ending of another design format.
    """
    warnings = _check_design(stitched, path, U01, MOST)
    turn_s = stitched.turns.turn_s
    slow, facts = two_speeds(turn_s)
    events = _events(stitched)
    for tick, names in events.items():
        events[tick] = [name for name in names if name not in {SLOW, FAST}]
    for turn in np.flatnonzero(np.diff(slow.astype(np.int64), prepend=0)).tolist():
        events.setdefault(turn, []).append(SLOW if slow[turn] else FAST)
    content = u01_bytes(_units_xy(stitched), stitched.turns.moves.needle, events)
    file = _write_design(stitched, path, content, U01, warnings)
    return replace(file, facts=(*file.facts, *facts))


def two_speeds(turn_s: FloatArray) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Return which turns are slow if a machine has two speeds, and the facts about both speeds.

    Parameters
    ----------
    turn_s
        (n,) planned time of each turn, s.
    """
    order = np.sort(turn_s)
    count = np.arange(1, len(order) + 1)
    total = count * order + (len(order) - count) * order[-1]
    fast_s, slow_s = float(order[int(np.argmin(total))]), float(order[-1])
    slow = turn_s > fast_s * (1.0 + _ROUNDING)
    if not slow.any():
        return slow, (f"no SLOW or FAST: {60.0 / slow_s:.4g} stitches a minute for all",)
    return slow, (
        f"SLOW for {int(slow.sum())} of {len(slow)} turns, whose slowest is planned with "
        f"{60.0 / slow_s:.4g} stitches a minute, FAST for the others, planned with at least "
        f"{60.0 / fast_s:.4g}; at those two speeds {float(total.min()):.4g} s, as planned "
        f"{float(turn_s.sum()):.4g} s, all at the slower {len(slow) * slow_s:.4g} s",
    )


def _check_design(stitched: Stitched, path: Path, suffix: str, most: int) -> tuple[str, ...]:
    """Refuse a design that a format cannot hold; return a warning for a name without ending."""
    name, unit_m = _DESIGNS[suffix], stitched.pace.tables.unit.si
    if abs(unit_m / UNIT_M - 1.0) > 1e-9 or stitched.pace.tables.longest_units > most:
        raise PlanError(
            f"{name} is in units of {UNIT_M * 1e3:g} mm and holds {most} in a stitch; the "
            f"machine moves by {unit_m * 1e3:g} mm, {stitched.pace.tables.longest_units} at most",
            place=stitched.machine.place,
            remedy="Take a machine with such units.",
        )
    ending = path.suffix.lower()
    if ending in SUFFIXES and ending != suffix:
        raise OptionError(
            f"{name}, and the name of {str(path)!r} ends in {path.suffix}: a reader would take "
            "it for another format",
            remedy=f"Name it {str(path.with_suffix(suffix))!r}.",
        )
    if ending == suffix or is_stdout(path):
        return ()
    return (f"{path}: {name} is known by the ending {suffix}, which this name has not",)


def _units_xy(stitched: Stitched) -> IntArray:
    """Return the (n, 2) displacements with X first, whatever the order of the machine's axes."""
    return stitched.turns.moves.units[:, [stitched.axes.index(axis) for axis in ("X", "Y")]]


def _events(stitched: Stitched) -> dict[int, list[str]]:
    """Return the names of the events before each turn."""
    found: dict[int, list[str]] = {}
    for event in stitched.turns.events:
        if event.kind == "tool":
            found.setdefault(event.tick, []).append(event.name)
    return found


def _write_design(
    stitched: Stitched, path: Path, content: bytes, suffix: str, warnings: tuple[str, ...]
) -> Written:
    """Write a design that reads back, by the reader of its format, with the same stitches."""
    sewn = np.cumsum(_units_xy(stitched), axis=0)[stitched.turns.moves.needle == 1]
    if not np.array_equal(sewn_units(content, suffix), sewn):
        raise PlanError(
            f"the design reads back from {suffix[1:].upper()} with other stitches",
            place=Place(stitched.job.file),
            remedy="Write another format, and report the design.",
        )
    with atomic_file(path) as file:
        file.write(content)
    fact = f"{len(sewn)} stitches, which read back at the same places"
    return replace(written(path), warnings=warnings, facts=(fact,))


def _manifest(stitched: Stitched, files: Iterable[Written]) -> dict[str, Any]:
    commands = stitched.commands
    period_s = commands.clock.period_s
    return {
        "format": FORMAT,
        "threadline": __version__,
        "job": stitched.job.name,
        "job_sha256": commands.job_sha256,
        "machine": stitched.machine.name,
        "machine_sha256": commands.machine_sha256,
        "law": stitched.law.name,
        "counted_by": commands.counted_by,
        "timer_s": f"{period_s.numerator}/{period_s.denominator}",
        "angles_per_turn": commands.steps_per_turn,
        "angles_of_window": commands.window_angle,
        "axes": list(commands.axes),
        "steps_per_m": commands.steps_per_unit.tolist(),
        "start_steps": commands.start_steps.tolist(),
        "tables": len(commands.library),
        "turns": commands.stitch_count(),
        "duration_ticks": commands.duration_ticks,
        "rows_sha256": commands.rows_sha256(),
        "files": {file.path.name: file.sha256 for file in files},
    }


def _amplitudes_left_m(stitched: Stitched) -> FloatArray:
    """Return the (tables, A) amplitudes that each table's steps leave in the slowest mode, m."""
    commands, pace = stitched.commands, stitched.pace
    period_s = commands.clock.period_s
    window_s = commands.window_angle * period_s
    columns = []
    for modes, scale in zip(pace.modes.values(), commands.steps_per_unit.tolist(), strict=True):
        columns.append(
            [
                max(
                    (steps_residual_m(t, period_s, window_s, 1.0 / scale, m) for m in modes[:1]),
                    default=0.0,
                )
                for t in commands.library
            ]
        )
    return np.array(columns).T


def _tables_bytes(commands: StepPlay) -> Iterator[bytes]:
    yield TABLES_MAGIC + np.array([len(commands.library)], dtype="<u4").tobytes()
    for table in commands.library:
        yield np.array([table.units, len(table)], dtype="<u4").tobytes()
        yield table.intervals.astype("<u4").tobytes()


def _tables_text(commands: StepPlay, residual_m: FloatArray) -> Iterator[bytes]:
    period_s = commands.clock.period_s if commands.counted_by == "time" else Fraction(0)
    names = ",".join(f"residual_{axis}_mm" for axis in commands.axes)
    yield f"units,steps,sum,shortest,shortest_us,{names},intervals\n".encode()
    for table, left in zip(commands.library, residual_m.tolist(), strict=True):
        intervals = " ".join(map(str, table.intervals.tolist()))
        short = f"{shortest_s(table, period_s) * 1e6:.4f}" if period_s else ""
        rest = ",".join(f"{value * 1e3:.6f}" for value in left)
        yield (
            f"{table.units},{len(table)},{table.intervals.sum()},{table.intervals.min()},{short},"
            f"{rest},{intervals}\n"
        ).encode()


def _columns(commands: StepPlay) -> list[tuple[str, str]]:
    """Return name and type of each column of a turn."""
    axes = [
        column
        for axis in commands.axes
        for column in ((f"table_{axis}", "<i4"), (f"sign_{axis}", "<i4"))
    ]
    head = [("begin", "<i8"), ("window", "<i8"), ("start", "<i4"), ("needle", "<i4")]
    return [*head, *axes, ("operation", "<i8")]


def _turns(commands: StepPlay) -> Iterator[np.ndarray[Any, np.dtype[np.void]]]:
    kind = np.dtype(_columns(commands))
    for block in commands:
        rows = np.empty(len(block), dtype=kind)
        for name in ("begin", "window", "start", "needle", "operation"):
            rows[name] = getattr(block, name)
        for k, axis in enumerate(commands.axes):
            rows[f"table_{axis}"], rows[f"sign_{axis}"] = block.table[:, k], block.sign[:, k]
        yield rows


def _stitches_bytes(commands: StepPlay) -> Iterator[bytes]:
    yield STITCHES_MAGIC + np.array([commands.stitch_count()], dtype="<u4").tobytes()
    for rows in _turns(commands):
        yield rows.tobytes()


def _stitches_text(commands: StepPlay) -> Iterator[bytes]:
    yield ("turn," + ",".join(name for name, _ in _columns(commands)) + "\n").encode()
    first = 0
    for rows in _turns(commands):
        lines = (f"{k}," + ",".join(map(str, row)) for k, row in enumerate(rows.tolist(), first))
        yield ("\n".join(lines) + "\n").encode()
        first += len(rows)


def _events_text(stitched: Stitched) -> Iterator[bytes]:
    yield b"turn,kind,name,operation\n"
    for event in stitched.turns.events:
        yield f"{event.tick},{event.kind},{event.name},{event.operation}\n".encode()
