"""Clocks, tables, schedules and recordings as values: exact times, and refusals."""

from __future__ import annotations

import pickle
import time
import weakref
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from fractions import Fraction
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.made import Made
from threadline.errors import OptionError, RecordingError
from threadline.files import (
    CachedStream,
    ChannelKind,
    Clock,
    RecordingBlock,
    Stream,
    SwitchSchedule,
    TickBlock,
    TickTable,
    common_period_s,
)
from threadline.files.recording import columns_of

from .makers import SERVO, recording_of, table_of

PERIODS = st.fractions(Fraction(1, 10**9), 10, max_denominator=10**9).filter(bool)


@given(period=PERIODS, tick=st.integers(0, 10**12))
def test_instants_are_correctly_rounded(period: Fraction, tick: int) -> None:
    clock = Clock("c", period)
    assert clock.time_s(tick) == float(period * tick)


@given(
    period=st.sampled_from([Fraction(1, 200), Fraction(17, 125_000), Fraction(1, 16_000_000)]),
    first=st.integers(0, 10**9),
    stride=st.integers(1, 50),
)
def test_runs_of_instants_do_not_drift(period: Fraction, first: int, stride: int) -> None:
    """Each is the exact fraction, rounded once, even after 10**9 ticks."""
    times = Clock("c", period).times_s(first, 20, stride)
    assert times.tolist() == [float(period * (first + stride * k)) for k in range(20)]


@given(periods=st.lists(PERIODS, min_size=1, max_size=4))
def test_the_common_period_divides_all_and_is_the_longest(periods: list[Fraction]) -> None:
    common = common_period_s(periods)
    multiples = [p / common for p in periods]
    assert all(m.denominator == 1 for m in multiples)
    assert np.gcd.reduce(np.array([int(m) for m in multiples], dtype=object)) == 1


def test_bad_clocks_are_refused() -> None:
    with pytest.raises(ValueError, match="period must be greater than 0"):
        Clock("c", Fraction(0))
    with pytest.raises(ValueError, match="no periods"):
        common_period_s([])


def test_a_table_ends_where_its_rows_sum_to() -> None:
    table = table_of([[1, 2], [3, -4], [5, 6]], rows=2)
    assert table.tick_count() == 3
    assert table.end_counts().tolist() == [-7 + 9, -6 + 4]
    assert table.start_counts.tolist() == [-7, -6]  # reading does not move the start


def test_tables_refuse_what_does_not_fit() -> None:
    with pytest.raises(ValueError, match="counts has 2 rows, operation has 1"):
        TickBlock(first_tick=0, counts=np.zeros((2, 1), int), operation=np.zeros(1, int))
    with pytest.raises(ValueError, match="whole numbers"):
        TickBlock(first_tick=0, counts=np.zeros((1, 1)), operation=np.zeros(1, int))
    with pytest.raises(ValueError, match="1 axes, 2 scales and 1 start"):
        TickTable(
            clock=SERVO,
            axes=("X",),
            counts_per_unit=np.ones(2),
            start_counts=np.zeros(1, int),
            blocks=Stream.of([]),
            job_sha256="",
            machine_sha256="",
        )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({}, None),
        ({"ticks": [3, 3]}, "strictly increasing"),
        ({"levels": [[1], [0]]}, "levels has shape"),
        ({"operation": [0]}, "ticks has 2 rows, operation has 1"),
        ({"duration_ticks": 4}, "duration_ticks 4 lies before the last row 5"),
    ],
)
def test_schedules_refuse_what_does_not_fit(changes, message) -> None:
    values = {
        "ticks": [0, 5],
        "levels": [[1, 0], [0, 1]],
        "operation": [0, 1],
        "duration_ticks": 9,
        **changes,
    }

    def make() -> SwitchSchedule:
        return SwitchSchedule(
            clock=SERVO, outputs=("a", "b"), job_sha256="", machine_sha256="", **values
        )

    if message is None:
        assert make().levels.tolist() == [[1, 0], [0, 1]]
    else:
        with pytest.raises(ValueError, match=message):
            make()


def test_a_recording_finds_its_channels_and_names_them() -> None:
    recording = recording_of({"X.load": [0.0, 1.0, 2.0], "A.load": [5.0, 6.0, 7.0]}, rows=2)
    assert recording.find(ChannelKind.LOAD, "A").name == "A.load"
    assert recording.find(ChannelKind.FRAME, "A") is None
    times, values = recording.samples("A.load")
    assert times.tolist() == [0.0, 0.005, 0.01]
    assert values.tolist() == [5.0, 6.0, 7.0]
    with pytest.raises(RecordingError, match=r"no channel 'Y.load'. It has X.load, A.load"):
        recording.samples("Y.load")


def test_channels_of_a_recording_are_read_together() -> None:
    """Each reading of a simulated recording simulates it again: it is read once for all."""
    kept = recording_of({"X.load": [0.0, 1.0, 2.0], "A.load": [5.0, 6.0, 7.0]}, rows=2)
    readings: list[int] = []

    def blocks() -> Iterator[RecordingBlock]:
        readings.append(1)
        return iter(kept)

    recording = replace(kept, blocks=Made(blocks))
    found = recording.samples_of(["A.load", "X.load"])
    assert list(found) == ["A.load", "X.load"] and len(readings) == 1
    assert [times.tolist() for times, _ in found.values()] == [[0.0, 0.005, 0.01]] * 2
    assert [values.tolist() for _, values in found.values()] == [[5.0, 6.0, 7.0], [0.0, 1.0, 2.0]]
    assert list(columns_of(recording)) == ["time [s]", "X.load [m]", "A.load [rad]"]
    assert len(readings) == 2
    with pytest.raises(RecordingError, match=r"no channel 'Y.load'"):
        recording.samples_of(["X.load", "Y.load"])


def test_streams_begin_anew() -> None:
    calls: list[int] = []
    stream = Stream(noted, calls, upto=3)
    assert (list(stream), list(stream)) == ([0, 1, 2], [0, 1, 2])
    assert len(calls) == 2


def test_a_short_stream_is_worked_out_once_and_a_long_one_anew() -> None:
    calls: list[int] = []
    blocks = [b"ab", b"", b"cde"]
    stream = CachedStream(noted_blocks, calls, blocks)
    next(iter(stream))  # the blocks of a reading that ends early are there for the others
    assert list(zip(stream, stream, strict=True)) == list(zip(blocks, blocks, strict=True))
    assert list(stream) == list(stream) == blocks
    assert len(calls) == 1
    travelled = pickle.loads(pickle.dumps(stream))
    READINGS.clear()
    assert list(travelled) == list(travelled) == blocks
    assert len(READINGS) == 1  # worked out anew there, once

    calls.clear()
    long = [b"x" * CachedStream.MOST_CACHED, b"y"]
    stream = CachedStream(noted_blocks, calls, long)
    assert list(stream) == list(stream) == long
    assert len(calls) == 2


def test_a_long_stream_holds_no_block_after_a_reading() -> None:
    """Neither if its first block is too long, nor if a later one is."""
    for lengths in (CachedStream.MOST_CACHED + 1, 1), (2, 2, CachedStream.MOST_CACHED, 1):
        alive: list[weakref.ref[Rows]] = []
        stream = CachedStream(rows_of, alive, lengths)
        assert [len(block) for block in stream] == list(lengths)
        assert len(alive) == len(lengths) and not any(ref() is not None for ref in alive)


def test_readings_side_by_side_of_a_long_stream_are_each_whole() -> None:
    """One of them reaches one row too many, and goes on; the others read by themselves."""
    calls: list[int] = []
    blocks = [b"ab", b"cd", b"x" * CachedStream.MOST_CACHED, b"y"]
    stream = CachedStream(noted_blocks, calls, blocks)
    behind, ahead = iter(stream), iter(stream)
    assert next(behind) == b"ab"
    assert list(ahead) == blocks and len(calls) == 1
    assert [b"ab", *behind] == blocks and len(calls) == 2
    assert list(stream) == blocks and len(calls) == 3


def test_a_stream_that_fails_does_so_for_every_reading() -> None:
    stream = CachedStream(failing_blocks)
    first, second = iter(stream), iter(stream)
    assert (next(first), next(second)) == (b"ab", b"ab")
    for reading in (first, second, stream):
        with pytest.raises(OptionError, match="no more"):
            list(reading)


def failing_blocks() -> Iterator[bytes]:
    yield b"ab"
    raise OptionError("no more")


def test_threads_may_read_a_stream_at_once() -> None:
    blocks = [bytes([k]) for k in range(200)]
    for _ in range(20):
        calls: list[int] = []
        stream = CachedStream(slow_blocks, calls, blocks)
        with ThreadPoolExecutor(4) as pool:
            assert list(pool.map(list, [stream] * 4)) == [blocks] * 4
        assert len(calls) == 1


def slow_blocks(calls: list[int], blocks: list[bytes]) -> Iterator[bytes]:
    calls.append(0)
    for block in blocks:
        time.sleep(0)  # another thread may go on
        yield block


READINGS: list[int] = []
"""An entry for each reading of ``noted_blocks``, in whichever copy of a stream."""


def noted_blocks(calls: list[int], blocks: list[bytes]) -> Iterator[bytes]:
    calls.append(0)
    READINGS.append(0)
    return iter(blocks)


class Rows:
    """A block of so many rows, which a test may watch."""

    def __init__(self, rows: int) -> None:
        self._rows = rows

    def __len__(self) -> int:
        return self._rows


def rows_of(alive: list[weakref.ref[Rows]], lengths: tuple[int, ...]) -> Iterator[Rows]:
    for length in lengths:
        block = Rows(length)
        alive.append(weakref.ref(block))
        yield block
        del block


def noted(calls: list[int], upto: int) -> Iterator[int]:
    calls.append(upto)
    return iter(range(upto))


class Steps:
    def __init__(self, upto: int) -> None:
        self.upto = upto

    def steps(self, first: int = 0) -> Iterator[int]:
        return iter(range(first, self.upto))

    def __iter__(self) -> Iterator[int]:
        return self.steps()


def test_streams_are_recipes() -> None:
    """Functions of modules are found in another process, too; nothing else is accepted."""
    for stream in (Stream(Steps(3).steps), Stream(iter, Steps(3)), Stream(reversed, (2, 1, 0))):
        assert list(pickle.loads(pickle.dumps(stream))) == list(stream) == [0, 1, 2]

    def nested() -> Iterator[int]:
        return iter([1])

    class Nested(Steps):
        pass

    remedy = r"at the top level of its module and pass the values that it needs"
    for arguments in (
        (lambda: iter([1]),),
        (nested,),
        (Nested, 3),
        (Nested(3).steps,),
        (iter, Nested(3)),
        (map, nested, (1, 2)),
        (partial(noted, calls=nested), 3),
    ):
        with pytest.raises(TypeError, match=remedy):
            Stream(*arguments)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="can be read only once"):
        Stream(iter, (k for k in range(3)))
