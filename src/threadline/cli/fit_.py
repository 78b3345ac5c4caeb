"""``threadline fit``: numbers of a machine file from measured data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.base.writing import check_machine_output
from threadline.cli import completion
from threadline.cli.arguments import JsonOption, keep_inputs
from threadline.cli.output import check_outputs, print_json, print_table, say
from threadline.errors import OptionError
from threadline.identify.measured_data import open_data
from threadline.identify.parameter_fit import Fit, fit, parse_numbers, quantity_text, write_fitted
from threadline.machine import load_machine


def fit_numbers(
    data: Annotated[
        list[str],
        typer.Argument(
            help="Measured data: a response (.csv) or a recording. +OVERLAY:FILE was measured with "
            "an overlay of the machine, such as +unloaded:motor.csv; response:FILE is the response "
            "of a measured sweep in place of its raw run."
        ),
    ],
    machine: Annotated[
        str,
        typer.Option(
            "--machine",
            "-m",
            autocompletion=completion.machines,
            help="Machine file (.toml) or library name: first guesses.",
        ),
    ],
    numbers: Annotated[
        str,
        typer.Option(help="Numbers to fit, with commas: links.x_belt.stiffness,bodies.x.inertia."),
    ],
    axis: Annotated[
        str | None, typer.Option(help="Axis of data that does not name its own.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write the fitted machine here (.toml).")
    ] = None,
    job: Annotated[
        Path | None,
        typer.Option(
            help="With -o: also search the fastest way to do this job over the tolerances, before "
            "and after the fit; takes minutes."
        ),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Fit numbers of MACHINE to measured data, and say how well each is known.

    Every number comes with its 95 % interval and with the smallest deviation that any unbiased fit
    of the same data could reach. Numbers that the data does not determine are refused.

    Exit status: 0 when every number was fitted, 2 wrong input.

    Example: threadline fit examples/stitcher-x-sweep.csv -m stitcher --axis X --numbers
    links.x_belt.stiffness,bodies.x_head.inertia,bodies.x_head.damping,drives.x.delay -o mine.toml
    """
    chosen = load_machine(machine)
    names = parse_numbers(numbers, chosen)
    if output is not None:
        check_machine_output(output)
        keep_inputs(output, chosen.file, *(Path(text.rpartition(":")[2]) for text in data))
    elif job is not None:
        raise OptionError("--job needs the fitted machine as a file", remedy="Add -o FILE.toml.")
    check_outputs(file=output)
    data_sets = [open_data(text, machine, axis or "") for text in data]
    result = fit(chosen, data_sets, names)
    source = ", ".join(one.name for one in data_sets)
    if output is not None:
        write_fitted(result, source, output)
    if not json:
        _show(result, source)
        if output is not None:
            say(f"Wrote {output}")
    worth = None if job is None or output is None else _worth(job, machine, output)
    if json:
        print_json(_content(result, source, output) | ({} if worth is None else {"worth": worth}))
    elif worth is not None:
        unit = worth["unit"] or "of the programmed feed"
        before, after = (
            "nothing in spec" if worth[key] is None else f"{worth[key]:.4g} {unit}"
            for key in ("before", "after")
        )
        say(f"{job} over the tolerances: {before} before the fit, {after} after it")


def _worth(job: Path, machine: str, fitted: Path) -> dict[str, Any]:
    """Return the fastest of a job over the tolerances, of the machine before and after the fit."""
    from threadline.face import fastest

    before, after = (fastest(job, one, level="over tolerances") for one in (machine, str(fitted)))
    return {"before": before.best, "after": after.best, "unit": after.unit}


def _show(result: Fit, source: str) -> None:
    rows = []
    for number in result.numbers:
        times_guess = number.value / number.quantity.si
        profile_text = "-" if number.profile is None else _ends(number.profile, number.value)
        rows.append(
            [
                number.name,
                quantity_text(number, source).partition(",")[0],
                f"{times_guess:.4g}",
                f"{100.0 * number.deviation:.2g} %",
                f"{100.0 * number.least_deviation:.2g} %",
                profile_text,
            ]
        )
    header = ["number", "value, 95 %", "times guess", "deviation", "least possible", "profile"]
    print_table(f"Fitted to {source}", header, rows)
    for first, second, r in result.correlated:
        say(f"{first} and {second} are correlated: {r:+.2f}")
    for name, noise in result.noise.items():
        say(f"{name}: noise {noise:.3g} (standard deviation of a residual)")
    if result.estimate.outliers:
        say(f"{result.estimate.outliers} of {len(result.estimate.residual)} values lie far off")
    for text in result.unexplained:
        say(f"NOT EXPLAINED {text}")
    if not result.unexplained:
        say("The fit explains the data everywhere within its noise")


def _ends(ends: tuple[float, float], value: float) -> str:
    return f"{100.0 * (ends[0] / value - 1.0):+.2g} ... {100.0 * (ends[1] / value - 1.0):+.2g} %"


def _content(result: Fit, source: str, output: Path | None) -> dict[str, Any]:
    content: dict[str, Any] = {
        "machine": result.machine.name,
        "data": source,
        "numbers": {
            n.name: {
                "value": n.value,
                "unit": n.quantity.unit,
                "text": quantity_text(n, source),
                "before": n.quantity.si,
                "deviation": n.deviation,
                "least_deviation": n.least_deviation,
                "interval": list(n.interval),
                "profile": None if n.profile is None else list(n.profile),
            }
            for n in result.numbers
        },
        "correlation": result.estimate.correlation.tolist(),
        "noise": dict(result.noise),
        "outliers": result.estimate.outliers,
        "unexplained": list(result.unexplained),
    }
    if output is not None:
        content["written"] = str(output)
    return content


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("fit")(fit_numbers)
