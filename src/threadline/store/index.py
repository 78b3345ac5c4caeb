"""The index of runs: one row for each, in SQLite or at any URL that SQLAlchemy knows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace

from sqlalchemy import Boolean, Column, Float, Integer, MetaData, String, Table, create_engine
from sqlalchemy.engine import Engine
from sqlalchemy.exc import SQLAlchemyError

from threadline.errors import StoreError

RUNNING = "running"
"""How a run has ended that has not, or whose program ended before it could say so."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRecord:
    """A run, as the index has it.

    Parameters
    ----------
    run
        Its name, which is that of its folder.
    started
        When, ISO 8601 with its zone.
    job, machine, link, speed
        What was run, on which machine, by which link, at which part of real time.
    ended, text
        How it ended and why; ``RUNNING`` while nobody has said so.
    passed
        The verdict of its recording; None while there is none.
    late_ticks
        Ticks that came more than half a period late.
    level, proof_passed, override
        Of the proof that it was run by, and why it was run if that did not pass.
    job_sha256, machine_sha256, commands_sha256, proof_sha256, threadline
        What it was made from.
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


_TYPES = {"speed": Float, "proof_passed": Boolean, "passed": Boolean, "late_ticks": Integer}
_RUNS = Table(
    "runs",
    MetaData(),
    *(
        Column(
            f.name, _TYPES.get(f.name, String), primary_key=f.name == "run",
            nullable=f.name == "passed",
        )
        for f in fields(RunRecord)
    ),
)  # fmt: skip


class RunIndex:
    """All runs of a store.

    Parameters
    ----------
    url
        Of a database, as SQLAlchemy writes it.

    Raises
    ------
    StoreError
        If it cannot be used.
    """

    def __init__(self, url: str) -> None:
        with _clear(url):
            self._engine: Engine = create_engine(url)
            _RUNS.metadata.create_all(self._engine)
        self._url = url

    def add(self, record: RunRecord) -> None:
        """Add a run, before it moves anything."""
        with _clear(self._url), self._engine.begin() as connection:
            connection.execute(_RUNS.insert().values(**_values(record)))

    def end(self, run: str, *, ended: str, text: str, late_ticks: int, passed: bool | None) -> None:
        """Say how a run ended."""
        with _clear(self._url), self._engine.begin() as connection:
            connection.execute(
                _RUNS.update()
                .where(_RUNS.c.run == run)
                .values(ended=ended, text=text, late_ticks=late_ticks, passed=passed)
            )

    def runs(self) -> Sequence[RunRecord]:
        """Return every run, the latest first."""
        with _clear(self._url), self._engine.connect() as connection:
            rows = connection.execute(_RUNS.select().order_by(_RUNS.c.run.desc()))
            return [RunRecord(**row) for row in rows.mappings()]

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()


def _values(record: RunRecord) -> dict[str, object]:
    return {f.name: getattr(replace(record), f.name) for f in fields(RunRecord)}


@contextmanager
def _clear(url: str) -> Iterator[None]:
    """Turn what a database refuses into one line."""
    try:
        yield
    except (SQLAlchemyError, ImportError) as error:
        why = str(getattr(error, "orig", None) or error).splitlines()[0][:160]
        raise StoreError(
            f"the index of runs {url.rpartition('@')[2]!r} cannot be used: {why}",
            remedy="Give another folder with --store, or mend the file.",
        ) from error
