"""Step tables by stitches: checked, locked, read in chunks, the same in another process."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from threadline.files import Clock, StepPlay, StepTable, StitchBlock, Stream

LIBRARY = tuple(
    StepTable(units=length, intervals=np.full(48 * length, 1600 // length)) for length in (1, 2, 5)
)
WINDOW = 5 * 48 * 320


def stitches(count: int, chunk: int) -> Iterator[StitchBlock]:
    """Yield a zigzag: X by the tables in turn, Y every second stitch."""
    for first in range(0, count, chunk):
        k = np.arange(first, min(first + chunk, count))
        even = k % 2 == 0
        yield StitchBlock(
            first_stitch=first,
            begin=3 * WINDOW * k,
            window=np.full(len(k), WINDOW),
            table=np.stack([k % 3, np.where(even, 0, -1)], axis=1),
            sign=np.stack([np.where(even, 1, -1), np.where(even, 1, 0)], axis=1),
            start=np.full(len(k), 1200),
            needle=np.ones(len(k), dtype=np.int64),
            operation=k,
        )


def play(blocks: Stream[StitchBlock], library: tuple[StepTable, ...] = LIBRARY) -> StepPlay:
    return StepPlay(
        clock=Clock("timer", Fraction(1, 16_000_000)),
        counted_by="time",
        steps_per_turn=3600,
        window_angle=1200,
        axes=("X", "Y"),
        steps_per_unit=np.array([480e3, 480e3]),
        start_steps=np.array([7, 0]),
        library=library,
        blocks=blocks,
        duration_ticks=3000 * WINDOW,
        job_sha256="",
        machine_sha256="",
    )


def test_end_of_a_step_play_does_not_depend_on_its_chunks() -> None:
    """Stitch by stitch in plain Python."""
    x, y = 7, 0
    for k in range(1000):
        x += (1 if k % 2 == 0 else -1) * 48 * (1, 2, 5)[k % 3]
        y += 48 if k % 2 == 0 else 0
    for chunk in (1000, 64, 7):
        made = play(Stream(stitches, 1000, chunk))
        assert made.stitch_count() == 1000
        assert made.end_steps().tolist() == [x, y]
        assert made.end_steps().tolist() == [x, y]  # read again
        assert max(len(block) for block in made) <= chunk


def test_nothing_of_it_can_be_changed_here_or_elsewhere() -> None:
    made = play(Stream(stitches, 20, 7))
    for one in (made, pickle.loads(pickle.dumps(made))):
        (first, *_) = one
        intervals = [table.intervals for table in one.library]
        for array in (*intervals, one.start_steps, one.steps_per_unit, first.table, first.start):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1
        assert one.end_steps().tolist() == made.end_steps().tolist()
        assert one.rows_sha256() == made.rows_sha256()


def block(**changes: object) -> StitchBlock:
    """Return a block of two stitches with some fields changed."""
    given = {
        "first_stitch": 0,
        "begin": np.array([0, 3 * WINDOW]),
        "window": np.array([WINDOW, WINDOW]),
        "table": np.array([[0, 1], [2, -1]]),
        "sign": np.array([[1, -1], [1, 0]]),
        "start": np.array([1200, 1200]),
        "needle": np.array([1, 0]),
        "operation": np.array([0, 1]),
    }
    return StitchBlock(**(given | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sign": np.array([[1, -1], [1, 1]])}, "stitch 1: a sign is 1 or -1, and 0 exactly"),
        ({"sign": np.array([[2, -1], [1, 0]])}, "stitch 0: a sign"),
        ({"start": np.array([0])}, "start 1"),
        ({"begin": np.array([0, WINDOW - 1])}, "stitch 1 begins before the window"),
        ({"sign": np.array([[1], [1]])}, "sign \\(2, 1\\)"),
    ],
)
def test_stitches_that_make_no_sense_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        block(**changes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"table": np.array([[0, 3], [2, -1]])}, "stitch 0: table \\[0, 3\\] is not from -1 to 2"),
        ({"start": np.array([0, 3600])}, "stitch 1: start \\[3600\\] is not from 0 to 3599"),
        ({"first_stitch": 5}, "expected stitch 0 .* got stitch 5"),
        ({"needle": np.array([2, 0])}, "stitch 0: needle"),
        ({"window": np.array([WINDOW, 100])}, "stitch 1: its table is longer than its window"),
        ({"begin": np.array([0, 3001 * WINDOW])}, "stitch 1: its window ends"),
    ],
)
def test_stitches_that_do_not_fit_are_refused_as_they_are_read(changes, message) -> None:
    with pytest.raises(ValueError, match=message):
        play(Stream.of([block(**changes)])).stitch_count()


@pytest.mark.parametrize("intervals", [np.empty(0, dtype=np.int64), np.array([3, 0, 3])])
def test_tables_without_time_are_refused(intervals: np.ndarray) -> None:
    with pytest.raises(ValueError, match="table of 7 units: it needs intervals"):
        StepTable(units=7, intervals=intervals)


def test_tables_by_angle_fill_the_window_of_angles() -> None:
    """4800 angles of a table fit in no window of 1200, however long the shaft takes."""
    made = replace(play(Stream.of([block()])), counted_by="angle", steps_per_turn=10**6)
    with pytest.raises(ValueError, match="stitch 0: its table is longer"):
        made.stitch_count()
    assert replace(made, window_angle=WINDOW).stitch_count() == 2


def test_the_hash_tells_commands_apart_and_not_how_they_are_cut() -> None:
    whole = play(Stream(stitches, 100, 100))
    assert play(Stream(stitches, 100, 7)).rows_sha256() == whole.rows_sha256()
    others = [
        replace(whole, counted_by="angle", steps_per_turn=10**6, window_angle=WINDOW),
        replace(whole, duration_ticks=whole.duration_ticks + 1),
        play(Stream(stitches, 99, 7)),
        play(Stream(stitches, 100, 7), (*LIBRARY[:2], LIBRARY[1])),
    ]
    assert len({one.rows_sha256() for one in (whole, *others)}) == 5
