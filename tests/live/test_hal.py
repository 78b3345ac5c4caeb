"""LinuxCNC's HAL behind an executor: the real one, headless, as another user than root."""

from __future__ import annotations

import json
import os
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import closing, nullcontext
from pathlib import Path

import numpy as np
import pytest

from tests.live.bench import table_of_counts, there_and_back, winder
from tests.live.hal_bench import (
    awake,
    bridge,
    commanded_in,
    execute,
    hal_alone,
    left_samples,
    refuse_slept,
    unhurried,
)
from tests.live.kill_bench import child
from tests.live.memory_sink import MemorySink
from tests.live.test_pace import plan_ticks
from threadline import machine as machine_package
from threadline.cli.main import main
from threadline.errors import LinkFaultError
from threadline.files import RunEnd
from threadline.live import hal_session
from threadline.live.continuing import Continued
from threadline.live.derived import rest_of_rows
from threadline.live.executor import Executor
from threadline.live.hal_rows import HalRows
from threadline.live.hal_session import STREAMER_KEY, HalSession, in_use
from threadline.live.states import Cause, Desk, State
from threadline.live.supervised import Conduct, run_commands
from threadline.live.wire import Connection, Message
from threadline.machine import Machine, load_machine

ZERO = np.zeros(3, np.int64)
ROWS = there_and_back(peak=10.0, cruise=60)  # 36 mm/s on X; 1.8 s in all
LEAD_TICKS = 4  # 20 ms, the age of reports in real time
X_M = winder().counts_per_unit[1]
LIBRARY = Path(machine_package.__file__).parent / "library" / "lathe-winder.toml"


@pytest.fixture(autouse=True)
def hal_lock(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Run one of these tests at a time."""
    with hal_alone(monkeypatch), unhurried(monkeypatch):
        yield


def winder_at_1_ms(folder: Path) -> Machine:
    """Return the winder's three axes at a tick of 1 ms, for the fifo alone."""
    text = LIBRARY.read_text("utf-8").replace('servo = "5 ms exact', 'servo = "1 ms exact')
    file = folder / "fast.toml"
    file.write_text(text, "utf-8")
    return load_machine(file)


@awake
def test_3000_ticks_of_three_axes_at_1_ms_and_none_is_lost(tmp_path: Path) -> None:
    """Refills have 25 rows, each with a tail that the next one replaces: HAL plays rows alone."""
    steps = np.random.default_rng(1994).integers(-30, 31, (3000, 3))
    rows = np.cumsum(steps, axis=0).astype(np.float64)
    hal = HalSession(winder_at_1_ms(tmp_path), ZERO, plant=False)
    try:
        hal.fill()
        first, sent = hal.end, 0
        found, late = [], 0
        begun = looked = time.monotonic()
        while sum(len(part.record) for part in found) < 4500 and time.monotonic() < begun + 20.0:
            assert time.monotonic() < looked + 0.06, "this computer slept"  # it holds 0.1 s
            looked = time.monotonic()
            while sent < len(rows) and first + sent < hal.taken + 100:
                part = rows[sent : sent + 25]
                tail = part[-1] + np.arange(1, 40)[:, None] * [7.0, -7.0, 7.0]
                assert hal.replace(first + sent, np.concatenate([part, tail])), (
                    "this computer slept"
                )
                sent += len(part)
            if sent == len(rows):  # the table ends here: no tail any more
                hal.replace(first + sent, rows[-1:])
                sent += 1
            found.append(hal.samples())
            late += int(np.count_nonzero(found[-1].interval_s > 1.5e-3))
            time.sleep(0.004)
            hal.fill()
        assert hal.lost == 0
    finally:
        hal.close()
    record = np.concatenate([part.record for part in found])
    commanded = np.concatenate([part.commanded for part in found])
    fresh = np.diff(record, prepend=-1) == 1
    assert fresh[record < first + 3000].all()  # none twice, none left out
    np.testing.assert_array_equal(commanded[fresh][first : first + 3000], rows)
    assert (commanded[record >= first + 3000] == rows[-1]).all()
    print(f"{late} of 3000 ticks came more than half a period late")


def test_a_program_runs_and_is_labelled(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command runs to the end: the run is not called proven, and its far end is named."""
    job = Path(__file__).parents[2] / "examples" / "x-180.prg"
    store = ["--store", str(tmp_path / "runs")]
    for _ in range(5):  # exit status 3: the process got no processor for a tenth of a second
        with pytest.raises(SystemExit) as ended:
            main(["run", str(job), "-m", "lathe-winder", "--link", "hal:plant", "--json",
                  "--interpolation", "b-spline", "--feed", "40count/tick", "--override", "a test",
                  "--nominal", *store])  # fmt: skip
        captured = capsys.readouterr()
        if ended.value.code != 3:
            break
    assert ended.value.code == 1, captured.err
    content = json.loads(captured.out)
    assert content["label"] == "HAL's plant, a lag for each axis: not the machine"
    statuses = {one["name"]: one["status"] for one in content["criteria"]}
    assert statuses["contour_error"] == "not-measured"
    assert statuses["tracking_error"] == "reported"
    with pytest.raises(SystemExit):
        main(["report", "last", *store])
    (page,) = (tmp_path / "runs").glob("*/report/report.html")
    assert "not the machine" in page.read_text("utf-8").replace("&#39;", "'")


@awake
def test_hold_resume_and_stop(tmp_path: Path) -> None:
    """A hold skips no row: the run ends where the table does, always on its path."""
    reports = []

    def at_tick(executor: Executor, desk: Desk) -> None:
        if executor.tick > 60 and not reports:
            reports.append(Cause.HOLD)
            desk.ask(Cause.HOLD)
        if executor.tick > 120 and reports[-1:] == [Cause.HOLD]:
            reports.append(Cause.RESUME)
            desk.ask(Cause.RESUME)

    with bridge(winder(), ZERO, tmp_path / "box", plant=True) as far:
        executor, sink = execute(far.end, winder(), table_of_counts(ROWS), at_tick)
    assert executor.ended == (RunEnd.COMPLETED, "")
    assert [state for _, state, _, _ in sink.log].count(State.HOLDING) == 1
    x, a = on_path(tmp_path / "box")
    assert x[-1] == 0.0
    assert a[-1] == np.abs(ROWS[:, 1]).sum()
    measured = np.concatenate([block.samples["X.measured"] for block in sink.blocks])
    commanded = np.concatenate([block.samples["X.commanded"] for block in sink.blocks])
    lag_s = 0.0294  # of X, as in docs/safety.md
    assert np.abs(measured - commanded).max() == pytest.approx(
        0.036 * lag_s, abs=2.0 / X_M
    )  # a count of rounding each way
    # The trace has the plan time of each tick, at which the table is where HAL commanded X.
    ticks = plan_ticks(sink.blocks, len(commanded))
    places = np.append(0, np.cumsum(ROWS[:, 1]))
    meant = np.interp(np.minimum(ticks, len(ROWS)), np.arange(len(places)), places)
    assert np.abs(commanded * X_M - meant).max() <= 0.5 + 1e-6
    assert ticks[-1] < len(ticks) - 40  # it was held


def on_path(box: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return counts of X and A; A turns one count for each of X, forth and back."""
    counts = commanded_in(box, 3)
    a, x = counts[:, 1], counts[:, 2]
    way = np.cumsum(np.abs(np.diff(x, prepend=0.0)))
    assert np.abs(a - way).max() <= 2.0  # a count of rounding each way
    return x, a


def ends_at_rest(box: Path) -> bool:
    """Return whether the rows themselves come to rest, without HAL holding the last one."""
    commanded = commanded_in(box, 3)
    fresh = commanded[np.diff(commanded[:, 0], prepend=-1.0) > 0, 1:]
    return bool((fresh[-3:] == fresh[-1]).all())


@awake
def test_a_stop_brakes_along_the_path_and_the_rest_is_done(tmp_path: Path) -> None:
    """At 36 mm/s within 2 mm of command, as in docs/safety.md; the rest begins at home."""
    at = list[int]()

    def at_tick(executor: Executor, desk: Desk) -> None:
        if executor.tick > 90 and not at:
            at.append(executor.tick)
            desk.ask(Cause.STOP)

    with bridge(winder(), ZERO, tmp_path / "box", plant=False) as far:
        executor, sink = execute(far.end, winder(), table_of_counts(ROWS), at_tick)
    assert executor.ended == (RunEnd.STOPPED, "stopped by the operator")
    on_path(tmp_path / "box")
    # Its first tick was past when it arrived, so it was sent again for a later tick.
    assert executor._lead == LEAD_TICKS, "this computer slept"
    commanded = np.concatenate([block.samples["X.commanded"] for block in sink.blocks])
    assert np.abs(np.diff(commanded[at[0] :])).sum() <= 2e-3

    executed = max(int(block.samples["operation"].max(initial=0.0)) for block in sink.blocks)
    rest = rest_of_rows(table_of_counts(ROWS), winder(), executed, at_rest=False)
    assert rest.left_out >= 50
    begins = [int(count) for count in rest.begins]
    approach = list(zip(winder().axes, begins, strict=True))
    again, more = Continued(rest=rest, line=0, approach=approach, notes=()), MemorySink()
    with (
        bridge(winder(), ZERO, tmp_path / "rest", plant=False) as far,
        closing(Desk()) as desk,
        closing(Connection(far.end)) as link,
    ):
        ended = run_commands(
            table_of_counts(ROWS),
            winder(),
            nullcontext(link),
            desk,
            more,
            Conduct(again=again),
            speed=1.0,
        )
    refuse_slept(ended[:2])
    assert ended[:2] == (RunEnd.COMPLETED, "")
    references = commanded_in(tmp_path / "rest", 3)[:, 1:]
    assert (references[-1] == ROWS.sum(axis=0)).all()
    there = int(np.flatnonzero((references == begins).all(axis=1))[0])
    moved = np.diff(references[: there + 1], axis=0) != 0.0
    assert (moved.sum(axis=1) <= 1).all()  # one axis after the other
    assert (moved.any(axis=0) == (np.array(begins) != 0)).all()
    # The trace begins with the work, at its time in the whole table.
    work = next(block for block in more.blocks if len(block.samples["X.commanded"]))
    assert work.first_tick["servo"] == rest.left_out
    assert work.samples["operation"][0] == rest.operation


@pytest.mark.parametrize("gone", [False, True])
@awake
def test_a_jog_at_manual_feed_ends_by_itself(gone: bool, tmp_path: Path) -> None:
    """72 mm/s on X: within 26 mm of its last renewal, and of the executor's last message."""
    box, desk, renewed_at = tmp_path / "box", Desk(), 0
    with bridge(winder(), ZERO, box, plant=False) as far:
        link = Connection(far.end)
        executor = Executor(link, winder(), desk, MemorySink(), speed=1.0)
        executor.connect()
        executor.enable()
        executor.home()
        executor.jog("X", 0.072)
        while executor.tick < 100:
            executor.step()
            refuse_slept(executor.ended)
            assert executor.state is State.JOGGING, executor.ended
            executor.renew()
            renewed_at = int(executor.position_counts[1])
        if gone:
            link.close()  # without a message
        else:
            while not executor.over:
                executor.step()
            refuse_slept(executor.ended)
            assert "nobody has renewed its lease" in executor.ended[1]  # type: ignore[index]
            executor.close()
    desk.close()
    commanded = commanded_in(box, 3)[:, 2]
    assert renewed_at > 0.02 * X_M, "it was on its way"
    assert (commanded[-5:] == commanded[-1]).all()
    assert commanded[-1] - renewed_at <= (0.010 if gone else 0.026) * X_M


@pytest.mark.long(but=("279", "76", "18"))
@pytest.mark.parametrize("tick", np.random.default_rng(15).integers(5, 300, 10).tolist())
@awake
def test_kill_the_executor(tick: int, tmp_path: Path) -> None:
    """HAL plays the tail that it holds: within 5 mm of path at 36 mm/s, and on the path."""
    x = killed(tick, tmp_path, "executor")
    assert np.abs(np.diff(x)).sum() <= 5e-3 * X_M


@pytest.mark.long(but=("163", "8", "231"))
@pytest.mark.parametrize("tick", np.random.default_rng(16).integers(5, 300, 10).tolist())
@awake
def test_kill_the_process_in_front_of_hal(tick: int, tmp_path: Path) -> None:
    """The same without the process that fills the fifo: the fifo runs empty at rest."""
    x = killed(tick, tmp_path, "bridge")
    assert np.abs(np.diff(x)).sum() <= 5e-3 * X_M


def killed(tick: int, folder: Path, whom: str) -> np.ndarray:
    """Kill a process at a tick; return the counts of X that HAL commanded from then on."""
    box = folder / "box"
    with bridge(winder(), ZERO, box, plant=False) as far:
        there, here = os.pipe()

        def run(end: socket.socket = far.end, signal_end: int = here) -> None:
            execute(
                end, winder(), table_of_counts(ROWS),
                lambda executor, _: os.write(signal_end, b"!") if executor.tick >= tick else None,
            )  # fmt: skip

        pid = child(run)
        try:
            far.end.close()
            os.close(here)  # killed by this test: if the run ends before, nothing is read
            assert os.read(there, 1) == b"!", "this computer slept, and the run ended before"
            os.kill(pid if whom == "executor" else far.pid, signal.SIGKILL)
            seen = len(commanded_in(box, 3)) if box.exists() else 0
            if whom == "bridge":
                time.sleep(1.0)  # longer than the content of the fifo
                with box.open("ab") as more:
                    more.write(left_samples(winder()).tobytes())
                os.waitpid(far.pid, 0)
        finally:  # its end of the link would keep the process in front of HAL alive
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            os.close(there)
    x, _ = on_path(box)
    assert len(x) > seen
    assert ends_at_rest(box)
    return x[max(seen - 1, 0) :]


@pytest.mark.long(but=("223", "36", "15"))
@pytest.mark.parametrize("tick", np.random.default_rng(17).integers(5, 300, 10).tolist())
@awake
def test_kill_hal(tick: int, tmp_path: Path) -> None:
    """For the executor this is a loss of power; it reports so, in the state of a fault."""
    killed_it = []

    def at_tick(executor: Executor, _desk: Desk) -> None:
        if executor.tick >= tick and not killed_it:
            killed_it.append(in_use(STREAMER_KEY))
            os.kill(killed_it[0], signal.SIGKILL)

    with bridge(winder(), ZERO, tmp_path / "box", plant=False) as far:
        executor, sink = execute(
            far.end, winder(), table_of_counts(ROWS), at_tick, may_stand_still=True
        )
    assert killed_it, executor.ended  # or HAL got no processor before
    assert executor.state is State.FAULT
    assert executor.ended is not None
    assert executor.ended[0] is RunEnd.FAULT
    assert "has stood still" in executor.ended[1]
    assert sum(len(block.samples["X.commanded"]) for block in sink.blocks) >= tick


@awake
def test_an_underrun_is_seen(tmp_path: Path) -> None:
    """The process in front of HAL sleeps: HAL brakes by itself, and the run is over."""
    slept = []

    def at_tick(executor: Executor, _desk: Desk) -> None:
        if executor.tick > 60 and not slept:
            os.kill(far.pid, signal.SIGSTOP)
            time.sleep(0.4)  # 0.1 s of rows; the executor gives up after 0.5 s
            os.kill(far.pid, signal.SIGCONT)
            slept.append(True)

    with bridge(winder(), ZERO, tmp_path / "box", plant=False) as far:
        executor, _ = execute(
            far.end, winder(), table_of_counts(ROWS), at_tick, may_stand_still=True
        )
    assert executor.ended == (
        RunEnd.FAULT,
        "refills came too late, this computer was busy: the machine has braked by itself",
    )
    on_path(tmp_path / "box")
    assert ends_at_rest(tmp_path / "box")


def test_a_sampler_that_runs_over_is_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lost samples are a fault, and nothing is recorded after them."""
    monkeypatch.setattr(hal_session, "SAMPLED_S", -0.4)  # room for 20 records
    reports: list[Message] = []
    hal = HalSession(winder(), ZERO, plant=False)
    try:
        rows = HalRows(winder(), ZERO, reports.append, hal, plant=False)
        for kind in ("enable", "home", "begin"):
            rows.take(Message(kind))
        for _ in range(5):
            time.sleep(0.4)  # four times the size of the fifo, if HAL gets the processor
            rows.go_on(0.4)
            if events := reports[-1].head.get("events", []):
                break
    finally:
        hal.close()
    assert [event[1] for event in events] == ["fault"]
    assert "samples of HAL were lost" in events[0][3]


def test_a_row_that_is_about_to_be_played_is_not_replaced() -> None:
    """A refusal changes nothing; the executor then begins to brake later."""
    hal = HalSession(winder(), ZERO, plant=False)
    try:
        hal.fill()
        try:
            replaced = hal.replace(hal.taken + 1, np.full((5, 3), 1e6))
        except LinkFaultError as late:  # the replacement was tried, and HAL was faster
            pytest.fail(str(late))
        assert not replaced
        time.sleep(0.1)
        assert not hal.samples().commanded.any()
    finally:
        hal.close()
