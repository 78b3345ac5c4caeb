"""Step tables by stitches: checked, locked, read in chunks, the same in another process."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from fractions import Fraction

import numpy as np
import pytest

from threadline.signals import Clock, ShaftClock, StepPlay, StitchBlock, Stream

SHAFT = ShaftClock("main", 3600, (Fraction(0),), (Fraction(25, 9),))
LIBRARY = tuple(np.full(48 * length, 1600 // length) for length in (1, 2, 5))


def stitches(count: int, chunk: int) -> Iterator[StitchBlock]:
    """Yield a zigzag: X by the tables in turn, Y every second stitch."""
    for first in range(0, count, chunk):
        k = np.arange(first, min(first + chunk, count))
        even = k % 2 == 0
        yield StitchBlock(
            first_stitch=first,
            table=np.stack([k % 3, np.where(even, 0, -1)], axis=1),
            sign=np.stack([np.where(even, 1, -1), np.where(even, 1, 0)], axis=1),
            start=np.full(len(k), 1200),
            operation=k,
        )


def play(blocks: Stream[StitchBlock], library: tuple[np.ndarray, ...] = LIBRARY) -> StepPlay:
    return StepPlay(
        clock=Clock("timer", Fraction(1, 16_000_000)),
        shaft=SHAFT,
        axes=("X", "Y"),
        steps_per_unit=np.array([480e3, 480e3]),
        start_steps=np.array([7, 0]),
        library=library,
        blocks=blocks,
        job_sha256="",
        machine_sha256="",
    )


def test_it_ends_where_its_tables_lead_however_it_is_cut() -> None:
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
        for array in (*one.library, one.start_steps, one.steps_per_unit, first.table, first.start):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1
        assert one.end_steps().tolist() == made.end_steps().tolist()
        assert one.shaft == SHAFT


def block(**changes: object) -> StitchBlock:
    """Return a block of two stitches with some fields changed."""
    given = {
        "first_stitch": 0,
        "table": np.array([[0, 1], [2, -1]]),
        "sign": np.array([[1, -1], [1, 0]]),
        "start": np.array([1200, 1200]),
        "operation": np.array([0, 1]),
    }
    return StitchBlock(**(given | changes))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sign": np.array([[1, -1], [1, 1]])}, "stitch 1: a sign is 1 or -1, and 0 exactly"),
        ({"sign": np.array([[2, -1], [1, 0]])}, "stitch 0: a sign"),
        ({"start": np.array([0])}, "start has 1 and operation 2 stitches"),
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
        ({"first_stitch": 5}, "stitch 0 comes as 5"),
    ],
)
def test_stitches_that_do_not_fit_are_refused_as_they_are_read(changes, message) -> None:
    with pytest.raises(ValueError, match=message):
        play(Stream.of([block(**changes)])).stitch_count()


@pytest.mark.parametrize("table", [np.empty(0, dtype=np.int64), np.array([3, 0, 3])])
def test_tables_without_time_are_refused(table: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"library\[1\]: a table has intervals"):
        play(Stream.of([block()]), (LIBRARY[0], table))
