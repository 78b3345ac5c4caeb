"""``threadline fastest`` on seams and designs: needle speeds and shaft speeds in spec."""

from __future__ import annotations

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
from threadline.cli.fastest_by_feed import proving
from threadline.cli.found import (
    alone_words,
    as_typed,
    command_line,
    forbidden_words,
    limit_words,
    margin_words,
    resolution_words,
    typed,
    until_words,
)
from threadline.cli.output import print_json, print_table, progress_bar, say
from threadline.cli.warn import tell, warn
from threadline.commands.plan import Plan
from threadline.errors import OptionError, UnitError
from threadline.jobs.operations import Feed, FeedMode
from threadline.jobs.seam.settings import LEAST_NEEDLE_HZ, MOST_NEEDLE_HZ
from threadline.proof.asked import level_option
from threadline.proof.option_words import parse_feed
from threadline.proof.pipeline import open_job, plan_job
from threadline.proof.recorded import tolerance_warnings
from threadline.search import Fastest, Mismatch, fastest_needle, needle_over_tolerances
from threadline.search.by_pace import needle_words, shaft_words
from threadline.search.mismatch import NEEDLE, SHAFT, shaft_over_tolerances
from threadline.search.shaft import FastestShaft, fastest_shaft
from threadline.units import parse_quantity
from threadline.verdict import closing, criteria_json, verdict_rows


def fastest_seam(asked: Asked) -> NoReturn:
    """Search the needle speed of a seam, print the result, and end the program."""
    file, machine, options = asked.file, asked.machine, asked.options
    check_mismatch(asked.mismatch, asked.actual is not None, asked.report)
    low, high = needle_hz(asked.low), needle_hz(asked.high)
    warn(machine, asked.job, own_feed=False)
    cells: list[Mismatch] = []
    with progress_bar(not asked.json) as progress:
        found = fastest_needle(
            file,
            machine,
            asked.spec,
            options,
            low=low,
            high=high,
            progress=progress,
            actual=asked.actual,
            trials=asked.trials,
            until=asked.until,
        )
        if asked.mismatch:
            end = found.best * ABOVE if high is None and found.best else (high or _UNKNOWN_HZ)
            cells = needle_over_tolerances(
                file, machine, asked.spec, options, low=low, high=end, progress=progress
            )
        sure = certainty_of(
            asked,
            (found.best, None),
            "stitch/s",
            lambda chosen, trials: (
                fastest_needle(
                    file,
                    machine,
                    asked.spec,
                    chosen,
                    low=low,
                    high=high,
                    progress=progress,
                    actual=asked.actual,
                    trials=trials,
                    until=asked.until,
                ).best,
                None,
            ),
        )
    title = f"{file.name} on {machine.name}{margin_words(asked.margin)}"
    drawn = drawn_of(cells, title, NEEDLE, asked)
    if found.best is not None:
        at_best = replace(options, needle=f"{found.best!r} stitch/s")
        plan = plan_job(open_job(file, machine, at_best), machine, at_best)
        tell(tolerance_warnings(plan))
        drawn = drawn or report_of(plan, asked)
    again = proving(asked, needle_words(found.best))
    if asked.json:
        said = {"margin": asked.margin, "command": again, "ended": asked.until.ended}
        said |= {} if sure is None else sure.json()
        print_json(_fastest_seam_content(found) | said | mismatch_json(cells, drawn))
    else:
        for line in until_words(asked.until.ended):
            say(line)
        _show_needle_speeds(found, title)
        if sure is not None:
            say(sure.line())
        if again is not None:
            say(f"To prove it: {again}")
        if cells:
            show_mismatch(cells, title, NEEDLE)
        if drawn is not None:
            say(f"Report: {drawn}")
    raise typer.Exit(0 if found.best is not None else 1)


_UNKNOWN_HZ = 100.0


def _fastest_seam_content(found: Fastest) -> dict[str, Any]:
    return {
        "best": found.best,
        "intervals": [[i.low, i.high] for i in found.intervals],
        "alone": list(found.alone),
        "limited_by": found.limited_by,
        "unit": "stitch/s",
        "step": found.step,
        "step_at_edges": found.near_step,
        "tried": found.tried,
        "verdict": {
            "passed": found.verdict.passed,
            "level": found.verdict.level.value,
            "criteria": criteria_json(found.verdict),
        },
    }


def _show_needle_speeds(found: Fastest, title: str) -> None:
    if found.best is None:
        why, *more = forbidden_words(
            found.forbidden, found.limited_by, lambda speed: f"{typed(speed)} stitch/s"
        )
        for line in (f"no needle speed is in spec ({found.tried} tried): {why}", *more):
            say(line)
        print_table("verdict where the search came closest", *verdict_rows(found.verdict))
        say(closing(found.verdict))
        return
    rows = [[typed(i.low), "alone" if i.alone else typed(i.high)] for i in found.intervals]
    print_table(f"{title}: needle speeds in spec", ["from stitch/s", "to stitch/s"], rows)
    say(
        f"fastest: {typed(found.best)} stitch/s, limited by {limit_words(found.limited_by)}; "
        f"{found.tried} plans tried"
    )
    say(f"needle speeds {resolution_words(found)}")
    if found.alone:
        say(alone_words(found, "stitch/s"))
    print_table("verdict at the fastest", *verdict_rows(found.verdict))
    say(closing(found.verdict))


def needle_hz(text: str | None) -> float | None:
    """Return a needle speed in stitch/s.

    Raises
    ------
    OptionError
        If the text is no needle speed.
    """
    if text is None:
        return None
    try:
        found = parse_quantity(text, "stitch/s")
    except UnitError as error:
        raise OptionError(
            f"{text!r}: {error.message}",
            remedy='The search of a seam runs in stitches: "40 stitch/s".',
        ) from error
    if not LEAST_NEEDLE_HZ <= found <= MOST_NEEDLE_HZ:
        raise OptionError(
            f"{text!r} is no needle speed: it must be at least {LEAST_NEEDLE_HZ:g} and at most "
            f"{MOST_NEEDLE_HZ:g} stitch/s",
            remedy="Correct --low or --high.",
        )
    return found


_MINUTE = 60.0


def fastest_design(asked: Asked) -> NoReturn:
    """Search the speed of the shaft, print the result, and end the program."""
    read, machine, options = asked.job, asked.machine, asked.options
    check_mismatch(asked.mismatch, asked.actual is not None, asked.report)
    low, high = (
        None if text is None else _stitches_per_second(text) for text in (asked.low, asked.high)
    )
    warn(machine, read, own_feed=False)
    with progress_bar(not asked.json) as progress:
        found = fastest_shaft(
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
        )
        sure = certainty_of(
            asked,
            (found.constant.best, found.duration_s),
            "stitch/s",
            lambda chosen, trials: (
                None,
                fastest_shaft(
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
                ).duration_s,
            ),
        )
        cells = []
        if asked.mismatch:
            end = found.constant.best * ABOVE if high is None and found.constant.best else high
            cells = shaft_over_tolerances(
                read, machine, asked.spec, options, low=low, high=end, progress=progress
            )
    title = f"{asked.title}{margin_words(asked.margin)}"
    drawn = drawn_of(cells, title, SHAFT, asked)
    if drawn is None and asked.report is not None and found.duration_s is not None:
        drawn = report_of(_plan(found, asked), asked)
    again = _command(found, asked)
    if asked.json:
        said = {"margin": asked.margin, "command": again, "ended": asked.until.ended}
        said |= {} if sure is None else sure.json()
        print_json(_fastest_shaft_content(found) | said | mismatch_json(cells, drawn))
    else:
        for line in until_words(asked.until.ended):
            say(line)
        _show_shaft_speeds(found, title)
        if sure is not None:
            say(sure.line())
        if again is not None:
            say(f"To prove it: {again}")
        if cells:
            show_mismatch(cells, title, SHAFT)
        if drawn is not None:
            say(f"Report: {drawn}")
    raise typer.Exit(0 if found.duration_s is not None else 1)


def _plan(found: FastestShaft, asked: Asked) -> Plan:
    """Return the plan of the fastest: a speed for each stitch, or a constant one."""
    schedule = found.schedule
    if schedule is not None and schedule.plan.duration_s == found.duration_s:
        return schedule.plan
    assert found.constant.best is not None
    feed = Feed(FeedMode.SHAFT, found.constant.best)
    return plan_job(asked.job, asked.machine, replace(asked.options, feed=feed))


def _stitches_per_second(text: str) -> float:
    feed = parse_feed(text)
    if feed.mode is not FeedMode.SHAFT:
        raise OptionError(
            f"speed {text!r} is not in stitches",
            remedy='The search of a design runs in stitches: "120 stitch/min".',
        )
    return feed.value


def _command(found: FastestShaft, asked: Asked) -> str | None:
    words = shaft_words(found)
    if words is None:
        return None
    typed = {**asked.words, "--interpolation": None, **as_typed(words)}
    return command_line("prove", asked.file, {**typed, **level_option(asked.trials)})


def _fastest_shaft_content(found: FastestShaft) -> dict[str, Any]:
    schedule = None
    if found.schedule is not None:
        schedule = {
            "duration_s": found.schedule.plan.duration_s,
            "tolerance_m": found.tolerance_m,
            "criteria": criteria_json(found.schedule.verdict),
        }
    return {
        "best": found.duration_s,
        "unit": "s",
        "intervals": [[i.low, i.high] for i in found.constant.intervals],
        "alone": list(found.constant.alone),
        "intervals_unit": "stitch/s",
        "limited_by": found.limited_by,
        "constant_s": found.constant_s,
        "schedule": schedule,
        "tried": found.constant.tried,
        "step": found.constant.step,
        "step_at_edges": found.constant.near_step,
        "verdict": {
            "passed": found.verdict.passed,
            "level": found.verdict.level.value,
            "criteria": criteria_json(found.verdict),
        },
    }


def _show_shaft_speeds(found: FastestShaft, title: str) -> None:
    begun = found.constant.low
    rows = [
        [
            f"{i.low * _MINUTE:.2f}",
            "alone" if i.alone else f"{i.high * _MINUTE:.2f}",
            "begins where the search did: --low for slower ones" if i.low == begun else "",
        ]
        for i in found.constant.intervals
    ]
    header = ["from stitch/min", "to stitch/min", "note"]
    print_table(f"{title}: constant speeds in spec", header, rows)
    if found.constant.best is None:
        say(f"no constant speed is in spec: {limit_words(found.limited_by)}")
    else:
        say(
            f"fastest constant speed: {found.constant.best * _MINUTE:.2f} stitch/min, "
            f"{found.constant_s:.4g} s, limited by {limit_words(found.limited_by)}; "
            f"{resolution_words(found.constant)}"
        )
    if found.constant.alone:
        say(alone_words(found.constant, "stitch/min", _MINUTE))
    if found.schedule is not None:
        say(
            f"fastest with a speed for each stitch: {found.schedule.plan.duration_s:.4g} s, "
            f"planned for a swing of {found.tolerance_m * 1e3:.4g} mm"
        )
    print_table("verdict at the fastest", *verdict_rows(found.verdict))
    say(closing(found.verdict))
