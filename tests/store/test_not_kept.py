"""Runs that cannot be written: nothing is left of one that has not begun, else it is a fault."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from threadline.cli.main import main
from threadline.errors import StoreError
from threadline.store import run_store
from threadline.store.index import RunIndex
from threadline.store.run_store import INDEX_URL, OpenRun, opened

JOB = Path(__file__).parents[2] / "examples" / "x-180.prg"
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
    """Exit status 2 says that nothing has moved."""

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
    """As where the folder that the link leads to is not mounted: the index is elsewhere."""
    file = tmp_path / INDEX_URL
    file.symlink_to(tmp_path / "not mounted" / INDEX_URL)
    with pytest.raises(StoreError, match="cannot be read"):
        opened(tmp_path)
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(StoreError, match="cannot be read"):
        opened(tmp_path)
    assert [one.name for one in tmp_path.iterdir()] == [INDEX_URL]
