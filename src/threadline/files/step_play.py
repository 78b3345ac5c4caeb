"""Commands of an embroidery frame (step tables per stitch and axis), and the hash of rows.

``docs/files.md`` ("The hash of the rows") defines the hash, so that another program can compute it.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from threadline.base.arrays import FloatArray, IntArray, Locked, read_only, read_only_int
from threadline.files.clock import Clock, Event
from threadline.files.stream import Stream

TICKS = "threadline tick table 1"
SWITCHES = "threadline switch schedule 1"
STEPS = "threadline step play 1"


class RowsHash:
    """Hashes rows and events as they are added; their division into blocks has no effect.

    Parameters
    ----------
    title
        ``TICKS``, ``SWITCHES`` or ``STEPS``.
    period_s
        Period of the clock.
    names
        Names of the axes or outputs.
    numbers
        All numbers except the rows, in the order of the definition in ``docs/files.md``.
    """

    def __init__(
        self,
        title: str,
        period_s: Fraction,
        names: tuple[str, ...],
        *numbers: FloatArray | IntArray,
    ) -> None:
        self._head = b"".join(
            [
                _text(title),
                _text(f"{period_s.numerator}/{period_s.denominator}"),
                struct.pack("<Q", len(names)),
                *(_text(name) for name in names),
                *(_eight_bytes(column) for column in numbers),
            ]
        )
        self._rows, self._events = hashlib.sha256(), hashlib.sha256()
        self._row_count = self._event_count = 0

    def add(self, columns: Iterable[IntArray], events: Iterable[Event]) -> None:
        """Add n rows, given as (n,) or (n, k) columns, and events in their order."""
        rows = np.column_stack([*columns])
        self._rows.update(_eight_bytes(rows))
        self._row_count += len(rows)
        for event in events:
            self._events.update(
                struct.pack("<qqd", event.tick, event.operation, event.value)
                + _text(event.kind)
                + _text(event.name)
            )
            self._event_count += 1

    def hexdigest(self) -> str:
        """Return the hash of all rows and events added so far."""
        digest = hashlib.sha256(self._head)
        for count, part in ((self._row_count, self._rows), (self._event_count, self._events)):
            digest.update(struct.pack("<Q", count) + part.digest())
        return digest.hexdigest()


def _text(text: str) -> bytes:
    content = text.encode()
    return struct.pack("<Q", len(content)) + content


def _eight_bytes(numbers: FloatArray | IntArray) -> bytes:
    """Return numbers as eight bytes each, little-endian, row by row."""
    return np.ascontiguousarray(numbers, dtype=numbers.dtype.newbyteorder("<")).tobytes()


CountedBy = Literal["time", "angle"]
"""Unit of the intervals in step tables: periods of a timer, or parts of a shaft's turn."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepTable(Locked):
    """The step intervals of one move; k intervals make a move of k steps.

    Parameters
    ----------
    units
        Length of the move in units of the design.
    intervals
        (k,) counts from the start of the window to the first step, then from step to step; at least
        1.
    """

    units: int
    intervals: IntArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "intervals", read_only_int(self.intervals, "intervals", ndim=1))
        if not len(self.intervals) or self.intervals.min() < 1:
            raise ValueError(f"table of {self.units} units: it needs intervals of at least 1 count")

    def __len__(self) -> int:
        return len(self.intervals)

    @property
    def times(self) -> IntArray:
        """(k,) counts from the start of the window to each step."""
        return np.cumsum(self.intervals)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StitchBlock(Locked):
    """Consecutive turns of the main shaft in a ``StepPlay``; n turns, A axes.

    Parameters
    ----------
    first_stitch
        Number of the first turn, counted from 0.
    begin
        (n,) int: tick of the clock at which the tables begin.
    window
        (n,) int: ticks in which the shaft turns through the window of the move at constant speed.
    table
        (n, A) int: index in the library of the table that each axis plays; -1 for no motion.
    sign
        (n, A) int: direction of the steps, 1 or -1; 0 for no motion.
    start
        (n,) int: shaft angle at which the tables begin.
    needle
        (n,) int: 1 if the needle enters the cloth in this turn, 0 if it is held up.
    operation
        (n,) int: operation of the job of each turn.
    events
        Events of these turns; their ticks are numbers of turns.
    """

    first_stitch: int
    begin: IntArray
    window: IntArray
    table: IntArray
    sign: IntArray
    start: IntArray
    needle: IntArray
    operation: IntArray
    events: tuple[Event, ...] = ()

    def __post_init__(self) -> None:
        columns = ("begin", "window", "start", "needle", "operation")
        for name in (*columns, "table", "sign"):
            ndim = 1 if name in columns else 2
            object.__setattr__(self, name, read_only_int(getattr(self, name), name, ndim=ndim))
        n = len(self.table)
        lengths = {name: len(getattr(self, name)) for name in (*columns, "sign")}
        if self.table.shape != self.sign.shape or set(lengths.values()) != {n}:
            stitches = ", ".join(f"{name} {length}" for name, length in lengths.items())
            raise ValueError(
                f"table has shape {self.table.shape}, sign {self.sign.shape}; stitches: {stitches}"
            )
        wrong_rows = np.flatnonzero(
            ((np.abs(self.sign) > 1) | ((self.sign == 0) != (self.table == -1))).any(axis=1)
        )
        if len(wrong_rows):
            raise ValueError(
                f"stitch {self.first_stitch + int(wrong_rows[0])}: a sign is 1 or -1, and 0 "
                "exactly where the table is -1"
            )
        wrong_rows = np.flatnonzero(self.begin[1:] < self.begin[:-1] + self.window[:-1])
        if len(wrong_rows):
            raise ValueError(
                f"stitch {self.first_stitch + int(wrong_rows[0]) + 1} begins before the window of "
                "the one before it has ended"
            )

    def __len__(self) -> int:
        return len(self.table)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepPlay(Locked):
    """Commands of an embroidery frame: a table of step intervals for each stitch and axis.

    Each turn of the shaft has a window in which the frame moves. A table of time intervals is valid
    for one shaft speed; a table of angle intervals is valid for every speed.

    Parameters
    ----------
    clock
        The timer of the controller.
    counted_by
        Unit of the intervals: ticks of the clock, or parts of the shaft's turn.
    steps_per_turn
        Number of equal parts of a turn of the shaft.
    window_angle
        Number of these parts in the window of the move.
    axes
        Names, in the order of the columns.
    steps_per_unit
        (A,) steps of the motor per metre or per radian.
    start_steps
        (A,) position of each axis before the first stitch, in steps.
    library
        The tables.
    blocks
        Re-iterable blocks of turns, consecutive from turn 0.
    duration_ticks
        Length of all turns together, in ticks of the clock.
    job_sha256, machine_sha256
        Hashes of the job and the machine for which the commands were made.
    """

    clock: Clock
    counted_by: CountedBy
    steps_per_turn: int
    window_angle: int
    axes: tuple[str, ...]
    steps_per_unit: FloatArray
    start_steps: IntArray
    library: tuple[StepTable, ...]
    blocks: Stream[StitchBlock]
    duration_ticks: int
    job_sha256: str
    machine_sha256: str

    def __post_init__(self) -> None:
        scale = read_only(self.steps_per_unit, "steps_per_unit", ndim=1)
        start = read_only_int(self.start_steps, "start_steps", ndim=1)
        if not len(self.axes) == len(scale) == len(start):
            raise ValueError(
                f"{len(self.axes)} axes, {len(scale)} scales and {len(start)} start positions"
            )
        if not 0 < self.window_angle < self.steps_per_turn:
            raise ValueError(
                f"the window has {self.window_angle} of the {self.steps_per_turn} angles of a turn"
            )
        object.__setattr__(self, "steps_per_unit", scale)
        object.__setattr__(self, "start_steps", start)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        # Unpickling calls the constructor, which checks the values again.
        return _step_play, tuple(getattr(self, field.name) for field in fields(self))

    def __iter__(self) -> Iterator[StitchBlock]:
        """Yield the blocks, each checked against library, axes and shaft.

        Raises
        ------
        ValueError
            If a stitch names an unknown table, begins outside its turn, has a table that is longer
            than its window, ends after ``duration_ticks``, or does not follow the preceding stitch.
        """
        next_stitch, free_tick = 0, 0
        table_counts = _spans(self.library)
        for block in self.blocks:
            if block.first_stitch != next_stitch or block.table.shape[1] != len(self.axes):
                raise ValueError(
                    f"expected stitch {next_stitch} with {len(self.axes)} axes, got stitch "
                    f"{block.first_stitch} with {block.table.shape[1]} axes"
                )
            for name, values, low, high in (
                ("table", block.table, -1, len(self.library)),
                ("start", block.start[:, None], 0, self.steps_per_turn),
                ("begin", block.begin[:1, None], free_tick, 2**62),
                ("needle", block.needle[:, None], 0, 2),
            ):
                wrong_rows = np.flatnonzero(((values < low) | (values >= high)).any(axis=1))
                if len(wrong_rows):
                    row = int(wrong_rows[0])
                    raise ValueError(
                        f"stitch {next_stitch + row}: {name} {values[row].tolist()} is not "
                        f"from {low} to {high - 1}"
                    )
            window_counts = (
                block.window if self.counted_by == "time" else np.array([self.window_angle])
            )
            too_long = np.flatnonzero(
                (table_counts[block.table] > window_counts[:, None]).any(axis=1)
            )
            if len(too_long):
                raise ValueError(
                    f"stitch {next_stitch + int(too_long[0])}: its table is longer than its window"
                )
            ends = block.begin + block.window
            beyond_end = np.flatnonzero(ends > self.duration_ticks)
            if len(beyond_end):
                raise ValueError(
                    f"stitch {next_stitch + int(beyond_end[0])}: its window ends at "
                    f"{ends[beyond_end[0]]}, the commands end at {self.duration_ticks}"
                )
            if len(block):
                free_tick = int(block.begin[-1] + block.window[-1])
            next_stitch += len(block)
            yield block

    def stitch_count(self) -> int:
        """Return the number of turns; reads every block."""
        return sum(len(block) for block in self)

    def tick_count(self) -> int | None:
        """Return None: step tables do not have a row for every tick."""
        return None

    def rows_sha256(self) -> str:
        """Return the hash of the commands: tables, turns and events.

        ``docs/files.md`` defines it byte by byte.
        """
        lengths = np.array([len(table) for table in self.library], dtype=np.int64)
        units = np.array([table.units for table in self.library], dtype=np.int64)
        counted_by_code = 0 if self.counted_by == "time" else 1
        digest = RowsHash(
            STEPS, self.clock.period_s, self.axes, self.steps_per_unit, self.start_steps,
            np.array(
                [counted_by_code, self.steps_per_turn, self.window_angle, self.duration_ticks]
            ),
            np.array([len(lengths)]), units, lengths, *(t.intervals for t in self.library),
        )  # fmt: skip
        for block in self:
            columns = (block.begin, block.window, block.start, block.needle)
            digest.add((*columns, block.table, block.sign, block.operation), block.events)
        return digest.hexdigest()

    def end_steps(self) -> IntArray:
        """Return the (A,) position after the last stitch, in steps; reads every block."""
        # A stitch without motion has the index -1, which selects the last entry: 0 steps.
        lengths = np.array([*(len(table) for table in self.library), 0], dtype=np.int64)
        total = self.start_steps.copy()
        for block in self:
            total += (block.sign * lengths[block.table]).sum(axis=0)
        return total


def _step_play(*values: Any) -> StepPlay:
    names = [field.name for field in fields(StepPlay)]
    return StepPlay(**dict(zip(names, values, strict=True)))


def concatenated_intervals(tables: tuple[StepTable, ...]) -> tuple[IntArray, IntArray]:
    """Return the (n,) intervals of all tables, and the (tables,) start index of each table.

    The results are the arguments of ``np.add.reduceat``; a call per table would be slow for
    hundreds of tables.
    """
    ends = np.cumsum([len(table) for table in tables], dtype=np.int64)
    begins = np.concatenate((np.zeros(1, dtype=np.int64), ends[:-1]))
    return np.concatenate([table.intervals for table in tables]), begins


@lru_cache(maxsize=1)
def _spans(tables: tuple[StepTable, ...]) -> IntArray:
    """Return the (k + 1,) length of each table in counts; the last entry, 0, means no table."""
    table_counts = np.zeros(len(tables) + 1, dtype=np.int64)
    if tables:
        intervals, begins = concatenated_intervals(tables)
        table_counts[:-1] = np.add.reduceat(intervals, begins)
    table_counts.setflags(write=False)
    return table_counts
