"""``threadline guide``: a sheet of axes, signals and connectors, and the calibration of drives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.cli import completion
from threadline.cli.arguments import JsonOption, named_folder
from threadline.cli.output import check_outputs, print_json, say
from threadline.machine import load_machine
from threadline.report.guide import guide_of, write_guide


def guide(
    machine: Annotated[
        str,
        typer.Argument(
            autocompletion=completion.machines, help="Machine file (TOML) or name of the library."
        ),
    ],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            "-o",
            parser=named_folder,
            metavar="<path>",
            help="Folder for the guide: HTML and PDF.",
        ),
    ] = Path("guide"),
    json: JsonOption = False,
) -> None:
    """Write the guide to MACHINE: axes, signals, connectors, and the calibration of its drives.

    Everything follows from the machine file; its [guide] table lists the connectors and the
    calibration steps from the drives' manual.

    Example: threadline guide lathe-winder -o reports/guide
    """
    chosen = load_machine(machine)
    check_outputs(folder=out)
    page = write_guide(chosen, out)
    if json:
        document = guide_of(chosen)
        tables = [
            {
                "title": t.title,
                "header": list(t.header),
                "rows": [list(row) for row in t.rows],
                "note": t.note,
            }
            for t in document.tables
        ]
        print_json({"machine": chosen.name, "guide": str(page), "tables": tables})
    else:
        say(f"Guide: {page}, and {page.with_suffix('.pdf').name} beside it")


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("guide")(guide)
