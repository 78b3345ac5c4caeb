"""``threadline equal``: one plan beside the file of every controller."""

from __future__ import annotations

from typing import Annotated

import typer

from threadline.cli import option_parameters
from threadline.cli.arguments import JobArgument, JsonOption, MachineOption
from threadline.cli.messages import PLANNING_STAGE
from threadline.cli.output import print_json, print_table, progress_bar, say
from threadline.proof.asked import Words
from threadline.proof.pipeline import open_job, plan_job
from threadline.search.equal import HEADER, asked_of, equal_targets


def equal_(
    job: JobArgument,
    machine: MachineOption,
    words: Words,
    targets: Annotated[
        str | None,
        typer.Option(
            help="Targets, separated by commas: csv,npz,ticks,nc,grbl. Default: those of --file, "
            "else all of the kind of machine."
        ),
    ] = None,
    file: Annotated[
        list[str] | None,
        typer.Option(
            help="TARGET=FILE: compare this file on disk, grbl=part.nc, in place of a new one. "
            "May be repeated."
        ),
    ] = None,
    slower: Annotated[bool, typer.Option("--slower", help="As with compile.")] = False,
    json: JsonOption = False,
) -> None:
    """Say whether the file on a controller is the plan that was proven.

    The plan of JOB is written for every target, or a file on disk is taken. Each file is read by
    something that did not write it, and compared with the plan in place and time.

    Exit status: 0 equal, 1 a file differs, 2 wrong input.

    Example: threadline equal examples/x-180.prg -m lathe-winder --targets csv,npz,ticks,nc,grbl

    A file on disk: threadline equal examples/x-180.prg -m lathe-winder --file nc=x-180.nc
    """
    chosen, options = words.machine(machine), words.options()
    names = [] if targets is None else [name.strip() for name in targets.split(",")]
    asked = asked_of(chosen, options, names, file or (), slower=slower)
    with progress_bar(not json) as progress:
        progress(PLANNING_STAGE, 0.0)
        plan = plan_job(open_job(job, chosen, options), chosen, options)
        found = equal_targets(plan, options, asked, progress)
    if json:
        print_json(found.content())
    else:
        title = f"{plan.job.name} on {plan.machine.name}, {plan.duration_s:.4g} s"
        print_table(title, HEADER, [one.row() for one in found.targets])
        skipped = sum(one.verdict == "skipped" for one in found.targets)
        told = "equal" if found.passed else "NOT EQUAL"
        say(f"{told}: {len(found.targets) - skipped} compared, {skipped} skipped")
    raise typer.Exit(0 if found.passed else 1)


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "equal", equal_)
