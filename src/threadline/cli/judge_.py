"""``threadline judge``: recordings from anywhere, judged by the same judge."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.cli.output import print_json, print_table, say
from threadline.cli.prove import show_steps
from threadline.cli.shared_options import FEED_FORWARD, JsonOption, SpecOption
from threadline.recorded import judge_files
from threadline.verdict import closing, verdict_json, verdict_rows


def judge(
    recordings: Annotated[
        list[Path],
        typer.Argument(help="Recordings (.mcap, .npz, .csv, .plt) of one and the same job."),
    ],
    spec: SpecOption = None,
    job: Annotated[
        Path | None, typer.Option(help="The job; default: what the recording names.")
    ] = None,
    machine: Annotated[
        str | None, typer.Option("--machine", "-m", help="The machine; default: likewise.")
    ] = None,
    interpolation: Annotated[str | None, typer.Option(help="Default: likewise.")] = None,
    feed: Annotated[str | None, typer.Option(help="Default: likewise.")] = None,
    dialect: Annotated[str | None, typer.Option(help="Default: likewise.")] = None,
    feed_mode: Annotated[str | None, typer.Option(help="Default: likewise.")] = None,
    radius: Annotated[str | None, typer.Option(help="Default: likewise.")] = None,
    tolerance: Annotated[str | None, typer.Option(help="Default: likewise.")] = None,
    limits: Annotated[str | None, typer.Option(help="Default: likewise.")] = None,
    par: Annotated[Path | None, typer.Option(help="FW-CNC.PAR; default: likewise.")] = None,
    actual: Annotated[
        str | None, typer.Option(help="The machine that ran the plan; default: likewise.")
    ] = None,
    shaper: Annotated[str | None, typer.Option(help="As with prove; default: likewise.")] = None,
    feed_forward: Annotated[
        bool,
        typer.Option(
            "--feed-forward", help="The table was made with it; the recording may say so itself."
        ),
    ] = False,
    smoothing: Annotated[
        str | None, typer.Option(help=f'Of feed-forward: likewise, else "{FEED_FORWARD}".')
    ] = None,
    json: JsonOption = False,
) -> None:
    """Judge what a machine did, recorded by Threadline or by anything that writes a table.

    Exit status: 0 in spec, 1 out of spec, 2 wrong input.

    Example: threadline judge run.npz, or: threadline judge trace.csv --job x-180.prg
    -m lathe-winder --interpolation linear
    """
    given = {
        "interpolation": interpolation,
        "feed": feed,
        "dialect": dialect,
        "feed-mode": feed_mode,
        "radius": radius,
        "tolerance": tolerance,
        "limits": limits,
        "shaper": shaper,
        "job": None if job is None else str(job),
        "machine": machine,
        "par": None if par is None else str(par),
        "actual": actual,
    }
    judged = judge_files(recordings, given, spec, feed_forward=feed_forward, smoothing=smoothing)
    plan, verdict = judged.plan, judged.verdict
    if json:
        print_json(verdict_json(verdict, plan))
    else:
        header, rows = verdict_rows(verdict)
        print_table(
            f"{', '.join(p.name for p in recordings)} against {plan.job.name}", header, rows
        )
        show_steps(verdict)
        say(closing(verdict))
    raise typer.Exit(0 if verdict.passed else 1)


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("judge")(judge)
