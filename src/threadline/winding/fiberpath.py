"""Mandrel, band and layers of FiberPath's ``.wind`` 1.x, a JSON document with a published format.

A file describes a cylinder, cone or Von Karman nose of the length ``windLength`` from place 0, one
tow, and layers. A helical layer has the angle ``windAngle`` at place 0 and N = ceil(2 pi R cos(a) /
width) circuits, where R is the radius of the bare mandrel. Each circuit advances by 2
``lockDegrees`` + 360 ``skipIndex`` / ``patternNumber`` degrees, and after every ``patternNumber``
circuits by 360 / N more. So all circuits of a layer are alike if ``patternNumber`` is N: their
shift is N ``lockDegrees`` / 180 + ``skipIndex`` (mod N). The format has no field for friction, for
dwells and for the path of the fibre in a turn.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NoReturn

from threadline.base.reading import read_text
from threadline.errors import JobError, Place

SUFFIX = ".wind"
"""Ending of a definition, in lower case."""
FRICTION = 0.2
"""Default slip limit of FiberPath's machine profile; no planner writes a friction."""
NAMED = f"friction {FRICTION:g} assumed"
"""Words in the name of a product: the friction is assumed, and not from the planner's file."""
_MAX_BYTES = 20_000_000
_MARGIN_BANDS = (
    2.0  # widths of the band by which a mandrel is longer than FiberPath's winding length
)
ANGLES = 1.0, 89.0
"""Least and largest winding angle of a helical layer, degrees."""
_ROOM_FACTOR = 1.05  # times the room for a turn by friction
_WHOLE_SLOTS = 1e-6

Content = dict[str, Any]


class WindFile:
    """A checked ``.wind`` file; unknown members are ignored.

    Lengths are in mm and angles in degrees, as in the file.

    Raises
    ------
    JobError
        If the file cannot be read, or is no winding definition of version 1.x.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        text = read_text(path, _MAX_BYTES, JobError, "winding definition", "utf-8-sig")
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            line = getattr(error, "lineno", 0)
            raise JobError(
                f"it is no JSON: {getattr(error, 'msg', 'nested too deeply')}",
                place=Place(str(path), line),
                remedy="FiberPath writes .wind as JSON; correct that line.",
            ) from error
        self.content: Mapping[str, Any] = content if isinstance(content, dict) else {}
        version = self.content.get("schemaVersion", "1.0")
        if not isinstance(version, str) or not re.fullmatch(r"1(\.\d{1,6})?", version):
            self.refuse(
                f"schemaVersion {str(version)[:20]!r}: versions 1.x are read", "Convert it."
            )
        mandrel, tow = self.table("mandrelParameters"), self.table("towParameters")
        self.radius = 0.5 * self.length(mandrel, "diameter")
        self.long, self.width = self.length(mandrel, "windLength"), self.length(tow, "width")
        self.thickness = self.length(tow, "thickness")
        profile = mandrel.get("profile")
        self.nose = profile is not None
        if self.nose:
            kind = profile.get("type") if isinstance(profile, dict) else profile
            if kind != "vonKarman":
                self.refuse(f"a mandrel of the profile {str(kind)[:40]!r}", "vonKarman is read.")
        cone = not self.nose and "endDiameter" in mandrel
        self.end = 0.5 * self.length(mandrel, "endDiameter") if cone else self.radius

    def product(self, room: float = 0.0) -> Content:
        """Return the content of a product file.

        Parameters
        ----------
        room
            Additional length for the turns of the fibre at each open end, mm, beyond the two band
            widths that every mandrel gets.
        """
        radius, length, width, end = self.radius, self.long, self.width, self.end
        margin_mm = _MARGIN_BANDS * width + room
        if self.nose:
            # Half of the radius at which the lowest geodesic turns back: no fibre comes nearer.
            sine = min([math.sin(math.radians(a)) for a in self.angles()] or [1.0])
            opening = max(0.5 * radius * sine, 0.51 * width)
            nose = {"kind": "nose", "radius": radius, "height": length, "opening": opening}
            base = {"kind": "cylinder", "radius": radius, "length": margin_mm}
            parts: list[Content] = [base, nose | {"pole": "right"}]
            covered = None
        else:
            slope = (end - radius) / length
            parts = [
                {"kind": "cone", "radius": radius - margin_mm * slope,
                 "length": length + 2.0 * margin_mm,
                 "end_radius": max(end + margin_mm * slope, 0.1 * end)}
            ]  # fmt: skip
            covered = {"begin": f"{margin_mm!r} mm", "end": f"{margin_mm + length!r} mm"}
        part_rows = [
            {key: f"{value!r} mm" if isinstance(value, float) else value
             for key, value in part.items()}
            for part in parts
        ]  # fmt: skip
        content: Content = {
            "name": f"{self.path.stem} ({NAMED})",
            "mandrel": {"at": f"{-margin_mm!r} mm"},
            "part": part_rows,
            "band": {"width": f"{width!r} mm", "thickness": f"{self.thickness!r} mm"},
            "friction": {"value": FRICTION},
        }
        return content if covered is None else content | {"coverage": covered}

    def refuse(self, what: str, remedy: str) -> NoReturn:
        """Raise a ``JobError`` about the file."""
        raise JobError(what, place=Place(str(self.path)), remedy=remedy)

    def table(self, name: str) -> Mapping[str, Any]:
        """Return a member that is an object."""
        member = self.content.get(name)
        if not isinstance(member, dict):
            self.refuse(
                f"{name} is missing",
                'FiberPath writes {"mandrelParameters": {"diameter": 70, ...}, ...}.',
            )
        return member

    def length(self, table: Mapping[str, Any], key: str) -> float:
        """Return a length above 0, mm."""
        value = table.get(key)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not 1e-6 < float(value) < 1e6:  # type: ignore[arg-type]
            self.refuse(
                f"{key} is {str(value)[:40]}, not a length above 0 mm", f'Write "{key}": 70.'
            )
        return float(value)  # type: ignore[arg-type]

    def angles(self) -> Iterator[float]:
        """Yield the winding angles of the layers that can be read, degrees."""
        layers = self.content.get("layers")
        for layer in layers if isinstance(layers, list) else ():
            angle = layer.get("windAngle") if isinstance(layer, dict) else None
            if isinstance(angle, int | float) and 0.0 < angle <= 90.0:
                yield float(angle)


def circuits_of(radius_mm: float, width_mm: float, angle_deg: float) -> int:
    """Return the number of circuits that FiberPath winds."""
    circumference_mm = 2.0 * math.pi * radius_mm
    return math.ceil(circumference_mm / (width_mm / math.cos(math.radians(angle_deg))))


def layered(path: Path, margin: float) -> Content:
    """Return the content of a product file, with its layers, for a ``.wind`` file.

    FiberPath turns the fibre back within ``windLength``, by a friction that the file does not give;
    here the mandrel is longer at its open ends by the length of such a turn.

    Parameters
    ----------
    margin
        Share of the friction that a path uses.

    Raises
    ------
    JobError
        If the file cannot be read, or has a layer that cannot be wound here; the error names the
        layer.
    """
    wind = WindFile(path)
    rows = wind.content.get("layers")
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        wind.refuse(
            "layers is no list of layers", 'Write "layers": [{"windType": "helical", ...}].'
        )
    least_sine = min((math.sin(math.radians(a)) for a in wind.angles()), default=1.0)
    room = _ROOM_FACTOR * wind.radius / (margin * FRICTION) * (1.0 / least_sine - 1.0)
    if wind.end < wind.radius:  # towards the narrow end the fibre turns of itself
        room = min(room, 0.5 * wind.long * wind.end / (wind.radius - wind.end))
    content = wind.product(room)
    begin = -float(content["mandrel"]["at"].removesuffix(" mm"))
    angle_radius = wind.radius + begin * (wind.radius - wind.end) / wind.long
    layers = [
        _row(wind, number, row, begin, angle_radius if number == 1 else wind.radius)
        for number, row in enumerate(rows, start=1)
    ]
    return content | {"layer": layers}


def _row(
    wind: WindFile, number: int, row: Mapping[str, Any], begin: float, angle_radius: float
) -> dict[str, Any]:
    """Return a ``[[layer]]`` whose angle holds at the radius ``angle_radius``, mm."""
    kind = row.get("windType")
    if kind == "hoop":
        if row.get("terminal", False):
            wind.refuse(
                f"layer {number}: a terminal hoop layer ends at the far end; here it comes back",
                'Write "terminal": false.',
            )
        return {"kind": "hoop"}
    if kind != "helical":
        wind.refuse(
            f"layer {number}: windType {str(kind)[:40]!r}: helical and hoop lay fibre",
            "Leave that layer out: between two layers the fibre finds its own way here.",
        )
    angle = _number(wind, number, row, "windAngle")
    low, high = ANGLES
    if not low <= angle <= high:
        wind.refuse(f"layer {number}: windAngle {angle:g}: {low:g} to {high:g} deg", "Correct it.")
    if row.get("frictionLambda", 0.0) != 0.0:
        wind.refuse(
            f"layer {number}: frictionLambda steers the whole path; here it is a geodesic",
            'Write "frictionLambda": 0.',
        )
    count = circuits_of(wind.radius, wind.width, angle)
    sine = wind.radius * math.sin(math.radians(angle)) / angle_radius
    angle_deg = angle if angle_radius == wind.radius else math.degrees(math.asin(sine))
    layer: Content = {"angle": f"{angle_deg!r} deg", "circuits": count}
    if wind.nose:
        layer["begin"] = f"{begin!r} mm"
    pattern, skip = (_number(wind, number, row, key) for key in ("patternNumber", "skipIndex"))
    slots = count * _number(wind, number, row, "lockDegrees") / 180.0
    if pattern == count and abs(slots - round(slots)) < _WHOLE_SLOTS * count:
        layer["shift"] = (round(slots) + round(skip)) % count
    return layer


def _number(wind: WindFile, number: int, row: Mapping[str, Any], key: str) -> float:
    value = row.get(key)
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not 0.0 < float(value) < 1e6:  # type: ignore[arg-type]
        wind.refuse(
            f"layer {number}: {key} is {str(value)[:40]}, not a number above 0", f'Write "{key}".'
        )
    return float(value)  # type: ignore[arg-type]
