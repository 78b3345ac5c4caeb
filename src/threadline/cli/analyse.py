"""``threadline analyse``: margins, poles, modes and actuators of a machine's loops."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.cli import completion
from threadline.cli.arguments import JsonOption, ReportOption
from threadline.cli.messages import warning
from threadline.cli.output import print_json, print_table, say
from threadline.dynamics.lead import LeadDesign, design_lead
from threadline.dynamics.loop import axis_loop
from threadline.dynamics.plausibility import plausibility_warnings
from threadline.dynamics.without_loop import Analysis, analyse_moving
from threadline.errors import OptionError
from threadline.identify.read_response import read_response
from threadline.machine import Machine, load_machine
from threadline.machine.controllers import LeadFilter
from threadline.machine.numbers import with_numbers
from threadline.report.analysis import analysis_tables, write_analysis
from threadline.search.experiments import run_experiments
from threadline.units import parse_quantity

_LEAD_EXAMPLE = 'Write it like --lead "13.5 Hz, 65 deg".'


def analyse(
    machine: Annotated[
        str,
        typer.Argument(
            autocompletion=completion.machines,
            help="Machine file (.toml) or library name, overlays after a plus.",
        ),
    ],
    axis: Annotated[str | None, typer.Option(help="Only this axis.")] = None,
    data: Annotated[
        Path | None,
        typer.Option(
            help="Measured speed per volt (CSV: frequency_hz, magnitude_db, phase_deg) of --axis."
        ),
    ] = None,
    lead: Annotated[
        str | None,
        typer.Option(help='Design lead filters first: crossover and margin, "13.5 Hz, 65 deg".'),
    ] = None,
    experiments: Annotated[
        bool,
        typer.Option(help="Also sweep, run and step the simulated machine, quantised."),
    ] = False,
    report: ReportOption = None,
    json: JsonOption = False,
) -> None:
    """Analyse the loops of MACHINE: margins, bandwidth, poles, modes, actuators, steps.

    A cylinder has no loop: the output says so and lists its modes.

    Each loop is analysed twice: sampled, as it runs, and continuous with its exact dead time.
    --lead first designs lead filters for the given crossover and phase margin. Exit status: 0 when
    every loop is stable, 1 when one is not, 2 wrong input.

    Example: threadline analyse stitcher --axis X --report reports/stitcher
    """
    chosen = load_machine(machine)
    if axis is not None and axis not in chosen.moving:
        raise OptionError(
            f"machine {chosen.name!r} has no axis {axis!r}",
            remedy=f"It has: {', '.join(chosen.moving)}.",
        )
    names = list(chosen.moving) if axis is None else [axis]
    loop_options = {"--data": data is not None, "--lead": lead is not None}
    used = [
        name for name, given in (loop_options | {"--experiments": experiments}).items() if given
    ]
    without_loop = [n for n in names if n not in chosen.axes or not chosen.axes[n].controller]
    if used and without_loop:
        raise OptionError(
            f"{used[0]} needs a loop, and axis {without_loop[0]} of {chosen.name!r} has none",
            remedy="Leave it out, or name a machine with controllers and axes.",
        )
    if data is not None and axis is None and len(chosen.axes) > 1:
        raise OptionError(
            "--data was measured on one axis, the machine has several",
            remedy="Name it with --axis.",
        )
    measured = None if data is None else read_response(data)
    designs = {} if lead is None else _designs(chosen, names, lead)
    replaced = {k: v for design, name in designs.values() for k, v in design.replaced(name).items()}
    if replaced:  # the rest of the analysis uses the designed filters
        chosen = with_numbers(chosen, replaced)
    analyses = {name: analyse_moving(chosen, name) for name in names}
    deviations = (
        {}
        if measured is None
        else {name: measured.against(axis_loop(chosen, name)) for name in names}
    )
    warnings = plausibility_warnings(chosen)
    tried = {name: run_experiments(chosen, name) for name in names} if experiments else {}
    written = (
        None
        if report is None
        else write_analysis(chosen, analyses, warnings, report, measured, tried)
    )
    if json:
        points = 0 if measured is None else len(measured.frequency_hz)
        content = _content(chosen.name, analyses, warnings, deviations, points, written)
        for name, (design, _) in designs.items():
            content["axes"][name]["lead"] = _lead_json(design)
        for name, outcome in tried.items():
            content["axes"][name]["experiments"] = outcome.as_json()
        print_json(content)
    else:
        for warning_text in warnings:
            warning(warning_text)
        for table in analysis_tables(analyses):
            print_table(table.title, table.header, table.rows)
        for outcome in tried.values():
            print_table(*outcome.table())
            say(outcome.summary())
        for name, (design, controller) in designs.items():
            k, a, b = design.continuous
            say(
                f"axis {name}: controllers.{controller} gain {design.gain:.4f} dac/count, zero "
                f"{design.zero:.4f}, pole {design.pole:.4f}; {k:.4g} (s + {a:.1f})/(s + {b:.0f}) "
                "V/count"
            )
        for analysis in analyses.values():
            say(analysis.verdict())
            if analysis.axis in deviations:
                level, phase = deviations[analysis.axis]
                say(
                    f"axis {analysis.axis}: the measured response is {level:.2f} dB and "
                    f"{phase:.1f} deg (rms) from the model"
                )
        if written is not None:
            say(f"Report: {written}")
    raise typer.Exit(0 if all(a.stable for a in analyses.values()) else 1)


def _content(
    name: str,
    analyses: dict[str, Analysis],
    warnings: list[str],
    deviations: dict[str, tuple[float, float]],
    points: int,
    written: Path | None,
) -> dict[str, Any]:
    axes: dict[str, Any] = {key: a.as_json() for key, a in analyses.items()}
    for key, (level, phase) in deviations.items():
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


def _designs(machine: Machine, axes: list[str], text: str) -> dict[str, tuple[LeadDesign, str]]:
    """Return the lead filter of every axis and the name of its controller."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2:
        raise OptionError(f"--lead {text!r} is not a crossover and a margin", remedy=_LEAD_EXAMPLE)
    crossover = parse_quantity(parts[0], "Hz")
    margin = math.degrees(parse_quantity(parts[1], "rad"))
    designs = {}
    for axis in axes:
        name = machine.axes[axis].controller
        if not isinstance(machine.controllers[name], LeadFilter):
            raise OptionError(
                f"--lead: controllers.{name} of axis {axis} is no lead filter",
                remedy='Give it kind = "lead" in the machine file.',
            )
        designs[axis] = (design_lead(axis_loop(machine, axis), crossover, margin), name)
    return designs


def _lead_json(design: LeadDesign) -> dict[str, float]:
    k, a, b = design.continuous
    return {
        "gain_dac_per_count": design.gain,
        "zero": design.zero,
        "pole": design.pole,
        "continuous_gain_v_per_count": k,
        "continuous_zero_per_s": a,
        "continuous_pole_per_s": b,
    }


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("analyse")(analyse)
