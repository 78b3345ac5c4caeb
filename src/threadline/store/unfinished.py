"""Runs of a store whose rest can be done: broken off before the end of their job."""

from __future__ import annotations

from pathlib import Path

from threadline.errors import StoreError
from threadline.plan import Plan
from threadline.signals import Ended
from threadline.signals.files import read_recording
from threadline.store.index import REFUSED, RunRecord
from threadline.store.run_store import TRACE, opened


def unfinished_run(store: Path, run: str) -> tuple[Path, RunRecord]:
    """Return the folder and the record of a run that can be continued; nothing is made.

    Raises
    ------
    StoreError
        If there is no such run, or it came to its end.
    """
    kept = opened(store)
    if kept is None:
        raise StoreError(
            f"there is no run {run[:60]!r} in {str(store)!r}", remedy="Give its folder: --store."
        )
    folder = kept.find(run)
    record = kept.index.record(folder.name)
    if record.ended in {Ended.COMPLETED, REFUSED}:
        raise StoreError(
            f"run {folder.name} was {record.ended}: there is no rest of it", remedy="Run the job."
        )
    return folder, record


def refuse_other_rows(record: RunRecord, plan: Plan) -> None:
    """Refuse a plan whose commands are not those of a run, to the row.

    Raises
    ------
    StoreError
        If they are others.
    """
    if plan.commands.rows_sha256() != record.commands_sha256:
        raise StoreError(
            f"run {record.run} was of other rows than these: another job, machine or options",
            remedy="Give the files and options of that run; its proof.json names them.",
        )


def trace_of(folder: Path, record: RunRecord) -> Path:
    """Return the trace of a run, which tells what was executed of it.

    Raises
    ------
    StoreError
        If the file in its place is the trace of another run.
    RecordingError
        If it cannot be read.
    """
    trace = folder / TRACE
    told = read_recording(trace)
    run = told.origin.get("run", record.run)
    if (run, told.job_sha256, told.machine_sha256) != (
        record.run, record.job_sha256, record.machine_sha256,
    ):  # fmt: skip
        raise StoreError(
            f"{str(trace)!r} is the trace of another run ({run[:60]!r}): it does not tell what was "
            "executed of this one",
            remedy="Put its own trace there, or run the job anew.",
        )
    return trace
