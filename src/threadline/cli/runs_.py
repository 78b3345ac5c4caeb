"""``threadline runs``: list the recorded runs and their verdicts."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from threadline.cli.arguments import JsonOption, named_folder
from threadline.cli.output import print_json, print_table, say
from threadline.live.store.index import RUNNING, RunRecord
from threadline.live.store.run_store import opened, verdict_of_proof, verdict_of_run

DEFAULT_STORE = Path("runs")
StoreOption = Annotated[
    Path,
    typer.Option(
        "--store",
        parser=named_folder,
        metavar="<path>",
        help="Folder of runs; the first run creates it.",
    ),
]


def runs(store: StoreOption = DEFAULT_STORE, json: JsonOption = False) -> None:
    """List the runs of a store, the latest first.

    Example: threadline runs --store runs
    """
    store_open = opened(store)
    records = (
        []
        if store_open is None
        else [(record, store_open.folder / record.run) for record in store_open.index.runs()]
    )
    if json:
        print_json(
            [
                {**asdict(record), "verdict": verdict_of_run(record, folder)}
                for record, folder in records
            ]
        )
    elif not records:
        say(f"There are no runs in {str(store)!r}; threadline run makes one.")
    else:
        header = ["run", "machine", "link", "ended", "this run", "proof", "late", "note"]
        print_table(f"Runs in {store}", header, [listed(*record) for record in records])


def listed(record: RunRecord, folder: Path) -> list[str]:
    """Return the row of a run: its verdict, and the verdict and level of its proof."""
    ended = "unknown" if record.ended == RUNNING else record.ended
    note = f"override: {record.override}" if record.override else _why(record)
    verdict = verdict_of_run(record, folder)
    proof = f"{verdict_of_proof(record, folder)} ({record.level})"
    late = str(record.late_ticks)
    return [record.run, record.machine, record.link, ended, verdict, proof, late, note]


def _why(record: RunRecord) -> str:
    """Return why a run ended, without its leading word: ``by the operator``."""
    return record.text.removeprefix(f"{record.ended} ")


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("runs")(runs)
