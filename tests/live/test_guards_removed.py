"""Take a guard away, and the test that the table of hazards names for it fails."""

from __future__ import annotations

import gc
import warnings
from collections import deque
from collections.abc import Callable

import numpy as np
import pytest

from tests.live import (
    test_checked,
    test_guards,
    test_homing,
    test_jog,
    test_tail,
)
from threadline.errors import LinkFaultError
from threadline.live import executor, states
from threadline.live.ahead import Ahead
from threadline.live.desk import Desk
from threadline.live.executor import Executor
from threadline.live.far_end import FarEnd
from threadline.live.guards import Guards
from threadline.live.lateness import Lateness
from threadline.live.sim_machine import SimMachine
from threadline.live.states import Cause, State

Take = Callable[[pytest.MonkeyPatch], None]
BY_LATENESS = ("late-ticks", "", "3 ticks in a row came late", 15)
BY_ENCODER = ("unheeded-reversal", "Y", "the output of Y changed its sign", 5)


def attribute(owner: object, name: str, value: object) -> Take:
    """Return what puts something else in the place of a guard."""
    return lambda monkeypatch: monkeypatch.setattr(owner, name, value)


def in_turn(desk: Desk) -> Cause | None:
    """Take commands in the order in which they came, a stop behind the others."""
    asked: deque[Cause] = desk._asked
    if asked:
        return asked.popleft()
    stop, desk._stop = desk._stop, False
    return Cause.STOP if stop else None


def nothing(*_: object, **__: object) -> str:
    """Find no fault."""
    return ""


GUARDS: dict[str, tuple[Take, Callable[[], None]]] = {
    "the tail": (
        attribute(Ahead, "_brake", lambda _: np.empty(0)),
        lambda: test_tail.test_where_refills_stop_at_speed_it_brakes_within_the_limits(70),
    ),
    "the depth": (
        attribute(executor, "DEPTH_S", 0.4),
        test_tail.test_no_more_than_a_tenth_of_a_second_is_held,
    ),
    "a stop first": (
        attribute(Desk, "take", in_turn),
        lambda: test_tail.test_a_stop_is_ahead_of_what_is_held_and_what_was_asked(100),
    ),
    "late ticks": (
        attribute(Lateness, "trip", nothing),
        lambda: test_guards.test_a_fault_brakes_on_the_path(*BY_LATENESS),
    ),
    "the guards of a report": (
        attribute(Guards, "_trip_of", nothing),
        lambda: test_guards.test_a_fault_brakes_on_the_path(*BY_ENCODER),
    ),
    "the emergency stop at enabling": (
        attribute(SimMachine, "pressed", False),
        test_guards.test_a_pressed_emergency_stop_is_told_and_nothing_starts_while_it_is,
    ),
    "homing after a fault": (
        attribute(states, "TRANSITIONS",
                  {**states.TRANSITIONS, (State.FAULT, Cause.RESET): State.IDLE}),
        test_guards.test_after_a_fault_nothing_moves_before_reset_enable_and_home,
    ),
    "limits of every row": (
        attribute(Ahead, "_check", nothing),
        test_checked.test_rows_beyond_travel_or_speed_are_never_sent,
    ),
    "the start where the machine stands": (
        attribute(Ahead, "refuse_elsewhere", nothing),
        test_checked.test_another_machine_or_start_is_refused,
    ),
    "the lease of a jog": (
        attribute(executor, "LEASE_S", 5.0),
        test_jog.test_at_manual_feed_it_ends_within_26_mm_of_the_last_renewal,
    ),
    "the release of a jog": (
        attribute(Executor, "let_go", nothing),
        test_jog.test_letting_go_brakes_now,
    ),
    "the stop of homing": (
        attribute(FarEnd, "home", lambda one, _wakes, _stopped: np.zeros(3, np.int64)),
        test_homing.test_a_run_that_is_stopped_while_it_homes_never_begins,
    ),
}  # fmt: skip


@pytest.mark.parametrize("guard", GUARDS)
def test_without_the_guard_its_test_fails(guard: str, monkeypatch: pytest.MonkeyPatch) -> None:
    take_away, test = GUARDS[guard]
    take_away(monkeypatch)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # a test that fails closes nothing
        with pytest.raises((AssertionError, pytest.fail.Exception, LinkFaultError)):
            test()
        gc.collect()
