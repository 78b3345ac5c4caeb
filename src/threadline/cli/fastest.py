"""``threadline fastest``: every interval of feed that stays in spec."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer

from threadline.cli.options import (
    DEFAULT_INTERPOLATION_TEXT,
    DEFAULT_TOLERANCE_TEXT,
    InterpolationOption,
    JobArgument,
    JsonOption,
    MachineOption,
    ParOption,
    SpecOption,
    ToleranceOption,
    machine_from,
    options_of,
)
from threadline.cli.output import print_json, print_table, progress_bar
from threadline.errors import OptionError
from threadline.jobs import read_job
from threadline.pipeline import parse_feed
from threadline.search import fastest_feed
from threadline.verdict import load_spec, verdict_rows


def fastest(
    job: JobArgument,
    machine: MachineOption,
    spec: SpecOption = None,
    interpolation: InterpolationOption = DEFAULT_INTERPOLATION_TEXT,
    tolerance: ToleranceOption = DEFAULT_TOLERANCE_TEXT,
    par: ParOption = None,
    low: Annotated[str | None, typer.Option(help="Lowest feed to try.")] = None,
    high: Annotated[str | None, typer.Option(help="Highest feed to try.")] = None,
    json: JsonOption = False,
) -> None:
    """Find every interval of feed at which JOB stays in spec on the machine, the highest first.

    Exit status: 0 when some feed passes, 1 when none does, 2 wrong input.

    Example: threadline fastest examples/x-180.prg -m lathe-winder --interpolation linear
    """
    chosen = machine_from(machine, par)
    read = read_job(job, chosen)
    with progress_bar(not json) as progress:
        found = fastest_feed(
            read,
            chosen,
            load_spec(spec, chosen),
            options_of(interpolation, None, tolerance),
            low=None if low is None else _metres_per_second(low),
            high=None if high is None else _metres_per_second(high),
            progress=progress,
        )
    if json:
        content: dict[str, Any] = {
            "best": found.best,
            "unit": "m/s",
            "intervals": [[i.low, i.high] for i in found.intervals],
            "limited_by": found.limited_by,
            "tried": found.tried,
            "verdict": None if found.verdict is None else found.verdict.passed,
        }
        print_json(content)
    else:
        rows = [[f"{i.low * 1e3:.2f}", f"{i.high * 1e3:.2f}"] for i in found.intervals]
        title = f"{read.name} on {chosen.name}, {interpolation}: feeds in spec"
        print_table(title, ["from mm/s", "to mm/s"], rows)
        if found.verdict is None:
            typer.echo(f"no feed is in spec ({found.tried} tried)")
        else:
            assert found.best is not None
            typer.echo(
                f"fastest {found.best * 1e3:.2f} mm/s, limited by {found.limited_by}; "
                f"optimum (20 % margin) is {_optimum(found.best):.2f} mm/s or less; "
                f"{found.tried} feeds tried"
            )
            header, body = verdict_rows(found.verdict)
            print_table("verdict at the fastest", header, body)
    raise typer.Exit(0 if found.verdict is not None else 1)


def _optimum(best_m_s: float) -> float:
    return float(np.round(best_m_s * 1e3 / 1.2, 2))


def _metres_per_second(text: str) -> float:
    feed = parse_feed(text)
    if feed.mode != "fastest-axis":
        raise OptionError(f"{text!r}: the search runs in mm/s", remedy='Write it like "36 mm/s".')
    return feed.value


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("fastest")(fastest)
