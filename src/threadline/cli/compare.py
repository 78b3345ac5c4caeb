"""``threadline compare``: interpolations and feeds side by side."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from threadline.cli.found import limit_words
from threadline.cli.options import (
    DEFAULT_TOLERANCE_TEXT,
    JobArgument,
    JsonOption,
    MachineOption,
    ParOption,
    ReportOption,
    SpecOption,
    ToleranceOption,
    machine_from,
    options_of,
)
from threadline.cli.output import note, print_json, print_table, progress_bar
from threadline.cli.outputs import check_outputs
from threadline.cli.tolerance import proof_warnings
from threadline.cli.warn import warn
from threadline.errors import OptionError
from threadline.jobs import read_job
from threadline.options import parse_feed
from threadline.pipeline import Proof
from threadline.report import write_comparison
from threadline.search import Comparison, Rung
from threadline.search import compare as compare_job
from threadline.verdict import Result, load_spec, verdict_json

COLUMNS = (
    ("tracking_error", "tracking mm"),
    ("contour_error", "contour mm"),
    ("turning_point_error", "turning point mm"),
    ("path_deviation", "plan misses mm"),
)


def compare(
    job: JobArgument,
    machine: MachineOption,
    interpolation: Annotated[
        str, typer.Option(help="Names, separated by commas.")
    ] = "linear,b-spline,b-spline-pulled",
    feed: Annotated[
        str | None, typer.Option(help="Feeds, separated by commas; default: as programmed.")
    ] = None,
    spec: SpecOption = None,
    tolerance: ToleranceOption = DEFAULT_TOLERANCE_TEXT,
    par: ParOption = None,
    fastest: Annotated[bool, typer.Option(help="Also find the fastest of each.")] = True,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Prove JOB with several interpolations at several feeds, and print them side by side.

    The fastest feed of each is searched within the placement criteria alone. Exit status: 0 when
    every proof is in spec, 1 when one is not, 2 wrong input.

    Example: threadline compare examples/x-180.prg -m lathe-winder
    --interpolation linear,b-spline,b-spline-pulled --feed "10 count/tick,80 count/tick"
    """
    check_outputs(folder=report)
    chosen = machine_from(machine, par)
    names = _listed(interpolation, "--interpolation")
    feeds = [None] if feed is None else [parse_feed(text) for text in _listed(feed, "--feed")]
    read = read_job(job, chosen)
    warn(chosen, read)
    with progress_bar(not json) as progress:
        found = compare_job(
            read,
            chosen,
            load_spec(spec, chosen),
            names,
            feeds,
            options_of(names[0], None, tolerance),
            with_fastest=fastest,
            progress=progress,
        )
        written = (
            None if report is None else write_comparison(found, report, comparison_tables(found))
        )
    for warning in dict.fromkeys(line for proof in found.proofs for line in proof_warnings(proof)):
        note(f"warning: {warning}")
    if json:
        content = comparison_json(found)
        if written is not None:
            content["report"] = str(written)
        print_json(content)
    else:
        show_comparison(found)
        if written is not None:
            typer.echo(f"Report: {written}")
    raise typer.Exit(0 if all(proof.verdict.passed for proof in found.proofs) else 1)


def show_comparison(found: Comparison) -> None:
    """Print a comparison for people."""
    for title, header, rows in comparison_tables(found):
        print_table(title, header, rows)


def comparison_tables(found: Comparison) -> list[tuple[str, list[str], list[list[str]]]]:
    """Return the tables of a comparison: title, header, rows."""
    first = found.proofs[0].plan
    header = ["interpolation", "feed", "time s", *(title for _, title in COLUMNS), "verdict"]
    rows = [
        [
            proof.plan.path.interpolation,
            proof.plan.options["feed"],
            f"{proof.plan.trajectory.duration_s:.3f}",
            *(_worst_mm(proof, name) for name, _ in COLUMNS),
            "in spec" if proof.verdict.passed else "OUT",
        ]
        for proof in found.proofs
    ]
    tables = [(f"{first.job.name} on {first.machine.name}", header, rows)]
    if found.fastest:
        reference = next(iter(found.fastest))
        slowest = found.fastest[reference].best.found.best
        body = [_fastest_row(name, f.best, slowest) for name, f in found.fastest.items()]
        head = ["interpolation", "mm/s", f"times {reference}", "limits used", "job s", "limited by"]
        tables.append(("fastest within the placement criteria", head, body))
    return tables


def _fastest_row(name: str, rung: Rung, reference_m_s: float | None) -> list[str]:
    best = rung.found.best
    if best is None:
        return [name, "none", "-", "-", "-", rung.found.limited_by]
    return [
        name,
        f"{best * 1e3:.1f}",
        f"{best / reference_m_s:.2f}" if reference_m_s else "-",
        f"{rung.share:.0%}",
        f"{rung.duration_s:.3f}",
        limit_words(rung.found.limited_by).removesuffix(" (--high)"),
    ]


def comparison_json(found: Comparison) -> dict[str, Any]:
    """Return a comparison as JSON content."""
    return {
        "proofs": [
            verdict_json(proof.verdict, proof.plan) | {"feed": proof.plan.options["feed"]}
            for proof in found.proofs
        ],
        "fastest": {
            name: {
                "best": f.best.found.best,
                "unit": "m/s",
                "intervals": [[i.low, i.high] for i in f.best.found.intervals],
                "limited_by": f.best.found.limited_by,
                "limits": f.best.share,
                "duration_s": f.best.duration_s,
            }
            for name, f in found.fastest.items()
        },
    }


def _worst_mm(proof: Proof, name: str) -> str:
    results: list[Result] = [
        r for r in proof.verdict.results if r.name == name and r.measured is not None
    ]
    lengths = [abs(r.measured) * 1e3 for r in results if r.unit == "m" and r.measured is not None]
    return f"{max(lengths):.3f}" if lengths else "-"


def _listed(text: str, option: str) -> list[str]:
    names = [part.strip() for part in text.split(",")]
    if not all(names):
        raise OptionError(f"{option} {text!r} has an empty entry", remedy="Separate with commas.")
    return names


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("compare")(compare)
