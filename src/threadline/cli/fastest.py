"""``threadline fastest``: every interval of feed that stays in spec."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from threadline.cli import option_parameters
from threadline.cli.arguments import JobArgument, JsonOption, MachineOption, named_folder
from threadline.cli.fastest_asked import Asked
from threadline.cli.fastest_by_feed import fastest_by_feed
from threadline.cli.fastest_cycle import fastest_moves
from threadline.cli.fastest_optimal import fastest_optimal
from threadline.cli.fastest_seam import fastest_design, fastest_seam
from threadline.errors import OptionError
from threadline.jobs.operations import Pace
from threadline.motion.path.interpolations import OPTIMAL
from threadline.proof.asked import Words
from threadline.search.by_pace import Question, refuse_for_pace
from threadline.search.until import Until
from threadline.units import parse_number


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
    question = Question.of(words, job, machine)
    refuse_for_pace(question.job, {"--out": out})
    law = words.text("law")
    typed = words.typed(robust=question.words.get("robust"))
    asked = Asked(
        question=question,
        words={
            "-m": machine,
            **typed,
            "--interpolation": None if law is not None else question.options.interpolation,
        },
        low=words.text("low"),
        high=words.text("high"),
        until=Until.within(_seconds(words.text("within"))),
        band=words.text("band"),
        out=out,
        mismatch=words.flag("mismatch"),
        report=report,
        json=json,
    )
    with asked.until.with_answer():
        ANSWERS[question.job.paced_by](asked)


def _seconds(within: str | None) -> float | None:
    if within is None:
        return None
    within_s = parse_number("--within", within, "s", "5 min")
    if not within_s > 0.0:
        raise OptionError(
            f"--within {within!r} must be greater than 0",
            remedy="Give how long the search may take, like '5 min', or leave it out.",
        )
    return within_s


def _by_feed(asked: Asked) -> NoReturn:
    """Tell the fastest of a job with feeds, or of one whose timing is planned as a whole."""
    if asked.options.interpolation == OPTIMAL:
        fastest_optimal(asked)
    fastest_by_feed(asked)


ANSWERS: Mapping[Pace, Callable[[Asked], NoReturn]] = {
    "feed": _by_feed,
    "needle": fastest_seam,
    "shaft": fastest_design,
    "switchings": fastest_moves,
}
"""By pace, as ``search.by_pace`` has the searches: how they are told."""


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "fastest", fastest)
