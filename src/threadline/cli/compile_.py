"""``threadline compile``: the tables and programs that a machine's own controller takes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.cli.feed_forward import feed_forward_warnings
from threadline.cli.options import (
    DEFAULT_INTERPOLATION_TEXT,
    DEFAULT_LIMITS_TEXT,
    DEFAULT_TOLERANCE_TEXT,
    FeedForwardOption,
    FeedModeOption,
    FeedOption,
    InterpolationOption,
    JobArgument,
    JsonOption,
    LimitsOption,
    MachineOption,
    ParOption,
    SmoothingOption,
    ToleranceOption,
    keep_inputs,
    machine_from,
    options_of,
)
from threadline.cli.output import print_json
from threadline.cli.outputs import check_outputs, folder_of
from threadline.cli.tolerance import tolerance_warnings
from threadline.cli.warn import warn
from threadline.errors import OptionError
from threadline.jobs import read_job
from threadline.options import refuse_axis_options
from threadline.pipeline import open_job, plan_job
from threadline.targets import write
from threadline.targets.schedule import compile_schedule
from threadline.targets.schedule_options import UNSHAPED_WORD, shaping_of
from threadline.targets.write import TABLES, check_target
from threadline.trajectory import check_limits


def compile_(
    job: JobArgument,
    machine: MachineOption,
    target: Annotated[str, typer.Option(help="ticks, csv, npz, nc, st or plcopen.")],
    out: Annotated[Path, typer.Option("--out", "--output", "-o", help="File to write.")],
    interpolation: InterpolationOption = DEFAULT_INTERPOLATION_TEXT,
    feed: FeedOption = None,
    feed_mode: FeedModeOption = None,
    tolerance: ToleranceOption = DEFAULT_TOLERANCE_TEXT,
    limits: LimitsOption = DEFAULT_LIMITS_TEXT,
    feed_forward: FeedForwardOption = False,
    smoothing: SmoothingOption = None,
    par: ParOption = None,
    shaper: Annotated[
        str,
        typer.Option(
            help='As with prove: "zv:12Hz:0.02" shapes the motion of axes; of an on/off machine '
            "zv, um-2ei, zv*um-2ei ... or none."
        ),
    ] = UNSHAPED_WORD,
    mode: Annotated[
        str | None,
        typer.Option(
            help='Of an on/off machine: the mode it is made for, "3.04 Hz"; default: its own.'
        ),
    ] = None,
    damping: Annotated[
        float | None, typer.Option(help="Damping ratio of that mode; default: the machine's.")
    ] = None,
    json: JsonOption = False,
) -> None:
    """Plan JOB and write it for a controller; every limit is checked before the first byte.

    Exit status: 0 written, 2 wrong input (nothing is written).

    Example: threadline compile examples/x-180.prg -m lathe-winder --target csv -o x-180.csv

    Of an on/off machine: threadline compile examples/letter-cycle.toml -m letter-placer
    --target st --shaper zv --mode "3.04 Hz" --damping 0.17 -o letter-cycle.st
    """
    chosen = machine_from(machine, par)
    keep_inputs(out, job, chosen.file, par)
    check_outputs(file=out)
    if shaper == UNSHAPED_WORD and (mode is not None or damping is not None):
        raise OptionError("--mode and --damping are of a shaper", remedy="Give --shaper too.")
    shapes_axes = shaper != UNSHAPED_WORD and not chosen.cylinders
    if shapes_axes and (mode is not None or damping is not None):
        raise OptionError(
            f"--mode and --damping are of on/off machines, which {chosen.name} is not",
            remedy='Write both with the shaper: --shaper "zv:12Hz:0.02".',
        )
    options = options_of(
        interpolation,
        feed,
        tolerance,
        limits,
        shaper if shapes_axes else None,
        feed_forward=feed_forward,
        smoothing=smoothing,
        feed_mode=feed_mode,
    )
    check_target(target, chosen)
    if chosen.cylinders:
        refuse_axis_options(chosen, options)
        shaping = shaping_of(chosen, shaper, mode=mode, damping_ratio=damping)
        scheduled = compile_schedule(read_job(job, chosen), chosen, shaping)
        with folder_of(out):
            files = write(scheduled, target, out)
        for warning in files[0].warnings:
            typer.echo(f"warning: {warning}", err=True)
    else:
        if (feed_forward or shapes_axes) and target not in TABLES:
            what = "feed-forward" if feed_forward else "a shaper"
            raise OptionError(
                f"{what} gives a reference for every tick, which target {target!r} has not",
                remedy=f"Use {' or '.join(TABLES)}.",
            )
        plan = plan_job(open_job(job, chosen, options), chosen, options)
        warn(
            chosen, plan.job, [*feed_forward_warnings(plan.feed_forward), *tolerance_warnings(plan)]
        )
        check_limits(plan.trajectory, chosen)
        with folder_of(out):
            files = write(plan, target, out)
    if json:
        print_json({"files": [{"file": str(f.path), "sha256": f.sha256} for f in files]})
    else:
        for file in files:
            typer.echo(f"{file.sha256}  {file.path}")


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("compile")(compile_)
