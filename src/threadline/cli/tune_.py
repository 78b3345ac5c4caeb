"""``threadline tune``: amplifiers and controllers, by several rules, side by side on jobs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from threadline.base.wording import toml_string
from threadline.base.writing import check_machine_output
from threadline.cli import completion
from threadline.cli.arguments import JsonOption, SpecOption, keep_inputs
from threadline.cli.output import check_outputs, print_json, print_table, progress_bar, say
from threadline.errors import OptionError
from threadline.files.formats.common import atomic_file
from threadline.identify.amplifier_trim import AxisTrim, trim
from threadline.identify.experiment_run import LINKS
from threadline.identify.parameter_fit import base_lines
from threadline.machine import Machine, load_machine
from threadline.machine.numbers import number_at, number_tables
from threadline.search.tune import (
    parse_controller,
    parse_rule,
    tune,
    tuning_goal,
    usual_controller,
    write_tuned,
)
from threadline.search.tuning import MEASURES, RULES, JobRun, TunedAxis, Tuning, label
from threadline.units import parse_quantity
from threadline.verdict.spec import load_spec


def tune_loops(
    machine: Annotated[
        str,
        typer.Argument(
            autocompletion=completion.machines,
            help="Machine file (.toml) or library name, overlays after a plus.",
        ),
    ],
    axis: Annotated[str | None, typer.Option(help="Only this axis.")] = None,
    margin: Annotated[
        str | None,
        typer.Option(
            help="Phase margin of the rule margin, which also asks for a gain margin of 2. "
            "Default: 60 deg."
        ),
    ] = None,
    crossover: Annotated[
        str | None,
        typer.Option(
            help='Crossover of the rule margin: "13.5 Hz". Default: the largest gain at low '
            "frequencies."
        ),
    ] = None,
    job: Annotated[
        list[Path] | None,
        typer.Option(help="Simulate this job with each controller; repeatable."),
    ] = None,
    spec: SpecOption = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Write a machine file with one of the controllers."),
    ] = None,
    controller: Annotated[
        str | None,
        typer.Option(
            autocompletion=completion.one_of(lambda: ("p", "pi", "pd", "pid", "lead")),
            help="With -o: p, pi, pd, pid or lead. Default: the machine's own kind.",
        ),
    ] = None,
    rule: Annotated[
        str | None,
        typer.Option(
            autocompletion=completion.one_of(lambda: RULES),
            help=f"With -o: {', '.join(RULES)}. Default: margin.",
        ),
    ] = None,
    amplifiers: Annotated[
        bool,
        typer.Option(
            "--trim",
            help="Instead, run the axes at constant speeds over a link, and print the factors by "
            "which the potentiometers of the amplifiers must change their gains.",
        ),
    ] = False,
    amplitude: Annotated[
        str | None, typer.Option(help='With --trim: largest deviation from the start, "40 mm".')
    ] = None,
    link: Annotated[str, typer.Option(help=f"With --trim: {', '.join(LINKS)}.")] = "sim",
    actual: Annotated[
        str | None,
        typer.Option(
            autocompletion=completion.machines,
            help="With --trim over sim: machine that is simulated in place of MACHINE.",
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Tune the loops of MACHINE: PE, PI, PD, PID and lead controllers by several rules.

    The rules are margin (phase and gain margin), ultimate and step (Ziegler and Nichols), and
    settling (Kp and Kd that settle fastest). Each controller comes with its margins, the worst
    margins over the tolerances of the machine file, and its step; with --job also with contour
    error, stitch length, settling and current of the job. Nothing moves without --trim.

    Exit status: 0, 2 wrong input, 3 when the machine or its link failed.

    Example: threadline tune lathe-winder --axis X --job examples/x-180.prg -o reports/tuned.toml
    """
    chosen = load_machine(machine)
    if output is not None:
        check_machine_output(output)
        keep_inputs(output, chosen.file, spec, *(job or ()))
    check_outputs(file=output)
    if amplifiers:
        design_options = {
            "--job": job, "--spec": spec, "--crossover": crossover, "--controller": controller,
            "--margin": margin, "--rule": rule,
        }  # fmt: skip
        if given := [word for word, value in design_options.items() if value]:
            raise OptionError(
                "--trim measures amplifiers and designs no controllers",
                remedy=f"Leave out {', '.join(given)}.",
            )
        _trim(chosen, axis, amplitude, (link, actual), output, json=json)
        return
    if actual is not None or amplitude is not None or link != "sim":
        raise OptionError("--link, --actual and --amplitude are for --trim", remedy="Add --trim.")
    for word, value in (("--controller", controller), ("--rule", rule)):
        if output is None and value is not None:
            raise OptionError(f"{word} says what -o writes", remedy="Add -o FILE.toml.")
    if spec is not None and not job:
        raise OptionError("--spec is the specification of jobs", remedy="Add --job FILE.")
    kind = usual_controller(chosen) if controller is None else parse_controller(controller)
    tuning_rule = parse_rule(rule or "margin")
    goal = tuning_goal(chosen, axis, margin or "60 deg", crossover)
    job_spec = None if spec is None else load_spec(spec, chosen)
    with progress_bar(not json) as progress:
        tuning = tune(chosen, goal, job or (), job_spec, progress)
    if output is not None:
        write_tuned(tuning, kind, tuning_rule, output)
    if json:
        print_json(tuning.content() | ({} if output is None else {"written": str(output)}))
        return
    _show(tuning)
    if output is not None:
        say(f"Wrote {output}")


def _trim(
    machine: Machine,
    axis: str | None,
    amplitude: str | None,
    link_and_actual: tuple[str, str | None],
    output: Path | None,
    *,
    json: bool,
) -> None:
    linear = axis is None or axis not in machine.axes or machine.axes[axis].kind == "linear"
    if amplitude is not None and axis is None:
        raise OptionError("--amplitude is for one axis", remedy="Name it with --axis.")
    link, actual = link_and_actual
    trims = trim(
        machine,
        () if axis is None else (axis,),
        link=link,
        actual=None if actual is None else load_machine(actual),
        amplitude=None
        if amplitude is None
        else parse_quantity(amplitude, "m" if linear else "rad"),
    )
    if output is not None:
        _write_gains(machine, trims, output)
    if json:
        content = {
            axis_trim.axis: {
                "factor": axis_trim.factor,
                "interval": axis_trim.interval,
                "speed_per_volt": axis_trim.speed_per_volt,
                "wanted": axis_trim.wanted,
            }
            for axis_trim in trims
        }
        print_json(
            {"machine": machine.name, "axes": content}
            | ({} if output is None else {"written": str(output)})
        )
        return
    rows = [
        [
            axis_trim.axis,
            f"{axis_trim.speed_per_volt:.5g}",
            f"{axis_trim.wanted:.5g}",
            f"{axis_trim.factor:.4f}",
            f"{100 * axis_trim.interval:.2g} %",
        ]
        for axis_trim in trims
    ]
    header = ["axis", "count/s/V", "wanted", "turn gain by", "95 %"]
    print_table("Amplifiers, from runs at constant speeds", header, rows)
    if output is not None:
        say(f"Wrote {output}")


def _write_gains(machine: Machine, found: tuple[AxisTrim, ...], file: Path) -> None:
    """Write a machine file with the gains as they were found, before any potentiometer turns."""
    numbers = {}
    for axis_trim in found:
        path = f"drives.{axis_trim.drive}.amplifier.gain"
        old = number_at(machine, path)
        percent = max(100.0 * axis_trim.interval, 0.01)
        numbers[path] = (
            f"{old.si / axis_trim.factor:.6g} {old.unit}".strip()
            + f" +- {percent:.2g} %, measured: threadline tune --trim"
        )
    lines = [
        "# Gains of the amplifiers as threadline tune --trim found them.",
        *base_lines(machine, file.parent),
        f"name = {toml_string(machine.name.split('+')[0] + '-as-found')}",
        *number_tables(numbers),
    ]
    with atomic_file(file) as stream:
        stream.write(("\n".join(lines) + "\n").encode())


def _show(found: Tuning) -> None:
    for axis in found.axes:
        header = ["controller", "gains", "Hz", "deg", "gain", "worst deg", "worst gain",
                  "settles ms", "overshoot %"]  # fmt: skip
        print_table(f"Axis {axis.axis} of {found.machine.name}", header, _rows(axis))
        if axis.limit is not None:
            smooth = (
                "overshoots at any gain"
                if axis.smooth_kp is None
                else f"no overshoot up to {axis.smooth_kp:.4g} dac/count"
            )
            say(
                f"axis {axis.axis}, proportional: {smooth}; swings on at {axis.limit.kp:.4g} "
                f"dac/count with {1e3 * axis.limit.period_s:.4g} ms, on the simulated machine"
            )
        for text in axis.left_out:
            say(f"axis {axis.axis}, left out: {text}")
    for job in dict.fromkeys(run.job for run in found.runs):
        runs = [run for run in found.runs if run.job == job]
        header = ["controller", "contour mm", "stitch length %", "settles ms", "current A"]
        print_table(f"{job} on the simulated machine, in one run", header, [*map(_job_row, runs)])


def _rows(axis: TunedAxis) -> list[list[str]]:
    rows = []
    for loop in axis.loops:
        figures = loop.figures.as_json()
        gains = " ".join(f"{key} {value:.4g}" for key, value in loop.gains.items())
        if not loop.figures.stable:
            rows.append([loop.name, gains, "unstable", *["-"] * 6])
            continue
        worst, step = loop.worst, loop.step
        rows.append(
            [
                loop.name,
                gains,
                _number(figures["crossover_hz"], ".1f"),
                _number(figures["phase_margin_deg"], ".1f"),
                _number(figures["gain_margin"], ".2f"),
                _number(worst.phase_margin_deg, ".1f") if worst.stable else "unstable",
                _number(worst.gain_margin, ".2f") if worst.stable else "unstable",
                "-" if step is None else f"{1e3 * step.settling_s:.0f}",
                "-" if step is None else f"{100 * step.overshoot:.1f}",
            ]
        )
    return rows


def _job_row(run: JobRun) -> list[str]:
    if run.verdict is None:
        return [label(run.kind, run.rule), "unstable", "-", "-", "-"]
    factors = (1e3, 1e2, 1e3, 1.0)
    cells = []
    for name, factor in zip(MEASURES, factors, strict=True):
        value = run.worst(name)
        if value is not None and math.isinf(value):
            cells.append("never")
        else:
            cells.append(_number(None if value is None else factor * value, ".3g"))
    return [label(run.kind, run.rule), *cells]


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else f"{value:{form}}"


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("tune")(tune_loops)
