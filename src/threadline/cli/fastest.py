"""``threadline fastest``: every interval of feed that stays in spec."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from threadline.cli import option_parameters
from threadline.cli.arguments import JobArgument, JsonOption, MachineOption, named_folder
from threadline.cli.fastest_cycle import CycleOutput, write_move_list
from threadline.cli.fastest_optimal import OptimalOutput
from threadline.cli.fastest_output import FeedOutput, NeedleOutput, SearchOutput, ShaftOutput
from threadline.cli.output import check_outputs, print_json, progress_bar, tell, warn
from threadline.cli.search_text import as_typed, command_line
from threadline.commands.write import TICK_TARGETS
from threadline.motion.path.interpolations import FIRMWARE, OPTIMAL
from threadline.proof.request import Words, level_option
from threadline.search.by_pace import answered
from threadline.search.deadline import Deadline
from threadline.search.question import question_of, refuse_others, searched_as


def fastest(
    job: JobArgument,
    machine: MachineOption,
    words: Words,
    report: Annotated[
        Path | None,
        typer.Option(
            parser=named_folder,
            metavar="<path>",
            help="Folder for the report on the fastest plan; with --mismatch, for the picture of "
            "that search (PNG, SVG).",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "--output",
            "-o",
            help="Write the move list of the shortest cycle to this file (on/off machines).",
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Find every interval of feed in which JOB stays in spec on the machine, the highest first.

    If a program has several F, their ratios are kept and the feed override is searched, in percent.
    For a seam the needle speed is searched, in stitch/s; for an embroidery design the shaft speed,
    constant and stitch by stitch. For an on/off machine the shortest cycle is searched: each move
    gets its own shaper or switching times, and each wait its length.

    Every trial is proved by twenty runs, as threadline prove does, or by one run with --nominal. If
    a result is close to a limit, the search also looks for a run that fails, and with --tolerances
    for a machine that fails. With --margin "20 %" a fifth of every limit is kept free. With
    --robust "100 %" one plan must pass on every machine at the ends of the tolerances. With
    --learned 5 the table that five repeats have learned is judged in place of the plan. With --band
    "20 %" the commands of an on/off machine must pass for all modes within 20 % of their frequency.
    With --interpolation optimal no feed is searched; the search chooses the options that are not
    given: tolerance, distance outside corners, reserve, smoothing, contour, feed-forward. The
    duration of the fastest plan in spec is compared with the least times within the limits of axes
    and drives alone.

    Exit status: 0 if a feed passes, 1 if none does, 2 for wrong input.

    Example: threadline fastest examples/x-180.prg -m lathe-winder --interpolation linear

    On/off machine: threadline fastest examples/letter-cycle.toml -m letter-placer -o best.toml
    """
    question = question_of(words, job, machine)
    refuse_others(question.job, question.options, {"--out": out})
    check_outputs(file=out, folder=report)
    output_class = OUTPUTS[searched_as(question.job, question.options)]
    warn(question.machine, question.job, own_feed=False)
    with progress_bar(not json) as progress:
        found = answered(replace(question, until=question.until or Deadline(), progress=progress))
        output = output_class(found, f"{question.job.name} on {question.machine.name}")
    tell(output.warnings())
    page = None if report is None else output.report(report)
    written = None if out is None else write_move_list(found, out)
    command = None
    if written is not None or found.again is not None:
        typed = words.typed(robust=question.words.get("robust")) | {"--interpolation": None}
        if output.on_ticks and words.text("law") is None:
            typed["--interpolation"] = question.options.interpolation
        best_words = as_typed(found.words or {}) if written is None else {}
        options = {"-m": machine, **typed, **best_words, **level_option(question.trials)}
        if question.learned is None:
            command = command_line("prove", written or job, options)
            dialect = question.machine.programs.dialect
            if question.options.interpolation == FIRMWARE and dialect in TICK_TARGETS:
                output_options = {"--target": dialect, "-o": f"faster-{job.name}"}
                compile_options = {
                    "-m": machine,
                    **typed,
                    "--interpolation": None,
                    **best_words,
                    **output_options,
                }
                output.faster = command_line("compile", job, compile_options)
                output.as_found = command_line(
                    "compile", job, compile_options | {"--interpolation": FIRMWARE}
                )
        else:
            options["--repeats"] = str(question.learned)
            command = command_line("learn", job, options)
    if json:
        extra = {"command": command} | ({} if page is None else {"report": str(page)})
        print_json(output.content() | extra)
    else:
        output.show(command, page)
    raise typer.Exit(0 if found.passed else 1)


OUTPUTS: Mapping[str, type[SearchOutput]] = {
    "feed": FeedOutput,
    OPTIMAL: OptimalOutput,
    "needle": NeedleOutput,
    "shaft": ShaftOutput,
    "switchings": CycleOutput,
}
"""Output class of each kind of search; the keys are the results of ``searched_as``."""


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "fastest", fastest)
