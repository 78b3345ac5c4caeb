"""The fitted machine as a file, based on the machine before the fit."""

from __future__ import annotations

import os
from pathlib import Path

from threadline.base.wording import ascii_only, toml_string
from threadline.files.formats.common import atomic_file
from threadline.identify.parameter_fit import Fit, FittedNumber
from threadline.machine import Machine
from threadline.machine.load import split_reference
from threadline.machine.numbers import number_tables
from threadline.units import unit_factor

_UNITS = {"s": "ms", "m": "mm", "H": "mH", "N*m": "N m", "kg*m^2": "kg m^2", "N*s/m": "N s/m",
          "N*m*s/rad": "N m s/rad", "N*m/A": "N m/A"}  # fmt: skip
_LEAST_PERCENT, _MOST_PERCENT = 1e-4, 99.0


def quantity_text(number: FittedNumber, source: str) -> str:
    """Return a fitted number as text of a machine file.

    Parameters
    ----------
    source
        Source of the measurement, for the note.
    """
    unit = _UNITS.get(number.quantity.unit, number.quantity.unit)
    value = number.value / (unit_factor(unit, number.quantity.unit) if unit else 1.0)
    percent = min(max(100.0 * number.tolerance, _LEAST_PERCENT), _MOST_PERCENT)
    return f"{value:.6g} {unit}".strip() + f" +- {percent:.2g} %, measured: {source}"


def base_lines(machine: Machine, folder: Path) -> list[str]:
    """Return the line of a machine file in ``folder`` that bases it on another machine."""
    name, overlays = split_reference(machine.reference)
    base = machine.reference
    if name.endswith(".toml"):
        base = "+".join([os.path.relpath(Path(name).resolve(), folder.resolve()), *overlays])
    return [f"base = {toml_string(base)}"]


def fitted_toml(result: Fit, source: str, folder: Path) -> str:
    """Return the fitted machine as text of its file, to lie in ``folder``."""
    machine = result.machine
    note = ascii_only(source)
    lines = [
        f"# Fitted by threadline fit to {note}; every tolerance is a 95 % interval.",
        *base_lines(machine, folder),
        f"name = {toml_string(machine.name.split('+')[0] + '-fitted')}",
        f"title = {toml_string(machine.title + ', fitted')}",
        *number_tables({n.name: quantity_text(n, f"fit to {note}") for n in result.numbers}),
    ]
    return "\n".join(lines) + "\n"


def write_fitted(result: Fit, source: str, file: Path) -> None:
    """Write the fitted machine.

    Raises
    ------
    RecordingError
        If the file cannot be written.
    """
    text = fitted_toml(result, source, file.parent)
    with atomic_file(file) as stream:
        stream.write(text.encode())
