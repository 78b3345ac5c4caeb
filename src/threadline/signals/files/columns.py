"""Headings of the columns of a recorded trace: ``time [s]``, ``X [mm]``, ``A.load [deg]``."""

from __future__ import annotations

import re
from dataclasses import dataclass

from threadline.errors import Place, RecordingError, UnitError
from threadline.foreign_messages import nearest
from threadline.signals.recording import ChannelKind
from threadline.units import same_dimension, unit_factor

AXES = ("A", "B", "C", "U", "V", "W", "X", "Y", "Z")
TIME = "time"

_COLUMN = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*(?:\[\s*(?P<unit>[^\[\]]*?)\s*\])?\s*")
_SWITCHED = re.compile(r"(?P<name>[A-Za-z][A-Za-z0-9_-]*)\.(?P<kind>output|input)")
"""An output or input of the PLC, by its name in the machine file; 0 or 1."""
_POSITIONS = frozenset(
    {
        ChannelKind.COMMANDED,
        ChannelKind.MEASURED,
        ChannelKind.LOAD,
        ChannelKind.FRAME,
        ChannelKind.TOOL,
    }
)
_UNITS = {ChannelKind.VOLTAGE: ("V",), ChannelKind.CURRENT: ("A",)}
_PER_AXIS = tuple(k for k in ChannelKind if k in _POSITIONS or k in _UNITS)


def units_of(kind: ChannelKind) -> tuple[str, ...]:
    """Return the SI units that a channel of ``kind`` may have; none where it has no unit."""
    return _UNITS.get(kind, ("m", "rad") if kind in _POSITIONS else ())


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a trace: its channel, and the factor from its unit to the SI unit."""

    name: str
    kind: ChannelKind | None  # None for the time
    axis: str
    unit: str
    factor: float


def parse_column(text: str, place: Place) -> Column:
    """Return the channel that the heading of a column names.

    ``X [mm]`` is the measured position of axis X; ``X.load [mm]`` and the like name another kind
    of channel; ``operation`` has no unit, nor have ``valve.output`` and ``switch.input``, which
    are outputs and inputs of a PLC.

    Raises
    ------
    RecordingError
        If the name is unknown or the unit missing or wrong.
    """
    match = _COLUMN.fullmatch(text.strip().strip('"'))
    if match is None:
        raise RecordingError(
            f"{text.strip()[:60]!r} is not the name of a column",
            place=place,
            remedy='Write it like "X [mm]".',
        )
    name, unit = match["name"], match["unit"]
    if name == TIME:
        return Column(TIME, None, "", "s", _factor(name, unit, ("s",), place))
    if name == ChannelKind.OPERATION:
        if unit:
            raise RecordingError(f"{name!r} has no unit, found [{unit[:20]}]", place=place)
        return Column(name, ChannelKind.OPERATION, "", "", 1.0)
    switched = _SWITCHED.fullmatch(name)
    if switched is not None:
        if unit:
            raise RecordingError(f"{name[:60]!r} has no unit, found [{unit[:20]}]", place=place)
        return Column(switched["name"], ChannelKind(switched["kind"]), "", "", 1.0)
    axis, dot, kind_name = name.partition(".")
    known = [f"{axis}.{kind.value}" for kind in _PER_AXIS]
    if axis not in AXES or (dot and name not in known):
        among = known if axis in AXES else [TIME, *AXES, str(ChannelKind.OPERATION)]
        raise RecordingError(
            f"unknown column {name[:60]!r}",
            place=place,
            remedy=f"{nearest(name, among)} Take columns out that are not to be judged.",
        )
    kind = ChannelKind(kind_name) if dot else ChannelKind.MEASURED
    units = units_of(kind)
    factor = _factor(name, unit, units, place)
    si = next(u for u in units if same_dimension(unit, u))
    return Column(f"{axis}.{kind.value}", kind, axis, si, factor)


def _factor(name: str, unit: str | None, units: tuple[str, ...], place: Place) -> float:
    example = {"s": "s", "m": "mm", "V": "V", "A": "A"}[units[0]]
    remedy = f'Write it like "{name} [{example}]".'
    if not unit:
        raise RecordingError(f"column {name!r} has no unit", place=place, remedy=remedy)
    for target in units:
        try:
            return unit_factor(unit, target)
        except UnitError:
            continue
    wanted = " or ".join(units)
    raise RecordingError(
        f"column {name!r} is in {unit[:20]!r}, which is not a unit like {wanted}",
        place=place,
        remedy=remedy,
    )
