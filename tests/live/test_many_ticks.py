"""A report with many ticks is guarded like one for each tick, and used in quiet runs alone."""

from __future__ import annotations

import numpy as np
import pytest

from tests.live.bench import Bench, table_of_counts, there_and_back, winder
from threadline.files import Event
from threadline.live.executor import DEPTH_S, MANY_S, Executor
from threadline.live.guards import Guards
from threadline.live.sim_machine import SimFault
from threadline.live.states import Cause, State
from threadline.live.wire import Message

TICKS = 900


def followed(chance: np.random.Generator) -> dict[str, np.ndarray]:
    """Return commands and readings of X: a filtered walk, whose encoder sticks somewhere."""
    scale = winder().counts_per_unit[1]
    speeds = np.repeat(chance.uniform(-0.036, 0.036, TICKS // 30), 30)
    commanded = np.rint(np.cumsum(speeds) * 0.005 * scale) / scale
    read, lag = np.zeros(TICKS), chance.uniform(4.0, 16.0)
    for k in range(1, TICKS):
        read[k] = read[k - 1] + (commanded[k - 1] - read[k - 1]) / lag
    stuck = int(chance.integers(100, TICKS))
    read[stuck:] = read[stuck]
    return {"X.commanded": commanded, "X.measured": np.rint(read * scale) / scale}


def tripped(samples: dict[str, np.ndarray], length: int) -> tuple[int, str]:
    """Return the first tick of the report in which the guards trip, and their words."""
    guards = Guards(winder())
    for first in range(0, TICKS, length):
        part = {name: values[first : first + length] for name, values in samples.items()}
        if why := guards.trip(first, part, late=False, late_periods=0.0):
            return first, why
    return TICKS, ""


@pytest.mark.parametrize("seed", range(12))
def test_reports_of_any_length_trip_at_the_same_tick(seed: int) -> None:
    samples = followed(np.random.default_rng(seed))
    at, why = tripped(samples, 1)
    if seed == 0:
        assert why  # otherwise nothing is compared
    for length in (5, 18, 60):
        assert tripped(samples, length) == (at - at % length if why else TICKS, why), length


def spoiled(chance: np.random.Generator, kind: str) -> dict[str, np.ndarray]:
    """Return samples of X at which one guard has to trip, and no other guard before it."""
    samples = {"X.voltage": np.full(TICKS, 1.0), **followed(np.random.default_rng(3))}
    samples["X.measured"] = samples["X.commanded"].copy()
    at = int(chance.integers(2, TICKS - 1))
    if kind == "jumps":
        samples["X.measured"][at] += 0.1
    elif kind == "beyond":
        samples = {name: np.full(TICKS, 0.0) for name in samples}
        for name in ("X.commanded", "X.measured"):
            samples[name] = np.concatenate([np.full(at, 0.5), np.full(TICKS - at, 0.503)])
    elif kind == "changed its sign":
        samples["X.voltage"][at:] = -1.0
    elif kind == "follows":
        samples["X.measured"] -= np.linspace(0.0, 0.05 * TICKS / at, TICKS)
    return samples


@pytest.mark.parametrize("kind", ["", "jumps", "beyond", "changed its sign", "follows"])
def test_one_call_for_all_ticks_judges_as_the_guards_that_say_which(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For each guard alone, both ways give the same report and the same words."""
    chance = np.random.default_rng(7)
    for _ in range(8):
        samples = spoiled(chance, kind)
        # Each way alone: callers cannot choose, because a guard has no setting.
        with monkeypatch.context() as patched:
            patched.setattr(Guards, "_in_order", lambda *_: False)
            one_by_one = tripped(samples, 18)
        with monkeypatch.context() as patched:
            patched.setattr(
                Guards, "_trip_of", lambda _, axis, __: "trips" if axis.name == "X" else ""
            )
            at_once = tripped(samples, 18)
        assert at_once[0] == one_by_one[0]
        assert tripped(samples, 18) == one_by_one
        assert kind in one_by_one[1]
        assert bool(one_by_one[1]) == bool(kind)


class Asked(Bench):
    """Notes how many ticks the executor requests, and its state then."""

    def __init__(self, speed: float = 0.0) -> None:
        super().__init__()
        self.asked: list[tuple[State, int]] = []
        wire, send = self.wire, self.wire.send
        self.executor = Executor(wire, winder(), self.desk, self.sink, speed=speed)  # type: ignore[arg-type]
        wire.machine.greet()
        self.executor.connect()

        def noted(message: Message) -> None:
            if message.kind == "go":
                wire.group = int(message.head.get("ticks", 5))
                self.asked.append((self.executor.state, wire.group))
            send(message)

        wire.send = noted  # type: ignore[method-assign]


def test_many_ticks_are_asked_for_in_a_run_alone() -> None:
    bench = Asked().ready()
    many = int(MANY_S / 0.005)
    assert many * 0.005 < DEPTH_S  # the link's rows are never used up
    bench.executor.jog("X", 0.02)
    bench.go_on(20)
    bench.executor.let_go()
    bench.go_on()
    assert {asked for asked in bench.asked if asked[0] is State.JOGGING} == {(State.JOGGING, 5)}
    assert bench.executor.position_counts[1]
    bench.executor.move("X", 0)
    while not bench.executor.over:
        bench.executor.renew()
        bench.executor.step()
    bench.asked.clear()
    bench.executor.start(table_of_counts(there_and_back()))
    bench.go_on(100)
    bench.desk.ask(Cause.HOLD)
    bench.go_on(250)
    bench.desk.ask(Cause.RESUME)
    bench.go_on()
    found = set(bench.asked)
    assert (State.RUNNING, many) in found
    assert {ticks for at, ticks in found if at is State.HOLDING} == {5}
    assert bench.executor.ended is not None
    assert bench.executor.ended[0] == "completed"


def test_a_slow_machine_is_looked_at_as_often_as_before() -> None:
    """At twice real time a report with many ticks would delay a stop by 45 ms."""
    bench = Asked(2.0).ready()
    bench.executor.start(table_of_counts(there_and_back()))
    bench.go_on()
    assert {ticks for _, ticks in bench.asked} == {5}


def test_a_stop_of_the_program_is_met_as_with_short_reports() -> None:
    event = Event(tick=200, kind="stop", operation=4)
    bench = Asked().ready()
    bench.executor.start(table_of_counts(there_and_back(), (event,)))
    while bench.executor.state is not State.HOLDING:
        bench.executor.step()
    assert np.array_equal(bench.executor.position_counts, there_and_back()[:200].sum(axis=0))


def played_one_by_one(
    rows: np.ndarray, lates: dict[int, float], fault: SimFault | None = None
) -> list[tuple[int, int, int, int, tuple[str, ...]]]:
    """Play rows tick by tick, reported in fives; return the content of the reports.

    The content is the first tick, the tick after, late ticks, samples of X, and kinds of events.
    """
    bench = Bench(fault=fault).ready()
    executor, machine = bench.executor, bench.wire.machine
    executor.start(table_of_counts(rows))
    machine.report_ticks = 5
    reports: list[Message] = []
    machine._tell = reports.append
    for tick in range(len(rows) + 12):
        machine.play(1, lates.get(tick, 0.0))
        if machine.silenced:
            break
    heads = [(one.head, one.arrays) for one in reports]
    return [
        (
            head["tick"],
            head["now"],
            head["late"],
            len(arrays["X.commanded"]),
            tuple(event[1] for event in head["events"] if event[1] in ("late", "fault")),
        )
        for head, arrays in heads
    ]


SHORT = np.tile([0, 1, 0], (17, 1))
"""Rows that a machine holds at once."""


def test_ticks_are_reported_together_but_what_is_urgent_at_once() -> None:
    """Each tick comes once, in order; a late tick is counted as if each had its own report."""
    quiet = played_one_by_one(SHORT, {})
    assert [one[:4] for one in quiet[:3]] == [(0, 5, 0, 5), (5, 10, 0, 5), (10, 15, 0, 5)]
    late = played_one_by_one(SHORT, {2: 0.4, 7: 0.6, 8: 0.6, 10: 0.3})
    assert [one[:3] for one in late[:5]] == [
        (0, 5, 0), (5, 7, 0), (7, 8, 1), (8, 9, 1), (9, 14, 0),
    ]  # fmt: skip
    assert [one[4] for one in late[2:4]] == [("late",)] * 2
    for found in (quiet, late):
        ends = [one[1] for one in found]
        assert [one[0] for one in found] == [0, *ends[:-1]]
        assert [one[3] for one in found] == [one[1] - one[0] for one in found]
    pressed = played_one_by_one(SHORT, {}, SimFault("e-stop", 7))
    assert [one[:2] for one in pressed[:2]] == [(0, 5), (5, 7)]
    assert pressed[1][4] == ("fault",)
    dead = played_one_by_one(SHORT, {}, SimFault("lost-link", 12))
    assert [one[:2] for one in dead] == [(0, 5), (5, 10), (10, 12)]


def test_a_standstill_is_reported_at_once() -> None:
    """Rows and tail end within a report, and commands at rest come after it."""
    found = played_one_by_one(SHORT[:7], {})
    held = [one[1] for one in found]
    assert 7 in held  # the machine stands from here on, three ticks before a report is due


def test_a_stop_in_real_time_counts_the_ticks_since_the_last_report(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A report 25 ms old is 5 ticks old: the braking rows begin 4 ticks after those."""
    bench = Bench().ready()
    executor = bench.executor
    executor.start(table_of_counts(there_and_back()))
    bench.go_on(100)
    now_s = executor._heard_s
    executor._real_time, executor._lead = True, 4
    monkeypatch.setattr("threadline.live.executor.clock_s", lambda: now_s + 0.026)
    sent = len(bench.wire.sent)
    bench.desk.ask(Cause.STOP)
    executor.obey()
    refill = bench.wire.sent[sent]
    assert refill.kind == "refill"
    assert refill.head["first"] == executor.tick + 5 + 4
    # After a sleep of the computer it is no later than the sent rows.
    monkeypatch.setattr("threadline.live.executor.clock_s", lambda: now_s + 3600.0)
    assert executor._soonest <= executor.tick + 20 + 4
