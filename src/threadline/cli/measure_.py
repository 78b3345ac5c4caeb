"""``threadline measure``: an experiment on one axis of a machine, for ``threadline fit``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from threadline.cli import completion
from threadline.cli.arguments import JsonOption, keep_inputs
from threadline.cli.output import check_outputs, print_json, print_table, say
from threadline.errors import LinkFaultError
from threadline.files import RunEnd
from threadline.files.formats import write_recording
from threadline.identify.experiment_run import (
    LINKS,
    Measurement,
    Prediction,
    check_measurement_file,
    check_same_axes,
    measure,
    predict,
)
from threadline.identify.planned_experiment import EXPERIMENTS, experiment, parse_band
from threadline.live.sim_machine import parse_fault
from threadline.machine import Machine, load_machine
from threadline.units import parse_quantity


def measure_axis(
    machine: Annotated[
        str,
        typer.Argument(
            autocompletion=completion.machines,
            help="Machine file (.toml) or library name, overlays after a plus.",
        ),
    ],
    axis: Annotated[str, typer.Option(help="The axis that moves.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Write the measurement here (.npz or .mcap).")
    ],
    kind: Annotated[str, typer.Option("--experiment", help=f"{', '.join(EXPERIMENTS)}.")] = "sweep",
    amplitude: Annotated[
        str | None,
        typer.Option(
            help='Largest deviation from the start: "2 mm". Default: a twentieth of the travel; '
            "less where speed or acceleration would exceed a share of the limits."
        ),
    ] = None,
    band: Annotated[
        str | None, typer.Option(help='Lowest and highest frequency of a sweep: "1 Hz, 60 Hz".')
    ] = None,
    link: Annotated[str, typer.Option(help=f"Link to the machine: {', '.join(LINKS)}.")] = "sim",
    actual: Annotated[
        str | None,
        typer.Option(help="With --link sim: machine that is simulated in place of MACHINE."),
    ] = None,
    inject: Annotated[
        str | None, typer.Option(help="With --link sim: a fault at a time: lost-link@1 s.")
    ] = None,
    dry: Annotated[
        bool, typer.Option("--dry", help="Only predict the motion; nothing runs.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Move one axis of MACHINE and record it, for a fit of its numbers.

    The experiment is simulated first; if it would leave the travel, exceed the speed of the axis or
    reach the limit of the current, nothing moves. The file has the raw run and, of a sweep, the
    response of the encoder in counts per volt of the controller, with its coherence.

    Exit status: 0 when the whole experiment ran, 2 wrong input, 3 when the machine or its link
    failed; the recording until then is written.

    Example: threadline measure lathe-winder --axis X --experiment sweep -o sweep.npz
    """
    chosen = load_machine(machine)
    check_measurement_file(output)
    keep_inputs(output, chosen.file)
    check_outputs(file=output)
    unit = "m" if chosen.axes.get(axis) is None or chosen.axes[axis].kind == "linear" else "rad"
    planned = experiment(
        chosen,
        axis,
        kind,
        amplitude=None if amplitude is None else parse_quantity(amplitude, unit),
        band_hz=None if band is None else parse_band(band),
    )
    actual_machine = None if actual is None else load_machine(actual)
    if actual_machine is not None:
        check_same_axes(chosen, actual_machine)
    fault = None if inject is None else parse_fault(inject, chosen)
    prediction = predict(chosen, planned)
    if not json:
        say(_foreseen(chosen, axis, kind, prediction))
    if dry:
        if json:
            print_json({"predicted": _predicted(prediction)})
        return
    measurement = measure(chosen, planned, link=link, actual=actual_machine, fault=fault)
    write_recording(measurement.recording, output)
    if measurement.ended is not RunEnd.COMPLETED:
        raise LinkFaultError(
            f"the measurement ended early: {measurement.why or measurement.ended.value}",
            remedy=f"{output} has the recording until then.",
        )
    if json:
        print_json(_content(prediction, measurement, output))
        return
    if measurement.response is not None:
        _show(measurement)
    elif kind == "sweep":
        say("The link reports no volts, so the file has no response; fit the raw run")
    say(f"Wrote {output}")


def _foreseen(machine: Machine, axis: str, kind: str, found: Prediction) -> str:
    unit, factor = ("mm", 1e3) if machine.axes[axis].kind == "linear" else ("rad", 1.0)
    return (
        f"{kind} of {axis} in {found.duration_s:.3g} s: from {found.lowest * factor:.4g} to "
        f"{found.highest * factor:.4g} {unit}, up to {found.speed * factor:.4g} {unit}/s and "
        f"{found.current_a:.3g} A by the machine file"
    )


def _show(found: Measurement) -> None:
    response = found.response
    assert response is not None and response.coherence is not None
    rows = [
        [f"{f:.4g}", f"{magnitude_db:.2f}", f"{phase:.1f}", f"{coherence:.4f}"]
        for f, magnitude_db, phase, coherence in zip(
            response.frequency_hz,
            response.magnitude_db,
            response.phase_deg,
            response.coherence,
            strict=True,
        )
    ]
    header = ["Hz", "dB of 1 count/V", "deg", "coherence"]
    print_table(f"Response of {response.output} to the volts of axis {response.axis}", header, rows)


def _predicted(found: Prediction) -> dict[str, float]:
    return {
        "duration_s": found.duration_s,
        "lowest": found.lowest,
        "highest": found.highest,
        "speed": found.speed,
        "current_a": found.current_a,
    }


def _content(foreseen: Prediction, found: Measurement, output: Path) -> dict[str, Any]:
    content: dict[str, Any] = {"predicted": _predicted(foreseen), "written": str(output)}
    if (response := found.response) is not None and response.coherence is not None:
        content["response"] = {
            "axis": response.axis,
            "output": response.output,
            "unit": f"{response.unit}/V",
            "frequency_hz": response.frequency_hz.tolist(),
            "magnitude_db": response.magnitude_db.tolist(),
            "phase_deg": response.phase_deg.tolist(),
            "coherence": response.coherence.tolist(),
        }
    return content


def register(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("measure")(measure_axis)
