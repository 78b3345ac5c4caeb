"""``threadline connect``: read the settings of a controller from the controller itself."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from threadline.base.writing import staged_file
from threadline.cli.arguments import JsonOption
from threadline.cli.from_settings import read_rows, settings_of
from threadline.cli.output import check_outputs, print_json, print_table, say
from threadline.errors import OptionError
from threadline.live.settings_link import KLIPPER, ask_controller

_BAUD = {"min": 1200, "max": 4_000_000}


def connect(
    address: Annotated[
        str,
        typer.Argument(
            metavar="ADDRESS",
            help="Serial device (/dev/ttyUSB0), HOST:PORT, or http://HOST:7125 of a Moonraker.",
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="File to write; default KIND-settings.txt."),
    ] = None,
    baud: Annotated[
        int | None,
        typer.Option(
            "--baud", **_BAUD, help="Speed of the serial device; 115200 and 250000 are tried."
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Read the settings of a controller from the controller, and write them to a file.

    Nothing moves and no setting is changed. Opening a serial line restarts many boards, with
    any sender. grbl, grblHAL, FluidNC, Marlin and RepRapFirmware answer over a serial line or
    the network, Klipper through Moonraker. threadline new --from reads the file.

    Example: threadline connect /dev/ttyUSB0
    """
    if output is not None:
        _check(output)
    answer = ask_controller(address, baud)
    file = output
    if file is None:
        file = Path("printer.cfg" if answer.kind == KLIPPER else f"{answer.kind}-settings.txt")
        _check(file)
    with staged_file(file) as staged:
        staged.write(answer.text.encode("utf-8"))
    settings = settings_of(answer.kind, file)
    rows = read_rows(settings)
    command = f"threadline new {answer.kind} my-machine --from {shlex.quote(str(file))}"
    if json:
        keys = ("setting", "value", "from")
        print_json(
            {
                "kind": answer.kind, "identity": answer.identity, "file": str(file),
                "read": [dict(zip(keys, row, strict=True)) for row in rows],
                "notes": settings.notes, "left_out": settings.ignored, "new": command,
            }
        )  # fmt: skip
        return
    say(f"{answer.kind}: {answer.identity}")
    print_table(f"settings in {file}", ("setting", "value", "from"), rows)
    for text in (*settings.notes, *settings.ignored):
        say(f"  {text}")
    say(f"Next: {command}")


def _check(file: Path) -> None:
    check_outputs(file=file)
    if file.exists():
        raise OptionError(
            f"{str(file)!r} is there already", remedy="Name another file with --output."
        )


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("connect")(connect)
