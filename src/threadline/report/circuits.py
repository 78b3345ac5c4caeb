"""What the 1994 controller showed before winding: ticks per circuit, circuits, data points."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from threadline.jobs.circuit import begins_circuit
from threadline.jobs.operations import Job, Source
from threadline.plan import Plan
from threadline.signals import TickTable, tick_table
from threadline.signals.files.plt import LINES_1994


@dataclass(frozen=True, slots=True, kw_only=True)
class CircuitCounts:
    """The figures of a compiled job.

    Parameters
    ----------
    ticks
        Of the whole job.
    circuits
        Passes of the outermost subroutine calls; 1 for a program without a subroutine.
    shortest_ticks, longest_ticks
        Of a circuit.
    data_points
        Samples that a recording every ``record_every`` ticks has, the first at tick 0.
    record_every
        Ticks from one data point to the next; None for a machine without operator's settings,
        every tick of which is recorded.
    period_s
        Of a tick.
    """

    ticks: int
    circuits: int
    shortest_ticks: int
    longest_ticks: int
    data_points: int
    record_every: int | None
    period_s: Fraction

    def lines(self) -> list[str]:
        """Return the figures as lines of text."""
        each = f"{self.longest_ticks}"
        if self.shortest_ticks != self.longest_ticks:
            each = f"{self.shortest_ticks} to {self.longest_ticks}"
        more = ""
        if self.data_points > LINES_1994:
            more = f"; the 1994 plot file held {LINES_1994}"
        tick = f"{float(self.period_s * 1000):g} ms"
        whole = f"{float(self.ticks * self.period_s):.6g} s"
        if self.record_every is None and self.circuits == 1:
            return [f"Ticks in all:         {self.ticks} ({whole}; a tick is {tick})"]
        shown = [
            f"Ticks per circuit:    {each} (a tick is {tick})",
            f"Circuits:             {self.circuits}",
            f"Ticks in all:         {self.ticks} ({whole})",
        ]
        if self.record_every is None:
            return shown
        return [
            *shown,
            f"Data points recorded: {self.data_points} (every {self.record_every} ticks{more})",
        ]


def count_circuits(plan: Plan) -> CircuitCounts:
    """Return ticks per circuit, circuits and data points of a plan; reads its tick table once.

    A circuit is one pass of an outermost subroutine call. Ticks of operations outside any call
    (an approach, a return) count for the whole job alone.

    Raises
    ------
    OptionError
        If the plan's commands are not a tick table.
    """
    table = tick_table(plan.commands)
    ticks = 0
    lengths = _Lengths()
    for circuit, rows in _by_circuit(table, plan.job):
        ticks += rows
        lengths.add(circuit, rows)
    lengths.add(0, 0)
    if not lengths.count:
        lengths = _Lengths(count=1, shortest=ticks, longest=ticks)
    operator = plan.machine.operator
    every = None if operator is None else max(1, round(operator.record_every.si))
    return CircuitCounts(
        ticks=ticks,
        circuits=lengths.count,
        shortest_ticks=lengths.shortest,
        longest_ticks=lengths.longest,
        data_points=ticks // (every or 1) + 1,
        record_every=every,
        period_s=table.clock.period_s,
    )


@dataclass(slots=True)
class _Lengths:
    """Number and lengths of the circuits so far; the last one may still grow."""

    count: int = 0
    shortest: int = 0
    longest: int = 0
    circuit: int = 0
    ticks: int = 0

    def add(self, circuit: int, ticks: int) -> None:
        """Add ticks of a circuit; 0 is outside any."""
        if circuit == self.circuit:
            self.ticks += ticks
            return
        if self.circuit:
            self.shortest = min(self.shortest, self.ticks) if self.count else self.ticks
            self.longest = max(self.longest, self.ticks)
            self.count += 1
        self.circuit, self.ticks = circuit, ticks


def _by_circuit(table: TickTable, job: Job) -> Iterator[tuple[int, int]]:
    """Yield the number of the circuit, from 1, 0 outside any, and the ticks of each operation."""
    operations = enumerate(job)
    index, circuit = -1, 0
    source: Source | None = None
    entered = 0
    for block in table:
        found, counts = np.unique(block.operation, return_counts=True)
        for wanted, rows in zip(found.tolist(), counts.tolist(), strict=True):
            while index < wanted:
                index, operation = next(operations, (wanted, None))
                before, source = source, None if operation is None else operation.source
                entered += source is not None and begins_circuit(before, source)
            circuit = entered if source is not None and source.passes else 0
            yield circuit, rows
