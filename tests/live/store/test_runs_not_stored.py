"""Runs that cannot be written: nothing is left of an unstarted one; otherwise it is a fault."""

from __future__ import annotations

import errno
import json
import math
import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from threadline.cli.main import main
from threadline.errors import StoreError
from threadline.live.store import run_store
from threadline.live.store.index import RunIndex
from threadline.live.store.run_store import INDEX_URL, OpenRun, opened

JOB = Path(__file__).parents[3] / "examples" / "x-180.prg"
pytestmark = pytest.mark.usefixtures("forked_machine")
FULL = OSError(errno.ENOSPC, "No space left on device")


def run(store: Path) -> int | str | None:
    with pytest.raises(SystemExit) as ended:
        main(["run", str(JOB), "-m", "lathe-winder", "--nominal", "--speed", "0",
              "--store", str(store)])  # fmt: skip
    return ended.value.code


@pytest.mark.parametrize(
    ("method", "error"),
    [("block", FULL), ("state", FULL), ("judged", FULL), ("judged", StoreError("it is locked"))],
)
def test_a_machine_that_has_moved_is_no_wrong_input(
    method: str,
    error: Exception,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Exit status 2 would mean that nothing has moved."""

    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(OpenRun, method, fail)
    assert run(tmp_path / "runs") == 3
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith("error: [FAULT] the run could not be kept in ")
    assert (error.strerror if isinstance(error, OSError) else "it is locked") in said


def test_an_index_that_fails_too_does_not_hide_why(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: object) -> None:
        raise FULL

    def locked(*_: object, **__: object) -> None:
        raise StoreError("it is locked")

    monkeypatch.setattr(OpenRun, "block", fail)
    monkeypatch.setattr(RunIndex, "end", locked)
    assert run(tmp_path / "runs") == 3
    assert "No space left on device" in capsys.readouterr().err


@pytest.mark.parametrize("fails", ["add", "copyfileobj"])
def test_nothing_is_left_of_a_run_that_has_not_begun(
    fails: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def locked(*_: object) -> None:
        raise StoreError("it is locked")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    if fails == "add":
        monkeypatch.setattr(RunIndex, "add", locked)
    else:
        monkeypatch.setattr(run_store.shutil, "copyfileobj", full)
    assert run(tmp_path / "runs") == 2
    assert [one.name for one in (tmp_path / "runs").iterdir()] == ["index.sqlite"]
    said = capsys.readouterr().err
    assert "it is locked" in said if fails == "add" else str(tmp_path / "runs") in said


def test_a_url_of_the_index_that_cannot_be_read_is_no_store_of_its_own(tmp_path: Path) -> None:
    """An example is an unmounted folder behind the link: the index is elsewhere."""
    file = tmp_path / INDEX_URL
    file.symlink_to(tmp_path / "not mounted" / INDEX_URL)
    with pytest.raises(StoreError, match="cannot be read"):
        opened(tmp_path)
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(StoreError, match="cannot be read"):
        opened(tmp_path)
    assert [one.name for one in tmp_path.iterdir()] == [INDEX_URL]


def test_end_of_a_run_is_stored_before_its_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An operator who interrupts the judging does not lose the run's end."""

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("threadline.live.job_run.judge", interrupted)
    assert run(tmp_path / "runs") == 130
    kept = opened(tmp_path / "runs")
    assert kept is not None
    (record,) = kept.index.runs()
    assert (record.ended, record.passed) == ("completed", None)


def test_a_verdict_is_whole_or_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise FULL

    monkeypatch.setattr(run_store, "SYNC_S", math.inf)  # the trace is not synced meanwhile
    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        assert run(tmp_path / "runs") == 3
    (folder,) = (file.parent for file in tmp_path.glob("runs/*/trace.mcap"))
    assert not [*folder.glob("*verdict*")]


@pytest.mark.long(
    shown_by="tests/cli/test_messages.py::test_standard_streams_that_are_closed_or_full"
)
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_a_verdict_that_cannot_be_printed_is_no_wrong_input(tmp_path: Path) -> None:
    """The machine has moved, and the verdict is stored: exit status 2 would deny both."""
    words = ["run", str(JOB), "-m", "lathe-winder", "--nominal", "--speed", "0"]
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "threadline", *words], stdout=full, stderr=subprocess.PIPE,
            text=True, check=False, cwd=tmp_path, env=dict(os.environ),
        )  # fmt: skip
    assert done.returncode == 0
    assert "cannot be written (No space left on device); the verdict is in runs" in done.stderr


def test_a_fault_whose_time_never_comes_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["run", str(JOB), "-m", "lathe-winder", "--nominal", "--speed", "0",
              "--store", str(tmp_path / "runs"), "--inject", "lost-link@99 s"])  # fmt: skip
    assert ended.value.code == 0
    assert "warning: --inject: lost-link at 99 s never came: the run ended at 10." in (
        capsys.readouterr().err
    )


@pytest.mark.long(shown_by="test_a_machine_that_has_moved_is_no_wrong_input")
def test_a_closed_input_and_the_longest_name_are_no_obstacle(tmp_path: Path) -> None:
    """A service, for example, has no standard input, for which Python has None."""
    job = tmp_path / f"{'a' * 251}.prg"
    job.write_bytes(JOB.read_bytes())
    words = shlex.join(
        [sys.executable, "-m", "threadline", "run", str(job), "-m", "lathe-winder", "--nominal",
         "--speed", "0", "--store", str(tmp_path / "runs"), "--json"]
    )  # fmt: skip
    done = subprocess.run(
        ["/bin/sh", "-c", f"exec {words} <&-"], capture_output=True, text=True, check=False,
        env=dict(os.environ),
    )  # fmt: skip
    assert (done.returncode, json.loads(done.stdout)["ended"]) == (0, "completed"), done.stderr
