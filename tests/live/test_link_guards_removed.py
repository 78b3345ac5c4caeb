"""Remove a guard of links, cylinders, frames, grbl or HAL: the test named for it fails.

Nobody may leave out a guard, so none has a setting: it is removed where it is, though private.
"""

from __future__ import annotations

import dataclasses
import gc
import re
import warnings
from collections.abc import Callable
from contextlib import ExitStack

import numpy as np
import pytest

from tests.live import (
    bench,
    test_continued_grbl,
    test_grbl,
    test_grbl_waits,
    test_hal,
    test_hal_rows,
    test_scans,
    test_turns,
    test_wire,
)
from tests.live.hal_bench import hal_alone, unhurried
from tests.live.test_guards_removed import Take, attribute, nothing, with_folder
from threadline.live import (
    executor,
    grbl_controller,
    grbl_program,
    grbl_run,
    grbl_words,
    hal_rows,
    wire,
)
from threadline.live import guards as lateness
from threadline.live import guards as scan_guards
from threadline.live.grbl_controller import Controller
from threadline.live.grbl_run import GrblRun
from threadline.live.grbl_words import CharacterCount, Status
from threadline.live.guards import Lateness, ScanGuards, clock_s
from threadline.live.hal_session import HalSession
from threadline.live.scans_ahead import ScansAhead
from threadline.live.turns_ahead import TurnsAhead
from threadline.twin.row_session import Part
from threadline.twin.stitching import StitchingSession
from threadline.twin.switching_session import SwitchingSession

_ask_status, _ask, _guards, _hal = (
    Controller.ask_status, Controller.ask, ScanGuards.__init__, HalSession.__init__,
)  # fmt: skip


def always_idle(one: Controller) -> Status:
    """Take a controller for standing, whatever it reports."""
    return dataclasses.replace(_ask_status(one), state="Idle")


def looks_alone(one: GrblRun) -> None:
    """Note the time of a look, however long ago the last one was."""
    one._looked_s = clock_s()


def deaf(one: Controller, line: bytes, timeout_s: float, _stopped: object = None) -> list[str]:
    """Ask without heeding a stop; a query of a minute ends after a second."""
    return _ask(one, line, min(timeout_s, 1.0))


def needing_nothing(one: ScanGuards, machine: object) -> None:
    """Guard no interlock."""
    _guards(one, machine)  # type: ignore[arg-type]
    one._needs = {}


def without_lead(one: HalSession, *arguments: object, **options: object) -> None:
    """Take any waiting row in HAL for a row that can be replaced."""
    _hal(one, *arguments, **options)  # type: ignore[arg-type]
    one._lead = -10


def beside_is_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """Take any place for a place on the lines; ten lines are enough then."""
    monkeypatch.setattr(grbl_run, "OFF_PATH_M", 1e9)
    monkeypatch.setattr(test_grbl, "LINES", "".join(test_grbl.LINES.splitlines(keepends=True)[:10]))


def silence_is_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for a silent controller for ever; the test does not."""
    monkeypatch.setattr(grbl_run, "SILENCE_S", 1e9)
    monkeypatch.setattr(test_grbl, "PATIENCE_S", 2.5)


def darkness_is_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """Heed no broken beam; the run of 900 scans does not end then."""
    monkeypatch.setattr(scan_guards, "FREE", frozenset())
    monkeypatch.setattr(bench, "LONGEST_TICKS", 2_000)


def trusting(one: hal_rows._Played, part: Part) -> dict[str, np.ndarray]:
    """Take HAL's answers for the sent records."""
    found = one._sampled(len(part.travelled))
    one._tick += len(part.travelled)
    return {"commanded": found.commanded, "read": np.rint(found.read)}


def of_scans(text: str, message: str) -> Callable[[], None]:
    return lambda: test_scans.test_a_fault_switches_everything_off(text, message)


def of_settings(number: int, factor: float, message: str) -> Callable[[], None]:
    return lambda: test_grbl.test_a_controller_of_another_machine_is_refused(
        number, factor, message
    )


def with_patch(test: Callable[[pytest.MonkeyPatch], None]) -> Callable[[], None]:
    """Return a call of a test that patches the code itself."""

    def call() -> None:
        with pytest.MonkeyPatch.context() as monkeypatch:
            test(monkeypatch)

    call.__module__ = test.__module__
    return call


GUARDS: dict[str, tuple[Take, Callable[[], None]]] = {
    "a length out of range": (
        attribute(wire, "MOST_BYTES", 1 << 40),
        lambda: test_wire.test_a_length_out_of_range_is_refused((1 << 24) + 1),
    ),
    "kinds of events": (
        attribute(wire, "_EVENT_KINDS", (*wire._EVENT_KINDS, "dance", "explode")),
        test_wire.test_events_are_checked,
    ),
    "both ends of a cylinder": (
        attribute(scan_guards, "combinations", lambda *_: ()),
        of_scans("stuck-contact:z_is_up@0.5 s", "z_is_up and z_is_down are on together"),
    ),
    "the interlocks": (
        attribute(ScanGuards, "__init__", needing_nothing),
        of_scans("stuck-contact:z_is_down@0.5 s", "knife is on, and z_is_down, which it needs"),
    ),
    "the light grid": (
        darkness_is_well,
        of_scans("light-grid@3.7 s", "light_grid is off: a broken beam"),
    ),
    "late scans": (
        attribute(lateness, "LATE_IN_A_ROW", 10**9),
        of_scans("late-ticks@1 s", "3 ticks in a row came late"),
    ),
    "both valves of a cylinder": (
        attribute(ScansAhead, "_check", nothing),
        test_scans.test_a_row_for_both_sides_of_a_cylinder_is_never_sent,
    ),
    "the scan at which all is off": (
        attribute(SwitchingSession, "switch_off_at", nothing),
        lambda: test_scans.test_outputs_switch_off_when_refills_stop(160),
    ),
    "the scan at which all is off, at a wait": (
        attribute(SwitchingSession, "switch_off_at", nothing),
        test_scans.test_a_wait_that_is_not_met_while_nobody_refills_switches_off_too,
    ),
    "late turns": (
        attribute(Lateness, "trip", nothing),
        lambda: test_turns.test_a_fault_ends_it("one-late-tick"),
    ),
    "turns that are sent ahead": (
        attribute(executor, "DEPTH_S", 5.0),
        lambda: test_turns.test_frame_rests_after_the_present_turn_when_refills_stop(900),
    ),
    "turns that are taken back": (
        attribute(StitchingSession, "drop_from", nothing),
        lambda: test_turns.test_a_stop_lets_the_turn_under_way_end_and_no_more(2600),
    ),
    "turns beyond the travel": (
        attribute(TurnsAhead, "_check", nothing),
        test_turns.test_turns_beyond_the_travel_are_never_sent,
    ),
    "the steps of a controller": (
        attribute(Controller, "compare", nothing),
        of_settings(100, 1.01, "the steps of X"),
    ),
    "a controller that moves": (
        attribute(Controller, "ask_status", always_idle),
        test_grbl.test_moving_controller_is_refused_at_the_meeting,
    ),
    "start and travel of a program": (
        attribute(GrblRun, "refuse_program", nothing),
        test_grbl.test_a_run_begins_where_the_machine_stands_and_stays_in_its_travel,
    ),
    "bytes that act at once": (
        attribute(grbl_words, "refuse_realtime", nothing),
        lambda: test_grbl.test_realtime_bytes_and_commands_in_a_program_are_refused(b"G1 X1!"),
    ),
    "beside the lines": (
        beside_is_well,
        lambda: test_grbl.test_error_of_grbl_stops_the_run_with_a_fault("beside", "beside the"),
    ),
    "characters that are counted": (
        attribute(CharacterCount, "fits", lambda *_: True),
        test_grbl.test_a_program_is_run_whole_and_its_reports_are_a_recording,
    ),
    "a silent controller": (
        silence_is_well,
        lambda: test_grbl.test_a_lost_link_is_a_fault_and_what_runs_out_is_bounded("silent"),
    ),
    "a computer that slept": (
        attribute(GrblRun, "_judge_silence", looks_alone),
        with_patch(test_grbl_waits.test_nothing_that_moves_is_sent_after_this_process_stood_still),
    ),
    "numbers of another meaning": (
        attribute(grbl_controller, "_refuse_other_reports", nothing),
        lambda: test_grbl_waits.test_settings_that_give_its_numbers_another_meaning_are_refused(
            13, 1.0, "reports inches"
        ),
    ),
    "a stop while grbl homes": (
        attribute(Controller, "ask", deaf),
        test_grbl.test_a_stop_while_it_homes_resets_it_at_once,
    ),
    "a spindle that ran": (
        attribute(grbl_program, "_SWITCHES", re.compile(rb"(?!)")),
        with_folder(test_continued_grbl.test_a_spindle_that_ran_runs_again_before_anything_moves),
    ),
    "counts that come back from HAL": (
        attribute(hal_rows._Played, "_read", trusting),
        test_hal_rows.test_a_count_that_was_not_sent_is_a_fault,
    ),
    "a HAL that is silent": (
        attribute(hal_rows, "SILENT_S", 1e9),
        lambda: test_hal_rows.test_a_hal_that_is_silent_is_a_fault("in motion"),
    ),
    "samples that HAL lost": (
        attribute(HalSession, "lost", property(lambda _: 0)),
        with_patch(test_hal.test_a_sampler_that_runs_over_is_seen),
    ),
    "a fifo of HAL that ran empty": (
        attribute(executor, "_STARVED", ""),
        with_folder(test_hal.test_an_underrun_is_seen.__wrapped__),
    ),
    "rows that HAL is about to play": (
        attribute(HalSession, "__init__", without_lead),
        test_hal.test_a_row_that_is_about_to_be_played_is_not_replaced,
    ),
}


@pytest.mark.parametrize("guard", GUARDS)
def test_without_the_guard_its_test_fails(guard: str, monkeypatch: pytest.MonkeyPatch) -> None:
    take_away, test = GUARDS[guard]
    monkeypatch.setattr(grbl_run, "POLL_S", 0.03)
    take_away(monkeypatch)
    failed = (AssertionError, pytest.fail.Exception)
    with warnings.catch_warnings(), ExitStack() as around:
        warnings.simplefilter("ignore", ResourceWarning)  # a failing test closes nothing
        if getattr(test, "__module__", "") == "tests.live.test_hal":
            around.enter_context(hal_alone(monkeypatch))
            around.enter_context(unhurried(monkeypatch))
        with pytest.raises(failed):
            test()
        gc.collect()
