"""``threadline fastest``: every interval of feed that stays in spec."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.cli.fastest_by_feed import fastest_by_feed
from threadline.cli.fastest_cycle import fastest_moves
from threadline.cli.fastest_optimal import fastest_optimal
from threadline.cli.fastest_seam import fastest_seam, needle_hz
from threadline.cli.fastest_shaft import fastest_design
from threadline.cli.level import NominalOption, TolerancesOption, YieldOption, trials_of
from threadline.cli.shared_options import (
    DEFAULT_INTERPOLATION_TEXT,
    DEFAULT_TOLERANCE_TEXT,
    ActualOption,
    ContourOption,
    DialectOption,
    FeedForwardOption,
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
    machine_from,
    options_of,
    report_folder,
)
from threadline.errors import OptionError
from threadline.machine.radii import with_radii
from threadline.option_words import parse_margin, parse_number
from threadline.path.interpolations import OPTIMAL
from threadline.pipeline import open_job
from threadline.verdict import load_spec


def fastest(
    job: JobArgument,
    machine: MachineOption,
    spec: SpecOption = None,
    interpolation: InterpolationOption = DEFAULT_INTERPOLATION_TEXT,
    law: LawOption = None,
    dialect: DialectOption = None,
    radius: RadiusOption = None,
    tolerance: ToleranceOption = DEFAULT_TOLERANCE_TEXT,
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
            help='Of a part program: how long the search may take, "5 min"; then the best so far '
            "is told. Ctrl-C asks for it at once."
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            parser=report_folder,
            metavar="<path>",
            help="Folder for the picture of --mismatch (PNG, SVG); of a move list without it for "
            "the report of the cycle that was found.",
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
    hold wherever the modes are within 20 % of their frequency.
    For an embroidery design the speed of the shaft is searched, a constant one and one that is
    different for each stitch. Every trial is proved by twenty runs, as by threadline prove, or with
    --nominal by one. With --interpolation optimal no feed is searched: a few plans are proved, and
    the answer tells how much slower the fastest is than the limits of axes and drives alone allow.

    Exit status: 0 when some feed passes, 1 when none does, 2 wrong input.

    Example: threadline fastest examples/x-180.prg -m lathe-winder --interpolation linear

    Of an on/off machine: threadline fastest examples/letter-cycle.toml -m letter-placer
    -o best.toml
    """
    trials = trials_of(nominal, None, tolerances, wished)
    chosen, kept_free = with_radii(machine_from(machine, par), radius), parse_margin(margin)
    asked = load_spec(spec, chosen).with_margin(kept_free)
    options = options_of(
        interpolation,
        None,
        tolerance,
        feed_forward=feed_forward,
        smoothing=smoothing,
        law=law,
        dialect=dialect,
        radius=radius,
        contour=contour,
    )
    within_s = None if within is None else parse_number("--within", within, "s", "5 min")
    if within_s is not None and not within_s > 0.0:
        raise OptionError(f"--within {within!r} must be greater than 0")
    read = open_job(job, chosen, options)
    if read.paced_by != "feed":
        _refuse_within(within)
    other = None if actual is None else machine_from(actual, par)
    names: dict[str, str | Path | None] = {
        "-m": machine,
        "-s": spec,
        "--par": par,
        "--actual": actual,
    }
    if read.paced_by == "switchings":
        if low is not None or high is not None:
            raise OptionError(
                f"--low and --high are of feeds, which {chosen.name} does not have",
                remedy="Leave them out; its moves and waits are searched.",
            )
        fastest_moves(
            job, read, chosen, asked, kept_free, out, names, other, mismatch, report, trials,
            band, json,
        )  # fmt: skip
    if out is not None or band is not None:
        raise OptionError(
            f"{'--band' if out is None else '--out'} is for move lists alone, which have "
            "commands and waits to search and to write",
            remedy="Leave it out; the command that proves the answer is printed.",
        )
    if read.paced_by == "shaft":
        fastest_design(
            job,
            read,
            chosen,
            asked,
            kept_free,
            options,
            other,
            (low, high),
            {**names, "--law": law},
            mismatch,
            report,
            trials,
            json,
        )
    if read.paced_by == "needle":
        fastest_seam(
            job,
            read,
            chosen,
            asked,
            kept_free,
            options,
            other,
            (needle_hz(low), needle_hz(high)),
            mismatch,
            report,
            trials,
            json,
        )
    words: dict[str, str | Path | None] = {
        **names,
        "--interpolation": None if law is not None else interpolation,
        "--law": law,
        "--dialect": dialect,
        "--radius": radius,
        "--tolerance": None if tolerance == DEFAULT_TOLERANCE_TEXT else tolerance,
        "--feed-forward": "" if feed_forward else None,
        "--smoothing": smoothing,
        "--contour": contour,
    }
    if options.interpolation != OPTIMAL:
        fastest_by_feed(
            job, read, chosen, asked, kept_free, options, other, (low, high), mismatch, report,
            words, trials, within_s, json,
        )  # fmt: skip
    _refuse_within(within)
    fastest_optimal(
        job,
        read,
        chosen,
        asked,
        kept_free,
        options,
        other,
        (low, high),
        mismatch,
        report,
        words,
        trials,
        json,
    )


def _refuse_within(within: str | None) -> None:
    if within is not None:
        raise OptionError(
            f"--within {within!r} is of searches for a feed",
            remedy="Leave it out; this search takes a few plans.",
        )


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("fastest")(fastest)
