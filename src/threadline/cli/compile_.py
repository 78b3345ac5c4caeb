"""``threadline compile``: write tables and programs for a machine's own controller."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.base.progress import WRITING
from threadline.base.writing import is_stdout, together
from threadline.cli import completion, option_parameters
from threadline.cli.arguments import JobArgument, JsonOption, MachineOption, keep_inputs
from threadline.cli.messages import PLANNING_STAGE, WRITING_STAGE, note
from threadline.cli.output import check_outputs, print_json, progress_bar, say, warn
from threadline.commands.nc import check_passes, write_passes
from threadline.errors import OptionError
from threadline.files.formats.common import Written, written
from threadline.motion.timing import check_limits
from threadline.proof.pipeline import open_job, plan_job, write
from threadline.proof.recorded import tolerance_warnings
from threadline.proof.request import Words, check_target


def compile_(
    job: JobArgument,
    machine: MachineOption,
    target: Annotated[
        str,
        typer.Option(
            autocompletion=completion.targets,
            help="ticks, csv, npz, nc, grbl, fluidnc, marlin, klipper, reprapfirmware, linuxcnc, "
            "fanuc; on an on/off machine st, openplc, plcopen, scl; on an embroidery machine "
            "steps, t15, dst, u01.",
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "--output", "-o", help="File to write.")],
    words: Words,
    slower: Annotated[
        bool,
        typer.Option(
            "--slower",
            help="Write the program even if it takes longer on its firmware than JOB itself.",
        ),
    ] = False,
    passes: Annotated[
        bool,
        typer.Option(
            "--passes",
            help="Write the circuits of a winding as subroutines and their passes, by the moves of "
            "its design: nc, linuxcnc, fanuc.",
        ),
    ] = False,
    json: JsonOption = False,
) -> None:
    """Plan JOB and write it for a controller; every limit is checked before the first byte.

    Auxiliary words of a part program (spindle, laser, tool, coolant, fan, pen) keep their places
    in a program for a firmware. A word that the firmware lacks or reads differently is refused by
    name.

    Exit status: 0 written, 2 wrong input (nothing is written).

    Example: threadline compile examples/x-180.prg -m lathe-winder --target csv -o x-180.csv

    On an on/off machine: threadline compile examples/letter-cycle.toml -m letter-placer
    --target st --shaper zv --mode "3.04 Hz" --damping 0.17 -o letter-cycle.st
    """
    chosen = words.machine(machine)
    keep_inputs(out, job, chosen.file, words.path("par"))
    check_outputs(file=out)
    if json and is_stdout(out):
        raise OptionError(
            f"--json and {str(out)!r} both go to standard output", remedy="Leave one of them out."
        )
    options = words.options()
    check_target(target, chosen, options)
    if passes:
        style = check_passes(target)
    with progress_bar() as progress:
        progress(PLANNING_STAGE, 0.0)
        plan = plan_job(open_job(job, chosen, options), chosen, options)
        WRITING.begin()
        progress(WRITING_STAGE, 0.0)
        more_warnings = [*plan.intent.warnings, *tolerance_warnings(plan)]
        warn(chosen, plan.job, more_warnings, own_feed=options.own_feeds)
        with together(out):
            if passes:
                check_limits(plan.motion.trajectory, plan.machine)
                fact = write_passes(plan.job, plan.machine, out, style)
                files = [written(out, (f"{out.name}: {fact}",))]
            else:
                files = write(plan, target, out, slower=slower)
    if json:
        print_json({"files": [_content(file) for file in files]})
    else:
        tell = note if is_stdout(out) else say
        for file in files:
            tell(f"{file.sha256}  {file.path}")
            for fact in file.facts:
                tell(fact)
            for warning in file.warnings:
                if warning not in plan.intent.warnings:
                    note(warning)


def _content(file: Written) -> dict[str, Any]:
    """Return a written file as JSON content."""
    content: dict[str, Any] = {"file": str(file.path), "sha256": file.sha256}
    if file.facts:
        content["facts"] = list(file.facts)
    if file.as_run_s is not None:
        content["stands_s"], content["as_run_s"] = file.as_run_s
    return content


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "compile", compile_)
