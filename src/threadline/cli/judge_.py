"""``threadline judge``: the verdict on recordings, Threadline's own or another program's."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.cli.output import print_json, print_table, say
from threadline.cli.prove import show_steps
from threadline.cli.shared_options import JsonOption, SpecOption
from threadline.option_defaults import FEED_FORWARD
from threadline.recorded import judge_files
from threadline.verdict import closing, happened_lines, verdict_json, verdict_rows

_DEFAULT = "default: what the recording names"
_AS_WITH_PROVE = f"As with prove; {_DEFAULT}."


def judge(
    recordings: Annotated[
        list[Path],
        typer.Argument(help="Recordings (.mcap, .npz, .csv, .plt) of one and the same job."),
    ],
    spec: SpecOption = None,
    job: Annotated[Path | None, typer.Option(help=f"The job; {_DEFAULT}.")] = None,
    machine: Annotated[
        str | None, typer.Option("--machine", "-m", help=f"The machine; {_DEFAULT}.")
    ] = None,
    interpolation: Annotated[str | None, typer.Option(help=_AS_WITH_PROVE)] = None,
    feed: Annotated[str | None, typer.Option(help=_AS_WITH_PROVE)] = None,
    dialect: Annotated[str | None, typer.Option(help=_AS_WITH_PROVE)] = None,
    feed_mode: Annotated[str | None, typer.Option(help=_AS_WITH_PROVE)] = None,
    radius: Annotated[str | None, typer.Option(help=_AS_WITH_PROVE)] = None,
    tolerance: Annotated[str | None, typer.Option(help=_AS_WITH_PROVE)] = None,
    limits: Annotated[str | None, typer.Option(help=_AS_WITH_PROVE)] = None,
    par: Annotated[Path | None, typer.Option(help=f"FW-CNC.PAR; {_DEFAULT}.")] = None,
    actual: Annotated[
        str | None, typer.Option(help=f"The machine that ran the plan; {_DEFAULT}.")
    ] = None,
    shaper: Annotated[str | None, typer.Option(help=_AS_WITH_PROVE)] = None,
    feed_forward: Annotated[
        bool,
        typer.Option(
            "--feed-forward",
            help=f"The plan was made with feed-forward; {_DEFAULT}.",
        ),
    ] = False,
    smoothing: Annotated[
        str | None,
        typer.Option(help=f'Time of feed-forward; {_DEFAULT}, else "{FEED_FORWARD}".'),
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
        for line in happened_lines(verdict):
            say(line)
        say(closing(verdict))
    raise typer.Exit(0 if verdict.passed else 1)


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("judge")(judge)
