"""The rows in a machine always end at rest, on the path, within the limits of every axis."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.live.bench import Bench, table_of_counts, there_and_back, winder
from tests.made import read_once
from threadline.files import ChannelKind, Recording, RunEnd
from threadline.live.braking import MOST_PLACES, CountLimits, brake, rise
from threadline.live.path_window import PathWindow
from threadline.live.states import Cause, State
from threadline.twin import simulate

ROWS = there_and_back()
PLACES = np.concatenate([np.zeros((1, 3), np.int64), np.cumsum(ROWS, axis=0)])
# A count of the table and one of its derived rows: half a count each, four times so in the
# second difference.
ROUNDING = 4.0


def off_path(counts: np.ndarray) -> float:
    """Return the largest distance, in counts, from a chord of the table, the same for all axes."""
    # A turns one count for each of X, forth and back, so it shows the place along the path.
    along = counts[:, 0].astype(float)
    x = np.interp(along, PLACES[:, 0], PLACES[:, 1])
    y = np.interp(along, PLACES[:, 0], PLACES[:, 2])
    return float(max(np.abs(counts[:, 1] - x).max(), np.abs(counts[:, 2] - y).max()))


def test_undisturbed_run_equals_the_simulation_to_the_bit() -> None:
    table = table_of_counts(ROWS)
    bench = Bench().ready()
    bench.executor.start(table)
    bench.go_on()
    expected = read_once(simulate(table, winder()))
    assert bench.executor.state is State.IDLE
    assert bench.executor.ended == (RunEnd.COMPLETED, "")
    for channel in expected.channels:
        assert np.array_equal(bench.channel(channel.name), expected.samples(channel.name)[1])
    events = [event for block in bench.sink.blocks for event in block.events]
    assert events == [event for block in expected for event in block.events]


def test_no_more_than_a_tenth_of_a_second_is_held() -> None:
    """This counts wanted rows; after them there is only the tail."""
    bench = Bench().ready()
    held: list[int] = []
    machine = bench.wire.machine
    bench.wire.before_play = lambda: held.append(machine.wanted)
    bench.executor.start(table_of_counts(ROWS))
    bench.go_on()
    assert max(held) == 20  # ticks of 5 ms
    assert min(held[: len(ROWS) // 5 - 8]) > 10  # and it is kept full


@pytest.mark.parametrize("tick", [70, 130, 250])
def test_machine_brakes_within_its_limits_when_refills_stop_at_speed(tick: int) -> None:
    """At 144 mm/s a standstill at once would take three times the acceleration of X."""
    bench = Bench().ready()
    bench.executor.start(table_of_counts(there_and_back(peak=40.0, cruise=100)))
    bench.go_on(tick)
    bench.wire.mute = True
    while not bench.wire.machine.standing:
        bench.wire.machine.play(5)
        message = bench.wire.receive()
        assert message is not None
        bench.sink.block(bench.executor.far_end.reported(message, None))
    limit = CountLimits.of(winder()).acceleration + ROUNDING
    rows = np.diff(bench.commanded(), axis=0, append=bench.commanded()[-1:])
    assert (np.abs(np.diff(rows, axis=0)).max(axis=0) <= limit).all()


@settings(max_examples=25)
@given(st.integers(1, len(ROWS) - 1))
def test_machine_brakes_on_the_path_when_refills_stop(tick: int) -> None:
    """At any instant: within the limits, on the path, within 100 ms and the braking distance."""
    bench = Bench().ready()
    bench.executor.start(table_of_counts(ROWS))
    bench.go_on(tick)
    bench.wire.mute = True
    before = bench.executor.tick
    machine = bench.wire.machine
    while not machine.standing:
        machine.play(5)
        message = bench.wire.receive()
        assert message is not None
        bench.sink.block(bench.executor.far_end.reported(message, None))
    counts = bench.commanded()
    assert off_path(counts) <= 1.0
    limits = CountLimits.of(winder())
    rows = np.diff(counts, axis=0)
    assert (np.abs(np.diff(rows, axis=0)).max(axis=0) <= limits.acceleration + ROUNDING).all()
    # 20 rows of 10 counts, and braking from there: a closed form with half of the limit.
    fastest = 10.0
    way = 20 * fastest + fastest**2 / (2 * 0.5 * limits.acceleration[2]) + 20
    assert abs(int(counts[-1, 0]) - int(counts[min(before, len(counts) - 1), 0])) <= way


@given(st.floats(3.0, len(ROWS) - 3.0), st.sampled_from([2.0, 10.0, 40.0, 100.0]))
def test_braking_and_rising_keep_every_limit(place: float, peak: float) -> None:
    rows = there_and_back(peak)
    limits = CountLimits.of(winder())
    window = PathWindow(table_of_counts(rows))
    window.reach(len(rows))
    ends = brake(window, (place - 2.0, place - 1.0, place), limits)
    assert (np.diff(np.concatenate([[place], ends])) >= -1e-12).all()
    assert len(ends) < MOST_PLACES
    whole = np.concatenate([[place - 2.0, place - 1.0, place], ends, [ends[-1]] * 2])
    again = rise(window, float(ends[-1]), limits)
    assert again[-1] == round(again[-1])
    back = np.concatenate([[ends[-1]] * 3, again, again[-1] + np.arange(1, 4)])
    # Each table needs less than the limit of every axis.
    for places in (whole, back):
        counts = np.rint(window.counts(places))
        asked = np.abs(np.diff(counts, 2, axis=0)).max(axis=0)
        assert (asked <= limits.acceleration + ROUNDING).all(), (place, peak, asked)


@pytest.mark.long(shown_by="test_machine_brakes_on_the_path_when_refills_stop")
@settings(max_examples=20)
@given(st.lists(st.integers(0, 260), min_size=1, max_size=4), st.booleans())
def test_hold_and_resume_skip_no_row_and_repeat_none(ticks: list[int], early: bool) -> None:
    """At any instants, repeatedly, also while it brakes: the sums equal the table's."""
    bench = Bench().ready()
    bench.executor.start(table_of_counts(ROWS))
    for tick in ticks:
        bench.go_on(bench.executor.tick + tick)
        bench.desk.ask(Cause.HOLD)
        bench.executor.obey()
        held = bench.executor.state is State.HOLDING
        bench.go_on(bench.executor.tick + (0 if early else 60))
        bench.desk.ask(Cause.RESUME)
        bench.executor.obey()
        assert not held or bench.executor.state is State.RUNNING
    bench.go_on()
    assert bench.executor.ended == (RunEnd.COMPLETED, "")
    counts = bench.commanded()
    assert counts[-1].tolist() == ROWS.sum(axis=0).tolist()
    # A never turns back in this table: a repeated or skipped row would show in it.
    assert (np.diff(counts[:, 0]) >= 0).all()
    assert np.abs(np.diff(counts[:, 0])).max() <= 11
    assert off_path(counts) <= 1.0
    limits = CountLimits.of(winder())
    assert (np.abs(np.diff(counts, 2, axis=0)).max(axis=0) <= limits.acceleration + ROUNDING).all()


@pytest.mark.parametrize("tick", [1, 40, 230, 300, 500, 620])
def test_a_stop_is_ahead_of_what_is_held_and_what_was_asked(tick: int) -> None:
    bench = Bench().ready()
    bench.executor.start(table_of_counts(ROWS))
    bench.go_on(tick)
    at = bench.executor.tick
    for cause in (Cause.HOLD, Cause.RESUME, Cause.HOLD, Cause.STOP, Cause.RESUME):
        bench.desk.ask(cause)
    bench.go_on()
    assert bench.executor.state is State.IDLE
    assert bench.executor.ended == (RunEnd.STOPPED, "stopped by the operator")
    counts = bench.commanded()
    # It does not play the 20 held rows: 4 ticks at 10 counts brake within the limits.
    assert counts[-1, 0] - counts[min(at, len(counts) - 1), 0] <= 4 * 10
    causes = [cause for _, _, cause, _ in bench.sink.log]
    assert causes[causes.index(Cause.STOP) :] == [Cause.STOP, Cause.AT_REST]
    assert not {Cause.HOLD, Cause.RESUME} & set(causes)  # dropped, not only overtaken


def test_a_recording_of_a_stop_says_so() -> None:
    bench = Bench().ready()
    table = table_of_counts(ROWS)
    bench.executor.start(table)
    bench.go_on(100)
    bench.desk.ask(Cause.STOP)
    bench.go_on()
    recording = Recording(
        channels=simulate(table, winder()).channels,
        blocks=bench.sink.blocks,
        job_sha256="",
        machine_sha256="",
        simulated=True,
    )
    assert recording.find(ChannelKind.LOAD, "X") is not None
    outcome = recording.outcome()
    assert (outcome.ended, outcome.text) == (RunEnd.STOPPED, "stopped by the operator")
