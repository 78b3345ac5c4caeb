"""``threadline report``: a run of the store, judged again and written as a report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.base.writing import together
from threadline.cli.arguments import JsonOption, SpecOption, named_folder
from threadline.cli.output import check_outputs, print_json, say
from threadline.cli.prove import show_proof
from threadline.cli.runs_ import DEFAULT_STORE, StoreOption
from threadline.errors import OptionError, StoreError
from threadline.files.formats import read_recording, write_recording
from threadline.live.store.index import REFUSED, RunRecord
from threadline.live.store.run_store import INPUTS, PROOF, TRACE, opened
from threadline.live.store.whole_trace import as_one, joined_with, whole_recording
from threadline.proof.option_form import Door
from threadline.proof.pipeline import Proof
from threadline.proof.proof_file import read_proof
from threadline.proof.proof_hash import spec_sha256
from threadline.proof.recorded import judge_files
from threadline.proof.request import Words
from threadline.report.proof import write_report
from threadline.search.report_data import report_data
from threadline.verdict import verdict_json


def report(
    run: Annotated[str, typer.Argument(help="Name of the run (threadline runs), or last.")],
    store: StoreOption = DEFAULT_STORE,
    spec: SpecOption = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            parser=named_folder,
            metavar="<path>",
            help="Folder for the report; default: report, in the folder of the run.",
        ),
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(help="Write the recording to this file, too: .csv, .npz, .plt.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Judge the recording of a run again, and write its report.

    A continued run is judged together with the runs that it continues.

    Job, machine and specification must be unchanged since the run, unless -s gives another
    specification.

    Exit status: 0 in spec, 1 out of spec or not complete, 2 wrong input.

    Example: threadline report last --csv run.csv
    """
    store_open = opened(store)
    if store_open is None:
        raise StoreError(
            f"there is no run {run[:60]!r} in {str(store)!r}", remedy="threadline run makes one."
        )
    folder = store_open.find(run)
    record = store_open.index.record(folder.name)
    if record.ended == REFUSED:
        raise StoreError(
            f"run {folder.name} was refused before anything moved: {record.text}",
            remedy="There is nothing to judge.",
        )
    pages = out or folder / "report"
    check_outputs(file=csv, folder=pages)
    _check_samples(folder, record)
    proof_read = read_proof(folder / PROOF)
    words = Words.of("judge", Door.LINE, {"spec": proof_read.spec_path if spec is None else spec})
    try:
        judged = judge_files([folder / TRACE], words, read_one=whole_recording)
    except OptionError as error:
        raise StoreError(
            f"run {folder.name}: {error.message}",
            remedy=f"Put the file back as it was; {folder / INPUTS} has a copy of each input.",
        ) from error
    if spec is None and spec_sha256(judged.spec) != proof_read.sha256("spec"):
        raise StoreError(
            f"the specification that run {folder.name} was proved by, {proof_read.name('spec')!r}, "
            "has changed since",
            remedy=f"Give it with -s; {folder / INPUTS} has a copy if it was a file.",
        )
    recording, earlier_runs = judged.recordings[0], joined_with(folder / TRACE)
    proof = Proof(
        plan=judged.plan,
        recording=recording,
        verdict=judged.verdict,
        spec=judged.spec,
        judged=(recording,),
    )
    with together(csv):
        if csv is not None:
            write_recording(recording, csv)
        written = write_report(report_data(proof), pages)
    override = record.override
    if json:
        content = verdict_json(judged.verdict, judged.plan)
        content |= {"override": override} if override else {}
        print_json(
            {**content, "run": folder.name, "judged_with": earlier_runs, "report": str(written)}
        )
    else:
        show_proof(proof)
        if override:
            say(f"Run although its proof failed, by an override: {override}")
        if earlier_runs:
            say(as_one(earlier_runs))
        say(f"Report: {written}")
    raise typer.Exit(0 if judged.verdict.passed else 1)


def _check_samples(folder: Path, record: RunRecord) -> None:
    """Refuse a run that ended before its first sample, for example while homing.

    A run that was judged had samples: its trace was removed, or lost.
    """
    trace = folder / TRACE
    is_empty = not trace.exists() or not trace.stat().st_size
    if is_empty and record.passed is not None:
        word = "empty" if trace.exists() else "missing"
        raise StoreError(
            f"the trace of run {folder.name} is {word}: {trace}",
            remedy="The run was judged, so it had one: put it back from a copy.",
        )
    if is_empty or read_recording(trace).is_empty():
        ended_text = (
            f", {record.ended}: {record.text}" if record.text else ", without a word of its end"
        )
        raise StoreError(
            f"run {folder.name} ended before its first sample{ended_text}",
            remedy="There is nothing to judge; run the job again.",
        )


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("report")(report)
