"""``threadline compare``: interpolations and feeds side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.base.option_defaults import AUTO, DEFAULT_INTERPOLATION, UNSHAPED_WORD
from threadline.cli import option_parameters
from threadline.cli.arguments import JobArgument, JsonOption, MachineOption, ReportOption
from threadline.cli.messages import warning
from threadline.cli.output import check_outputs, print_json, print_table, progress_bar, say, warn
from threadline.cli.search_text import VELOCITY_LIMITS, command_line, limit_words
from threadline.errors import OptionError
from threadline.jobs.operations import FeedMode
from threadline.motion.path.interpolations import FIRMWARE
from threadline.proof.kinds import kind_of
from threadline.proof.pipeline import open_job
from threadline.proof.recorded import proof_warnings
from threadline.proof.request import Words, with_radii_of
from threadline.report.proof import write_comparison
from threadline.search import Comparison, FastestJob
from threadline.search import compare as compare_job
from threadline.search.compare import compared_table
from threadline.verdict import verdict_json


def compare(
    job: JobArgument,
    machine: MachineOption,
    words: Words,
    fastest: Annotated[bool, typer.Option(help="Also find the fastest of each.")] = True,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Prove JOB with several interpolations at several feeds, and print them side by side.

    On an on/off machine shapers are compared instead, on an embroidery machine motion laws. The
    fastest feed of each interpolation is searched within the criteria of placement and of the laid
    fibre alone. For a move list, a design, or a machine file without dynamics the output names the
    command that searches.

    Exit status: 0 when every proof is in spec, 1 when one is not, 2 wrong input.

    Example: threadline compare examples/x-180.prg -m lathe-winder
    --interpolation linear,b-spline,b-spline-pulled --feed "10 count/tick,80 count/tick"

    On an on/off machine: threadline compare examples/letter-cycle.toml -m letter-placer
    --shaper none,zv,um-zv
    """
    trials = words.trials()
    check_outputs(folder=report)
    file_machine = words.machine(machine)
    defaults = kind_of(file_machine).compared
    feed, shaper = words.text("feed"), words.text("shaper")
    interpolation = words.text("interpolation")
    if (
        interpolation is None
        and file_machine.planner is not None
        and not words.flag("feed_forward")
    ):
        interpolation = f"{FIRMWARE},{AUTO}"
    names = _values(interpolation, defaults, "interpolation", DEFAULT_INTERPOLATION)
    shapers = _values(shaper, defaults, "shaper", UNSHAPED_WORD)
    shown = ["shaper"] if "shaper" in defaults else ["interpolation", "feed"]
    if shaper is not None and "shaper" not in shown:
        shown.append("shaper")
    feeds = [] if feed is None else _listed(feed, "--feed")
    planned = words.each_options(job, names, feeds, shapers)
    chosen = with_radii_of(file_machine, planned[0])
    job_read = open_job(job, chosen, planned[0])
    warn(chosen, job_read, own_feed=any(one.own_feeds for one in planned))
    with progress_bar(not json) as progress:
        comparison = compare_job(
            job_read,
            chosen,
            words.spec(chosen),
            planned,
            with_fastest=fastest,
            progress=progress,
            trials=trials,
            actual=words.actual(),
        )
        tables = comparison_tables(comparison, shown)
        written = None if report is None else write_comparison(comparison, report, tables)
    for warning_text in dict.fromkeys(
        line for proof in comparison.proofs for line in proof_warnings(proof)
    ):
        warning(warning_text)
    left_out = left_out_words(comparison, job, machine) if fastest else None
    if json:
        content = comparison_json(comparison) | {"fastest_left_out": left_out}
        if written is not None:
            content["report"] = str(written)
        print_json(content)
    else:
        show_comparison(comparison, shown)
        if left_out is not None:
            say(left_out)
        if written is not None:
            say(f"Report: {written}")
    raise typer.Exit(0 if all(proof.verdict.passed for proof in comparison.proofs) else 1)


def show_comparison(found: Comparison, shown: Sequence[str]) -> None:
    """Print a comparison for people."""
    for title, header, rows in comparison_tables(found, shown):
        print_table(title, header, rows)
    for name, why in found.refused:
        say(f"{name} is refused: {why}")


def left_out_words(found: Comparison, job: Path, machine: str) -> str | None:
    """Return why the fastest was not searched, and the command that does; None if it was."""
    if found.fastest:
        return None
    plan = found.proofs[0].plan
    searches = command_line("fastest", job, {"-m": machine})
    if plan.machine.without_dynamics:
        return (
            "No fastest feed within placement is searched: the machine file has no dynamics; "
            f"{searches} finds the feeds within its limits."
        )
    return f"{_LEFT_OUT[plan.job.paced_by]} {searches} does that."


_LEFT_OUT = {
    "switchings": "The fastest of each shaper is not searched: the shortest cycle chooses shaper, "
    "levels and waits for every move by itself.",
    "shaft": "The fastest of each law is not searched: the shaft speed is searched with one "
    "law, which --law names.",
}
"""Reason why a comparison searches no fastest feed, by the pace of the job."""


def comparison_tables(
    found: Comparison, shown: Sequence[str] = ("interpolation", "feed")
) -> list[tuple[str, list[str], list[list[str]]]]:
    """Return the tables of a comparison: title, header, rows; ``shown`` names compared options."""
    tables = [compared_table(found, shown)]
    if found.fastest:
        reference = next(iter(found.fastest))
        body = [_fastest_row(n, f, found.fastest[reference]) for n, f in found.fastest.items()]
        by_share = any(f.by is FeedMode.OVERRIDE for f in found.fastest.values())
        head = [
            "interpolation",
            "feed" if by_share else "mm/s",
            f"times {reference}",
            "acceleration limits used",
            "job s",
            "limited by",
        ]
        tables.append(("fastest within the placement criteria", head, body))
    return tables


def _fastest_row(name: str, result: FastestJob, reference: FastestJob) -> list[str]:
    candidate, slowest = result.best, reference.best.found.best
    best = candidate.found.best
    if best is None:
        return [name, "none", "-", "-", "-", candidate.found.limited_by]
    names_unit = reference.by is FeedMode.OVERRIDE
    answer = f"{best * 1e3:.1f}{' mm/s' if names_unit else ''}"
    if result.by is FeedMode.OVERRIDE:
        answer = f"{best * 100.0:.4g} %"
    return [
        name,
        f"{answer}{' alone' if candidate.isolated else ''}",
        f"{best / slowest:.2f}" if slowest and result.by is reference.by else "-",
        f"{candidate.share:.0%}",
        f"{candidate.duration_s:.3f}",
        limit_words(candidate.found.limited_by, VELOCITY_LIMITS),
    ]


def comparison_json(found: Comparison) -> dict[str, Any]:
    """Return a comparison as JSON content."""
    return {
        "proofs": [
            verdict_json(proof.verdict, proof.plan)
            | {"feed": proof.plan.options["feed"], "shaper": proof.plan.options.get("shaper")}
            | {"as_run_s": run_s}
            for proof, run_s in zip(found.proofs, found.as_run_s, strict=True)
        ],
        "refused": [{"shaper": name, "why": why} for name, why in found.refused],
        "fastest": {
            name: {
                "best": f.best.found.best,
                "unit": "" if f.by is FeedMode.OVERRIDE else "m/s",
                "intervals": [[i.low, i.high] for i in f.best.found.intervals],
                "alone": list(f.best.found.isolated),
                "limited_by": f.best.found.limited_by,
                "limits": f.best.share,
                "duration_s": f.best.duration_s,
            }
            for name, f in found.fastest.items()
        },
    }


def _values(
    text: str | None, defaults: Mapping[str, tuple[str, ...]], key: str, otherwise: str
) -> list[str]:
    """Return the values of a compared option: the given ones, else the defaults of the kind."""
    return list(defaults.get(key, (otherwise,))) if text is None else _listed(text, f"--{key}")


def _listed(text: str, option: str) -> list[str]:
    names = [part.strip() for part in text.split(",")]
    if not all(names):
        raise OptionError(f"{option} {text!r} has an empty entry", remedy="Separate with commas.")
    return names


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    option_parameters.add(app, "compare", compare)
