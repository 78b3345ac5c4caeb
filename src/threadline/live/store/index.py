"""The index of runs: one row for each, in SQLite or at any URL that SQLAlchemy knows."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from threadline.errors import StoreError

# SQLAlchemy takes a fifth of a second to load: it is imported only to open an index.
if TYPE_CHECKING:
    from sqlalchemy import Table
    from sqlalchemy.engine import Engine, RowMapping

RUNNING = "running"
"""``ended`` of a run that is going on, or whose program was killed before it wrote the end."""

REFUSED = "refused"
"""``ended`` of a run that was refused before anything moved: there is nothing to judge."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRecord:
    """The row of one run in the index.

    Parameters
    ----------
    run
        Name of the run and of its folder.
    started
        Time of its start, ISO 8601 with the time zone.
    job, machine, link, speed
        Names of the job, of the machine and of the link to it, and the speed as a multiple of real
        time.
    ended, text
        How the run ended, and why; ``ended`` is ``RUNNING`` until then, and ``REFUSED`` if nothing
        has moved.
    passed
        Whether its recording is within the specification; None while there is no verdict.
    late_ticks
        Number of ticks that came more than half a period late.
    level, proof_passed, override
        Level of the proof, whether it passed, and the operator's reason to run without a pass.
    job_sha256, machine_sha256, commands_sha256, proof_sha256, threadline
        Hashes of the files and commands that were run, and the version of the program.
    """

    run: str
    started: str
    job: str
    machine: str
    link: str
    speed: float
    level: str
    proof_passed: bool
    job_sha256: str
    machine_sha256: str
    commands_sha256: str
    proof_sha256: str
    threadline: str
    override: str = ""
    ended: str = RUNNING
    text: str = ""
    passed: bool | None = None
    late_ticks: int = 0


_NAME = re.compile(r"[A-Za-z0-9._-]{1,200}")


@cache
def _table() -> Table:
    """Return the table of the runs, as defined in the database."""
    from sqlalchemy import Boolean, Column, Float, Integer, MetaData, String, Table

    types = {"speed": Float, "proof_passed": Boolean, "passed": Boolean, "late_ticks": Integer}
    columns: Iterator[Column[Any]] = (
        Column(
            f.name, types.get(f.name, String), primary_key=f.name == "run",
            nullable=f.name == "passed",
        )
        for f in fields(RunRecord)
    )  # fmt: skip
    return Table("runs", MetaData(), *columns)


class RunIndex:
    """The index of all runs of a store.

    Parameters
    ----------
    where
        A file of SQLite, or the URL of a database in SQLAlchemy's form.

    Raises
    ------
    StoreError
        If the database cannot be used; every method raises it, too.
    """

    def __init__(self, where: Path | str) -> None:
        from sqlalchemy import create_engine
        from sqlalchemy.engine import URL
        from sqlalchemy.pool import NullPool
        from sqlalchemy.schema import CreateTable

        self._shown = str(where).rpartition("@")[2] if isinstance(where, str) else str(where)
        with self._clear():
            # As text a path would be parsed as a URL, and cut at its first "?".
            url = URL.create("sqlite", database=str(where)) if isinstance(where, Path) else where
            # A connection lasts for one use, so that an abandoned store leaves none open.
            self._engine: Engine = create_engine(url, poolclass=NullPool)
            with self._engine.begin() as connection:  # another program may create it, too
                connection.execute(CreateTable(_table(), if_not_exists=True))

    def add(self, record: RunRecord) -> None:
        """Add a run."""
        with self._clear(), self._engine.begin() as connection:
            connection.execute(_table().insert().values(**_values(record)))

    def end(self, run: str, *, ended: str, text: str, late_ticks: int, passed: bool | None) -> None:
        """Write into its row how a run ended."""
        table = _table()
        with self._clear(), self._engine.begin() as connection:
            connection.execute(
                table.update()
                .where(table.c.run == run)
                .values(ended=ended, text=text, late_ticks=late_ticks, passed=passed)
            )

    def record(self, run: str) -> RunRecord:
        """Return the row of a run, which must exist."""
        return next(record for record in self.runs() if record.run == run)

    def runs(self) -> Sequence[RunRecord]:
        """Return every run, the latest first."""
        with self._clear(), self._engine.connect() as connection:
            records = [
                self._record(row) for row in connection.execute(_table().select()).mappings()
            ]
        return sorted(
            records, key=lambda record: (_instant(record.started), record.run), reverse=True
        )

    def _record(self, row: RowMapping) -> RunRecord:
        """Return the run of a row, checked: SQLite accepts any type in any column."""
        wrong_columns = [name for name, value in row.items() if not _fits(str(name), value)]
        if wrong_columns:
            raise StoreError(
                f"the index of runs {self._shown!r} is damaged: {wrong_columns[0]} of a run is "
                f"{str(row[wrong_columns[0]])[:40]!r}",
                remedy="Give another folder with --store, or repair the file.",
            )
        return RunRecord(**row)

    @contextmanager
    def _clear(self) -> Iterator[None]:
        """Raise errors of the database as a ``StoreError`` of one line."""
        from sqlalchemy.exc import SQLAlchemyError

        try:
            yield
        except (SQLAlchemyError, ImportError, ValueError) as error:
            if isinstance(error, StoreError):
                raise
            why = str(getattr(error, "orig", None) or error).splitlines()[0][:160]
            raise StoreError(
                f"the index of runs {self._shown!r} cannot be used: {why}",
                remedy="Another program writes into it: try again, or give another folder with "
                "--store."
                if "is locked" in why
                else "Give another folder with --store, or repair the file.",
            ) from error


def _fits(name: str, value: object) -> bool:
    """Return whether the value of a column has the type of its field in ``RunRecord``."""
    if name == "run":  # a folder of the store, never a path out of it
        return isinstance(value, str) and bool(_NAME.fullmatch(value)) and value.strip(".") != ""
    if name == "passed":
        return value is None or isinstance(value, bool)
    if name == "speed":
        return isinstance(value, float) and math.isfinite(value)
    if name in {"proof_passed", "late_ticks"}:
        return isinstance(value, int)
    if name == "started":
        return isinstance(value, str) and math.isfinite(_instant(value))
    return isinstance(value, str)


def _instant(started: str) -> float:
    """Return the time of a start in s since 1970; NaN if it is invalid."""
    try:
        return datetime.fromisoformat(started).timestamp()
    except ValueError:
        return math.nan


def _values(record: RunRecord) -> dict[str, object]:
    return {f.name: getattr(record, f.name) for f in fields(RunRecord)}
