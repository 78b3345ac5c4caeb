"""``threadline analyse``: what a machine's loops, modes and actuators are like."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.cli.options import JsonOption, ReportOption
from threadline.cli.output import note, print_json, print_table
from threadline.errors import OptionError
from threadline.machine import load_machine
from threadline.plant.analysis import AxisAnalysis, analyse_axis
from threadline.plant.measured import MeasuredResponse, read_response
from threadline.plant.suspicions import suspicions
from threadline.report.analysis import analysis_tables, write_analysis


def analyse(
    machine: Annotated[
        str, typer.Argument(help="Machine file (.toml) or library name, overlays after a plus.")
    ],
    axis: Annotated[str | None, typer.Option(help="Only this axis.")] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            help="Measured speed per volt (CSV: frequency_hz, magnitude_db, phase_deg) of --axis."
        ),
    ] = None,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Analyse the loops of MACHINE: margins, bandwidth, poles, modes, actuators, steps.

    Both the true sampled loop and the continuous one with its exact dead time. Exit status: 0
    when every loop is stable, 1 when one is not, 2 wrong input.

    Example: threadline analyse stitcher --axis X --report reports/stitcher
    """
    chosen = load_machine(machine)
    if axis is not None and axis not in chosen.axes:
        raise OptionError(
            f"machine {chosen.name!r} has no axis {axis!r}",
            remedy=f"It has: {', '.join(chosen.axes)}.",
        )
    if data is not None and axis is None and len(chosen.axes) > 1:
        raise OptionError(
            "--data was measured on one axis, the machine has several",
            remedy="Name it with --axis.",
        )
    measured = None if data is None else read_response(data)
    names = list(chosen.axes) if axis is None else [axis]
    analyses = {name: analyse_axis(chosen, name) for name in names}
    warnings = suspicions(chosen)
    written = (
        None if report is None else write_analysis(chosen, analyses, warnings, report, measured)
    )
    if json:
        print_json(_content(chosen.name, analyses, warnings, measured, written))
    else:
        for warning in warnings:
            note(f"warning: {warning}")
        for table in analysis_tables(analyses):
            print_table(table.title, table.header, table.rows)
        for analysis in analyses.values():
            typer.echo(analysis.verdict())
            if measured is not None:
                level, phase = measured.against(analysis.loop)
                typer.echo(
                    f"axis {analysis.axis}: the measured response is {level:.2f} dB and "
                    f"{phase:.1f} deg (rms) from the model"
                )
        if written is not None:
            typer.echo(f"Report: {written}")
    raise typer.Exit(0 if all(a.stable for a in analyses.values()) else 1)


def _content(
    name: str,
    analyses: dict[str, AxisAnalysis],
    warnings: list[str],
    measured: MeasuredResponse | None,
    written: Path | None,
) -> dict[str, Any]:
    axes: dict[str, Any] = {key: a.as_json() for key, a in analyses.items()}
    if measured is not None:
        for key, analysis in analyses.items():
            level, phase = measured.against(analysis.loop)
            points = len(measured.frequency_hz)
            axes[key]["measured"] = {"points": points, "rms_db": level, "rms_deg": phase}
    content: dict[str, Any] = {
        "machine": name,
        "stable": all(a.stable for a in analyses.values()),
        "axes": axes,
        "warnings": warnings,
    }
    if written is not None:
        content["report"] = str(written)
    return content


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("analyse")(analyse)
