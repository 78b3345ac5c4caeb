"""``threadline fastest``: every interval of feed that stays in spec."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from threadline.cli.chosen import machine_from, options_of
from threadline.cli.fastest_asked import Asked
from threadline.cli.fastest_by_feed import fastest_by_feed
from threadline.cli.fastest_cycle import fastest_moves
from threadline.cli.fastest_optimal import fastest_optimal
from threadline.cli.fastest_seam import fastest_seam
from threadline.cli.fastest_shaft import fastest_design
from threadline.cli.level import NominalOption, TolerancesOption, YieldOption, trials_of
from threadline.cli.shared_options import (
    ActualOption,
    ContourOption,
    DialectOption,
    FeedForwardOption,
    FeedModeOption,
    InterpolationOption,
    JobArgument,
    JsonOption,
    LawOption,
    MachineOption,
    ParOption,
    RadiusOption,
    SmoothingOption,
    SpecOption,
    ToleranceOption,
    named_folder,
)
from threadline.errors import OptionError
from threadline.jobs.operations import Pace
from threadline.machine.radii import with_radii
from threadline.option_defaults import DEFAULT_INTERPOLATION, DEFAULT_TOLERANCE
from threadline.option_words import parse_margin
from threadline.options import robust_plan
from threadline.path.interpolations import OPTIMAL
from threadline.pipeline import open_job
from threadline.search.until import Until
from threadline.typed_number import parse_number
from threadline.verdict import load_spec


def fastest(
    job: JobArgument,
    machine: MachineOption,
    spec: SpecOption = None,
    interpolation: InterpolationOption = DEFAULT_INTERPOLATION,
    law: LawOption = None,
    dialect: DialectOption = None,
    feed_mode: FeedModeOption = None,
    radius: RadiusOption = None,
    tolerance: ToleranceOption = DEFAULT_TOLERANCE,
    contour: ContourOption = None,
    feed_forward: FeedForwardOption = False,
    smoothing: SmoothingOption = None,
    par: ParOption = None,
    actual: ActualOption = None,
    low: Annotated[
        str | None, typer.Option(help='Lowest feed to try; of a seam "5 stitch/s".')
    ] = None,
    high: Annotated[str | None, typer.Option(help="Highest feed to try.")] = None,
    margin: Annotated[
        str,
        typer.Option(
            help='Share of every limit of the specification to keep free: "20 %"; the machine\'s '
            "own limits stay."
        ),
    ] = "0 %",
    band: Annotated[
        str | None,
        typer.Option(
            help="Of an on/off machine: the shortest cycle that is in spec with every mode within "
            'this share of its frequency: "20 %".',
        ),
    ] = None,
    robust: Annotated[
        str | None,
        typer.Option(
            help="One plan for all machines with loads and springs at the ends of this share of "
            'their tolerances, each judged in one run: "100 %"; and what that costs. With '
            "--feed-forward it is planned for all of them.",
        ),
    ] = None,
    mismatch: Annotated[
        bool,
        typer.Option(
            "--mismatch",
            help="Search again with masses and stiffnesses at the ends of their tolerances, "
            "planned for the machine as its file says.",
        ),
    ] = False,
    nominal: NominalOption = False,
    tolerances: TolerancesOption = False,
    wished: YieldOption = None,
    within: Annotated[
        str | None,
        typer.Option(
            help='How long the search may take, "5 min"; then the best so far is told. Ctrl-C '
            "asks for it at once."
        ),
    ] = None,
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

    For a seam the needle speed is searched, in stitch/s. With --margin "20 %" a fifth of every
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
    trials = trials_of(nominal, None, tolerances, wished, robust)
    planned = robust_plan(robust, interpolation, feed_forward)
    chosen, kept_free = with_radii(machine_from(machine, par), radius), parse_margin(margin)
    options = options_of(
        interpolation,
        None,
        tolerance,
        feed_forward=feed_forward,
        smoothing=smoothing,
        law=law,
        dialect=dialect,
        feed_mode=feed_mode,
        radius=radius,
        contour=contour,
        robust=planned,
    ).on(chosen)
    read = open_job(job, chosen, options)
    asked = Asked(
        file=job,
        job=read,
        machine=chosen,
        actual=None if actual is None else machine_from(actual, par),
        spec=load_spec(spec, chosen).with_margin(kept_free),
        margin=kept_free,
        options=options,
        words={
            "-m": machine,
            "-s": spec,
            "--par": par,
            "--actual": actual,
            "--interpolation": None if law is not None else options.interpolation,
            "--law": law,
            "--dialect": dialect,
            "--feed-mode": feed_mode,
            "--radius": radius,
            "--tolerance": None if tolerance == DEFAULT_TOLERANCE else tolerance,
            "--feed-forward": "" if feed_forward else None,
            "--smoothing": smoothing,
            "--contour": contour,
            "--robust": planned,
        },
        low=low,
        high=high,
        until=Until.within(_seconds(within)),
        band=band,
        out=out,
        mismatch=mismatch,
        report=report,
        trials=trials,
        json=json,
    )
    answer = ANSWERS[read.paced_by]
    given = {"--low": low, "--high": high, "--band": band, "--out": out, "--robust": robust}
    for name, value in given.items():
        if value is not None and name not in answer.takes:
            raise OptionError(
                f"{name} {str(value)!r} does not apply to {read.name}, of which "
                f"{answer.searched} searched",
                remedy=f"Leave it out{_INSTEAD.get(name, '')}.",
            )
    with asked.until.with_answer():
        answer.tell(asked)


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


@dataclass(frozen=True, slots=True)
class _Answer:
    """How ``threadline fastest`` answers for jobs of one pace.

    Parameters
    ----------
    tell
        Searches, prints what was found, and ends the program.
    searched
        What is searched, with its verb, for a message.
    takes
        Which of the options that not every search has it takes.
    """

    tell: Callable[[Asked], NoReturn]
    searched: str
    takes: frozenset[str]


_SPAN = frozenset({"--low", "--high", "--robust"})
ANSWERS: Mapping[Pace, _Answer] = {
    "feed": _Answer(_by_feed, "the feed is", _SPAN),
    "needle": _Answer(fastest_seam, "the speed of the needle is", _SPAN),
    "shaft": _Answer(fastest_design, "the speed of the shaft is", _SPAN),
    "switchings": _Answer(fastest_moves, "commands and waits are", frozenset({"--band", "--out"})),
}
"""By pace, as ``search.by_pace`` has the searches: how they are told."""
_INSTEAD = {
    "--robust": "; --band finds commands for every mode within a share of its frequency",
    "--band": "; prove --tolerances judges other machines",
    "--out": "; the command that proves the answer is printed",
}
"""What there is instead of an option that not every search has."""


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("fastest")(fastest)
