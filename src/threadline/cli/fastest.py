"""``threadline fastest``: every interval of feed that stays in spec."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.cli.fastest_cycle import fastest_moves
from threadline.cli.fastest_seam import (
    ABOVE,
    check_mismatch,
    fastest_seam,
    mismatch_json,
    needle_hz,
    show_mismatch,
)
from threadline.cli.fastest_shaft import fastest_design
from threadline.cli.found import (
    command_line,
    limit_words,
    margin_words,
    merged,
    resolution_words,
    typed,
)
from threadline.cli.level import NominalOption, TolerancesOption, level_words, trials_of
from threadline.cli.output import print_json, print_table, progress_bar, say
from threadline.cli.shared_options import (
    DEFAULT_INTERPOLATION_TEXT,
    DEFAULT_TOLERANCE_TEXT,
    ActualOption,
    ContourOption,
    FeedForwardOption,
    InterpolationOption,
    JobArgument,
    JsonOption,
    LawOption,
    MachineOption,
    ParOption,
    SmoothingOption,
    SpecOption,
    ToleranceOption,
    machine_from,
    options_of,
    report_folder,
)
from threadline.cli.warn import tell, warn
from threadline.doubts import tolerance_warnings
from threadline.errors import OptionError
from threadline.jobs import read_job
from threadline.jobs.operations import Feed, FeedMode
from threadline.kinds import kind_of
from threadline.machine import Machine
from threadline.options import Options, parse_feed, parse_margin
from threadline.pipeline import plan_job
from threadline.plan import Following
from threadline.report.mismatch import write_mismatch
from threadline.search import (
    Fastest,
    FastestJob,
    Mismatch,
    fastest_job,
    feed_over_tolerances,
    feed_range_m_s,
)
from threadline.search.gentle import Rung
from threadline.verdict import closing, criteria_json, load_spec, verdict_rows


def fastest(
    job: JobArgument,
    machine: MachineOption,
    spec: SpecOption = None,
    interpolation: InterpolationOption = DEFAULT_INTERPOLATION_TEXT,
    law: LawOption = None,
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
    mismatch: Annotated[
        bool,
        typer.Option(
            "--mismatch",
            help="The same with masses and stiffnesses at the ends of their tolerances, planned "
            "for the machine as its file says.",
        ),
    ] = False,
    nominal: NominalOption = False,
    tolerances: TolerancesOption = False,
    report: Annotated[
        Path | None,
        typer.Option(
            parser=report_folder,
            metavar="<path>",
            help="Folder for the picture of --mismatch (PNG, SVG).",
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
    shaper or switchings of its own, and every wait its length.
    For an embroidery design the speed of the shaft is searched, a constant one and one that is
    different for each stitch. What is tried is proved by twenty runs, as prove does; --nominal by
    one.

    Exit status: 0 when some feed passes, 1 when none does, 2 wrong input.

    Example: threadline fastest examples/x-180.prg -m lathe-winder --interpolation linear

    Of an on/off machine: threadline fastest examples/letter-cycle.toml -m letter-placer
    -o best.toml
    """
    trials = trials_of(nominal, None, tolerances)
    chosen, kept_free = machine_from(machine, par), parse_margin(margin)
    asked = load_spec(spec, chosen).with_margin(kept_free)
    read = read_job(job, chosen)
    options = options_of(
        interpolation,
        None,
        tolerance,
        feed_forward=feed_forward,
        smoothing=smoothing,
        law=law,
        contour=contour,
    )
    kind_of(chosen).check_options(chosen, options)
    if read.paced_by == "switchings":
        given = [low, high, actual, report, None if not mismatch else ""]
        if any(value is not None for value in given):
            raise OptionError(
                "--low, --high, --actual, --mismatch and --report are of feeds, which "
                f"{chosen.name} does not have",
                remedy="Leave them out; its moves and waits are searched.",
            )
        names = {"-m": machine, "-s": spec, "--par": par}
        fastest_moves(job, read, chosen, asked, kept_free, out, names, trials, json)
    if out is not None:
        raise OptionError(
            "--out is of move lists, which have commands and waits to write",
            remedy="Leave it out; the command that proves the answer is printed.",
        )
    if read.paced_by == "shaft":
        if mismatch or report is not None:
            raise OptionError(
                "--mismatch and --report are of feeds and needles of seams",
                remedy="Leave them out; prove --report draws the design.",
            )
        fastest_design(
            job,
            read,
            chosen,
            asked,
            kept_free,
            options,
            None if actual is None else machine_from(actual, par),
            (low, high),
            {"-m": machine, "-s": spec, "--par": par, "--actual": actual, "--law": law},
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
            None if actual is None else machine_from(actual, par),
            (needle_hz(low), needle_hz(high)),
            mismatch,
            report,
            trials,
            json,
        )
    check_mismatch(mismatch, actual is not None, report)
    other = None if actual is None else machine_from(actual, par)
    lowest = None if low is None else _metres_per_second(low)
    highest = None if high is None else _metres_per_second(high)
    warn(chosen, read)
    with progress_bar(not json) as progress:
        result = fastest_job(
            read,
            chosen,
            asked,
            options,
            low=lowest,
            high=highest,
            progress=progress,
            actual=other,
            trials=trials,
        )
        best = result.best
        cells: list[Mismatch] = []
        if mismatch:
            cells = feed_over_tolerances(
                read,
                chosen,
                asked,
                replace(options, limit_share=best.share),
                low=lowest,
                high=_end_of_mismatch(best, highest, chosen),
                progress=progress,
            )
        title = f"{read.name} on {chosen.name}{margin_words(kept_free)}"
        drawn = None if report is None else write_mismatch(cells, title, report, "mm/s", 1e3)
    if best.found.best is not None or options.following is Following.MOTOR:
        tell(tolerance_warnings(plan_job(read, chosen, _at(options, best))))
    again = (
        None
        if best.found.best is None
        else command_line(
            "prove",
            job,
            {
                "-m": machine,
                "-s": spec,
                "--par": par,
                "--interpolation": interpolation,
                "--tolerance": None if tolerance == DEFAULT_TOLERANCE_TEXT else tolerance,
                "--feed": f"{best.found.best!r} m/s",
                "--limits": None if best.share == 1.0 else f"{best.share * 100.0!r} %",
                "--feed-forward": "" if feed_forward else None,
                "--smoothing": smoothing,
                "--contour": contour,
                "--actual": actual,
                level_words(trials): "" if level_words(trials) else None,
            },
        )
    )
    if json:
        told = {"report": str(drawn)} if drawn is not None else {}
        print_json(
            _content(result) | {"margin": kept_free, "command": again} | mismatch_json(cells) | told
        )
    else:
        how = f"{interpolation}, feed-forward" if feed_forward else interpolation
        _show(result, f"{read.name} on {chosen.name}, {how}{margin_words(kept_free)}")
        if again is not None:
            say(f"To prove it: {again}")
        if cells:
            show_mismatch(cells, title, "mm/s", 1e3)
        if drawn is not None:
            say(f"Report: {drawn}")
    raise typer.Exit(0 if result.best.found.best is not None else 1)


def _end_of_mismatch(best: Rung, highest: float | None, machine: Machine) -> float:
    """Return the highest speed that is tried over tolerances: a little above the nominal best."""
    if highest is not None:
        return highest
    if best.found.best is None:
        return feed_range_m_s(machine)[1]
    return best.found.best * ABOVE


def _at(options: Options, best: Rung) -> Options:
    """Return the options of the fastest plan; those of the search where no feed is in spec."""
    if best.found.best is None:
        return options
    feed = Feed(FeedMode.FASTEST_AXIS, best.found.best)
    return replace(options, feed=feed, limit_share=best.share)


def _content(result: FastestJob) -> dict[str, Any]:
    found = result.best.found
    return {
        "best": found.best,
        "unit": "m/s",
        "intervals": [[i.low, i.high] for i in found.intervals],
        "limited_by": found.limited_by,
        "limits": result.best.share,
        "duration_s": result.best.duration_s,
        "step": found.step,
        "step_at_edges": found.near_step,
        "tried": sum(rung.found.tried for rung in result.rungs),
        "verdict": _verdict_content(found),
        "rungs": [
            {
                "limits": rung.share,
                "duration_s": rung.duration_s,
                "intervals": [[i.low, i.high] for i in rung.found.intervals],
                "limited_by": rung.found.limited_by,
            }
            for rung in result.rungs
        ],
    }


def _show(result: FastestJob, title: str) -> None:
    rows = []
    for rung in result.rungs:
        for interval in rung.found.intervals:
            first = interval is rung.found.intervals[0]
            rows.append(
                [
                    f"{rung.share:.1%}",
                    typed(interval.low * 1e3),
                    typed(interval.high * 1e3),
                    f"{rung.duration_s:.3f}" if first and rung.duration_s else "",
                    limit_words(rung.found.limited_by) if first else "",
                ]
            )
    header = ["limits used", "from mm/s", "to mm/s", "job s", "limited by"]
    print_table(f"{title}: feeds in spec", header, merged(rows))
    best = result.best
    tried = sum(rung.found.tried for rung in result.rungs)
    head, body = verdict_rows(best.found.verdict)
    if best.found.best is None:
        say(f"no feed is in spec ({tried} tried): {best.found.limited_by} fails at all")
        print_table("verdict where the search came closest", head, body)
        return
    say(
        f"fastest: {best.duration_s:.3f} s at {typed(best.found.best * 1e3)} mm/s with "
        f"{best.share:.1%} of the limits, limited by {limit_words(best.found.limited_by)}; "
        f"{tried} plans tried"
    )
    say(f"feeds {resolution_words(best.found)}")
    print_table("verdict at the fastest", head, body)
    say(closing(best.found.verdict))


def _verdict_content(found: Fastest) -> dict[str, Any]:
    return {
        "passed": found.verdict.passed,
        "level": found.verdict.level.value,
        "criteria": criteria_json(found.verdict),
    }


def _metres_per_second(text: str) -> float:
    feed = parse_feed(text)
    if feed.mode != "fastest-axis":
        raise OptionError(f"{text!r}: the search runs in mm/s", remedy='Write it like "36 mm/s".')
    return feed.value


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("fastest")(fastest)
