"""Tables and recordings made of given numbers, and their content for comparison."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from hypothesis import strategies as st

from threadline.files import (
    Channel,
    ChannelKind,
    Clock,
    Event,
    Recording,
    RecordingBlock,
    Stream,
    TickBlock,
    TickTable,
)

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
                events=tuple(e for e in events if begin <= e.tick and (last or e.tick < end)),
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
    """Return the whole content of a table, whatever its blocks are."""
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


def recording_of(
    samples: dict[str, Sequence[float]],
    *,
    clock: Clock = SERVO,
    stride: int = 1,
    first: int = 0,
    rows: int = 10**9,
    events: Sequence[Event] = (),
) -> Recording:
    """A recording on one clock; channels are called ``X.load`` and the like."""
    units = {"voltage": "V", "current": "A", "operation": ""}
    channels = []
    for name in samples:
        axis, _, kind = name.rpartition(".")
        unit = units.get(kind, "rad" if axis in "ABC" else "m")
        channels.append(
            Channel(
                name=name,
                kind=ChannelKind(kind),
                unit=unit,
                clock=clock,
                axis=axis,
                stride=stride,
            )
        )
    count = len(next(iter(samples.values())))
    blocks = []
    for begin in range(0, max(count, 1), rows):
        ticks = range(first + begin * stride, first + min(begin + rows, count) * stride)
        blocks.append(
            RecordingBlock(
                first_tick={clock.name: first + begin * stride},
                samples={
                    n: np.array(v, dtype=float)[begin : begin + rows] for n, v in samples.items()
                },
                events=tuple(e for e in events if e.tick in ticks),
            )
        )
    return Recording(
        channels=tuple(channels),
        blocks=Stream.of(blocks),
        job_sha256="c" * 64,
        machine_sha256="d" * 64,
        simulated=True,
        origin={"job": "x-180.prg", "feed": "10 count/tick"},
    )


def story(recording: Recording) -> dict[str, object]:
    """Return the whole content of a recording, whatever its blocks are; NaN as text."""
    blocks = list(recording)
    return {
        "channels": recording.channels,
        "hashes": (recording.job_sha256, recording.machine_sha256),
        "simulated": recording.simulated,
        "origin": dict(recording.origin),
        "first": dict(blocks[0].first_tick) if blocks else None,
        "samples": {
            c.name: [repr(float(v)) for b in blocks for v in b.samples[c.name]]
            for c in recording.channels
        },
        "events": [e for b in blocks for e in b.events],
    }
