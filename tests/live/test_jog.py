"""A jog never runs away: it ends with its lease, at the end of travel, and with its executor."""

from __future__ import annotations

import time
from contextlib import closing

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.live.bench import Bench, table_of_counts, there_and_back, winder
from tests.live.memory_sink import MemorySink
from threadline.errors import CommandError
from threadline.files import RunEnd
from threadline.live.braking import CountLimits
from threadline.live.executor import Executor
from threadline.live.jogging import JogAhead, manual_feed
from threadline.live.sim_process import REAL_TIME, sim_link
from threadline.live.states import Cause, Desk, State
from threadline.live.wire import Message

MM = 1e3 / winder().counts_per_unit[1]
FAST = 20 * MM / 1e3 / 0.005  # 72 mm/s, the manual feed


def jogged(axis: str = "X", velocity: float = FAST, start: np.ndarray | None = None) -> Bench:
    bench = Bench(start=start).ready()
    bench.executor.jog(axis, velocity)
    return bench


def test_at_manual_feed_it_ends_within_26_mm_of_the_last_renewal() -> None:
    """250 ms at 72.3 mm/s are 18.1 mm; a report of 25 ms and braking are less than 2.1 mm."""
    bench = jogged()
    bench.go_on()
    way = bench.wire.machine.position[1] * MM
    assert 17.0 <= way <= 20.2
    assert bench.executor.state is State.IDLE
    assert "nobody has renewed its lease for 0.25 s" in (bench.executor.ended or ("", ""))[1]


def test_jog_lasts_only_while_it_is_renewed() -> None:
    bench = jogged()
    for tick in range(20, 400, 20):
        bench.go_on(tick)
        bench.executor.renew()
    assert bench.executor.state is State.JOGGING
    renewed, at = bench.executor.tick, bench.wire.machine.position[1] * MM
    assert at == pytest.approx(1e3 * FAST * renewed * 0.005, abs=2.0)
    bench.go_on()
    assert (bench.wire.machine.position[1]) * MM - at <= 26.0
    with pytest.raises(CommandError, match="there is no jog"):
        bench.executor.renew()


@settings(max_examples=15)
@given(st.integers(0, 49), st.sampled_from([-1.0, -0.3, 0.5, 1.0]))
def test_jog_stops_within_10_mm_after_the_link_dies(tick: int, share: float) -> None:
    """100 ms at 72.3 mm/s are 7.2 mm; from 20 counts per tick it brakes in 0.4 mm."""
    bench = jogged(velocity=share * FAST)
    bench.go_on(tick)
    bench.wire.mute = True
    machine = bench.wire.machine
    before = machine.position[1]
    machine.play(400)
    assert machine.standing
    assert abs(machine.position[1] - before) * MM <= 7.2 * abs(share) + 0.5


def test_letting_go_brakes_now() -> None:
    """The 100 ms in the link are not played: v^2 / 2a and the jerk's share, 0.25 + 0.18 mm."""
    bench = jogged()
    bench.go_on(40)
    at = bench.wire.machine.position[1]
    bench.executor.let_go()
    bench.go_on()
    limits = CountLimits.of(winder())
    v, a, j = 20.0, limits.acceleration[1], limits.jerk[1]
    way = v * v / (2 * a) + 0.5 * v * a / j
    assert (bench.wire.machine.position[1] - at) <= way + 2
    assert bench.executor.state is State.IDLE


def test_a_stop_ends_it_ahead_of_renewals() -> None:
    bench = jogged()
    bench.go_on(40)
    bench.executor.renew()
    bench.desk.ask(Cause.STOP)
    bench.go_on()
    assert bench.executor.state is State.IDLE
    assert bench.executor.ended is not None
    assert bench.executor.ended[1] == "stopped by the operator"


@pytest.mark.parametrize("share", [1.0, 0.35])
def test_jog_stops_at_the_end_of_travel(share: float) -> None:
    start = np.array([0, round(495.0 / MM), 0])
    bench = jogged(velocity=share * FAST, start=start)
    for _ in range(40):
        bench.go_on(bench.executor.tick + 20)
        if bench.executor.over:
            break
        bench.executor.renew()
    ends = (start + bench.wire.machine.position)[1] * MM
    assert 499.0 <= ends <= 500.0 + 0.5 * MM
    assert bench.executor.ended is not None
    assert bench.executor.ended[1] == "the end of its travel"


@pytest.mark.parametrize("axis", ["A", "X", "Y"])
def test_jog_keeps_the_limits_of_acceleration_and_jerk(axis: str) -> None:
    """By differences of the sent rows, tail included; rounding adds half a count, doubled each."""
    machine = winder()
    k = machine.axis_names.index(axis)
    limits = CountLimits.of(machine)
    speed = manual_feed(machine)[k] / machine.counts_per_unit[k] / 0.005
    jog = JogAhead(machine, np.zeros(3, np.int64), axis, speed)
    message = jog.extend(40)
    places = np.concatenate([[0] * 4, np.cumsum(message.arrays["counts"][:, k])])
    places = np.concatenate([places, [places[-1]] * 4])
    assert len(message.arrays["counts"]) > 40
    assert np.abs(np.diff(places, 2)).max() <= limits.acceleration[k] + 2.0
    assert np.abs(np.diff(places, 3)).max() <= limits.jerk[k] + 4.0
    assert np.diff(places).max() == pytest.approx(20, abs=1)


def test_impossible_jog_is_refused() -> None:
    bench = Bench()
    with pytest.raises(CommandError, match="'jog' is not possible while the machine is disabled"):
        bench.executor.jog("X", FAST)
    bench.ready()
    with pytest.raises(CommandError, match="there is no axis 'Q'"):
        bench.executor.jog("Q", FAST)
    with pytest.raises(CommandError, match=r"72\.98 mm/s is faster than the manual feed, 72\.257"):
        bench.executor.jog("X", 1.01 * FAST)
    assert bench.executor.state is State.IDLE
    bench.executor.jog("X", FAST)
    with pytest.raises(CommandError, match="while the machine is jogging"):
        bench.executor.start(table_of_counts(there_and_back()))
    bench.go_on()
    # Now it stands elsewhere: a run that begins at 0 is refused.
    with pytest.raises(CommandError, match=r"X stands at \d+\.\d+ mm, the run begins at 0 mm"):
        bench.executor.start(table_of_counts(there_and_back()))
    stands = bench.executor._stands
    bench.executor.start(table_of_counts(there_and_back(), start=stands))
    bench.go_on()
    assert bench.executor.state is State.IDLE


def to_count(bench: Bench, axis: str, count: int) -> None:
    bench.executor.move(axis, count)
    while not bench.executor.over:
        if bench.executor.state is State.JOGGING:
            bench.executor.renew()
        bench.executor.step()


@pytest.mark.parametrize("count", [1, -3, 40, 2000, -2000])
def test_a_move_ends_on_its_count(count: int) -> None:
    bench = Bench().ready()
    to_count(bench, "X", count)
    assert bench.executor.state is State.IDLE
    assert bench.wire.machine.position.tolist() == [0, count, 0]
    to_count(bench, "X", 0)
    bench.executor.start(table_of_counts(there_and_back()))  # the run begins there
    bench.go_on()
    assert bench.executor.state is State.IDLE


@pytest.mark.parametrize("how", ["move", "stop", "let go", "lease"])
@pytest.mark.parametrize("axis", ["A", "X", "Y"])
def test_idle_machine_after_a_jog_stands_at_the_reported_place(axis: str, how: str) -> None:
    """The loop lags by 29 ms, 20 counts at the manual feed: the taught place is the true one.

    The friction of 0.01 N that holds the simulated loops back is less than a count of any axis.
    """
    bench, k = Bench().ready(), winder().axis_names.index(axis)
    if how == "move":
        to_count(bench, axis, 555)  # 10 mm of X
    else:
        bench.executor.jog(axis, manual_feed(winder())[k] / winder().counts_per_unit[k] / 0.005)
        bench.go_on(40)
        if how == "stop":
            bench.desk.ask(Cause.STOP)
        elif how == "let go":
            bench.executor.let_go()
        bench.go_on()
    assert bench.executor.state is State.IDLE
    shown = bench.executor.latest[f"{axis}.measured"] * winder().counts_per_unit[k]
    assert abs(shown - bench.wire.machine.position[k]) <= 1.5


@settings(max_examples=15)
@given(st.integers(1, 120), st.sampled_from(["stop", "let go", "lease", "dead"]))
def test_a_move_ends_as_a_jog_does(tick: int, how: str) -> None:
    """By a stop, let-go, the tail or its lease (18.1 + 1.8 + 0.43 mm): never later."""
    bench = Bench().ready()
    bench.executor.move("X", 3000)
    while bench.executor.tick < tick:
        bench.executor.renew()
        bench.executor.step()
    at = bench.wire.machine.position[1] * MM
    if how == "dead":
        bench.wire.mute = True
        bench.wire.machine.play(400)
    else:
        if how == "stop":
            bench.desk.ask(Cause.STOP)
        elif how == "let go":
            bench.executor.let_go()
        bench.go_on()
        assert bench.executor.state is State.IDLE
    assert bench.wire.machine.standing
    way = {"stop": 0.6, "let go": 0.6, "lease": 20.4, "dead": 7.7}[how]
    assert bench.wire.machine.position[1] * MM - at <= way
    assert bench.wire.machine.position[1] <= 3000


def test_a_move_keeps_the_travel() -> None:
    bench = Bench().ready()
    with pytest.raises(CommandError, match="X: 600 mm is beyond its travel, -500 mm to 500 mm"):
        bench.executor.move("X", round(600 / MM))
    assert bench.executor.state is State.IDLE


@pytest.mark.parametrize("tick", [15, 40, 65])
@pytest.mark.parametrize("between", [False, True])
def test_second_let_go_changes_nothing(tick: int, between: bool) -> None:
    """This also holds if both come late, when the machine refuses what begins in its past."""
    bench = jogged()
    executor = bench.executor
    while executor.tick < tick:
        executor.renew()
        executor.step()
    if between:
        executor.let_go()
    if executor._owes_go:  # the machine goes on, and has not reported yet
        executor._owes_go = False
        executor._link.send(Message("go"))
    executor.let_go()
    executor.let_go()
    bench.go_on()
    assert executor.state is State.IDLE
    assert executor.ended == (RunEnd.COMPLETED, "")
    assert bench.wire.machine.position[1] * MM <= 1e3 * FAST * 0.005 * (tick + 10) + 0.5


@pytest.mark.usefixtures("forked_machine")
@pytest.mark.parametrize("how", ["move", "jog"])
def test_a_first_motion_to_where_it_stands_ends_in_real_time(
    how: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After homing, "all axes to 0" has no rows to play, and once it never ended.

    A busy computer plays ticks late. The guard against that has tests of its own, in
    ``test_guards``, and is off here.
    """
    monkeypatch.setattr("threadline.live.guards.LATE_IN_A_ROW", 1 << 30)
    monkeypatch.setattr("threadline.live.guards.LATE_PERIODS", 1e9)
    machine, desk = winder(), Desk()
    with sim_link(machine, np.zeros(3, np.int64), REAL_TIME) as link, closing(desk):
        executor = Executor(link, machine, desk, MemorySink(), speed=REAL_TIME)
        executor.connect()
        executor.enable()
        executor.home()
        if how == "move":
            executor.move("X", 0)
        else:
            executor.jog("X", 0.0)
        ends = time.monotonic() + 100.0
        while not executor.over:
            assert time.monotonic() < ends, executor.state
            desk.ask(Cause.HOLD)  # impossible now; it wakes the executor, which waits for reports
            executor.step()
        assert (executor.state, executor.ended) == (State.IDLE, (RunEnd.COMPLETED, ""))
