"""``threadline fastest``: every interval of feed that stays in spec."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from threadline.cli import option_parameters
from threadline.cli.arguments import JobArgument, JsonOption, MachineOption, named_folder
from threadline.cli.fastest_cycle import CycleTold, write_move_list
from threadline.cli.fastest_told import FeedTold, NeedleTold, OptimalTold, ShaftTold, Told
from threadline.cli.found import as_typed, command_line
from threadline.cli.output import check_outputs, print_json, progress_bar
from threadline.cli.warn import tell, warn
from threadline.motion.path.interpolations import OPTIMAL
from threadline.proof.asked import Words, level_option
from threadline.search.by_pace import answered
from threadline.search.question import question_of, refuse_others, searched_as
from threadline.search.until import Until


def fastest(
    job: JobArgument,
    machine: MachineOption,
    words: Words,
    report: Annotated[
        Path | None,
        typer.Option(
            parser=named_folder,
            metavar="<path>",
            help="Folder for the report of the fastest, or with --mismatch for its picture "
            "(PNG, SVG).",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "--output",
            "-o",
            help="Of an on/off machine: write the move list of the shortest cycle to this file.",
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Find every interval of feed at which JOB stays in spec on the machine, the highest first.

    A program with several F keeps their ratios: the feed override in percent is searched. For a
    seam the needle speed is searched, in stitch/s. With --margin "20 %" a fifth of every
    limit is kept free. For an on/off machine the shortest cycle is searched: every move gets a
    shaper or switchings of its own, and every wait its length; with --band "20 %" the commands
    hold wherever the modes are within 20 % of their frequency. With --robust "100 %" one plan
    is to hold on every machine at the ends of the tolerances.
    For an embroidery design the speed of the shaft is searched, a constant one and one that is
    different for each stitch. Every trial is proved by twenty runs, as by threadline prove, or with
    --nominal by one. With --interpolation optimal no feed is searched: a few plans are proved, and
    the answer tells how much slower the fastest is than the limits of axes and drives alone allow.

    Exit status: 0 when some feed passes, 1 when none does, 2 wrong input.

    Example: threadline fastest examples/x-180.prg -m lathe-winder --interpolation linear

    Of an on/off machine: threadline fastest examples/letter-cycle.toml -m letter-placer
    -o best.toml
    """
    asked = question_of(words, job, machine)
    refuse_others(asked.job, asked.options, {"--out": out})
    check_outputs(file=out, folder=report)
    telling = TOLD[searched_as(asked.job, asked.options)]
    warn(asked.machine, asked.job, own_feed=False)
    with progress_bar(not json) as progress:
        found = answered(replace(asked, until=asked.until or Until(), progress=progress))
        told = telling(found, f"{asked.job.name} on {asked.machine.name}")
    tell(told.warnings())
    page = None if report is None else told.report(report)
    written = None if out is None else write_move_list(found, out)
    again = None
    if written is not None or found.again is not None:
        typed = words.typed(robust=asked.words.get("robust")) | {"--interpolation": None}
        if told.on_ticks and words.text("law") is None:
            typed["--interpolation"] = asked.options.interpolation
        best = as_typed(found.words or {}) if written is None else {}
        options = {"-m": machine, **typed, **best, **level_option(asked.trials)}
        again = command_line("prove", written or job, options)
    if json:
        said = {"command": again} | ({} if page is None else {"report": str(page)})
        print_json(told.content() | said)
    else:
        told.show(again, page)
    raise typer.Exit(0 if found.passed else 1)


TOLD: Mapping[str, type[Told]] = {
    "feed": FeedTold,
    OPTIMAL: OptimalTold,
    "needle": NeedleTold,
    "shaft": ShaftTold,
    "switchings": CycleTold,
}
"""By ``searched_as``, as ``search.by_pace`` has the searches: how they are told."""


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "fastest", fastest)
