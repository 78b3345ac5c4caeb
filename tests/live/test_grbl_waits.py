"""Waits of a controller with grbl, the meaning of its numbers, and a computer that slept."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.live.grbl_model import GrblModel
from tests.live.memory_sink import MemorySink
from tests.live.test_grbl import (
    EXAMPLES,
    MACHINE,
    PATIENCE_S,
    START,
    go_on,
    meeting,
    program,
    ready,
    settings,
)
from threadline.cli.main import main
from threadline.cli.operator_keys import AtTheKeys
from threadline.errors import CommandError, LinkFaultError, OptionError
from threadline.files import RunEnd
from threadline.live import grbl_controller, grbl_run
from threadline.live import guards as lateness
from threadline.live.grbl_operated import GrblOperated
from threadline.live.grbl_run import GrblRun
from threadline.live.grbl_words import in_words, status_of
from threadline.live.guards import clock_s
from threadline.live.links import link_of
from threadline.live.sim_process import SLOWER
from threadline.live.states import Cause, Desk, State
from threadline.live.supervised import Conduct
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grbl_run, "POLL_S", 0.03)
    monkeypatch.setattr(grbl_run, "SILENCE_S", 3.0)
    monkeypatch.setattr(grbl_run, "OBEYS_S", 0.3)


def moving(model: GrblModel) -> Callable[[], bool]:
    """Return whether more than a few lines were accepted, and many are still to be sent."""
    return lambda: model.heard.count(b"G1") > 8


# --- the meaning of its numbers ------------------------------------------------------------


@pytest.mark.parametrize(
    ("setting", "value", "says"),
    [
        (13, 1.0, r"\$13=1 of the controller: it reports inches"),
        (10, 0.0, r"\$10=0 of the controller: it reports work positions.*Set \$10=1"),
        (10, 2.0, r"\$10=2 .*Set \$10=3"),
    ],
)
def test_settings_that_give_its_numbers_another_meaning_are_refused(
    setting: int, value: float, says: str
) -> None:
    model = GrblModel(settings() | {setting: value})
    with meeting(model) as (one, _, _), pytest.raises(CommandError, match=says):
        one.controller.meet()
    assert b"G1" not in model.heard and b"$J" not in model.heard


def test_settings_that_say_the_usual_are_taken() -> None:
    model = GrblModel(settings() | {10: 255.0, 13: 0.0})
    with meeting(model) as (one, _, _):
        one.controller.meet()
    assert b"$$" in model.heard and b"$I" in model.heard  # these settings were read, and accepted


def test_a_small_receive_buffer_is_not_overflowed() -> None:
    """Its size is read by $I and respected; a buffer smaller than a jog's line is refused."""
    model = GrblModel(settings(), faster=4.0, characters=48)
    with meeting(model) as (one, _, _):
        ready(one, program())
        go_on(one)
        assert one.ended == (RunEnd.COMPLETED, "")
        assert not model.overflowed
    with (
        meeting(GrblModel(settings(), characters=16)) as (one, _, _),
        pytest.raises(CommandError, match="holds 16 characters, the least is 40"),
    ):
        one.controller.meet()


def test_a_line_that_is_longer_than_its_buffer_is_refused() -> None:
    model = GrblModel(settings(), characters=48)
    with meeting(model) as (one, _, _):
        with pytest.raises(CommandError, match="has 60 characters, the receive buffer of the con"):
            ready(one, program(f"G1 X1{' ' * 50}F600\n"))
        assert b"G1" not in model.heard


# --- waits ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("state", "says"),
    [
        ("Sleep", "the controller tells Sleep: its motors are off"),
        ("Check", "the controller tells Check: it reads lines without moving"),
        ("Home", "the controller tells Home"),
        ("Tool", "the controller tells Tool"),
    ],
)
def test_a_state_in_which_no_run_goes_on_ends_it(state: str, says: str) -> None:
    model = GrblModel(settings())
    with meeting(model) as (one, _, _):
        ready(one, program())
        go_on(one, moving(model))
        one.controller.brakes_s = 0.0  # a controller that does not report rest is reset soon
        model.state = state
        go_on(one)
        assert one.ended is not None
        assert (one.ended[0], one.state) == (RunEnd.FAULT, State.FAULT)
        assert says in one.ended[1]
        assert not model.blocks and bytes(model.heard).rstrip(b"?").endswith(b"\x18")


def test_a_door_is_told_and_nothing_goes_on_before_it_is_closed() -> None:
    model = GrblModel(settings(), faster=2.0)
    with meeting(model) as (one, desk, sink):
        ready(one, program())
        go_on(one, moving(model))
        model.state = "Door:1"
        go_on(one, lambda: one.state is State.HOLDING)
        assert "its safety door is open" in one.why
        desk.ask(Cause.RESUME)
        go_on(one, lambda: "Close the door" in str(sink.log[-1][-1]) or "open" in sink.log[-1][-1])
        assert one.state is State.HOLDING
        assert b"~" not in model.heard
        model.state = "Door:0"
        go_on(one, lambda: "its safety door is closed again" in one.why)
        desk.ask(Cause.RESUME)
        go_on(one)
        assert one.ended == (RunEnd.COMPLETED, "")


def test_a_stop_at_an_open_door_ends_at_once() -> None:
    model = GrblModel(settings())
    with meeting(model) as (one, desk, _):
        ready(one, program())
        go_on(one, moving(model))
        model.state = "Door:1"
        go_on(one, lambda: one.state is State.HOLDING)
        desk.ask(Cause.STOP)
        go_on(one)
        assert one.ended == (RunEnd.STOPPED, "stopped by the operator")


def test_resume_button_of_the_controller_ends_a_hold() -> None:
    model = GrblModel(settings(), faster=2.0)
    with meeting(model) as (one, _, sink):
        ready(one, program())
        go_on(one, moving(model))
        model.state = "Hold"
        go_on(one, lambda: one.state is State.HOLDING)
        model.state = "Run"
        go_on(one)
        assert one.ended == (RunEnd.COMPLETED, "")
        assert "the controller goes on by itself" in [text for *_, text in sink.log]


class Silent(GrblModel):
    """A controller that accepts no line of a program."""

    def _take_move(self, line: str) -> None:
        pass

    def _do(self, line: str) -> None:
        if not line.startswith("G1"):
            super()._do(line)


def test_lines_that_are_never_answered_end_a_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grbl_run, "ANSWERS_S", 0.3)
    with meeting(Silent(settings())) as (one, _, _):
        ready(one, program("G1 X1 F6000\nG1 X2\n"))
        go_on(one)
        assert one.ended is not None and "has not answered 2 lines" in one.ended[1]


def test_a_dwell_is_part_of_what_lines_take() -> None:
    assert program("G1 X1 F60\nG4 P5\n").durations_s.tolist() == pytest.approx([1.0, 5.0])


@pytest.mark.parametrize("alone", [True, False])
def test_a_hold_that_nobody_can_end_is_stopped(
    alone: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("threadline.live.job_run.UNATTENDED_S", 0.0)
    run = SimpleNamespace(
        state=State.HOLDING, why="its door is open", stopped_by="", time_s=1.0, percent=100
    )
    desk = Desk()
    terminal, keyboard = os.pipe()  # no key is pressed
    keys = AtTheKeys(desk, 10.0, None, None if alone else terminal)
    keys.step(run)
    os.close(terminal)
    os.close(keyboard)
    assert desk.take() is (Cause.STOP if alone else None)
    errors = capsys.readouterr().err
    assert "holding: its door is open; " in errors
    assert ("nobody is at the keyboard" in errors) is alone
    assert (run.stopped_by == "Threadline: nobody is at the keyboard to resume") is alone
    desk.close()


def test_a_controller_that_waits_is_not_met() -> None:
    model = GrblModel(settings())
    model.state = "Door:1"
    with meeting(model) as (one, _, _):
        with pytest.raises(LinkFaultError, match="not at rest: it tells Door: its safety door is"):
            one.controller.meet()
        assert set(bytes(model.heard)) <= set(b"?")


# --- a computer that slept -----------------------------------------------------------------


def test_the_clock_counts_sleep(monkeypatch: pytest.MonkeyPatch) -> None:
    if hasattr(time, "CLOCK_BOOTTIME"):
        before = time.clock_gettime(time.CLOCK_BOOTTIME)
        assert before <= clock_s() <= time.clock_gettime(time.CLOCK_BOOTTIME)
    monkeypatch.setattr(lateness, "COUNTS_SLEEP", None)
    before = time.monotonic()
    assert before <= clock_s() <= time.monotonic()


def slept(one: GrblRun, model: GrblModel) -> bytes:
    """Let a run go on to its end after a sleep; return the bytes that the controller got."""
    heard = len(model.heard)
    go_on(one)
    assert one.ended is not None
    assert one.ended[0] is RunEnd.FAULT
    assert "this program did not run for" in one.ended[1]
    return bytes(model.heard)[heard:]


def test_nothing_that_moves_is_sent_after_this_process_stood_still(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Unread answers would allow more lines; it holds instead, and the controller drops lines."""
    monkeypatch.setattr(grbl_run, "SILENCE_S", 0.5)
    model = GrblModel(settings(), blocks=4)
    with meeting(model) as (one, _, _):
        ready(one, program())
        go_on(one, moving(model))
        time.sleep(1.0)  # as in SIGSTOP: the controller goes on, and answers
        assert b"G1" not in slept(one, model)
        assert not model.blocks and not model.rx
        stood = model.at.copy()
        time.sleep(0.2)
        assert np.array_equal(model.at, stood)


def test_nothing_that_moves_is_sent_after_the_computer_slept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Python's monotonic clock stands still in a sleep."""
    if not hasattr(time, "CLOCK_BOOTTIME"):
        pytest.skip("this system has no clock that counts sleep")
    model = GrblModel(settings(), blocks=4)
    with meeting(model) as (one, _, _):
        ready(one, program())
        go_on(one, moving(model))
        real_clock = time.clock_gettime
        monkeypatch.setattr(time, "clock_gettime", lambda clock: real_clock(clock) + 3600.0)
        assert b"G1" not in slept(one, model)


def test_a_hold_is_not_resumed_by_what_was_asked_before_a_sleep(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(grbl_run, "SILENCE_S", 0.5)
    model = GrblModel(settings())
    with meeting(model) as (one, desk, _):
        ready(one, program())
        go_on(one, moving(model))
        desk.ask(Cause.HOLD)
        go_on(one, lambda: model.state == "Hold")
        desk.ask(Cause.RESUME)
        time.sleep(1.0)
        assert b"~" not in slept(one, model)


def test_a_sleep_while_it_homes_is_no_way_to_a_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grbl_controller, "ASLEEP_S", 0.5)
    model = GrblModel(settings() | {22: 1.0})
    model.homing_s = 0.5
    with meeting(model) as (one, _, _):
        one.controller.meet()
        slow = iter([1.0])
        with pytest.raises(LinkFaultError, match=r"did not run for .* while it homed"):
            one.controller.home(lambda: bool(time.sleep(next(slow, 0.0))))
        until = time.monotonic() + 60.0
        while not bytes(model.heard).endswith(b"\x18"):
            assert time.monotonic() < until


def test_no_run_begins_on_what_was_heard_long_ago(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grbl_run, "FRESH_S", 0.2)
    model = GrblModel(settings())
    with meeting(model) as (one, _, _):
        one.controller.meet()
        one.enable()
        one.home()
        time.sleep(0.5)
        with pytest.raises(CommandError, match="the controller was last heard"):
            one.start(program(), START)
        assert b"G1" not in model.heard


# --- its position --------------------------------------------------------------------------


@pytest.mark.parametrize("approach", [False, True])
def test_a_run_is_repeated_by_an_approach(approach: bool) -> None:
    """Without switches it stands at the end of the previous run, which is another place."""
    options = Options()
    plan = plan_job(open_job(EXAMPLES / "helix.gcode", MACHINE, options), MACHINE, options)
    model = GrblModel(settings(), faster=20.0)
    model.at[[0, 3]] = model.target[[0, 3]] = 3.0, 20.0
    model.start()
    link = link_of(f"grbl:{model.address}", MACHINE, 1.0, None, approach=approach)
    link.prepare(plan)
    desk = Desk()

    def stop(_: object) -> None:
        desk.ask(Cause.STOP)

    def run() -> RunEnd:
        return link.run(plan, desk, MemorySink(), Conduct(watch=stop))[0]

    try:
        if approach:
            assert run() is RunEnd.STOPPED
            assert b"$J=G21G90G53X" in model.heard
        else:
            with pytest.raises(CommandError, match="run --approach"):
                run()
            assert b"$J" not in model.heard
    finally:
        link.close()
        desk.close()
        model.close()


def test_an_approach_is_of_grbl_alone_and_a_slower_machine_has_no_speed() -> None:
    with pytest.raises(OptionError, match="--approach needs a controller with grbl"):
        link_of("sim", MACHINE, 1.0, None, approach=True)
    with pytest.raises(OptionError, match=f"--link {SLOWER} goes at real time where it can"):
        link_of(SLOWER, MACHINE, 4.0, None)


def test_states_in_words() -> None:
    for text, stands in (
        ("Hold:0", True), ("Hold:1", False), ("Door:0", True), ("Door:1", True), ("Door:2", False),
        ("Door:3", False), ("Sleep", True), ("Check", True), ("Run", False), ("Idle", True),
    ):  # fmt: skip
        found = status_of(f"<{text}|MPos:0,0,0|FS:0,0>")
        assert found is not None and found.stands is stands, text
        assert found.words.startswith(f"the controller tells {text.partition(':')[0]}")


# --- stops of the program ------------------------------------------------------------------

STOPS = "G1 X300 F6000\nM0\nG1 X200\nM0\nG1 X100\n"


@pytest.mark.parametrize("passed", [True, False])
def test_stops_of_the_program_are_passed_only_when_asked(passed: bool) -> None:
    """Otherwise it stands at the first M0 until the operator resumes."""
    model = GrblModel(settings(), faster=4.0)
    with meeting(model) as (plain, desk, sink):
        one = GrblRun(plain.controller, desk, sink, pass_stops=passed)
        ready(one, program(STOPS))
        if passed:
            go_on(one)
            assert one.ended == (RunEnd.COMPLETED, "")
            assert model.heard.count(b"~") == 2
            return
        go_on(one, lambda: one.state is State.HOLDING)
        assert model.at[0] == pytest.approx(300.0)
        assert b"~" not in model.heard


def test_a_hold_by_the_button_before_a_stop_stays() -> None:
    """The M0 is the first line without an answer, but the machine has not reached it."""
    model = GrblModel(settings(), faster=0.5)
    with meeting(model) as (plain, desk, sink):
        one = GrblRun(plain.controller, desk, sink, pass_stops=True)
        ready(one, program(STOPS))
        go_on(one, lambda: model.at[0] > 60.0)
        model.state = "Hold"
        go_on(one, lambda: one.state is State.HOLDING)
        until = time.monotonic() + 1.0
        go_on(one, lambda: time.monotonic() > until)
        assert one.state is State.HOLDING
        assert b"~" not in model.heard


# --- changes at the controller -------------------------------------------------------------


def noted(sink: MemorySink) -> list[tuple[str, str]]:
    return [(e.kind, e.name) for block in sink.blocks for e in block.events]


def test_an_override_set_at_the_controller_is_written_down() -> None:
    """Grbl v1.1 Interface: ``Ov:`` in a report is feed, rapids and spindle in percent."""
    model = GrblModel(settings(), faster=2.0)
    with meeting(model) as (one, _, sink):
        ready(one, program())
        go_on(one, moving(model))
        model.overrides = (50, 25, 100)
        go_on(one, lambda: sink.log[-1][2] is Cause.OVERRIDE)
        assert sink.log[-1][1:] == (
            State.RUNNING, Cause.OVERRIDE,
            "overrides set at the controller: feed 50 %, rapids 25 %",
        )  # fmt: skip
        model.overrides = (100, 100, 100)
        go_on(one)
        assert one.ended == (RunEnd.COMPLETED, "")
        assert noted(sink) == [
            ("override", "feed 50 %, rapids 25 %"), ("override", "none"), ("completed", ""),
        ]  # fmt: skip


@pytest.mark.parametrize("percent", [10, 37, 99])
def test_an_override_of_the_operator_is_stepped_to_and_read_back(percent: int) -> None:
    """Equal bytes that arrive together count as one; the override is recorded once reached."""
    model = GrblModel(settings())
    with meeting(model) as (one, desk, sink):
        ready(one, program())
        go_on(one, moving(model))
        desk.override(percent)
        go_on(one, lambda: one.percent == percent and len(noted(sink)) == 1)
        assert model.overrides == (percent, 100, 100)
        desk.override(100)
        go_on(one, lambda: one.percent == 100)
        desk.override(110)
        go_on(one)
        assert one.ended == (RunEnd.COMPLETED, "")
        assert noted(sink) == [
            ("override", f"feed {percent} %"), ("override", "none"), ("completed", ""),
        ]  # fmt: skip
        refused = [text for *_, text in sink.log if "not within" in text]
        assert refused == [
            "an override of 110 % is not within the 10 to 100 % that the proof covers"
        ]


def test_a_controller_that_takes_no_override_is_told_of() -> None:
    model = GrblModel(settings(), faster=0.5)
    model.overridable = False
    with meeting(model) as (one, desk, sink):
        ready(one, program())
        go_on(one, moving(model))
        desk.override(50)
        go_on(one, lambda: sink.log[-1][2] is Cause.OVERRIDE)
        assert sink.log[-1][3].endswith("override the feed by 50 %, and reports 100 %")
        assert one.state is State.RUNNING


@pytest.mark.parametrize("lasts", [True, False])
def test_an_override_from_before_a_run_is_one_of_it_unless_a_reset_ended_it(lasts: bool) -> None:
    model = GrblModel(settings(), faster=4.0)
    with meeting(model) as (plain, desk, sink):
        one = GrblOperated(plain.controller, desk, sink)
        one.connect()
        one.enable()
        one.home()
        model.overrides = (120, 100, 100)
        until = time.monotonic() + PATIENCE_S
        while model.reported_overrides != model.overrides and time.monotonic() < until:
            one.stand(0.05)
        for _ in range(5):  # the link reads the report
            one.stand(0.05)
        if not lasts:
            model._say("ALARM:1")
            while one.state is not State.FAULT and time.monotonic() < until:
                one.stand(0.05)
            one.reset()
            one.enable()
            one.home()
        one.start(program(), START)
        assert noted(sink) == ([("override", "feed 120 %")] if lasts else [])


def test_holds_and_overrides_of_the_controller_are_named_in_the_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    job = tmp_path / "short.gcode"
    job.write_text("G21\nG90\nG1 X200 A40 F3000\nX400 A60\nM30\n", "utf-8")

    class Turned(GrblModel):
        """A controller whose knob is turned, and whose hold button is pressed and released."""

        held_s = 0.0

        def _move(self, left_s: float) -> None:
            super()._move(left_s)
            if self.at[0] > 60.0 and self.overrides[0] == 100 and b"~" not in self.heard:
                self.overrides = (80, 100, 100)
            if self.at[0] > 120.0 and not self.held_s:
                self.held_s, self.state = time.monotonic(), "Hold"
            if self.state == "Hold" and time.monotonic() > self.held_s + 2.0:
                self.state = "Run"

    model = Turned(settings())
    model.start()
    with pytest.raises(SystemExit):
        main(["run", str(job), "-m", "stepper-winder", "--nominal", "--link",
              f"grbl:{model.address}", "--store", str(tmp_path / "runs"), "--json"])  # fmt: skip
    model.close()
    events = json.loads(capsys.readouterr().out)["events"]
    assert [one["kind"] for one in events] == ["override", "hold"]
    assert events[0]["text"] == "overrides set at the controller: feed 80 %"
    assert events[1]["text"].startswith("it was held, the controller tells Hold: by its own hold")
    assert all(one["time_s"] > 0.0 and one["job_line"] == 3 for one in events)


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("ALARM:9", "ALARM:9, homing found no limit switch: raise the travel"),
        ("error:22", "error:22, no feed is set"),
        ("error:15\r", "error:15, the jog would leave its travel"),
        ("error:77", "error:77"),
        ("ALARM", "ALARM"),
        ("error: Bad number format", "error: Bad number format"),
    ],
)
def test_alarms_and_refusals_in_words(line: str, says: str) -> None:
    assert in_words(line).startswith(says)
    assert (in_words(line) == line) == (says == line)
