"""Remove a guard: the test that the table of hazards names for it fails.

Nobody may leave out a guard, so none has a setting: it is removed where it is, though private.
"""

from __future__ import annotations

import gc
import tempfile
import warnings
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.live import (
    test_checked,
    test_continued,
    test_guards,
    test_hold_deviation,
    test_homing,
    test_jog,
    test_loads_follow,
    test_many_ticks,
    test_override,
    test_scans,
    test_tail,
)
from tests.live.bench import winder
from threadline.cli import operator_keys as continued
from threadline.errors import CommandError, LinkFaultError
from threadline.files import Commands
from threadline.live import braking, continuing, executor, guards, states, supervised
from threadline.live import guards as lateness
from threadline.live.ahead import Ahead
from threadline.live.executor import Executor
from threadline.live.far_end import FarEnd
from threadline.live.guards import Guards
from threadline.live.jogging import JogAhead
from threadline.live.scans_ahead import ScansAhead
from threadline.live.sim_kinds import SimRows
from threadline.live.sim_machine import SimMachine
from threadline.live.states import Cause, Desk, Hold, State
from threadline.live.wire import Message
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, open_job, plan_job, prove_plan
from threadline.proof.proof_file import ProofFile, write_proof
from threadline.verdict import load_spec

_extend, _start, _moved_to_begin = JogAhead.extend, Executor.start, supervised.moved_to_begin
_start_again = Ahead.start_again
Take = Callable[[pytest.MonkeyPatch], None]
BY_LATENESS = ("late-ticks", "", "3 ticks in a row came late", 15)
BY_ONE_TICK = ("one-late-tick", "", "a tick came 6 periods late", 5)
BY_REVERSAL = ("unheeded-reversal", "Y", "the output of Y changed its sign", 5)
BY_JUMP = ("encoder-jump", "A", "the encoder of A jumps by 2", 5)
BY_STUCK = ("stuck-encoder", "X", "the encoder of X stands still while the axis should move", 22)
BY_SWITCH = ("switch-hit", "x_high", "the limit switch x_high is hit", 5)


def attribute(owner: object, name: str, value: object) -> Take:
    """Return a patch that replaces a guard."""
    return lambda monkeypatch: monkeypatch.setattr(owner, name, value)


def transition(state: State, cause: Cause, after: State) -> Take:
    """Return a patch that allows a transition outside the table."""
    return attribute(states, "TRANSITIONS", {**states.TRANSITIONS, (state, cause): after})


def with_proof(test: Callable[[Proof, Path], None]) -> None:
    """Call a test with a proof of a job, and with the file of the proof."""
    options = Options(interpolation="linear")
    job = open_job(test_checked.EXAMPLES / "x-180.prg", winder(), options)
    plan = plan_job(job, winder(), options)
    proof = prove_plan(plan, load_spec(None, winder()))
    with tempfile.TemporaryDirectory() as folder:
        written = Path(folder) / "a.proof.json"
        write_proof(proof, written)
        test(proof, written)


def in_turn(desk: Desk) -> Cause | None:
    """Take commands in their order, a stop after the others."""
    asked: deque[Cause] = desk._asked
    if asked:
        return asked.popleft()
    stop, desk._stop = desk._stop, False
    return Cause.STOP if stop else None


def without_end(one: JogAhead, until: int) -> Message:
    """Jog as if the axis had no end."""
    one._low, one._high = -np.inf, np.inf
    return _extend(one, until)


def held_anywhere(one: Executor, commands: Commands, **options: Any) -> None:
    """Begin a run in which a hold takes effect anywhere."""
    _start(one, commands, **{**options, "hold": Hold.AT_ONCE})


def unconfirmed(*given: object) -> object:
    """Approach without a confirmation."""
    return _moved_to_begin(*given[:-1], lambda: True)  # type: ignore[arg-type]


def with_patch(test: Callable[..., None]) -> Callable[[], None]:
    """Return a call of a test of jumps that patches the code itself."""

    def call() -> None:
        with pytest.MonkeyPatch.context() as monkeypatch:
            test("jumps", monkeypatch)

    return call


def inner(test: Callable[..., None]) -> Callable[..., None]:
    """Return the test of one example of a property test, without a search for examples."""
    found: Callable[..., None] = test.hypothesis.inner_test  # type: ignore[attr-defined]
    return found


def with_folder(test: Callable[[Path], None]) -> Callable[[], None]:
    """Return a call of a test with a folder of its own."""

    def call() -> None:
        with tempfile.TemporaryDirectory() as folder:
            test(Path(folder))

    call.__module__ = test.__module__
    return call


def ends_unseen(one: Executor, _why: str) -> None:
    """Take a lost link for the end of a run."""
    one.over = True


def from_a_whole_row(one: Ahead) -> None:
    """Start again at the row after the stop."""
    one._places[-1] = np.floor(one._places[-1]) + 1.0
    _start_again(one)


def nothing(*_: object, **__: object) -> str:
    """Find no fault."""
    return ""


GUARDS: dict[str, tuple[Take, Callable[[], None]]] = {
    "the tail": (
        attribute(Ahead, "_brake", lambda _: np.empty(0)),
        lambda: test_tail.test_machine_brakes_within_its_limits_when_refills_stop_at_speed(70),
    ),
    "the depth": (
        attribute(executor, "DEPTH_S", 0.4),
        test_tail.test_no_more_than_a_tenth_of_a_second_is_held,
    ),
    "a stop first": (
        attribute(Desk, "take", in_turn),
        lambda: test_tail.test_a_stop_is_ahead_of_what_is_held_and_what_was_asked(100),
    ),
    "late ticks in a row": (
        attribute(lateness, "LATE_IN_A_ROW", 10**9),
        lambda: test_guards.test_a_fault_brakes_on_the_path(*BY_LATENESS),
    ),
    "one very late tick": (
        attribute(lateness, "LATE_PERIODS", 1e9),
        lambda: test_guards.test_a_fault_brakes_on_the_path(*BY_ONE_TICK),
    ),
    "the reversal rule": (
        attribute(Guards, "_reversed", nothing),
        lambda: test_guards.test_a_fault_brakes_on_the_path(*BY_REVERSAL),
    ),
    "the encoder that jumps": (
        attribute(Guards, "_jumped", nothing),
        lambda: test_guards.test_a_fault_brakes_on_the_path(*BY_JUMP),
    ),
    "the encoder that stands still": (
        attribute(Guards, "_following", nothing),
        lambda: test_guards.test_a_fault_brakes_on_the_path(*BY_STUCK),
    ),
    "the following error": (
        attribute(guards, "FOLLOWING_M", 1.0),
        test_guards.test_an_axis_that_falls_behind_is_a_fault_at_twice_its_lag_and_1_mm,
    ),
    "the travel during motion": (
        attribute(Guards, "_beyond", nothing),
        test_guards.test_a_reading_beyond_the_travel_is_a_fault,
    ),
    "the limit switches": (
        attribute(Guards, "_switch_hit", nothing),
        lambda: test_guards.test_a_fault_brakes_on_the_path(*BY_SWITCH),
    ),
    "the range of an override": (
        attribute(executor, "refuse_override", nothing),
        lambda: test_override.test_more_or_less_than_was_proven_is_refused(101, "10 to 100 %"),
    ),
    "homing before a run": (
        transition(State.ENABLED, Cause.START, State.RUNNING),
        test_guards.test_run_needs_a_homed_machine_that_does_not_jog,
    ),
    "no run out of a jog": (
        transition(State.JOGGING, Cause.START, State.RUNNING),
        test_guards.test_run_needs_a_homed_machine_that_does_not_jog,
    ),
    "no motion on a new connection": (
        transition(State.DISABLED, Cause.JOG, State.JOGGING),
        test_guards.test_a_new_connection_moves_nothing,
    ),
    "the hashes of the proof": (
        attribute(supervised, "check_proof", lambda *_: ()),
        lambda: with_proof(test_checked.test_one_changed_row_is_refused),
    ),
    "the reason to run out of specification": (
        attribute(ProofFile, "passed", True),
        lambda: with_proof(
            lambda proof, written: test_checked.test_out_of_specification_takes_a_reason(
                proof, written.parent
            )
        ),
    ),
    "the emergency stop at enabling": (
        attribute(SimMachine, "pressed", False),
        test_guards.test_a_pressed_emergency_stop_is_told_and_nothing_starts_while_it_is,
    ),
    "homing after a fault": (
        transition(State.FAULT, Cause.RESET, State.IDLE),
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
    "the end of travel of a jog": (
        attribute(JogAhead, "extend", without_end),
        lambda: test_jog.test_jog_stops_at_the_end_of_travel(1.0),
    ),
    "the rest that a hold waits for": (
        attribute(Executor, "start", held_anywhere),
        test_hold_deviation.test_a_hold_then_stands_at_the_next_rest_and_goes_on_from_there,
    ),
    "every tick of a report": (
        attribute(Guards, "_in_order", lambda *_: True),
        with_patch(test_many_ticks.test_one_call_for_all_ticks_judges_as_the_guards_that_say_which),
    ),
    "a braking that is refused": (
        attribute(Ahead, "undo", lambda _: False),
        lambda: test_homing.test_a_braking_that_is_refused_comes_again_later(Cause.STOP),
    ),
    "the confirmation of a rest": (
        attribute(supervised, "moved_to_begin", unconfirmed),
        lambda: test_continued.test_nothing_moves_until_somebody_confirms(False, None),
    ),
    "the travel of an approach": (
        attribute(continuing, "_approach", lambda *_: []),
        test_continued.test_an_approach_beyond_the_travel_is_refused_before_anything_moves,
    ),
    "the rest of this job alone": (
        attribute(continued, "refuse_other_rows", nothing),
        with_folder(
            test_continued.test_another_job_a_completed_run_and_nobody_there_are_refused
        ),
    ),
    "the end of a link": (
        attribute(Executor, "_lost", ends_unseen),
        lambda: test_guards.test_a_link_that_is_gone_is_a_fault_at_once("lost-link"),
    ),
    "what is held at the emergency stop": (
        attribute(SimRows, "_drop", nothing),
        test_guards.test_a_pressed_emergency_stop_is_told_and_nothing_starts_while_it_is,
    ),
    "homing of cylinders that stopped short": (
        attribute(ScansAhead, "keeps_home", True),
        lambda: test_scans.test_a_stop_switches_everything_off_at_the_next_scan(160),
    ),
    "the place at which a hold stands": (
        attribute(Ahead, "start_again", from_a_whole_row),
        lambda: inner(test_tail.test_hold_and_resume_skip_no_row_and_repeat_none)([75], False),
    ),
    "the limit of motors": (
        attribute(braking, "fastest", lambda *_: np.inf),
        test_loads_follow.test_no_row_is_faster_than_a_motor_can_turn,
    ),
    "the loops that settle before a jog is over": (
        attribute(JogAhead, "settled", lambda *_: True),
        lambda: test_jog.test_idle_machine_after_a_jog_stands_at_the_reported_place("X", "let go"),
    ),
    "the stop of homing": (
        attribute(FarEnd, "home", lambda one, _wakes, _stopped: (np.zeros(3, np.int64), {})),
        test_homing.test_a_run_that_is_stopped_while_it_homes_never_begins,
    ),
}  # fmt: skip


@pytest.mark.parametrize("guard", GUARDS)
def test_without_the_guard_its_test_fails(guard: str, monkeypatch: pytest.MonkeyPatch) -> None:
    take_away, test = GUARDS[guard]
    take_away(monkeypatch)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # a failing test closes nothing
        # Without the end of travel of a jog, the guard of rows ends the jog first: no renewal.
        with pytest.raises((AssertionError, pytest.fail.Exception, LinkFaultError, CommandError)):
            test()
        gc.collect()
