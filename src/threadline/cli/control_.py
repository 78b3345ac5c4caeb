"""``threadline control``: design a controller for many sensors, and write it as a machine file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from threadline.cli import completion
from threadline.cli.arguments import JsonOption
from threadline.cli.output import check_outputs, print_json, print_table, say
from threadline.dynamics.state_designs import DESIGNS
from threadline.machine import load_machine
from threadline.report.analysis import analysis_tables
from threadline.search.controller_design import ControlDesign, DesignGoal, design_controllers


def control(
    machine: Annotated[
        str,
        typer.Argument(
            autocompletion=completion.machines,
            help="Machine file (.toml) or library name, overlays after a plus.",
        ),
    ],
    design: Annotated[str, typer.Option(help=f"One of {', '.join(DESIGNS)}.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Write the machine with the design here (.toml).")
    ],
    gain: Annotated[
        float | None,
        typer.Option(
            help="lqg, preview, zpetc: static gain, as a multiple of the present controllers'. "
            "Default: 1."
        ),
    ] = None,
    sensors: Annotated[
        str | None,
        typer.Option(help="lqg, preview, zpetc: sensors to read besides the encoders: x_pot."),
    ] = None,
    ahead: Annotated[
        int | None, typer.Option(help="preview: references to look ahead. Default: 4.")
    ] = None,
    smoothing: Annotated[
        int | None,
        typer.Option(
            help="zpetc: references, an odd number, in each of the four averages before the "
            "inverse: references are whole counts, and an inverse amplifies steps. Default: 1."
        ),
    ] = None,
    axes: Annotated[
        str | None,
        typer.Option(help="cross-coupled: the two axes. Default: the first two linear axes."),
    ] = None,
    direction: Annotated[
        str | None,
        typer.Option(
            help="cross-coupled: direction of the line, from the first axis. Default: 45 deg."
        ),
    ] = None,
    coupling: Annotated[
        str | None,
        typer.Option(
            help="cross-coupled: how much more an error across the line weighs than lag. "
            "Default: 50 %."
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Design a state-space controller for MACHINE, and write the machine with it.

    The design reads sensors only. The written file is MACHINE with other controllers: analyse,
    prove and compare it like any other. The loops of the written machine are shown.

    Exit status: 0 when every loop is stable, 1 when one is not, 2 wrong input.

    Example: threadline control stitcher --design lqg --gain 2 -o reports/stitcher-lqg.toml
    """
    goal = DesignGoal(
        design=design,
        gain=gain,
        sensors=_listed(sensors),
        ahead=ahead,
        smoothing=smoothing,
        axes=_listed(axes),
        direction=direction,
        coupling=coupling,
    )
    chosen = load_machine(machine)
    check_outputs(file=output)
    designed = design_controllers(chosen, goal, output)
    if json:
        print_json(designed.content())
    else:
        _show(designed)
    raise typer.Exit(0 if designed.stable else 1)


def _listed(text: str | None) -> tuple[str, ...] | None:
    """Return the names of a list with commas."""
    if text is None:
        return None
    return tuple(name.strip() for name in text.split(",") if name.strip())


def _show(designed: ControlDesign) -> None:
    for table in analysis_tables(designed.axes):
        print_table(table.title, table.header, table.rows)
    for controller in designed.controllers:
        delay = designed.delay_s(controller)
        delay_text = f"; it delays the motion by {1e3 * delay:g} ms" if delay else ""
        say(
            f"axes {', '.join(controller.axes)}: {len(controller.A)} states, from "
            f"{', '.join(controller.sensors)} to {', '.join(controller.drives)}{delay_text}"
        )
    for analysis in designed.axes.values():
        say(analysis.verdict())
    say(f"Wrote {designed.file}")


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("control")(control)
