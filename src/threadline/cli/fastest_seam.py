"""``threadline fastest`` on a seam: every interval of needle speed that stays in spec."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

import typer

from threadline.cli.found import limit_words, margin_words, resolution_words, typed
from threadline.cli.level import level_words
from threadline.cli.output import print_json, print_table, progress_bar, say
from threadline.cli.outputs import check_outputs
from threadline.cli.warn import tell, warn
from threadline.doubts import tolerance_warnings
from threadline.errors import OptionError, UnitError
from threadline.jobs import Job, read_job
from threadline.jobs.seam.settings import LEAST_NEEDLE_HZ, MOST_NEEDLE_HZ
from threadline.machine import Machine
from threadline.options import Options
from threadline.pipeline import Trials, plan_job
from threadline.report.mismatch import write_mismatch
from threadline.search import Fastest, Mismatch, fastest_needle, needle_over_tolerances
from threadline.units import parse_quantity
from threadline.verdict import Spec, closing, criteria_json, verdict_rows


def fastest_seam(
    job: Path,
    read: Job,
    machine: Machine,
    spec: Spec,
    margin: float,
    options: Options,
    actual: Machine | None,
    span: tuple[float | None, float | None],
    mismatch: bool,
    report: Path | None,
    trials: Trials,
    json: bool,
) -> NoReturn:
    """Search the needle speed of a seam, say what was found, and leave."""
    check_mismatch(mismatch, actual is not None, report)
    warn(machine, read)
    low, high = span
    cells: list[Mismatch] = []
    with progress_bar(not json) as progress:
        found = fastest_needle(
            job,
            machine,
            spec,
            options,
            low=low,
            high=high,
            progress=progress,
            actual=actual,
            trials=trials,
        )
        if mismatch:
            end = found.best * ABOVE if high is None and found.best else (high or _UNKNOWN_HZ)
            cells = needle_over_tolerances(
                job, machine, spec, options, low=low, high=end, progress=progress
            )
        title = f"{job.name} on {machine.name}{margin_words(margin)}"
        written = None if report is None else write_mismatch(cells, title, report)
    if found.best is not None:
        sewn = read_job(job, machine, needle_speed=f"{found.best!r} stitch/s")
        tell(tolerance_warnings(plan_job(sewn, machine, options)))
    if json:
        content = _content(found) | {"margin": margin} | mismatch_json(cells)
        if written is not None:
            content["report"] = str(written)
        print_json(content)
    else:
        _show(found, title)
        if found.best is not None:
            say(
                f'To prove it: write needle_speed = "{found.best!r} stitch/s" in {job.name}, then '
                f"threadline prove with the same options {level_words(trials)}".rstrip()
            )
        if cells:
            show_mismatch(cells, title)
        if written is not None:
            say(f"Report: {written}")
    raise typer.Exit(0 if found.best is not None else 1)


ABOVE = 1.1
"""A machine off its file is rarely faster than by that."""
_UNKNOWN_HZ = 100.0


def check_mismatch(mismatch: bool, actual: bool, report: Path | None) -> None:
    """Refuse --report without --mismatch, which it draws, and --mismatch beside --actual.

    Raises
    ------
    OptionError
        If the options do not go together, or the report cannot be written.
    """
    if report is not None and not mismatch:
        raise OptionError("--report has a picture of --mismatch alone", remedy="Give both.")
    if mismatch and actual:
        raise OptionError("--mismatch and --actual exclude each other", remedy="Give one of them.")
    check_outputs(folder=report)


def mismatch_json(cells: list[Mismatch]) -> dict[str, Any]:
    """Return what is printed of a search over tolerances; nothing where there was none."""
    found = [
        {"mass": c.mass, "stiffness": c.stiffness, **_interval_content(c.found)} for c in cells
    ]
    return {"mismatch": found} if found else {}


def _interval_content(found: Fastest) -> dict[str, Any]:
    return {
        "best": found.best,
        "intervals": [[i.low, i.high] for i in found.intervals],
        "limited_by": found.limited_by,
    }


def _content(found: Fastest) -> dict[str, Any]:
    return {
        **_interval_content(found),
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
        say(f"no needle speed is in spec ({found.tried} tried): {found.limited_by} fails at all")
        print_table("verdict where the search came closest", *verdict_rows(found.verdict))
        return
    rows = [[typed(i.low), typed(i.high)] for i in found.intervals]
    print_table(f"{title}: needle speeds in spec", ["from stitch/s", "to stitch/s"], rows)
    say(
        f"fastest: {typed(found.best)} stitch/s, limited by {limit_words(found.limited_by)}; "
        f"{found.tried} plans tried"
    )
    say(f"needle speeds {resolution_words(found)}")
    print_table("verdict at the fastest", *verdict_rows(found.verdict))
    say(closing(found.verdict))


def show_mismatch(
    cells: list[Mismatch], title: str, unit: str = "stitch/s", per_unit: float = 1.0
) -> None:
    """Print the fastest per mass and stiffness, both at the ends of their tolerances.

    Parameters
    ----------
    unit
        In which speeds are printed.
    per_unit
        What the searched speeds are multiplied by to be in ``unit``.
    """
    names = {-1.0: "lower end", 0.0: "as in the file", 1.0: "upper end"}
    rows = [
        [
            names[cell.mass],
            names[cell.stiffness],
            "none" if cell.found.best is None else f"{per_unit * cell.found.best:.2f}",
            limit_words(cell.found.limited_by),
        ]
        for cell in cells
    ]
    header = ["mass of loads", "stiffness of links", f"fastest {unit}", "limited by"]
    done = "sewn" if unit == "stitch/s" else "done"
    print_table(f"{title}: planned for the file, {done} off its tolerances", header, rows)


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
