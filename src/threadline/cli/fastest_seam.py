"""``threadline fastest`` on a seam: every interval of needle speed that stays in spec."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NoReturn

import typer

from threadline.cli.certainty import certainty_of
from threadline.cli.fastest_asked import Asked
from threadline.cli.fastest_by_feed import proving
from threadline.cli.found import (
    alone_words,
    forbidden_words,
    limit_words,
    margin_words,
    resolution_words,
    typed,
    until_words,
)
from threadline.cli.mismatch import (
    ABOVE,
    check_mismatch,
    drawn_of,
    mismatch_json,
    report_of,
    show_mismatch,
)
from threadline.cli.output import print_json, print_table, progress_bar, say
from threadline.cli.warn import tell, warn
from threadline.doubts import tolerance_warnings
from threadline.errors import OptionError, UnitError
from threadline.jobs.seam.settings import LEAST_NEEDLE_HZ, MOST_NEEDLE_HZ
from threadline.pipeline import open_job, plan_job
from threadline.search import Fastest, Mismatch, fastest_needle, needle_over_tolerances
from threadline.search.by_pace import needle_words
from threadline.search.mismatch import NEEDLE
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
        print_json(_content(found) | said | mismatch_json(cells, drawn))
    else:
        for line in until_words(asked.until.ended):
            say(line)
        _show(found, title)
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


def _content(found: Fastest) -> dict[str, Any]:
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


def _show(found: Fastest, title: str) -> None:
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
