"""``threadline fastest`` on a part program: every interval of feed in spec."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, NoReturn

import typer

from threadline.cli.controller_settings import settings_words
from threadline.cli.found import (
    alone_words,
    command_line,
    limit_words,
    margin_words,
    merged,
    resolution_words,
    typed,
)
from threadline.cli.level import level_option
from threadline.cli.mismatch import ABOVE, check_mismatch, mismatch_json, show_mismatch
from threadline.cli.output import print_json, print_table, progress_bar, say
from threadline.cli.warn import tell, warn
from threadline.doubts import tolerance_warnings
from threadline.errors import OptionError
from threadline.jobs import Job
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import Machine
from threadline.option_words import parse_feed
from threadline.options import Options
from threadline.pipeline import Trials, plan_job
from threadline.plan import Following
from threadline.report.mismatch import write_mismatch
from threadline.search import (
    Fastest,
    FastestJob,
    Mismatch,
    Rung,
    fastest_job,
    feed_over_tolerances,
    feed_range_m_s,
)
from threadline.search.mismatch import FEED
from threadline.search.until import Until
from threadline.verdict import Spec, closing, criteria_json, verdict_rows


def fastest_by_feed(
    job: Path,
    read: Job,
    machine: Machine,
    spec: Spec,
    margin: float,
    options: Options,
    actual: Machine | None,
    span: tuple[str | None, str | None],
    mismatch: bool,
    report: Path | None,
    asked: dict[str, str | Path | None],
    trials: Trials,
    within_s: float | None,
    json: bool,
) -> NoReturn:
    """Search the feed and the share of the limits, print the result, and end the program.

    Parameters
    ----------
    span
        Texts of the lowest and the highest feed to try.
    asked
        Options of the command that proves the answer, but for those that were found.
    within_s
        How long the search may take; None is as long as it takes.
    """
    check_mismatch(mismatch, actual is not None, report)
    low, high = (None if text is None else metres_per_second(text) for text in span)
    warn(machine, read)
    with progress_bar(not json) as progress:
        result = fastest_job(
            read,
            machine,
            spec,
            options,
            low=low,
            high=high,
            progress=progress,
            actual=actual,
            trials=trials,
            until=Until.within(within_s),
        )
        best = result.best
        cells: list[Mismatch] = []
        if mismatch:
            cells = feed_over_tolerances(
                read,
                machine,
                spec,
                replace(options, limit_share=best.share),
                low=low,
                high=_end_of_mismatch(best, high, machine),
                progress=progress,
            )
        title = f"{read.name} on {machine.name}{margin_words(margin)}"
        drawn = None if report is None else write_mismatch(cells, title, FEED, report)
    if best.found.best is not None or options.following is Following.MOTOR:
        tell(tolerance_warnings(plan_job(read, machine, _at(options, best))))
    again = None if best.found.best is None else _command(best, job, asked, trials)
    if json:
        said = {"margin": margin, "command": again}
        print_json(_content(result) | said | mismatch_json(cells, drawn))
    else:
        ahead = ", feed-forward" if options.following is Following.LOAD else ""
        how = f"{options.interpolation}{ahead}"
        _show(result, f"{read.name} on {machine.name}, {how}{margin_words(margin)}")
        for line in settings_words(machine, best, limits=len(result.rungs) > 1):
            say(line)
        if again is not None:
            say(f"To prove it: {again}")
        if cells:
            show_mismatch(cells, title, FEED)
        if drawn is not None:
            say(f"Report: {drawn}")
    raise typer.Exit(0 if best.found.best is not None else 1)


def _command(best: Rung, job: Path, asked: dict[str, str | Path | None], trials: Trials) -> str:
    return command_line(
        "prove",
        job,
        asked
        | {
            "--feed": f"{best.found.best!r} m/s",
            "--limits": None if best.share == 1.0 else f"{best.share * 100.0!r} %",
            **level_option(trials),
        },
    )


def metres_per_second(text: str) -> float:
    """Return a feed in m/s of the fastest axis, as ``--low`` and ``--high`` give one.

    Raises
    ------
    OptionError
        If the feed is in another unit than a speed.
    """
    feed = parse_feed(text)
    if feed.mode != "fastest-axis":
        raise OptionError(f"{text!r}: the search runs in mm/s", remedy='Write it like "36 mm/s".')
    return feed.value


def _end_of_mismatch(best: Rung, highest: float | None, machine: Machine) -> float:
    """Return the highest speed that is tried over tolerances: a little above the nominal best."""
    if highest is not None:
        return highest
    if best.found.best is None:
        return feed_range_m_s(machine)[1]
    return best.found.best * ABOVE


def _at(options: Options, best: Rung) -> Options:
    """Return ``options`` with the feed and the limits of ``best``.

    Where no feed is in spec they are returned unchanged.
    """
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
        "alone": list(found.alone),
        "limited_by": found.limited_by,
        "limits": result.best.share,
        "duration_s": result.best.duration_s,
        "step": found.step,
        "step_at_edges": found.near_step,
        "tried": sum(rung.found.tried for rung in result.rungs),
        "moves": result.moves,
        "judged_moves": result.judged_moves,
        "parts": result.parts,
        "whole_job_judged": result.whole,
        "ended": result.ended,
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
            first = interval is rung.found.fastest
            rows.append(
                [
                    f"{rung.share:.1%}",
                    typed(interval.low * 1e3),
                    "alone" if interval.alone else typed(interval.high * 1e3),
                    f"{rung.duration_s:.3f}" if first and rung.duration_s else "",
                    limit_words(rung.found.limited_by) if first else "",
                ]
            )
    header = ["acceleration limits used", "from mm/s", "to mm/s", "job s", "limited by"]
    print_table(f"{title}: feeds in spec", header, merged(rows))
    best = result.best
    tried = sum(rung.found.tried for rung in result.rungs)
    head, body = verdict_rows(best.found.verdict)
    for line in _how_judged(result):
        say(line)
    if best.found.best is None:
        say(f"no feed is in spec ({tried} tried): {best.found.limited_by} fails at all")
        print_table("verdict where the search came closest", head, body)
        return
    say(
        f"fastest: {best.duration_s:.3f} s at {typed(best.found.best * 1e3)} mm/s with "
        f"{best.share:.1%} of the acceleration and jerk limits, limited by "
        f"{limit_words(best.found.limited_by)}; "
        f"{tried} plans tried"
    )
    say(f"feeds {resolution_words(best.found)}")
    if best.found.alone:
        say(alone_words(best.found, "mm/s", 1e3))
    print_table("verdict at the fastest", head, body)
    say(closing(best.found.verdict))


def _how_judged(result: FastestJob) -> Iterator[str]:
    """Yield lines on what the answer does not say of itself."""
    if result.parts:
        parts = "one stretch" if result.parts == 1 else f"{result.parts} stretches"
        yield (
            f"judged by {result.judged_moves} of {result.moves} moves, {parts}: the others repeat "
            "them"
        )
        if not result.whole:
            yield "the whole job was not judged: prove it by the command below"
    if result.ended:
        yield f"{result.ended}: this is the best of what was tried so far"


def _verdict_content(found: Fastest) -> dict[str, Any]:
    return {
        "passed": found.verdict.passed,
        "level": found.verdict.level.value,
        "criteria": criteria_json(found.verdict),
    }
