"""Open measured data by the content of its file."""

from __future__ import annotations

from pathlib import Path

from threadline.errors import OptionError
from threadline.identify.fitted import Data
from threadline.identify.of_responses import ResponseData
from threadline.identify.read_response import read_response
from threadline.machine import load_machine


def open_data(text: str, machine: str, axis: str = "") -> Data:
    """Return measured data, ready to be fitted.

    Parameters
    ----------
    text
        Name of a file, or ``+OVERLAY:FILE`` if it was measured with an overlay of the machine.
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
    return ResponseData(machine=chosen, measured=read_response(Path(file)), axis=axis)
