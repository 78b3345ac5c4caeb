"""Runs side by side drop places far behind them all; each keeps its own progress error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from threadline.files import ChannelKind, Recording, RecordingBlock, Stream
from threadline.verdict import Criterion, Judge, judge

from .builders import TICK_S, follow, plan_through, record, spec_of

XY = ("X", "Y")
POINTS = [[0.0, 0.0], [0.04, 0.0], [0.04, 0.03], [0.0, 0.03]]
PER_MOVE, LAG = 20, 12  # 2 and 1.5 mm from sample to sample
SPEC = spec_of(Criterion(name="progress_error", limit=5e-4), lag_s=LAG * TICK_S)
PLAN = plan_through(POINTS, XY, move_s=PER_MOVE * TICK_S)
COMMAND, OPERATION = follow(POINTS, PER_MOVE, standstill=30)


def alone(actual: np.ndarray) -> Recording:
    channels = {ChannelKind.LOAD: actual, ChannelKind.COMMANDED: COMMAND}
    return record(XY, channels, OPERATION, per_block=17)


def side_by_side(moves: list[np.ndarray]) -> Recording:
    """One recording of several runs; each channel that differs between them is (samples, runs)."""
    each = [list(alone(actual)) for actual in moves]
    blocks = [
        replace(
            rows[0],
            samples={
                name: np.stack([row.samples[name] for row in rows], axis=1)
                if name.endswith(".load")
                else samples
                for name, samples in rows[0].samples.items()
            },
        )
        for rows in zip(*each, strict=True)
    ]
    return replace(alone(moves[0]), blocks=Stream(read, READINGS, tuple(blocks)), runs=len(moves))


READINGS: list[int] = []
"""An entry for each reading of a recording."""


def read(readings: list[int], blocks: tuple[RecordingBlock, ...]) -> Iterator[RecordingBlock]:
    """Yield the blocks of a recording, and note that it is read."""
    readings.append(1)
    return iter(blocks)


def late(by: int) -> np.ndarray:
    return np.vstack([np.repeat(COMMAND[:1], by, axis=0), COMMAND[:-by]])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("scale_m", [1e-5, 5e-4, 5e-3])
def test_each_run_has_the_error_that_it_has_alone(seed: int, scale_m: float) -> None:
    """Random ways, some later than others, from far below the way of a sample to beyond it."""
    rng = np.random.default_rng(seed)
    moves = [late(int(by)) + rng.normal(scale=scale_m, size=COMMAND.shape) for by in (1, 3, 6, 9)]
    found = Judge(PLAN, SPEC).each(side_by_side(moves)).row("progress_error")
    together = judge([side_by_side(moves)], PLAN, SPEC).result("progress_error")
    singles = [judge([alone(way)], PLAN, SPEC).result("progress_error") for way in moves]
    np.testing.assert_allclose(found.values, [s.measured for s in singles], rtol=0, atol=1e-12)
    worst = int(np.argmax(found.values))
    worst_of_all = (together.measured, together.time_s, together.note, together.run)
    one = singles[worst]
    assert worst_of_all == (pytest.approx(one.measured, abs=1e-12), one.time_s, one.note, worst + 1)


def test_a_place_that_was_given_up_and_could_be_better_is_looked_at_again() -> None:
    """Late by 2 samples, then back for a while to where 9 samples are: one run of two.

    If that way back were right, a tool would have had to stay 14 mm behind, and this place was
    dropped long before. With the remaining places the error would be 14 mm; the least is 7 mm.
    """
    good, back = late(2), late(2)
    READINGS.clear()
    np.testing.assert_array_less(judged_values([good, good + 1e-6]), 1e-4)
    once = len(READINGS)
    READINGS.clear()
    back[14:17] = late(9)[14:17]
    values = judged_values([good, back])
    assert len(READINGS) == once + 1
    single = judge([alone(back)], PLAN, SPEC).result("progress_error").measured
    assert values[1] == pytest.approx(single, abs=1e-12)
    assert values[0] < 1e-9 and 5e-3 < single < 9e-3
    # Further runs of the plan keep places as far behind: they are read once.
    READINGS.clear()
    np.testing.assert_array_equal(judged_values([good, back]), values)
    assert len(READINGS) == once


def judged_values(moves: list[np.ndarray]) -> np.ndarray:
    return Judge(PLAN, SPEC).each(side_by_side(moves)).row("progress_error").values


def test_every_place_of_a_single_run_is_kept() -> None:
    """The run may come from a live machine, whose samples can be read only once."""
    back = late(2)
    readings = []
    for way in (late(2), back):
        READINGS.clear()
        judge([side_by_side([way])], PLAN, SPEC)
        readings.append(len(READINGS))
        back[14:17] = late(9)[14:17]
    assert readings[0] == readings[1]
