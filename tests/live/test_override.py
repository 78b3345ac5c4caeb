"""An overridden run plays its table slower: whole, on its path, within every limit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.live.bench import Bench, table_of_counts, there_and_back, winder
from tests.live.test_pace import CLOCK, PLACES, plan_ticks
from tests.live.test_tail import ROUNDING, off_path
from threadline.errors import CommandError
from threadline.files import Event, RunEnd
from threadline.live.braking import CountLimits, change_rate
from threadline.live.path_window import PathWindow
from threadline.live.states import Cause, State

ROWS = there_and_back()
TICK_S = float(CLOCK.period_s)


def events(bench: Bench, kind: str) -> list[Event]:
    return [e for block in bench.sink.blocks for e in block.events if e.kind == kind]


def check_whole(bench: Bench) -> None:
    """Check counts, path, limits and the recorded times of a finished run of ``ROWS``."""
    assert bench.executor.ended == (RunEnd.COMPLETED, "")
    counts = bench.commanded()
    assert counts[-1].tolist() == ROWS.sum(axis=0).tolist()
    assert (np.diff(counts[:, 0]) >= 0).all()  # A never turns back in this table
    assert np.abs(np.diff(counts[:, 0])).max() <= 11
    assert off_path(counts) <= 1.0
    limits = CountLimits.of(winder())
    assert (np.abs(np.diff(counts, 2, axis=0)).max(axis=0) <= limits.acceleration + ROUNDING).all()
    ticks = plan_ticks(bench.sink.blocks, len(counts))
    assert (np.diff(ticks) >= 0.0).all()
    along = np.minimum(ticks, len(ROWS))
    expected = [np.interp(along, np.arange(len(PLACES)), PLACES[:, k]) for k in range(3)]
    assert np.abs(counts - np.stack(expected, axis=1)).max() <= 0.5 + 1e-4


@pytest.mark.long(shown_by="test_a_change_of_rate_keeps_every_limit")
@settings(max_examples=20)
@given(
    st.lists(
        st.tuples(st.integers(0, 200), st.integers(10, 100), st.booleans(), st.integers(0, 60)),
        min_size=1, max_size=5,
    ),
    st.integers(10, 100),
)  # fmt: skip
def test_any_overrides_holds_and_resumes_play_the_table(
    asked: list[tuple[int, int, bool, int]], last: int
) -> None:
    """Also while it brakes, starts again or changes its rate: no row is skipped or repeated."""
    bench = Bench().ready()
    bench.executor.start(table_of_counts(ROWS))
    for ticks, percent, holds, rests in asked:
        bench.go_on(bench.executor.tick + ticks)
        bench.desk.override(percent)
        bench.executor.obey()
        if holds:
            for cause in (Cause.HOLD, Cause.RESUME):
                bench.go_on(bench.executor.tick + rests)
                bench.desk.ask(cause)
                bench.executor.obey()
    if bench.executor.state is State.RUNNING:
        bench.executor.override(last)
        assert bench.executor.percent == last
    bench.go_on()
    check_whole(bench)


@given(st.floats(3.0, 500.0), st.integers(10, 99), st.integers(10, 100), st.sampled_from([10, 100]))
def test_a_change_of_rate_keeps_every_limit(
    place: float, before: int, after: int, peak: float
) -> None:
    limits = CountLimits.of(winder())
    window = PathWindow(table_of_counts(there_and_back(peak)))
    window.reach(len(ROWS))
    rates = before / 100.0, after / 100.0
    places = change_rate(window, place, rates, limits)
    if after == 100:
        assert places[-1] == round(places[-1])
    comes = place - rates[0] * np.arange(3.0, -1.0, -1.0)
    whole = np.concatenate([comes, places, places[-1] + rates[1] * np.arange(1, 4)])
    steps = np.diff(whole)
    assert steps.min() >= min(rates) - 1e-9
    assert steps.max() <= max(rates) + 1e-9
    asked = np.abs(np.diff(np.rint(window.counts(whole)), 2, axis=0)).max(axis=0)
    assert (asked <= limits.acceleration + ROUNDING).all()


@pytest.mark.long(only="10")
@pytest.mark.parametrize("percent", [10, 37, 50, 99])
def test_a_slower_run_takes_longer_and_tells_it_in_a_few_events(percent: int) -> None:
    """From its second row on; one event for each tick would be hundreds to thousands."""
    bench = Bench().ready()
    bench.executor.start(table_of_counts(ROWS))
    bench.go_on(5)
    bench.desk.override(percent)
    bench.go_on()
    check_whole(bench)
    ticks = plan_ticks(bench.sink.blocks, len(bench.commanded()))
    arrived = int(np.argmax(ticks >= len(ROWS) - 1e-6))
    # 25 rows were sent; the rate changes in 100 ticks, on average the mean of both; then slow.
    rate = percent / 100.0
    slow = (len(ROWS) - 25 - 100 * (1.0 + rate) / 2.0) / rate
    assert arrived == pytest.approx(125 + slow, abs=2.0)
    assert len(events(bench, "plan")) < 110
    assert [(e.name, e.value) for e in events(bench, "override")] == [
        (f"feed {percent} %", percent / 100.0)
    ]
    # After the last row the plan goes on with the clock, as in any other run.
    assert np.diff(ticks[arrived + 1 :]) == pytest.approx(1.0)


def test_a_hold_keeps_the_override_and_a_stop_works_from_it() -> None:
    bench = Bench().ready()
    bench.executor.start(table_of_counts(ROWS))
    bench.go_on(100)
    bench.desk.override(40)
    bench.go_on(300)
    bench.desk.ask(Cause.HOLD)
    bench.go_on(420)
    assert bench.executor.state is State.HOLDING
    bench.desk.ask(Cause.RESUME)
    bench.go_on(600)
    ticks = plan_ticks(bench.sink.blocks, 590)
    assert np.diff(ticks[230:290]) == pytest.approx(0.4)
    assert np.diff(ticks[350:420]) == pytest.approx(0.0)
    assert np.diff(ticks[540:]) == pytest.approx(0.4)
    bench.desk.ask(Cause.STOP)
    bench.go_on()
    assert bench.executor.ended is not None
    assert bench.executor.ended[0] is RunEnd.STOPPED
    assert off_path(bench.commanded()) <= 1.0


def test_a_run_back_at_the_whole_feed_plays_the_rows_of_its_table() -> None:
    bench = Bench().ready()
    bench.executor.start(table_of_counts(ROWS))
    bench.go_on(100)
    bench.desk.override(30)
    bench.go_on(250)
    bench.desk.override(100)
    bench.go_on()
    check_whole(bench)
    rows = np.diff(bench.commanded(), axis=0)
    assert any(np.array_equal(rows[k : k + 300], ROWS[-300:]) for k in range(len(rows) - 300))


def test_an_override_that_was_braked_away_is_told_when_it_is_played() -> None:
    """It was requested and sent ahead, then a hold cut it off before it was played."""
    bench = Bench().ready()
    bench.wire.group = 1
    bench.executor.start(table_of_counts(ROWS))
    bench.go_on(100)
    bench.desk.override(50)
    bench.go_on(101)
    bench.desk.ask(Cause.HOLD)
    bench.go_on(180)
    assert not events(bench, "override")
    bench.desk.ask(Cause.RESUME)
    bench.go_on()
    check_whole(bench)
    assert [e.name for e in events(bench, "override")] == ["feed 50 %"]


@pytest.mark.parametrize(
    ("percent", "words"),
    [(9, "10 to 100 %"), (0, "10 to 100 %"), (-50, "10 to 100 %"), (101, "10 to 100 %")],
)
def test_more_or_less_than_was_proven_is_refused(percent: int, words: str) -> None:
    bench = Bench().ready()
    bench.executor.start(table_of_counts(ROWS))
    bench.go_on(100)
    with pytest.raises(CommandError, match=words):
        bench.executor.override(percent)
    bench.desk.override(percent)  # at the desk such an override is recorded, and changes nothing
    bench.go_on()
    assert [text for *_, cause, text in bench.sink.log if cause is Cause.OVERRIDE] == [
        f"an override of {percent} % is not within the 10 to 100 % that the proof covers"
    ]
    assert np.array_equal(
        np.diff(bench.commanded(), axis=0)[: len(ROWS) - 1], ROWS[: len(ROWS) - 1]
    )


def test_without_a_run_or_where_it_was_found_to_spoil_the_work_it_is_refused() -> None:
    bench = Bench().ready()
    with pytest.raises(CommandError, match="while the machine is idle"):
        bench.executor.override(50)
    bench.executor.start(table_of_counts(ROWS), no_override="at 50 % it shakes")
    bench.go_on(100)
    with pytest.raises(CommandError, match="at 50 % it shakes"):
        bench.executor.override(50)
    assert bench.executor.percent == 100
    bench.desk.ask(Cause.STOP)
    bench.go_on()


def test_a_stop_drops_an_override_that_was_asked_before_it() -> None:
    bench = Bench().ready()
    bench.executor.start(table_of_counts(ROWS))
    bench.go_on(100)
    bench.desk.override(50)
    bench.desk.ask(Cause.STOP)
    bench.go_on()
    assert not [cause for *_, cause, _ in bench.sink.log if cause is Cause.OVERRIDE]
