"""``tl.measure``, ``tl.fit`` and ``tl.trim``: the commands of that name as Python functions."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from threadline.base.arguments import checked
from threadline.base.writing import check_machine_output
from threadline.machine import Machine, load_machine
from threadline.proof.python_arguments import in_arguments
from threadline.units import parse_quantity

if TYPE_CHECKING:
    from threadline.identify.amplifier_trim import AxisTrim
    from threadline.identify.experiment_run import Measurement
    from threadline.identify.parameter_fit import Fit


@in_arguments
@checked
def fit(
    data: str | Path | Sequence[str | Path],
    machine: str | Path,
    numbers: Sequence[str],
    out: str | Path | None = None,
    *,
    axis: str = "",
) -> Fit:
    """Fit numbers of a machine file to measured data; print nothing, and write ``out`` if given.

    Parameters
    ----------
    data
        A file, or several: responses, recordings, ``"+OVERLAY:FILE"`` and ``"response:FILE"`` as on
        the command line.
    machine
        Machine file, or name in the library; its numbers are the first guesses.
    numbers
        Dotted names, such as ``["bodies.x.inertia"]``.
    out
        Machine file to write.
    axis
        Axis of data that does not name its own.

    Raises
    ------
    InputError
        As on the command line.
    """
    from threadline.identify.measured_data import open_data
    from threadline.identify.parameter_fit import fit as fitted
    from threadline.identify.parameter_fit import parse_numbers, write_fitted

    files = [data] if isinstance(data, str | Path) else list(data)
    machine_read = load_machine(str(machine))
    names = parse_numbers(",".join(numbers), machine_read)
    data_files = [open_data(str(file), str(machine), axis) for file in files]
    if out is not None:
        check_machine_output(Path(out))
    result = fitted(machine_read, data_files, names)
    if out is not None:
        write_fitted(result, ", ".join(data_read.name for data_read in data_files), Path(out))
    return result


@in_arguments
@checked
def measure(
    machine: str | Path,
    axis: str,
    out: str | Path | None = None,
    *,
    experiment: str = "sweep",
    amplitude: str | None = None,
    band: str | None = None,
    link: str = "sim",
    actual: str | Machine | None = None,
) -> Measurement:
    """Predict an experiment on one axis, run it, and return the recording.

    Parameters
    ----------
    machine, axis
        The machine file or its name in the library, and the axis that moves.
    out
        File of the measurement (``.npz``, ``.mcap``).
    experiment
        ``"sweep"``, ``"steps"``, ``"constant"``, ``"coast"`` or ``"backlash"``.
    amplitude
        Largest deviation from the start, ``"2 mm"``.
    band
        Lowest and highest frequency of a sweep, ``"1 Hz, 60 Hz"``.
    link
        ``"sim"``, ``"hal:plant"`` or ``"hal:loopback"``.
    actual
        With ``"sim"``: machine that is simulated in place of ``machine``.

    Raises
    ------
    InputError
        As on the command line; nothing has moved then.
    LinkFaultError
        If the machine does not answer.
    """
    from threadline.files.formats import write_recording
    from threadline.identify.experiment_run import check_measurement_file, predict
    from threadline.identify.experiment_run import measure as measured
    from threadline.identify.planned_experiment import experiment as planned_of
    from threadline.identify.planned_experiment import parse_band

    machine_read = load_machine(str(machine))
    if out is not None:
        check_measurement_file(Path(out))
    unit = "rad" if axis in machine_read.axes and machine_read.axes[axis].kind == "rotary" else "m"
    planned = planned_of(
        machine_read,
        axis,
        experiment,
        amplitude=None if amplitude is None else parse_quantity(amplitude, unit),
        band_hz=None if band is None else parse_band(band),
    )
    predict(machine_read, planned)
    far_machine = load_machine(actual) if isinstance(actual, str) else actual
    result = measured(machine_read, planned, link=link, actual=far_machine)
    if out is not None:
        write_recording(result.recording, Path(out))
    return result


@in_arguments
@checked
def trim(
    machine: str | Path,
    axis: str | None = None,
    *,
    link: str = "sim",
    actual: str | Machine | None = None,
) -> tuple[AxisTrim, ...]:
    """Run axes at constant speeds; return the factors for the potentiometers of their amplifiers.

    Parameters
    ----------
    machine
        Its file or its name in the library.
    axis
        The axis to run; None: all axes with a control loop.
    link
        ``"sim"``, ``"hal:plant"`` or ``"hal:loopback"``.
    actual
        With ``"sim"``: machine that is simulated in place of ``machine``.

    Raises
    ------
    InputError
        As on the command line; nothing has moved then.
    LinkFaultError
        If the machine does not answer, or a run ended early.
    """
    from threadline.identify.amplifier_trim import trim as trimmed

    return trimmed(
        load_machine(str(machine)),
        () if axis is None else (axis,),
        link=link,
        actual=load_machine(actual) if isinstance(actual, str) else actual,
    )
