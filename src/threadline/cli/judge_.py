"""``threadline judge``: judge recordings, Threadline's own or another program's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.cli import completion, option_parameters
from threadline.cli.arguments import JsonOption
from threadline.cli.output import print_json, print_table, say
from threadline.cli.prove import show_steps
from threadline.proof.recorded import judge_files
from threadline.proof.request import Words
from threadline.verdict import closing, happened_lines, verdict_json, verdict_rows


def judge(
    recordings: Annotated[
        list[Path],
        typer.Argument(help="Recordings (.mcap, .npz, .csv, .plt) of the same job."),
    ],
    words: Words,
    job: Annotated[
        Path | None, typer.Option(help="The job; default: the job that the recording names.")
    ] = None,
    machine: Annotated[
        str | None,
        typer.Option(
            "--machine",
            "-m",
            autocompletion=completion.machines,
            help="The machine; default: the machine that the recording names.",
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Judge recordings of a machine, written by Threadline or by any program that writes a table.

    Exit status: 0 in spec, 1 out of spec, 2 wrong input.

    Example: threadline judge run.npz, or: threadline judge trace.csv --job x-180.prg
    -m lathe-winder --interpolation linear
    """
    judged = judge_files(recordings, words, job=job, machine=machine)
    plan, verdict = judged.plan, judged.verdict
    if json:
        print_json(verdict_json(verdict, plan))
    else:
        header, rows = verdict_rows(verdict)
        print_table(
            f"{', '.join(p.name for p in recordings)} against {plan.job.name}", header, rows
        )
        show_steps(verdict)
        for line in happened_lines(verdict):
            say(line)
        say(closing(verdict))
    raise typer.Exit(0 if verdict.passed else 1)


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "judge", judge)
