"""Measured frequency responses from CSV, and their distance from the model's."""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from threadline.arrays import FloatArray
from threadline.errors import Place, RecordingError
from threadline.input_files import read_text
from threadline.plant.loop import Loop

_COLUMNS = ("frequency_hz", "magnitude_db", "phase_deg")
_MAX_BYTES = 20_000_000
_MAX_POINTS = 200_000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredResponse:
    """Motor speed per volt as a frequency response analyser measures it.

    Parameters
    ----------
    frequency_hz, magnitude_db, phase_deg
        (k,), rising in frequency; the magnitude may have any reference.
    """

    frequency_hz: FloatArray
    magnitude_db: FloatArray
    phase_deg: FloatArray

    def against(self, loop: Loop) -> tuple[float, float]:
        """Return the root mean square distances from the model in dB and in degrees.

        Magnitudes are compared after both were normalised to the first point.
        """
        magnitude, phase = speed_response(loop, 2 * np.pi * self.frequency_hz)
        level = magnitude - magnitude[0] + self.magnitude_db[0]
        turn = (phase - self.phase_deg + 180.0) % 360.0 - 180.0
        return (
            float(np.sqrt(np.mean((level - self.magnitude_db) ** 2))),
            float(np.sqrt(np.mean(turn**2))),
        )


def speed_response(loop: Loop, omega_rad_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return magnitude, in (k,) dB relative to zero frequency, and (k,) phase of speed per volt.

    It is the continuous response of amplifier and plant, without the sampling of the controller.
    """
    own = loop.own()

    def speed(omega: FloatArray) -> FloatArray:
        return np.asarray(1j * omega * own.response(omega)[:, 0, 0])

    still = abs(speed(omega_rad_s[:1] * 1e-3)[0])
    response = speed(omega_rad_s)
    return (
        np.asarray(20.0 * np.log10(np.abs(response) / still)),
        np.asarray(np.degrees(np.unwrap(np.angle(response)))),
    )


def read_response(path: Path) -> MeasuredResponse:
    """Read a CSV file with the columns ``frequency_hz``, ``magnitude_db`` and ``phase_deg``.

    Raises
    ------
    RecordingError
        If a column is missing, or a line doesn't hold three finite numbers, rising in frequency.
    """
    name = str(path)
    text = read_text(path, _MAX_BYTES, RecordingError, "measured response", "utf-8-sig")
    rows = csv.reader(text.splitlines())
    header = [cell.strip() for cell in next(rows, [])]
    for column in _COLUMNS:
        if column not in header:
            raise RecordingError(
                f"column {column!r} is missing",
                place=Place(name, 1),
                remedy=f"The first line must name {', '.join(_COLUMNS)}.",
            )
    places = [header.index(column) for column in _COLUMNS]
    points: list[list[float]] = []
    for number, row in enumerate(rows, start=2):
        if not row:
            continue
        points.append(_numbers(row, places, Place(name, number)))
        if len(points) > 1 and points[-1][0] <= points[-2][0]:
            raise RecordingError(
                f"frequency {points[-1][0]:g} Hz does not rise",
                place=Place(name, number),
                remedy="Sort the lines by frequency.",
            )
        if len(points) > _MAX_POINTS:
            raise RecordingError(
                f"more than {_MAX_POINTS} points", place=Place(name, number), remedy="Thin them."
            )
    if not points:
        raise RecordingError("the file holds no points", place=Place(name))
    table = np.array(points)
    return MeasuredResponse(
        frequency_hz=table[:, 0], magnitude_db=table[:, 1], phase_deg=table[:, 2]
    )


def _numbers(row: list[str], places: list[int], place: Place) -> list[float]:
    try:
        values = [float(row[k]) for k in places]
    except (IndexError, ValueError) as error:
        raise RecordingError(
            f"{','.join(row)[:60]!r} does not hold three numbers", place=place
        ) from error
    if not all(math.isfinite(v) for v in values) or values[0] <= 0:
        raise RecordingError(
            f"{','.join(row)[:60]!r} must hold finite numbers and a frequency above 0", place=place
        )
    return values
