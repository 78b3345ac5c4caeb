"""``threadline fastest`` on a part program: every interval of feed in spec."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, NoReturn

import typer

from threadline.cli.fastest_asked import (
    ABOVE,
    Asked,
    certainty_of,
    check_mismatch,
    drawn_of,
    mismatch_json,
    report_of,
    show_mismatch,
)
from threadline.cli.found import (
    AXES_ALONE,
    END,
    alone_words,
    as_typed,
    command_line,
    forbidden_words,
    limit_words,
    margin_words,
    merged,
    resolution_words,
    settings_words,
    typed,
    until_words,
)
from threadline.cli.output import print_json, print_table, progress_bar, say
from threadline.cli.warn import tell, warn
from threadline.commands.plan import Following
from threadline.errors import OptionError
from threadline.jobs import Job
from threadline.jobs.gcode.feeds import as_f_words
from threadline.jobs.operations import Feed, FeedMode
from threadline.machine import Machine
from threadline.proof.asked import level_option
from threadline.proof.option_words import parse_feed, share_words
from threadline.proof.options import Options
from threadline.proof.pipeline import plan_job
from threadline.proof.recorded import tolerance_warnings
from threadline.search import Fastest, FastestJob, Mismatch, fastest_job, feed_over_tolerances
from threadline.search.by_pace import job_words
from threadline.search.feed import search_range, searched_by
from threadline.search.forbidden import joined
from threadline.search.mismatch import F_WORDS, FEED, OVERRIDE
from threadline.verdict import closing, criteria_json, verdict_rows

_UNITS = {
    FeedMode.FASTEST_AXIS: ("mm/s", 1e3),
    FeedMode.F_WORD: ("F", 60_000.0),
    FeedMode.OVERRIDE: ("%", 100.0),
}
"""By what a search varies: how its feeds are printed, and what one in m/s is multiplied by."""


def fastest_by_feed(asked: Asked) -> NoReturn:
    """Search the feed and the share of the limits, print the result, and end the program."""
    read, machine, options = asked.job, asked.machine, asked.options
    check_mismatch(asked.mismatch, asked.actual is not None, asked.report)
    by, low, high = _span(read, machine, asked.low, asked.high)
    warn(machine, read, own_feed=False)
    with progress_bar(not asked.json) as progress:
        result = fastest_job(
            read,
            machine,
            asked.spec,
            options,
            low=low,
            high=high,
            progress=progress,
            actual=asked.actual,
            trials=asked.trials,
            until=asked.until,
            by=by,
        )
        best = result.best
        sure = certainty_of(
            asked,
            best_of(result),
            "" if by is FeedMode.OVERRIDE else "m/s",
            lambda chosen, trials: best_of(
                fastest_job(
                    read,
                    machine,
                    asked.spec,
                    chosen,
                    low=low,
                    high=high,
                    progress=progress,
                    actual=asked.actual,
                    trials=trials,
                    until=asked.until,
                    by=by,
                )
            ),
        )
        cells: list[Mismatch] = []
        if asked.mismatch:
            cells = feed_over_tolerances(
                read,
                machine,
                asked.spec,
                replace(options, limit_share=best.share),
                low=low,
                high=_end_of_mismatch(result, high, read, machine),
                progress=progress,
                by=by,
            )
    free = margin_words(asked.margin)
    found = best.found.best is not None
    if found or options.following is Following.MOTOR:
        plan = plan_job(read, machine, _at(options, result))
        tell(tolerance_warnings(plan))
    searched = {FeedMode.F_WORD: F_WORDS, FeedMode.OVERRIDE: OVERRIDE}.get(by, FEED)
    drawn = drawn_of(cells, f"{asked.title}{free}", searched, asked)
    if drawn is None and found:
        drawn = report_of(plan, asked)
    again = proving(asked, job_words(result))
    if asked.json:
        said = {"margin": asked.margin, "command": again}
        said |= {} if sure is None else sure.json()
        print_json(_content(result, read) | said | mismatch_json(cells, drawn))
    else:
        ahead = ", feed-forward" if options.following is Following.LOAD else ""
        how = f"{options.interpolation}{ahead}"
        _show(result, f"{asked.title}, {how}{free}", high)
        if sure is not None:
            say(sure.line())
        for line in settings_words(read, machine, result):
            say(line)
        if again is not None:
            say(f"To prove it: {again}")
        if cells:
            show_mismatch(cells, f"{asked.title}{free}", searched)
        if drawn is not None:
            say(f"Report: {drawn}")
    raise typer.Exit(0 if found else 1)


def best_of(found: FastestJob) -> tuple[float | None, float | None]:
    """Return the best speed that was found, and how long the job takes at it."""
    return found.best.found.best, found.best.duration_s


def proving(asked: Asked, words: Mapping[str, str] | None) -> str | None:
    """Return the command that proves what a search found; None where nothing is in spec.

    Parameters
    ----------
    words
        The planning options that the search found.
    """
    if words is None:
        return None
    return command_line(
        "prove", asked.file, {**asked.words, **as_typed(words), **level_option(asked.trials)}
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


def _span(
    read: Job, machine: Machine, low: str | None, high: str | None
) -> tuple[FeedMode, float | None, float | None]:
    """Return what the feeds of the search are of, and its ends in m/s of that.

    Raises
    ------
    OptionError
        If an end is in another unit than a speed, or the ends are of different kinds.
    """
    ends = [None if text is None else parse_feed(text) for text in (low, high)]
    modes = {end.mode for end in ends if end is not None} or {searched_by(read, machine)}
    if modes == {FeedMode.F_WORD}:
        as_f_words(1.0, read.feed_rule)
    elif modes not in ({FeedMode.FASTEST_AXIS}, {FeedMode.OVERRIDE}):
        if len(modes) > 1:
            raise OptionError(
                f"--low {low!r} and --high {high!r} are feeds of different kinds",
                remedy='Write both like "36 mm/s", both like "F 3000", or both like "120 %".',
            )
        metres_per_second(str(high if low is None else low))
    values = [None if end is None else end.value for end in ends]
    return modes.pop(), values[0], values[1]


def _end_of_mismatch(
    result: FastestJob, highest: float | None, read: Job, machine: Machine
) -> float:
    """Return the highest speed that is tried over tolerances: a little above the nominal best."""
    if highest is not None:
        return highest
    best = result.best.found.best
    if best is None:
        return search_range(read, machine, result.by)[1]
    return best * ABOVE


def _at(options: Options, result: FastestJob) -> Options:
    """Return ``options`` with the feed and the limits that were found.

    Where no feed is in spec they are returned unchanged.
    """
    best = result.best
    if best.found.best is None:
        return options
    return replace(options, feed=Feed(result.by, best.found.best), limit_share=best.share)


def _content(result: FastestJob, read: Job) -> dict[str, Any]:
    found = result.best.found
    return {
        "best": found.best,
        "unit": "" if result.by is FeedMode.OVERRIDE else "m/s",
        "feed": read.feed_rule if result.by is FeedMode.F_WORD else result.by.value,
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
        "long_moves_cut": result.cut,
        "limits_left_out": list(result.left_out),
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


def _show(result: FastestJob, title: str, high: float | None) -> None:
    end = AXES_ALONE if high is None else END
    unit, per_m_s = _UNITS[result.by]
    rows = []
    for rung in result.rungs:
        for interval in rung.found.intervals:
            first = interval is rung.found.fastest
            rows.append(
                [
                    share_words(rung.share),
                    typed(interval.low * per_m_s),
                    "alone" if interval.alone else typed(interval.high * per_m_s),
                    f"{rung.duration_s:.3f}" if first and rung.duration_s else "",
                    limit_words(rung.found.limited_by, end) if first else "",
                ]
            )
    header = ["acceleration limits used", f"from {unit}", f"to {unit}", "job s", "limited by"]
    print_table(f"{title}: feeds in spec", header, merged(rows))
    best = result.best
    tried = sum(rung.found.tried for rung in result.rungs)
    head, body = verdict_rows(best.found.verdict)
    for line in _how_judged(result):
        say(line)
    if best.found.best is None:
        forbids = joined(one for rung in result.rungs for one in rung.found.forbidden)
        why, *more = forbidden_words(
            forbids, best.found.limited_by, lambda feed: _feed_text(result.by, feed)
        )
        for line in (f"no feed is in spec ({tried} tried): {why}", *more):
            say(line)
        print_table("verdict where the search came closest", head, body)
        say(closing(best.found.verdict))
        return
    say(
        f"fastest: {best.duration_s:.3f} s at {_feed_text(result.by, best.found.best)} with "
        f"{share_words(best.share)} of the acceleration and jerk limits, limited by "
        f"{limit_words(best.found.limited_by, end)}; "
        f"{tried} plans tried"
    )
    say(f"feeds {resolution_words(best.found)}")
    if best.found.alone:
        say(alone_words(best.found, unit, per_m_s))
    print_table("verdict at the fastest", head, body)
    say(closing(best.found.verdict))


def _feed_text(by: FeedMode, value: float) -> str:
    unit, per_m_s = _UNITS[by]
    number = typed(value * per_m_s)
    return f"F {number}" if by is FeedMode.F_WORD else f"{number} {unit}"


def _how_judged(result: FastestJob) -> Iterator[str]:
    """Yield lines on what the answer does not say of itself."""
    if result.parts:
        parts = "one stretch" if result.parts == 1 else f"{result.parts} stretches"
        yield (
            f"judged by {result.judged_moves} of {result.moves} moves, {parts}: the others repeat "
            "them"
        )
    if result.cut:
        yield "moves that last long were judged by their beginnings and their ends"
    if result.left_out:
        left_out = ", ".join(share_words(share) for share in result.left_out)
        yield (
            f"left out: {left_out} of the limits, with which the job takes no less time even at "
            "the highest feed"
        )
    if (result.parts or result.cut) and not result.whole:
        yield (
            "the whole job was not judged: the verdict is the worst of what was, with times from "
            "the beginning of a stretch; prove it by the command below"
        )
    yield from until_words(result.ended)


def _verdict_content(found: Fastest) -> dict[str, Any]:
    return {
        "passed": found.verdict.passed,
        "level": found.verdict.level.value,
        "criteria": criteria_json(found.verdict),
    }
