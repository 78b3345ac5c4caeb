"""Commands of an embroidery frame: step-interval tables, one for each stitch and axis."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from threadline.arrays import FloatArray, IntArray, Locked, read_only, read_only_int
from threadline.signals.clock import Clock
from threadline.signals.commands import Event
from threadline.signals.shaft import ShaftClock
from threadline.signals.stream import Stream


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StitchBlock(Locked):
    """A run of consecutive stitches of a ``StepPlay``; n stitches, A axes.

    Parameters
    ----------
    first_stitch
        Number of the first.
    table
        (n, A) int: which table of the library each axis plays, -1 where it stands.
    sign
        (n, A) int: 1 or -1, the sense of its steps; 0 where it stands.
    start
        (n,) int: angle of the shaft in its turn, in ticks of the shaft, at which the tables begin.
    operation
        (n,) int: operation of the job that each stitch belongs to.
    events
        Events of these stitches; their ticks are numbers of stitches.
    """

    first_stitch: int
    table: IntArray
    sign: IntArray
    start: IntArray
    operation: IntArray
    events: tuple[Event, ...] = ()

    def __post_init__(self) -> None:
        for name, ndim in (("table", 2), ("sign", 2), ("start", 1), ("operation", 1)):
            object.__setattr__(self, name, read_only_int(getattr(self, name), name, ndim=ndim))
        n = len(self.table)
        lengths = [len(self.sign), len(self.start), len(self.operation)]
        if self.table.shape != self.sign.shape or lengths != [n, n, n]:
            raise ValueError(
                f"table has shape {self.table.shape}, sign {self.sign.shape}, start has "
                f"{lengths[1]} and operation {lengths[2]} stitches"
            )
        wrong = np.flatnonzero(
            ((np.abs(self.sign) > 1) | ((self.sign == 0) != (self.table == -1))).any(axis=1)
        )
        if len(wrong):
            raise ValueError(
                f"stitch {self.first_stitch + int(wrong[0])}: a sign is 1 or -1, and 0 exactly "
                "where the table is -1"
            )

    def __len__(self) -> int:
        return len(self.table)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StepPlay(Locked):
    """Tables of step intervals, played one for each stitch and axis: an embroidery frame's.

    Parameters
    ----------
    clock
        What intervals are counted in: a timer, or a shaft that they follow.
    shaft
        What stitches begin by: one in each turn.
    axes
        Names, in the order of the columns.
    steps_per_unit
        (A,) steps of the motor per metre or per radian.
    start_steps
        (A,) where each axis stands before the first stitch.
    library
        The tables: (k,) intervals each, from the start of a stitch to the first step and from
        step to step, 1 at least; a table of k intervals moves by k steps.
    blocks
        Re-iterable blocks of stitches, consecutive from stitch 0.
    job_sha256, machine_sha256
        What it was made from and for.
    """

    clock: Clock | ShaftClock
    shaft: ShaftClock
    axes: tuple[str, ...]
    steps_per_unit: FloatArray
    start_steps: IntArray
    library: tuple[IntArray, ...]
    blocks: Stream[StitchBlock]
    job_sha256: str
    machine_sha256: str

    def __post_init__(self) -> None:
        scale = read_only(self.steps_per_unit, "steps_per_unit", ndim=1)
        start = read_only_int(self.start_steps, "start_steps", ndim=1)
        if not len(self.axes) == len(scale) == len(start):
            raise ValueError(
                f"{len(self.axes)} axes, {len(scale)} scales and {len(start)} start positions"
            )
        tables = tuple(
            read_only_int(table, f"library[{k}]", ndim=1) for k, table in enumerate(self.library)
        )
        for k, table in enumerate(tables):
            if not len(table) or table.min() < 1:
                raise ValueError(f"library[{k}]: a table has intervals, of 1 count at least")
        object.__setattr__(self, "steps_per_unit", scale)
        object.__setattr__(self, "start_steps", start)
        object.__setattr__(self, "library", tables)

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        # What is read again is checked again, and so are the tables in their tuple locked.
        return _step_play, tuple(getattr(self, field.name) for field in fields(self))

    def __iter__(self) -> Iterator[StitchBlock]:
        """Yield the blocks, each checked against library, axes and shaft.

        Raises
        ------
        ValueError
            If a stitch names a table that is not there, begins outside its turn, or follows no
            other.
        """
        expected = 0
        for block in self.blocks:
            if block.first_stitch != expected or block.table.shape[1] != len(self.axes):
                raise ValueError(
                    f"stitch {expected} comes as {block.first_stitch}, of {block.table.shape[1]} "
                    f"axes; wanted are {len(self.axes)}"
                )
            for name, values, low, high in (
                ("table", block.table, -1, len(self.library)),
                ("start", block.start[:, None], 0, self.shaft.steps_per_turn),
            ):
                wrong = np.flatnonzero(((values < low) | (values >= high)).any(axis=1))
                if len(wrong):
                    at = int(wrong[0])
                    raise ValueError(
                        f"stitch {expected + at}: {name} {values[at].tolist()} is not from {low} "
                        f"to {high - 1}"
                    )
            expected += len(block)
            yield block

    def stitch_count(self) -> int:
        """Return how many stitches there are; reads all of it."""
        return sum(len(block) for block in self)

    def end_steps(self) -> IntArray:
        """Return the (A,) position after the last stitch; reads all of it."""
        # A stitch that stands takes the last entry, 0 steps.
        lengths = np.array([*(len(table) for table in self.library), 0], dtype=np.int64)
        total = self.start_steps.copy()
        for block in self:
            total += (block.sign * lengths[block.table]).sum(axis=0)
        return total


def _step_play(*values: Any) -> StepPlay:
    names = [field.name for field in fields(StepPlay)]
    return StepPlay(**dict(zip(names, values, strict=True)))
