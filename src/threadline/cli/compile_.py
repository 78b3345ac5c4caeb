"""``threadline compile``: the tables and programs that a machine's own controller takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.cli.chosen import machine_from, options_of
from threadline.cli.output import print_json, say
from threadline.cli.outputs import check_outputs
from threadline.cli.shared_options import (
    ContourOption,
    DialectOption,
    FeedForwardOption,
    FeedModeOption,
    FeedOption,
    InterpolationOption,
    JobArgument,
    JsonOption,
    LawOption,
    LimitsOption,
    MachineOption,
    ParOption,
    RadiusOption,
    RobustOption,
    SmoothingOption,
    ToleranceOption,
    keep_inputs,
    ratio,
)
from threadline.cli.told import note
from threadline.cli.warn import warn
from threadline.doubts import tolerance_warnings
from threadline.errors import OptionError
from threadline.kinds import kind_of
from threadline.option_defaults import (
    AUTO,
    DEFAULT_INTERPOLATION,
    DEFAULT_LIMITS,
    DEFAULT_TOLERANCE,
)
from threadline.pipeline import open_job, plan_job, target_of, write
from threadline.signals.files.common import Written
from threadline.targets.schedule_options import UNSHAPED_WORD
from threadline.writing import is_stdout, together


def compile_(
    job: JobArgument,
    machine: MachineOption,
    target: Annotated[
        str,
        typer.Option(
            help="ticks, csv, npz, nc, grbl, fluidnc, marlin, klipper, reprapfirmware, linuxcnc, "
            "fanuc; of an on/off machine st, plcopen, scl; of an embroidery machine steps, t15."
        ),
    ],
    out: Annotated[Path, typer.Option("--out", "--output", "-o", help="File to write.")],
    interpolation: InterpolationOption = DEFAULT_INTERPOLATION,
    law: LawOption = None,
    feed: FeedOption = None,
    dialect: DialectOption = None,
    feed_mode: FeedModeOption = None,
    radius: RadiusOption = None,
    tolerance: ToleranceOption = DEFAULT_TOLERANCE,
    contour: ContourOption = None,
    limits: LimitsOption = DEFAULT_LIMITS,
    feed_forward: FeedForwardOption = False,
    smoothing: SmoothingOption = None,
    robust: RobustOption = None,
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
        float | None,
        typer.Option(
            parser=ratio("--damping"), help="Damping ratio of that mode; default: the machine's."
        ),
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
    if json and is_stdout(out):
        raise OptionError(
            f"--json and {str(out)!r} both go to standard output", remedy="Leave one of them out."
        )
    if shaper == UNSHAPED_WORD and (mode is not None or damping is not None):
        raise OptionError(
            "--mode and --damping name the mode of a shaper", remedy="Give --shaper too."
        )
    asked = None if shaper == UNSHAPED_WORD else shaper
    options = replace(
        options_of(
            AUTO if interpolation == DEFAULT_INTERPOLATION else interpolation,
            feed,
            tolerance,
            limits,
            asked,
            feed_forward=feed_forward,
            smoothing=smoothing,
            feed_mode=feed_mode,
            law=law,
            dialect=dialect,
            radius=radius,
            contour=contour,
            robust=robust,
        ),
        shaper_mode=mode,
        shaper_damping=damping,
    )
    kind = kind_of(chosen)
    kind.check_options(chosen, options)
    written_as = target_of(target, chosen)
    if (feed_forward or asked is not None) and not written_as.takes_shaped:
        own = kind.targets
        raise OptionError(
            f"{'feed-forward' if feed_forward else 'a shaper'} gives a reference for every tick, "
            f"and target {target!r} cannot write them",
            remedy=f"Use {' or '.join(name for name in own if own[name].takes_shaped)}.",
        )
    plan = plan_job(open_job(job, chosen, options), chosen, options)
    more = [*plan.intent.warnings, *tolerance_warnings(plan)]
    warn(chosen, plan.job, more, own_feed=options.feed is None)
    with together(out):
        files = write(plan, target, out)
    if json:
        print_json({"files": [_content(file) for file in files]})
    else:
        tell = note if is_stdout(out) else say
        for file in files:
            tell(f"{file.sha256}  {file.path}")
            for fact in file.facts:
                tell(fact)
            for told in file.warnings:
                if told not in plan.intent.warnings:
                    note(told)


def _content(file: Written) -> dict[str, Any]:
    """Return a written file as JSON content."""
    facts = {"facts": list(file.facts)} if file.facts else {}
    return {"file": str(file.path), "sha256": file.sha256, **facts}


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("compile")(compile_)
