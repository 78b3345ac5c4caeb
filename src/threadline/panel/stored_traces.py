"""Runs of the store for the panel: their list, and files made of their traces.

A long recording is read in a separate process, so that the server stays small.
"""

from __future__ import annotations

import asyncio
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

from threadline.base.importing import import_and_call, program_apart
from threadline.errors import StoreError
from threadline.live.store.run_store import TRACE, opened, verdict_of_run
from threadline.panel.calculation import answer_of

CHILD = import_and_call("threadline.panel.thinned_traces", "main")
_COLUMNS = ("run", "started", "job", "ended", "text", "passed")
_MOST_RUNS = 200
_JUDGED = (0, 1)  # exit statuses of a report that was written: in spec, out of spec
_one_at_a_time = asyncio.Semaphore(1)


def stored_runs(store: Path) -> list[dict[str, Any]]:
    """Return an entry for each run in a store, the latest first, at most 200."""
    store_open = opened(store)
    if store_open is None:
        return []
    entries = []
    for record in store_open.index.runs()[:_MOST_RUNS]:
        row = asdict(record)
        word = verdict_of_run(record, store_open.folder / record.run)
        entries.append({**{name: row[name] for name in _COLUMNS}, "verdict": word})
    return entries


def trace_file(store: Path, run: str) -> Path:
    """Return the trace of a run.

    Raises
    ------
    StoreError
        If there is no run with that name.
    """
    store_open = opened(store)
    if store_open is None:
        raise StoreError(f"there is no run {run[:60]!r}", remedy="Run a program first.")
    return store_open.find(run) / TRACE


async def in_process(trace: Path, out: Path) -> str:
    """Write a trace as JSON, or as a recording of another format; return an error text, or "".

    Parameters
    ----------
    trace, out
        File of the recording, and the file to write; its suffix sets the format.
    """
    async with _one_at_a_time:
        status, output, _ = await answer_of(*program_apart(CHILD), str(trace), str(out))
    ended = "the trace cannot be read: the reading process has ended" if status else ""
    return output.decode("utf-8", "replace").strip() or ended


async def report_of(store: Path, run: str, out: Path) -> str:
    """Write the report of a run, as ``threadline report`` does; return an error text, or "".

    Parameters
    ----------
    out
        The file ``report.pdf``; the other files of the report go into the same folder.
    """
    async with _one_at_a_time:
        status, _, error_output = await answer_of(
            sys.executable, "-P", "-m", "threadline", "report", run,
            "--store", str(store), "-o", str(out.parent),
        )  # fmt: skip
    if status in _JUDGED and out.exists():
        return ""
    lines = error_output.decode("utf-8", "replace").strip().splitlines()
    return lines[-1].removeprefix("error: ") if lines else "the process that judged it has ended"


def temporary(ending: str) -> Path:
    """Return a file for an answer; the sender deletes its folder."""
    return Path(tempfile.mkdtemp(prefix="threadline-trace-")) / f"trace.{ending}"
