"""Tables and recordings made of given numbers, and what to compare of them."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from hypothesis import strategies as st

from threadline.signals import Clock, Event, Stream, TickBlock, TickTable

SERVO = Clock("servo", Fraction(1, 200))


def table_of(
    counts: Sequence[Sequence[int]],
    *,
    operation: Sequence[int] | None = None,
    events: Sequence[Event] = (),
    axes: tuple[str, ...] = ("A", "X"),
    rows: int = 10**9,
    clock: Clock = SERVO,
) -> TickTable:
    """A tick table with ``rows`` rows in each block."""
    values = np.array(counts, dtype=np.int64).reshape(-1, len(axes))
    labels = np.zeros(len(values)) if operation is None else np.array(operation)
    blocks = []
    for begin in range(0, max(len(values), 1), rows):
        end = min(begin + rows, len(values))
        last = end == len(values)
        blocks.append(
            TickBlock(
                first_tick=begin,
                counts=values[begin:end],
                operation=labels[begin:end].astype(np.int64),
                events=tuple(
                    e for e in events if begin <= e.tick and (last or e.tick < end)
                ),
            )
        )
    return TickTable(
        clock=clock,
        axes=axes,
        counts_per_unit=np.array([2015.7566 + k / 3 for k in range(len(axes))]),
        start_counts=np.arange(len(axes)) - 7,
        blocks=Stream.of(blocks),
        job_sha256="a" * 64,
        machine_sha256="b" * 64,
    )


def content(table: TickTable) -> dict[str, object]:
    """Everything that a table says, whatever its blocks are."""
    blocks = list(table)
    ticks = 0
    for block in blocks:
        assert block.first_tick == ticks
        ticks += len(block)
    return {
        "clock": table.clock,
        "axes": table.axes,
        "scale": table.counts_per_unit.tolist(),
        "start": table.start_counts.tolist(),
        "job": table.job_sha256,
        "machine": table.machine_sha256,
        "counts": [row for b in blocks for row in b.counts.tolist()],
        "operation": [o for b in blocks for o in b.operation.tolist()],
        "events": [e for b in blocks for e in b.events],
    }


@st.composite
def tables(draw: st.DrawFn) -> TickTable:
    """Tables with rows that repeat, run evenly or jump, with events anywhere."""
    axes = draw(st.sampled_from([("X",), ("A", "X"), ("A", "B", "C", "X", "Y", "Z")]))
    count = draw(st.integers(0, 60))
    speeds = draw(
        st.lists(st.fractions(-90, 90, max_denominator=50), min_size=len(axes), max_size=len(axes))
    )
    even = [[int(v * (k + 1)) - int(v * k) for v in speeds] for k in range(count)]
    for _ in range(draw(st.integers(0, 3))):
        if count:
            row = draw(st.integers(0, count - 1))
            even[row] = [draw(st.integers(-(2**40), 2**40)) for _ in axes]
    operation = sorted(draw(st.lists(st.integers(-1, 5), min_size=count, max_size=count)))
    ticks = sorted(draw(st.lists(st.integers(0, count), max_size=5)))
    events = [
        Event(
            tick=tick,
            kind=draw(st.sampled_from(["output", "wait", "stop", "dwell", "tool", "end"])),
            operation=draw(st.integers(-1, 99)),
            name=draw(st.sampled_from(["", "valve", 'odd "name", ja\n#', "näher"])),
            value=draw(st.floats(allow_nan=False, allow_infinity=False)),
        )
        for tick in ticks
    ]
    rows = draw(st.integers(1, 70))
    return table_of(even, operation=operation, events=events, axes=axes, rows=rows)
