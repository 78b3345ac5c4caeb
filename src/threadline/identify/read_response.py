"""Readers of frequency responses from analysers: a table of frequency, magnitude and phase."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from threadline.base.arrays import FloatArray
from threadline.base.reading import read_text
from threadline.errors import Place, RecordingError
from threadline.identify.measured_response import OUTPUTS, MeasuredResponse, check_response
from threadline.units import same_dimension, unit_factor

MAX_BYTES = 20_000_000
MAX_POINTS = 200_000
_FIRST_LINE_REMEDY = "The first line must name frequency_hz, magnitude_db, phase_deg."
_HEADING = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(?:\[\s*(?P<unit>[^\[\]]*?)\s*\])?\s*")
_COMMENT = re.compile(r"#\s*(?P<key>[a-z]+)\s*:\s*(?P<value>.*?)\s*")


@dataclass(frozen=True, slots=True)
class _Columns:
    """Places of the columns, and how their values are read."""

    frequency: int
    to_hertz: float
    magnitude: int
    decibel: bool
    unit: str  # SI, per volt; empty for a relative magnitude
    scale: float
    phase: int
    to_radian: float
    coherence: int | None

    @property
    def places(self) -> list[int]:
        found = [self.frequency, self.magnitude, self.phase]
        return found if self.coherence is None else [*found, self.coherence]


def rows_of(text: str) -> tuple[dict[str, str], Iterator[tuple[int, list[str]]]]:
    """Return the ``# key: value`` lines above a table, and its lines with their numbers.

    Cells are separated by commas, semicolons or tabs, whichever the first line has most of.
    """
    lines = list(enumerate(text.splitlines(), start=1))
    comments: dict[str, str] = {}
    index = 0
    while index < len(lines) and (
        not lines[index][1].strip() or lines[index][1].lstrip().startswith("#")
    ):
        match = _COMMENT.fullmatch(lines[index][1].strip())
        if match:
            comments[match["key"]] = match["value"]
        index += 1
    heading = lines[index][1] if index < len(lines) else ""
    separator = max(",;\t", key=heading.count)
    rows = (
        (number, [cell.strip() for cell in line.split(separator)])
        for number, line in lines[index:]
        if line.strip() and not line.lstrip().startswith("#")
    )
    return comments, rows


def read_response(path: Path) -> MeasuredResponse:
    """Read a table of a measured frequency response.

    The columns are ``frequency_hz``, ``magnitude_db`` and ``phase_deg``, in any order; or
    ``frequency [rad/s]``, ``magnitude [rad/s/V]``, ``magnitude_db [count/V]``, ``phase [rad]`` with
    their units, and ``coherence``. A magnitude without a unit has an unknown reference. Lines ``#
    axis: X`` and ``# output: sensors.x_pot`` above the table name the measured output.

    Raises
    ------
    RecordingError
        If a column is missing, a line does not hold finite numbers, frequencies do not increase, or
        a coherence is outside 0 to 1.
    """
    name = str(path)
    text = read_text(path, MAX_BYTES, RecordingError, "measured response", "utf-8-sig")
    comments, rows = rows_of(text)
    number, header = next(rows, (1, []))
    columns = _columns(header, Place(name, number))
    points: list[list[float]] = []
    for number, row in rows:
        point = _numbers(row, columns.places, Place(name, number))
        if points and point[0] <= points[-1][0]:
            raise RecordingError(
                f"frequency {point[0] * columns.to_hertz:g} Hz does not increase",
                place=Place(name, number),
                remedy="Sort the lines by frequency.",
            )
        points.append(point)
        if len(points) > MAX_POINTS:
            raise RecordingError(
                f"more than {MAX_POINTS} points", place=Place(name, number), remedy="Thin them."
            )
    if not points:
        raise RecordingError("the file holds no points", place=Place(name))
    return _response(np.array(points), columns, comments, Place(name))


def _response(
    table: FloatArray, columns: _Columns, comments: dict[str, str], place: Place
) -> MeasuredResponse:
    magnitude = table[:, 1]
    if not columns.decibel and (magnitude <= 0.0).any():
        raise RecordingError(
            f"magnitude {magnitude[int(np.argmax(magnitude <= 0.0))]:g} is not above 0",
            place=place,
            remedy="Remove the points without a magnitude.",
        )
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        magnitude = 10.0 ** (magnitude / 20.0) if columns.decibel else magnitude
        value = magnitude * columns.scale * np.exp(1j * table[:, 2] * columns.to_radian)
    response = MeasuredResponse(
        frequency_hz=table[:, 0] * columns.to_hertz,
        value=np.asarray(value, dtype=np.complex128),
        coherence=None if columns.coherence is None else table[:, 3],
        unit=columns.unit,
        axis=comments.get("axis", ""),
        output=comments.get("output", ""),
        place=place,
    )
    check_response(response)
    return response


def _columns(header: list[str], place: Place) -> _Columns:
    headings: dict[str, tuple[int, str]] = {}
    for index, cell in enumerate(header):
        match = _HEADING.fullmatch(cell.strip('"'))
        if match:
            headings.setdefault(match["name"].lower(), (index, match["unit"] or ""))

    def heading(*names: str) -> tuple[str, int, str]:
        for name in names:
            if name in headings:
                return (name, *headings[name])
        raise RecordingError(
            f"column {names[0]!r} is missing", place=place, remedy=_FIRST_LINE_REMEDY
        )

    name, frequency, unit = heading("frequency_hz", "frequency", "freq")
    to_hertz = 1.0
    if name != "frequency_hz":
        to_hertz = 1.0 / (2.0 * math.pi) if unit == "rad/s" else unit_factor(unit or "Hz", "Hz")
    name, magnitude, unit = heading("magnitude_db", "magnitude")
    decibel = name == "magnitude_db" or unit.lower() == "db"
    unit = "" if unit.lower() == "db" else unit
    si, scale = _output_unit(unit, place) if unit else ("", 1.0)
    name, phase, phase_unit = heading("phase_deg", "phase")
    to_radian = (
        math.radians(1.0) if name == "phase_deg" else unit_factor(phase_unit or "deg", "rad")
    )
    return _Columns(
        frequency=frequency,
        to_hertz=to_hertz,
        magnitude=magnitude,
        decibel=decibel,
        unit=si,
        scale=scale,
        phase=phase,
        to_radian=to_radian,
        coherence=headings["coherence"][0] if "coherence" in headings else None,
    )


def _output_unit(text: str, place: Place) -> tuple[str, float]:
    """Return the SI unit of an output per volt, and the factor from ``text`` to it."""
    unit = text.removesuffix("/V").strip()
    for si in OUTPUTS if text.endswith("/V") else ():
        if same_dimension(unit, si):
            return si, unit_factor(unit, si)
    raise RecordingError(
        f"a magnitude in {text[:40]!r} is not an output per volt",
        place=place,
        remedy="Write it like [rad/s/V], [count/V] or [mm/s/V].",
    )


def _numbers(row: list[str], places: list[int], place: Place) -> list[float]:
    text = ",".join(row)[:60]
    try:
        values = [float(row[k]) for k in places]
    except (IndexError, ValueError) as error:
        count = {3: "three", 4: "four"}[len(places)]
        raise RecordingError(f"{text!r} does not hold {count} numbers", place=place) from error
    if not all(math.isfinite(v) for v in values) or values[0] <= 0:
        raise RecordingError(
            f"{text!r} must hold finite numbers and a frequency above 0", place=place
        )
    return values
