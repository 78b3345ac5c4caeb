"""``threadline equal``: one plan beside the file of every controller."""

from __future__ import annotations

import os
import shlex
from typing import Annotated

import typer

from threadline.cli import completion, option_parameters
from threadline.cli.arguments import JobArgument, JsonOption, MachineOption, ReportOption
from threadline.cli.messages import PLANNING_STAGE, warning
from threadline.cli.output import check_outputs, print_json, print_table, progress_bar, say
from threadline.cli.search_text import command_line
from threadline.proof.pipeline import open_job, plan_job
from threadline.proof.request import Words
from threadline.readback.equal import HEADER, asked_of, equal_targets
from threadline.report.differences import write_equality


def equal_(
    job: JobArgument,
    machine: MachineOption,
    words: Words,
    targets: Annotated[
        str | None,
        typer.Option(
            autocompletion=completion.each_target,
            help="Targets, separated by commas: csv,npz,ticks,nc,steps,st,grbl,marlin,klipper. "
            "Default: the targets of --file, else all of the kind of machine.",
        ),
    ] = None,
    file: Annotated[
        list[str] | None,
        typer.Option(
            help="TARGET=FILE: compare this file on disk, grbl=part.nc, in place of a new one. "
            "May be repeated."
        ),
    ] = None,
    slower: Annotated[
        bool,
        typer.Option(
            "--slower",
            help="Compare also a program that takes longer on its firmware than JOB itself.",
        ),
    ] = False,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Check that the files of the controllers are the plan that was proven.

    The command writes the plan of JOB for every target, or takes a file on disk. A reader that
    shares no code with the writer reads each file, and its positions and times are compared with
    the plan. If a reader is not installed, the output says how to get it; with CI=true the exit
    status is then 1.

    Exit status: 0 equal, 1 a file differs, 2 wrong input.

    Example: threadline equal examples/x-180.prg -m lathe-winder --targets csv,npz,ticks,nc

    A file on disk: threadline equal examples/x-180.prg -m lathe-winder --file nc=x-180.nc
    """
    check_outputs(folder=report)
    chosen, options = words.machine(machine), words.options()
    names = [] if targets is None else [name.strip() for name in targets.split(",")]
    question = asked_of(chosen, options, names, file or (), slower=slower)
    with progress_bar(not json) as progress:
        progress(PLANNING_STAGE, 0.0)
        plan = plan_job(open_job(job, chosen, options), chosen, options)
        equality = equal_targets(plan, options, question, progress)
    written = None
    if report is not None:
        typed = {"-m": machine, **words.typed("equal"), "--targets": targets}
        files = [word for one in file or () for word in ("--file", one)]
        command = command_line("equal", job, typed | {"--slower": "" if slower else None})
        written = write_equality(equality, report, shlex.join([*shlex.split(command), *files]))
    forbidden = equality.missing if os.environ.get("CI") == "true" else {}
    if json:
        content = equality.content()
        if written is not None:
            content["report"] = str(written)
        print_json(content)
    else:
        title = f"{plan.job.name} on {plan.machine.name}, {plan.duration_s:.4g} s"
        print_table(title, HEADER, [one.row() for one in equality.targets])
        for one in equality.targets:
            if one.remark:
                say(f"{one.target}: {one.remark}")
        say(equality.closing())
        if written is not None:
            say(f"Report: {written}")
    for target, why in forbidden.items():
        warning(f"{target}: {why}; CI=true does not allow that")
    raise typer.Exit(0 if equality.passed and not forbidden else 1)


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "equal", equal_)
