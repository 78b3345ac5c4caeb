"""Several programs with one store, and an index that another program keeps locked."""

from __future__ import annotations

import json
import os
import sqlite3
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy
from sqlalchemy import MetaData, Table, create_engine
from sqlalchemy.dialects import postgresql
from sqlalchemy.schema import CreateTable

from threadline.cli.main import main
from threadline.errors import StoreError
from threadline.live.store.index import RunIndex, RunRecord
from threadline.live.store.run_store import INDEX, INDEX_URL, OpenRun, RunStore, opened

EXAMPLES = Path(__file__).parents[3] / "examples"
PROGRAMS = 8


def record(run: str) -> RunRecord:
    return RunRecord(
        run=run, started="2026-11-23T01:00:00+00:00", job="x", machine="m", link="sim", speed=0.0,
        level="nominal", proof_passed=True, override="", job_sha256="", machine_sha256="",
        commands_sha256="", proof_sha256="", threadline="0.1.0",
    )  # fmt: skip


def test_programs_that_begin_at_once_all_get_their_rows(tmp_path: Path) -> None:
    """The store does not exist yet: one program makes the table, the others find it."""
    children, (gate, open_it) = [], os.pipe()
    for number in range(PROGRAMS):
        pid = os.fork()
        if not pid:
            try:
                os.close(open_it)
                os.read(gate, 1)  # all at once
                store = RunStore(tmp_path / "runs")
                for run in range(5):
                    store.index.add(record(f"run-{number}-{run}"))
                    store.index.end(
                        f"run-{number}-{run}", ended="completed", text="", late_ticks=0, passed=True
                    )
                os._exit(0)
            except BaseException as error:
                os.write(2, f"{error}\n".encode())
                os._exit(1)
        children.append(pid)
    os.close(gate)
    os.close(open_it)
    assert [os.waitpid(pid, 0)[1] for pid in children] == [0] * PROGRAMS
    rows = RunStore(tmp_path / "runs").index.runs()
    assert len(rows) == 5 * PROGRAMS
    assert all(row.ended == "completed" and row.passed for row in rows)


def test_a_store_names_the_database_of_its_index(tmp_path: Path) -> None:
    """Every command finds the index there; then the folder has none."""
    folder = tmp_path / "runs"
    folder.mkdir()
    (folder / INDEX_URL).write_text(f"sqlite:///{tmp_path / 'elsewhere.sqlite'}\n", "utf-8")
    store = RunStore(folder)
    store.index.add(record("first"))
    assert (tmp_path / "elsewhere.sqlite").is_file()
    assert not (folder / INDEX).exists()
    again = opened(folder)
    assert again is not None
    assert [one.run for one in again.index.runs()] == ["first"]
    for wrong in ("", "no url", "a://b c://d", "nothing://x"):
        (folder / INDEX_URL).write_text(wrong, "utf-8")
        with pytest.raises(StoreError, match=r"index\.url|cannot be used"):
            RunStore(folder)


def test_the_table_is_one_of_postgresql(tmp_path: Path) -> None:
    """The dialect of PostgreSQL writes the same table as is made in SQLite.

    ``docs/running.md`` names the server with which it was tried.
    """
    RunStore(tmp_path)
    made = Table("runs", MetaData(), autoload_with=create_engine(f"sqlite:///{tmp_path / INDEX}"))
    statement = str(CreateTable(made).compile(dialect=postgresql.dialect()))
    assert "CREATE TABLE runs" in statement
    assert "PRIMARY KEY (run)" in statement
    for column, kind in (("run", "VARCHAR"), ("passed", "BOOLEAN"), ("late_ticks", "INTEGER")):
        assert f"{column} {kind}" in statement


def at_once(url: Any, **options: Any) -> Any:
    """Do not wait five seconds for a lock that nobody releases."""
    return create_engine(url, connect_args={"timeout": 0.05}, **options)


@pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="nothing says what is open")
def test_the_index_is_open_while_it_is_used_alone(tmp_path: Path) -> None:
    """Python 3.13 warns if a database is dropped while it is open."""
    index = RunIndex(tmp_path / INDEX)
    index.add(record("first"))
    assert [row.run for row in index.runs()] == ["first"]
    still = [os.path.realpath(one) for one in Path("/proc/self/fd").iterdir()]
    assert str((tmp_path / INDEX).resolve()) not in still


def test_a_locked_index_is_one_line_before_anything_moves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sqlalchemy, "create_engine", at_once)
    RunIndex(tmp_path / INDEX).add(record("first"))
    other = sqlite3.connect(tmp_path / INDEX)
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(StoreError, match=r"is locked\. Another program writes into it: try"):
        RunStore(tmp_path).index.add(record("second"))
    other.rollback()
    other.close()
    RunStore(tmp_path).index.add(record("second"))
    assert [row.run for row in RunStore(tmp_path).index.runs()] == ["second", "first"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["report", "last", "--store", "STORE"], "there is no run 'last' in"),
        (["report", "last", "--store", "FILE"], "is no folder of runs"),
        (["runs", "--store", "FILE"], "is no folder of runs"),
    ],
)
def test_listing_runs_creates_no_store(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, folder = tmp_path / "file", tmp_path / "nowhere"
    file.write_text("not a store")
    with pytest.raises(SystemExit) as ended:
        main([{"STORE": str(folder), "FILE": str(file)}.get(word, word) for word in words])
    out, err = capsys.readouterr()
    assert ended.value.code == 2 and out == "" and message in err
    assert not folder.exists() and file.read_text() == "not a store"


def test_a_folder_without_an_index_has_no_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["runs", "--store", str(tmp_path)])
    assert not ended.value.code and "There are no runs in" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


def test_a_run_whose_index_is_locked_at_its_end_is_kept_and_entered_later(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """This is no fault: trace and verdict exist, and the next look at the store enters them."""
    monkeypatch.chdir(tmp_path)
    locked: list[sqlite3.Connection] = []
    judged = OpenRun.judged

    def locks_first(self: OpenRun, content: dict[str, Any], ended: str, text: str) -> str:
        """Another program begins to write just before the run is entered."""
        locked.append(sqlite3.connect(tmp_path / "runs" / INDEX))
        locked[0].execute("BEGIN EXCLUSIVE")
        return judged(self, content, ended, text)

    monkeypatch.setattr(OpenRun, "judged", locks_first)
    with pytest.raises(SystemExit) as ended:
        main(["run", str(EXAMPLES / "x-180.prg"), "-m", "lathe-winder", "--nominal",
              "--speed", "0", "--store", "runs", "--json"])  # fmt: skip
    output = capsys.readouterr()
    assert ended.value.code in (0, None)
    assert "are kept in runs/" in output.err and "is locked" in output.err
    assert "threadline runs --store runs enters it into the index later" in output.err
    locked[0].rollback()
    locked[0].close()
    (row,) = RunIndex(tmp_path / "runs" / INDEX).runs()
    assert row.passed is None

    with pytest.raises(SystemExit):
        main(["runs", "--store", "runs", "--json"])
    (listed,) = json.loads(capsys.readouterr().out)
    assert (listed["passed"], listed["ended"]) == (True, "completed")
    assert listed["verdict"] == "in spec"
