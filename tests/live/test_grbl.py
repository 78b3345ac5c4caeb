"""Programs on a controller with grbl, against a strict model of it (``grbl_model``)."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from tests.live.grbl_model import BLOCKS, GrblModel
from tests.live.memory_sink import MemorySink
from threadline.cli.main import main
from threadline.errors import CommandError, LinkFaultError, OptionError, PlanError
from threadline.files import RunEnd
from threadline.live import grbl_run
from threadline.live.grbl_controller import Controller
from threadline.live.grbl_run import GrblRun
from threadline.live.grbl_settings import units_of
from threadline.live.grbl_words import Program, program_of, runs_out, status_of
from threadline.live.links import link_of
from threadline.live.port import Port
from threadline.live.states import Cause, Desk, State
from threadline.machine import Machine, load_machine
from threadline.proof.options import Options
from threadline.proof.pipeline import open_job, plan_job

EXAMPLES = Path(__file__).parents[2] / "examples"
MACHINE: Machine = load_machine("stepper-winder")
UNITS = units_of(MACHINE)
PATIENCE_S = 60.0
START = np.zeros(2)
# A square spiral that never retraces itself: 60 lines, more than any buffer holds.
LINES = "".join(f"G1 A{10 * k} X{5 * k} F6000\n" for k in range(1, 61))


def settings() -> dict[int, float]:
    found = {22: 0.0}
    for k, name in enumerate(MACHINE.axis_names):
        at = "XYZA".index(name)
        found[100 + at] = float(MACHINE.counts_per_unit[k] * UNITS[k])
        found[110 + at] = float(60.0 * MACHINE.velocity_limit[k] / UNITS[k])
        found[120 + at] = float(MACHINE.acceleration_limit[k] / UNITS[k])
    return found


def program(text: str = LINES) -> Program:
    return program_of(text.encode(), MACHINE.axis_names, UNITS, START)


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Allow for a busy computer, which gives the model little processor time."""
    monkeypatch.setattr(grbl_run, "POLL_S", 0.03)
    monkeypatch.setattr(grbl_run, "SILENCE_S", 3.0)


@contextmanager
def meeting(model: GrblModel) -> Iterator[tuple[GrblRun, Desk, MemorySink]]:
    model.start()
    desk, sink, port = Desk(), MemorySink(), Port(model.address)
    try:
        yield GrblRun(Controller(port, MACHINE), desk, sink), desk, sink
    finally:
        port.close()
        desk.close()
        model.close()


def ready(one: GrblRun, what: Program) -> None:
    one.controller.meet()
    one.enable()
    one.home()
    one.start(what, START)


def go_on(one: GrblRun, until: Callable[[], bool] = lambda: False) -> None:
    ends = time.monotonic() + PATIENCE_S
    while not one.over and not until():
        assert time.monotonic() < ends, (one.state, one.executed, one.acknowledged)
        one.step()


def test_a_program_is_run_whole_and_its_reports_are_a_recording() -> None:
    model = GrblModel(settings(), faster=4.0)
    with meeting(model) as (one, _, sink):
        ready(one, program())
        ahead = []

        def seen() -> bool:
            ahead.append((one.executed, one.acknowledged))
            return False

        go_on(one, seen)
        assert one.ended == (RunEnd.COMPLETED, "")
        assert one.state is State.IDLE
        assert not model.overflowed
        assert model.heard.count(b"G1 ") == 60
        np.testing.assert_allclose(model.at, [300.0, 0.0, 0.0, 600.0], atol=1e-9)
        # Taken lines are not done lines: the planner holds most of the answered ones.
        executed, answered = np.array(ahead).T
        assert (np.diff(executed) >= 0).all()
        assert (executed <= answered).all()
        assert (answered - executed).max() >= BLOCKS - 2
        assert executed[-1] == 60
        # The recording lies on the program: A turns twice as far as X goes, in its units.
        a, x = (
            np.concatenate([block.samples[f"{name}.commanded"] for block in sink.blocks])
            for name in "AX"
        )
        np.testing.assert_allclose(a / UNITS[0], 2.0 * x / UNITS[1], atol=0.01)
        assert (x[-1], len(x) > 20) == (pytest.approx(0.3), True)
        events = [event.kind for block in sink.blocks for event in block.events]
        assert events == ["completed"]


def test_a_hold_stands_on_the_path_and_goes_on_from_there() -> None:
    model = GrblModel(settings(), faster=2.0)
    with meeting(model) as (one, desk, sink):
        ready(one, program())
        go_on(one, lambda: one.executed >= 5)
        desk.ask(Cause.HOLD)
        go_on(one, lambda: model.state == "Hold")
        held = model.at.copy()
        until = time.monotonic() + 0.4
        go_on(one, lambda: time.monotonic() > until)
        assert one.state is State.HOLDING
        assert np.array_equal(model.at, held)
        desk.ask(Cause.RESUME)
        go_on(one)
        assert one.ended == (RunEnd.COMPLETED, "")
        assert model.heard.count(b"G1 ") == 60
        assert [cause for *_, cause, _ in sink.log][-3:] == [
            Cause.HOLD, Cause.RESUME, Cause.COMPLETED,
        ]  # fmt: skip


def test_the_time_of_a_run_goes_on_within_a_line() -> None:
    """A winder's line may take minutes: time left and progress count what is done of it."""
    model = GrblModel(settings(), faster=2.0)
    what = program("G1 A200 X100 F6000\n")
    whole_s = float(what.durations_s.sum())
    with meeting(model) as (one, _desk, _kept):
        ready(one, what)
        go_on(one, lambda: one.plan_s > 0.4 * whole_s)
        assert one.executed == 0
        assert one.plan_s <= model.at[0] / 100.0 * whole_s
        go_on(one)
        assert one.plan_s == pytest.approx(whole_s)


def test_a_hold_after_the_last_line_is_refused_and_the_run_ends() -> None:
    """A feed hold then would leave the controller in Hold with nothing to resume."""
    model = GrblModel(settings(), faster=4.0)
    with meeting(model) as (one, desk, sink):
        ready(one, program())
        go_on(one, lambda: one.ended is not None)
        before = model.heard.count(b"!")
        desk.ask(Cause.HOLD)
        go_on(one)
        assert (one.state, model.heard.count(b"!")) == (State.IDLE, before)
        assert any("the run has come to its end" in text for *_, text in sink.log)


def test_a_hold_of_the_controller_itself_is_one_of_the_run() -> None:
    """After M0 or its own button, nothing goes on before the operator says so."""
    model = GrblModel(settings(), faster=4.0)
    with meeting(model) as (one, desk, sink):
        ready(one, program())
        go_on(one, lambda: one.executed >= 5)
        model.state = "Hold"
        go_on(one, lambda: one.state is State.HOLDING)
        assert sink.log[-1][-1].startswith("the controller tells Hold: by its own hold button")
        assert b"~" not in model.heard
        desk.ask(Cause.RESUME)
        go_on(one)
        assert one.ended == (RunEnd.COMPLETED, "")


def test_a_stop_is_ahead_of_what_was_sent_and_drops_it() -> None:
    model = GrblModel(settings(), faster=0.2)
    with meeting(model) as (one, desk, _):
        ready(one, program())
        go_on(one, lambda: one.executed >= 3)
        for cause in (Cause.HOLD, Cause.RESUME, Cause.STOP, Cause.RESUME):
            desk.ask(cause)
        go_on(one)
        assert one.ended == (RunEnd.STOPPED, "stopped by the operator")
        stood = model.at.copy()
        assert stood[0] < 60.0
        time.sleep(0.3)
        assert np.array_equal(model.at, stood)
        assert not model.blocks and not model.rx
        assert b"~" not in model.heard


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("T7\n", r"refused 'T7': error:20, it does not know this command"),
        ("alarm", "ALARM:1, a limit switch was hit, and its position is lost"),
        ("beside", "beside the lines"),
    ],
)
def test_error_of_grbl_stops_the_run_with_a_fault(text: str, message: str) -> None:
    model = GrblModel(settings())
    with meeting(model) as (one, _, _):
        lines = LINES.splitlines(keepends=True)
        ready(one, program("".join([*lines[:4], text, *lines[4:]]) if "\n" in text else LINES))
        if text == "alarm":
            model.alarm_at_s = 0.0
        elif text == "beside":
            go_on(one, lambda: one.executed >= 2)
            model.beside_mm = 20.0
        go_on(one)
        assert one.state is State.FAULT
        assert message.replace("\\", "") in (one.ended or ("", ""))[1]
        assert not model.blocks
        assert model.heard.rstrip(b"?").endswith(b"\x18")


@pytest.mark.parametrize("how", ["closed", "silent"])
def test_a_lost_link_is_a_fault_and_what_runs_out_is_bounded(how: str) -> None:
    """grbl executes its buffer: as long as was stated before, and no longer."""
    model = GrblModel(settings())
    slow = program(LINES.replace("F6000", "F1200"))
    goes_s, _ = runs_out(slow, BLOCKS)
    with meeting(model) as (one, _, _):
        ready(one, slow)
        go_on(one, lambda: one.executed >= 2)
        if how == "silent":
            model.stuck = True
            go_on(one)
            assert f"silent for {grbl_run.SILENCE_S:g} s" in (one.ended or ("", ""))[1]
        else:
            assert model.client is not None
            model.client.shutdown(2)
            go_on(one)
            assert (
                "the link is gone; the controller executes by itself" in (one.ended or ("", ""))[1]
            )
            until = time.monotonic() + 60.0
            while model.state == "Run" and time.monotonic() < until:
                time.sleep(0.05)
            assert model.state == "Idle"
            length = np.hypot(5.0, 10.0)
            ran = (float(np.linalg.norm(model.at)) / length - one.executed) * length / 20.0
            assert 0.0 < ran <= goes_s
        assert one.state is State.FAULT


def test_moving_controller_is_refused_at_the_meeting() -> None:
    model = GrblModel(settings())
    model.blocks.append((np.array([50.0, 0.0, 0.0, 0.0]), 1.0))
    model.state = "Run"
    with meeting(model) as (one, _, _):
        with pytest.raises(LinkFaultError, match="is not at rest: it tells Run"):
            one.controller.meet()
        assert set(bytes(model.heard)) <= set(b"?")
        assert one.state is State.DISABLED


@pytest.mark.parametrize(
    ("number", "factor", "message"),
    [(100, 1.01, "the steps of X"), (103, 0.99, "the steps of A"), (110, 1.1, "the speed of X"),
     (123, 2.0, "the acceleration of A")],
)  # fmt: skip
def test_a_controller_of_another_machine_is_refused(
    number: int, factor: float, message: str
) -> None:
    """grbl plans by its settings: they must equal the machine file's limits, or be slower."""
    wrong = settings()
    wrong[number] *= factor
    model = GrblModel(wrong)
    with meeting(model) as (one, _, _), pytest.raises(CommandError, match=message):
        one.controller.meet()
    assert b"G1" not in model.heard


def test_slower_settings_are_taken() -> None:
    slower = settings()
    slower[110] *= 0.5
    model = GrblModel(slower)
    with meeting(model) as (one, _, _):
        one.controller.meet()
    assert b"$$" in model.heard and b"G1" not in model.heard


def test_a_run_begins_where_the_machine_stands_and_stays_in_its_travel() -> None:
    model = GrblModel(settings())
    model.at[0] = 3.0
    with (
        meeting(model) as (one, _, _),
        pytest.raises(CommandError, match="axis X stands at 3 mm, the run begins at 0"),
    ):
        ready(one, program())
    model = GrblModel(settings())
    with meeting(model) as (one, _, _):
        with pytest.raises(CommandError, match="axis X: the program leaves its travel"):
            ready(one, program("G1 X9000 F6000\n"))
        assert b"G1" not in model.heard


@pytest.mark.parametrize(
    "line",
    [b"G1 X1!", b"G1 X1 ?", b"~", b"G1\x18", b"G1 X1 \x84", b"$H", b" $X", b"G1 X" + b"1" * 130],
)
def test_realtime_bytes_and_commands_in_a_program_are_refused(line: bytes) -> None:
    with pytest.raises(PlanError, match="line 2 of the program"):
        program_of(b"G21\n" + line + b"\n", MACHINE.axis_names, UNITS, START)


def test_reports_that_are_none() -> None:
    assert status_of("ok") is None
    work = status_of("<Idle|WPos:0,0,0|FS:0,0>")
    assert work is not None and work.position is None
    with pytest.raises(LinkFaultError, match="instead of numbers"):
        status_of("<Idle|MPos:0,nan,0|FS:0,0>")


def test_run_out_distance_covers_planner_blocks_and_receive_buffer() -> None:
    """15 blocks, the block under way, and 128 characters: 6 lines of 19 to 21 characters."""
    goes_s, way_m = runs_out(program(), BLOCKS)
    each_s = 60.0 * np.hypot(5.0, 10.0) / 6000.0
    assert goes_s == pytest.approx((BLOCKS + 1 + 7) * each_s, rel=0.05)
    assert way_m > 0.0


def test_a_serial_line_is_a_port_too() -> None:
    ours, theirs = os.openpty()
    port = Port(os.ttyname(theirs))
    with pytest.raises(LinkFaultError, match="another program has it"):
        Port(os.ttyname(theirs))
    port.send(b"G1 X1\n?")
    assert os.read(ours, 100) == b"G1 X1\n?"
    os.write(ours, b"ok\r\n<Idle|MPos:0.000,0.000,0.000>\r\n")
    assert (port.receive(1.0), port.receive(1.0)) == ("ok", "<Idle|MPos:0.000,0.000,0.000>")
    os.close(ours)
    port.receive(0.2)
    assert port.lost
    port.close()
    os.close(theirs)


def test_addresses_and_options_that_are_none() -> None:
    for address in ("nowhere", "host:99999", "host:"):
        with pytest.raises((OptionError, LinkFaultError)):
            Port(address)
    with pytest.raises(LinkFaultError, match=r"nothing answers at '127\.0\.0\.1:1'"):
        Port("127.0.0.1:1")
    with pytest.raises(LinkFaultError, match="it is not a serial line"):
        Port("/dev/null")
    with pytest.raises(OptionError, match="need the simulated machine"):
        link_of("grbl:127.0.0.1:1", MACHINE, 0.0, None)
    with pytest.raises(OptionError, match="is not driven by part programs"):
        link_of("grbl:127.0.0.1:1", load_machine("letter-placer"), 1.0, None)


def test_a_stop_while_it_homes_resets_it_at_once() -> None:
    """Homing takes a minute; the stop does not wait for its end, and nothing is sent after it."""
    model = GrblModel(settings() | {22: 1.0})
    model.homing_s = 60.0
    with meeting(model) as (one, desk, _):
        one.controller.meet()
        one.enable()
        stopping = threading.Timer(0.3, desk.ask, (Cause.STOP,))
        stopping.start()
        began = time.monotonic()
        with pytest.raises(LinkFaultError, match="stopped by the operator while it homed"):
            one.home()
        assert time.monotonic() - began < 50.0
        while not bytes(model.heard).endswith(b"$H\n\x18"):
            assert time.monotonic() - began < 50.0
        assert one.state is State.FAULT


def test_a_planner_of_more_blocks_is_said_to_run_out_longer(tmp_path: Path) -> None:
    """The controller reports how many blocks it holds; the program has 40, mostly of 1 mm."""
    job = tmp_path / "zigzag.gcode"
    moves = "".join(f"X{1 + k % 2} A{k % 4}\n" for k in range(40))
    job.write_text(f"G21\nG90\nG1 F600\n{moves}M30\n", "utf-8")
    options = Options()
    plan = plan_job(open_job(job, MACHINE, options), MACHINE, options)
    reports = []
    for blocks in (15, 100):
        model = GrblModel(settings(), blocks=blocks)
        model.start()
        link = link_of(f"grbl:{model.address}", MACHINE, 1.0, None)
        reports += [float(line.split()[-5]) for line in link.prepare(plan) if "up to" in line]
        link.close()
        model.close()
        assert b"G1" not in model.heard
    holds = plan.duration_s
    assert reports[0] < reports[1] <= holds, (reports, holds)


def test_the_command_records_and_judges(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a load its position is not proven: required criteria are not measured."""
    job = tmp_path / "short.gcode"
    job.write_text("G21\nG90\nG1 X20 A40 F3000\nX40 A60\nM30\n", "utf-8")
    model = GrblModel(settings())
    model.start()
    with pytest.raises(SystemExit) as ended:
        main(["run", str(job), "-m", "stepper-winder", "--nominal", "--link",
              f"grbl:{model.address}", "--store", str(tmp_path / "runs"), "--json"])  # fmt: skip
    model.close()
    captured = capsys.readouterr()
    assert ended.value.code == 1, captured.err
    assert '"ended": "completed"' in captured.out
    assert '"not-measured"' in captured.out
    assert "executes its buffer" in captured.err
    np.testing.assert_allclose(model.at, [40.0, 0.0, 0.0, 60.0], atol=1e-9)
    (kept,) = (tmp_path / "runs").glob("*/sent/program.nc")
    assert kept.read_bytes() in bytes(model.heard).replace(b"?", b"")
