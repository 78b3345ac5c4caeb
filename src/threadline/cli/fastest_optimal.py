"""``threadline fastest --interpolation optimal``: the fastest plan in spec, and what limits it."""

from __future__ import annotations

import math
from typing import Any, NoReturn

import typer

from threadline.base.option_defaults import NO_CONTOUR
from threadline.cli.fastest_asked import Asked, certainty_of, report_of
from threadline.cli.fastest_by_feed import best_of, metres_per_second, proving
from threadline.cli.found import limit_words, margin_words, typed, until_words
from threadline.cli.output import check_outputs, print_json, print_table, progress_bar, say
from threadline.cli.warn import warn
from threadline.errors import OptionError
from threadline.motion.path.interpolations import OPTIMAL
from threadline.proof.option_words import share_words
from threadline.proof.pipeline import plan_job, with_shaping
from threadline.report.strips import binding_lines, binding_of
from threadline.search import FastestJob, Rung, fastest_job
from threadline.search.allowance import options_at
from threadline.search.by_pace import job_words
from threadline.verdict import closing, criteria_json, verdict_rows


def fastest_optimal(asked: Asked) -> NoReturn:
    """Find the fastest plan in spec, print it beside the bound, and end the program.

    The bound is the shortest duration that the limits of axes and drives alone allow. The highest
    feed caps the speed.

    Raises
    ------
    OptionError
        If an option of a search by feed was given.
    """
    wrong = {"--low": asked.low, "--mismatch": asked.mismatch or None}
    for name, value in wrong.items():
        if value is not None:
            raise OptionError(
                f"{name} belongs to a search by feed, and {OPTIMAL} searches no feed",
                remedy="Leave it out; prove --tolerances judges its plan on other machines.",
            )
    read, machine, options = asked.job, asked.machine, asked.options
    check_outputs(folder=asked.report)
    highest_m_s = None if asked.high is None else metres_per_second(asked.high)
    spec = with_shaping(asked.spec, machine, options)
    warn(machine, read, own_feed=False)
    with progress_bar(not asked.json) as progress:
        found = fastest_job(
            read,
            machine,
            spec,
            options,
            high=highest_m_s,
            progress=progress,
            actual=asked.actual,
            trials=asked.trials,
            until=asked.until,
        )
        sure = certainty_of(
            asked,
            best_of(found),
            "m/s",
            lambda chosen, trials: best_of(
                fastest_job(
                    read,
                    machine,
                    spec,
                    chosen,
                    high=highest_m_s,
                    progress=progress,
                    actual=asked.actual,
                    trials=trials,
                    until=asked.until,
                )
            ),
        )
    best = found.best
    again = proving(asked, job_words(found))
    plan = plan_job(read, machine, options_at(machine, options, best, highest_m_s))
    bound = binding_of(plan)
    binds = {} if bound is None else bound.binds
    page = report_of(plan, asked, spec)
    if asked.json:
        told = {"report": str(page)} if page is not None else {}
        said = {"margin": asked.margin, "command": again, "binds": binds}
        said |= {} if sure is None else sure.json()
        print_json(_content(found) | said | told)
    else:
        _show(found, f"{asked.title}, optimal{margin_words(asked.margin)}")
        if sure is not None:
            say(sure.line())
        for line in [] if bound is None else binding_lines(bound):
            say(line)
        if again is not None:
            say(f"To prove it: {again}")
        if page is not None:
            say(f"Report: {page}")
    raise typer.Exit(0 if best.found.best is not None else 1)


def _content(found: FastestJob) -> dict[str, Any]:
    best = found.best
    return {
        "best": best.found.best,
        "unit": "m/s",
        "intervals": [[i.low, i.high] for i in best.found.intervals],
        "limited_by": best.found.limited_by,
        "duration_s": best.duration_s,
        "tried": len(found.rungs),
        "ended": found.ended,
        "bounds": [{"within": b.within, "duration_s": b.duration_s} for b in found.bounds],
        "verdict": {
            "passed": best.found.verdict.passed,
            "level": best.found.verdict.level.value,
            "criteria": criteria_json(best.found.verdict),
        },
        "rungs": [_rung_content(rung) for rung in found.rungs],
        **_allowed(best),
    }


def _rung_content(rung: Rung) -> dict[str, Any]:
    return {
        "duration_s": rung.duration_s,
        "limited_by": None if rung.duration_s is not None else rung.found.limited_by,
        "alone": rung.alone,
        **_allowed(rung),
    }


def _allowed(rung: Rung) -> dict[str, Any]:
    contour_m = rung.contour_m
    return {
        "limits": rung.share,
        "contour_m": None if contour_m is None or math.isinf(contour_m) else contour_m,
    }


def _show(found: FastestJob, title: str) -> None:
    rows = [
        [
            _allowance(rung),
            "" if rung.duration_s is None else f"{rung.duration_s:.3f}",
            _outcome(rung),
        ]
        for rung in found.rungs
    ]
    header = [
        "acceleration limits used" if found.best.contour_m is None else "contour mm",
        "job s",
        "verdict",
    ]
    print_table(f"{title}: plans proved", header, rows)
    best = found.best
    for line in until_words(found.ended):
        say(line)
    head, body = verdict_rows(best.found.verdict)
    if best.duration_s is None:
        say(f"no plan is in spec ({len(rows)} proved): {best.found.limited_by} fails at all")
        print_table("verdict where the search came closest", head, body)
        say(closing(best.found.verdict))
        return
    say(
        f"fastest: {best.duration_s:.3f} s, limited by {limit_words(best.found.limited_by)}; "
        f"{len(rows)} plans proved"
    )
    if any(rung.alone for rung in found.rungs):
        say("alone: the plan for an allowance smaller by half a percent is out of spec")
    for bound in found.bounds:
        over = best.duration_s / bound.duration_s - 1.0
        say(f"within the limits of {bound.within} alone: {bound.duration_s:.3f} s ({over:+.0%})")
    print_table("verdict at the fastest", head, body)
    say(closing(best.found.verdict))


def _outcome(rung: Rung) -> str:
    if rung.duration_s is None:
        return f"OUT: {rung.found.limited_by}"
    return "in spec, alone" if rung.alone else "in spec"


def _allowance(rung: Rung) -> str:
    if rung.contour_m is None:
        return share_words(rung.share)
    return NO_CONTOUR if math.isinf(rung.contour_m) else typed(round(rung.contour_m * 1e3, 6))
