"""A machine reports the plan time that it plays if its clock shows another one."""

from __future__ import annotations

import numpy as np
import pytest

from tests.live.bench import Bench, table_of_counts, there_and_back
from threadline.files import Clock, RecordingBlock, RunEnd
from threadline.live.pace import Pace
from threadline.live.states import Cause
from threadline.machine import load_machine
from threadline.verdict.progress import PlanClock

ROWS = there_and_back()
PLACES = np.concatenate([np.zeros((1, 3), np.int64), np.cumsum(ROWS, axis=0)])
CLOCK: Clock = load_machine("lathe-winder").tick_clock


def plan_ticks(blocks: list[RecordingBlock], number: int) -> np.ndarray:
    """Return the plan time of each tick, in ticks, read block by block."""
    reader, found = PlanClock(CLOCK), []
    for block in blocks:
        reader.take(block.events)
        first = block.first_tick[CLOCK.name]
        time_s = CLOCK.times_s(first, len(block.samples["operation"]))
        found.append(reader.at(time_s)[0] / float(CLOCK.period_s))
    return np.concatenate(found)[:number]


@pytest.mark.parametrize("seed", range(6))
def test_the_axes_are_told_where_the_table_is_at_the_plans_time(seed: int) -> None:
    """In runs with random holds, some while it brakes or starts, and some with a stop."""
    rng = np.random.default_rng(seed)
    bench = Bench().ready()
    bench.executor.start(table_of_counts(ROWS))
    for wait, rest in rng.integers(1, [200, 40], size=(int(rng.integers(1, 4)), 2)).tolist():
        bench.go_on(bench.executor.tick + wait)
        for cause, ticks in ((Cause.HOLD, rest), (Cause.RESUME, 3)):
            bench.desk.ask(cause)
            bench.executor.obey()
            bench.go_on(bench.executor.tick + ticks)
    if seed % 3 == 2 and not bench.executor.over:
        bench.desk.ask(Cause.STOP)
    bench.go_on()
    counts = bench.commanded()
    ticks = plan_ticks(bench.sink.blocks, len(counts))
    along = np.minimum(ticks, len(ROWS))  # after the last row the clock goes on
    expected = [np.interp(along, np.arange(len(PLACES)), PLACES[:, k]) for k in range(3)]
    assert np.abs(counts - np.stack(expected, axis=1)).max() <= 0.5 + 1e-6
    assert (np.diff(ticks) >= 0.0).all()
    if bench.executor.ended == (RunEnd.COMPLETED, ""):
        assert ticks[-1] == round(ticks[-1])  # on whole rows again


def test_a_run_that_nothing_held_tells_nothing() -> None:
    bench = Bench().ready()
    bench.executor.start(table_of_counts(ROWS))
    bench.go_on()
    assert not [e for block in bench.sink.blocks for e in block.events if e.kind == "plan"]


def test_rows_played_after_refills_stop_are_reported() -> None:
    bench = Bench().ready()
    bench.executor.start(table_of_counts(ROWS))
    bench.go_on(130)
    bench.wire.mute = True
    for _ in range(20):
        bench.wire.machine.play(5)
        message = bench.wire.receive()
        assert message is not None
        bench.sink.block(bench.executor.far_end.reported(message, None))
    counts = bench.commanded()
    ticks = plan_ticks(bench.sink.blocks, len(counts))
    assert ticks[-1] == ticks[-30] < len(counts) - 1
    x = np.interp(ticks, np.arange(len(PLACES)), PLACES[:, 1])
    assert np.abs(counts[:, 1] - x).max() <= 0.5 + 1e-6


def test_any_places_come_back_to_the_bit() -> None:
    """Random places, in reports of any length; the reader asks in other pieces."""
    rng = np.random.default_rng(5)
    steps = rng.choice([0.0, 0.0, 0.0, 0.25, 0.8, 1.0, 1.0, 1.0, 1.0], size=600)
    steps[100:160], steps[300:400] = 0.0, 1.0
    places = np.cumsum(steps)
    pace, events, at = Pace(CLOCK), [], 0
    while at < len(places):
        n = int(rng.integers(1, 40))
        events += pace.played(at, places[at : at + n])
        at += n
    reader, found = PlanClock(CLOCK), [0.0]
    unheld = np.arange(3.0)
    assert reader.at(unheld)[0] is unheld  # to the bit, and without extra events
    for first in range(1, len(places) + 1, 37):
        last = min(first + 37, len(places) + 1)
        reader.take([event for event in events if first <= event.tick < last])
        found += reader.at(CLOCK.times_s(first, last - first))[0].tolist()
    period_s = float(CLOCK.period_s)
    assert np.abs(np.array(found[1:]) - places * period_s).max() < 1e-12
    assert len(events) < 2 * np.count_nonzero(np.diff(steps)) + 4
