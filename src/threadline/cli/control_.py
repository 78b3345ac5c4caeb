"""``threadline control``: design a controller for many sensors, and write it as a machine file."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.cli.arguments import JsonOption, keep_inputs
from threadline.cli.output import check_outputs, print_json, print_table, say
from threadline.dynamics.analysis import AxisAnalysis, analyse
from threadline.dynamics.contouring import cross_coupled
from threadline.dynamics.design_overlay import overlay_text
from threadline.dynamics.state_designs import (
    DESIGNS,
    PREVIEW,
    Designed,
    lqg,
    preview,
    regulators,
    zero_phase,
    zero_phase_ticks,
)
from threadline.errors import OptionError
from threadline.files.formats.common import atomic_file
from threadline.machine import Machine, load_machine
from threadline.machine.load import split_reference
from threadline.report.analysis import analysis_tables
from threadline.units import parse_quantity

_MOST_GAIN = 100.0
_MOST_SMOOTHING = 15


def control(
    machine: Annotated[
        str, typer.Argument(help="Machine file (.toml) or library name, overlays after a plus.")
    ],
    design: Annotated[str, typer.Option(help=f"One of {', '.join(DESIGNS)}.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Write the machine with the design here (.toml).")
    ],
    gain: Annotated[
        float,
        typer.Option(
            help="lqg, preview, zpetc: gain at rest, in gains at rest of the present controllers."
        ),
    ] = 1.0,
    sensors: Annotated[
        str, typer.Option(help="lqg, preview, zpetc: sensors to read besides the encoders: x_pot.")
    ] = "",
    ahead: Annotated[int, typer.Option(help="preview: references to look ahead.")] = 4,
    smoothing: Annotated[
        int,
        typer.Option(
            help="zpetc: references, an odd number, in each of the four averages before the "
            "inverse: whole counts step, and an inverse makes much of steps."
        ),
    ] = 1,
    axes: Annotated[
        str, typer.Option(help="cross-coupled: the two axes; without it the first two linear ones.")
    ] = "",
    direction: Annotated[
        str, typer.Option(help="cross-coupled: direction of the line, from the first axis.")
    ] = "45 deg",
    coupling: Annotated[
        str,
        typer.Option(help="cross-coupled: what an error across the line weighs more than lag."),
    ] = "50 %",
    json: JsonOption = False,
) -> None:
    """Design a state-space controller for MACHINE, and write the machine with it.

    The design reads sensors only. The written file is MACHINE with other controllers: analyse,
    prove and compare it like any other. The loops of the written machine are shown.

    Exit status: 0 when every loop is stable, 1 when one is not, 2 wrong input.

    Example: threadline control stitcher --design lqg --gain 2 -o reports/stitcher-lqg.toml
    """
    chosen = load_machine(machine)
    _check(chosen, design, output)
    keep_inputs(output, chosen.file)
    check_outputs(file=output)
    words = f"threadline control {machine} --design {design}"
    if design == "cross-coupled":
        pair = _pair(chosen, axes)
        theta = parse_quantity(direction, "rad")
        weight = parse_quantity(coupling, "")
        if not 0.0 <= weight <= _MOST_GAIN:
            raise OptionError(f"--coupling {coupling!r} is not between 0 and {_MOST_GAIN:.0%}")
        words += f" --axes {','.join(pair)} --direction {math.degrees(theta):g}deg"
        words += f" --coupling {100 * weight:g}%"
        found = [cross_coupled(chosen, pair, theta, weight)]
    else:
        found, said = _of_regulators(chosen, design, (gain, sensors, ahead, smoothing))
        words += said
    text = overlay_text(chosen, _base(machine, chosen, output), words, found)
    with atomic_file(output) as stream:
        stream.write(text.encode())
    analyses = analyse(load_machine(str(output)))
    stable = all(one.stable for one in analyses.values())
    if json:
        print_json(_content(chosen, design, found, analyses, output))
    else:
        _show(chosen, found, analyses, output)
    raise typer.Exit(0 if stable else 1)


def _check(machine: Machine, design: str, output: Path) -> None:
    if design not in DESIGNS:
        raise OptionError(f"no design {design!r}", remedy=f"There are: {', '.join(DESIGNS)}.")
    if not machine.controllers or machine.takes_positions:
        raise OptionError(
            f"machine {machine.name!r} has no control loops, so there is no controller to design",
            remedy="Name a machine with controllers and axes.",
        )
    if output.suffix != ".toml" or output.name.endswith(".spec.toml"):
        raise OptionError(
            f"{str(output)!r} is no name for a machine file",
            remedy="Give one that ends in .toml and not in .spec.toml.",
        )


def _of_regulators(
    machine: Machine, design: str, told: tuple[float, str, int, int]
) -> tuple[list[Designed], str]:
    """Return the designs of all pieces with a regulator, and the options that made them."""
    gain, sensors, ahead, smoothing = told
    if not 0.0 < gain <= _MOST_GAIN:
        raise OptionError(f"--gain {gain:g} is not above 0 and at most {_MOST_GAIN:g}")
    if design == "preview" and not PREVIEW[0] <= ahead <= PREVIEW[1]:
        raise OptionError(f"--ahead {ahead} is not from {PREVIEW[0]} to {PREVIEW[1]}")
    if smoothing % 2 == 0 or not 1 <= smoothing <= _MOST_SMOOTHING:
        raise OptionError(f"--smoothing {smoothing} is no odd number from 1 to {_MOST_SMOOTHING}")
    others = tuple(name.strip() for name in sensors.split(",") if name.strip())
    found = regulators(machine, gain, others)
    said = f" --gain {gain:g}" + (f" --sensors {','.join(others)}" if others else "")
    if design == "lqg":
        return [lqg(one) for one in found], said
    if design == "preview":
        return [preview(one, ahead) for one in found], f"{said} --ahead {ahead}"
    late = max(zero_phase_ticks(one, smoothing) for one in found)
    made = [zero_phase(one, late, smoothing) for one in found]
    return made, f"{said} --smoothing {smoothing}"


def _pair(machine: Machine, axes: str) -> tuple[str, str]:
    linear = [name for name, axis in machine.axes.items() if axis.kind == "linear"]
    names = [name.strip() for name in axes.split(",")] if axes else linear[:2]
    if len(names) != 2 or len(set(names)) != 2 or not set(names) <= set(machine.axes):
        raise OptionError(
            f"--axes {axes or ', '.join(names)!r} is no pair of the axes of {machine.name!r}",
            remedy=f"It has: {', '.join(machine.axes)}.",
        )
    return names[0], names[1]


def _base(reference: str, machine: Machine, output: Path) -> str:
    """Return the machine's reference as seen from the folder of the output."""
    name, overlays = split_reference(reference)
    if name.endswith(".toml"):
        name = os.path.relpath(machine.file, output.parent)
    return "+".join([Path(name).as_posix(), *overlays])


def _content(
    machine: Machine,
    design: str,
    found: list[Designed],
    analyses: dict[str, AxisAnalysis],
    output: Path,
) -> dict[str, Any]:
    return {
        "machine": machine.name,
        "design": design,
        "controllers": [
            {"axes": list(one.axes), "sensors": list(one.sensors), "states": len(one.A),
             "delay_s": _delay_s(machine, one)}
            for one in found
        ],
        "axes": {axis: analysis.as_json() for axis, analysis in analyses.items()},
        "stable": all(one.stable for one in analyses.values()),
        "written": str(output),
    }  # fmt: skip


def _delay_s(machine: Machine, design: Designed) -> float:
    return design.delay_ticks * float(machine.clock(design.clock).period_s)


def _show(
    machine: Machine, found: list[Designed], analyses: dict[str, AxisAnalysis], output: Path
) -> None:
    for table in analysis_tables(analyses):
        print_table(table.title, table.header, table.rows)
    for one in found:
        delay = _delay_s(machine, one)
        late = f"; it delays the motion by {1e3 * delay:g} ms" if delay else ""
        say(
            f"axes {', '.join(one.axes)}: {len(one.A)} states, from {', '.join(one.sensors)} to "
            f"{', '.join(one.drives)}{late}"
        )
    for analysis in analyses.values():
        say(analysis.verdict())
    say(f"Wrote {output}")


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("control")(control)
