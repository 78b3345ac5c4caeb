"""Commands for the machine's controller: tables of whole numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from threadline.base.arrays import FloatArray, IntArray, Locked, read_only, read_only_int
from threadline.errors import OptionError
from threadline.files.clock import Clock, Event
from threadline.files.step_play import SWITCHES, TICKS, RowsHash, StepPlay
from threadline.files.stream import Stream


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TickBlock(Locked):
    """A run of consecutive rows of a tick table.

    Parameters
    ----------
    first_tick
        Tick of the first row.
    counts
        (n, axes) int: encoder counts to travel during each tick.
    operation
        (n,) int: index of the operation that each row belongs to.
    events
        Events whose ticks lie in this block, in order.
    """

    first_tick: int
    counts: IntArray
    operation: IntArray
    events: tuple[Event, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "counts", read_only_int(self.counts, "counts", ndim=2))
        object.__setattr__(self, "operation", read_only_int(self.operation, "operation", ndim=1))
        if len(self.counts) != len(self.operation):
            raise ValueError(
                f"counts has {len(self.counts)} rows, operation has {len(self.operation)}"
            )

    def __len__(self) -> int:
        return len(self.counts)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TickTable(Locked):
    """Counts per tick and axis: the commands of a machine whose controller closes the loops.

    Parameters
    ----------
    clock
        Clock of the rows: the controller plays one row per tick.
    axes
        Names, in the order of the columns.
    counts_per_unit
        (axes,) counts per metre or per radian.
    start_counts
        (axes,) commanded position before the first row.
    blocks
        Re-iterable blocks of rows, consecutive from tick 0.
    job_sha256, machine_sha256
        Hashes of the job and the machine for which the table was made.
    began_sha256
        For a learned table: hash of the rows of the planned table from which it was learned. Empty
        for a planned table.
    """

    clock: Clock
    axes: tuple[str, ...]
    counts_per_unit: FloatArray
    start_counts: IntArray
    blocks: Stream[TickBlock]
    job_sha256: str
    machine_sha256: str
    began_sha256: str = ""

    def __post_init__(self) -> None:
        scale = read_only(self.counts_per_unit, "counts_per_unit", ndim=1)
        start = read_only_int(self.start_counts, "start_counts", ndim=1)
        object.__setattr__(self, "counts_per_unit", scale)
        object.__setattr__(self, "start_counts", start)
        if not len(self.axes) == len(scale) == len(start):
            raise ValueError(
                f"{len(self.axes)} axes, {len(scale)} scales and {len(start)} start positions"
            )

    def __iter__(self) -> Iterator[TickBlock]:
        return iter(self.blocks)

    def tick_count(self) -> int:
        """Return the number of rows; reads the whole table."""
        return sum(len(block) for block in self)

    def rows_hash(self) -> RowsHash:
        """Return a hash object for this table; the caller adds the rows in order."""
        return RowsHash(
            TICKS, self.clock.period_s, self.axes, self.counts_per_unit, self.start_counts
        )

    def rows_sha256(self) -> str:
        """Return the hash of the commands; reads the whole table.

        It covers the clock's period, the axes, their counts per unit and start, every row and every
        event, and does not depend on the division into blocks. ``docs/files.md`` defines it byte by
        byte.
        """
        digest = self.rows_hash()
        for block in self:
            digest.add((block.counts, block.operation), block.events)
        return digest.hexdigest()

    def end_counts(self) -> IntArray:
        """Return the (axes,) commanded position after the last row; reads the whole table."""
        total = self.start_counts.copy()
        for block in self:
            total += block.counts.sum(axis=0)
        return total


@dataclass(frozen=True, slots=True, kw_only=True)
class Creep:
    """Short openings of a valve during a wait, by which a piston creeps to its end switch.

    The schedule stands still during the wait. An opening is finished before the switch is read
    again. The wait ends when the switch is on and ``rest`` scans have passed since the last
    opening.

    Parameters
    ----------
    tick
        Tick of the wait; each wait has a tick of its own.
    first, every
        Number of scans of waiting before the first opening, and number from one opening to the
        next.
    opens
        Length of an opening, in scans.
    rest
        Number of scans from the end of the last opening until the piston is at rest.
    most
        Number of scans of waiting after which a switch that is still off is a fault.
    levels
        State of every output during an opening.
    """

    tick: int
    first: int
    every: int
    opens: int
    rest: int
    most: int
    levels: tuple[int, ...]

    @property
    def row(self) -> tuple[int, ...]:
        """All numbers, in the order of the fields."""
        return (
            self.tick, self.first, self.every, self.opens, self.rest, self.most, *self.levels,
        )  # fmt: skip

    @classmethod
    def of_row(cls, row: Sequence[int]) -> Creep:
        """Return the creep of a ``row``; raise ValueError if its numbers are not possible."""
        tick, first, every, opens, rest, most, *levels = (int(number) for number in row)
        if min(tick, first, rest) < 0 or not 0 < opens < every or not set(levels) <= {0, 1}:
            raise ValueError(f"no creep has the numbers {str(list(row))[:80]}")
        return cls(
            tick=tick,
            first=first,
            every=every,
            opens=opens,
            rest=rest,
            most=most,
            levels=tuple(levels),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SwitchSchedule(Locked):
    """Outputs over time: the commands of an on/off machine.

    Parameters
    ----------
    clock
        Scan clock of the controller.
    outputs
        Names of the outputs, in the order of the columns.
    ticks
        (n,) int, increasing: scan at which the levels of a row take effect.
    levels
        (n, outputs) int: state of every output from this scan on.
    operation
        (n,) int: index of the operation that each row belongs to.
    duration_ticks
        Length of the whole schedule, in scans.
    job_sha256, machine_sha256
        Hashes of the job and the machine for which the schedule was made.
    events
        Waits and stops, in order of their ticks.
    creeps
        The creeps to end switches during waits, in order of their ticks.
    """

    clock: Clock
    outputs: tuple[str, ...]
    ticks: IntArray
    levels: IntArray
    operation: IntArray
    duration_ticks: int
    job_sha256: str
    machine_sha256: str
    events: tuple[Event, ...] = field(default=())
    creeps: tuple[Creep, ...] = field(default=())

    def __post_init__(self) -> None:
        for name, ndim in (("ticks", 1), ("levels", 2), ("operation", 1)):
            object.__setattr__(self, name, read_only_int(getattr(self, name), name, ndim=ndim))
        if self.levels.shape != (len(self.ticks), len(self.outputs)):
            raise ValueError(
                f"levels has shape {self.levels.shape}, "
                f"expected {(len(self.ticks), len(self.outputs))}"
            )
        if len(self.operation) != len(self.ticks):
            raise ValueError(
                f"ticks has {len(self.ticks)} rows, operation has {len(self.operation)}"
            )
        if len(self.ticks) and (np.diff(self.ticks) <= 0).any():
            raise ValueError("ticks must be strictly increasing")
        if len(self.ticks) and self.duration_ticks < self.ticks[-1]:
            raise ValueError(
                f"duration_ticks {self.duration_ticks} lies before the last row {self.ticks[-1]}"
            )
        if any(len(creep.levels) != len(self.outputs) for creep in self.creeps):
            raise ValueError(f"a creep does not have {len(self.outputs)} levels")

    def creep_at(self, tick: int) -> Creep | None:
        """Return the creep of the wait at ``tick``; None for a wait without a creep."""
        return next((creep for creep in self.creeps if creep.tick == tick), None)

    def rows_sha256(self) -> str:
        """Return the hash of the commands.

        It covers the clock's period, the outputs, the duration, every creep, row and event.
        ``docs/files.md`` defines it byte by byte.
        """
        numbers = [self.duration_ticks, *(n for creep in self.creeps for n in creep.row)]
        digest = RowsHash(SWITCHES, self.clock.period_s, self.outputs, np.array(numbers))
        digest.add((self.ticks, self.levels, self.operation), self.events)
        return digest.hexdigest()

    def tick_count(self) -> int | None:
        """Return None: a schedule does not have a row for every tick."""
        return None

    def creeps_by_row(self) -> dict[int, list[Creep]]:
        """Return the creeps by the row that is in effect during their waits."""
        creeps: dict[int, list[Creep]] = {}
        rows = np.searchsorted(self.ticks, [creep.tick for creep in self.creeps], side="right")
        for row, creep in zip(rows.tolist(), self.creeps, strict=True):
            creeps.setdefault(row - 1, []).append(creep)
        return creeps


Commands = TickTable | SwitchSchedule | StepPlay
KindT = TypeVar("KindT", bound=TickTable | SwitchSchedule | StepPlay)


def _of_kind(commands: Commands, kind: type[KindT], requirement: str, remedy: str) -> KindT:
    if not isinstance(commands, kind):
        raise OptionError(f"this needs {requirement}", remedy=remedy)
    return commands


def tick_table(commands: Commands) -> TickTable:
    """Return ``commands`` as a tick table; raise an ``OptionError`` for another kind."""
    requirement = "a table of counts, which an on/off machine does not have"
    return _of_kind(commands, TickTable, requirement, "Choose a machine with axes.")


def switch_schedule(commands: Commands) -> SwitchSchedule:
    """Return ``commands`` as a switch schedule; raise an ``OptionError`` for another kind."""
    requirement = "a schedule of switchings, which a machine with axes does not have"
    return _of_kind(commands, SwitchSchedule, requirement, "Choose a machine with cylinders.")


def played(commands: Commands) -> StepPlay:
    """Return ``commands`` as step tables by stitch; raise an ``OptionError`` for another kind."""
    requirement = "step tables, which only a machine with a main shaft plays"
    return _of_kind(commands, StepPlay, requirement, "Choose an embroidery machine.")
