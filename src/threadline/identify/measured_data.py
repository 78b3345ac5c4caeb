"""Open measured data by the content of its file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from threadline.base.reading import read_text
from threadline.errors import OptionError, Place, RecordingError
from threadline.files.formats import read_recording
from threadline.identify.experiment_run import response_of
from threadline.identify.frequency_domain import ResponseData
from threadline.identify.measured_response import MeasuredResponse
from threadline.identify.parameter_fit import Data
from threadline.identify.read_response import MAX_BYTES, read_response, rows_of
from threadline.identify.time_domain import recording_data
from threadline.machine import load_machine

_OF_SWEEP = "response:"
_RECORDINGS = (".npz", ".mcap", ".plt")


def open_data(text: str, machine: str, axis: str = "") -> Data:
    """Return measured data, ready to be fitted.

    Parameters
    ----------
    text
        Name of a file, or ``+OVERLAY:FILE`` if it was measured with an overlay of the machine.
        ``response:FILE`` is the response of a measured sweep, in place of its raw run.
    machine
        Name of the machine file, with overlays after plus signs.
    axis
        Axis of a response that does not name its own.

    Raises
    ------
    RecordingError
        If the file cannot be read.
    OptionError
        If the data does not fit the machine.
    """
    overlay, file = "", text
    if text.startswith("+"):
        overlay, colon, file = text.partition(":")
        if not colon or not file:
            raise OptionError(
                f"{text[:60]!r} names no file", remedy="Write it like +unloaded:motor.csv."
            )
    chosen = load_machine(machine + overlay)
    if file.startswith(_OF_SWEEP):
        path = Path(file.removeprefix(_OF_SWEEP))
        return ResponseData(machine=chosen, measured=_response_in(path), axis=axis)
    path = Path(file)
    if path.suffix.lower() in _RECORDINGS or _is_trace(path):
        return recording_data(read_recording(path), chosen, path, axis)
    return ResponseData(machine=chosen, measured=read_response(path), axis=axis)


def _response_in(path: Path) -> MeasuredResponse:
    """Return the response that a measured sweep has beside its raw run."""
    found = response_of(read_recording(path).origin)
    if found is None:
        raise RecordingError(
            "it has no response",
            place=Place(str(path)),
            remedy="threadline measure --experiment sweep writes one.",
        )
    return replace(found, place=Place(str(path)))


def _is_trace(path: Path) -> bool:
    """Return whether a table begins with a column of time: a recording, not a response."""
    _, rows = rows_of(
        read_text(path, MAX_BYTES, RecordingError, "file of measured data", "utf-8-sig")
    )
    _, header = next(rows, (1, []))
    return any(cell.strip('" ').lower().startswith("time") for cell in header)
