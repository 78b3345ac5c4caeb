"""The option ``--radius``: radii of the rotary axes for one job."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

from pydantic import ValidationError

from threadline.base.reading import read_text
from threadline.errors import OptionError, UnitError
from threadline.machine.mandrel import Mandrel
from threadline.machine.model import Machine
from threadline.machine.parts import Axis
from threadline.machine.quantity import Quantity, parse_machine_quantity

_TABLE = ".csv"
_MOST_BYTES = 1_000_000
_PLACE = re.compile(r"(?P<radius>.+?)\s+at\s+(?P<along>[A-Z])\s+(?P<at>.+)")
_FORM = 'Write it like "A=40 mm", "A=20 mm at X 0 mm; 50 mm at X 100 mm" or "A=mandrel.csv".'
_COLUMN = re.compile(r"(?P<along>[A-Z])_mm")
_RADIUS = "radius_mm"


def with_radii(machine: Machine, text: str | None) -> Machine:
    """Return ``machine`` with radii of its rotary axes, given like ``"A=40 mm, B=2 mm"``.

    A mandrel may have different radii along a linear axis: ``"A=20 mm at X 0 mm; 50 mm at X 100
    mm"``. With None the machine is returned unchanged.

    Raises
    ------
    OptionError
        If the text cannot be read, or names an axis that is not rotary.
    """
    if text is None:
        return machine
    axes = dict(machine.axes)
    text = written_out(text)
    for part in text.split(","):
        name, equals, written = (piece.strip() for piece in part.partition("="))
        axis = machine.axes.get(name)
        if not equals or axis is None or axis.kind != "rotary":
            turning = ", ".join(sorted(machine.rotary & machine.axes.keys())) or "none"
            raise OptionError(
                f"--radius {part.strip()[:40]!r} is not the radius of a rotary axis of "
                f"{machine.name!r}",
                remedy=f"{_FORM} Its rotary axes: {turning}.",
            )
        if axes[name] is not axis:
            raise OptionError(
                f"--radius {text[:80]!r} gives {name} two radii", remedy="Give each axis one."
            )
        axes[name] = _with_radius(axis, written, machine, f"--radius {part.strip()[:40]!r}")
    return replace(machine, axes=axes)


def written_out(text: str) -> str:
    """Return the text of ``--radius`` with each table (``A=mandrel.csv``) replaced by its rows.

    The stored options of a plan then contain the rows and do not depend on the file. A table has
    the columns ``X_mm`` (or another linear axis) and ``radius_mm``.

    Raises
    ------
    OptionError
        If a table cannot be read.
    """
    parts = []
    for part in text.split(","):
        name, _, written = (piece.strip() for piece in part.partition("="))
        parts.append(f"{name}={_rows(Path(written))}" if written.endswith(_TABLE) else part.strip())
    return ", ".join(parts)


def _with_radius(axis: Axis, written: str, machine: Machine, option: str) -> Axis:
    if " at " not in written:
        return replace(axis, radius=_length(written, option, positive=True), profile=None)
    matches = [_PLACE.fullmatch(place.strip()) for place in written.split(";")]
    places = [match for match in matches if match is not None]
    along_axes = {match["along"] for match in places}
    if len(places) < len(matches) or len(along_axes) > 1:
        raise OptionError(f"{option} is not a profile along one axis", remedy=_FORM)
    along_axis = along_axes.pop()
    if along_axis not in machine.axes or machine.axes[along_axis].kind != "linear":
        raise OptionError(
            f"{option} is along {along_axis}, not a linear axis of {machine.name!r}", remedy=_FORM
        )
    try:
        profile = Mandrel(
            along=along_axis,
            at=tuple(_length(match["at"], option) for match in places),
            radius=tuple(_length(match["radius"], option, positive=True) for match in places),
        )
    except ValidationError as error:
        reason = str(error.errors()[0]["msg"]).removeprefix("Value error, ")
        raise OptionError(f"{option}: {reason}", remedy=_FORM) from error
    return replace(axis, radius=None, profile=profile)


def _length(written: str, option: str, *, positive: bool = False) -> Quantity:
    try:
        length = parse_machine_quantity(f"{written.strip()} exact, assumed", ("m",))
    except UnitError as error:
        raise OptionError(f"{option}: {error.message}", remedy=_FORM) from error
    if positive and length.si <= 0.0:
        raise OptionError(f"{option}: a radius must be greater than 0", remedy=_FORM)
    return length


def _rows(table: Path) -> str:
    """Return the rows of a table of radii as text: ``20 mm at X 0 mm; 50 mm at X 100 mm``."""
    text = read_text(table, _MOST_BYTES, OptionError, "table of radii", "utf-8-sig")
    rows = [row for row in csv.reader(text.splitlines()) if any(map(str.strip, row))]
    header = [name.strip() for name in rows[0]] if rows else []
    along_axes = [match["along"] for name in header if (match := _COLUMN.fullmatch(name))]
    if len(header) != 2 or len(along_axes) != 1 or _RADIUS not in header:
        raise OptionError(
            f"{table}: a table of radii has the columns X_mm and {_RADIUS}",
            remedy=f"Begin it with the line X_mm,{_RADIUS} (X: the axis along the mandrel).",
        )
    radius_column, place_column = header.index(_RADIUS), 1 - header.index(_RADIUS)
    parts = []
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(header) or any("," in cell or ";" in cell for cell in row):
            raise OptionError(
                f"{table}: row {number} has {len(row)} columns, the header has {len(header)}",
                remedy="Give each row a position and a radius, with decimal points.",
            )
        parts.append(
            f"{row[radius_column].strip()} mm at {along_axes[0]} {row[place_column].strip()} mm"
        )
    return "; ".join(parts)
