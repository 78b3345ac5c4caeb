"""Read a file of measured data as a recorded run or as a frequency response."""

from __future__ import annotations

from pathlib import Path

from threadline.base.reading import read_text
from threadline.errors import OptionError, Place, RecordingError
from threadline.files.formats import read_recording
from threadline.identify.experiment_run import response_of
from threadline.identify.frequency_domain import ResponseData
from threadline.identify.measured_response import MeasuredResponse
from threadline.identify.parameter_fit import Data
from threadline.identify.read_response import MAX_BYTES, read_response, rows_of
from threadline.identify.recorded_run import check_run
from threadline.identify.time_domain import recording_data
from threadline.machine import Machine, load_machine

_OF_SWEEP = "response:"
_RECORDINGS = (".npz", ".mcap", ".plt")


def open_data(text: str, machine: str, axis: str = "") -> Data:
    """Return the measured data in a file, ready for a fit.

    Parameters
    ----------
    text
        Name of a file, or ``+OVERLAY:FILE`` if the machine had an overlay during the measurement.
        ``response:FILE`` reads the frequency response that ``threadline measure`` stored in the
        recording of a sweep, instead of the recording itself.
    machine
        Name of the machine file, with overlays after plus signs.
    axis
        Axis of a response that names none, or the only axis to use of a recording.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    OptionError
        If the machine has no such axis, or no control loops for a recording.
    """
    overlay, file = "", text
    if text.startswith("+"):
        overlay, colon, file = text.partition(":")
        if not colon or not file:
            raise OptionError(
                f"{text[:60]!r} names no file", remedy="Write it like +unloaded:motor.csv."
            )
    return read_data(file, load_machine(machine + overlay), axis)


def read_data(file: str, machine: Machine, axis: str = "") -> Data:
    """Return the data that was measured on ``machine``, from a file or ``response:FILE``.

    Raises
    ------
    RecordingError, OptionError
        See ``open_data``.
    """
    if file.startswith(_OF_SWEEP):
        path = Path(file.removeprefix(_OF_SWEEP))
        return ResponseData(machine=machine, measured=_response_in(path, machine), axis=axis)
    path = Path(file)
    if path.suffix.lower() in _RECORDINGS or _is_trace(path):
        return recording_data(read_recording(path), machine, path, axis)
    return ResponseData(machine=machine, measured=read_response(path), axis=axis)


def _response_in(path: Path, machine: Machine) -> MeasuredResponse:
    """Return the frequency response that is stored in the recording of a sweep."""
    recording, place = read_recording(path), Place(str(path))
    response = response_of(recording.origin, place)
    if response is None:
        raise RecordingError(
            "it has no response",
            place=place,
            remedy="threadline measure --experiment sweep writes one.",
        )
    # The response names only its axis: the run itself shows whether this machine made it.
    if response.axis in machine.axes and machine.axes[response.axis].controller:
        check_run(recording, machine, response.axis, place)
    return response


def _is_trace(path: Path) -> bool:
    """Return whether a table is a recording: it has a column of time, and a response has none."""
    _, rows = rows_of(
        read_text(path, MAX_BYTES, RecordingError, "file of measured data", "utf-8-sig")
    )
    _, header = next(rows, (1, []))
    return any(cell.strip('" ').lower().startswith("time") for cell in header)
