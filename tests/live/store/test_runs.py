"""A run is stored from before anything moves, and a crash loses at most a second of it."""

from __future__ import annotations

import errno
import json
import os
import signal
import socket
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import IO, cast

import numpy as np
import pytest

from tests.live.bench import table_of_counts, there_and_back, winder
from threadline import __version__
from threadline.cli.main import main
from threadline.cli.runs_ import listed
from threadline.errors import CommandError, LinkFaultError, StoreError
from threadline.files import Event, RecordingBlock, RunEnd
from threadline.files.formats import read_recording
from threadline.live import sim_process
from threadline.live.executor import MANY_S, Executor
from threadline.live.states import Desk
from threadline.live.store import run_store
from threadline.live.store.index import REFUSED, RUNNING, RunRecord
from threadline.live.store.run_store import OpenRun, RunStore
from threadline.live.wire import Connection
from threadline.proof.options import Options
from threadline.proof.pipeline import Proof, open_job, plan_job, prove_plan
from threadline.proof.proof_file import ProofFile, read_proof, verify_proof, write_proof
from threadline.verdict import load_spec

EXAMPLES = Path(__file__).parents[3] / "examples"
ROWS = there_and_back(cruise=600)


@pytest.fixture(scope="module")
def proof() -> Proof:
    options = Options(interpolation="linear")
    plan = plan_job(open_job(EXAMPLES / "x-180.prg", winder(), options), winder(), options)
    return prove_plan(plan, load_spec(None, winder()))


@pytest.fixture
def known(proof: Proof, tmp_path: Path) -> ProofFile:
    write_proof(proof, tmp_path / "a.proof.json")
    return read_proof(tmp_path / "a.proof.json")


def execute(run: OpenRun, end: socket.socket, speed: float, kill_at: int = 0) -> Executor:
    desk = Desk()
    executor = Executor(Connection(end), winder(), desk, run, speed=speed)
    with closing(desk):
        executor.connect()
        executor.enable()
        executor.home()
        executor.start(table_of_counts(ROWS))
        while not executor.over:
            executor.step()
            if kill_at and executor.tick >= kill_at:
                os.kill(os.getpid(), signal.SIGKILL)
    return executor


def machine(theirs: socket.socket, ours: socket.socket, speed: float) -> int:
    pid = os.fork()
    if not pid:
        ours.close()
        sim_process.serve(theirs, winder(), np.zeros(3, np.int64), speed)
        os._exit(0)
    return pid


def test_a_run_has_all_that_it_was_made_from(
    proof: Proof, known: ProofFile, tmp_path: Path
) -> None:
    store = RunStore(tmp_path / "runs")
    job = EXAMPLES / "x-180.prg"
    origin = {"link": "sim", "override": "a test"}
    run = store.begin(proof.plan, known, origin, 0.0, [job, job])
    # Before anything moves.
    (record,) = store.index.runs()
    assert (record.ended, record.passed, record.override) == (RUNNING, None, "a test")
    assert (record.job_sha256, record.machine_sha256, record.threadline) == (
        proof.plan.job.sha256, proof.plan.machine.sha256, __version__,
    )  # fmt: skip
    assert record.commands_sha256 == proof.plan.commands.rows_sha256()
    assert verify_proof(run.path / "proof.json") == ()
    kept = sorted((run.path / "inputs").iterdir())
    assert [file.name for file in kept] == ["2-x-180.prg", "x-180.prg"]
    assert all(file.read_bytes() == job.read_bytes() for file in kept)
    ours, theirs = socket.socketpair()
    pid = machine(theirs, ours, 0.0)
    theirs.close()
    with run:
        executor = execute(run, ours, 0.0)
    ours.close()
    os.waitpid(pid, 0)
    assert executor.ended == (RunEnd.COMPLETED, "")
    run.judged({"late_ticks": 0, "passed": True}, "completed", "")
    (record,) = store.index.runs()
    assert (record.ended, record.passed) == ("completed", True)
    states = [
        json.loads(line)["state"] for line in (run.path / "events.jsonl").read_text().splitlines()
    ]
    assert states == ["enabled", "homing", "idle", "running", "idle"]
    found = read_recording(run.trace)
    assert len(found.samples("X.load")[1]) == len(ROWS) + 101
    assert (found.origin["link"], found.origin["run"]) == ("sim", run.path.name)
    assert store.find("last") == store.find(run.path.name) == run.path


@pytest.mark.parametrize("tick", [35, 480, 1233])
def test_a_crash_loses_at_most_a_second(
    proof: Proof, known: ProofFile, tmp_path: Path, tick: int
) -> None:
    """kill -9 at a tick of the run: the trace ends at the last report, and says so."""
    store = RunStore(tmp_path / "runs")
    run = store.begin(proof.plan, known, {"link": "sim"}, 0.0)
    ours, theirs = socket.socketpair()
    pid = machine(theirs, ours, 0.0)
    theirs.close()
    executor = os.fork()
    if not executor:
        execute(run, ours, 0.0, tick)
        os._exit(1)
    ours.close()
    assert os.waitstatus_to_exitcode(os.waitpid(executor, 0)[1]) == -signal.SIGKILL
    os.waitpid(pid, 0)
    found = read_recording(run.trace)
    samples = len(found.samples("X.load")[1])
    report = round(MANY_S / 5e-3)  # ticks of 5 ms
    assert report < 200  # which is a second
    assert tick <= samples <= tick + report
    assert found.outcome().ended is RunEnd.FAULT
    (record,) = store.index.runs()
    assert record.ended == RUNNING
    with run:
        pass  # number of this process, which has written nothing


def test_a_run_that_never_began_says_why(proof: Proof, known: ProofFile, tmp_path: Path) -> None:
    store = RunStore(tmp_path / "runs")
    with (
        pytest.raises(LinkFaultError),
        store.begin(proof.plan, known, {"link": "sim"}, 0.0),
    ):
        raise LinkFaultError("the machine did not answer")
    again = store.begin(proof.plan, known, {"link": "sim"}, 0.0)
    with again:
        pass
    records = store.index.runs()
    assert len({record.run for record in records}) == 2
    assert {record.text for record in records} == {"", "the machine did not answer"}
    with pytest.raises(StoreError, match="there is no run 'nothing'"):
        store.find("nothing")


def test_the_disk_is_ordered_to_take_it_up_as_it_goes(
    proof: Proof, known: ProofFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A loss of the computer's power leaves the trace up to the last such order."""
    assert run_store.SYNC_S < 1.0
    monkeypatch.setattr(run_store, "SYNC_S", 0.0)
    ordered: list[int] = []
    monkeypatch.setattr(run_store.os, "fsync", lambda _: ordered.append(run.trace.stat().st_size))
    store = RunStore(tmp_path / "runs")
    run = store.begin(proof.plan, known, {"link": "sim"}, 0.0)
    ours, theirs = socket.socketpair()
    pid = machine(theirs, ours, 0.0)
    theirs.close()
    with run:
        execute(run, ours, 0.0)
    ours.close()
    os.waitpid(pid, 0)
    assert len(ordered) > 3
    assert ordered == sorted(ordered)
    assert ordered[0] < ordered[-1] <= run.trace.stat().st_size


def test_a_refused_run_has_a_verdict_and_is_listed(
    proof: Proof, known: ProofFile, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = RunStore(tmp_path / "runs")
    run = store.begin(proof.plan, known, {"link": "sim"}, 0.0)
    with pytest.raises(CommandError), run:
        raise CommandError("axis X stands at 1, the run begins at 0")
    (record,) = store.index.runs()
    assert (record.ended, record.passed) == (REFUSED, None)
    verdict = json.loads((run.path / "verdict.json").read_text())
    assert (verdict["ended"], verdict["passed"], verdict["run"]) == (REFUSED, False, run.path.name)
    assert listed(record, run.path)[3:5] == [REFUSED, REFUSED]
    with pytest.raises(SystemExit) as ended:
        main(["report", "last", "--store", str(store.folder)])
    assert ended.value.code == 2
    assert "was refused before anything moved: axis X stands at 1" in capsys.readouterr().err


def test_the_last_run_is_the_one_that_began_last(tmp_path: Path) -> None:
    """Runs that began in one second are not in the order of their names; time zones differ, too."""
    store = RunStore(tmp_path)
    for run, started in (
        ("20261122-120000-x", "2026-11-22T12:00:00.100000+00:00"),
        ("20261122-120000-a", "2026-11-22T12:00:00.900000+00:00"),
        ("20261122-130000-b", "2026-11-22T13:00:00.000000+02:00"),
    ):
        store.index.add(replace(RECORD, run=run, started=started))
    assert [one.run[9:] for one in store.index.runs()] == ["120000-a", "120000-x", "130000-b"]
    assert store.find("last").name == "20261122-120000-a"


def test_a_store_that_cannot_be_used_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("text")
    with pytest.raises(StoreError, match="cannot keep runs in"):
        RunStore(file)
    folder = tmp_path / "damaged"
    folder.mkdir()
    (folder / "index.sqlite").write_bytes(b"no database at all, but long enough to be read" * 40)
    with pytest.raises(StoreError, match="cannot be used"):
        RunStore(folder)


RECORD = RunRecord(
    run="20261122-120000-a", started="2026-11-22T12:00:00+00:00", job="a.prg", machine="m",
    link="sim", speed=0.0, level="nominal", proof_passed=True, job_sha256="", machine_sha256="",
    commands_sha256="", proof_sha256="", threadline="0",
)  # fmt: skip


@pytest.mark.parametrize("name", ["a?b", "a%20b", "a#b", "a@b", "a;b", "mode=memory?x", ":memory:"])
def test_the_index_lies_in_the_folder_whatever_that_is_called(name: str, tmp_path: Path) -> None:
    """As a URL, "a?b/index.sqlite" was the file "a": all stores with such names shared an index."""
    store = RunStore(tmp_path / name)
    store.index.add(RECORD)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert [path.name for path in (tmp_path / name).iterdir()] == ["index.sqlite"]


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("run", b"\x00\xff"),
        ("run", "../../etc"),
        ("run", ".."),
        ("run", "a\x00b"),
        ("text", b"\x00\xff"),
        ("speed", float("inf")),
        ("speed", "fast"),
        ("late_ticks", "many"),
        ("late_ticks", 1.5),
        ("started", "yesterday"),
    ],
)
def test_an_index_that_holds_something_else_is_one_line(
    column: str, value: object, tmp_path: Path
) -> None:
    """SQLite takes any value in any column; a name that is a path leads out of the store."""
    store = RunStore(tmp_path)
    store.index.add(RECORD)
    with closing(sqlite3.connect(tmp_path / "index.sqlite")) as index, index:
        index.execute(f"update runs set {column} = ?", (value,))
    for ask in (store.index.runs, lambda: store.find("last")):
        with pytest.raises(StoreError, match=f"damaged: {column} of a run is") as caught:
            ask()
        assert "\n" not in str(caught.value)


def test_a_full_disk_ends_the_run_and_names_it(
    proof: Proof, known: ProofFile, tmp_path: Path
) -> None:
    """The disk is full at the third block: the machine brakes by itself."""

    class Full:
        def __init__(self, file: IO[bytes], room: int) -> None:
            self._file, self._room = file, room

        def write(self, data: bytes) -> int:
            self._room -= len(data)
            if self._room < 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            return self._file.write(data)

        def __getattr__(self, name: str) -> object:
            return getattr(self._file, name)

    store = RunStore(tmp_path / "runs")
    run = store.begin(proof.plan, known, {"link": "sim"}, 0.0)
    run._trace = cast("IO[bytes]", Full(run._trace, 20_000))
    ours, theirs = socket.socketpair()
    pid = machine(theirs, ours, 0.0)
    theirs.close()
    with pytest.raises(OSError, match="No space left") as caught, run:
        execute(run, ours, 0.0)
    ours.close()
    assert os.waitpid(pid, 0)[1] == 0  # it has come to rest, and ended by itself
    assert caught.value.filename == str(run.path)
    (record,) = store.index.runs()
    assert (record.ended, record.passed) == ("fault", None)
    assert record.text == "the trace could not be written: No space left on device"
    assert read_recording(run.trace).outcome().ended is RunEnd.FAULT


def test_a_run_without_samples_has_one_line_for_a_report(
    known: ProofFile, proof: Proof, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was stopped while it homed, with an event and no sample, or killed before any writing."""
    store = RunStore(tmp_path / "runs")
    run = store.begin(proof.plan, known, {"link": "sim"}, 1.0)
    channels = proof.recording.channels
    with run:
        run.begin(channels, simulated=True)
        stopped = Event(tick=0, kind="stopped", operation=-1, name="stopped while homing")
        nothing = {channel.name: np.empty(0) for channel in channels}
        first = {channel.clock.name: 0 for channel in channels}
        run.block(RecordingBlock(first_tick=first, samples=nothing, events=(stopped,)))
        run.over("stopped", "stopped while homing")
    name = run.path.name
    for content, message in (
        (None, f"run {name} ended before its first sample, stopped: stopped while homing"),
        (b"", f"run {name} ended before its first sample"),
        (b"\x89MC", "the trace ends before its first sample"),
    ):
        if content is not None:
            run.trace.write_bytes(content)
        for more in ([], ["--json"], ["--csv", str(tmp_path / "out.csv")]):
            with pytest.raises(SystemExit) as left:
                main(["report", name, "--store", str(tmp_path / "runs"), *more])
            output = capsys.readouterr()
            assert (left.value.code, output.out, output.err.count("\n")) == (2, "", 1), output.err
            assert message in output.err
    assert not (tmp_path / "out.csv").exists()


def test_a_trace_that_was_lost_is_no_run_without_samples(
    known: ProofFile, proof: Proof, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The index shows that the run was judged: it did not end before its first sample."""
    store = RunStore(tmp_path / "runs")
    run = store.begin(proof.plan, known, {"link": "sim"}, 1.0)
    with run:
        run.begin(proof.recording.channels, simulated=True)
        run.judged({"passed": True, "criteria": [], "late_ticks": 0}, "completed", "")
    for word in ("empty", "missing"):
        if word == "empty":
            run.trace.write_bytes(b"")
        else:
            run.trace.unlink()
        with pytest.raises(SystemExit):
            main(["report", run.path.name, "--store", str(tmp_path / "runs")])
        errors = capsys.readouterr().err
        assert f"the trace of run {run.path.name} is {word}" in errors
        assert "before its first sample" not in errors
