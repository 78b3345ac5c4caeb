"""Tables of axis values as jobs: a row is the position of the axes, with its time or its feed.

The first row names the columns, with their unit: ``time [s], A [deg], X [mm]``, or as planners of
fibre paths write it, ``A_deg,X_mm,F_mm_min,tension_N``. ``time`` (or ``t``) is the time of the row,
``F`` the feed of the move to it; a table has one of the two. Every other column that is no
axis of the machine becomes a tag of its moves. The job begins at the first row. Separators are
commas, semicolons or tabs; a row that begins with # is a comment.
"""

from __future__ import annotations

import csv
import hashlib
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray, IntArray
from threadline.base.reading import open_binary
from threadline.errors import BudgetError, JobError, Place, UnitError
from threadline.files import Stream
from threadline.geometry.strokes import decode_text
from threadline.jobs.gcode.dialects import DIALECTS
from threadline.jobs.gcode.feeds import FRule, f_rule
from threadline.jobs.gcode.foreign import LETTERS, letters_of
from threadline.jobs.operations import (
    Dwell,
    Feed,
    FeedMode,
    Job,
    MoveRun,
    Operation,
    OperationStream,
    Source,
)
from threadline.machine import Machine
from threadline.units import unit_factor

_CELL = re.compile(r"([A-Za-z]+)(?:\s*[\[(]\s*([^\])]+?)\s*[\])]|_([A-Za-z]+(?:_[A-Za-z]+)?))?")
_TIMES, _FEEDS = ("T", "TIME"), ("F", "FEED")
_DRAWING_COLUMNS = frozenset(("X", "Y", "CX", "CY", "BULGE", "TURN", "LAYER"))
_EXAMPLE = 'Begin the table with a row like "time [s], A [deg], X [mm]" or "A_deg,X_mm,F_mm_min".'
_MOST_BYTES = 1 << 28
_LONGEST_RUN = 4096
_HEAD_BYTES = 4096

AXIS_TABLE_OPTIONS = ("feed_mode", "base_axes", "axes")
"""Options that ``read_axis_table`` takes."""


def is_axis_table(path: Path) -> bool:
    """Return whether the first row of a table names times, feeds, or axes that no drawing has."""
    if path.is_dir():
        return False
    with open_binary(path) as stream:
        head = stream.read(_HEAD_BYTES).decode("utf-8-sig", "replace")
    names = {name for name, _ in _columns(head)}
    return bool(names & {*_TIMES, *_FEEDS}) or any(
        len(name) == 1 and name in LETTERS for name in names - _DRAWING_COLUMNS
    )


def _columns(text: str) -> list[tuple[str, str]]:
    """Return name (capital letters) and unit of every column; a name may be empty."""
    for line in text.splitlines():
        if line.strip() and not line.lstrip().startswith("#"):
            columns = []
            for cell in re.split(r"[;\t]|,(?![^\[(]*[\])])", line):
                match = _CELL.fullmatch(cell.strip())
                unit = (match[2] or (match[3] or "").replace("_", "/")) if match else ""
                columns.append((match[1].upper() if match else "", unit))
            return columns
    return []


@dataclass(frozen=True, slots=True, eq=False)
class AxisTable:
    """A checked table of axis values.

    Parameters
    ----------
    file
        Path of the file.
    line
        (n,) line of each row.
    position
        (n, axes) positions in m or rad.
    feeds
        Feed of each row but the first; rows with equal feeds share one object.
    duration_s
        (n - 1,) times between rows, s; empty in a table with feeds.
    tags
        Name and (n,) values of every other column.
    """

    file: str
    line: IntArray
    position: FloatArray
    feeds: tuple[Feed, ...]
    duration_s: FloatArray
    tags: tuple[tuple[str, FloatArray], ...]

    def runs(self) -> Iterator[Operation | MoveRun]:
        """Yield the moves from the first row to the last, and a rest where no axis moves."""
        at_rest = np.all(np.diff(self.position, axis=0) == 0.0, axis=1)
        ends = np.flatnonzero(at_rest) if len(self.duration_s) else np.empty(0, np.int64)
        begin = 0
        for end in (*ends.tolist(), len(at_rest)):
            for first in range(begin, end, _LONGEST_RUN):
                yield self._run(first, min(end, first + _LONGEST_RUN))
            if end < len(at_rest):
                place = Source(self.file, int(self.line[end + 1]))
                yield Dwell(float(self.duration_s[end]), place)
            begin = end + 1

    def _run(self, begin: int, end: int) -> MoveRun:
        feeds: list[tuple[int, Feed | None]] = []
        for index, feed in enumerate(self.feeds[begin:end]):
            if not feeds or feed is not feeds[-1][1]:
                feeds.append((index, feed))
        rows = slice(begin + 1, end + 1)
        return MoveRun(
            targets=self.position[rows],
            line=self.line[rows],
            feeds=tuple(feeds),
            file=self.file,
            passes=(),
            columns={name: values[rows] for name, values in self.tags},
        )


def read_axis_table(
    path: str | Path,
    *,
    machine: Machine,
    feed_mode: str | None = None,
    base_axes: tuple[str, ...] = (),
    axes: str | None = None,
) -> Job:
    """Return the job of a table of axis values.

    Parameters
    ----------
    path
        The table (``.csv``).
    machine
        Machine whose axes the table names.
    feed_mode, base_axes
        Rule for the meaning of the column F; None: the machine file's rule, else its dialect's.
    axes
        Axes of the machine for letters of the table, such as ``"C=A,Z=X"`` (the table's C is the
        machine's A); None: axes with the same letters.

    Raises
    ------
    JobError
        If it is no such table, or names an axis that the machine lacks; the error names the line.
    BudgetError
        If it has more rows than the machine's tick budget.
    OptionError
        If the options do not fit the machine.
    """
    path = Path(path)
    place = Place(str(path))
    content = _content(path)
    text = decode_text(content, str(path), "table")
    columns = _columns(text)
    line, values = _numbers(text, len(columns), str(path))
    if len(values) < 2:
        raise JobError("the table has fewer than two rows", place=place, remedy=_EXAMPLE)
    _check_budget(len(values), machine, place)
    names = [name for name, _ in columns]
    if len(set(filter(None, names))) < len([name for name in names if name]):
        raise JobError("two columns have the same name", place=place, remedy=_EXAMPLE)
    letters = letters_of(machine, axes)
    if _is_path_of_fibre(names):
        raise JobError(
            "the table has points x, y, z of a fibre on its mandrel and neither times nor feeds: "
            "it is a path on the surface, from which a planner makes axis values",
            place=place,
            remedy=_EXAMPLE,
        )
    position = np.zeros((len(values), len(machine.axis_names)))
    kinds = [axis.kind for axis in machine.axes.values()]
    dialect = DIALECTS.get(machine.programs.dialect)
    dialect_rule = "fastest-axis" if dialect is None else dialect.feed_rule
    rule = f_rule(machine, feed_mode, tuple(base_axes), dialect_rule)
    time_s: FloatArray | None = None
    feed_m_s: FloatArray | None = None
    tags: list[tuple[str, FloatArray]] = []
    for index, (name, unit) in enumerate(columns):
        column = values[:, index]
        if name in letters.axes:
            target = "m" if kinds[letters.axes[name]] == "linear" else "rad"
            position[:, letters.axes[name]] = column * _factor(name, unit, target, place)
        elif name in letters.dropped:
            continue
        elif name in _TIMES:
            time_s = column * _factor(name, unit, "s", place)
        elif name in _FEEDS:
            feed_m_s = column * _factor(name, unit, "m/s", place)
        elif len(name) == 1 and name in LETTERS:
            raise JobError(
                f"column {name}: the machine {machine.name!r} has no axis {name}",
                place=place,
                remedy=f"Its axes are {', '.join(machine.axis_names)}; rename the table's (--axes "
                f'"{name}={machine.axis_names[-1]}", or {name}=none to leave it out).',
            )
        elif name:
            tags.append((name.lower() + (f"_{unit.replace('/', '_')}" if unit else ""), column))
    if not set(names) & set(letters.axes):
        raise JobError("the table names no axis of the machine", place=place, remedy=_EXAMPLE)
    if (time_s is None) == (feed_m_s is None):
        fault = "neither times nor feeds" if time_s is None else "both times and feeds"
        raise JobError(f"the table of axis values has {fault}", place=place, remedy=_EXAMPLE)
    duration_s = np.empty(0) if time_s is None else np.diff(time_s)
    feeds = _feeds(rule, feed_m_s) if feed_m_s is not None else _in_time(duration_s)
    wrong_rows = np.flatnonzero(np.array([not feed.value > 0.0 for feed in feeds]))
    if len(wrong_rows):
        row_fault = "no feed above 0" if time_s is None else "no later time than the row before"
        raise JobError(
            f"the row has {row_fault}",
            place=Place(str(path), int(line[wrong_rows[0] + 1])),
            remedy="Correct it.",
        )
    table = AxisTable(str(path), line, position, feeds, duration_s, tuple(tags))
    return Job(
        name=path.name,
        file=str(path),
        sha256=hashlib.sha256(content).hexdigest(),
        axes=machine.axis_names,
        start=tuple(position[0].tolist()),
        operations=OperationStream(Stream(AxisTable.runs, table)),
        feed_rule=rule.text if time_s is None else "",
    )


def _content(path: Path) -> bytes:
    with open_binary(path) as stream:
        content: bytes = stream.read(_MOST_BYTES + 1)
    if len(content) > _MOST_BYTES:
        raise JobError(
            "the table has more than 256 MiB", place=Place(str(path)), remedy="Cut it into parts."
        )
    return content


def _check_budget(rows: int, machine: Machine, place: Place) -> None:
    """Refuse more rows than the tick budget: each row takes at least one tick."""
    budget = int(machine.tick_budget.si)
    if rows > budget:
        raise BudgetError(
            f"the table has {rows} rows, more than the machine's tick budget, {budget}",
            place=place,
            remedy="Raise tick_budget in the machine file.",
        )


def _is_path_of_fibre(names: list[str]) -> bool:
    return {"X", "Y", "Z"} <= set(names) and not {*_TIMES, *_FEEDS, "A", "B", "C"} & set(names)


def _numbers(text: str, columns: int, file: str) -> tuple[IntArray, FloatArray]:
    """Return the line of each row, and the (rows, columns) numbers."""
    heading = next(
        (
            text_line
            for text_line in text.splitlines()
            if text_line.strip() and text_line.strip()[0] != "#"
        ),
        "",
    )
    separator = next((s for s in (";", "\t") if s in heading), ",")
    reader = csv.reader(text.splitlines(), delimiter=separator)
    lines: list[int] = []
    rows: list[list[float]] = []
    has_heading = False
    for cells in reader:
        if not cells or not "".join(cells).strip() or cells[0].lstrip().startswith("#"):
            continue
        if not has_heading:
            has_heading = True
            continue
        place = Place(file, reader.line_num)
        if len(cells) != columns:
            raise JobError(
                f"the row has {len(cells)} cells, and the first row {columns}",
                place=place,
                remedy="Give every column a cell.",
            )
        point = "," if separator != "," else "."
        texts = [cell.replace(point, ".") for cell in cells]
        try:
            row = [float(cell) for cell in texts]
        except ValueError:
            bad_cell = next(cell for cell in texts if not _is_number(cell))
            raise JobError(
                f"{bad_cell.strip()[:40]!r} is not a number", place=place, remedy="Correct it."
            ) from None
        if not all(map(math.isfinite, row)):
            raise JobError("a number is not finite", place=place, remedy="Correct it.")
        lines.append(reader.line_num)
        rows.append(row)
    return np.array(lines, np.int64), np.array(rows, np.float64).reshape(len(rows), columns)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _factor(name: str, unit: str, target: str, place: Place) -> float:
    if not unit:
        raise JobError(f"column {name} has no unit", place=place, remedy=_EXAMPLE)
    try:
        return unit_factor(unit, target)
    except UnitError as error:
        raise JobError(f"column {name}: {error.message}", place=place, remedy=_EXAMPLE) from error


def _feeds(rule: FRule, feed_m_s: FloatArray) -> tuple[Feed, ...]:
    """Return the feed of every row but the first, in m/s by the rule for F."""
    known: dict[float, Feed] = {}
    return tuple(
        known.setdefault(value, Feed(rule.mode, value, rule.base_axes))
        for value in feed_m_s[1:].tolist()
    )


def _in_time(duration_s: FloatArray) -> tuple[Feed, ...]:
    """Return feeds that move from each row to the next in its time."""
    known: dict[float, Feed] = {}
    return tuple(
        known.setdefault(
            duration, Feed(FeedMode.INVERSE_TIME, 1.0 / duration if duration > 0.0 else 0.0)
        )
        for duration in duration_s.tolist()
    )
